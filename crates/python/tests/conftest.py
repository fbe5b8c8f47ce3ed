"""The world that the tests share: a room of 3.2 m x 2 m with a recess and a pillar, and a short drive through it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import locsim

ROOM: dict[str, Any] = {
    "outline": {
        "name": "room",
        "points_m": [[0, 0], [3.2, 0], [3.2, 0.8], [3.6, 0.8], [3.6, 1.4], [3.2, 1.4], [3.2, 2], [0, 2]],
    },
    "obstacles": [{"name": "pillar", "points_m": [[1.5, 1.5], [1.8, 1.5], [1.8, 1.8], [1.5, 1.8]]}],
}

DRIVE = """\
name: room
description: A short drive through a small room
seed: 3
trials: 3
map: {file: room.yaml}
ray_cast: {method: table, cell_m: 0.1}
blocks: {per_metre_of_wall: 0.3, length_m: [0.2, 0.4], width_m: [0.2, 0.4], wall_distance_m: [0.0, 0.3]}
robot:
  path: {waypoints: {points_m: [[0.6, 0.9], [2.6, 0.9]], speed_m_s: 0.5, turn_rate_deg_s: 45}}
  odometry_noise: {alpha: [0.05, 0.02, 0.05, 0.01]}
laser: {rate_hz: 5, beams: 12, max_range_m: 3, noise: {sigma_m: 0.02}}
training: {poses: 24, observations: 24}
models: [classic, np_reg_registered]
filter:
  particles: 100
  resample: {effective_share_below: 0.5}
  motion: {model: odometry, alpha: [0.1, 0.05, 0.1, 0.05]}
  start: {tracking: {sigma_m: 0.1, sigma_deg: 3}}
"""

BEARINGS = np.linspace(-np.pi, np.pi, 12, endpoint=False, dtype=np.float32)


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Range tables are kept away from the user's cache."""
    os.environ["LOCSIM_CACHE"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `room.yaml` and `room-run.yaml`."""
    folder = tmp_path_factory.mktemp("world")
    (folder / "room.yaml").write_text(json.dumps(ROOM))
    (folder / "room-run.yaml").write_text(DRIVE)
    return folder


@pytest.fixture(scope="session")
def scenario(folder: Path) -> Path:
    return folder / "room-run.yaml"


@pytest.fixture(scope="session")
def room(folder: Path) -> locsim.Map:
    return locsim.Map.load(folder / "room.yaml")


@pytest.fixture(scope="session")
def ran(scenario: Path) -> locsim.Run:
    return locsim.run(scenario)


def program(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The `locsim` command: the program of the build where the gate names it, or else the one in the wheel."""
    command = [os.environ["LOCSIM_PROGRAM"]] if "LOCSIM_PROGRAM" in os.environ else [sys.executable, "-m", "locsim"]
    return subprocess.run([*command, *arguments], cwd=cwd, capture_output=True, text=True, check=False)
