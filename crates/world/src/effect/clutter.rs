//! Effects on the unmapped blocks along the walls.

use super::effect_type::EffectType;
use super::{Description, Effect, EffectKind, Fit, Moves, Needs, Parameter, Site, Statistic};
use crate::map::FINEST_M;
use crate::options::BlockOptions;

/// More or fewer unmapped blocks.
pub(super) struct BlockDensity;

impl EffectType for BlockDensity {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "block_density",
                site: Site::World,
                parameters: &[Parameter::strength("factor", "1", 1.0, [0.0, 100.0], 2.0)],
                formula: "blocks per metre of wall times factor",
                sentence: "There are more, or fewer, unmapped objects along the walls than assumed.",
                sides: Some([
                    "There are fewer unmapped objects along the walls than assumed.",
                    "There are more unmapped objects along the walls than assumed.",
                ]),
                signature: "how often readings are short near walls",
                confused_with: &[EffectKind::BlockDepth, EffectKind::MissingObject],
                statistics: &[Statistic::ClutterDensity],
                moves: Moves::Clutter,
                fit: Fit::Nuisance,
                needs: Needs::MAP,
                ..Description::DEFAULT
            }
        }
    }

    fn blocks(&self, effect: &Effect, blocks: BlockOptions) -> BlockOptions {
        let [factor] = effect.numbers();
        BlockOptions { per_metre_of_wall: blocks.per_metre_of_wall * factor, ..blocks }
    }
}

/// Deeper or flatter unmapped blocks.
pub(super) struct BlockDepth;

impl EffectType for BlockDepth {
    fn description(&self) -> &'static Description {
        const {
            &Description {
                name: "block_depth",
                site: Site::World,
                parameters: &[Parameter::strength("factor", "1", 1.0, [0.01, 100.0], 1.5)],
                formula: "width of blocks and their gap to the wall times factor",
                sentence: "Unmapped objects reach farther, or less far, into the room than assumed.",
                sides: Some([
                    "Unmapped objects reach less far into the room than assumed.",
                    "Unmapped objects reach farther into the room than assumed.",
                ]),
                signature: "how short readings are near walls",
                confused_with: &[EffectKind::BlockDensity],
                statistics: &[Statistic::ClutterDepth],
                moves: Moves::Clutter,
                fit: Fit::WithClutter,
                needs: Needs::MAP,
                is_as_map_errors: true,
                ..Description::DEFAULT
            }
        }
    }

    fn blocks(&self, effect: &Effect, blocks: BlockOptions) -> BlockOptions {
        let [factor] = effect.numbers();
        // Two such effects may make blocks thinner than any can be.
        BlockOptions {
            width_m: blocks.width_m.map(|width| (factor * width).max(FINEST_M)),
            wall_distance_m: blocks.wall_distance_m.map(|gap| factor * gap),
            ..blocks
        }
    }
}
