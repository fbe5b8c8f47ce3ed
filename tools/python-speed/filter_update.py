"""Times of `Filter.update` at 10,000 particles x 60 beams in Python and in Rust, on the same drive.

    python tools/python-speed/filter_update.py target/debug/examples/filter_update [ROUNDS]

Each round is a process of either language, one after the other; who is first alternates. Both must have built their crates with the same
profile. `RAYON_NUM_THREADS` is the number of threads. Printed are the medians of each process and their ratio, in each round.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import locsim

ROOT = Path(__file__).resolve().parents[2]
PARTICLES = 10_000
BEAMS = 60


def write_drive(folder: Path) -> Path:
    """The corridor of the smoke test with more beams and scans, and a model that is fitted to it."""
    scenario = locsim.Scenario(ROOT / "scenarios/ci-smoke.yaml").replace({"laser.beams": BEAMS, "laser.rate_hz": 20})
    log = locsim.simulate(scenario)
    map_file = ROOT / "maps/corridor.yaml"
    beams = locsim.Map.load(map_file).beams(log.laser_poses, log.bearings, log.max_range)
    locsim.SensorModel.fit("np_reg_registered", log.ranges, beams).save(folder / "drive.model")
    drive = {
        "map": str(map_file),
        "model": str(folder / "drive.model"),
        "bearings": log.bearings.tolist(),
        "start": log.poses[0].tolist(),
        "increments": log.increments.tolist(),
        "ranges": log.ranges.tolist(),
        "particles": PARTICLES,
        "start_sigma": [0.2, 0.1],
        "alpha": [0.1, 0.05, 0.1, 0.05],
        "mount": list(log.mount),
        "tempering": [0.01, 0.3],
        "below": 0.5,
        "seed": 1,
    }
    file = folder / "drive.json"
    file.write_text(json.dumps(drive))
    return file


def filter_of(drive: dict[str, Any]) -> locsim.Filter:
    return locsim.Filter(
        locsim.Map.load(drive["map"]),
        locsim.SensorModel.load(drive["model"]),
        drive["bearings"],
        particles=drive["particles"],
        start=drive["start"],
        start_sigma=tuple(drive["start_sigma"]),
        alpha=drive["alpha"],
        mount=tuple(drive["mount"]),
        tempering=tuple(drive["tempering"]),
        seed=drive["seed"],
    )


def measure(file: Path) -> None:
    """The loop of crates/bench/examples/filter_update.rs."""
    import numpy as np

    drive = json.loads(file.read_text())
    increments = np.array(drive["increments"])
    scans = np.array(drive["ranges"], dtype=np.float32)
    pf = filter_of(drive)
    milliseconds, evidence = [], []
    for increment, ranges in zip(increments, scans, strict=True):
        pf.predict(increment)
        before = time.perf_counter()
        update = pf.update(ranges)
        milliseconds.append((time.perf_counter() - before) * 1e3)
        evidence.append(update.log_evidence)
        pf.resample(below=drive["below"])
    print(json.dumps({"milliseconds": milliseconds, "evidence": evidence}))


def arrays(file: Path) -> None:
    """What the particles cost as arrays [us], and the update beside views that are held."""
    drive = json.loads(file.read_text())
    pf = filter_of(drive)
    pf.update(drive["ranges"][0])

    def microseconds(call: Any) -> float:
        times = []
        for _ in range(500):
            before = time.perf_counter()
            call()
            times.append((time.perf_counter() - before) * 1e6)
        return statistics.median(times)

    views = ["x", "y", "theta", "weights", "log_likelihood"]
    print(f"pf.x, a view: {microseconds(lambda: pf.x):.1f} us; pf.particles, a copy: {microseconds(lambda: pf.particles):.1f} us")
    for words, hold in [("no view is held", False), ("all views are held", True)]:
        times = []
        for increment, ranges in zip(drive["increments"], drive["ranges"], strict=True):
            held = [getattr(pf, view) for view in views] if hold else []
            before = time.perf_counter()
            pf.predict(increment)
            pf.update(ranges)
            pf.resample()
            times.append((time.perf_counter() - before) * 1e3)
            del held
        print(f"predict, update and resample where {words}: {statistics.median(times):.3f} ms")


def compare(program: str, rounds: int) -> None:
    folder = Path(tempfile.mkdtemp(prefix="filter-update-"))
    file = write_drive(folder)
    mine = [sys.executable, __file__, "--measure", str(file)]
    commands = {"rust": [program, str(file)], "python": mine}
    medians: dict[str, list[float]] = {"rust": [], "python": []}
    evidence = []
    for turn in range(rounds):
        for language in sorted(commands, reverse=turn % 2 == 0):
            done = subprocess.run(commands[language], capture_output=True, text=True, check=True)
            result = json.loads(done.stdout)
            medians[language].append(statistics.median(result["milliseconds"]))
            evidence.append(result["evidence"])
    assert all(each == evidence[0] for each in evidence), "the work was not the same"
    ratios = [p / r for p, r in zip(medians["python"], medians["rust"], strict=True)]
    print(f"{PARTICLES} particles x {BEAMS} beams, {len(evidence[0])} scans, threads: {os.environ.get('RAYON_NUM_THREADS', 'all')}")
    print("round  rust [ms]  python [ms]  python / rust")
    for turn, (r, p, ratio) in enumerate(zip(medians["rust"], medians["python"], ratios, strict=True), 1):
        print(f"{turn:>5}  {r:>9.3f}  {p:>11.3f}  {ratio:>13.3f}")
    for name, values in [("rust [ms]", medians["rust"]), ("python [ms]", medians["python"]), ("python / rust", ratios)]:
        print(f"{name}: median {statistics.median(values):.3f}, from {min(values):.3f} to {max(values):.3f}")
    subprocess.run([sys.executable, __file__, "--arrays", str(file)], check=True)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["--measure", file]:
            measure(Path(file))
        case ["--arrays", file]:
            arrays(Path(file))
        case [program, *rest]:
            compare(program, int(rest[0]) if rest else 7)
        case _:
            sys.exit(__doc__)
