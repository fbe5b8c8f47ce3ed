from __future__ import annotations

import inspect
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import program

import locsim
from locsim import _locsim, distreg

PACKAGE = Path(locsim.__file__).parent


def test_the_stubs_are_those_of_the_module(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    command = [sys.executable, "-m", "mypy.stubtest", "locsim", "--ignore-disjoint-bases"]
    checked = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_the_package_is_typed(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    command = [sys.executable, "-m", "mypy", "--strict", "-p", "locsim", "--cache-dir", str(tmp_path)]
    checked = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def public() -> list[tuple[str, object]]:
    """All functions, classes and members that users see."""
    found: list[tuple[str, object]] = []
    for module in [locsim, distreg]:
        for name in module.__all__:
            value = getattr(module, name)
            found.append((name, value))
            if inspect.isclass(value) and not issubclass(value, Exception):
                members = [member for member in vars(value) if not member.startswith("_")]
                found += [(f"{name}.{member}", getattr(value, member)) for member in members]
    return found


def test_everything_is_documented() -> None:
    names = {name for name, _ in public()}
    assert {"run", "Map.cast", "SensorModel.log_density", "Filter.particles", "fit"} <= names
    bare = [name for name, value in public() if callable(value) and not inspect.getdoc(value)]
    assert bare == []
    for name in ["Log", "Beams", "Filter", "Estimate"]:
        members = vars(getattr(locsim, name)).items()
        assert [m for m, value in members if not m.startswith("_") and not inspect.getdoc(value)] == [], name


def test_arguments_of_arrays_tell_their_shapes() -> None:
    for function, shapes in [
        (locsim.Map.cast, ["[poses, 3]", "[beams]", "[poses, beams]", "[m]"]),
        (locsim.Filter.update, ["[beams]", "[m]"]),
        (distreg.fit, ["[n, coordinates]", "[n, m]"]),
    ]:
        doc = inspect.getdoc(function)
        assert doc is not None
        assert all(shape in doc for shape in shapes), doc


def test_all_names_are_there() -> None:
    compiled = {name for name in dir(_locsim) if not name.startswith("__")} - {"main"}
    exported = {*locsim.__all__, *distreg.__all__} - {"distreg", "__version__"}
    assert compiled == exported


def in_process(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "locsim", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "arguments",
    [["--version"], ["effects"], ["--help"], ["run"], ["run", "nowhere.yaml"], ["schema"], ["nonsense"], []],
)
def test_the_command_is_the_program(arguments: list[str]) -> None:
    mine, theirs = in_process(*arguments), program(*arguments)
    assert (mine.returncode, mine.stdout, mine.stderr) == (theirs.returncode, theirs.stdout, theirs.stderr)


def test_the_command_runs_a_scenario(scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = in_process("run", str(scenario), "--trials", "1", "--out", str(out))
    assert done.returncode == 0, done.stderr
    assert (out / "recording.rrd").is_file()


def test_the_version_is_that_of_the_program() -> None:
    assert program("--version").stdout.split() == ["locsim", locsim.__version__]
