//! Effects that stand in front of the walls: in the world, or on the robot.

use std::f64::consts::{PI, TAU};

use glam::DVec2;

use super::beam::BEARING_MARGIN;
use super::effect_type::EffectType;
use super::reading::{Hit, Return};
use super::{
    Alternative, Description, Disc, Effect, EffectKind, Experiment, Fit, Moves, Needs, Parameter,
    Replacement, Site, Statistic,
};

/// A round object that the map lacks.
pub(super) struct MissingObject;

impl EffectType for MissingObject {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "missing_object",
                site: Site::World,
                parameters: &[
                    Parameter::position("x_m", "m", [-1e5, 1e5], 0.0, 0.15),
                    Parameter::position("y_m", "m", [-1e5, 1e5], 0.0, 0.15),
                    Parameter::strength("radius_m", "m", 0.0, [0.0, 10.0], 0.2),
                ],
                formula: "an opaque disc at (x_m, y_m) of radius radius_m in the map frame",
                sentence: "Something round stands in the world, always at the same place, and the map lacks it.",
                signature: "short readings of all beams through one place",
                confused_with: &[EffectKind::BlockDensity, EffectKind::MovedWall],
                experiments: &[Experiment::Turn],
                statistics: &[Statistic::Object],
                moves: Moves::Objects,
                fit: Fit::WithClutter,
                needs: Needs::MAP,
                is_as_map_errors: true,
                ..Description::DEFAULT
            }
        }
    }

    fn object(&self, effect: &Effect) -> Option<Disc> {
        let [x, y, radius_m] = effect.numbers();
        (radius_m > 0.0).then_some(Disc { center: DVec2::new(x, y), radius_m })
    }
}

/// A part of the robot in front of some beams.
pub(super) struct SectorOcclusion;

impl EffectType for SectorOcclusion {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "sector_occlusion",
                parameters: &[
                    Parameter::position("from_rad", "rad", [-PI, PI], -0.2, 0.05).key("from_deg"),
                    Parameter::position("to_rad", "rad", [-PI, PI], 0.2, 0.05).key("to_deg"),
                    Parameter::shape("range_m", "m", [0.0, 100.0], 0.3),
                    Parameter::probability(0.5),
                ],
                formula: "with p: N(range_m, sigma(range_m)) for bearings from from_rad counter-clockwise to to_rad, \
                          where what is met is farther",
                sentence: "Part of the robot (a cable, a post) is in front of some beams.",
                signature: "short readings of a fixed range at fixed bearings",
                confused_with: &[EffectKind::BlockDensity],
                experiments: &[Experiment::Turn],
                statistics: &[Statistic::Sector],
                fit: Fit::WithClutter,
                replaces: Some(Replacement::Robot),
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, hit: &Hit<'_>, reading: &mut Return<'_>) {
        let [from_rad, to_rad, range_m, p] = effect.numbers();
        if range_m < hit.range && is_between(hit.view.bearing, from_rad, to_rad) {
            reading.or(p, Alternative::Near { mean: range_m, sigma: hit.sigma(range_m) });
        }
    }
}

/// Whether a bearing lies between two others, counter-clockwise from the first \[rad\].
fn is_between(bearing: f64, from: f64, to: f64) -> bool {
    let width = if to >= from { to - from } else { to - from + TAU };
    (bearing - from + BEARING_MARGIN).rem_euclid(TAU) <= width + 2.0 * BEARING_MARGIN
}
