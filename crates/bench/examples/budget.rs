//! Risk against the number of states that are kept, on the benchmark's mixed sensor: states chosen at random, evenly,
//! or by herding; the others' observations thrown away, or given to the nearest kept state.

use distreg::{
    Alignment, ConditionalDistribution, Dataset, Degree, DensityEstimate, Error, Kernel, Loss, NpRegOptions,
    Regressor, Selection, Weighting, condense, cross_validate, grid_search, product, select,
};
use locsim_bench::regression::{Task, Truth};

/// Units of distance along range \[m\] and incidence \[rad\].
const SCALES: [f64; 2] = [0.8, 0.2];

fn main() -> Result<(), Error> {
    let task = Task::new(Truth::Mixed)?;
    let outcomes = Task::outcomes()?;
    let alignment = Alignment::Shift { state_dim: 0 };
    let risk = |kept: &Dataset| {
        let method = |h: &[f64]| NpRegOptions {
            outcomes,
            alignment,
            density: DensityEstimate::Histogram,
            weighting: Weighting::kernel(Kernel::Epanechnikov, h),
            degree: Degree::Linear,
        };
        let axes: [&[f64]; 2] = [&[0.4, 0.8, 1.6, 3.2], &[0.1, 0.2, 0.4, 0.8]];
        let best =
            grid_search(&product(&axes), |h| cross_validate(&method(h), kept, 5, 1, Loss::HistogramMatch))?;
        let predictions = method(&best.candidate).fit(kept)?.predict_batch(&task.queries)?;
        Ok::<_, Error>(task.risk(&predictions))
    };
    println!("risk [mm]; all {} states: {:.1}", task.train.len(), risk(&task.train)?);
    println!("states  selection      kept alone  with the others' observations");
    for budget in [25, 50, 100, 200, 400] {
        for selection in [Selection::Random, Selection::FarthestFirst, Selection::Herding] {
            let kept = select(&task.train, budget, selection, &SCALES, 1)?;
            let condensed = condense(&task.train, &kept, alignment, outcomes.point_mass_at, &SCALES)?;
            let alone = risk(&task.train.subset(&kept))?;
            let name = format!("{selection:?}");
            println!("{budget:>6}  {name:<13}  {alone:>10.1}  {:>10.1}", risk(&condensed)?);
        }
    }
    Ok(())
}
