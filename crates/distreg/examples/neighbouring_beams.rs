//! Two neighbouring beams of a laser, jointly: p(z1, z2 | x) = p(z1 | x) p(z2 | x, z1), against the product of the two
//! p(z1 | x) p(z2 | x), by held-out log loss.

use distreg::{
    Alignment, Dataset, Degree, DensityEstimate, Error, Kernel, Loss, NpRegOptions, Outcomes, Regressor,
    Weighting, cross_validate, grid_search, losses, product, risk,
};
use rand_philox::{Philox, u32_to_unit_f64};

/// Held-out log losses of a pair of readings \[nats\].
pub struct Losses {
    /// Of the joint model.
    pub joint: f64,
    /// Of the product of both beams' own models.
    pub product: f64,
}

/// Both beams see a wall at range r. A quarter of the time an object up to a metre before it stands in the first beam,
/// and then, with the given probability, in the second too, at nearly the same range; else the second beam sees an
/// object of its own a quarter of the time.
fn pairs(count: u64, together: f64, seed: u64) -> Vec<[f64; 3]> {
    (0..count)
        .map(|pair| {
            let mut random = Philox::from_u64_seed_stream(seed, pair);
            let mut unit = || u32_to_unit_f64(random.next_u32());
            let r = 1.5 + 2.5 * unit();
            let noise = [0.02 * (unit() + unit() - 1.0), 0.02 * (unit() + unit() - 1.0)];
            let objects = [unit(), unit()].map(|share| r - 0.1 - 0.9 * share);
            let (blocked, both, alone) = (unit() < 0.25, unit() < together, unit() < 0.25);
            let first = if blocked { objects[0] } else { r };
            let second = match (both, alone) {
                (true, _) => first,
                (false, true) => objects[1],
                (false, false) => r,
            };
            [r, first + noise[0], second + noise[1]]
        })
        .collect()
}

/// Held-out log loss of registered NP-REG, with bandwidths cross-validated on the training data.
fn held_out_loss(train: &Dataset, held_out: &Dataset, axes: &[&[f64]]) -> Result<f64, Error> {
    let outcomes = Outcomes::of_values(0.0, 4.5, 0.02)?;
    let method = |bandwidths: &[f64]| NpRegOptions {
        outcomes,
        alignment: Alignment::Shift { state_dim: 0 },
        density: DensityEstimate::Histogram,
        weighting: Weighting::kernel(Kernel::Gaussian, bandwidths),
        degree: Degree::Constant,
    };
    let loss = Loss::LogLoss { floor: 0.01 };
    let best = grid_search(&product(axes), |h| cross_validate(&method(h), train, 4, 1, loss))?;
    Ok(risk(&losses(&method(&best.candidate).fit(train)?, held_out, loss)?, 1)?.mean)
}

/// State and reading of one regression, from (r, z1, z2).
type Row = fn(&[f64; 3]) -> (Vec<f64>, f64);

fn dataset(pairs: &[[f64; 3]], dim: usize, row: Row) -> Result<Dataset, Error> {
    let mut data = Dataset::new(dim);
    for (state, z) in pairs.iter().map(row) {
        data.push(&state, &[z])?;
    }
    Ok(data)
}

/// Learns both models from 1500 pairs and scores them on 700 others.
///
/// # Errors
/// If a fit is not possible.
pub fn compare(together: f64) -> Result<Losses, Error> {
    let (train, held_out) = (pairs(1500, together, 1), pairs(700, together, 2));
    let score = |axes: &[&[f64]], row: Row| {
        let dim = axes.len();
        held_out_loss(&dataset(&train, dim, row)?, &dataset(&held_out, dim, row)?, axes)
    };
    let ranges = [0.5, 2.0];
    let first = score(&[&ranges], |&[r, z1, _]| (vec![r], z1))?;
    let second = score(&[&ranges], |&[r, _, z2]| (vec![r], z2))?;
    // The first beam's reading relative to the wall is a state coordinate of the second beam.
    let given = score(&[&ranges, &[0.02, 0.05, 0.2, 1.0]], |&[r, z1, z2]| (vec![r, z1 - r], z2))?;
    Ok(Losses { joint: first + given, product: first + second })
}

// The test that includes this file has no use for `main`.
#[allow(dead_code)]
fn main() -> Result<(), Error> {
    println!("objects in both beams   joint [nats]   product [nats]");
    for together in [0.9, 0.0] {
        let Losses { joint, product } = compare(together)?;
        println!("{together:<21}   {joint:<12.3}   {product:.3}");
    }
    Ok(())
}
