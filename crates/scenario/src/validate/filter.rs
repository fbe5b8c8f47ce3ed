use locsim_core::Pose2;
use locsim_mcl::{
    AnnealingOptions, InjectionOptions, KldOptions, ParticleCount, ResampleTrigger, Spread, UpdateThreshold,
};

use locsim_core::limits::MOST_PARTICLES;

use super::beams;
use crate::check::Allowed::{AboveUpTo, Between, FromBelow, Within};
use crate::check::{ANGLE, COORDINATE, Checker, LENGTH, NOISE, POSITIVE_LENGTH, number};
use crate::form::Form;
use crate::key_path::join;
use crate::raw::{
    Count, EachScan, MotionModelName, No, NotAnnealed, RawAdaptive, RawAnnealing, RawAround, RawFilter,
    RawInjection, RawKld, RawLaser, RawMotion, RawResample, RawSpread, RawStart, RawUpdate,
};
use crate::{Filter, Motion, Start};

/// Least effective share of a filter on a log. A log's map and odometry err in ways that no motion noise has, and a scan after such an
/// error leaves few of 2,000 particles.
const LEAST_EFFECTIVE: f64 = 0.02;
/// Random walk of the position beside motion noise that is fitted to a log's odometry (m, after a metre): about what maps and references of
/// logs differ by from place to place.
const RANDOM_WALK_M: f64 = 0.04;
/// How far a robot moves between two scans of a log that are taken in: less than between two of most logs, and more than an odometry
/// jitters by.
const STANDING: RawUpdate = RawUpdate { distance_m: 0.02, angle_deg: 1.0 };

pub(super) fn filter(
    check: &mut Checker<'_>,
    raw: &RawFilter,
    laser: Option<&RawLaser>,
    has_log: bool,
) -> Filter {
    let laser_beams = laser.and_then(|laser| u32::try_from(laser.beams).ok());
    Filter {
        particles: match &raw.particles {
            Form::Short(Count(count)) => {
                ParticleCount::Fixed(check.count("filter.particles", *count, 1, MOST_PARTICLES) as usize)
            }
            Form::Full(RawAdaptive { kld }) => adaptive(check, kld),
        },
        motion: motion(check, &raw.motion, has_log),
        calibrate: {
            check.refuse(!has_log && raw.motion.calibrate == Some(true), "filter.motion.calibrate", || {
                "true is not allowed; only the odometry of a `log` can be calibrated".to_owned()
            });
            has_log && raw.motion.calibrate.unwrap_or(raw.motion.alpha.is_none())
        },
        random_walk_m: {
            let fitted = if raw.motion.alpha.is_none() { RANDOM_WALK_M } else { 0.0 };
            check.number("filter.motion.random_walk_m", raw.motion.random_walk_m.unwrap_or(fitted), LENGTH)
        },
        resampler: raw.resampler,
        resample: match raw.resample {
            RawResample::EachStep => ResampleTrigger::EachStep,
            RawResample::EffectiveShareBelow(share) => ResampleTrigger::EffectiveShareBelow(check.number(
                "filter.resample.effective_share_below",
                share,
                AboveUpTo(0.0, 1.0),
            )),
        },
        injection: match raw.injection {
            Form::Short(No::None) => None,
            Form::Full(raw) => Some(injection(check, raw)),
        },
        start: match raw.start {
            RawStart::Global => Start::Global,
            RawStart::Tracking(spread) => {
                Start::Tracking(self::spread(check, "filter.start.tracking", spread))
            }
            RawStart::Around(RawAround { x_m, y_m, heading_deg, sigma_m, sigma_deg }) => {
                let key = "filter.start.around";
                let pose = Pose2::new(
                    check.number(&join(key, "x_m"), x_m, COORDINATE),
                    check.number(&join(key, "y_m"), y_m, COORDINATE),
                    check.degrees(&join(key, "heading_deg"), heading_deg, ANGLE),
                );
                Start::Around(pose, self::spread(check, key, RawSpread { sigma_m, sigma_deg }))
            }
        },
        beams: beams(check, "filter.beams", raw.beams, laser_beams),
        update: match (&raw.update, has_log) {
            (Some(Form::Short(EachScan::EachScan)), _) | (None, false) => None,
            (Some(Form::Full(raw)), _) => Some(update(check, *raw)),
            (None, true) => Some(update(check, STANDING)),
        },
        estimate: raw.estimate,
        regularization: spread(check, "filter.regularization", raw.regularization),
        least_effective_share: {
            let share = raw.least_effective_share.unwrap_or(if has_log { LEAST_EFFECTIVE } else { 0.0 });
            let share = check.number("filter.least_effective_share", share, FromBelow(0.0, 1.0));
            (share > 0.0).then_some(share)
        },
        annealing: match raw.annealing {
            Form::Short(NotAnnealed::None) => None,
            Form::Full(raw) => Some(annealing(check, raw)),
        },
    }
}

fn update(check: &mut Checker<'_>, raw: RawUpdate) -> UpdateThreshold {
    UpdateThreshold {
        distance_m: check.number("filter.update.distance_m", raw.distance_m, LENGTH),
        angle_rad: check.degrees("filter.update.angle_deg", raw.angle_deg, Within(0.0, 180.0)),
    }
}

fn adaptive(check: &mut Checker<'_>, raw: &RawKld) -> ParticleCount {
    let key = |key| join("filter.particles.kld", key);
    let min = check.count(&key("min"), raw.min, 1, MOST_PARTICLES);
    let max = check.count(&key("max"), raw.max, 1, MOST_PARTICLES);
    check.refuse(min > max, &key("max"), || format!("{max} is not allowed; not below `min`, which is {min}"));
    ParticleCount::Kld(KldOptions {
        min: min as usize,
        max: max as usize,
        error: check.number(&key("error"), raw.error, Within(1e-6, 1e3)),
        quantile: check.number(&key("quantile"), raw.quantile, FromBelow(0.5, 1.0)),
        bin_m: check.number(&key("bin_m"), raw.bin_m, POSITIVE_LENGTH),
        bin_rad: check.degrees(&key("bin_deg"), raw.bin_deg, Within(1e-3, 360.0)),
    })
}

fn motion(check: &mut Checker<'_>, raw: &RawMotion, has_log: bool) -> Motion {
    let key = "filter.motion.alpha";
    let Some(given) = &raw.alpha else {
        let is_odometry = raw.model == MotionModelName::Odometry;
        check.refuse(!(is_odometry && has_log), key, || {
            "the key is missing; only the noise of `odometry` may be left out, on a `log`, to which it is then fitted".to_owned()
        });
        return Motion::Odometry(None);
    };
    check.numbers(key, given, NOISE);
    let wanted = match raw.model {
        MotionModelName::Odometry => 4,
        MotionModelName::Velocity => 6,
    };
    check.refuse(given.len() != wanted, key, || {
        format!("a list of length {} is not allowed; this motion model has {wanted} parameters", given.len())
    });
    let alpha = |i: usize| given.get(i).copied().unwrap_or_default();
    match raw.model {
        MotionModelName::Odometry => Motion::Odometry(Some(std::array::from_fn(alpha))),
        MotionModelName::Velocity => Motion::Velocity(std::array::from_fn(alpha)),
    }
}

fn injection(check: &mut Checker<'_>, raw: RawInjection) -> InjectionOptions {
    let [slow, fast] = [raw.alpha_slow, raw.alpha_fast];
    let alpha_slow = check.number("filter.injection.alpha_slow", slow, AboveUpTo(0.0, 1.0));
    let alpha_fast = check.number("filter.injection.alpha_fast", fast, AboveUpTo(0.0, 1.0));
    check.refuse(slow >= fast, "filter.injection.alpha_slow", || {
        let [slow, fast] = [slow, fast].map(number);
        format!("{slow} is not allowed; below `alpha_fast`, which is {fast}")
    });
    InjectionOptions { alpha_slow, alpha_fast }
}

fn annealing(check: &mut Checker<'_>, raw: RawAnnealing) -> AnnealingOptions {
    let key = |key| join("filter.annealing", key);
    let share = check.number(&key("effective_share"), raw.effective_share, Between(0.0, 1.0));
    AnnealingOptions {
        candidates: check.count(&key("candidates"), raw.candidates, 1, MOST_PARTICLES) as usize,
        effective_share: share,
        moves: check.count(&key("moves"), raw.moves, 1, 1000) as usize,
        step: spread(check, "filter.annealing", RawSpread { sigma_m: raw.sigma_m, sigma_deg: raw.sigma_deg }),
        gathered_m: check.number(&key("gathered_m"), raw.gathered_m, Within(0.0, 1e6)),
    }
}

fn spread(check: &mut Checker<'_>, key: &str, raw: RawSpread) -> Spread {
    Spread {
        sigma_m: check.number(&join(key, "sigma_m"), raw.sigma_m, NOISE),
        sigma_rad: check.degrees(&join(key, "sigma_deg"), raw.sigma_deg, NOISE),
    }
}
