//! AMCL's filter: nav2's defaults, but for the parameters that are searched.

use std::sync::Arc;

use locsim_core::{Drive, DriveStep, Pose2, SensorModel, wrap_angle};
use locsim_dataset::OdometryError;
use locsim_mcl::{
    Filter, FilterOptions, KldOptions, Multinomial, OdometryMotion, ParticleCount, PoseBins, ResampleTrigger,
    Spread, Start, StepInput,
};
use locsim_sensor::{Amcl, AmclKind, AmclParameters};

use locsim_lab::LabError;
use locsim_lab::run::MapSet;

/// AMCL updates after this motion: along x or y of the odometry \[m\], or a turn \[rad\].
pub(super) const UPDATE_MIN_D: f64 = 0.25;
pub(super) const UPDATE_MIN_A: f64 = 0.2;
/// Least and greatest number of particles, `pf_err` and `pf_z`.
pub(super) const PARTICLES: [usize; 2] = [500, 2000];
pub(super) const PF_ERR: f64 = 0.05;
pub(super) const PF_Z: f64 = 0.99;
/// `pf_z` is a quantile of the normal distribution; this is its probability.
const PF_QUANTILE: f64 = 0.838_913;
/// Cells of AMCL's histogram \[m\] and \[rad\].
const CELL: (f64, f64) = (0.5, 10.0 * std::f64::consts::PI / 180.0);
/// nav2's default of each alpha.
pub(super) const USUAL_ALPHA: f64 = 0.2;

/// The parameters that are searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Settings {
    /// The laser model.
    pub laser: AmclParameters,
    /// `alpha1` to `alpha4`.
    pub alpha: [f64; 4],
}

impl Settings {
    /// nav2's defaults.
    pub const DEFAULTS: Self =
        Self { laser: AmclParameters::defaults(AmclKind::AmclLikelihoodField), alpha: [USUAL_ALPHA; 4] };
}

/// The scans of a drive that AMCL takes in: the first, and each at which the odometry is far enough from the one before.
pub(super) fn updates(drive: &Drive) -> Drive {
    let mut last: Option<Pose2> = None;
    let mut steps = Vec::new();
    for step in &drive.steps {
        let now = step.odometry;
        let is_due = last.is_none_or(|last| {
            (now.x - last.x).abs() > UPDATE_MIN_D
                || (now.y - last.y).abs() > UPDATE_MIN_D
                || wrap_angle(now.theta - last.theta).abs() > UPDATE_MIN_A
        });
        if is_due {
            steps.push(step.clone());
            last = Some(now);
        }
    }
    Drive { laser: drive.laser.clone(), steps }
}

/// The noise of the odometry between AMCL's updates, alpha 1 to 4, and the number of windows that it is estimated from; `None`
/// with too few of them. Drives that are too short by themselves are taken end to end.
pub(super) fn odometry_noise(drives: &[Drive]) -> Option<([f64; 4], usize)> {
    let mut errors: Vec<OdometryError> = drives.iter().filter_map(OdometryError::of).collect();
    if errors.is_empty() {
        errors.extend(end_to_end(drives).as_ref().and_then(OdometryError::of));
    }
    let windows: usize = errors.iter().map(|error| error.windows).sum();
    let mean = |i: usize| {
        errors.iter().map(|error| error.alpha[i] * error.windows as f64).sum::<f64>() / windows as f64
    };
    (windows > 0).then(|| (std::array::from_fn(mean), windows))
}

/// The drives as one, each from where the one before ended; `None` where its first or last reference pose isn't known.
fn end_to_end(drives: &[Drive]) -> Option<Drive> {
    let (first, others) = drives.split_first()?;
    let mut all = first.clone();
    for drive in others {
        let (begin, end) = (drive.steps.first()?, all.steps.last()?);
        let (begin_reference, end_reference) = (begin.reference?, end.reference?);
        let odometry = end.odometry;
        all.steps.extend(drive.steps.iter().map(|step| DriveStep {
            odometry: odometry.compose(&step.odometry.relative_to(&begin.odometry)),
            reference: step.reference.map(|pose| end_reference.compose(&pose.relative_to(&begin_reference))),
            ..step.clone()
        }));
    }
    Some(all)
}

/// The errors of one localization.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Errors {
    /// Number of updates.
    pub steps: usize,
    /// Sums of squares of position \[m^2\] and heading \[rad^2\].
    pub squares: [f64; 2],
    /// Whether the robot was lost, as in a run.
    pub is_lost: bool,
}

impl Errors {
    /// Root mean square of the position error \[m\].
    pub fn position_m(&self) -> f64 {
        (self.squares[0] / self.steps as f64).sqrt()
    }
}

/// AMCL on a map.
pub(super) struct Localizer {
    pub maps: MapSet,
    /// Spread of the start about the true pose.
    pub start: Spread,
    /// Position errors beyond this are those of a lost robot \[m\].
    pub lost_m: f64,
}

impl Localizer {
    /// Localizes on a drive of AMCL's updates, each with a reference pose. Gives up at a position error above `most_m` \[m\], after
    /// which only `is_lost` has a meaning.
    ///
    /// # Errors
    /// [`LabError`] for parameters that a filter doesn't take.
    pub fn errors(
        &self,
        settings: &Settings,
        drive: &Drive,
        seed: u64,
        most_m: f64,
    ) -> Result<Errors, LabError> {
        let failed = |source| LabError::TrainingData { source };
        // Only the beams that AMCL takes, so that no others are cast.
        let stride = settings.laser.stride(drive.laser.beam_count());
        let drive = drive.with_every_beam(stride);
        let laser = AmclParameters { max_beams: drive.laser.beam_count().max(2), ..settings.laser };
        let model = Amcl::new(laser, Arc::clone(&self.maps.distance)).map_err(failed)?;
        let truth: Vec<Pose2> = drive.steps.iter().filter_map(|step| step.reference).collect();
        let start = Start::Tracking { pose: truth[0], spread: self.start };
        let map = &*self.maps.ranges;
        let mut filter = Filter::new(options(settings)?, &start, map, seed)?;
        let mut errors = Errors { steps: truth.len(), squares: [0.0; 2], is_lost: false };
        let mut off = 0;
        for (i, (step, truth)) in drive.steps.iter().zip(&truth).enumerate() {
            let odometry = drive.odometry_increment(i);
            let input = StepInput { odometry, laser: &drive.laser, scan: &step.scan };
            let estimates = filter.step(&input, map, &model as &dyn SensorModel)?.estimates;
            let pose = estimates
                .densest_cluster
                .map_or(estimates.weighted_mean.pose, |cluster| cluster.estimate.pose);
            let position = pose.position().distance(truth.position());
            errors.squares[0] += position * position;
            errors.squares[1] += wrap_angle(pose.theta - truth.theta).powi(2);
            // At the end, or in more than half of the steps.
            let is_off = position > self.lost_m;
            off += usize::from(is_off);
            errors.is_lost = is_off || 2 * off > errors.steps;
            if position > most_m {
                break;
            }
        }
        Ok(errors)
    }
}

/// AMCL's filter: KLD sampling, independent draws of ancestors after each update, no recovery.
fn options(settings: &Settings) -> Result<FilterOptions, LabError> {
    let [min, max] = PARTICLES;
    let (bin_m, bin_rad) = CELL;
    let kld = KldOptions { min, max, error: PF_ERR, quantile: PF_QUANTILE, bin_m, bin_rad };
    Ok(FilterOptions {
        particles: ParticleCount::Kld(kld),
        motion: Arc::new(OdometryMotion::new(settings.alpha)?),
        resampler: Arc::new(Multinomial),
        trigger: ResampleTrigger::EachStep,
        injection: None,
        regularization: None,
        update: None,
        least_effective_share: None,
        clusters: Some(PoseBins::new(bin_m, bin_rad)?),
        annealing: None,
        ancestry: false,
    })
}

#[cfg(test)]
mod tests {
    use locsim_core::{Laser, Scan};

    use super::*;

    /// A drive of `metres` in steps of a quarter of a metre, whose odometry says 10 % more.
    fn straight(metres: f64) -> Drive {
        let steps = (0..=(4.0 * metres) as u32).map(|i| {
            let x = 0.25 * f64::from(i);
            DriveStep {
                stamp_secs: f64::from(i),
                odometry: Pose2::new(1.1 * x, 0.0, 0.0),
                reference: Some(Pose2::new(3.0, 2.0 + x, std::f64::consts::FRAC_PI_2)),
                scan: Scan { ranges: vec![1.0] },
            }
        });
        let laser = Laser::new(vec![0.0], vec![0.0], 0.0, 10.0, Pose2::IDENTITY).unwrap();
        Drive { laser, steps: steps.collect() }
    }

    /// Six drives of 2 m tell the noise as one of 12 m does, one alone is too short.
    #[test]
    fn short_drives_tell_the_odometrys_noise_end_to_end() {
        assert_eq!(odometry_noise(&[straight(2.0)]), None);
        let short: [Drive; 6] = std::array::from_fn(|_| straight(2.0));
        let ([_, _, distance, _], windows) = odometry_noise(&short).unwrap();
        let ([_, _, expected, _], expected_windows) = odometry_noise(&[straight(12.0)]).unwrap();
        assert_eq!(windows, expected_windows);
        assert!((distance / expected - 1.0).abs() < 1e-9, "{distance} {expected}");
    }

    /// AMCL compares along x and y, each alone: 0.24 m along both is 0.34 m, and no update.
    #[test]
    fn amcl_updates_after_its_least_motion() {
        let poses = [
            (0.0, 0.0, 0.0),
            (0.24, 0.24, 0.0),
            (0.26, 0.24, 0.0),
            (0.26, 0.24, 0.19),
            (0.26, 0.24, 0.21),
            (0.26, 0.0, 0.21),
            (0.26, -0.02, 0.21),
            (0.26, -0.02, 0.41),
        ];
        let steps = poses.iter().map(|&(x, y, theta)| DriveStep {
            stamp_secs: 0.0,
            odometry: Pose2::new(x, y, theta),
            reference: None,
            scan: Scan { ranges: vec![1.0] },
        });
        let laser = Laser::new(vec![0.0], vec![0.0], 0.0, 10.0, Pose2::IDENTITY).unwrap();
        let cut = updates(&Drive { laser, steps: steps.collect() });
        let kept: Vec<(f64, f64, f64)> =
            cut.steps.iter().map(|step| (step.odometry.x, step.odometry.y, step.odometry.theta)).collect();
        assert_eq!(kept, [poses[0], poses[2], poses[4], poses[6]]);
    }
}
