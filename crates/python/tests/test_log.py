from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import program

import locsim


@pytest.mark.parametrize("name", ["drive.mcap", "drive.log.gz"])
def test_a_log_is_what_was_simulated(scenario: Path, tmp_path: Path, name: str) -> None:
    simulated = locsim.simulate(scenario)
    simulated.save(tmp_path / name)
    log = locsim.read_log(tmp_path / name)
    assert len(log) == len(simulated) == len(log.stamps)
    assert log.ranges.shape == (len(log), 12)
    assert (log.ranges.dtype, log.poses.dtype) == (np.float32, np.float64)
    assert log.max_range == 3.0
    np.testing.assert_allclose(log.ranges, simulated.ranges, atol=1e-3)
    np.testing.assert_allclose(log.poses, simulated.poses, atol=1e-4)
    np.testing.assert_allclose(np.diff(log.stamps), np.diff(simulated.stamps), atol=1e-4)
    np.testing.assert_allclose(log.bearings, simulated.bearings, atol=1e-4)
    # Increments chain to the odometry.
    x, y, theta = log.odometry[0]
    for dx, dy, dtheta in log.increments[1:]:
        x, y = x + np.cos(theta) * dx - np.sin(theta) * dy, y + np.sin(theta) * dx + np.cos(theta) * dy
        theta += dtheta
    np.testing.assert_allclose([x, y], log.odometry[-1][:2], atol=1e-9)
    assert log.with_beams(4).ranges.shape == (len(log), 4)


def test_the_program_writes_the_same_log(scenario: Path, tmp_path: Path) -> None:
    locsim.simulate(scenario, trial=1).save(tmp_path / "mine.mcap")
    assert program("simulate", str(scenario), "--trial", "1", "--out", str(tmp_path / "theirs.mcap")).returncode == 0
    assert (tmp_path / "mine.mcap").read_bytes() == (tmp_path / "theirs.mcap").read_bytes()


def test_errors_are_those_of_the_program(tmp_path: Path) -> None:
    image = tmp_path / "image.png"
    image.write_bytes(b"\x89PNG\r\n")
    for path in [image, tmp_path / "nowhere.log"]:
        with pytest.raises(locsim.LogError) as caught:
            locsim.read_log(path)
        printed = program("inspect", str(path))
        assert printed.stderr.strip() == f"error: {caught.value}"
