#!/usr/bin/env python3
"""The atlas: how strong an effect must be before `locsim gap` finds it in 9 of 10 logs, by laser, drive length and clutter.

usage: tools/atlas/atlas.py [--locsim PROGRAM] [--rows FILE] [--design N] [--rounds N] [--minutes M] [--docs DOCS]

A search tells for effects of one number the strength that it would find with 90 % probability (`detectable`). The design's logs have no
effect and lie on random parts of the path of scenarios/gap/nominal.yaml in up to 36 settings. The logarithm of that strength is regressed
on the logarithms of the setting, effect by effect. The check's logs lie in settings that the design hasn't, and have one effect of the
strength predicted for them. Logs that FILE has aren't run again; with --minutes, none is begun later. --docs writes atlas.md and
images/atlas.svg there.

Needs numpy, PyYAML and matplotlib. Everything random comes from the number of a log.
"""

import argparse
import json
import math
import random
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[2]
SEED = 22
REPLICATES = 99
# Drive lengths [m] (short ones more often: a search costs as its log is long), beams over 360 degrees, blocks per metre of wall; the regression's zero is the last, last and middle one.
LENGTHS_M, BEAMS, CLUTTER = (3.0, 6.0, 12.0, 24.0), (18, 36, 72), (0.25, 0.5, 1.0)
REFERENCE = (24.0, 72.0, 0.5)
# Effects whose strength is one number, that number's key, and its unit.
EFFECTS = {
    "range_bias": ("bias_m", "m"),
    "range_scale": ("k", ""),
    "incidence_bias": ("bias_m", "m"),
    "range_noise": ("growth", "1/m"),
    "incidence_noise": ("growth", ""),
    "heavy_tail": ("p", ""),
    "mount_yaw": ("yaw_deg", "deg"),
    "time_offset": ("delay_secs", "s"),
    "motion_skew": ("sweep_secs", "s"),
    "crosstalk": ("p", ""),
}
NAMES = list(EFFECTS)
ONE_SIDED = ("range_noise", "incidence_noise", "heavy_tail", "crosstalk")
# Numbers of the check's logs begin here.
CHECK = 100_000


def covariates(setting):
    return np.array([1.0] + [math.log(a / b) for a, b in zip(setting, REFERENCE)])


def part_of(points, start, length):
    """The part of a polyline from `start` on, `length` long."""
    part, at = [], 0.0
    for a, b in zip(points, points[1:]):
        step = math.dist(a, b)
        lo, hi = max(start, at), min(start + length, at + step)
        if lo < hi:
            ends = [[a[k] + (b[k] - a[k]) * (s - at) / step for k in (0, 1)] for s in (lo, hi)]
            part += ends if not part else ends[1:]
        at += step
    return [[round(x, 4), round(y, 4)] for x, y in part]


def effect(name, strength, rng):
    sign = 1 if name in ONE_SIDED else rng.choice((-1, 1))
    found = {"name": name, EFFECTS[name][0]: sign * strength}
    return found | {"share": 1.0} if name == "crosstalk" else found


def call_of(words, folder):
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}: {done.stderr}")
    return done.stdout


def search(locsim, number, setting, name=None, strength=0.0):
    """Makes a log with an effect, or without, searches it, and says what was named and what would have been found."""
    rng = random.Random(f"{SEED}/{number}")
    length, beams, clutter = setting
    scenario = yaml.safe_load((ROOT / "scenarios/gap/nominal.yaml").read_text())
    waypoints = scenario["robot"]["path"]["waypoints"]
    whole = sum(math.dist(a, b) for a, b in zip(waypoints["points_m"], waypoints["points_m"][1:]))
    waypoints["points_m"] = part_of(waypoints["points_m"], rng.uniform(0.0, whole - length), length)
    scenario["map"]["file"] = str(ROOT / "maps/corridor.yaml")
    scenario["laser"]["beams"] = int(beams)
    scenario["blocks"]["per_metre_of_wall"] = clutter
    scenario["filter"]["beams"] = min(scenario["filter"]["beams"], int(beams))
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "nominal.yaml").write_text(yaml.safe_dump(scenario))
        if name:
            scenario["effects"].append(effect(name, strength, rng))
        (Path(folder) / "hidden.yaml").write_text(yaml.safe_dump(scenario))
        call_of([locsim, "simulate", "hidden.yaml", "--out", "log.mcap", "--seed", str(number + 1)], folder)
        call = [locsim, "gap", "nominal.yaml", "--log", "log.mcap", "--out", "found", "--scans", "10000", "--beams", "72"]
        call += ["--replicates", str(REPLICATES), "--no-filter", "--quiet", "--json", "--threads", "1", "--seed", str(number + 1)]
        outcome = json.loads(call_of(call, folder))
    scale = lambda found: 180.0 / math.pi if found["parameter"] == "yaw_rad" else 1.0
    return {
        "number": number, "length_m": length, "beams": beams, "clutter": clutter, "effect": name, "strength": strength,
        "scans": outcome["scans"], "verdict": outcome["verdict"], "seconds": round(outcome["seconds"], 1),
        "named": [found["candidates"] for found in outcome["effects"]],
        "found": any(name in found["candidates"] for found in outcome["effects"]),
        "detectable": {found["name"]: found["value"] * scale(found) for found in outcome["detectable"]},
    }


def setting_of(row):
    return row["length_m"], row["beams"], row["clutter"]


class Fit:
    """log strength of an effect = a + b . log setting, by least squares over the design's logs that tell it."""

    def __init__(self, rows, name):
        rows = [row for row in rows if row["number"] < CHECK and name in row["detectable"]]
        self.count = len(rows)
        design = np.array([covariates(setting_of(row)) for row in rows])
        values = np.log([row["detectable"][name] for row in rows])
        self.beta = np.linalg.lstsq(design, values, rcond=None)[0]
        left = values - design @ self.beta
        self.deviation = math.sqrt(left @ left / max(self.count - 4, 1))

    def strength(self, setting):
        return math.exp(covariates(setting) @ self.beta)


def design_settings():
    """All 36 settings, so that each dozen of them has every length with every laser."""
    return [(length, beams, CLUTTER[(i + j + turn) % 3])
            for turn in range(3) for i, length in enumerate(LENGTHS_M) for j, beams in enumerate(BEAMS)]


def check_settings():
    """20 settings between those of the design, and an effect for each."""
    rng = random.Random(f"{SEED}/check")
    between = lambda lo, hi: math.exp(rng.uniform(math.log(lo), math.log(hi)))
    settings = [(round(between(3.0, 24.0), 2), round(between(18, 72)), round(between(0.25, 1.0), 3)) for _ in range(20)]
    return list(zip((2 * NAMES)[:20], settings))


def run(options, rows, store):
    """Runs the logs that aren't there yet: first the design's, then the check's."""
    done = {row["number"] for row in rows}
    began = time.monotonic()

    def add(number, *case, **more):
        if number in done or (options.minutes is not None and time.monotonic() - began > 60 * options.minutes):
            return
        row = search(options.locsim, number, *case) | more
        rows.append(row)
        store.write(json.dumps(row) + "\n")
        store.flush()
        print(f"{number}: {case}: {row['named']}, {row['seconds']} s", flush=True)

    for number, setting in enumerate(design_settings()[: options.design]):
        add(number, setting)
    for n in range(20 * options.rounds):
        name, setting = check_settings()[n % 20]
        add(CHECK + n, setting, name, Fit(rows, name).strength(setting))


def interval(count, of):
    """Clopper and Pearson's 95 % interval of a share, by bisection of the binomial distribution."""
    tail = lambda p, lo: sum(math.comb(of, k) * p**k * (1 - p) ** (of - k) for k in range(lo, of + 1))

    def solve(target, lo):
        a, b = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (a + b)
            a, b = (middle, b) if tail(middle, lo) < target else (a, middle)
        return 0.5 * (a + b)

    return solve(0.025, count) if count else 0.0, solve(0.975, count + 1) if count < of else 1.0


def share(rows, found):
    count, of = sum(map(found, rows)), len(rows)
    if not of:
        return "no logs"
    lo, hi = interval(count, of)
    return f"{count} of {of} ({count / of:.2f} [{lo:.2f}, {hi:.2f}])"


def digits(value):
    return f"{value:.2g}" if value >= 1e-4 else f"{value:.1e}".replace("e-0", "e-")


def figure(rows, fits, path):
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams.update({"svg.hashsalt": "atlas", "font.size": 9, "svg.fonttype": "none"})
    from matplotlib import pyplot

    colours = dict(zip(BEAMS, ("#0072b2", "#e69f00", "#009e73")))
    figure, axes = pyplot.subplots(2, 5, figsize=(13, 5.6), layout="constrained")
    for panel, (name, fit) in zip(axes.flat, fits.items()):
        for beams, colour in colours.items():
            panel.plot(LENGTHS_M, [fit.strength((length, beams, REFERENCE[2])) for length in LENGTHS_M], color=colour, label=f"{beams} beams")
            found = [row for row in rows if row["number"] < CHECK and row["beams"] == beams and name in row["detectable"]]
            panel.plot([row["length_m"] for row in found], [row["detectable"][name] for row in found], ".", color=colour)
        panel.set(xscale="log", yscale="log", title=name)
        panel.set_xticks(LENGTHS_M, [f"{length:g}" for length in LENGTHS_M])
        panel.minorticks_off()
        unit = EFFECTS[name][1]
        panel.set_ylabel(f"{EFFECTS[name][0]} [{unit}]" if unit else EFFECTS[name][0])
        panel.set_xlabel("drive [m]")
    for panel in axes.flat[len(fits):]:
        panel.remove()
    axes.flat[0].legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})
    # No space at the ends of lines.
    path.write_text("\n".join(line.rstrip() for line in path.read_text().splitlines()) + "\n")


def table(head, lines):
    return "\n".join(f"| {' | '.join(line)} |" for line in [head, ["---"] * len(head), *lines])


def publish(rows, docs):
    design, check = ([row for row in rows if (row["number"] < CHECK) == first] for first in (True, False))
    fits = {name: Fit(rows, name) for name in NAMES if sum(name in row["detectable"] for row in design) > 5}
    figure(rows, fits, docs / "images/atlas.svg")
    law = [[name, f"`{EFFECTS[name][0]}`{' (' + EFFECTS[name][1] + ')' if EFFECTS[name][1] else ''}", digits(fit.strength(REFERENCE)),
            *[f"{slope:+.2f}" for slope in fit.beta[1:]], f"{fit.deviation:.2f}", str(fit.count)] for name, fit in fits.items()]
    head = ["effect", "strength", "24 m, 72 beams, 0.5 blocks/m", "per log length", "per log beams", "per log clutter", "scatter", "logs"]
    columns = [(length, beams) for beams in BEAMS for length in LENGTHS_M]
    lines = [[name, *[digits(fit.strength((length, beams, REFERENCE[2]))) for length, beams in columns]] for name, fit in fits.items()]
    cases = [[row["effect"], f"{row['length_m']:g}", str(row["beams"]), f"{row['clutter']:g}", digits(row["strength"]),
              ", ".join("/".join(found) for found in row["named"]) or "-", "yes" if row["found"] else "no"] for row in check]
    false = [row for row in design if row["named"]]
    unseen = len({setting_of(row) for row in check})
    (docs / "atlas.md").write_text(f"""# Atlas of effects

How strong must an effect be before `locsim gap` finds it in 9 of 10 logs? By laser (beams over 360 degrees, noise 1 cm), length of the drive, and
clutter, in the corridor of [`scenarios/gap/nominal.yaml`](../scenarios/gap/nominal.yaml). It is written by

```sh
tools/atlas/atlas.py --locsim target/release/locsim --rows docs/reports/atlas.jsonl --docs docs
```

which runs the logs that the rows lack (`--design 36 --rounds 10` for all of them), and needs Python with numpy, PyYAML and matplotlib.

## What it stands on

{len(design)} logs without an effect in {len(design)} of 36 settings, each on a part of the path of its own, {REPLICATES} simulated logs behind each p-value, seed {SEED}. A search tells for
{len(fits)} of the 26 effects the strength whose score passes the threshold in 9 of 10 logs; these are regressed here. The other {26 - len(fits)} have places,
bearings or clocks of their own, or act on the odometry or the clutter: the search tells no such strength for them, and this atlas **lacks them**. False names in these logs: {len(false)}.

![Strength against length of drive for each effect and laser](images/atlas.svg)

Lines: 0.5 blocks per metre of wall. Points: single logs, all clutters.

## Least strengths

At 0.5 blocks per metre of wall, for 18, 36 and 72 beams and drives of 3, 6, 12 and 24 m:

{table(["effect", *[f"{beams}, {length:g} m" for length, beams in columns]], lines)}

Strength at the reference, and exponents: strength goes as length^a beams^b clutter^c. Scatter is the standard deviation of log strength about the law.

{table(head, law)}

## Check

{len(check)} fresh logs in {unseen} settings that no log above has, drawn between the least and the greatest, each with one effect of the strength predicted for 9 of 10:

- the effect is named, or in the set of a name: {share(check, lambda row: row["found"])}
- anything is named: {share(check, lambda row: bool(row["named"]))}

Asked for was a share within 5 points of 0.90 in each setting. For that, each setting needs some 140 logs; what is said here is the share over all settings.

{table(["effect", "length (m)", "beams", "blocks per m", "strength", "named", "found"], cases)}
""")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--locsim", default="locsim", help="the program")
    parser.add_argument("--rows", type=Path, default=ROOT / "docs/reports/atlas.jsonl", help="one line for each log")
    parser.add_argument("--design", type=int, default=36, help="logs of the design, at most 36")
    parser.add_argument("--rounds", type=int, default=1, help="logs of the check in each of its 20 settings")
    parser.add_argument("--minutes", type=float, help="begin no log later")
    parser.add_argument("--docs", type=Path, help="write atlas.md and images/atlas.svg into this folder")
    options = parser.parse_args()
    rows = [json.loads(line) for line in options.rows.read_text().splitlines()] if options.rows.exists() else []
    with options.rows.open("a") as store:
        run(options, rows, store)
    if options.docs:
        publish(rows, options.docs)


if __name__ == "__main__":
    main()
