from __future__ import annotations

import gc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import locsim


#: Options of a scenario's filter, and the same in Python.
OPTIONS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "fixed": ({}, {"particles": 100}),
    "adaptive": (
        {
            "particles": {"kld": {"min": 60, "max": 300, "bin_m": 0.1}},
            "injection": {"alpha_slow": 0.05, "alpha_fast": 0.5},
            "regularization": {"sigma_m": 0.01, "sigma_deg": 0.5},
        },
        {
            "particles": locsim.KldSampling(60, 300, bin_m=0.1),
            "injection": (0.05, 0.5),
            "regularization": (0.01, np.radians(0.5)),
        },
    ),
    "annealed": (
        {"start": "global", "annealing": {"candidates": 2000, "sigma_deg": 0.5, "moves": 4}},
        {
            "particles": 100,
            "start": None,
            "annealing": locsim.Annealing(candidates=2000, sigma_rad=np.radians(0.5), moves=4),
        },
    ),
}


@pytest.mark.parametrize("name", OPTIONS)
def test_a_filter_from_python_is_that_of_a_run(name: str, folder: Path, tmp_path: Path) -> None:
    """The estimates of a run on a log, bit for bit: Python predicts, updates and resamples, the crates do the same in `run`."""
    pyarrow = pytest.importorskip("pyarrow")
    compute = pytest.importorskip("pyarrow.compute")
    of_scenario, of_filter = OPTIONS[name]
    room_file = folder / "room.yaml"
    often = locsim.Scenario(folder / "room-run.yaml").replace({"laser.rate_hz": 20})
    locsim.simulate(often).save(tmp_path / "drive.mcap")
    keys = {
        "name": "log",
        "seed": 3,
        "trials": 2,
        "map": {"file": room_file},
        "log": {"file": "drive.mcap", "train_scans": [[0.5, 1.0]], "localize_scans": [[0.0, 0.5]]},
        "training": {"poses": 100},
        "models": [{"name": "np_reg_registered", "floor": 0.01, "exponent": 0.4}],
        # Each scan is given to `update` below.
        "filter": often.to_dict()["filter"] | {"update": "each_scan"} | of_scenario,
    }
    out = tmp_path / "out"
    ran = locsim.run(locsim.Scenario(keys, base=tmp_path), out=out)
    steps, trials = (pyarrow.table(ran.tables[name]) for name in ["steps", "trials"])

    log = locsim.read_log(tmp_path / "drive.mcap")
    room = locsim.Map.load(room_file)
    model = locsim.SensorModel.load(out / "models/np_reg_registered.model")
    counts = set()
    for trial, seed in zip(trials["trial"].to_pylist(), trials["seed"].to_pylist(), strict=True):
        rows = steps.filter(compute.equal(steps["trial"], trial)).to_pydict()
        options = {
            "start": log.poses[0],
            "start_sigma": (0.1, np.radians(3)),
            "alpha": (0.1, 0.05, 0.1, 0.05),
            "mount": log.mount,
            "tempering": (0.01, 0.4),
            "seed": seed,
        }
        pf = locsim.Filter(room, model, log.bearings, **(options | of_filter))
        resampled = 0
        for i in rows["step"]:
            pf.predict(log.increments[i])
            update = pf.update(log.ranges[i])
            x, y, theta = pf.estimate().pose
            assert x == rows["estimate_x_m"][i]
            assert y == rows["estimate_y_m"][i]
            assert theta == rows["estimate_theta_rad"][i]
            assert update.log_evidence == rows["log_evidence_nats"][i]
            assert pf.effective_sample_size == rows["effective_sample_size"][i]
            assert len(pf.weights) == rows["particles"][i]
            assert pf.resample(below=0.5) == rows["resampled"][i]
            resampled += rows["resampled"][i]
            counts.add(len(pf.weights))
        assert 2 < resampled <= len(rows["step"]) < len(log)
    injected = [text for text in trials["events"].to_pylist() if "random" in text or "inject" in text]
    # An annealed set is as large as its spread asks for until it has gathered.
    assert (len(counts) > 1, bool(injected)) == (name in ["adaptive", "annealed"], name == "adaptive")


@pytest.fixture(scope="module")
def world(scenario: Path, room: locsim.Map) -> tuple[locsim.Log, locsim.SensorModel]:
    log = locsim.simulate(locsim.Scenario(scenario).replace({"laser.rate_hz": 40}))
    beams = room.beams(log.laser_poses, log.bearings, log.max_range)
    return log, locsim.SensorModel.fit("np_reg_registered", log.ranges, beams)


@pytest.mark.parametrize("resampler", ["systematic", "stratified", "multinomial", "residual"])
def test_a_filter_follows_the_robot(resampler: str, room: locsim.Map, world) -> None:
    log, model = world
    pf = locsim.Filter(
        room, model, log.bearings, particles=500, start=log.poses[0], tempering=(0.01, 0.3), resampler=resampler
    )
    for increment, ranges in zip(log.increments, log.ranges, strict=True):
        pf.predict(increment)
        pf.update(ranges)
        estimate = pf.estimate()
        pf.resample(below=0.5)
    assert np.hypot(*(estimate.pose - log.poses[-1])[:2]) < 0.1
    assert estimate.covariance.shape == (3, 3)
    np.testing.assert_array_equal(estimate.covariance, estimate.covariance.T)
    assert np.hypot(*(estimate.max_weight - log.poses[-1])[:2]) < 0.3


def test_particles_are_the_users_own(room: locsim.Map, world) -> None:
    log, model = world
    pf = locsim.Filter(room, model, log.bearings, particles=300, seed=4)
    before = pf.particles
    assert (before.shape, before.dtype) == ((300, 3), np.float64)
    assert room.is_free(before[:, :2]).all()
    kept = before.copy()
    pf.predict([0.1, 0.0, 0.2])
    pf.update(log.ranges[0])
    np.testing.assert_array_equal(before, kept)
    assert (pf.particles != kept).any()
    weights = pf.weights
    assert weights.sum() == pytest.approx(1.0)
    assert 1.0 / (weights**2).sum() == pytest.approx(pf.effective_sample_size)
    mean = (weights[:, None] * pf.particles)[:, :2].sum(0)
    np.testing.assert_allclose(pf.estimate().pose[:2], mean, rtol=1e-9)
    assert pf.resample()
    np.testing.assert_allclose(pf.weights, 1 / 300)
    assert not pf.resample(below=0.9)


#: The arrays of a filter that are views of its memory.
VIEWS = ["x", "y", "theta", "weights", "log_likelihood"]


@pytest.mark.parametrize("name", VIEWS)
def test_a_view_is_the_filters_memory(name: str, room: locsim.Map, world) -> None:
    log, model = world
    pf = locsim.Filter(room, model, log.bearings, particles=300, seed=4)
    pf.update(log.ranges[0])
    view = getattr(pf, name)
    assert (view.shape, view.dtype, view.flags.owndata) == ((300,), np.float64, False)
    assert np.shares_memory(view, getattr(pf, name))
    assert not np.shares_memory(view, pf.particles)
    assert not view.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        view[0] = 1.0
    with pytest.raises(ValueError, match="WRITEABLE"):
        view.flags.writeable = True


def test_views_are_the_particles(room: locsim.Map, world) -> None:
    log, model = world
    pf = locsim.Filter(room, model, log.bearings, particles=300, seed=4)
    assert pf.log_likelihood.shape == (0,)
    pf.update(log.ranges[0])
    np.testing.assert_array_equal(np.stack([pf.x, pf.y, pf.theta], axis=1), pf.particles)
    weights = np.exp(pf.log_likelihood - pf.log_likelihood.max())
    np.testing.assert_allclose(pf.weights, weights / weights.sum(), rtol=1e-9, atol=1e-15)


#: Steps of a filter, each with the views that it gives other values.
STEPS: dict[str, tuple[Any, list[str]]] = {
    "predict": (lambda pf, log: pf.predict([0.1, 0.02, 0.2]), ["x", "y", "theta"]),
    "update": (lambda pf, log: pf.update(log.ranges[1]), ["weights", "log_likelihood"]),
    "resample": (lambda pf, log: pf.resample(), ["x", "y", "theta", "weights"]),
    "annealed update": (lambda pf, log: pf.update(log.ranges[0]), VIEWS),
}


@pytest.mark.parametrize("name", STEPS)
def test_a_view_keeps_its_values_when_the_filter_goes_on(name: str, room: locsim.Map, world) -> None:
    log, model = world
    step, changed = STEPS[name]
    # So many that the first scan leaves fewer of them: of a set that keeps its size, weights would be what they were.
    annealing = locsim.Annealing(candidates=30_000, moves=2) if name == "annealed update" else None
    pf = locsim.Filter(room, model, log.bearings, particles=300, annealing=annealing, seed=4)
    if annealing is None:
        pf.update(log.ranges[0])
    views = {view: getattr(pf, view) for view in VIEWS}
    kept = {view: values.copy() for view, values in views.items()}
    step(pf, log)
    for view, values in views.items():
        np.testing.assert_array_equal(values, kept[view])
        now = getattr(pf, view)
        assert np.array_equal(now, kept[view]) != (view in changed), view
        assert np.shares_memory(now, values) != (view in changed), view


def test_views_change_no_bit_of_what_follows(room: locsim.Map, world) -> None:
    log, model = world

    def drive(*, hold: bool) -> np.ndarray:
        options: dict[str, Any] = {
            "particles": locsim.KldSampling(60, 300, bin_m=0.1),
            "injection": (0.05, 0.5),
            "regularization": (0.01, 0.01),
        }
        pf = locsim.Filter(room, model, log.bearings, start=log.poses[0], seed=1, **options)
        held = []
        for increment, ranges in zip(log.increments, log.ranges, strict=True):
            for step in [lambda: pf.predict(increment), lambda: pf.update(ranges), lambda: pf.resample(below=0.9)]:
                step()
                views = [getattr(pf, view) for view in VIEWS]
                held.append((views, [view.copy() for view in views]) if hold else None)
        for views, copies in filter(None, held):
            for view, copy in zip(views, copies, strict=True):
                np.testing.assert_array_equal(view, copy)
        return np.concatenate([pf.particles.ravel(), pf.weights, pf.log_likelihood])

    np.testing.assert_array_equal(drive(hold=True), drive(hold=False))


def test_a_view_outlives_its_filter(room: locsim.Map, world) -> None:
    log, model = world
    pf = locsim.Filter(room, model, log.bearings, particles=100_000, seed=4)
    pf.update(log.ranges[0])
    views = [getattr(pf, view) for view in VIEWS]
    part = pf.x[10:20]
    kept = [view.copy() for view in views]
    del pf
    gc.collect()
    # Memory that had been freed would be taken for these.
    others = [np.full(100_000, -1.0) for _ in range(20)]
    for view, values in zip(views, kept, strict=True):
        np.testing.assert_array_equal(view, values)
    np.testing.assert_array_equal(part, kept[0][10:20])
    assert all((other == -1.0).all() for other in others)


def test_the_same_seed_gives_the_same_particles(room: locsim.Map, world) -> None:
    log, model = world

    def particles(seed: int, *, table: bool = True) -> np.ndarray:
        pf = locsim.Filter(room, model, log.bearings, particles=200, start=log.poses[0], seed=seed, table=table)
        for increment, ranges in zip(log.increments[:5], log.ranges[:5], strict=True):
            pf.predict(increment)
            pf.update(ranges)
            pf.resample()
        return pf.particles

    np.testing.assert_array_equal(particles(1), particles(1))
    assert (particles(1) != particles(2)).any()
    exact = particles(1, table=False)
    assert np.abs(exact[:, :2].mean(0) - particles(1)[:, :2].mean(0)).max() < 0.05


def test_what_a_filter_refuses(room: locsim.Map, world) -> None:
    log, model = world
    pf = locsim.Filter(room, model, log.bearings)
    with pytest.raises(locsim.FilterError, match="a scan of 3 ranges from a laser of 12 beams"):
        pf.update([1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="odometry: a pose is not finite"):
        pf.predict([np.nan, 0, 0])
    with pytest.raises(ValueError, match="odometry: a pose is not finite, or beyond"):
        pf.predict([1e300, 0, 0])
    with pytest.raises(ValueError, match="particles: 1000000000 is not allowed; at most 10000000"):
        locsim.Filter(room, model, log.bearings, particles=10**9)
    with pytest.raises(ValueError, match="start_sigma"):
        locsim.Filter(room, model, log.bearings, start=log.poses[0], start_sigma=(1e308, 0.1))
    with pytest.raises(ValueError, match="count: 1000000000 is not allowed"):
        room.free_poses(10**9)
    with pytest.raises(ValueError, match="bearings: NaN of beam 1 is not allowed"):
        room.cast(log.poses[:1], [0.0, np.nan])
    with pytest.raises(ValueError, match="points: a coordinate is not finite"):
        room.distance([[np.nan, 1.0]])
    with pytest.raises(locsim.FilterError, match="particle count"):
        locsim.Filter(room, model, log.bearings, particles=0)
    with pytest.raises(locsim.FilterError, match="greatest particle count"):
        locsim.Filter(room, model, log.bearings, particles=locsim.KldSampling(200, 100))
    with pytest.raises(locsim.FilterError, match="alpha_fast"):
        locsim.Filter(room, model, log.bearings, injection=(0.1, 0.05))
    with pytest.raises(locsim.FilterError, match="regularization sigma_m"):
        locsim.Filter(room, model, log.bearings, regularization=(-0.1, 0.0))
    with pytest.raises(locsim.FilterError, match="annealing effective share"):
        locsim.Filter(room, model, log.bearings, annealing=locsim.Annealing(effective_share=1.0))
    with pytest.raises(TypeError, match="particles"):
        locsim.Filter(room, model, log.bearings, particles="many")
    with pytest.raises(locsim.FilterError, match="motion alpha"):
        locsim.Filter(room, model, log.bearings, alpha=(-1, 0, 0, 0))
    with pytest.raises(locsim.SensorError, match="exponent"):
        locsim.Filter(room, model, log.bearings, tempering=(0.1, 0.0))
    with pytest.raises(ValueError, match="resampler"):
        locsim.Filter(room, model, log.bearings, resampler="roulette")
