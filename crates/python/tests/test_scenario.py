from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import DRIVE, program

import locsim


def broken(folder: Path, old: str, new: str) -> Path:
    assert old in DRIVE
    path = folder / "broken.yaml"
    path.write_text(DRIVE.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("particles: 100", "particles: 0"),
        ("particles: 100", "partciles: 100"),
        ("beams: 12", "beams: many"),
        ("room.yaml", "nowhere.yaml"),
        ("name: room", "name: [room"),
        ("poses: 24, observations: 24", "poses: -1, observations: 0"),
    ],
)
def test_errors_are_those_of_the_program(folder: Path, old: str, new: str) -> None:
    path = broken(folder, old, new)
    with pytest.raises(locsim.ScenarioError) as caught:
        locsim.Scenario(path)
    printed = program("validate", str(path))
    assert printed.returncode == 2
    assert printed.stderr.strip() == f"error: {caught.value}"


def test_an_error_has_file_line_and_key(folder: Path) -> None:
    path = broken(folder, "particles: 100", "particles: 0")
    with pytest.raises(locsim.ScenarioError) as caught:
        locsim.run(path)
    error = caught.value
    assert (error.file, error.line, error.key) == (path, 15, "filter.particles")
    assert [key for _, key, _ in error.problems] == ["filter.particles"]
    assert isinstance(error, locsim.LocsimError)


def test_a_dict_is_the_scenario_of_its_file(folder: Path, scenario: Path) -> None:
    of_file = locsim.Scenario(scenario)
    keys = of_file.to_dict()
    assert keys["laser"]["beams"] == 12
    of_dict = locsim.Scenario(keys, base=folder)
    assert of_dict.to_dict() == keys
    assert (of_dict.name, of_dict.seed, of_dict.trials, of_dict.models) == (
        "room",
        3,
        3,
        ["classic", "np_reg_registered"],
    )
    assert of_dict.file is None
    assert of_file.file == scenario


def test_a_dict_has_the_same_errors_without_lines(folder: Path, scenario: Path) -> None:
    keys = locsim.Scenario(scenario).to_dict()
    keys["filter"]["particles"] = np.int64(0)
    with pytest.raises(locsim.ScenarioError) as caught:
        locsim.Scenario(keys, base=folder)
    assert caught.value.line is None
    assert caught.value.key == "filter.particles"
    assert "0 is not allowed" in str(caught.value)


def test_what_json_cannot_say_is_refused(scenario: Path) -> None:
    keys = locsim.Scenario(scenario).to_dict()
    with pytest.raises(TypeError, match="set is not allowed"):
        locsim.Scenario({**keys, "models": {"classic"}})
    with pytest.raises(ValueError, match="JSON"):
        locsim.Scenario({**keys, "seed": float("nan")})


def test_values_are_replaced(scenario: Path) -> None:
    changed = locsim.Scenario(scenario).replace({"filter.particles": 50, "laser.beams": 8}, trials=7)
    keys = changed.to_dict()
    assert (keys["filter"]["particles"], keys["laser"]["beams"], changed.trials) == (50, 8, 7)
    with pytest.raises(locsim.ScenarioError, match=r"filter\.particles") as caught:
        locsim.Scenario(scenario).replace({"filter.particles": -1})
    assert caught.value.line is None


def test_overrides_are_those_of_the_command(scenario: Path) -> None:
    one = locsim.Scenario(scenario, trials=1, seed=9, models=["classic"])
    assert (one.trials, one.seed, one.models) == (1, 9, ["classic"])
    with pytest.raises(locsim.ScenarioError) as caught:
        locsim.Scenario(scenario, models=["classical"])
    printed = program("run", str(scenario), "--models", "classical")
    assert printed.stderr.strip() == f"error: {caught.value}"


def test_a_map_from_a_dict_is_that_of_its_file(folder: Path, room: locsim.Map) -> None:
    of_dict = locsim.Map(json.loads((folder / "room.yaml").read_text()))
    assert of_dict.bounds == room.bounds
    np.testing.assert_array_equal(of_dict.walls, room.walls)
