#!/usr/bin/env python3
"""What shards cost: 2,000 short runs in 1, 2, 10, 20 and 200 shards, against the same runs in one go.

usage: tools/sweep-figures/shards.py [--locsim PROGRAM] [--rounds N] [--shards N ...] [--folder DIR]

Processor time (user and system) of all shards and of the merge is held against that of `locsim sweep` without shards, all on one thread.
Wall time would tell how busy the machine is. At the end single runs and shards of 20 take turns, which tells what a shard costs by itself. Each round has every way once, in a random order. The merged files must have the bytes of the
unsharded sweep; `times.csv` and the manifest, which has its hash, are of the clock.
"""

import argparse
import os
import random
import shutil
import statistics
import subprocess
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHARDS = (1, 2, 10, 20, 200)
PAIRS = 40
# A drive of 5 m, 25 scans, with a model that isn't trained.
SCENARIO = """
name: short
seed: 1
trials: 1
map: {{file: {map}}}
ray_cast: {{method: table, cell_m: 0.2}}
robot:
  path: {{waypoints: {{points_m: [[1, 2], [6, 2]], speed_m_s: 1, turn_rate_deg_s: 45}}}}
  odometry_noise: {{alpha: [0.05, 0.02, 0.05, 0.01]}}
laser: {{rate_hz: 5, beams: 18, max_range_m: 4.5, noise: {{sigma_m: 0.01}}}}
training: {{poses: 4, observations: 4}}
models: [amcl_beam]
filter:
  particles: 200
  motion: {{model: odometry, alpha: [0.1, 0.05, 0.1, 0.05]}}
  start: {{tracking: {{sigma_m: 0.1, sigma_deg: 3}}}}
"""
SWEEP = """
scenario: short.yaml
seed: 22
axes:
  laser.noise.sigma_m: {{from: 0.01, to: 0.1, count: 10}}
  filter.particles: {{from: 201, to: {last}, step: 1}}
"""


def call(words, folder):
    """Processor time of a command [s]."""
    with open(folder / "output", "wb") as output:
        process = subprocess.Popen(words, cwd=folder, stdout=output, stderr=output)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(words)}: {(folder / 'output').read_text()}")
    return usage.ru_utime + usage.ru_stime


def files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*")
            if path.is_file() and path.name not in ("times.csv", "manifest.json")}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--locsim", default="locsim", help="the program")
    parser.add_argument("--runs", type=int, default=2000, help="runs, a multiple of 200")
    parser.add_argument("--rounds", type=int, default=3, help="how often each way is measured")
    parser.add_argument("--shards", type=int, nargs="+", default=SHARDS, help="numbers of shards")
    parser.add_argument("--folder", help="a folder for results, on the disk of interest")
    options = parser.parse_args()
    program = str(Path(shutil.which(options.locsim)).resolve())
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        folder = Path(folder)
        (folder / "short.yaml").write_text(SCENARIO.format(map=ROOT / "maps/corridor.yaml"))
        (folder / "short-sweep.yaml").write_text(SWEEP.format(last=200 + options.runs // 10))
        sweep = [program, "sweep", "short-sweep.yaml", "--threads", "1", "--quiet", "--force", "--out"]
        call([*sweep, "first", "--shard", f"1/{options.runs}"], folder)  # fills the cache of range tables
        seconds = {shards: [] for shards in (0, *options.shards)}
        merges = {shards: [] for shards in options.shards}
        for turn in range(options.rounds):
            whole = None
            order = list(options.shards)
            random.Random(turn).shuffle(order)
            for shards in (0, *order):
                if shards:
                    of_shards = sum(call([*sweep, "out", "--shard", f"{i}/{shards}"], folder) for i in range(1, shards + 1))
                    of_merge = call([program, "merge", "out", "--out", "merged", "--quiet"], folder)
                    assert files(folder / "merged") == whole, f"{shards} shards: other bytes"
                    merges[shards].append(of_merge)
                    seconds[shards].append(of_shards + of_merge)
                    shutil.rmtree(folder / "merged")
                else:
                    seconds[0].append(call([*sweep, "out"], folder))
                    whole = files(folder / "out")
                shutil.rmtree(folder / "out")
                over = f", {100 * (seconds[shards][-1] / seconds[0][-1] - 1):+.1f} %" if shards else ""
                print(f"round {turn + 1}, {shards or 'no'} shards: {seconds[shards][-1]:.2f} s{over}", flush=True)
        small = {1: [], 20: []}
        for pair in range(min(PAIRS, options.runs // 20)):
            for size, found in small.items():
                found.append(call([*sweep, "out", "--shard", f"{1 + pair * 20 // size}/{options.runs // size}"], folder))
                shutil.rmtree(folder / "out")
    one, twenty = (1000 * statistics.mean(found) for found in small.values())
    run = (twenty - one) / 19
    print(f"a run: {run:.1f} ms, a shard by itself: {one - run:.1f} ms ({len(small[1])} pairs)")
    print(f"no shards: {statistics.median(seconds[0]):.2f} s, {min(seconds[0]):.2f} to {max(seconds[0]):.2f}")
    for shards in options.shards:
        over = [100 * (a / b - 1) for a, b in zip(seconds[shards], seconds[0])]
        print(f"{shards} shards: {statistics.median(seconds[shards]):.2f} s, of which merge {statistics.median(merges[shards]):.2f} s; "
              f"over no shards {statistics.median(over):+.1f} % ({min(over):+.1f} to {max(over):+.1f}); the same bytes")


if __name__ == "__main__":
    main()
