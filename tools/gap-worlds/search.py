"""Runs `locsim gap` on the logs of worlds.py and prints a table.

    python3 tools/gap-worlds/search.py target/release/locsim OUT [CASE ...] [-- further options of locsim gap]
"""

import json
import resource
import subprocess
import sys
from pathlib import Path


def listed(found):
    form = f" ({found['form_of']})" if found.get("form_of") else ""
    return f"{found['deviation']} over {found['covariate']}{form}"


def main():
    arguments = sys.argv[1:]
    more = arguments[arguments.index("--") + 1:] if "--" in arguments else []
    arguments = arguments[:arguments.index("--")] if "--" in arguments else arguments
    program, out = arguments[0], Path(arguments[1])
    names = arguments[2:] or sorted(p.name for p in out.iterdir() if (p / "truth.json").exists())
    print("| hidden | truth | verdict | named | without a name (form of) | closed | range errors | CPU s |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name in names:
        folder = out / name
        truth = json.loads((folder / "truth.json").read_text())
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        command = [program, "gap", str(folder / "scenario.yaml"), "--log", str(folder / "measured.log"), "--out", str(folder / "found"),
                   "--replicates", "99", "--no-filter", "--threads", "1", "--force", *more]
        run = subprocess.run(command, capture_output=True, text=True)
        seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        if not (folder / "found" / "gap.json").exists():
            print(f"| {name} | | exit {run.returncode} | {run.stderr[-300:]!r} |", flush=True)
            continue
        found = json.loads((folder / "found" / "gap.json").read_text())
        effects = ", ".join(effect["name"] for effect in found["effects"])
        unnamed = "; ".join(listed(u) for u in found["unnamed"])
        right = ", ".join(truth["names"]) or (f"outside, {truth['covariate']}" if truth["covariate"] else "nothing")
        gap = found["gap"]
        closed = f"{gap['closed']['value']:.2f}" if gap["closed"] else "-"
        errors = "{:.1f} -> {:.1f} ({:.1f})".format(*(gap[key]["w1_mm"] for key in ("before", "after", "floor")))
        print(f"| {name} | {right} | {found['verdict']} | {effects} | {unnamed} | {closed} | {errors} | {seconds:.0f} |", flush=True)


if __name__ == "__main__":
    main()
