"""Distribution regression: learns the whole distribution p(z | x) of an observation z given a state x from samples.

The methods are those of Tallavajhula, Poczos and Kelly, "Nonparametric Distribution Regression Applied to Sensor
Modeling" (IROS 2016), and two more: NP-REG (histograms smoothed over states), P-REG (regressed parameters of a family)
and Fréchet regression in Wasserstein space.
"""

from locsim._locsim import Prediction, Regression, fit, risk

__all__ = ["Prediction", "Regression", "fit", "risk"]
