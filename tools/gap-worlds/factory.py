"""Logs with a hidden effect from a factory floor: racks on thin uprights, a round wall, a slanted corridor, people who walk, parked pallets.
Own rays, clutter, noise, drive and effects; standard library only.

    python3 factory.py OUT [CASE ...]

writes OUT/CASE/scenario.yaml, measured.log, truth.json (and floor.yaml, the map).
"""

import bisect
import json
import math
import random
import sys
from pathlib import Path

TAU = 2 * math.pi
DEG = math.pi / 180


def wrap(a):
    return (a + math.pi) % TAU - math.pi


# ---- the building -------------------------------------------------------------------------------------------------------------------------

def arc(cx, cy, r, a0, a1, n):
    return [(round(cx + r * math.cos(a0 + (a1 - a0) * i / n), 4), round(cy + r * math.sin(a0 + (a1 - a0) * i / n), 4)) for i in range(n + 1)]


ROUND = arc(20.0, 5.0, 5.0, -math.pi / 2, 0.0, 10)
OUTLINE = [(0.0, 0.0), (9.5, 0.0), (9.5, -0.6), (12.0, -0.6), (12.0, 0.0)] + ROUND + [(25.0, 14.0), (15.0, 14.0), (12.4, 18.2), (9.7, 18.2), (12.3, 14.0),
                                                                                    (0.0, 14.0), (0.0, 8.2), (-0.5, 8.2), (-0.5, 6.4), (0.0, 6.4)]


def square(x, y, side):
    s = side / 2
    return [(round(x - s, 4), round(y - s, 4)), (round(x + s, 4), round(y - s, 4)), (round(x + s, 4), round(y + s, 4)), (round(x - s, 4), round(y + s, 4))]


UPRIGHTS = ([square(3.0 + 1.45 * i, y, 0.09) for y in (3.2, 4.3, 7.4, 8.5) for i in range(5)]
            + [square(13.0 + 1.45 * i, y, 0.09) for y in (8.0, 9.1) for i in range(4)])
SOLID = [[(12.8, 3.4), (16.1, 2.9), (16.3, 4.3), (13.0, 4.8)], arc(20.6, 9.4, 0.4, 0.0, TAU * 15 / 16, 15)]
OBSTACLES = UPRIGHTS + SOLID


def edges(points):
    return [(*a, *b) for a, b in zip(points, points[1:] + points[:1])]


# Edges with the free side to the left: the outline counter-clockwise, obstacles clockwise. Their number is the index of a wall.
WALLS = edges(OUTLINE) + [e for o in OBSTACLES for e in edges(o[::-1])]
BOTTOM, FAR_RIGHT, TOP_LEFT = 0, OUTLINE.index((25.0, 5.0)), OUTLINE.index((12.3, 14.0))
MACHINE = range(len(WALLS) - 20, len(WALLS) - 16)

# ---- the drive: sections of a rounded polyline, forwards or backwards ---------------------------------------------------------------------

SECTIONS = [
    (1, [(8.5, 1.3), (9.6, 1.4), (11.0, 1.8), (17.5, 1.6), (21.6, 2.9), (22.9, 6.5), (22.4, 9.5), (20.8, 11.4), (18.8, 10.0), (19.0, 7.6), (21.5, 7.4),
         (22.8, 9.5), (21.4, 12.2), (16.0, 12.3), (13.9, 13.4), (11.7, 16.9)]),
    (-1, [(11.7, 16.9), (13.6, 13.85), (14.6, 12.2), (17.6, 11.3)]),
    (1, [(17.6, 11.3), (14.0, 12.1), (9.0, 11.3), (3.5, 11.9), (1.2, 9.9), (1.3, 6.3), (4.0, 5.8), (11.2, 5.9), (11.2, 3.0)]),
]


def rounded(points, times=4):
    for _ in range(times):
        out = [points[0]]
        for (ax, ay), (bx, by) in zip(points, points[1:]):
            out += [(0.75 * ax + 0.25 * bx, 0.75 * ay + 0.25 * by), (0.25 * ax + 0.75 * bx, 0.25 * ay + 0.75 * by)]
        points = out + [points[-1]]
    return points


class Drive:
    def __init__(self, seed):
        rng = random.Random(seed)
        phase, self.t, self.rows = rng.uniform(0, TAU), [], []
        time = 0.0
        for sign, stops in SECTIONS:
            moved = [stops[0]] + [(x + rng.uniform(-0.12, 0.12), y + rng.uniform(-0.12, 0.12)) for x, y in stops[1:-1]] + [stops[-1]]
            if sign < 0 or moved[0] != SECTIONS[0][1][0]:
                moved[1] = stops[1]  # where the direction changes both tangents agree
            line = rounded(moved)
            xs, ys = [], []
            for (ax, ay), (bx, by) in zip(line, line[1:]):
                n = max(1, round(math.hypot(bx - ax, by - ay) / 0.01))
                xs += [ax + (bx - ax) * i / n for i in range(n)]
                ys += [ay + (by - ay) * i / n for i in range(n)]
            n = len(xs)
            raw = [math.atan2(ys[min(i + 1, n - 1)] - ys[max(i - 1, 0)], xs[min(i + 1, n - 1)] - xs[max(i - 1, 0)]) for i in range(n)]
            flat = [raw[0]]
            for a in raw[1:]:
                flat.append(flat[-1] + wrap(a - flat[-1]))
            total, sums = 0.0, [0.0]
            for a in flat:
                total += a
                sums.append(total)
            smooth = [(sums[min(i + 25, n)] - sums[max(i - 25, 0)]) / (min(i + 25, n) - max(i - 25, 0)) for i in range(n)]
            if self.rows:  # turns on the spot by what is left where the direction changes
                x, y, h, _ = self.rows[-1]
                left = wrap(smooth[0] + (0 if sign > 0 else math.pi) - h)
                for i in range(1, 41):
                    self.t.append(time)
                    self.rows.append((x + (xs[0] - x) * i / 40, y + (ys[0] - y) * i / 40, h + left * i / 40, 0.0))
                    time += 0.025 + abs(left) / 0.5 / 40
            for i in range(n):
                bend = abs(smooth[min(i + 5, n - 1)] - smooth[max(i - 5, 0)]) / 0.1
                v = min(1.2 - max(0.0, math.sin(0.35 * i * 0.01 + phase)) ** 4, 0.9 / max(bend, 1e-6), math.sqrt(2 * 0.5 * 0.01 * (min(i, n - 1 - i) + 1)))
                v = max(v, 0.08 if min(i, n - i) < 5 else 0.2)
                self.t.append(time)
                self.rows.append((xs[i], ys[i], smooth[i] if sign > 0 else smooth[i] + math.pi, sign * v))
                time += 0.01 / v
        self.duration = time

    def __call__(self, time):
        k = min(max(bisect.bisect_right(self.t, time) - 1, 0), len(self.t) - 2)
        w = min(max((time - self.t[k]) / (self.t[k + 1] - self.t[k]), 0.0), 1.0)
        a, b = self.rows[k], self.rows[k + 1]
        return (a[0] + w * (b[0] - a[0]), a[1] + w * (b[1] - a[1]), wrap(a[2] + w * wrap(b[2] - a[2])))

    def speed(self, time):
        k = min(max(bisect.bisect_right(self.t, time) - 1, 0), len(self.t) - 1)
        return self.rows[k][3]


# ---- rays ---------------------------------------------------------------------------------------------------------------------------------

def sweep(lx, ly, dirs, lh, first, step, segments, discs):
    """Ranges and what was hit of a fan of beams: each segment is drawn over the beams that it covers."""
    n = len(dirs)
    z, hit = [math.inf] * n, [None] * n

    def covered(lo, width):
        rel = (lo - first) % TAU
        for base in (rel, rel - TAU):
            a, b = math.ceil((base - 1e-9) / step), math.floor((base + width + 1e-9) / step)
            yield from range(max(a, 0), min(b, n - 1) + 1)

    for index, (ax, ay, bx, by) in enumerate(segments):
        px, py = ax - lx, ay - ly
        a0 = math.atan2(py, px) - lh
        turn = wrap(math.atan2(by - ly, bx - lx) - lh - a0)
        ex, ey = bx - ax, by - ay
        cross = px * ey - py * ex
        for k in covered(a0 if turn >= 0 else a0 + turn, abs(turn)):
            dx, dy = dirs[k]
            det = dx * ey - dy * ex
            if abs(det) > 1e-12:
                t = cross / det
                if 0 < t < z[k]:
                    z[k], hit[k] = t, index
    for cx, cy, r in discs:
        px, py = cx - lx, cy - ly
        d = math.hypot(px, py)
        if d <= r:
            continue
        half = math.asin(r / d)
        for k in covered(math.atan2(py, px) - lh - half, 2 * half):
            b = dirs[k][0] * px + dirs[k][1] * py
            root = b * b - d * d + r * r
            if root >= 0 and b - math.sqrt(root) < z[k]:
                z[k], hit[k] = b - math.sqrt(root), -1
    return z, hit


def one_ray(x, y, angle, segments, discs):
    """The same by another way, for single rays: the crossing by line parameters."""
    dx, dy = math.cos(angle), math.sin(angle)
    best, hit = math.inf, None
    for i, (ax, ay, bx, by) in enumerate(segments):
        sa, sb = (ax - x) * dy - (ay - y) * dx, (bx - x) * dy - (by - y) * dx  # sides of the ray's line
        if (sa > 0) == (sb > 0):
            continue
        w = sa / (sa - sb)
        t = (ax + w * (bx - ax) - x) * dx + (ay + w * (by - ay) - y) * dy
        if 1e-6 < t < best:
            best, hit = t, i
    for cx, cy, r in discs:
        b = (cx - x) * dx + (cy - y) * dy
        off = abs((cx - x) * dy - (cy - y) * dx)
        if off <= r and 0 < b - math.sqrt(r * r - off * off) < best:
            best, hit = b - math.sqrt(r * r - off * off), -1
    return best, hit


# ---- clutter ------------------------------------------------------------------------------------------------------------------------------

WALL_BLOCKS = (0.12, 0.5), (0.12, 0.4), (0.0, 0.5), 30  # length, width, gap to the wall (m), yaw (deg)
FREE_BLOCKS = (0.1, 0.3), (0.1, 0.3), (0.0, 5.0), 30  # legs anywhere on the floor


def rectangle(x, y, length, width, yaw):
    c, s = math.cos(yaw), math.sin(yaw)
    return edges([(x + c * u - s * v, y + s * u + c * v) for u, v in ((-length / 2, -width / 2), (length / 2, -width / 2), (length / 2, width / 2),
                                                                     (-length / 2, width / 2))])


def boxes(rng, density, kind):
    length, width, free, turn = kind
    out = []
    for ax, ay, bx, by in WALLS:
        span = math.hypot(bx - ax, by - ay)
        ux, uy = (bx - ax) / span, (by - ay) / span
        at = rng.expovariate(density)
        while at < span:
            long, wide, gap, yaw = rng.uniform(*length), rng.uniform(*width), rng.uniform(*free), rng.uniform(-turn, turn) * DEG
            off = gap + 0.5 * (long * abs(math.sin(yaw)) + wide * math.cos(yaw))
            out.append((ax + ux * at - uy * off, ay + uy * at + ux * off, long, wide, math.atan2(uy, ux) + yaw))
            at += rng.expovariate(density)
    return out


def clear(b, x, y, least):
    c, s = math.cos(b[4]), math.sin(b[4])
    u, v = c * (x - b[0]) + s * (y - b[1]), -s * (x - b[0]) + c * (y - b[1])
    return math.hypot(max(abs(u) - b[2] / 2, 0), max(abs(v) - b[3] / 2, 0)) > least


WALKS = [[(1.5, 2.3), (12.0, 2.2), (17.0, 2.2), (21.0, 5.0)], [(11.0, 1.5), (11.2, 6.5), (11.0, 12.5)], [(1.0, 5.9), (11.0, 5.8), (18.5, 6.2)],
         [(23.5, 5.5), (23.3, 12.5), (16.5, 11.0)], [(2.0, 10.2), (9.0, 10.3), (14.0, 11.0), (13.4, 14.5)], [(1.2, 12.5), (1.0, 3.0)]]


class Person:
    """Walks to and fro on a line, at about 1 m/s, and stands for a while now and then."""

    def __init__(self, rng, line):
        self.points = [(x + rng.uniform(-0.4, 0.4), y + rng.uniform(-0.4, 0.4)) for x, y in line]
        self.v, self.stand = rng.uniform(0.8, 1.2), rng.uniform(0.0, 6.0)
        self.lengths = [math.dist(a, b) for a, b in zip(self.points, self.points[1:])]
        self.start = rng.uniform(0, 60)

    def legs(self, time):
        total = sum(self.lengths)
        period = 2 * (total / self.v + self.stand)
        u = (time + self.start) % period
        back = u >= period / 2
        s = min((u - period / 2 if back else u) * self.v, total)
        walking = s < total
        s = total - s if back else s
        for (ax, ay), (bx, by), span in zip(self.points, self.points[1:], self.lengths):
            if s <= span or (bx, by) == self.points[-1]:
                w = min(s / span, 1.0)
                ux, uy = (bx - ax) / span, (by - ay) / span
                x, y = ax + w * (bx - ax), ay + w * (by - ay)
                stride = 0.22 * math.sin(TAU * 0.9 * time + self.start) if walking else 0.0
                return [(x - uy * 0.1 + ux * stride, y + ux * 0.1 + uy * stride, 0.06), (x + uy * 0.1 - ux * stride, y - ux * 0.1 - uy * stride, 0.06)]
            s -= span


PALLETS = [(8.0, 1.0, 1.2, 0.8, 0.1), (23.9, 7.5, 0.8, 1.2, 0.05), (6.2, 12.9, 1.2, 0.8, -0.1), (17.4, 13.0, 1.2, 0.8, 0.3), (11.0, 8.4, 0.8, 1.2, 0.2)]


# ---- the world ----------------------------------------------------------------------------------------------------------------------------

class World:
    truth, covariate = None, None
    clutter, people, resample = "people", 6, "each_observation"
    scenario_density, kind = 0.06, FREE_BLOCKS
    reference_error = None  # metres, radians, seconds
    rate, scans = 5.5, 400
    noise, max_range = 0.012, 20.0
    mount, mount_off = (0.34, 0.0, 0.0), (0.0, 0.0, 0.0)
    other_rate = False
    beams, first, step = 271, -135 * DEG, 1 * DEG

    def __init__(self, seed):
        self.rng, self.own = random.Random(seed), random.Random(seed + 77)
        self.drive = Drive(seed + 5)
        self.counts = dict(readings=0, front=0, lost=0, far=0)

    # What cases override.
    def walls(self):
        return WALLS

    def things(self):
        return []

    def when(self, time, bearing):
        """When the beam of a scan of this stamp is taken; None if `shift` says it for the scan as a whole."""
        return None

    def shift(self, time):
        return time

    def bias(self, b):
        return 0.0

    def sigma(self, b):
        return self.noise

    def lost(self, b):
        return 0.0

    def stray(self, time):
        return 0.0

    def reading(self, z, b):
        return z

    def finish(self, out, nominal, time):
        return out

    def wheels(self, forward, turn, time, pose):
        return forward, turn

    def reference(self, pose, time):
        return pose

    def surroundings(self, time, robot):
        rng = self.rng
        blocks, discs = [], []
        if self.clutter == "blocks":
            blocks = [b for b in boxes(rng, self.scenario_density, self.kind) if clear(b, robot[0], robot[1], 0.35)]
        if self.clutter in ("standing", "people+standing"):
            if not hasattr(self, "standing"):
                way = [self.drive(0.25 * i) for i in range(int(4 * self.drive.duration))]
                self.standing = [b for b in boxes(rng, self.scenario_density, self.kind) if all(clear(b, x, y, 0.35) for x, y, _ in way)]
            blocks += self.standing
        if "pallets" in self.clutter:
            third = self.scans / self.rate / 3
            for i, p in enumerate(PALLETS):
                if (i % 3) * third <= time < (i % 3 + 1) * third:
                    blocks.append(p)
        if "people" in self.clutter:
            if not hasattr(self, "crowd"):
                self.crowd = [Person(rng, WALKS[i % len(WALKS)]) for i in range(self.people)]
            for person in self.crowd:
                legs = person.legs(time)
                if math.dist(legs[0][:2], robot[:2]) > 0.7:
                    discs += legs
        return [e for b in blocks for e in rectangle(*b)], discs

    def laser(self, pose):
        x, y, h = pose
        mx, my, mt = (a + b for a, b in zip(self.mount, self.mount_off))
        return x + mx * math.cos(h) - my * math.sin(h), y + mx * math.sin(h) + my * math.cos(h), h + mt

    def scan(self, time):
        rng, walls = self.rng, self.world
        at = self.shift(time)
        pose = self.drive(at)
        lx, ly, lh = self.laser(pose)
        extra, discs = self.surroundings(at, pose)
        discs = discs + self.things()
        segments = walls + extra
        bearings = [self.first + i * self.step for i in range(self.beams)]
        dirs = [(math.cos(lh + b), math.sin(lh + b)) for b in bearings]
        own_pose = self.when(time, 0.0) is not None
        if own_pose:
            z, hit = [], []
        else:
            z, hit = sweep(lx, ly, dirs, lh, self.first, self.step, segments, discs)
        out, nominal = [], []
        for k, bearing in enumerate(bearings):
            if own_pose:
                px, py, ph = self.laser(self.drive(self.when(time, bearing)))
                zk, hk = one_ray(px, py, ph + bearing, segments, discs)
                angle = ph + bearing
            else:
                zk, hk, px, py, angle = z[k], hit[k], lx, ly, lh + bearing
            nominal.append(zk)
            wall = hk if hk is not None and 0 <= hk < len(walls) else None
            incidence = 0.0
            if hk is not None and hk >= 0:
                ax, ay, bx, by = segments[hk]
                incidence = math.acos(min(1.0, abs(math.cos(angle) * (by - ay) - math.sin(angle) * (bx - ax)) / math.hypot(bx - ax, by - ay)))
            b = dict(z=zk, incidence=incidence, bearing=bearing, angle=angle, time=time, wall=wall, k=k, x=px, y=py, segments=segments, discs=discs,
                     place=(px + zk * math.cos(angle), py + zk * math.sin(angle)) if zk < 99 else (99, 99))
            r = zk
            if zk < math.inf:
                r = zk + self.bias(b) + rng.gauss(0, self.sigma(b))
            r = self.reading(r, b)
            if rng.random() < 0.004 or rng.random() < self.lost(b):
                r = self.max_range
                self.counts["lost"] += 1
            if rng.random() < 0.003 or rng.random() < self.stray(time):
                r = rng.uniform(0.0, self.max_range)
            self.counts["readings"] += 1
            self.counts["front"] += wall is None and zk < self.max_range
            self.counts["far"] += zk >= self.max_range
            out.append(min(max(r, 0.02), self.max_range))
        return self.finish(out, nominal, time)

    def odometer(self, times):
        """Poses of the wheels at these times, with noise."""
        rng = self.rng
        x, y, h = 3.0, -1.0, 0.4  # a frame of its own
        out, last = [], self.drive(times[0])
        for i, time in enumerate(times):
            pose = self.drive(time)
            if i:
                turn = wrap(pose[2] - last[2])
                middle = last[2] + turn / 2
                forward = (pose[0] - last[0]) * math.cos(middle) + (pose[1] - last[1]) * math.sin(middle)
                forward, turn = self.wheels(forward, turn, time, pose)
                forward += rng.gauss(0, 0.02 * abs(forward))
                turn += rng.gauss(0, 0.02 * abs(turn) + 0.005 * abs(forward))
                x, y, h = x + forward * math.cos(h + turn / 2), y + forward * math.sin(h + turn / 2), wrap(h + turn)
            out.append((x, y, h))
            last = pose
        return out

    def write(self, folder):
        rng = self.rng
        self.world = self.walls()
        times = [0.5 + i / self.rate for i in range(self.scans)]
        assert times[-1] < self.drive.duration, self.drive.duration
        ranges = [[round(z, 3) for z in self.scan(t)] for t in times]
        # All stamps of odometry: those of scans, and others in between where the reference has a clock of its own.
        references = [0.31 + i / 10.7 for i in range(int((times[-1] + 0.3) * 10.7))] if self.other_rate else times
        ticks = sorted(set(times) | set(references) | ({0.21 + i / 20 for i in range(int(times[-1] * 20 + 8))} if self.other_rate else set()))
        wheels = dict(zip(ticks, self.odometer(ticks)))
        error, last = [0.0, 0.0, 0.0], None
        lines = []
        mx, my, mt = self.mount
        head = ["# CARMEN Logfile", f"PARAM robot_frontlaser_offset {mx} 0 w 0", f"PARAM robot_frontlaser_side_offset {my} 0 w 0",
                f"PARAM robot_frontlaser_angular_offset {mt:.9f} 0 w 0"]
        scan_at, reference_at = dict(zip(times, ranges)), set(references)
        for t in ticks:
            end = f"{t + 1000:.6f} w {t + 1000:.6f}"
            ox, oy, oh = wheels[t]
            robot = f"{ox:.9f} {oy:.9f} {oh:.9f}"
            lines.append(f"ODOM {robot} 0 0 0 {end}")
            if t in reference_at:
                px, py, ph = self.reference(self.drive(t), t)
                if self.reference_error:
                    sm, sr, tau = self.reference_error
                    keep = 0.0 if last is None else math.exp(-(t - last) / tau)
                    error = [keep * e + math.sqrt(1 - keep * keep) * rng.gauss(0, s) for e, s in zip(error, (sm, sm, sr))]
                    last = t
                    px, py, ph = px + error[0], py + error[1], wrap(ph + error[2])
                lines.append(f"TRUEPOS {px:.9f} {py:.9f} {ph:.9f} {robot} {end}")
            if t in scan_at:
                laser = (f"{ox + mx * math.cos(oh) - my * math.sin(oh):.9f} {oy + mx * math.sin(oh) + my * math.cos(oh):.9f} {wrap(oh + mt):.9f}")
                z = " ".join(f"{v:.3f}" for v in scan_at[t])
                lines.append(f"ROBOTLASER1 0 {self.first:.9f} {self.step * (self.beams - 1):.9f} {self.step:.9f} {self.max_range} 0.001 0 {self.beams} {z}"
                             f" 0 {laser} {robot} 0 0 0 0 0 {end}")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "measured.log").write_text("\n".join(head + lines) + "\n")
        points = lambda ps: "[" + ", ".join(f"[{x}, {y}]" for x, y in ps) + "]"
        (folder / "floor.yaml").write_text(f"outline:\n  name: outline\n  points_m: {points(OUTLINE)}\nobstacles:\n"
                                           + "".join(f"  - name: obstacle {i}\n    points_m: {points(o)}\n" for i, o in enumerate(OBSTACLES)))
        (folder / "scenario.yaml").write_text(
            f"name: factory\nseed: 1\ntrials: 2\nmap: {{file: floor.yaml}}\nblocks:\n  per_metre_of_wall: {self.scenario_density}\n"
            f"  length_m: {list(self.kind[0])}\n  width_m: {list(self.kind[1])}\n  yaw_deg: [-{self.kind[3]}, {self.kind[3]}]\n"
            f"  wall_distance_m: {list(self.kind[2])}\n  resample: {self.resample}\n"
            f"robot:\n  path: {{waypoints: {{points_m: [[8.5, 1.3], [12.0, 1.8]], speed_m_s: 0.8, turn_rate_deg_s: 50}}}}\n"
            f"  odometry_noise: {{alpha: [0.02, 0.005, 0.02, 0.005]}}\n"
            f"laser:\n  rate_hz: {self.rate}\n  beams: {self.beams}\n  field_of_view_deg: {(self.beams - 1) * self.step / DEG:.6f}\n  max_range_m: {self.max_range}\n"
            f"  resolution_m: 0.001\n  noise: {{sigma_m: {self.noise}}}\n  mount: {{x_m: {mx}, y_m: {my}, yaw_deg: {mt / DEG:.6f}}}\n"
            "effects:\n  - {name: range_dropout, p: 0.004, exponent: 0}\n  - {name: crosstalk, p: 0.003, share: 1}\n"
            "models: [likelihood_field]\nfilter:\n  particles: 500\n  motion: {model: odometry, alpha: [0.05, 0.05, 0.05, 0.05]}\n"
            "  start: {tracking: {sigma_m: 0.1, sigma_deg: 3}}\n")
        (folder / "truth.json").write_text(json.dumps(dict(names=self.truth or [], covariate=self.covariate)) + "\n")
        c = self.counts
        return f"in front {c['front'] / c['readings']:.3f}, lost {c['lost'] / c['readings']:.3f}, beyond range {c['far'] / c['readings']:.3f}"


CASES = {}


def case(truth=None, covariate=None, **settings):
    def add(world):
        CASES[world.__name__] = type(world.__name__, (world,), dict(truth=truth, covariate=covariate, **settings))
        return CASES[world.__name__]
    return add


ERR = (0.01, 0.2 * DEG, 2.0)


# -- nothing hidden

@case(clutter="blocks", scenario_density=0.12, kind=WALL_BLOCKS)
class n_blocks(World):
    pass


@case(clutter="standing", resample="never", scenario_density=0.12, kind=WALL_BLOCKS)
class n_standing(World):
    pass


@case(scenario_density=0.04, kind=WALL_BLOCKS)
class n_people_walls(World):
    pass


@case()
class n_people(World):
    pass


@case(clutter="blocks")
class n_blocks_free(World):
    pass


@case(resample="never")
class n_people_never(World):
    pass


@case(clutter="people+pallets", people=3, scenario_density=0.12, kind=WALL_BLOCKS)
class n_pallets(World):
    pass


@case(reference_error=ERR)
class n_reference(World):
    pass


@case(clutter="people+pallets", people=3, reference_error=ERR, resample="never", rate=6.0, scenario_density=0.12, kind=WALL_BLOCKS)
class n_pallets_reference(World):
    pass


@case(other_rate=True, mount=(-0.3, 0.1, math.pi), rate=6.0)
class n_back(World):
    pass


# -- in the library

@case(["range_bias"])
class bias(World):
    def bias(self, b):
        return 0.02


@case(["range_scale"], reference_error=ERR)
class scale(World):
    def bias(self, b):
        return 0.005 * b["z"]


@case(["incidence_dropout"])
class dropout(World):
    def lost(self, b):
        return 0.5 / (1 + math.exp(-(b["incidence"] / DEG - 68) / 3))


@case(["mount_yaw"], reference_error=ERR)
class yaw(World):
    mount_off = (0.0, 0.0, 0.7 * DEG)


@case(["time_offset"], other_rate=True)
class late(World):
    def shift(self, time):
        return time - 0.06


@case(["sector_occlusion"])
class sector(World):
    def reading(self, z, b):
        return 0.28 + self.rng.gauss(0, self.noise) if 98 * DEG < b["bearing"] < 109 * DEG else z


@case(["glass"])
class glass(World):
    def reading(self, z, b):
        if b["wall"] == FAR_RIGHT and self.rng.random() < 0.5:
            return z + self.own.uniform(0.8, 5.0) if self.own.random() < 0.6 else self.max_range
        return z


def moved(walls, index, out):
    walls = list(walls)
    ax, ay, bx, by = walls[index]
    n = math.hypot(bx - ax, by - ay)
    nx, ny, ux, uy = (by - ay) / n * out, -(bx - ax) / n * out, (bx - ax) / n * abs(out), (by - ay) / n * abs(out)
    walls[index] = (ax + nx - ux, ay + ny - uy, bx + nx + ux, by + ny + uy)
    return walls


@case(["moved_wall"])
class wall(World):
    def walls(self):
        return moved(WALLS, TOP_LEFT, 0.12)


@case(["missing_object"])
class drum(World):
    def things(self):
        return [(17.8, 6.0, 0.3)]


@case(["odom_distance_scale"])
class odometry(World):
    def wheels(self, forward, turn, time, pose):
        return 1.025 * forward, turn


@case(["crosstalk"])
class interference(World):
    def stray(self, time):
        return 0.15 if (time % 11) < 2.3 else 0.0


@case(["mixed_pixels"])
class mixed(World):
    def finish(self, out, nominal, time):
        z = list(out)
        for i in range(1, len(z)):
            near, far = sorted((nominal[i - 1], nominal[i]))
            if far - near > 0.3 and far < self.max_range and self.rng.random() < 0.4:
                z[i] = near + self.rng.random() * (far - near)
        return z


@case(["heavy_tail"])
class tail(World):
    def sigma(self, b):
        return self.noise * (6 if self.rng.random() < 0.05 else 1)


@case(["range_noise"])
class noise_far(World):
    def sigma(self, b):
        return self.noise * math.hypot(1, b["z"] / 8)


@case(["quantization"])
class steps(World):
    def finish(self, out, nominal, time):
        return [z if z >= self.max_range else 0.05 * round(z / 0.05) for z in out]


@case(["motion_skew"])
class skew(World):
    """A rotating laser, stamped at the middle beam: 1/rate for a whole turn."""

    def when(self, time, bearing):
        return time + bearing / TAU / self.rate


@case(["motion_skew", "time_offset"])
class skew_first(World):
    """The same, stamped at the first beam."""

    def when(self, time, bearing):
        return time + (bearing - self.first) / TAU / self.rate


# -- in another form

@case(["range_scale"])
class scale_bent(World):
    def bias(self, b):
        return 0.06 * (1 - math.exp(-b["z"] / 4))


@case(["warmup_drift"])
class warmup(World):
    def bias(self, b):
        return 0.05 * max(0.0, 1 - b["time"] / 50)


@case(["incidence_dropout"])
class dropout_cosine(World):
    def lost(self, b):
        return 0.7 * (1 - math.cos(b["incidence"])) ** 2


@case(["range_dropout"])
class beyond_12(World):
    def lost(self, b):
        return 1.0 if b["z"] > 12 else 0.0


# -- outside

@case(covariate="bearing")
class sun(World):
    """Returns are lost towards a low sun in the door: a direction of the world, not of the laser."""

    def lost(self, b):
        return 0.6 if abs(wrap(b["angle"] - 160 * DEG)) < 22 * DEG else 0.0


@case(covariate="place")
class dark(World):
    def bias(self, b):
        return 0.03 if b["wall"] is not None and (b["wall"] in MACHINE or b["wall"] in (FAR_RIGHT, TOP_LEFT)) else 0.0


@case(covariate="place")
class mirror(World):
    """Four metres of the bottom wall are polished steel."""

    def reading(self, z, b):
        if b["wall"] == BOTTOM and 4 < b["place"][0] < 8 and self.rng.random() < 0.7:
            more, _ = one_ray(b["place"][0], b["place"][1] + 1e-4, -b["angle"], b["segments"], b["discs"])
            return z + more
        return z


@case(covariate="speed")
class nod(World):
    """The robot nods when it brakes: beams ahead end on the floor."""

    def reading(self, z, b):
        t = b["time"]
        brake = (abs(self.drive.speed(t - 0.15)) - abs(self.drive.speed(t + 0.15))) / 0.3
        if brake > 0.2 and self.drive.speed(t) > 0 and abs(b["bearing"]) < 75 * DEG:
            pitch = min(0.12 * brake, 0.08)
            return min(z, 0.25 / math.tan(pitch) / math.cos(b["bearing"]) + self.rng.gauss(0, 0.04))
        return z


@case(covariate="odometry")
class slip_place(World):
    """An oily floor at the round wall: wheels turn 15 % too far there."""

    def wheels(self, forward, turn, time, pose):
        return (1.15 * forward if pose[0] > 18 and pose[1] < 7 else forward), turn


@case(covariate="time")
class jump(World):
    def reference(self, pose, time):
        return (pose[0] + 0.08, pose[1] + 0.06, pose[2]) if time > 36 else pose


@case(covariate="time")
class repeated(World):
    """One scan of fifteen is the one before with a new stamp."""

    def finish(self, out, nominal, time):
        again = getattr(self, "last", None)
        self.last = out
        return again if again and self.rng.random() < 1 / 15 else out


@case(covariate="odometry")
class frozen(World):
    def wheels(self, forward, turn, time, pose):
        return (0.0, 0.0) if 21 < time < 23 else (forward, turn)


@case(covariate="range")
class coarse_far(World):
    def finish(self, out, nominal, time):
        return [0.1 * round(z / 0.1) if 8 < z < self.max_range else z for z in out]


@case(covariate="time")
class heading_drift(World):
    def reference(self, pose, time):
        return pose[0], pose[1], wrap(pose[2] + 1.2 * DEG * time / 73)


@case(covariate="odometry")
class gyro(World):
    """A gyro whose zero drifts away, up to 1.5 deg/s."""

    def wheels(self, forward, turn, time, pose):
        return forward, turn + 1.5 * DEG * (time / 73) / self.rate


# -- two at once

@case(["range_bias", "incidence_dropout"])
class bias_and_dropout(bias, dropout):
    pass


@case(["mount_yaw", "odom_distance_scale"], reference_error=ERR)
class yaw_and_odometry(yaw, odometry):
    pass


@case(["range_scale", "missing_object"])
class scale_and_drum(scale, drum):
    pass


def main():
    out = Path(sys.argv[1])
    for name in sys.argv[2:] or list(CASES):
        seed = sum((i + 3) * ord(c) for i, c in enumerate(name))
        print(name, CASES[name](seed).write(out / name), flush=True)


if __name__ == "__main__":
    main()
