//! The catalogue of effects, by the statistics that show them.

use locsim_world::effect::{Direction, EffectKind, Statistic};

/// The effects that a statistic of some kind shows, in the catalogue's order, each with what `pick` takes from it.
pub fn shown_by<T>(pick: impl Fn(&'static Statistic) -> Option<T>) -> impl Iterator<Item = (EffectKind, T)> {
    EffectKind::ALL.into_iter().flat_map(move |kind| {
        let picked: Vec<T> = kind.description().statistics.iter().filter_map(&pick).collect();
        picked.into_iter().map(move |of_kind| (kind, of_kind))
    })
}

/// The effects that a statistic of some kind shows, in the catalogue's order.
pub fn kinds_shown_by(is_of_kind: impl Fn(&Statistic) -> bool) -> impl Iterator<Item = EffectKind> {
    EffectKind::ALL.into_iter().filter(move |kind| kind.description().statistics.iter().any(&is_of_kind))
}

/// Typical values of an effect's parameters, but for those that a direction gives.
pub fn values_along(kind: EffectKind, direction: Direction) -> Vec<f64> {
    let mut values: Vec<f64> = kind.parameters().iter().map(|parameter| parameter.start).collect();
    for &(parameter, value) in direction {
        values[parameter] = value;
    }
    values
}
