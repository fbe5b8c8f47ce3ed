//! Phases of readings modulo a step, which bunch where readings are quantized.

use std::f64::consts::TAU;

use locsim_comparison::kinds_shown_by;
use locsim_world::effect::{self, EffectKind};

use super::{Family, Form, Group, Halves, Readings, Statistic};

/// Steps of lasers on the market \[m\]: 2 mm to 5 cm.
const STEPS_M: [f64; 7] = [0.002, 0.003, 0.005, 0.01, 0.02, 0.025, 0.05];

/// For each step the sums of cosine and sine of the returns' phases.
pub(super) struct Steps {
    kind: EffectKind,
}

impl Steps {
    pub fn all() -> Vec<Self> {
        kinds_shown_by(|statistic| matches!(statistic, effect::Statistic::Step))
            .map(|kind| Self { kind })
            .collect()
    }
}

impl Family for Steps {
    fn statistics(&self) -> Vec<Statistic> {
        let of_step = |step| Statistic::along(self.kind, &[(0, step)], Group::Places, Form::Other);
        STEPS_M.into_iter().flat_map(|step| [of_step(step), of_step(step)]).collect()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let mut sums = vec![[0.0; 2]; 2 * STEPS_M.len()];
        for reading in log.all.iter().filter(|reading| reading.is_return) {
            for (sum, part) in sums.iter_mut().zip(phases(reading.z).as_flattened()) {
                sum[reading.half] += part;
            }
        }
        sums
    }
}

/// Cosine and sine of 2 pi z over each of [`STEPS_M`]: all but one are powers of one complex number.
fn phases(z: f64) -> [[f64; 2]; STEPS_M.len()] {
    let phase = |step: f64| {
        let (sin, cos) = (TAU * z / step).sin_cos();
        [cos, sin]
    };
    let times = |[a, b]: [f64; 2], [c, d]: [f64; 2]| [a * c - b * d, a * d + b * c];
    let square = |a| times(a, a);
    let tenth = phase(0.1);
    let of_50 = square(tenth);
    let of_25 = square(of_50);
    let of_20 = times(of_25, tenth);
    let of_10 = square(of_20);
    let of_5 = square(of_10);
    let of_2 = times(square(of_5), of_10);
    [of_2, phase(0.003), of_5, of_10, of_20, of_25, of_50]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phases_are_those_of_the_steps() {
        for z in [0.0, 0.4567, 3.21, 7.999] {
            for (step, [cos, sin]) in STEPS_M.into_iter().zip(phases(z)) {
                let angle = TAU * z / step;
                assert!((cos - angle.cos()).abs() < 1e-9 && (sin - angle.sin()).abs() < 1e-9, "{z} {step}");
            }
        }
    }
}
