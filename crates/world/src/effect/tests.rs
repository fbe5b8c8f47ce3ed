//! The catalogue, and distributions of readings against their own samples.

use std::f64::consts::TAU;

use locsim_core::{Draw, Pose2, PoseError, Stage};
use proptest::prelude::*;
use rand::RngExt;

use super::*;
use crate::map::FINEST_M;
use crate::simulation::LaserOptions;
use crate::simulation::fixtures::laser_options;

/// A stretch of wall that the beams of these tests end on.
pub(crate) const STRETCH: [DVec2; 2] = [DVec2::new(0.0, 0.0), DVec2::new(6.0, 0.0)];

/// A place for kinds that have one.
pub(crate) fn place(kind: EffectKind) -> Vec<[DVec2; 2]> {
    if kind.has_place() { vec![STRETCH] } else { Vec::new() }
}

/// Each effect at a value that shows; the typical one, where nothing else is said.
pub(crate) fn strong(kind: EffectKind) -> Effect {
    use EffectKind as E;
    let values: &[f64] = match kind {
        E::RangeBias => &[0.05],
        E::RangeScale => &[0.03],
        E::IncidenceBias => &[0.02],
        E::RangeNoise => &[0.01],
        E::IncidenceNoise => &[2.0],
        E::HeavyTail => &[0.4],
        E::IncidenceDropout => &[0.8, 0.6, 0.2],
        E::RangeDropout => &[0.9, 0.7],
        E::MixedPixels => &[0.5],
        E::Glass => &[0.6, 0.25],
        E::MovedWall => &[-0.3, 0.05],
        E::MissingObject => &[4.0, 3.0, 0.3],
        E::MountYaw | E::TimeOffset | E::OdomDistanceScale | E::OdomTurnScale => &[0.1],
        E::MountOffset => &[0.1, -0.05],
        E::MotionSkew | E::OdomImbalance => &[0.2],
        E::WarmupDrift => &[0.1, 5.0],
        E::SectorOcclusion => &[3.0, -2.0, 0.4, 0.7],
        E::Crosstalk => &[0.7, 0.6],
        E::WheelSlip => &[0.5, 0.3],
        _ => return Effect::typical(kind, place(kind)),
    };
    Effect::new(kind, values.to_vec(), place(kind)).unwrap()
}

fn effects(kinds: &[EffectKind]) -> Effects {
    Effects::new(kinds.iter().map(|&kind| strong(kind)).collect()).unwrap()
}

/// P(D > d) <= 2 exp(-2 n d^2) (Dvoretzky, Kiefer, Wolfowitz, Massart): 1e-6 at this d.
pub(crate) fn critical_distance(n: usize) -> f64 {
    ((2.0f64 / 1e-6).ln() / (2.0 * n as f64)).sqrt()
}

/// Kolmogorov-Smirnov distance of usable readings from a distribution, by the randomized probability transform, which is
/// uniform also where there are point masses; in units of the critical distance.
pub(crate) fn distance_from(distribution: impl Fn(usize) -> ReadingDistribution, readings: &[f32]) -> f64 {
    let mut u: Vec<f64> = readings
        .iter()
        .enumerate()
        .filter(|(_, z)| !z.is_nan())
        .map(|(i, &z)| {
            let distribution = distribution(i);
            let upper = distribution.cdf(z);
            let lower = if z >= distribution.max_m as f32 {
                distribution.cdf(z.next_down())
            } else if distribution.step_m > 0.0 {
                distribution.cdf((f64::from(z) - 0.5 * distribution.step_m) as f32)
            } else {
                upper
            };
            let v: f64 = Draw::new(5, Stage::Bootstrap, 0).item(i as u32).random();
            lower + v * (upper - lower)
        })
        .collect();
    if u.is_empty() {
        return 0.0;
    }
    u.sort_unstable_by(f64::total_cmp);
    let n = u.len() as f64;
    let distance = u
        .iter()
        .enumerate()
        .map(|(i, u)| (u - i as f64 / n).max((i as f64 + 1.0) / n - u))
        .fold(0.0, f64::max);
    distance / critical_distance(u.len())
}

fn laser(resolution_m: f64) -> LaserOptions {
    LaserOptions {
        sigma_m: 0.02,
        sigma_per_m: 0.002,
        min_range_m: 0.1,
        max_range_m: 4.5,
        resolution_m,
        ..laser_options()
    }
}

/// A wall straight ahead and at a slant, both with an edge and a surface behind; a wall with nothing behind, near the
/// maximum range; a block; nothing.
fn beams() -> [(BeamView, HitKind, f64); 5] {
    let view = |range, incidence, jump, behind| BeamView {
        secs: 1.0,
        bearing: 3.1,
        range,
        incidence,
        endpoint: DVec2::new(3.0, 0.05),
        direction: DVec2::Y,
        normal: DVec2::ZERO,
        jump,
        behind,
    };
    [
        (view(2.0, 0.1, Some([2.0, 3.5]), Some(3.0)), HitKind::Wall, 2.0),
        (view(1.2, 1.2, Some([0.6, 1.2]), Some(4.4)), HitKind::Wall, 1.2),
        (view(4.45, 0.7, None, None), HitKind::Wall, 4.45),
        (view(3.0, 0.7, Some([2.0, 3.0]), Some(3.5)), HitKind::Object, 0.12),
        (view(6.75, 0.0, None, None), HitKind::Wall, 6.75),
    ]
}

fn samples(distribution: &ReadingDistribution, n: u32) -> Vec<f32> {
    let (noise, chance) = (Draw::new(3, Stage::Laser, 0), Draw::new(3, Stage::Effect, 0));
    (0..n).map(|i| distribution.sample(&mut noise.item(i), &mut chance.item(i))).collect()
}

/// Every reading that a quantized sensor can give below the maximum range, or the middles of steps of 0.25 mm; and the
/// width that each stands for \[m\].
fn readings(distribution: &ReadingDistribution) -> (Vec<f32>, f64) {
    if distribution.step_m > 0.0 {
        let multiples = (0..).map(|k| (f64::from(k) * distribution.step_m) as f32);
        (multiples.take_while(|z| *z < distribution.max_m as f32).collect(), distribution.step_m)
    } else {
        ((0..18_000).map(|i| (f64::from(i) + 0.5) as f32 * 0.000_25).collect(), 0.000_25)
    }
}

/// The density integrates to 1 with the mass at the maximum range, and its running integral is the distribution
/// function. The midpoint rule errs by at most half a step times the jump at each edge of a uniform part.
fn check_density(name: &str, distribution: &ReadingDistribution) {
    let (z, width) = readings(distribution);
    let mut sum = 0.0;
    for &z in &z {
        let mass = distribution.density(z) * width;
        let at = sum + if distribution.step_m > 0.0 { mass } else { 0.5 * mass };
        assert!(
            (at - distribution.cdf(z)).abs() < 1e-3,
            "{name} at {z}: {at}, but cdf {}",
            distribution.cdf(z)
        );
        sum += mass;
    }
    let max = distribution.max_m as f32;
    let total = sum + distribution.density(max);
    assert!((total - 1.0).abs() < 1e-3, "{name}: total {total} for {distribution:?}");
    assert!(
        (1.0 - distribution.cdf(max.next_down()) - distribution.density(max)).abs() < 1e-4,
        "{name}: jump at the maximum"
    );
    let below = (distribution.min_m as f32).next_down();
    assert_eq!(
        (distribution.cdf(max), distribution.cdf(below), distribution.density(below)),
        (1.0, 0.0, 0.0),
        "{name}"
    );
    assert_eq!(distribution.log_density(f32::NAN), 0.0, "{name}");
}

#[test]
fn every_law_integrates_to_one_and_samples_agree_with_it() {
    for resolution_m in [0.0, 0.01] {
        for kind in EffectKind::ALL {
            let effects = effects(&[kind]);
            let mut told_apart = false;
            // Enough to tell a tail of 5 standard deviations from one of 4.
            let n = if kind == EffectKind::HeavyTail { 80_000 } else { 4000 };
            for (i, (view, met, range)) in beams().into_iter().enumerate() {
                let name = format!("{kind}, beam {i}, resolution {resolution_m}");
                let distribution = effects.reading(&laser(resolution_m), &view, met, range);
                let nominal = Effects::none().reading(&laser(resolution_m), &view, met, range);
                check_density(&name, &distribution);
                let d = distance_from(|_| distribution.clone(), &samples(&distribution, n));
                assert!(d < 1.0, "{name}: {d}");
                told_apart |= distance_from(|_| distribution.clone(), &samples(&nominal, 4000)) > 1.0;
            }
            // Negative control: samples of the nominal world, under every effect that changes readings.
            let shapes_readings =
                matches!(kind.moves(), Moves::Readings | Moves::Distribution | Moves::Walls);
            assert_eq!(told_apart, shapes_readings, "{kind}, resolution {resolution_m}");
        }
    }
}

/// All pairs, the same effect twice among them, on a slanted wall with an edge and a surface behind.
#[test]
fn two_effects_together_agree_with_their_density() {
    let (view, met, range) = beams()[1];
    for a in EffectKind::ALL {
        for b in EffectKind::ALL {
            if (a, b) == (EffectKind::WheelSlip, EffectKind::WheelSlip) {
                continue;
            }
            let distribution = effects(&[a, b]).reading(&laser(0.0), &view, met, range);
            let d = distance_from(|_| distribution.clone(), &samples(&distribution, 1000));
            assert!(d < 1.0, "{a}, {b}: {d}");
            let other_way = effects(&[b, a]).reading(&laser(0.0), &view, met, range);
            if a != b {
                assert_eq!(
                    distribution.alternatives, other_way.alternatives,
                    "{a}, {b}: order doesn't matter"
                );
            }
        }
    }
    let all = effects(&EffectKind::ALL).reading(&laser(0.0), &view, met, range);
    check_density("all", &all);
    assert!(distance_from(|_| all.clone(), &samples(&all, 4000)) < 1.0);
}

#[test]
fn a_neutral_effect_leaves_every_law_as_it_is() {
    for kind in EffectKind::ALL {
        let neutral = Effects::new(vec![Effect::neutral(kind, place(kind))]).unwrap();
        for (view, met, range) in beams() {
            let distribution = neutral.reading(&laser(0.001), &view, met, range);
            assert_eq!(distribution, Effects::none().reading(&laser(0.001), &view, met, range), "{kind}");
        }
        let pose = Pose2::new(0.3, -0.2, 1.0);
        assert_eq!(neutral.laser_mount(pose), pose, "{kind}");
        assert_eq!(neutral.beam_secs(1.0, 2.5), 2.5, "{kind}");
        assert_eq!(neutral.odometry(&pose).mean, pose, "{kind}");
        assert!(neutral.objects().is_empty());
    }
}

/// The form without logarithms is the plain one to 1e-12, but for fine steps.
#[test]
fn the_fast_density_is_the_plain_one() {
    let mut compared = 0;
    for resolution_m in [0.0, 0.05] {
        for a in EffectKind::ALL {
            for b in EffectKind::ALL {
                if (a, b) == (EffectKind::WheelSlip, EffectKind::WheelSlip) {
                    continue;
                }
                let effects = effects(&[a, b]);
                for (view, met, range) in beams() {
                    let distribution = effects.reading(&laser(resolution_m), &view, met, range);
                    if distribution.step_m > 0.0 && distribution.step_m <= 0.5 * 5.0 * distribution.sigma {
                        continue;
                    }
                    let limits = distribution.limits();
                    for i in 2..=90 {
                        let z =
                            if i == 90 { distribution.max_m as f32 } else { (f64::from(i) * 0.05) as f32 };
                        let plain = distribution.density(z);
                        let [fast, usable] =
                            distribution.density_parts(limits, f64::from(z)).map(|parts| parts.total());
                        let fast = fast / usable;
                        // Smaller ones are the exponential of a large number.
                        if plain > 1e-150 {
                            assert!((fast - plain).abs() <= 1e-12 * plain, "{a}, {b} at {z}: {fast} {plain}");
                            compared += 1;
                        }
                        let edge = f64::from(z) + 0.5 * distribution.step_m;
                        let below = (distribution.below(limits, edge)[0].total() - (1.0 - usable)) / usable;
                        if i < 90 {
                            let plain = distribution.cdf(z);
                            assert!((below - plain).abs() < 1e-7, "{a}, {b} at {z}: {below} {plain}");
                        }
                    }
                }
            }
        }
    }
    assert!(compared > 50_000, "{compared}");
}

/// At its middle a fine step has less than its probability, by as much as the density bends.
#[test]
fn the_density_of_a_fine_step_errs_by_its_curvature() {
    let (view, met, range) = beams()[0];
    for share in [0.05, 0.2, 0.49] {
        let sigma = 0.02 + 0.002 * range;
        let distribution = Effects::none().reading(&laser(share * sigma), &view, met, range);
        let mut worst = 0.0_f64;
        for k in 0..(4.0 / distribution.step_m) as u32 {
            let z = f64::from(k) * distribution.step_m;
            let t = (z - range) / sigma;
            if t.abs() < 5.0 {
                let plain = distribution.density(z as f32);
                let error = distribution.density_parts(distribution.limits(), z)[0].total() / plain - 1.0;
                let expected = -(t * t - 1.0) / 24.0 * share * share;
                worst = worst.max((error - expected).abs() / (share * share * share * share));
            }
        }
        // The next term is of fourth order, with a coefficient of about t^4 / 1920 + t^4 / 576.
        assert!(worst < 2.0, "{share}: {worst}");
    }
}

/// The forms of the documentation, term by term.
#[test]
fn means_and_deviations_are_those_of_the_formulas() {
    let (view, ..) = beams()[1];
    let distribution = |kind| effects(&[kind]).reading(&laser(0.0), &view, HitKind::Wall, 1.2);
    let tan_squared = 1.2f64.tan().powi(2);
    let sigma = 0.02 + 0.002 * 1.2;
    for (kind, mean, sigma) in [
        (EffectKind::RangeBias, 1.25, sigma),
        (EffectKind::RangeScale, 1.2 * 1.03, sigma),
        (EffectKind::IncidenceBias, 1.2 + 0.02 * tan_squared, sigma),
        (EffectKind::RangeNoise, 1.2, sigma + 0.01 * 1.44),
        (EffectKind::IncidenceNoise, 1.2, sigma * (1.0 + 2.0 * tan_squared)),
        (EffectKind::MovedWall, 1.2 - 0.3 / 1.2f64.cos(), 0.02 + 0.002 * (1.2 - 0.3 / 1.2f64.cos())),
        (EffectKind::WarmupDrift, 1.2 + 0.1 * (-0.2f64).exp(), sigma),
    ] {
        let distribution = distribution(kind);
        assert!(
            (distribution.mean - mean).abs() < 1e-12 && (distribution.sigma - sigma).abs() < 1e-12,
            "{kind}: {distribution:?}"
        );
    }
    let alternative = |kind| distribution(kind).alternatives.as_slice()[0];
    let near = |p: f64, expected: f64| (p - expected).abs() < 1e-12;
    assert!(near(alternative(EffectKind::RangeDropout).0, 0.9 * (1.2f64 / 4.5).powf(0.7)));
    assert!(near(alternative(EffectKind::IncidenceDropout).0, 0.8 / (1.0 + (-3.0f64).exp())));
    assert!(near(alternative(EffectKind::Crosstalk).0, 0.42));
    assert_eq!(alternative(EffectKind::MixedPixels), (0.5, Alternative::Between { lo: 0.6, hi: 1.2 }));
    // A quarter of those that are let through are of clutter.
    let through = distribution(EffectKind::Glass).alternatives;
    let &[(of_clutter, between), (rest, surface)] = through.as_slice() else { panic!("{through:?}") };
    assert_eq!(between, Alternative::Between { lo: 1.2, hi: 4.4 });
    assert_eq!(surface, Alternative::Near { mean: 4.4, sigma: 0.02 + 0.0088 });
    assert!(near(of_clutter, 0.15) && near((1.0 - of_clutter) * rest, 0.45));
    let outside = BeamView { behind: None, ..view };
    let through = effects(&[EffectKind::Glass]).reading(&laser(0.0), &outside, HitKind::Wall, 1.2);
    assert!(near(0.5 * through.alternatives.as_slice()[0].0, 0.3) && near(through.density(4.5), 0.3));
    assert_eq!(
        alternative(EffectKind::SectorOcclusion),
        (0.7, Alternative::Near { mean: 0.4, sigma: 0.0208 })
    );
    // Beyond 80 deg all is as there.
    let grazing = BeamView { incidence: 1.57, ..view };
    let mean = effects(&[EffectKind::IncidenceBias]).reading(&laser(0.0), &grazing, HitKind::Wall, 1.2).mean;
    assert!((mean - 1.2 - 0.02 * 80f64.to_radians().tan().powi(2)).abs() < 1e-9);
}

#[test]
fn effects_of_walls_leave_blocks_alone_and_effects_of_a_place_other_walls() {
    use EffectKind as E;
    let (view, ..) = beams()[1];
    let nominal = |met| Effects::none().reading(&laser(0.0), &view, met, 0.9);
    for kind in
        [E::IncidenceBias, E::IncidenceNoise, E::IncidenceDropout, E::MixedPixels, E::Glass, E::MovedWall]
    {
        let distribution = effects(&[kind]).reading(&laser(0.0), &view, HitKind::Object, 0.9);
        assert_eq!(distribution, nominal(HitKind::Object), "{kind} on a block");
    }
    for kind in [E::MixedPixels, E::Glass, E::MovedWall] {
        let distribution = effects(&[kind]).reading(&laser(0.0), &view, HitKind::Wall, 0.9);
        assert_eq!(distribution, nominal(HitKind::Wall), "{kind} on an object before the wall");
    }
    let elsewhere = BeamView { endpoint: DVec2::new(3.0, 0.11), ..view };
    for kind in [E::Glass, E::MovedWall] {
        let distribution = effects(&[kind]).reading(&laser(0.0), &elsewhere, HitKind::Wall, 1.2);
        assert_eq!(
            distribution,
            Effects::none().reading(&laser(0.0), &elsewhere, HitKind::Wall, 1.2),
            "{kind} elsewhere"
        );
    }
    let ahead = BeamView { bearing: 2.9, ..view };
    assert_eq!(
        effects(&[E::SectorOcclusion]).reading(&laser(0.0), &ahead, HitKind::Wall, 1.2),
        Effects::none().reading(&laser(0.0), &ahead, HitKind::Wall, 1.2),
        "outside the sector"
    );
}

/// A wall of 4 m whose middle is 10 cm to the left and that is turned by 0.05: where a ray from either side meets that wall.
#[test]
fn a_turned_wall_is_met_where_it_stands() {
    let ends = [DVec2::new(1.0, 2.0), DVec2::new(5.0, 2.0)];
    let turned = Effect::new(EffectKind::MovedWall, vec![0.1, 0.05], vec![ends]).unwrap();
    let turned = Effects::new(vec![turned]).unwrap();
    let along = DVec2::from_angle(0.05);
    for (x, slant) in [(1.1, 0.0), (3.0, 0.0), (4.9, 0.0), (1.5, 1.0), (4.5, 1.0), (4.5, -1.0), (2.0, -1.3)] {
        for up in [DVec2::Y, DVec2::NEG_Y] {
            let direction = up.rotate(DVec2::from_angle(-slant));
            let range = 2.0 / direction.y.abs();
            let origin = DVec2::new(x, 2.0) - range * direction;
            let view = BeamView {
                endpoint: DVec2::new(x, 2.0),
                incidence: slant.abs(),
                range,
                direction,
                ..beams()[1].0
            };
            let met = (DVec2::new(3.0, 2.1) - origin).perp_dot(along) / direction.perp_dot(along);
            assert!((turned.wall_range(&view) - met).abs() < 1e-9, "{x} {slant}");
        }
    }
    let beside = BeamView { endpoint: DVec2::new(5.2, 2.0), ..beams()[1].0 };
    assert_eq!(turned.wall_range(&beside), beside.range);
}

#[test]
fn quantized_readings_have_a_density_on_their_grid_alone() {
    let (view, met, range) = beams()[0];
    let distribution = effects(&[EffectKind::Quantization]).reading(&laser(0.0), &view, met, range);
    assert_eq!(distribution.step_m, 0.05);
    assert_eq!(distribution.density(2.01), 0.0);
    assert!(distribution.density(2.0) > distribution.density(2.05) && distribution.density(2.05) > 0.0);
    assert_eq!(distribution.cdf(2.01), distribution.cdf(2.0));
    // The coarsest step counts.
    let fine = effects(&[EffectKind::Quantization]).reading(&laser(0.1), &view, met, range);
    assert_eq!(fine.step_m, 0.1);
}

/// Far from the mean the log density goes on where the density itself has vanished.
#[test]
fn log_densities_do_not_underflow() {
    let (view, met, range) = beams()[0];
    for resolution_m in [0.0, 0.01] {
        let distribution = Effects::none().reading(&laser(resolution_m), &view, met, range);
        let mut last = distribution.log_density(2.0);
        for centimetres in 201..450 {
            let z = (f64::from(centimetres) * 0.01) as f32;
            let ln = distribution.log_density(z);
            assert!(ln < last && ln > -1e5, "{ln} at {z} after {last}");
            let t = (f64::from(z) - 2.0) / distribution.sigma;
            // A cell of half a standard deviation looks like its near edge: t off by a quarter.
            assert!((ln + 0.5 * t * t).abs() < 6.0 + 0.3 * t, "{ln} at {t} standard deviations");
            last = ln;
        }
        assert!(distribution.log_density(4.5) > -1e5 && distribution.log_density(4.5) < -5e3);
    }
}

#[test]
fn the_odometry_reads_what_the_formulas_say() {
    let increment = Pose2::new(-0.3, 0.04, 0.2);
    let mean = |kind| effects(&[kind]).odometry(&increment).mean;
    let near = |a: Pose2, b: Pose2| (a.x - b.x).abs() + (a.y - b.y).abs() + (a.theta - b.theta).abs() < 1e-12;
    assert!(near(mean(EffectKind::OdomDistanceScale), Pose2::new(-0.33, 0.044, 0.2)));
    assert!(near(mean(EffectKind::OdomTurnScale), Pose2::new(-0.3, 0.04, 0.22)));
    let backward = -0.3f64.hypot(0.04);
    assert!(near(mean(EffectKind::OdomImbalance), Pose2::new(-0.3, 0.04, 0.2 + 0.2 * backward)));
}

/// Samples of the share of a slip against its distribution function, where it is above 0; the share of increments that
/// don't slip within 4.9 standard errors.
#[test]
fn slips_agree_with_their_distribution() {
    let distribution = effects(&[EffectKind::WheelSlip]).odometry(&Pose2::new(0.5, 0.0, 0.1));
    let n = 20_000;
    let draw = Draw::new(3, Stage::Effect, 0);
    let mut stretch: Vec<f64> =
        (0..n).map(|i| distribution.sample(&mut draw.item(i)).x / 0.5 - 1.0).filter(|s| *s > 1e-12).collect();
    stretch.sort_unstable_by(f64::total_cmp);
    let slipped = stretch.len() as f64 / f64::from(n);
    assert!((slipped - 0.5).abs() < 4.9 * (0.25 / f64::from(n)).sqrt(), "{slipped}");
    let distance = |slip: Slip| {
        let m = stretch.len() as f64;
        let of_slips = |s: f64| (slip.cdf(s) - slip.cdf(0.0)) / slip.p;
        stretch
            .iter()
            .enumerate()
            .map(|(i, s)| (of_slips(*s) - (i as f64 + 0.5) / m).abs())
            .fold(0.0, f64::max)
    };
    assert!(distance(distribution.slip) < critical_distance(stretch.len()));
    assert!(
        distance(Slip { share: 0.33, ..distribution.slip }) > critical_distance(stretch.len()),
        "blind to 10 %"
    );
    let step = 1e-4;
    let integral: f64 =
        (0..30_000).map(|i| distribution.slip.density((f64::from(i) + 0.5) * step) * step).sum();
    assert!(
        (integral - distribution.slip.p).abs() < 1e-6 && (distribution.slip.cdf(0.0) - 0.5).abs() < 1e-12
    );
}

#[test]
fn jumps_are_those_to_the_neighbour_that_differs_most() {
    let nominal = [1.0, 1.2, 2.0, 1.9, 5.0];
    assert_eq!(jump_at(&nominal, 0, false), None);
    assert_eq!(jump_at(&nominal, 0, true), Some([1.0, 5.0]));
    assert_eq!(jump_at(&nominal, 1, false), Some([1.2, 2.0]));
    assert_eq!(jump_at(&nominal, 2, false), Some([1.2, 2.0]));
    assert_eq!(jump_at(&nominal, 3, false), Some([1.9, 5.0]));
    assert_eq!(jump_at(&[1.0], 0, true), None);
}

proptest! {
    #[test]
    fn beams_are_shifted_in_time_by_their_bearing(bearing in -3.1..3.1f64, secs in 0.0..9.0f64) {
        let shifted = effects(&[EffectKind::TimeOffset, EffectKind::MotionSkew]).beam_secs(bearing, secs);
        prop_assert!((shifted - (secs + 0.1 + 0.2 * bearing / TAU)).abs() < 1e-12);
    }
}

/// Both ends belong to a sector, also where it reaches over the back or all around, and pi as f32 is pi.
#[test]
fn sectors_hold_their_ends() {
    let (view, ..) = beams()[0];
    let is_in = |bearing: f32, from: f64, to: f64| {
        let sector = Effect::new(EffectKind::SectorOcclusion, vec![from, to, 0.4, 0.7], vec![]).unwrap();
        let view = BeamView { bearing: f64::from(bearing), ..view };
        let distribution =
            Effects::new(vec![sector]).unwrap().reading(&laser(0.0), &view, HitKind::Wall, 2.0);
        !distribution.alternatives.as_slice().is_empty()
    };
    let pi = std::f32::consts::PI;
    assert!(
        is_in(pi, 3.0, -3.0) && is_in(3.0, 3.0, -3.0) && is_in(-3.0, 3.0, -3.0) && !is_in(0.0, 3.0, -3.0)
    );
    assert!(is_in(pi, 3.0, f64::from(pi).min(std::f64::consts::PI)) && !is_in(-3.0, 3.0, 3.1));
    assert!([-pi + 1e-3, 0.0, pi].into_iter().all(|b| is_in(b, -std::f64::consts::PI, std::f64::consts::PI)));
    assert!(is_in(0.1, 0.1, 0.1) && !is_in(0.2, 0.1, 0.1));
}

/// A laser turned by half a degree more is beyond what a reference errs by; one displaced by 3 cm more is not.
#[test]
fn what_a_reference_may_err_by_is_no_other_effect() {
    let error = PoseError { sigma_m: 0.025, sigma_rad: 0.0024, correlation_secs: 2.0, ..PoseError::NONE };
    let of = |kind, values: &[f64]| Effect::new(kind, values.to_vec(), Vec::new()).unwrap();
    let [turned, slightly, more] = [0.0122, 0.018, 0.022].map(|yaw_rad| of(EffectKind::MountYaw, &[yaw_rad]));
    assert!(more.is_beyond(&turned, &error) && !slightly.is_beyond(&turned, &error));
    let [near, behind, far] = [-0.042, -0.075, -0.15].map(|x_m| of(EffectKind::MountOffset, &[x_m, 0.0]));
    assert!(!behind.is_beyond(&near, &error) && far.is_beyond(&near, &error));
    let [late, later] = [0.1, 0.5].map(|secs| of(EffectKind::TimeOffset, &[secs]));
    assert!(!later.is_beyond(&late, &error));
}

#[test]
fn a_sentence_says_to_which_side() {
    let bias = |bias_m| Effect::new(EffectKind::RangeBias, vec![bias_m], Vec::new()).unwrap().sentence();
    assert!(bias(0.02).contains("too long") && !bias(0.02).contains("too short"));
    assert!(bias(-0.02).contains("too short") && !bias(-0.02).contains("too long"));
    let fewer = Effect::new(EffectKind::BlockDensity, vec![0.5], Vec::new()).unwrap();
    assert!(fewer.sentence().contains("fewer"));
}

#[test]
fn the_catalogue_is_complete() {
    for (i, kind) in EffectKind::ALL.into_iter().enumerate() {
        assert_eq!(kind as usize, i);
        assert_eq!(kind.name().parse::<EffectKind>(), Ok(kind));
        assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
        assert!(!kind.confused_with().is_empty() && !kind.confused_with().contains(&kind), "{kind}");
        for text in [kind.formula(), kind.sentence(), kind.signature()] {
            assert!(text.len() > 4, "{kind}");
        }
        assert!(kind.strengths().next().is_some() && !kind.description().statistics.is_empty(), "{kind}");
        let has_sides = !kind.is_one_sided() && kind.strengths().count() == 1;
        assert_eq!(kind.description().sides.is_some(), has_sides, "{kind}");
        for other in kind.confused_with() {
            assert!(kind.confused_with().iter().filter(|again| *again == other).count() == 1, "{kind}");
        }
        for parameter in kind.parameters() {
            assert_eq!(
                parameter.unit.starts_with("rad"),
                parameter.key != parameter.name,
                "{kind}: {parameter:?}"
            );
            for value in [parameter.neutral, parameter.start] {
                assert!((parameter.lo..=parameter.hi).contains(&value), "{kind}: {parameter:?}");
            }
        }
    }
    let error = "glas".parse::<EffectKind>().unwrap_err().to_string();
    assert!(error.starts_with("\"glas\" is not an effect; one of range_bias, range_scale,"), "{error}");
}

/// Losses that hardly grow with range aren't said to be of far surfaces.
#[test]
fn a_sentence_says_what_the_values_do() {
    let sentence = |exponent: f64| {
        Effect::new(EffectKind::RangeDropout, vec![0.1, exponent], Vec::new()).unwrap().sentence()
    };
    assert!(sentence(0.2).contains("near and far alike") && sentence(2.0).contains("Far surfaces"));
    let bursts = |share| Effect::new(EffectKind::Crosstalk, vec![0.1, share], Vec::new()).unwrap().bursts();
    assert!(bursts(0.2).unwrap().are_seldom() && !bursts(0.4).unwrap().are_seldom());
}

/// Blocks that are flattened by all that an effect can, twice over, are blocks still.
#[test]
fn blocks_stay_as_thick_as_any_can_be() {
    let flat = Effect::new(EffectKind::BlockDepth, vec![0.01], Vec::new()).unwrap();
    let effects = Effects::new(vec![flat.clone(), flat]).unwrap();
    let blocks = effects.blocks(crate::simulation::fixtures::block_options());
    assert!(blocks.width_m.iter().all(|width| *width >= FINEST_M), "{:?}", blocks.width_m);
}

/// A log's beams are cast anew for an effect that changes where they start or what they can meet, and for no other.
#[test]
fn views_change_where_an_effect_says_so() {
    let pose = Pose2::new(0.3, -0.2, 1.0);
    let blocks = crate::simulation::fixtures::block_options();
    for kind in EffectKind::ALL {
        let effects = effects(&[kind]);
        let is_changed = effects.laser_mount(pose) != pose
            || effects.beam_secs(1.0, 2.5) != 2.5
            || effects.blocks(blocks) != blocks
            || !effects.objects().is_empty()
            || effects.needs() != Needs::default();
        assert_eq!(kind.changes_views(), is_changed, "{kind}");
        let increment = Pose2::new(0.3, 0.04, 0.2);
        let is_of_odometry = effects.odometry(&increment) != Effects::none().odometry(&increment);
        assert_eq!(kind.moves() == Moves::Odometry, is_of_odometry, "{kind}");
        assert_eq!(kind.moves() == Moves::Clutter, effects.blocks(blocks) != blocks, "{kind}");
    }
}

/// The true motion is recovered from the odometry, where no wheel slips.
#[test]
fn errors_of_the_odometry_are_corrected() {
    let errors =
        effects(&[EffectKind::OdomDistanceScale, EffectKind::OdomTurnScale, EffectKind::OdomImbalance])
            .odometry_errors();
    for motion in [Pose2::new(0.2, 0.01, 0.1), Pose2::new(-0.1, 0.0, -0.4), Pose2::new(0.0, 0.0, 0.3)] {
        let read = errors.distribution(&motion).mean;
        let back = errors.corrected(&read);
        let off = (back.x - motion.x).abs() + (back.y - motion.y).abs() + (back.theta - motion.theta).abs();
        assert!(off < 1e-12 && read != motion, "{motion:?} {back:?}");
    }
}

#[test]
fn effects_out_of_range_are_refused() {
    let new = |kind, values: &[f64], place: &[[DVec2; 2]]| Effect::new(kind, values.to_vec(), place.to_vec());
    let point = [DVec2::ZERO; 2];
    for (effect, message) in [
        (new(EffectKind::Glass, &[], &[STRETCH]), "glass needs 2 values; got 0"),
        (new(EffectKind::Glass, &[1.5, 0.0], &[STRETCH]), "p of glass must be from 0 to 1; got 1.5"),
        (new(EffectKind::RangeBias, &[f64::NAN], &[]), "bias_m of range_bias must be from -1 to 1; got NaN"),
        (new(EffectKind::Glass, &[0.5, 0.0], &[]), "glass needs a place: at least one stretch of wall"),
        (new(EffectKind::HeavyTail, &[0.5], &[STRETCH]), "heavy_tail has no place"),
        (
            new(EffectKind::Glass, &[0.5, 0.0], &[STRETCH, point]),
            "stretch 1 of the place of glass needs two finite",
        ),
    ] {
        let error = effect.unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    let many = |kind, n| Effects::new(vec![strong(kind); n]).map_err(|error| error.to_string());
    assert_eq!(many(EffectKind::WheelSlip, 2).unwrap_err(), "wheel_slip can be there once only");
    assert!(many(EffectKind::Glass, 6).is_ok() && many(EffectKind::MixedPixels, 12).is_ok());
    // Each pane has a surface behind it, and clutter before that.
    for (kind, n, count) in [(EffectKind::Glass, 7, 14), (EffectKind::MixedPixels, 13, 13)] {
        assert_eq!(
            many(kind, n).unwrap_err(),
            format!("{count} replacements of readings by effects are more than the 12 that are allowed")
        );
    }
}
