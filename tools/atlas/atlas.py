#!/usr/bin/env python3
"""The atlas: how strong an effect must be before `locsim gap` finds it in 9 of 10 logs, by laser, drive length and clutter.

usage: tools/atlas/atlas.py [--locsim PROGRAM] [--rows FILE] [--design N] [--rounds N] [--doses N] [--checks N] [--minutes M] [--docs DOCS]

A search tells for effects of one number the strength that it would find with 90 % probability (`detectable`). The design's logs have no
effect and lie on random parts of the path of scenarios/gap/nominal.yaml in up to 36 settings. The logarithm of that strength is regressed
on the logarithms of the setting, effect by effect. For the other effects logs have a random strength about the threshold (doses), and whether the effect is
found is regressed on the logarithms of strength and setting. The check's logs lie in settings that these haven't, and have one effect of the
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
from typing import NamedTuple

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


class Dosed(NamedTuple):
    """An effect whose strength is told by logs that have it."""

    strength: str
    unit: str
    first: float  # strength in the middle setting, from which the logs go up where it is missed and down where it is found
    greatest: float  # logs have no more
    acts_on: str = "readings"
    what: str = ""


DOSED = {
    "incidence_dropout": Dosed("p", "", 0.05, 1.0, what="beyond 60 degrees"),
    "range_dropout": Dosed("p", "", 0.1, 1.0, what="exponent 4, of 8 m"),
    "mixed_pixels": Dosed("p", "", 0.3, 1.0),
    "glass": Dosed("p", "", 0.1, 1.0, what="a stretch of 1.5 m beside the drive"),
    "moved_wall": Dosed("distance_m", "m", 0.02, 0.5, what="a stretch of 1.5 m beside the drive"),
    "missing_object": Dosed("radius_m", "m", 0.08, 0.4, what="0.5 to 1.2 m beside the drive, off the walls"),
    "mount_offset": Dosed("length", "m", 0.01, 0.3, what="in any direction"),
    "warmup_drift": Dosed("bias_m", "m", 0.004, 0.5, what="`tau_secs` 10"),
    "sector_occlusion": Dosed("p", "", 0.1, 1.0, what="30 degrees at 0.3 m"),
    "quantization": Dosed("step_m", "m", 0.02, 0.05, what="a step of lasers on the market"),
    "block_density": Dosed("factor - 1", "", 0.5, 19.0, "clutter"),
    "block_depth": Dosed("factor - 1", "", 0.3, 9.0, "clutter"),
    "odom_distance_scale": Dosed("k", "", 0.01, 0.5, "odometry"),
    "odom_turn_scale": Dosed("k", "", 0.02, 0.5, "odometry"),
    "odom_imbalance": Dosed("turn_deg_per_m", "deg/m", 0.5, 57.0, "odometry"),
    "wheel_slip": Dosed("p", "", 0.1, 1.0, "odometry", "`share` 0.2"),
}
# The steps that a search looks for: others aren't named however coarse they are.
STEPS_M = (0.002, 0.003, 0.005, 0.01, 0.02, 0.025, 0.05)
# Their logs: a search costs as its readings, so that no log has many, and those of few come twice.
MOST_BEAM_METRES = 432.0
CHEAP = [(3.0, 18), (3.0, 36), (3.0, 72), (6.0, 18), (6.0, 36), (12.0, 18)]
DOSE_SETTINGS = CHEAP[:3] + [(12.0, 36)] + CHEAP[3:] + [(6.0, 72)] + CHEAP[:3] + [(24.0, 18)] + CHEAP[3:]
# The zero of their regression, in the middle of their logs.
CENTRE = (6.0, 36.0, 0.5)
# What is believed of exponents before the logs, beside the ten effects' for those of readings: the odometry doesn't know the laser; a share of the blocks is known as they are many.
EXPONENTS = {"odometry": (-0.5, 0.0, 0.0), "clutter": (-0.5, -0.5, -0.5)}
EXPONENT_DEVIATION = 0.3
# d logit(found) / d log strength: that of a test that finds a shift of the wanted size in 9 of 10 logs is 5 to 6, places along the path make it half.
SLOPE, SLOPE_DEVIATION = math.log(3.5), 0.4
LEVEL_DEVIATION = 3.0
WANTED = math.log(0.9 / 0.1)
BOOTSTRAPS = 400
# Straight walls of the corridor, [x, x, y].
WALLS = [(0.0, 4.3, 0.0), (5.2, 9.9, 0.0), (11.1, 17.0, 0.0), (17.9, 20.0, 0.0), (0.0, 2.0, 4.0), (2.9, 6.5, 4.0), (7.7, 14.2, 4.0), (15.1, 20.0, 4.0)]
STRETCH_M = 1.5
# Numbers of logs begin here: doses (1,000 for each effect), the check's of the ten, of the others, logs with steps of any size.
DOSE, CHECK, DOSE_CHECK, ANY_STEP = 10_000, 100_000, 200_000, 300_000


def is_design(row):
    return row["number"] < DOSE


def is_dose(row):
    return DOSE <= row["number"] < CHECK


def is_check(row):
    return CHECK <= row["number"] < ANY_STEP


def covariates(setting, zero=REFERENCE):
    return np.array([1.0] + [math.log(a / b) for a, b in zip(setting, zero)])


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


def point_of(part, rng):
    """A random point of a polyline."""
    lengths = [math.dist(a, b) for a, b in zip(part, part[1:])]
    a, b = rng.choices(list(zip(part, part[1:])), lengths)[0]
    share = rng.random()
    return [a[k] + (b[k] - a[k]) * share for k in (0, 1)]


def stretch_beside(part, rng):
    """The stretch of a straight wall nearest to a random point of the drive, on a random side."""
    x, y = point_of(part, rng)[0], rng.choice((0.0, 4.0))
    half = 0.5 * STRETCH_M
    middles = [min(max(x, a + half), b - half) for a, b, at in WALLS if at == y]
    middle = min(middles, key=lambda middle: abs(middle - x))
    # The robot is on the right of the line from the first end to the second, so that a positive distance is farther for it.
    half = half if y > 0 else -half
    return {"from_m": [round(middle - half, 3), y], "to_m": [round(middle + half, 3), y]}


def place_beside(part, rng):
    """A place that the robot sees from near by, where neither it nor the clutter of the walls gets."""
    while True:
        x, y = point_of(part, rng)
        angle, distance = rng.uniform(-math.pi, math.pi), rng.uniform(0.5, 1.2)
        x, y = x + distance * math.cos(angle), y + distance * math.sin(angle)
        away = min(math.dist((x, y), [a[k] + (b[k] - a[k]) * i / 50 for k in (0, 1)]) for a, b in zip(part, part[1:]) for i in range(51))
        if 0.9 < x < 19.1 and 0.9 < y < 3.1 and away >= 0.5:
            return {"x_m": round(x, 3), "y_m": round(y, 3)}


def effect(name, strength, part, rng):
    sign = rng.choice((-1, 1))
    if name in EFFECTS:
        found = {"name": name, EFFECTS[name][0]: strength if name in ONE_SIDED else sign * strength}
        return found | {"share": 1.0} if name == "crosstalk" else found
    angle = rng.uniform(-math.pi, math.pi)
    # Bearings end at half a turn.
    bearing = lambda away: (math.degrees(angle) + away + 180.0) % 360.0 - 180.0
    return {"name": name} | {
        "incidence_dropout": lambda: {"p": strength, "angle_deg": 60},
        "glass": lambda: {"p": strength, **stretch_beside(part, rng)},
        "moved_wall": lambda: {"distance_m": sign * strength, **stretch_beside(part, rng)},
        "missing_object": lambda: {"radius_m": strength, **place_beside(part, rng)},
        "mount_offset": lambda: {"x_m": strength * math.cos(angle), "y_m": strength * math.sin(angle)},
        "warmup_drift": lambda: {"bias_m": sign * strength, "tau_secs": 10},
        "sector_occlusion": lambda: {"from_deg": bearing(-15), "to_deg": bearing(15), "range_m": 0.3, "p": strength},
        "quantization": lambda: {"step_m": strength},
        "block_density": lambda: {"factor": 1.0 + strength},
        "block_depth": lambda: {"factor": 1.0 + strength},
        "odom_distance_scale": lambda: {"k": sign * strength},
        "odom_turn_scale": lambda: {"k": sign * strength},
        "odom_imbalance": lambda: {"turn_deg_per_m": sign * strength},
        "wheel_slip": lambda: {"p": strength, "share": 0.2},
    }.get(name, lambda: {"p": strength})()


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
            scenario["effects"].append(effect(name, strength, waypoints["points_m"], rng))
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
        rows = [row for row in rows if is_design(row) and name in row["detectable"]]
        self.count = len(rows)
        design = np.array([covariates(setting_of(row)) for row in rows])
        values = np.log([row["detectable"][name] for row in rows])
        self.beta = np.linalg.lstsq(design, values, rcond=None)[0]
        left = values - design @ self.beta
        self.deviation = math.sqrt(left @ left / max(self.count - 4, 1))

    def strength(self, setting):
        return math.exp(covariates(setting) @ self.beta)


class Dose:
    """logit P(found) = logit 0.9 + slope (log strength - level - b . log setting), the most probable one after an effect's logs."""

    def __init__(self, rows, name):
        self.name = name
        acts_on = DOSED[name].acts_on
        exponents = EXPONENTS[acts_on] if acts_on in EXPONENTS else np.mean([Fit(rows, other).beta[1:] for other in NAMES], axis=0)
        self.prior = np.array([math.log(DOSED[name].first), SLOPE, *exponents])
        self.deviations = np.array([LEVEL_DEVIATION, SLOPE_DEVIATION, *[EXPONENT_DEVIATION] * 3])
        self.rows = [row for row in rows if is_dose(row) and row["effect"] == name]
        self.count, self.found = len(self.rows), sum(row["found"] for row in self.rows)
        self.settings = np.array([covariates(setting_of(row), CENTRE)[1:] for row in self.rows]).reshape(-1, 3)
        self.logs = np.log([row["strength"] for row in self.rows])
        self.outcomes = np.array([row["found"] for row in self.rows], dtype=float)
        self.at = self.climb(np.ones(self.count))

    def climb(self, weights):
        """The maximum, by Fisher scoring whose steps are damped until each gains."""
        at, damping = self.prior.copy(), 1e-3
        logit = lambda at: np.clip(WANTED + math.exp(at[1]) * (self.logs - at[0] - self.settings @ at[2:]), -30.0, 30.0)
        value = lambda at: weights @ (self.outcomes * logit(at) - np.log1p(np.exp(logit(at)))) - 0.5 * np.sum(((at - self.prior) / self.deviations) ** 2)
        here = value(at)
        for _ in range(200):
            slope, gap = math.exp(at[1]), self.logs - at[0] - self.settings @ at[2:]
            p = 1.0 / (1.0 + np.exp(-logit(at)))
            slopes = slope * np.column_stack([-np.ones(self.count), gap, -self.settings])
            gradient = slopes.T @ (weights * (self.outcomes - p)) - (at - self.prior) / self.deviations**2
            curvature = (slopes.T * (weights * p * (1.0 - p))) @ slopes + np.diag(self.deviations**-2.0)
            step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), gradient)
            there = value(at + step)
            if there < here:
                damping *= 8.0
                if damping > 1e9:
                    break
                continue
            at, here, damping = at + step, there, damping / 4.0
            if np.max(np.abs(step)) < 1e-7:
                break
        return at

    def strength(self, setting, found=0.9, at=None):
        at = self.at if at is None else at
        return math.exp(at[0] + covariates(setting, CENTRE)[1:] @ at[2:] + (math.log(found / (1.0 - found)) - WANTED) / math.exp(at[1]))

    def bootstrap(self):
        """The law after logs that are drawn from these, with replacement."""
        rng = np.random.default_rng([SEED, NUMBERS[self.name]])
        return [self.climb(rng.multinomial(self.count, np.full(self.count, 1.0 / self.count)).astype(float)) for _ in range(BOOTSTRAPS)]

    def wanted(self, setting):
        """The least strength that there is and that is found in 9 of 10 logs."""
        strength = self.strength(setting)
        return min((step for step in STEPS_M if step >= strength), default=strength) if self.name == "quantization" else strength

    def is_reached(self, setting):
        return self.wanted(setting) <= DOSED[self.name].greatest


NUMBERS = {name: i for i, name in enumerate(DOSED)}


def nearest_step(strength):
    return min(STEPS_M, key=lambda step: abs(math.log(step / strength)))


def dose(rows, name, k):
    """Setting and strength of an effect's log k: after the logs before, it is found with a probability between 0.25 and 0.97."""
    rng = random.Random(f"{SEED}/{name}/{k}")
    turn = 4 * NUMBERS[name]
    length, beams = DOSE_SETTINGS[(k + turn) % len(DOSE_SETTINGS)]
    setting = length, beams, CLUTTER[(k + k // len(DOSE_SETTINGS) + turn) % 3]
    before = [row for row in rows if not is_dose(row) or row["number"] < DOSE + 1000 * NUMBERS[name] + k]
    lo, hi = (math.log(p / (1.0 - p)) for p in (0.25, 0.97))
    found = 1.0 / (1.0 + math.exp(-rng.uniform(lo, hi)))
    strength = min(Dose(before, name).strength(setting, found), DOSED[name].greatest)
    return setting, name, nearest_step(strength) if name == "quantization" else strength


def design_settings():
    """All 36 settings, so that each dozen of them has every length with every laser."""
    return [(length, beams, CLUTTER[(i + j + turn) % 3])
            for turn in range(3) for i, length in enumerate(LENGTHS_M) for j, beams in enumerate(BEAMS)]


def settings_between(seed, count, most_beam_metres=math.inf):
    """Settings between those of the design."""
    rng = random.Random(seed)
    between = lambda lo, hi: math.exp(rng.uniform(math.log(lo), math.log(hi)))
    settings = []
    while len(settings) < count:
        setting = round(between(3.0, 24.0), 2), round(between(18, 72)), round(between(0.25, 1.0), 3)
        if setting[0] * setting[1] <= most_beam_metres:
            settings.append(setting)
    return settings


def check_settings():
    """20 settings, and an effect for each."""
    return list(zip((2 * NAMES)[:20], settings_between(f"{SEED}/check", 20)))


def dose_check(n):
    """Effect and setting of log n of the others' check: 80 pairs of 16 effects and 20 settings."""
    settings = settings_between(f"{SEED}/dose check", 20, MOST_BEAM_METRES)
    return list(DOSED)[n % len(DOSED)], settings[n % 20]


def cases(options, rows):
    """Numbers of logs, each with what tells its setting, effect and strength by the rows so far: the design, its check, doses, their check."""
    for number, setting in enumerate(design_settings()[: options.design]):
        yield number, lambda: (setting,)
    for n in range(20 * options.rounds):
        name, setting = check_settings()[n % 20]
        yield CHECK + n, lambda: (setting, name, Fit(rows, name).strength(setting))
    for k in range(options.doses):
        for name in DOSED:
            yield DOSE + 1000 * NUMBERS[name] + k, lambda: dose(rows, name, k)
    for n in range(options.checks):
        name, setting = dose_check(n)
        if Dose(rows, name).is_reached(setting):
            yield DOSE_CHECK + n, lambda: (setting, name, Dose(rows, name).wanted(setting))


def run(options, rows, store):
    """Runs the logs that aren't there yet."""
    done = {row["number"] for row in rows}
    began = time.monotonic()
    for number, case_of in cases(options, rows):
        if number in done:
            continue
        if options.minutes is not None and time.monotonic() - began > 60 * options.minutes:
            return
        case = case_of()
        row = search(options.locsim, number, *case)
        rows.append(row)
        store.write(json.dumps(row) + "\n")
        store.flush()
        print(f"{number}: {case}: {row['named']}, {row['seconds']} s", flush=True)


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


def named_strength(name):
    key, unit = EFFECTS[name] if name in EFFECTS else DOSED[name][:2]
    return key, unit


def told(law, setting):
    """A predicted strength; that it is above what was tried, where it is."""
    if isinstance(law, Dose) and not law.is_reached(setting):
        return f"> {digits(DOSED[law.name].greatest)}"
    return digits(law.wanted(setting) if isinstance(law, Dose) else law.strength(setting))


def figure(rows, laws, path):
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams.update({"svg.hashsalt": "atlas", "font.size": 9, "svg.fonttype": "none"})
    from matplotlib import lines as lines_2d, pyplot, ticker

    colours = dict(zip(BEAMS, ("#0072b2", "#e69f00", "#009e73")))
    # One more for the legend.
    figure, axes = pyplot.subplots(-(-(len(laws) + 1) // 5), 5, figsize=(13, 0.52 * (len(laws) + 4)), layout="constrained")
    for panel, (name, law) in zip(axes.flat, laws.items()):
        for beams, colour in colours.items():
            setting = lambda length: (length, beams, REFERENCE[2])
            reached = [length for length in LENGTHS_M if isinstance(law, Fit) or law.is_reached(setting(length))]
            if isinstance(law, Dose) and law.found == law.count:
                reached = []  # logs that all have it say no strength
            panel.plot(reached, [law.strength(setting(length)) for length in reached], color=colour, label=f"{beams} beams")
            if isinstance(law, Fit):
                logs = [(row["length_m"], row["detectable"][name], True) for row in rows if is_design(row) and row["beams"] == beams and name in row["detectable"]]
            else:
                # Beside each other, by laser.
                aside = 1.0 + 0.06 * (BEAMS.index(beams) - 1)
                logs = [(row["length_m"] * aside, row["strength"], row["found"]) for row in law.rows if row["beams"] == beams]
            for is_filled in (True, False):
                chosen = [log[:2] for log in logs if log[2] == is_filled]
                if chosen:
                    panel.plot(*zip(*chosen), "o", markersize=3, color=colour, markerfacecolor=colour if is_filled else "none", markeredgewidth=0.6)
        panel.set(xscale="log", yscale="log", title=name)
        panel.set_xticks(LENGTHS_M, [f"{length:g}" for length in LENGTHS_M])
        panel.xaxis.set_minor_locator(ticker.NullLocator())
        lo, hi = panel.get_ylim()
        panel.yaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0) if hi / lo < 100 else (1.0,)))
        panel.yaxis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:g}"))
        panel.yaxis.set_minor_locator(ticker.NullLocator())
        key, unit = named_strength(name)
        panel.set_ylabel(f"{key} [{unit}]" if unit else key)
        panel.set_xlabel("drive [m]")
    rest = axes.flat[len(laws):]
    for panel in rest:
        panel.axis("off")
    mark = lambda fill: lines_2d.Line2D([], [], linestyle="none", marker="o", markersize=4, color="black", markerfacecolor=fill)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    legend = rest[0].legend([*handles, mark("black"), mark("none")], [*labels, "found, or told by the search", "missed"], loc="center left", frameon=False)
    # Wider than its panel, which is to be as wide as the others.
    legend.set_in_layout(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})
    # No space at the ends of lines.
    path.write_text("\n".join(line.rstrip() for line in path.read_text().splitlines()) + "\n")


def table(head, lines):
    return "\n".join(f"| {' | '.join(line)} |" for line in [head, ["---"] * len(head), *lines])


def check_table(rows):
    head = ["effect", "length (m)", "beams", "blocks per m", "strength", "named", "found"]
    cases = [[row["effect"], f"{row['length_m']:g}", str(row["beams"]), f"{row['clutter']:g}", digits(row["strength"]),
              ", ".join("/".join(found) for found in row["named"]) or "-", "yes" if row["found"] else "no"] for row in rows]
    return table(head, cases)


def publish(rows, docs):
    design, doses = list(filter(is_design, rows)), list(filter(is_dose, rows))
    check, dose_rows = ([row for row in rows if is_check(row) and (row["effect"] in EFFECTS) == first] for first in (True, False))
    fits = {name: Fit(rows, name) for name in NAMES if sum(name in row["detectable"] for row in design) > 5}
    dosed = {name: Dose(rows, name) for name in DOSED}
    laws = fits | dosed
    figure(rows, laws, docs / "images/atlas.svg")
    law = [[name, f"`{EFFECTS[name][0]}`{' (' + EFFECTS[name][1] + ')' if EFFECTS[name][1] else ''}", digits(fit.strength(REFERENCE)),
            *[f"{slope:+.2f}" for slope in fit.beta[1:]], f"{fit.deviation:.2f}", str(fit.count)] for name, fit in fits.items()]
    head = ["effect", "strength", "24 m, 72 beams, 0.5 blocks/m", "per log length", "per log beams", "per log clutter", "scatter", "logs"]
    dose_law = []
    for name, found in dosed.items():
        drawn = sorted(found.strength(CENTRE, at=at) for at in found.bootstrap())
        lo, hi = (digits(drawn[round(share * (len(drawn) - 1))]) for share in (0.025, 0.975))
        key, unit = named_strength(name)
        strength = f"`{key}`" + (f" ({unit})" if unit else "") + (f", {DOSED[name].what}" if DOSED[name].what else "")
        if found.found < found.count:
            law_of = [f"{told(found, CENTRE)} [{lo}, {hi}]", *[f"{slope:+.2f}" for slope in found.at[2:]], f"{math.exp(found.at[1]):.1f}"]
        else:
            law_of = [f"at most {digits(min(row['strength'] for row in found.rows))}", *4 * ["-"]]
        dose_law.append([name, strength, *law_of, f"{found.found} of {found.count}", digits(max(row["strength"] for row in found.rows))])
    dose_head = ["effect", "strength", "6 m, 36 beams, 0.5 blocks/m", "per log length", "per log beams", "per log clutter", "slope", "found", "most tried"]
    columns = [(length, beams) for beams in BEAMS for length in LENGTHS_M]
    lines = [[name, *[told(found, (length, beams, REFERENCE[2])) for length, beams in columns]] for name, found in laws.items()]
    false = [row for row in design if row["named"]]
    unseen = len({setting_of(row) for row in check})
    left_out = [(name, setting) for name, setting in map(dose_check, range(80)) if not dosed[name].is_reached(setting)]
    any_step = [row for row in rows if row["number"] >= ANY_STEP]
    off_step = [row for row in any_step if not any(math.isclose(row["strength"] / step, round(row["strength"] / step)) for step in STEPS_M)]
    of_odometry, others = ([row for row in dose_rows if (DOSED[row["effect"]].acts_on == "odometry") == first] for first in (True, False))
    of_effect = {name: [row["found"] for row in dose_rows if row["effect"] == name] for name in DOSED}
    by_effect = [f"{name} {sum(found)} of {len(found)}" for name, found in of_effect.items()]
    (docs / "atlas.md").write_text(f"""# Atlas of effects

How strong must an effect be before `locsim gap` finds it in 9 of 10 logs? By laser (beams over 360 degrees, noise 1 cm), length of the drive, and
clutter, in the corridor of [`scenarios/gap/nominal.yaml`](../scenarios/gap/nominal.yaml). It is written by

```sh
tools/atlas/atlas.py --locsim target/release/locsim --rows docs/reports/atlas.jsonl --docs docs
```

which runs the logs that the rows lack (`--design 36 --rounds 10 --checks 400` for more of them), and needs Python with numpy, PyYAML and matplotlib. Found means: the effect is named,
or in the set of a name.

## What it stands on

**Strengths that a search tells.** {len(design)} logs without an effect in {len(design)} of 36 settings, each on a part of the path of its own, {REPLICATES} simulated logs behind each p-value, seed {SEED}. A
search tells for {len(fits)} of the 26 effects the strength whose score passes the threshold in 9 of 10 logs; these are regressed here. False names in these logs: {len(false)}.

**Strengths by trial.** The other {len(dosed)} have places, bearings or clocks of their own, or act on the odometry or the clutter: the search tells no such strength for them.
{len(doses)} logs have one of them each, at a random strength: after the effect's logs before, it is found with a probability between 0.25 and 0.97. Whether it was found is
regressed: logit P(found) = logit 0.9 + slope (log strength - log of the strength that is wanted), which goes with powers of the setting. Weak priors (standard deviation {EXPONENT_DEVIATION}) draw
the exponents to the mean of the {len(fits)} effects above; of the odometry to -0.5 for length and 0 for beams and clutter; of the clutter to -0.5 for all three. Lasers and
drives of these logs have at most {MOST_BEAM_METRES:.0f} beams times metres; what is told for 72 beams on 12 m, 36 and 72 on 24 m is the law's continuation.

![Strength against length of drive for each effect and laser](images/atlas.svg)

Lines: 0.5 blocks per metre of wall. Points: single logs, all clutters; in the last {len(dosed)} panels filled where the effect was found, and open where it was missed.

## Least strengths

At 0.5 blocks per metre of wall, for 18, 36 and 72 beams and drives of 3, 6, 12 and 24 m. "> x": not found in 9 of 10 logs up to x, the most that was tried.

{table(["effect", *[f"{beams}, {length:g} m" for length, beams in columns]], lines)}

Strength goes as length^a beams^b clutter^c. Of the strengths that a search tells, at the reference; scatter is the standard deviation of log strength about the law:

{table(head, law)}

Of those by trial, with 95 % intervals from {BOOTSTRAPS} bootstraps of the logs; `slope` is that of logit P in log strength:

{table(dose_head, dose_law)}

Coarse steps are looked for at {", ".join(f"{1000 * step:g}" for step in STEPS_M)} mm, the table's strengths. Of {len(any_step)} logs with steps of {1000 * min(row["strength"] for row in any_step):.0f} to
{1000 * max(row["strength"] for row in any_step):.0f} mm in the same settings, those whose step is a multiple of one of these had it named in {sum(row["found"] for row in any_step if row not in off_step)} of
{len(any_step) - len(off_step)} logs, the others in {sum(row["found"] for row in off_step)} of {len(off_step)}.

## Check

Fresh logs in settings that no log above has, drawn between the least and the greatest, each with one effect of the strength predicted for 9 of 10.

Strengths that a search tells, {len(check)} logs in {unseen} settings:

- the effect is found: {share(check, lambda row: row["found"])}
- anything is named: {share(check, lambda row: bool(row["named"]))}

Strengths by trial, {len(dose_rows)} logs in {len({setting_of(row) for row in dose_rows})} settings of at most {MOST_BEAM_METRES:.0f} beams times metres:

- the effect is found: {share(dose_rows, lambda row: row["found"])}
- anything is named: {share(dose_rows, lambda row: bool(row["named"]))}
- by effect: {", ".join(by_effect)}
- of the odometry {share(of_odometry, lambda row: row["found"])}, others {share(others, lambda row: row["found"])}, a division that was made after the check
- left out, as the law says that it isn't found up to the most that was tried: {len(left_out)} of 80 pairs of effect and setting ({", ".join(sorted({name for name, _ in left_out})) or "none"})

Asked for was a share within 5 points of 0.90 in each setting. For that, each setting needs some 140 logs; what is said here is the share over all settings.
The law of {len(doses) // len(dosed)} logs errs itself: a strength that is right on average is found less often than in 9 of 10 logs, as P bends down there.

{check_table(check)}

{check_table(dose_rows)}
""")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--locsim", default="locsim", help="the program")
    parser.add_argument("--rows", type=Path, default=ROOT / "docs/reports/atlas.jsonl", help="one line for each log")
    parser.add_argument("--design", type=int, default=24, help="logs of the design, at most 36")
    parser.add_argument("--rounds", type=int, default=1, help="logs of the check in each of its 20 settings")
    parser.add_argument("--doses", type=int, default=26, help="logs of each effect that a search tells no strength for, at most 1,000")
    parser.add_argument("--checks", type=int, default=144, help="logs of the check of these")
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
