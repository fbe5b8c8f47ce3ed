//! Training data: states of the sensor, each with one or more readings.

use std::collections::BTreeSet;

use locsim_core::{Beams, CAST_REACH, Draw, Pose2, Stage};
use rand::RngExt;

use crate::SensorError;
use crate::beam::Beam;

/// The state x of one beam, on which its reading's density is conditioned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamState {
    /// `map_from_laser`.
    pub laser: Pose2,
    /// Bearing of the beam in the laser frame \[rad\].
    pub bearing: f32,
    /// Nominal range r \[m\], at most [`locsim_core::CAST_REACH`] times the maximum range; no less than the maximum
    /// range where the map has nothing that the sensor could see.
    pub range: f32,
    /// Incidence angle alpha \[rad\], 0 to pi/2.
    pub incidence: f32,
    /// Surface id, [`locsim_core::NO_SURFACE`] without one.
    pub surface: u32,
    /// Which scan pose the beam belongs to; beams of one scan are never parted by [`TrainingSet::split`].
    pub scan: u32,
}

/// D = {(`x_i`, `z_ij`)}: N beam states with one or more readings each, in a structure of arrays.
#[derive(Clone, Debug)]
pub struct TrainingSet {
    max_range: f32,
    states: Vec<BeamState>,
    /// Readings of state i are `readings[ends[i - 1]..ends[i]]`.
    ends: Vec<usize>,
    readings: Vec<f32>,
}

impl TrainingSet {
    /// An empty set for a sensor of this maximum range \[m\].
    ///
    /// # Errors
    /// [`SensorError::MaxRange`] unless it is positive and finite.
    pub fn new(max_range: f32) -> Result<Self, SensorError> {
        if !(max_range > 0.0 && max_range.is_finite()) {
            return Err(SensorError::MaxRange(max_range));
        }
        Ok(Self { max_range, states: Vec::new(), ends: Vec::new(), readings: Vec::new() })
    }

    /// Adds a state with its readings \[m\]; the maximum range means "no return". NaN readings (nothing
    /// usable) are left out. Returns whether any reading was left: a state without one isn't kept.
    ///
    /// # Errors
    /// [`SensorError::State`] or [`SensorError::Reading`] for values out of bounds; the set is then
    /// unchanged.
    pub fn push(&mut self, state: BeamState, readings: &[f32]) -> Result<bool, SensorError> {
        let index = self.len();
        let refuse = |what| Err(SensorError::State { index, what });
        if !(state.laser.is_finite() && state.bearing.is_finite()) {
            return refuse("pose and bearing must be finite");
        }
        if !(0.0..=CAST_REACH * self.max_range).contains(&state.range) {
            return refuse("the nominal range must be from 0 to 1.5 times the maximum range");
        }
        // pi/2 in f32 lies above that in f64, and ray casts round
        if !(0.0..=std::f32::consts::FRAC_PI_2 + 1e-4).contains(&state.incidence) {
            return refuse("the incidence angle must be from 0 to pi/2");
        }
        let outside = |z: &&f32| !z.is_nan() && !(0.0..=self.max_range).contains(*z);
        if let Some(&value) = readings.iter().find(outside) {
            return Err(SensorError::Reading { index, value, max_range: self.max_range });
        }
        let before = self.readings.len();
        self.readings.extend(readings.iter().copied().filter(|z| !z.is_nan()));
        let kept = self.readings.len() > before;
        if kept {
            self.states.push(state);
            self.ends.push(self.readings.len());
        }
        Ok(kept)
    }

    /// Adds a state for each beam, with its readings in `scans`, each one with a reading for every beam. `scan_of` tells which scan
    /// pose a beam (pose-major index) belongs to.
    ///
    /// # Errors
    /// As [`TrainingSet::push`].
    pub fn push_beams(
        &mut self,
        beams: &Beams<'_>,
        scans: &[&[f32]],
        scan_of: impl Fn(usize) -> u32,
    ) -> Result<(), SensorError> {
        let k = beams.per_pose();
        let mut readings = Vec::with_capacity(scans.len());
        for i in 0..beams.len() {
            let state = BeamState {
                laser: beams.laser.get(i / k),
                bearing: beams.bearings[i % k],
                range: beams.range[i],
                incidence: beams.incidence[i],
                surface: beams.surface[i],
                scan: scan_of(i),
            };
            readings.clear();
            readings.extend(scans.iter().map(|scan| scan[i]));
            self.push(state, &readings)?;
        }
        Ok(())
    }

    /// Number of states, N.
    pub fn len(&self) -> usize {
        self.states.len()
    }

    /// No states at all.
    pub fn is_empty(&self) -> bool {
        self.states.is_empty()
    }

    /// Number of readings of all states.
    pub fn reading_count(&self) -> usize {
        self.readings.len()
    }

    /// Maximum range \[m\].
    pub fn max_range(&self) -> f32 {
        self.max_range
    }

    /// State `i`. Panics beyond the end, as slices do.
    pub fn state(&self, i: usize) -> &BeamState {
        &self.states[i]
    }

    /// Readings of state `i` \[m\], at least one. Panics beyond the end, as slices do.
    pub fn observations(&self, i: usize) -> &[f32] {
        let start = if i == 0 { 0 } else { self.ends[i - 1] };
        &self.readings[start..self.ends[i]]
    }

    /// Parts the set by scan pose: about `held_out_share` of the scans go to the second set, and at least one
    /// goes to each where there are two. Beams of one scan share what stands around the robot, so parting by
    /// beam would let a model see its own test. The same seed gives the same parts.
    ///
    /// # Errors
    /// [`SensorError::Parameter`] unless the share is above 0 and below 1.
    pub fn split(&self, held_out_share: f64, seed: u64) -> Result<(Self, Self), SensorError> {
        self.split_runs(held_out_share, seed, 1)
    }

    /// As [`TrainingSet::split`], but parts whole runs of `length` (at least 1) consecutive scan poses: neighbouring
    /// scans of a drive share what stands around the robot, too.
    ///
    /// # Errors
    /// As [`TrainingSet::split`].
    pub fn split_runs(
        &self,
        held_out_share: f64,
        seed: u64,
        length: u32,
    ) -> Result<(Self, Self), SensorError> {
        let run_of = |state: &BeamState| state.scan / length.max(1);
        if !(held_out_share > 0.0 && held_out_share < 1.0) {
            let (what, allowed) = ("the held-out share", "above 0 and below 1");
            return Err(SensorError::Parameter { what, allowed, value: held_out_share });
        }
        let draw = Draw::new(seed, Stage::Training, 0);
        let mut runs: Vec<u32> =
            self.states.iter().map(run_of).collect::<BTreeSet<_>>().into_iter().collect();
        // the runs with the smallest keys are held out
        runs.sort_by_cached_key(|&run| (draw.item(run).random::<u64>(), run));
        let most = runs.len().saturating_sub(1);
        let count = ((held_out_share * runs.len() as f64).round() as usize).max(1).min(most);
        let held_out: BTreeSet<u32> = runs[..count].iter().copied().collect();
        let is_held_out = |state: &BeamState| held_out.contains(&run_of(state));
        Ok((self.filtered(|s| !is_held_out(s)), self.filtered(is_held_out)))
    }

    /// The states for which `keep` holds, in order.
    #[must_use]
    pub fn filtered(&self, keep: impl Fn(&BeamState) -> bool) -> Self {
        let mut part =
            Self { max_range: self.max_range, states: Vec::new(), ends: Vec::new(), readings: Vec::new() };
        for (i, state) in self.states.iter().enumerate() {
            if keep(state) {
                part.states.push(*state);
                part.readings.extend_from_slice(self.observations(i));
                part.ends.push(part.readings.len());
            }
        }
        part
    }

    /// Laser pose of state `i`.
    pub(crate) fn pose(&self, i: usize) -> Pose2 {
        self.states[i].laser
    }

    /// Direction of the beam of state `i` in the map frame \[rad\].
    pub(crate) fn heading(&self, i: usize) -> f64 {
        self.states[i].laser.theta + f64::from(self.states[i].bearing)
    }

    /// The beam of state `i`, as the models' per-beam functions see it.
    pub(crate) fn beam(&self, i: usize) -> Beam {
        let state = &self.states[i];
        Beam {
            pose: i,
            bearing: 0,
            range: state.range.min(self.max_range),
            nominal: state.range,
            incidence: state.incidence,
            max_range: self.max_range,
        }
    }

    /// Every reading with its beam.
    pub(crate) fn readings(&self) -> impl Iterator<Item = (f32, Beam)> + '_ {
        (0..self.len()).flat_map(move |i| self.observations(i).iter().map(move |&z| (z, self.beam(i))))
    }
}
