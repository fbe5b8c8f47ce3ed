#!/usr/bin/env python3
"""What the merge of 1,000 shards with 10^7 rows takes.

usage: tools/sweep-figures/merge.py --shards FOLDER [--locsim PROGRAM] [--rounds N]

FOLDER has made-up shards, 1.2 GB, that a test of the sweep writes:

    LOCSIM_SYNTHETIC_SHARDS=FOLDER cargo test --workspace --lib -- --ignored synthesize_shards

Each round merges them into a new folder beside them, which is removed.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shards", type=Path, required=True, help="the folder of shards")
    parser.add_argument("--locsim", default="locsim", help="the program")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    walls = []
    for turn in range(options.rounds):
        with tempfile.TemporaryDirectory(dir=options.shards.parent) as folder:
            began = time.monotonic()
            process = subprocess.Popen([options.locsim, "merge", str(options.shards), "--out", f"{folder}/merged", "--quiet"])
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            if process.returncode:
                raise SystemExit(f"the merge failed with {process.returncode}")
            walls.append(time.monotonic() - began)
            shutil.rmtree(f"{folder}/merged")
            print(f"round {turn + 1}: {walls[-1]:.1f} s of wall time, {usage.ru_utime + usage.ru_stime:.1f} s of processor time, "
                  f"{usage.ru_maxrss / 1024:.0f} MB at most; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", flush=True)
    print(f"wall time: {statistics.median(walls):.1f} s, {min(walls):.1f} to {max(walls):.1f}")


if __name__ == "__main__":
    main()
