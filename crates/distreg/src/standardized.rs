use serde::{Deserialize, Serialize};

use crate::np_reg::deposit;
use crate::{
    ConditionalDistribution, Dataset, Error, Outcomes, PReg, PRegOptions, Regressor, Scratch, Support,
};

/// Location-scale regression: a Gaussian's mean m(x) and deviation s(x) are regressed on the state as P-REG does, and
/// another method learns the distribution of e = (z - m(x)) / s(x), which changes less with the state than that of z.
/// This is registration by a learned alignment; the shape of the distribution stays free (Akritas and Van Keilegom
/// 2001).
///
/// Good where one peak moves and widens with the state. Where several parts move each in its own way, no location and
/// scale registers them all, and [`Alignment`](crate::Alignment) by a state coordinate is better.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StandardizedOptions<R> {
    /// Regression of mean and deviation. Its outcomes are those of the whole, its family is a Gaussian (of a mixture,
    /// the first Gaussian).
    pub location_scale: PRegOptions,
    /// Regression of e. Its outcomes are those of e, such as bins of 0.02 from -8 to 8; e beyond counts in the end bins.
    /// It has a point mass if the whole has one.
    pub residual: R,
}

/// The model fitted by [`StandardizedOptions`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Standardized<M> {
    location_scale: PReg,
    residual: M,
}

impl<M> Standardized<M> {
    /// The regression of mean and deviation.
    pub fn location_scale(&self) -> &PReg {
        &self.location_scale
    }

    /// The regression of e.
    pub fn residual(&self) -> &M {
        &self.residual
    }
}

impl<R: Regressor> Regressor for StandardizedOptions<R> {
    type Model = Standardized<R::Model>;

    fn fit(&self, data: &Dataset) -> Result<Self::Model, Error> {
        let location_scale = self.location_scale.fit(data)?;
        let whole = location_scale.outcomes();
        let point = self.residual.outcomes().point_mass_at;
        if whole.point_mass_at.is_some() != point.is_some() {
            return Err(Error::PointMassMismatch);
        }
        let residuals = location_scale.residuals(data, point)?;
        Ok(Standardized { location_scale, residual: self.residual.fit(&residuals)? })
    }

    fn outcomes(&self) -> Outcomes {
        self.location_scale.outcomes
    }
}

impl<M: ConditionalDistribution> ConditionalDistribution for Standardized<M> {
    fn dim(&self) -> usize {
        self.residual.dim()
    }

    fn outcomes(&self) -> Outcomes {
        self.location_scale.outcomes()
    }

    fn predict_into(
        &self,
        query: &[f64],
        scratch: &mut Scratch,
        mass: &mut [f64],
    ) -> Result<(f64, Support), Error> {
        let (at, _) = self.location_scale.parameters_with(query, scratch)?;
        let from = self.residual.outcomes().grid;
        let mut residual = std::mem::take(&mut scratch.residual);
        residual.clear();
        residual.resize(from.bins, 0.0);
        let (mut point, support) = self.residual.predict_into(query, scratch, &mut residual)?;
        let to = self.outcomes();
        // Bin b of e covers an interval of z; in units of z's bins it starts here.
        let position =
            |b: usize| (at.mean + at.sigma * (from.lo + b as f64 * from.width) - to.grid.lo) / to.grid.width;
        let mut above = 0.0;
        for (b, &m) in residual.iter().enumerate() {
            if m > 0.0 {
                above += deposit(position(b), position(b + 1), m, mass);
            }
        }
        scratch.residual = residual;
        point += to.absorb_above(above, mass);
        Ok((point, support))
    }
}
