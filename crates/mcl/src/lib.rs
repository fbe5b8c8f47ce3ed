//! Monte Carlo localization: motion models, resamplers, the filter and its estimates
