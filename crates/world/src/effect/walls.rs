//! Effects on a stretch of wall.

use std::f64::consts::PI;

use super::beam::MAX_INCIDENCE_RAD;
use super::effect_type::EffectType;
use super::reading::{Hit, Return};
use super::{
    Alternative, BeamView, Description, Effect, EffectKind, Moves, Needs, Parameter, Prior, Replacement,
    Site, Statistic,
};

/// About the share of a room's readings that are of things before its walls.
const CLUTTER: f64 = 0.05;

/// A wall that lets beams through.
pub(super) struct Glass;

impl EffectType for Glass {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "glass",
                site: Site::World,
                parameters: &[
                    Parameter::probability(0.5),
                    Parameter::shape("clutter", "1", [0.0, 1.0], 0.0)
                        .default(0.0)
                        .prior(Prior::LogNormal { offset: CLUTTER, sd: 1.0 }),
                ],
                has_place: true,
                formula: "with p, at the place: the reading of the surface behind, or for the share clutter of anything before it; where the map has none behind, no return or, as likely, one from anywhere",
                sentence: "A stretch of wall lets beams through: glass, or a grating.",
                signature: "one stretch of wall that reads too long or not at all",
                confused_with: &[EffectKind::MovedWall, EffectKind::IncidenceDropout],
                statistics: &[Statistic::WallLoss],
                moves: Moves::Walls,
                replaces: Some(Replacement::Behind),
                needs: Needs { map: true, jump: false, behind: true },
                is_as_map_errors: true,
                ..Description::DEFAULT
            }
        }
    }

    fn reading(&self, effect: &Effect, hit: &Hit<'_>, reading: &mut Return<'_>) {
        let [p, clutter] = effect.numbers();
        if hit.is_in_range() && hit.mapped && effect.is_at(hit.view.endpoint) {
            let lo = hit.view.range;
            let Some(behind) = hit.view.behind.filter(|&behind| behind < hit.max) else {
                // Half of these values are beyond the maximum range: maps seldom have what is outside.
                return reading.or(p, Alternative::Between { lo, hi: 2.0 * hit.max - lo });
            };
            let surface = Alternative::Near {
                mean: reading.scale * behind + reading.bias,
                sigma: hit.sigma(behind) + reading.growth * behind * behind,
            };
            let of_clutter = p * clutter;
            reading.or(of_clutter, Alternative::Between { lo, hi: behind });
            // Of those that nothing stands in the way of.
            reading.or(if of_clutter < 1.0 { (p - of_clutter) / (1.0 - of_clutter) } else { 0.0 }, surface);
        }
    }
}

/// The most that a wall is turned \[rad\], 20 deg: the form is that of a small turn.
const MAX_TURN_RAD: f64 = 20.0 * PI / 180.0;
/// Walls are built or moved askew by about so much \[rad\], 2 deg.
const TURN_SD_RAD: f64 = 2.0 * PI / 180.0;

/// A ray that is nearly parallel to a turned wall meets it far away: no farther than by so much of the incidence's cosine.
const LEAST_CLOSING: f64 = 0.2;

/// A wall that isn't where the map has it.
pub(super) struct MovedWall;

impl EffectType for MovedWall {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "moved_wall",
                site: Site::World,
                parameters: &[
                    Parameter::strength("distance_m", "m", 0.0, [-5.0, 5.0], 0.1),
                    Parameter::shape("turn_rad", "rad", [-MAX_TURN_RAD, MAX_TURN_RAD], 0.0)
                        .key("turn_deg")
                        .default(0.0)
                        .prior(Prior::Normal { sd: TURN_SD_RAD }),
                ],
                has_place: true,
                formula: "r + distance_m / cos(alpha) seen from the right of the line from its first end to its second, r - distance_m / cos(alpha) from the left; alpha at most 80 deg; turned by turn_rad about its middle",
                sentence: "A stretch of wall stands elsewhere than in the map.",
                sides: Some([
                    "A stretch of wall stands nearer than in the map.",
                    "A stretch of wall stands farther away than in the map.",
                ]),
                signature: "one stretch of wall that is shifted, whichever way the robot looks at it",
                confused_with: &[EffectKind::Glass, EffectKind::MissingObject],
                statistics: &[Statistic::WallShift],
                moves: Moves::Walls,
                needs: Needs::MAP,
                is_as_map_errors: true,
                ..Description::DEFAULT
            }
        }
    }

    fn wall_range(&self, effect: &Effect, view: &BeamView, range: f64) -> f64 {
        let [distance_m, turn] = effect.numbers();
        let Some([a, b]) = effect.stretch_at(view.endpoint) else { return range };
        let along = (b - a).normalize();
        let away = along.perp_dot(view.direction).signum();
        let cos = view.incidence.min(MAX_INCIDENCE_RAD).cos();
        if turn == 0.0 {
            return range + away * distance_m / cos;
        }
        let slope = turn.tan();
        let s = along.dot(view.endpoint - a.midpoint(*b));
        let closing = (cos - away * slope * along.dot(view.direction)).max(LEAST_CLOSING * cos);
        range + away * (distance_m + slope * s) / closing
    }
}
