from __future__ import annotations

import numpy as np
import pytest

from locsim import LocsimError, distreg

MAX = 5.0


def data(n: int = 150, m: int = 40, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Ranges that follow the first coordinate; one in ten is lost."""
    rng = np.random.default_rng(seed)
    states = np.column_stack([rng.uniform(0.5, 4.0, n), rng.uniform(0.0, 1.0, n)])
    z = rng.normal(states[:, :1], 0.02 + 0.04 * states[:, 1:], (n, m))
    return states, np.where(rng.random((n, m)) < 0.1, MAX, z)


@pytest.mark.parametrize("method", ["np_reg", "p_reg", "frechet"])
def test_a_known_family_is_learnt(method: str) -> None:
    states, observations = data()
    model = distreg.fit(
        states,
        observations,
        method=method,
        values=(0.0, MAX, 0.02),
        point_mass=MAX,
        bandwidths=[0.5, 0.2],
        shift_by=0,
    )
    queries = np.array([[1.0, 0.5], [2.5, 0.5], [9.0, 0.5]])
    predicted = model.predict(queries)
    assert len(predicted) == 3
    np.testing.assert_allclose(predicted.mass.sum(1) + predicted.point_mass, 1.0)
    np.testing.assert_allclose(predicted.point_mass[:2], 0.1, atol=0.04)
    np.testing.assert_allclose(predicted.quantile(0.45)[:2], queries[:2, 0], atol=0.03)
    median = predicted.quantile(np.array([0.45, 0.45, 0.45]))
    np.testing.assert_allclose(predicted.cdf(median)[:2], 0.45, atol=0.02)
    np.testing.assert_allclose(predicted.density(MAX), predicted.point_mass)
    centres = (predicted.mass * predicted.centres).sum(1) + MAX * predicted.point_mass
    np.testing.assert_allclose(predicted.mean(), centres, atol=1e-6)


def test_a_risk_has_an_interval() -> None:
    states, observations = data()
    model = distreg.fit(states, observations, values=(0.0, MAX, 0.02), point_mass=MAX, bandwidths=[0.5, 0.2], shift_by=0)
    blunt = distreg.fit(states, observations, values=(0.0, MAX, 0.02), point_mass=MAX, bandwidths=[2.0, 2.0])
    held_out = data(seed=2)
    for loss in ["crps", "log_loss", "histogram_match", "wasserstein1", "euclidean"]:
        mean, lo, hi = distreg.risk(model.losses(*held_out, loss=loss))
        assert lo < mean < hi
        assert hi < distreg.risk(blunt.losses(*held_out, loss=loss))[1], loss


def test_observations_may_differ_in_number() -> None:
    states, observations = data(n=20, m=6)
    ragged = [row[: 2 + i % 5] for i, row in enumerate(observations)]
    padded = np.full((20, 6), np.nan)
    for row, values in zip(padded, ragged, strict=True):
        row[: len(values)] = values
    options = {"values": (0.0, MAX, 0.02), "point_mass": MAX, "neighbours": 5, "scales": [1.0, 1.0]}
    query = [[2.0, 0.5]]
    of_list, of_array = (distreg.fit(states, z, **options).predict(query).mass for z in [ragged, padded])
    np.testing.assert_array_equal(of_list, of_array)


def test_what_is_refused() -> None:
    states, observations = data(n=20, m=6)
    options = {"values": (0.0, MAX, 0.02)}
    with pytest.raises(ValueError, match="bandwidths"):
        distreg.fit(states, observations, **options)
    with pytest.raises(ValueError, match="kernel.*cosine"):
        distreg.fit(states, observations, bandwidths=[1, 1], kernel="cosine", **options)
    with pytest.raises(ValueError, match="method"):
        distreg.fit(states, observations, method="knn", bandwidths=[1, 1], **options)
    with pytest.raises(LocsimError, match="bandwidth"):
        distreg.fit(states, observations, bandwidths=[0, 1], **options)
    with pytest.raises(LocsimError, match="a state has 3 coordinates, expected 2"):
        distreg.fit(states, observations, bandwidths=[1, 1], **options).predict(np.zeros((1, 3)))
