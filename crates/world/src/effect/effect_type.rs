use locsim_core::Pose2;

use super::reading::{Hit, Return};
use super::{BeamView, Bursts, Description, Disc, Effect, OdometryErrors};
use crate::options::BlockOptions;

/// A kind of effect: its description, and what it does in a simulation. Each kind is a unit type, listed in
/// [`EffectKind`](super::EffectKind).
///
/// The hooks are called for an [`Effect`] of the kind; by default they do nothing. At its neutral value an effect is the
/// identity, bit for bit.
pub(crate) trait EffectType: Sync {
    /// Its description.
    fn description(&self) -> &'static Description;

    /// Where the laser sits on the robot, for where it is said to sit.
    fn laser_mount(&self, _: &Effect, mount: Pose2) -> Pose2 {
        mount
    }

    /// When a beam of a bearing \[rad\] is taken \[s\], for when its stamp says.
    fn beam_secs(&self, _: &Effect, _bearing: f64, secs: f64) -> f64 {
        secs
    }

    /// The clutter, for the assumed one.
    fn blocks(&self, _: &Effect, blocks: BlockOptions) -> BlockOptions {
        blocks
    }

    /// An object in the world that the map lacks.
    fn object(&self, _: &Effect) -> Option<Disc> {
        None
    }

    /// Adds to the errors of the odometry.
    fn odometry(&self, _: &Effect, _: &mut OdometryErrors) {}

    /// Range of the wall that a beam ends on \[m\], for where the map has it.
    fn wall_range(&self, _: &Effect, _: &BeamView, range: f64) -> f64 {
        range
    }

    /// Changes the return of a beam, or adds an alternative to it.
    fn reading(&self, _: &Effect, _: &Hit<'_>, _: &mut Return<'_>) {}

    /// Shift of all returns at a time since the first scan \[s\] that a filter can take off \[m\].
    fn drift_m(&self, _: &Effect, _secs: f64) -> f64 {
        0.0
    }

    /// The two states of an effect that comes in bursts.
    fn bursts(&self, _: &Effect) -> Option<Bursts> {
        None
    }
}
