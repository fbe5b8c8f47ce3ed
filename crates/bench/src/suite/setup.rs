use std::f64::consts::PI;

use clap::ValueEnum;
use locsim_core::Pose2;
use locsim_gap::GapError;
use locsim_scenario::Simulation;
use locsim_world::simulation::OdometryNoise;
use serde::{Deserialize, Serialize};
use strum::IntoStaticStr;

/// What a log's laser is like, and what its scenario says beside map, path and laser.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    ValueEnum,
    IntoStaticStr,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Setup {
    /// All as in the nominal scenario
    #[default]
    Scenario,
    /// 180 beams over 180 degrees, four scans per second
    HalfCircle,
    /// 1,080 beams over 270 degrees, two scans per second
    Fine,
    /// Beams all around, the first at -180 degrees, and the laser at the robot's centre
    FirstBeamBehind,
    /// Nothing optional: no clutter, no effects of the laser, an odometry without noise, readings that aren't quantized
    Bare,
}

impl Setup {
    /// Those beside the scenario's own.
    pub(super) const OTHERS: [Self; 4] = [Self::HalfCircle, Self::Fine, Self::FirstBeamBehind, Self::Bare];

    /// The name used in files.
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// The scenario's simulation with this setup. With fewer scans per second a log has fewer scans of the same path.
    pub(super) fn of(self, simulation: &Simulation) -> Result<Simulation, GapError> {
        let mut simulation = simulation.clone();
        let laser = &mut simulation.laser;
        match self {
            Self::Scenario => {}
            Self::HalfCircle => {
                (laser.beams, laser.field_of_view_rad, laser.first_bearing_rad) = (180, PI, None);
                laser.rate_hz = 4.0;
            }
            Self::Fine => {
                (laser.beams, laser.field_of_view_rad, laser.first_bearing_rad) = (1080, 1.5 * PI, None);
                laser.rate_hz = 2.0;
            }
            Self::FirstBeamBehind => {
                (laser.field_of_view_rad, laser.first_bearing_rad) = (2.0 * PI, Some(-PI));
                laser.mount = Pose2::IDENTITY;
            }
            Self::Bare => {
                laser.resolution_m = 0.0;
                simulation.blocks = None;
                simulation.effects.clear();
                simulation.robot.odometry_noise = OdometryNoise::new([0.0; 4])?;
            }
        }
        // A sweep is over when the next scan begins.
        simulation.laser.scan_secs = simulation.laser.scan_secs.min(simulation.laser.rate_hz.recip());
        Ok(simulation)
    }
}
