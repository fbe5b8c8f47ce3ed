//! Effects on a stretch of wall.

use super::beam::MAX_INCIDENCE_RAD;
use super::effect_type::EffectType;
use super::reading::{Hit, Return};
use super::{
    Alternative, BeamView, Description, Effect, EffectKind, Moves, Needs, Parameter, Replacement, Site,
    Statistic,
};

/// A wall that lets beams through.
pub(super) struct Glass;

impl EffectType for Glass {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "glass",
                site: Site::World,
                parameters: &[Parameter::probability(0.5)],
                has_place: true,
                formula: "with p, at the place: the reading of the surface behind; where the map has none, no return or, as likely, a return from anywhere behind",
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
        let [p] = effect.numbers();
        if hit.is_in_range() && hit.mapped && effect.is_at(hit.view.endpoint) {
            let behind = hit.view.behind.filter(|&behind| behind < hit.max);
            // Half of these values are beyond the maximum range: maps seldom have what is outside.
            let unknown = Alternative::Between { lo: hit.view.range, hi: 2.0 * hit.max - hit.view.range };
            let alternative = behind.map_or(unknown, |r| Alternative::Near {
                mean: reading.scale * r + reading.bias,
                sigma: hit.sigma(r) + reading.growth * r * r,
            });
            reading.or(p, alternative);
        }
    }
}

/// A wall that isn't where the map has it.
pub(super) struct MovedWall;

impl EffectType for MovedWall {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "moved_wall",
                site: Site::World,
                parameters: &[Parameter::strength("distance_m", "m", 0.0, [-5.0, 5.0], 0.1)],
                has_place: true,
                formula: "r + distance_m / cos(alpha), alpha at most 80 deg, at the place; positive: farther",
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
        let [distance_m] = effect.numbers();
        if effect.is_at(view.endpoint) {
            range + distance_m / view.incidence.min(MAX_INCIDENCE_RAD).cos()
        } else {
            range
        }
    }
}
