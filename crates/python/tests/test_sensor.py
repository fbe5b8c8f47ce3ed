from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import BEARINGS

import locsim

MAX_RANGE = 3.0


@pytest.fixture(scope="module")
def data(scenario: Path, room: locsim.Map) -> tuple[np.ndarray, locsim.Beams, locsim.Log]:
    log = locsim.simulate(locsim.Scenario(scenario).replace({"laser.rate_hz": 40}))
    return log.ranges, room.beams(log.laser_poses, log.bearings, log.max_range), log


@pytest.mark.parametrize("name", locsim.SensorModel.NAMES)
def test_density_cdf_and_samples_agree(name: str, room: locsim.Map, data) -> None:
    readings, beams, _ = data
    model = locsim.SensorModel.fit(name, readings, beams)
    assert (model.name, model.max_range) == (name, MAX_RANGE)
    assert model.log_density(readings, beams).shape == readings.shape
    if not model.is_normalized:
        return
    cells = 3000
    width = MAX_RANGE / cells
    z = np.repeat(((np.arange(cells) + 0.5) * width).astype(np.float32)[:, None], len(BEARINGS), axis=1)
    no_return = np.full(len(BEARINGS), MAX_RANGE, np.float32)
    for pose in room.free_poses(3, seed=5):
        same = room.beams(np.tile(pose, (cells, 1)), BEARINGS, MAX_RANGE)
        density = np.exp(model.log_density(z, same).astype(np.float64))
        lost = np.exp(model.log_density(no_return, same)[0].astype(np.float64))
        np.testing.assert_allclose(density.sum(0) * width + lost, 1.0, atol=5e-3)
        half = model.cdf(no_return / 2, same)[0]
        np.testing.assert_allclose(density[: cells // 2].sum(0) * width, half, atol=5e-3)
        assert (model.cdf(no_return, same) == 1.0).all()
        # 3000 draws: a share is known to 0.009, six standard deviations are 0.055.
        np.testing.assert_allclose((model.sample(same, seed=1) <= MAX_RANGE / 2).mean(0), half, atol=0.055)


def test_one_scan_is_held_against_every_pose(room: locsim.Map, data) -> None:
    readings, beams, log = data
    model = locsim.SensorModel.fit("np_reg_registered", readings, beams)
    of_one = model.log_density(readings[7], beams)
    assert of_one.shape == readings.shape
    np.testing.assert_array_equal(of_one[7], model.log_density(readings, beams)[7])
    with_gap = readings[7].copy()
    with_gap[3] = np.nan
    assert (model.log_density(with_gap, beams)[:, 3] == 0.0).all()
    # At the true pose the whole scan is likelier than at most others.
    total = of_one.sum(1)
    assert (total > total[7]).mean() < 0.2
    assert model.log_density(readings[7], room.beams(log.laser_poses[:0], log.bearings, MAX_RANGE)).shape == (0, 12)


def test_a_file_gives_the_same_density(data, tmp_path: Path, room: locsim.Map) -> None:
    readings, beams, _ = data
    for name in ["beam_mixture", "np_reg_field"]:
        model = locsim.SensorModel.fit(name, readings, beams)
        model.save(tmp_path / name)
        loaded = locsim.SensorModel.load(tmp_path / name, room)
        assert loaded.chosen == model.chosen
        np.testing.assert_array_equal(loaded.log_density(readings, beams), model.log_density(readings, beams))
    with pytest.raises(locsim.SensorError, match="distance"):
        locsim.SensorModel.load(tmp_path / "np_reg_field")


def test_states_without_a_map_are_enough() -> None:
    rng = np.random.default_rng(2)
    nominal = rng.uniform(0.5, 8.0, 4000)
    incidence = rng.uniform(0.0, 1.2, 4000)
    readings = np.where(rng.random(4000) < 0.1, 10.0, rng.normal(nominal, 0.05))
    states = locsim.Beams.of_states(nominal, incidence, max_range=10.0)
    model = locsim.SensorModel.fit("np_reg_registered", readings, states)
    ask = locsim.Beams.of_states([4.0, 4.0, 4.0], [0.3, 0.3, 0.3], max_range=10.0)
    at_wall, far, lost = np.exp(model.log_density(np.array([4.0, 2.0, 10.0]), ask))
    assert at_wall == pytest.approx(0.9 / (0.05 * np.sqrt(2 * np.pi)), rel=0.15)
    assert far < 0.05
    assert lost == pytest.approx(0.1, abs=0.03)
    log_loss, _ = model.evaluate(readings, states)
    assert -1.5 < log_loss < 0.0
    # Several scans of the same states.
    repeated = locsim.SensorModel.fit("np_reg_registered", np.stack([readings, readings]), states)
    assert repeated.evaluate(readings, states)[0] == pytest.approx(log_loss, abs=0.1)
    with pytest.raises(locsim.SensorError, match="distance"):
        locsim.SensorModel.fit("likelihood_field", readings, states)


def test_tempering_lies_in_its_range(data, room: locsim.Map) -> None:
    readings, beams, log = data
    model = locsim.SensorModel.fit("classic", readings[::2], room.beams(log.laser_poses[::2], log.bearings, MAX_RANGE))
    floor, exponent = model.choose_tempering(readings[1::2], log.laser_poses[1::2], log.bearings, room)
    assert 0.0 < floor < 1.0
    assert 0.0 < exponent <= 1.0


def test_what_does_not_fit_is_refused(data, room: locsim.Map) -> None:
    readings, beams, log = data
    with pytest.raises(locsim.SensorError, match="np_regg"):
        locsim.SensorModel.fit("np_regg", readings, beams)
    with pytest.raises(ValueError, match=r"readings: the shape \[12, 3\]"):
        locsim.SensorModel.fit("classic", np.zeros((12, 3)), beams)
    with pytest.raises(locsim.SensorError, match="reading 4 m is outside of 0 to 3 m"):
        locsim.SensorModel.fit("classic", np.full_like(readings, 4.0), beams)
    model = locsim.SensorModel.fit("classic", readings, beams)
    with pytest.raises(locsim.SensorError, match="3 m maximum range, beams of one of 5 m"):
        model.log_density(readings, room.beams(log.laser_poses, log.bearings, 5.0))
