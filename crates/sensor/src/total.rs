//! Whether a model's probabilities sum to 1.

use locsim_core::{Beams, CAST_REACH, Poses, SensorModel};

/// Beams that are looked at: nominal ranges as shares of the maximum range, at each of the incidence angles \[rad\].
const RANGE_SHARES: [f32; 11] = [0.0, 0.02, 0.1, 0.3, 0.5, 0.8, 0.95, 0.999, 1.0, 1.2, CAST_REACH];
const INCIDENCES: [f32; 3] = [0.0, 0.8, 1.5];

/// A model's total may be off by this much. The quadrature is 1e-4 off; where a Gaussian is cut at 0 far in its tail, f32 is
/// 3e-3 off.
const TOLERANCE: f64 = 0.01;

/// Readings from 0 to the maximum range are first cut into this many parts.
const PARTS: u16 = 64;
/// A part in which the midpoint rule and the distribution function differ by more than this is halved, ..
const PART_ERROR: f64 = 1e-6;
/// Parts are halved at most this many times, and only while there are fewer parts than the second number.
const HALVINGS: usize = 22;
const MOST_HALVED: usize = 1 << 12;

/// Whether the density integrates to 1 with the point mass at the maximum range, and whether the distribution function
/// agrees, along beams of every kind.
pub(crate) fn check(model: &dyn SensorModel, max_range: f32) -> Result<(), String> {
    for share in RANGE_SHARES {
        for incidence in INCIDENCES {
            let nominal = share * max_range;
            let totals = OneBeam { model, max_range, nominal, incidence }.totals();
            // Not true of NaN either.
            if let Some(total) =
                totals.into_iter().find(|total| !(1.0 - TOLERANCE..=1.0 + TOLERANCE).contains(total))
            {
                return Err(format!(
                    "the density integrates to {total}, not to 1 (nominal range {nominal} m, incidence {incidence} rad)"
                ));
            }
        }
    }
    Ok(())
}

/// A beam along which many readings are asked about.
pub(crate) struct OneBeam<'a> {
    pub model: &'a dyn SensorModel,
    /// \[m\].
    pub max_range: f32,
    /// \[m\].
    pub nominal: f32,
    /// \[rad\].
    pub incidence: f32,
}

impl OneBeam<'_> {
    /// Calls `f` with the readings as a batch, and returns the values that it fills in.
    pub fn ask(&self, z: &[f32], f: impl Fn(&dyn SensorModel, &Beams<'_>, &mut [f32])) -> Vec<f32> {
        let n = z.len();
        let beams = Beams {
            laser: Poses { x: &[0.0], y: &[0.0], theta: &[0.0] },
            bearings: &vec![0.0; n],
            range: &vec![self.nominal; n],
            incidence: &vec![self.incidence; n],
            surface: &vec![0; n],
            max_range: self.max_range,
        };
        let mut out = vec![0.0; n];
        f(self.model, &beams, &mut out);
        out
    }

    fn densities(&self, z: &[f32]) -> Vec<f64> {
        let logs = self.ask(z, |model, beams, out| model.log_density(z, beams, out));
        logs.into_iter().map(|log| f64::from(log).exp()).collect()
    }

    fn below(&self, z: &[f32]) -> Vec<f64> {
        let shares = self.ask(z, |model, beams, out| model.cdf(z, beams, out));
        shares.into_iter().map(f64::from).collect()
    }

    /// The point mass at the maximum range with the integral of the density, and with the distribution function just
    /// below the maximum range.
    pub fn totals(&self) -> [f64; 2] {
        let end = self.max_range.next_down();
        let at = |i: u16| end * (f32::from(i) / f32::from(PARTS));
        let mut parts: Vec<[f32; 2]> = (0..PARTS).map(|i| [at(i), at(i + 1)]).collect();
        let mut integral = 0.0;
        for halving in 0..=HALVINGS {
            let middles: Vec<f32> = parts.iter().map(|[a, b]| a + 0.5 * (b - a)).collect();
            let densities = self.densities(&middles);
            let below = self.below(parts.as_flattened());
            let masses: Vec<f64> = parts
                .iter()
                .zip(densities)
                .map(|([a, b], density)| density * (f64::from(*b) - f64::from(*a)))
                .collect();
            let rough = |i: usize| {
                let [a, b] = parts[i];
                let expected = below[2 * i + 1] - below[2 * i];
                (masses[i] - expected).abs() > PART_ERROR && a < middles[i] && middles[i] < b
            };
            let (halved, done): (Vec<usize>, Vec<usize>) = (0..parts.len()).partition(|&i| rough(i));
            integral += done.into_iter().map(|i| masses[i]).sum::<f64>();
            if halving == HALVINGS || halved.len() > MOST_HALVED {
                integral += halved.into_iter().map(|i| masses[i]).sum::<f64>();
                break;
            }
            parts = halved
                .into_iter()
                .flat_map(|i| {
                    let ([a, b], middle) = (parts[i], middles[i]);
                    [[a, middle], [middle, b]]
                })
                .collect();
        }
        let at_max = self.densities(&[self.max_range])[0];
        [integral + at_max, self.below(&[end])[0] + at_max]
    }
}
