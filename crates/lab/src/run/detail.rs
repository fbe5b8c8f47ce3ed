//! Keeps one trial in full, for pictures and recordings.

use locsim_core::{Beams, Drive, Hits, Laser, Particles, Pose2, RangeMap, Scan, SensorModel};
use locsim_mcl::{Filter, StepOutcome, Trajectory};

use super::training::TrainedModel;
use locsim_report::results::{BeamProbe, DetailedModel, DetailedStep};

/// Particles kept per step at the most; of more, evenly spaced ones are. In all steps of all models there are at most so many, of 32 bytes,
/// but for [`FEWEST`] per step.
const PARTICLES: usize = 1000;
const ALL_PARTICLES: usize = 8_000_000;
const FEWEST: usize = 30;

/// Ranges at which a probed beam's density is sampled.
const PROBE_POINTS: usize = 450;

/// Which beam of each step is shown in full, and from which pose: the same for every model.
#[derive(Clone, Copy, Debug)]
pub(super) struct Probe {
    beam: usize,
    pose: Pose2,
}

/// Collects the steps of one model.
pub(super) struct Detail<'a> {
    map: &'a dyn RangeMap,
    drive: &'a Drive,
    /// Chosen by the first model's filter, `None` while that runs.
    probes: Option<Vec<Probe>>,
    own_probes: Vec<Probe>,
    /// Particles that are kept of a step.
    particles: usize,
    model: DetailedModel,
}

impl<'a> Detail<'a> {
    /// Starts collecting for `model`, one of `models`; `probes` are what an earlier model's [`Detail::into_model`] returned.
    pub fn new(
        map: &'a dyn RangeMap,
        drive: &'a Drive,
        model: &str,
        models: usize,
        probes: Option<Vec<Probe>>,
    ) -> Self {
        let steps = (drive.steps.len() * models).max(1);
        let particles = (ALL_PARTICLES / steps).clamp(FEWEST, PARTICLES);
        let model =
            DetailedModel { name: model.to_owned(), steps: Vec::new(), most_likely_trajectory: Vec::new() };
        Self { map, drive, probes, own_probes: Vec::new(), particles, model }
    }

    /// Takes one step in.
    pub fn push(
        &mut self,
        filter: &Filter,
        outcome: &StepOutcome,
        model: &TrainedModel,
        truth: Pose2,
        scan: &Scan,
        events: Vec<String>,
    ) {
        let (laser, step) = (&self.drive.laser, self.model.steps.len());
        let mut log_density = vec![0.0; laser.beam_count()];
        let mut hits = Hits::default();
        let laser_pose: Particles = std::iter::once(truth.compose(&laser.base_from_laser())).collect();
        let beams = cast_scan(self.map, laser, &laser_pose, &mut hits);
        model.bare.log_density(&scan.ranges, &beams, &mut log_density);
        let probe = match &self.probes {
            Some(probes) => probes[step],
            None => Probe {
                beam: most_shortened(beams.range, scan, laser),
                pose: nearest(filter.particles(), truth),
            },
        };
        self.own_probes.push(probe);
        let stride = filter.particles().len().div_ceil(self.particles);
        let mean = &outcome.estimates.weighted_mean;
        let covariance = &mean.covariance;
        self.model.steps.push(DetailedStep {
            particles: filter.particles().iter().step_by(stride).collect(),
            weights: filter.weights().linear().iter().step_by(stride).copied().collect(),
            estimate: mean.pose,
            position_covariance: [[covariance[0][0], covariance[0][1]], [covariance[1][0], covariance[1][1]]],
            beam_log_density: log_density,
            effective_sample_size: outcome.effective_sample_size,
            log_evidence_nats: outcome.log_evidence,
            events,
            probe: self.probe(probe, &*model.bare, scan),
        });
    }

    /// Takes the path through the whole drive.
    pub fn finish(&mut self, trajectory: &Trajectory) {
        self.model.most_likely_trajectory.clone_from(&trajectory.poses);
    }

    /// The collected details, and the probes for the next model.
    pub fn into_model(self) -> (DetailedModel, Vec<Probe>) {
        (self.model, self.own_probes)
    }

    /// The density that `model` predicts for one beam.
    fn probe(&self, probe: Probe, model: &dyn SensorModel, scan: &Scan) -> BeamProbe {
        let laser = &self.drive.laser;
        let max_range = laser.max_range();
        let laser_pose: Particles = std::iter::once(probe.pose.compose(&laser.base_from_laser())).collect();
        let mut nominal = Hits::default();
        let bearing = &laser.bearings()[probe.beam..=probe.beam];
        self.map.cast(laser_pose.as_poses(), bearing, laser.cast_range(), &mut nominal);

        // One pose whose beams all point the same way: a density over z in one call.
        let mut z: Vec<f32> = (0..PROBE_POINTS)
            .map(|i| (i as f32 + 0.5) * max_range / PROBE_POINTS as f32)
            .chain([max_range])
            .collect();
        let bearings = vec![laser.bearings()[probe.beam]; z.len()];
        let hits = Hits {
            range: vec![nominal.range[0]; z.len()],
            incidence: vec![nominal.incidence[0]; z.len()],
            surface: vec![nominal.surface[0]; z.len()],
        };
        let mut density = vec![0.0; z.len()];
        model.log_density(&z, &hits.beams(laser_pose.as_poses(), &bearings, max_range), &mut density);
        for l in &mut density {
            *l = l.exp();
        }
        z.pop();
        let max_range_probability = density.pop().unwrap_or(0.0);
        BeamProbe {
            beam: probe.beam,
            pose: probe.pose,
            nominal_m: nominal.range[0].min(max_range),
            reading_m: scan.ranges[probe.beam],
            z_m: z,
            density_per_m: density,
            max_range_probability,
        }
    }
}

/// The beam whose reading falls shortest of its nominal range; no-return readings and open beams don't count.
fn most_shortened(nominal: &[f32], scan: &Scan, laser: &Laser) -> usize {
    let shortening = |beam: usize| {
        let (z, r) = (scan.ranges[beam], nominal[beam]);
        let usable = z < laser.max_range() && r < laser.max_range();
        if usable { r - z } else { f32::NEG_INFINITY }
    };
    (0..nominal.len())
        .reduce(|best, beam| if shortening(beam) > shortening(best) { beam } else { best })
        .unwrap_or(0)
}

/// The particle nearest to the truth in position.
fn nearest(particles: &Particles, truth: Pose2) -> Pose2 {
    let distance = |pose: &Pose2| pose.position().distance_squared(truth.position());
    particles.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(truth)
}

/// The beams of one pose, cast into the map.
fn cast_scan<'a>(
    map: &dyn RangeMap,
    laser: &'a Laser,
    laser_pose: &'a Particles,
    hits: &'a mut Hits,
) -> Beams<'a> {
    map.cast(laser_pose.as_poses(), laser.bearings(), laser.cast_range(), hits);
    hits.beams(laser_pose.as_poses(), laser.bearings(), laser.max_range())
}
