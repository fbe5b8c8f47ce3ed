from __future__ import annotations

import numpy as np
import pytest

import locsim

WIDTH, DEPTH = 6.0, 4.0
ROOM = {"outline": {"points_m": [[0, 0], [WIDTH, 0], [WIDTH, DEPTH], [0, DEPTH]]}}


def analytic(poses: np.ndarray, bearings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Range [m] and incidence [rad] of each beam in the empty room."""
    angle = poses[:, 2, None] + bearings[None, :].astype(np.float64)
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = poses[:, 0, None], poses[:, 1, None]
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0, (WIDTH - x) / cos, -x / cos)
        to_y = np.where(sin > 0, (DEPTH - y) / sin, -y / sin)
    return np.minimum(to_x, to_y), np.where(to_x < to_y, np.arccos(np.abs(cos)), np.arccos(np.abs(sin)))


def test_casts_are_those_of_a_rectangle() -> None:
    rng = np.random.default_rng(1)
    n = 500
    poses = np.column_stack(
        [rng.uniform(0.1, WIDTH - 0.1, n), rng.uniform(0.1, DEPTH - 0.1, n), rng.uniform(-np.pi, np.pi, n)]
    )
    bearings = rng.uniform(-np.pi, np.pi, 61).astype(np.float32)
    room = locsim.Map(ROOM)
    ranges, incidences = analytic(poses, bearings)
    cast = room.cast(poses, bearings)
    assert (cast.shape, cast.dtype) == ((n, 61), np.float32)
    np.testing.assert_allclose(cast, ranges, rtol=1e-5)
    beams = room.beams(poses, bearings, max_range=10.0)
    np.testing.assert_allclose(beams.ranges, ranges, rtol=1e-5)
    np.testing.assert_allclose(beams.incidences, incidences, atol=2e-3)
    np.testing.assert_allclose(room.cast(poses, bearings, max_range=2.0), np.minimum(ranges, 2.0), rtol=1e-5)


def test_points_are_free_inside() -> None:
    room = locsim.Map(ROOM)
    points = np.array([[[1.0, 1.0], [-1.0, 1.0]], [[5.9, 3.9], [6.1, 3.9]]])
    np.testing.assert_array_equal(room.is_free(points), [[True, False], [True, False]])
    assert room.distance([1.0, 2.0]) == pytest.approx(1.0, abs=0.05)
    poses = room.free_poses(200, seed=3)
    assert poses.shape == (200, 3)
    assert room.is_free(poses[:, :2]).all()
    np.testing.assert_array_equal(poses, room.free_poses(200, seed=3))
    assert (poses != room.free_poses(200, seed=4)).any()


def test_any_layout_of_an_array_is_read() -> None:
    room = locsim.Map(ROOM)
    poses = np.asfortranarray(room.free_poses(20))
    bearings = np.linspace(-1, 1, 30)
    expected = room.cast(np.ascontiguousarray(poses), bearings.astype(np.float32))
    np.testing.assert_array_equal(room.cast(poses, bearings), expected)
    np.testing.assert_array_equal(room.cast(poses.tolist(), bearings.tolist()), expected)
    np.testing.assert_array_equal(room.cast(poses[::2], bearings[::-3]), expected[::2, ::-3])
    assert room.cast(poses[0], bearings).shape == (1, 30)
    assert room.cast(poses[:0], bearings).shape == (0, 30)
    writable = room.cast(poses, bearings)
    writable += 1.0


@pytest.mark.parametrize(
    ("poses", "bearings", "message"),
    [
        (np.zeros((3, 2)), np.zeros(4), r"poses: the shape \[3, 2\] is not allowed; \[poses, 3"),
        (np.zeros((3, 3)), np.zeros((2, 2)), r"bearings: the shape \[2, 2\] is not allowed; \[beams\]"),
        (np.full((1, 3), np.nan), np.zeros(4), "poses: a pose is not finite"),
        (["a"], np.zeros(4), "poses: could not convert"),
    ],
)
def test_other_shapes_are_refused(poses: object, bearings: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        locsim.Map(ROOM).cast(poses, bearings)
    with pytest.raises(ValueError, match="max_range: 0 is not allowed"):
        locsim.Map(ROOM).cast(np.zeros(3), np.zeros(4), max_range=0.0)


def test_a_broken_map_is_refused(tmp_path) -> None:
    with pytest.raises(locsim.LocsimError, match="outline"):
        locsim.Map({})
    with pytest.raises(locsim.ScenarioError, match="nowhere"):
        locsim.Map.load(tmp_path / "nowhere.yaml")
