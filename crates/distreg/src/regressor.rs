use rayon::prelude::*;

use crate::{Dataset, Distribution, Error, Outcomes, PointMass, Support};

/// A method of distribution regression with all its settings: fits a model of p(z | x) to data.
///
/// The methods are [`NpRegOptions`](crate::NpRegOptions), [`PRegOptions`](crate::PRegOptions),
/// [`FrechetOptions`](crate::FrechetOptions) and [`StandardizedOptions`](crate::StandardizedOptions); everything
/// downstream of [`Regressor::fit`] treats them alike.
pub trait Regressor: Sync {
    /// The fitted model.
    type Model: ConditionalDistribution;

    /// Learns from `data`.
    ///
    /// # Errors
    /// If there is no data or a setting is invalid.
    fn fit(&self, data: &Dataset) -> Result<Self::Model, Error>;

    /// The possible outcomes: the bins and the point mass of every prediction.
    fn outcomes(&self) -> Outcomes;
}

/// A fitted model of p(z | x).
pub trait ConditionalDistribution: Send + Sync {
    /// Coordinates of a state, p.
    fn dim(&self) -> usize;

    /// The possible outcomes: the bins and the point mass of every prediction.
    fn outcomes(&self) -> Outcomes;

    /// Fills `mass`, all zeros and one element per bin, with the bin masses at `query`. Gives the probability of
    /// the point mass, 0 where the outcomes have none; together they sum to 1.
    ///
    /// # Errors
    /// If the query isn't `dim` finite numbers, or the alignment divides by a coordinate that isn't positive.
    fn predict_into(
        &self,
        query: &[f64],
        scratch: &mut Scratch,
        mass: &mut [f64],
    ) -> Result<(f64, Support), Error>;

    /// The distribution at `query`.
    ///
    /// # Errors
    /// As [`ConditionalDistribution::predict_into`].
    fn predict(&self, query: &[f64]) -> Result<(Distribution, Support), Error> {
        let outcomes = self.outcomes();
        let mut mass = vec![0.0; outcomes.grid.bins];
        let (point, support) = self.predict_into(query, &mut Scratch::default(), &mut mass)?;
        let point = outcomes.point_mass_at.map(|at| PointMass { at, mass: point });
        Ok((Distribution::normalized(outcomes.grid, mass, point), support))
    }

    /// The distributions at many queries (row by row, Q x `dim`), in parallel. Each row depends on its query
    /// alone, so the number of threads changes no bit.
    ///
    /// # Errors
    /// As [`ConditionalDistribution::predict_into`], at any query.
    fn predict_batch(&self, queries: &[f64]) -> Result<Predictions, Error> {
        let mut predictions = Predictions::new(self.outcomes());
        self.predict_batch_into(queries, &mut predictions)?;
        Ok(predictions)
    }

    /// As [`ConditionalDistribution::predict_batch`], into predictions whose memory is used again.
    ///
    /// # Errors
    /// As [`ConditionalDistribution::predict_into`], at any query; the predictions are then empty.
    fn predict_batch_into(&self, queries: &[f64], predictions: &mut Predictions) -> Result<(), Error> {
        let dim = self.dim();
        predictions.clear(self.outcomes());
        if !queries.len().is_multiple_of(dim) {
            return Err(Error::Dimension { expected: dim, found: queries.len() % dim });
        }
        let bins = predictions.outcomes.grid.bins;
        // Rows are zeroed by the thread that fills them.
        predictions.mass.resize(queries.len() / dim * bins, 0.0);
        let rows: Result<Vec<(f64, Support)>, Error> = predictions
            .mass
            .par_chunks_mut(bins)
            .zip(queries.par_chunks(dim))
            .map_init(Scratch::default, |scratch, (row, query)| {
                row.fill(0.0);
                self.predict_into(query, scratch, row)
            })
            .collect();
        match rows {
            Ok(rows) => {
                (predictions.points, predictions.support) = rows.into_iter().unzip();
                Ok(())
            }
            Err(error) => {
                predictions.mass.clear();
                Err(error)
            }
        }
    }
}

/// Buffers of one worker, used again from query to query.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    /// State indices and weights.
    pub(crate) weights: Vec<(usize, f64)>,
    /// Bins before they are moved or spread.
    pub(crate) bins: Vec<f64>,
    /// Regressed values.
    pub(crate) values: Vec<f64>,
    /// Bins of a residual's distribution.
    pub(crate) residual: Vec<f64>,
}

/// Predictions at many queries, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Predictions {
    outcomes: Outcomes,
    /// Queries x bins.
    mass: Vec<f64>,
    points: Vec<f64>,
    support: Vec<Support>,
}

impl Predictions {
    /// No predictions yet, to be filled by [`ConditionalDistribution::predict_batch_into`].
    pub fn new(outcomes: Outcomes) -> Self {
        Self { outcomes, mass: Vec::new(), points: Vec::new(), support: Vec::new() }
    }

    fn clear(&mut self, outcomes: Outcomes) {
        self.outcomes = outcomes;
        self.points.clear();
        self.support.clear();
    }

    /// Number of queries.
    pub fn len(&self) -> usize {
        self.support.len()
    }

    /// Whether there were no queries.
    pub fn is_empty(&self) -> bool {
        self.support.is_empty()
    }

    /// The possible outcomes.
    pub fn outcomes(&self) -> &Outcomes {
        &self.outcomes
    }

    /// Probability of each bin at query `i`, without the point mass.
    ///
    /// # Panics
    /// If `i` is not below `len`.
    pub fn mass(&self, i: usize) -> &[f64] {
        &self.mass[i * self.outcomes.grid.bins..(i + 1) * self.outcomes.grid.bins]
    }

    /// Probability of the point mass at each query; 0 where the model has none.
    pub fn points(&self) -> &[f64] {
        &self.points
    }

    /// Whether each query lies within the data.
    pub fn support(&self) -> &[Support] {
        &self.support
    }

    /// The distribution predicted at query `i`.
    ///
    /// # Panics
    /// If `i` is not below `len`.
    pub fn distribution(&self, i: usize) -> Distribution {
        let point = self.outcomes.point_mass_at.map(|at| PointMass { at, mass: self.points[i] });
        Distribution::normalized(self.outcomes.grid, self.mass(i).to_vec(), point)
    }
}
