use std::f64::consts::{FRAC_PI_3, TAU};

use locsim_comparison::fixtures::{DRIVE, MAX_M, NOMINAL, SEED, SIGMA_M, TRUTH};
use locsim_core::{Laser, Track, wrap_angle};
use locsim_gap::{PoseError, Recorded, Strength};
use locsim_world::effect::EffectKind;

use super::other::Course;
use super::*;

/// The north wall, which the robot sees from the south.
const NORTH: [DVec2; 2] = [DVec2::new(6.0, 4.0), DVec2::new(0.0, 4.0)];

/// Values of an effect that is strong, or as good as none.
fn values(form: OtherForm, strong: bool) -> Vec<f64> {
    let on = |value: f64| if strong { value } else { 0.0 };
    match form {
        OtherForm::IncidenceBias => vec![on(0.05)],
        OtherForm::HeavyTail | OtherForm::MixedPixels => vec![on(0.6)],
        OtherForm::Glass => vec![on(0.6), 0.0],
        OtherForm::IncidenceDropout => vec![on(0.8), FRAC_PI_3, 0.05],
        OtherForm::RangeDropout => vec![on(0.9), 4.0],
        OtherForm::WarmupDrift => vec![on(0.2), 3.0],
        OtherForm::MovedWall => vec![on(0.3), 0.0],
        OtherForm::MissingObject => vec![3.0, 2.0, on(0.2)],
        OtherForm::RangeNoise => vec![on(0.01)],
        OtherForm::IncidenceNoise => vec![on(3.0)],
        OtherForm::SectorOcclusion => vec![2.9, -2.9, 0.3, on(0.7)],
        OtherForm::Crosstalk => vec![on(0.9), 0.3],
        OtherForm::MotionSkew => vec![on(0.5)],
        OtherForm::RangeBias | OtherForm::RangeScale => vec![on(0.1)],
        OtherForm::TimeOffset | OtherForm::OdomDistanceScale | OtherForm::OdomImbalance => vec![on(0.2)],
        OtherForm::WheelSlip => vec![on(0.3), 0.5],
        OtherForm::Course(kind, _) => match kind {
            EffectKind::WarmupDrift => vec![on(0.2), 3.0],
            EffectKind::RangeNoise => vec![on(0.01)],
            EffectKind::IncidenceNoise => vec![on(3.0)],
            EffectKind::IncidenceDropout => vec![on(0.8), FRAC_PI_3, 0.05],
            EffectKind::RangeDropout => vec![on(0.9), 1.0],
            _ => vec![on(0.05)],
        },
    }
}

/// All forms.
fn forms() -> impl Iterator<Item = OtherForm> {
    OtherForm::ALL.into_iter().chain(OtherForm::COURSES)
}

fn place(form: OtherForm) -> Vec<[DVec2; 2]> {
    match form {
        OtherForm::Glass => vec![[DVec2::new(5.0, 1.0), DVec2::new(5.0, 2.0)], NORTH],
        OtherForm::MovedWall => vec![NORTH],
        _ => vec![],
    }
}

fn other(form: OtherForm, strong: bool, regime: Regime) -> Drive {
    record_other(&NOMINAL, &TRUTH, form, &values(form, strong), &place(form), regime, SEED).unwrap()
}

fn outside(kind: Outside, strength: f64) -> Drive {
    record_outside(&NOMINAL, &TRUTH, kind, strength, Regime::default(), SEED).unwrap()
}

fn plain(regime: Regime) -> Drive {
    locsim_gap::hidden::record_library(&NOMINAL, &TRUTH, &[], regime, SEED).unwrap()
}

fn strength(kind: Outside) -> f64 {
    match kind {
        Outside::LogNormalNoise => 1.0,
        Outside::DoubleReturn | Outside::FloorHit | Outside::SecondReflection | Outside::NearLoss => 0.5,
        Outside::OdometryLag => 0.25,
        Outside::NeighbourNoise => 0.8,
        _ => 0.1,
    }
}

/// All readings, NaN as -1.
fn readings(drive: &Drive) -> Vec<f64> {
    let all = drive.steps.iter().flat_map(|step| &step.scan.ranges);
    all.map(|&z| if z.is_nan() { -1.0 } else { f64::from(z) }).collect()
}

/// A reading before and after, and what the map says of its beam.
struct Pair {
    scan: usize,
    secs: f64,
    beam: usize,
    bearing: f64,
    range: f64,
    incidence: f64,
    surface: u32,
    at: DVec2,
    before: f64,
    after: f64,
}

impl Pair {
    fn moved(&self) -> f64 {
        self.after - self.before
    }

    fn is_changed(&self) -> bool {
        self.before != self.after
    }

    /// Whether the nominal reading is of the wall.
    fn is_wall(&self) -> bool {
        (self.before - self.range).abs() < 0.045
    }

    fn is_lost(&self) -> bool {
        self.after == MAX_M && self.before < MAX_M
    }
}

/// Every reading of the nominal drive with what became of it, by casts of the test's own.
fn pairs(drive: &Drive) -> Vec<Pair> {
    let nominal = plain(Regime::default());
    let laser: &Laser = &drive.laser;
    let (before, after) = (readings(&nominal), readings(drive));
    let mut pairs = vec![];
    for (scan, (&secs, pose)) in TRUTH.secs().iter().zip(TRUTH.poses()).enumerate() {
        for (beam, &bearing) in laser.bearings().iter().enumerate() {
            let map_from_laser = pose.compose(&laser.base_from_laser());
            let direction = DVec2::from_angle(map_from_laser.theta + f64::from(bearing));
            let hit = NOMINAL.map.cast_ray(map_from_laser.position(), direction, 99.0).unwrap();
            let i = scan * laser.beam_count() + beam;
            pairs.push(Pair {
                scan,
                secs,
                beam,
                bearing: f64::from(bearing),
                range: hit.range,
                incidence: hit.incidence,
                surface: hit.surface,
                at: map_from_laser.position() + hit.range * direction,
                before: before[i],
                after: after[i],
            });
        }
    }
    pairs
}

fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for value in values {
        (sum, n) = (sum + value, n + 1.0);
    }
    assert!(n > 20.0, "a mean of {n}");
    sum / n
}

fn share(pairs: &[Pair], of: impl Fn(&Pair) -> bool, is: impl Fn(&Pair) -> bool) -> f64 {
    mean(pairs.iter().filter(|pair| of(pair)).map(|pair| f64::from(is(pair))))
}

/// Root mean square of the changes of readings of walls.
fn spread(pairs: &[Pair], of: impl Fn(&Pair) -> bool) -> f64 {
    let walls = pairs.iter().filter(|pair| pair.is_wall() && of(pair));
    mean(walls.map(|pair| pair.moved().powi(2))).sqrt()
}

#[test]
fn without_effects_the_drive_is_the_simulators() {
    assert_eq!(readings(&plain(Regime::default())), readings(&DRIVE));
    assert_eq!(plain(Regime::default()).steps.last().unwrap().odometry, DRIVE.steps.last().unwrap().odometry);
}

#[test]
fn at_strength_0_every_drive_is_the_nominal_one_bit_for_bit() {
    let hard = Regime { persistent_blocks: true, pose_error: Some(Regime::POSE_ERROR) };
    for regime in [Regime::default(), hard] {
        let nominal = plain(regime);
        for form in forms() {
            assert_eq!(format!("{:?}", other(form, false, regime)), format!("{nominal:?}"), "{form:?}");
        }
        for &kind in Outside::ALL {
            let drive = record_outside(&NOMINAL, &TRUTH, kind, 0.0, regime, SEED).unwrap();
            assert_eq!(format!("{drive:?}"), format!("{nominal:?}"), "{kind:?}");
        }
    }
}

/// Also with beams that are taken one after the other.
#[test]
fn at_strength_0_a_sweep_is_the_nominal_one() {
    let mut nominal = NOMINAL.clone();
    nominal.laser.scan_secs = 0.1;
    let regime = Regime::default();
    let plain = locsim_gap::hidden::record_library(&nominal, &TRUTH, &[], regime, SEED).unwrap();
    for form in forms() {
        let values = values(form, false);
        let drive = record_other(&nominal, &TRUTH, form, &values, &place(form), regime, SEED).unwrap();
        assert_eq!(readings(&drive), readings(&plain), "{form:?}");
    }
    let biased = record_outside(&nominal, &TRUTH, Outside::SurfaceBias, 0.1, regime, SEED).unwrap();
    assert_ne!(readings(&biased), readings(&plain));
}

/// Readings or odometry differ, not both; the same seed gives the same bits, another one others.
#[test]
fn a_strong_effect_shows_where_it_acts_and_a_seed_decides_all() {
    let nominal = plain(Regime::default());
    let odometry = |drive: &Drive| drive.steps.iter().map(|step| step.odometry).collect::<Vec<_>>();
    for form in forms() {
        let drive = other(form, true, Regime::default());
        let of_odometry = form.kind().site() == locsim_world::effect::Site::Odometry;
        assert_eq!(readings(&drive) != readings(&nominal), !of_odometry, "{form:?}");
        assert_eq!(odometry(&drive) != odometry(&nominal), of_odometry, "{form:?}");
        assert!(drive.steps.iter().zip(&nominal.steps).all(|(a, b)| a.reference == b.reference));
        assert_eq!(format!("{:?}", other(form, true, Regime::default())), format!("{drive:?}"), "{form:?}");
    }
    for &kind in Outside::ALL {
        let drive = outside(kind, strength(kind));
        let of_odometry = kind == Outside::OdometryLag;
        let of_reference = kind == Outside::FrameTurned;
        assert_eq!(readings(&drive) != readings(&nominal), !of_odometry && !of_reference, "{kind:?}");
        let moved = drive.steps.iter().zip(&nominal.steps).any(|(a, b)| a.reference != b.reference);
        assert_eq!(moved, of_reference, "{kind:?}");
        assert_eq!(odometry(&drive) != odometry(&nominal), of_odometry, "{kind:?}");
        assert_eq!(format!("{:?}", outside(kind, strength(kind))), format!("{drive:?}"), "{kind:?}");
    }
    let values = values(OtherForm::HeavyTail, true);
    let of_seed = |seed| {
        record_other(&NOMINAL, &TRUTH, OtherForm::HeavyTail, &values, &[], Regime::default(), seed).unwrap()
    };
    assert_ne!(readings(&of_seed(1)), readings(&of_seed(2)));
}

/// A spline goes through them without a jump, a table stays at them.
#[test]
fn courses_go_through_their_knots() {
    let knots = [0.2, 1.8, 0.9, 1.1, 0.3, 1.5];
    for (i, knot) in knots.into_iter().enumerate() {
        assert!((Course::Spline.at(&knots, i as f64 / 5.0) - knot).abs() < 1e-12);
        assert_eq!(Course::Table.at(&knots, (i as f64 + 0.5) / 6.0), knot);
    }
    let spline: Vec<f64> = (0..=1000).map(|i| Course::Spline.at(&knots, f64::from(i) / 1000.0)).collect();
    assert!(spline.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 0.02));
    assert_eq!(Course::Table.at(&knots, 2.0), 1.5);
}

/// Each log has a course of its own, which is a function of its covariate alone.
#[test]
fn a_course_of_a_scale_is_over_range() {
    let form = OtherForm::Course(EffectKind::RangeScale, Course::Table);
    let scaled = pairs(&other(form, true, Regime::default()));
    let level = |range: f64| (range / MAX_M * 6.0) as usize;
    for at in 1..5 {
        let factors: Vec<f64> = scaled
            .iter()
            .filter(|pair| pair.is_wall() && level(pair.before) == at && pair.before > 1.0 && !pair.is_lost())
            .map(|pair| pair.moved() / (0.05 * pair.before))
            .collect();
        let first = factors[0];
        assert!((0.15..1.85).contains(&first), "{at}: {first}");
        assert!(factors.iter().all(|factor| (factor - first).abs() < 0.05), "{at}: {first}");
    }
}

#[test]
fn other_biases_are_where_and_as_large_as_they_say() {
    let strong = |form| pairs(&other(form, true, Regime::default()));
    // Where readings are shifted, each is by what the form says, up to the rounding before and after.
    let shifted = |form, by: &dyn Fn(&Pair) -> f64| {
        let mut count = 0;
        for pair in strong(form).iter().filter(|pair| pair.is_wall() && pair.range < 4.5 && !pair.is_lost()) {
            assert!((pair.moved() - by(pair)).abs() < 0.0012, "{form:?}: {} {}", pair.moved(), by(pair));
            count += 1;
        }
        assert!(count > 5000, "{form:?}: {count}");
    };
    shifted(OtherForm::RangeBias, &|pair| if pair.beam % 2 == 0 { 0.12 } else { 0.08 });
    shifted(OtherForm::RangeScale, &|pair| 0.1 * pair.before * (0.7 + 0.12 * pair.before));
    shifted(OtherForm::WarmupDrift, &|pair| 0.2 * (1.0 - pair.secs / 6.0).max(0.0));
    let slant = |pair: &Pair| 2.0 * (1.0 / pair.incidence.min(80_f64.to_radians()).cos() - 1.0);
    shifted(OtherForm::IncidenceBias, &|pair| 0.05 * slant(pair));
    assert!(
        strong(OtherForm::IncidenceBias)
            .iter()
            .all(|pair| !pair.is_changed() || pair.is_wall() || (pair.before - pair.range).abs() < 0.052)
    );
}

/// Spreads are within 10 %, and 0 where the form has none.
#[test]
fn other_noises_are_where_and_as_large_as_they_say() {
    let noise = pairs(&other(OtherForm::RangeNoise, true, Regime::default()));
    assert_eq!(spread(&noise, |pair| pair.before < 2.0), 0.0);
    let expected = ((SIGMA_M + 0.08 * 1.2_f64).powi(2) - SIGMA_M.powi(2)).sqrt();
    let at = spread(&noise, |pair| (3.15..3.25).contains(&pair.before));
    assert!((at / expected - 1.0).abs() < 0.3, "{at} {expected}");

    let noise = pairs(&other(OtherForm::IncidenceNoise, true, Regime::default()));
    assert!(spread(&noise, |pair| pair.incidence < 0.1) < 0.003);
    let at = spread(&noise, |pair| (1.0..1.1).contains(&pair.incidence));
    let expected = SIGMA_M * 3.0 * 2.0 * (1.0 / 1.05_f64.cos() - 1.0);
    assert!((at / expected - 1.0).abs() < 0.3, "{at} {expected}");

    // A share of 0.6 of the returns, with t of 3 degrees of freedom: |t| has the median 0.765.
    let tail = pairs(&other(OtherForm::HeavyTail, true, Regime::default()));
    let returns = |pair: &Pair| pair.before > 0.0 && pair.before < 4.0;
    let changed = share(&tail, returns, Pair::is_changed);
    assert!((0.57..0.61).contains(&changed), "{changed}");
    let beyond = share(
        &tail,
        |pair| returns(pair) && pair.is_changed(),
        |pair| pair.moved().abs() > 0.765 * 5.0 / 3_f64.sqrt() * SIGMA_M,
    );
    assert!((beyond - 0.5).abs() < 0.04, "{beyond}");
}

#[test]
fn other_dropouts_lose_what_they_say() {
    let lost = pairs(&other(OtherForm::IncidenceDropout, true, Regime::default()));
    assert!(lost.iter().all(|pair| !pair.is_changed() || pair.is_lost() && pair.incidence > FRAC_PI_3));
    let at = share(
        &lost,
        |pair| pair.is_wall() && pair.incidence > FRAC_PI_3 && pair.before < MAX_M,
        Pair::is_lost,
    );
    assert!((at - 0.8).abs() < 0.05, "{at}");

    // For an exponent of 4 the ramp starts at 0.6 R.
    let lost = pairs(&other(OtherForm::RangeDropout, true, Regime::default()));
    assert!(lost.iter().all(|pair| !pair.is_changed() || pair.is_lost() && pair.before > 0.6 * MAX_M));
    let at = share(&lost, |pair| (3.9..4.1).contains(&pair.before), Pair::is_lost);
    assert!((at - 0.45).abs() < 0.2, "{at}");
}

#[test]
fn other_walls_and_objects_stand_where_they_say() {
    // The north wall bulges by 0.47 m in its middle.
    let moved = pairs(&other(OtherForm::MovedWall, true, Regime::default()));
    let is_north = |pair: &Pair| pair.at.y > 4.0 - 1e-9;
    assert!(moved.iter().all(|pair| !pair.is_changed() || pair.at.y > 3.89));
    let straight = |pair: &Pair| is_north(pair) && pair.is_wall() && pair.incidence < 0.3;
    for x in [1.0, 2.0, 3.0, 4.0] {
        let near = |pair: &&Pair| straight(pair) && (pair.at.x - x).abs() < 0.4;
        let by = mean(moved.iter().filter(near).map(Pair::moved));
        let bulge = 0.15 * std::f64::consts::PI * (std::f64::consts::PI * x / 6.0).sin();
        assert!((by - bulge).abs() < 0.05, "{by} at {x}");
    }

    let met = pairs(&other(OtherForm::MissingObject, true, Regime::default()));
    let center = DVec2::new(3.0, 2.0);
    let (mut hit, half) = (0, 0.5 * std::f64::consts::PI.sqrt() * 0.2);
    for pair in met.iter().filter(|pair| pair.is_changed()) {
        let pose = TRUTH.poses()[pair.scan].compose(&NOMINAL.laser.mount);
        let point = pose.position() + pair.after * DVec2::from_angle(pose.theta + pair.bearing);
        let distance = point.distance(center);
        assert!(
            pair.after < pair.before && (half - 0.06..1.42 * half + 0.06).contains(&distance),
            "{distance}"
        );
        hit += 1;
    }
    assert!(hit > 200, "{hit}");

    // Behind the screen there is the east wall, behind the north wall nothing.
    let through = pairs(&other(OtherForm::Glass, true, Regime::default()));
    let screen = NOMINAL.map.geometry().surface_names().iter().position(|name| name == "screen").unwrap();
    let (mut behind, mut lost) = (0, 0);
    for pair in through.iter().filter(|pair| pair.is_changed()) {
        assert!(pair.incidence < FRAC_PI_3 && pair.is_wall() | ((pair.before - pair.range).abs() < 0.052));
        if pair.is_lost() {
            lost += 1;
        } else {
            assert!(pair.surface as usize == screen && pair.after > pair.before + 0.9);
            behind += 1;
        }
    }
    assert!(behind > 50 && lost > 500, "{behind} {lost}");
}

#[test]
fn other_disturbances_come_when_and_where_they_say() {
    let mixed = pairs(&other(OtherForm::MixedPixels, true, Regime::default()));
    let changed: Vec<&Pair> = mixed.iter().filter(|pair| pair.is_changed()).collect();
    let at_edges = changed.iter().filter(|pair| (pair.after - pair.range).abs() > 0.05).count();
    assert!(changed.len() > 200 && changed.len() < mixed.len() / 5 && at_edges > changed.len() / 2);

    let fingers = pairs(&other(OtherForm::SectorOcclusion, true, Regime::default()));
    for pair in fingers.iter().filter(|pair| pair.is_changed()) {
        let (from_start, near) =
            ((pair.bearing - 2.9).rem_euclid(TAU), |at: f64| (pair.after - at).abs() < 0.06);
        let first = from_start <= 0.194 && near(0.27);
        let second = (0.289..=0.4833).contains(&from_start) && near(0.33);
        assert!(first || second, "{} reads {}", pair.bearing, pair.after);
    }
    let share = share(&fingers, |pair| (pair.bearing - 2.9).rem_euclid(TAU) < 0.19, Pair::is_changed);
    assert!((share - 0.7).abs() < 0.1, "{share}");

    // Bursts: in each scan nearly all or no readings.
    let bursts = pairs(&other(OtherForm::Crosstalk, true, Regime::default()));
    let beams = DRIVE.laser.beam_count();
    let shares: Vec<usize> =
        bursts.chunks(beams).map(|scan| scan.iter().filter(|pair| pair.is_changed()).count()).collect();
    assert!(shares.iter().all(|&n| n == 0 || n > beams / 2), "{shares:?}");
    let on = shares.iter().filter(|&&n| n > 0).count();
    assert!(on > 3 && on < shares.len() * 4 / 5, "{on} of {}", shares.len());
}

/// Readings of walls are those from where the robot is at the form's time, within the noise.
#[test]
fn other_clocks_are_off_as_they_say() {
    for form in [OtherForm::MotionSkew, OtherForm::TimeOffset] {
        let drive = other(form, true, Regime::default());
        let late = |pair: &Pair| match form {
            OtherForm::MotionSkew => 0.25 * (0.5 * wrap_angle(pair.bearing)).sin(),
            _ => 0.2,
        };
        let miss = |pair: &Pair, secs: f64| {
            let pose = TRUTH.pose_at(pair.secs + secs).compose(&NOMINAL.laser.mount);
            let direction = DVec2::from_angle(pose.theta + pair.bearing);
            (NOMINAL.map.cast_ray(pose.position(), direction, 99.0).unwrap().range - pair.after).abs()
        };
        let pairs = pairs(&drive);
        let near = |secs: &dyn Fn(&Pair) -> f64| {
            share(&pairs, |pair| pair.is_changed() && pair.is_wall(), |pair| miss(pair, secs(pair)) < 0.04)
        };
        let (there, elsewhere, opposite) = (near(&late), near(&|_| 0.0), near(&|pair| -late(pair)));
        assert!(
            there > 0.65 && elsewhere < there - 0.1 && opposite < elsewhere,
            "{form:?}: {there} {elsewhere} {opposite}"
        );
    }
}

#[test]
fn other_odometries_read_what_they_say() {
    let nominal = plain(Regime::default());
    let steps =
        |drive: &Drive| (1..drive.steps.len()).map(|i| drive.odometry_increment(i)).collect::<Vec<_>>();
    let compare = |form| {
        let drive = other(form, true, Regime::default());
        let read = steps(&drive).into_iter().zip(steps(&nominal));
        let truth = TRUTH.poses().windows(2).map(|pair| pair[1].relative_to(&pair[0]));
        read.zip(truth).map(|((read, nominal), truth)| (read, nominal, truth)).collect::<Vec<_>>()
    };
    let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
    for (read, nominal, truth) in compare(OtherForm::OdomDistanceScale) {
        let factor = if truth.x > 0.0 { 1.2 } else { 1.0 };
        assert!(near(read.x, factor * nominal.x) && near(read.theta, nominal.theta));
    }
    for (read, nominal, truth) in compare(OtherForm::OdomImbalance) {
        let speed = 10.0 * truth.position().length().copysign(truth.x);
        assert!(near(read.x, nominal.x) && near(read.theta - nominal.theta, 0.02 * speed.tanh()));
    }
    let slips: Vec<f64> = compare(OtherForm::WheelSlip)
        .iter()
        .filter(|(_, nominal, _)| nominal.x.abs() > 1e-3)
        .map(|(read, nominal, _)| read.x / nominal.x - 1.0)
        .collect();
    let slipped = mean(slips.iter().map(|s| f64::from(*s > 1e-9)));
    assert!(slips.iter().all(|s| *s > -1e-9) && (slipped - 0.3).abs() < 0.2, "{slipped}");
}

#[test]
fn effects_outside_the_library_are_where_and_as_large_as_they_say() {
    let strong = |kind| pairs(&outside(kind, strength(kind)));
    let shifted = |kind, by: &dyn Fn(&Pair) -> f64| {
        for pair in strong(kind).iter().filter(|pair| pair.is_wall() && pair.range < 4.5) {
            assert!((pair.moved() - by(pair)).abs() < 0.0012, "{kind:?}: {} {}", pair.moved(), by(pair));
        }
    };
    shifted(Outside::PeriodicBias, &|pair| 0.1 * (TAU * pair.secs / 7.0).sin());
    shifted(Outside::BearingBias, &|pair| 0.1 * (2.0 * pair.bearing).sin());
    shifted(Outside::BearingRipple, &|pair| 0.1 * (6.0 * pair.bearing).sin());
    let names = NOMINAL.map.geometry().surface_names();
    shifted(Outside::SurfaceBias, &|pair| if names[pair.surface as usize] == "door" { -0.1 } else { 0.0 });

    let lit = strong(Outside::BackgroundLight);
    let center = TRUTH.poses()[TRUTH.poses().len() / 2].position();
    assert!(lit.iter().all(|pair| !pair.is_changed() || pair.at.distance(center) < 2.6 || !pair.is_wall()));
    let at = spread(&lit, |pair| (1.2..1.3).contains(&pair.at.distance(center)));
    assert!((at - 0.05).abs() < 0.015, "{at}");

    let jitter = strong(Outside::SharedScanJitter);
    let offsets: Vec<f64> = jitter
        .chunks(DRIVE.laser.beam_count())
        .map(|scan| {
            let moved: Vec<f64> =
                scan.iter().filter(|p| p.is_wall() && p.range < 4.5).map(Pair::moved).collect();
            assert!(moved.iter().all(|by| (by - moved[0]).abs() < 0.0025), "one offset for a scan");
            moved[0]
        })
        .collect();
    let spread = mean(offsets.iter().map(|x| x * x)).sqrt();
    assert!((spread - 0.1).abs() < 0.03, "{spread}");

    // The same mean and variance; the skewness of a lognormal of shape 1 is 6.2, and finite samples show less.
    let skewed = strong(Outside::LogNormalNoise);
    let moments = |z: &dyn Fn(&Pair) -> f64| {
        [1, 2, 3].map(|k| {
            mean(skewed.iter().filter(|p| p.is_wall()).map(|p| ((z(p) - p.range) / SIGMA_M).powi(k)))
        })
    };
    let ([m, v, s], [_, _, was]) = (moments(&|p| p.after), moments(&|p| p.before));
    assert!(m.abs() < 0.1 && (v - 1.0).abs() < 0.15 && s > 2.0 && was.abs() < 0.5, "{m} {v} {s} {was}");

    let twice = strong(Outside::DoubleReturn);
    let of_twice = |pair: &Pair| pair.before > 0.0 && 2.0 * pair.before < MAX_M;
    assert!(twice.iter().all(|pair| !pair.is_changed() || (pair.after - 2.0 * pair.before).abs() < 0.001));
    let doubled = share(&twice, of_twice, Pair::is_changed);
    assert!((doubled - 0.5).abs() < 0.05, "{doubled}");

    // At a steady speed the floor is 3 m ahead.
    let floor = strong(Outside::FloorHit);
    let ahead = |pair: &Pair| pair.bearing.abs() < 0.1;
    assert!(floor.iter().all(|pair| !pair.is_changed() || pair.bearing.abs() < 0.6 * TAU / 2.0));
    let mut hits: Vec<f64> =
        floor.iter().filter(|p| ahead(p) && p.is_changed()).map(|pair| pair.after).collect();
    hits.sort_by(f64::total_cmp);
    assert!(
        hits.len() > 30 && (hits[hits.len() / 2] - 3.0).abs() < 0.05,
        "{} {}",
        hits.len(),
        hits[hits.len() / 2]
    );
}

#[test]
fn what_people_have_met_is_where_and_as_large_as_it_says() {
    let strong = |kind| pairs(&outside(kind, strength(kind)));
    // Readings of the wall end where the wall is, to a few standard deviations of the noise.
    for pair in strong(Outside::Stripes).iter().filter(|pair| pair.is_wall() && pair.range < 4.5) {
        let by = 0.1 * (TAU * pair.at.x / 3.0).sin();
        assert!((pair.moved() - by).abs() < 0.0012 + 0.1 * TAU / 3.0 * 0.045, "{} {by}", pair.moved());
    }

    let noisy = strong(Outside::NeighbourNoise);
    let is_whole = |pair: &&[Pair]| pair.iter().all(|pair| pair.is_wall() && pair.range < 4.5);
    let error = |pair: &Pair| (pair.after - pair.range) / SIGMA_M;
    let of_beams = |gap: usize| {
        let scans = noisy.chunks(DRIVE.laser.beam_count());
        let pairs = scans.flat_map(|scan| scan.windows(gap + 1).filter(is_whole));
        mean(pairs.map(|pair| error(&pair[0]) * error(&pair[gap])))
    };
    // As much noise as before, of which neighbours share 0.8 * 0.9.
    let [variance, neighbours, next] = [0, 1, 2].map(of_beams);
    assert!((variance - 1.0).abs() < 0.1, "{variance}");
    assert!((neighbours - 0.72).abs() < 0.08 && (next - 0.648).abs() < 0.08, "{neighbours} {next}");

    let mirrored = strong(Outside::SecondReflection);
    let is_slanted = |pair: &Pair| pair.is_wall() && pair.incidence > 50_f64.to_radians();
    assert!(mirrored.iter().all(|pair| !pair.is_changed() || is_slanted(pair)));
    let went_on = share(&mirrored, is_slanted, Pair::is_changed);
    assert!((went_on - 0.5).abs() < 0.05, "{went_on}");
    // A room of 6 by 4 m, seen in the south wall: the ray goes on as if that wall weren't there, to the west wall's image.
    let south =
        |pair: &&Pair| is_slanted(pair) && pair.at.y.abs() < 1e-6 && pair.is_changed() && !pair.is_lost();
    let mut seen = 0;
    for pair in mirrored.iter().filter(south) {
        let at = TRUTH.poses()[pair.scan].compose(&DRIVE.laser.base_from_laser()).position();
        let direction = (pair.at - at).normalize();
        let to_west = -at.x / direction.x;
        if direction.x < 0.0 && (at + to_west * direction).y > -4.0 {
            assert!((pair.after - to_west).abs() < 0.05, "{} {to_west}", pair.after);
            seen += 1;
        }
    }
    assert!(seen > 5, "{seen}");

    let near = strong(Outside::NearLoss);
    let is_near = |pair: &Pair| pair.is_wall() && pair.range < 1.5;
    assert!(near.iter().all(|pair| !pair.is_changed() || is_near(pair) && pair.is_lost()));
    let lost = share(&near, is_near, Pair::is_lost);
    assert!((lost - 0.5).abs() < 0.05, "{lost}");

    // A quarter of a second is two and a half scans.
    let (late, nominal) = (outside(Outside::OdometryLag, 0.25), plain(Regime::default()));
    for i in 3..nominal.steps.len() {
        let between =
            nominal.steps[i - 3].odometry.position().lerp(nominal.steps[i - 2].odometry.position(), 0.5);
        assert!(late.steps[i].odometry.position().distance(between) < 0.002, "{i}");
    }
}

/// Errors of the reference have the process's spread and correlation; a spread is within 40 %, as a drive of some tens
/// of correlation times would have it, and much less correlation fails.
#[test]
fn a_regime_makes_references_err_and_blocks_stay() {
    let process = PoseError { correlation_secs: 0.5, ..Regime::POSE_ERROR };
    let regime = Regime { persistent_blocks: false, pose_error: Some(process) };
    let drive = plain(regime);
    assert_eq!(
        readings(&drive),
        readings(&plain(Regime::default())),
        "the laser is where the robot really is"
    );
    let errors: Vec<f64> = drive
        .steps
        .iter()
        .zip(TRUTH.poses())
        .map(|(step, truth)| step.reference.unwrap().x - truth.x)
        .collect();
    let square = mean(errors.iter().map(|e| e * e));
    let product = mean(errors.windows(2).map(|pair| pair[0] * pair[1]));
    assert!((square.sqrt() / 0.01 - 1.0).abs() < 0.4, "{}", square.sqrt());
    assert!((product / square - (-0.2_f64).exp()).abs() < 0.15, "{}", product / square);

    // While the robot turns in place, far from a block, blocks that stay are read again.
    let short = |drive: &Drive| {
        let pairs = pairs(drive);
        let n = drive.laser.beam_count();
        let is_short = |pair: &Pair| pair.after < pair.range - 0.06;
        let both = (n..pairs.len()).filter(|&i| is_short(&pairs[i]) && is_short(&pairs[i - n])).count();
        both as f64 / pairs.iter().filter(|pair| is_short(pair)).count() as f64
    };
    let persistent = plain(Regime { persistent_blocks: true, pose_error: None });
    let (stay, change) = (short(&persistent), short(&plain(Regime::default())));
    assert!(stay > change + 0.2, "{stay} {change}");
}

#[test]
fn what_cannot_be_recorded_is_refused() {
    let regime = Regime::default();
    for strength in [-0.1, f64::NAN] {
        let error = record_outside(&NOMINAL, &TRUTH, Outside::BearingBias, strength, regime, 1).unwrap_err();
        assert!(error.to_string().contains("strength must be finite, at least 0"), "{error}");
    }
    let error = record_other(&NOMINAL, &TRUTH, OtherForm::Glass, &[0.5, 0.0], &[], regime, 1).unwrap_err();
    assert!(error.to_string().contains("glass needs a place"), "{error}");
    for secs in [vec![0.0], vec![0.0, 0.0]] {
        let track = Track::new(secs.into_iter().map(|secs| (secs, TRUTH.poses()[0]))).unwrap();
        let error = locsim_gap::hidden::record_library(&NOMINAL, &track, &[], regime, 1).unwrap_err();
        assert!(error.to_string().contains("at least two poses"), "{error}");
    }
}

/// In another form an effect has the information of that form: a scale of distances that holds forward only is the same on a
/// drive forward, and a bias that grows less with the incidence is less.
#[test]
fn another_form_has_its_own_information() {
    let recorded = Recorded::new(&plain(Regime::default()), 160, 24, |_| true).unwrap();
    let strength = Strength::new(&NOMINAL, &recorded, Regime::default(), 9).unwrap();
    let ratio = |kind, value, form: OtherForm| {
        let effect = Effect::new(kind, vec![value], Vec::new()).unwrap();
        let other = strength.information(&effect, Some(&form.of_logs(&NOMINAL))).unwrap();
        other / strength.information(&effect, None).unwrap()
    };
    let scale = ratio(EffectKind::OdomDistanceScale, 0.05, OtherForm::OdomDistanceScale);
    assert!((0.9..1.1).contains(&scale), "{scale}");
    let bias = ratio(EffectKind::IncidenceBias, 0.002, OtherForm::IncidenceBias);
    assert!((0.05..0.7).contains(&bias), "{bias}");
}
