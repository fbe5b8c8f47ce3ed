"""Logs with a hidden effect from worlds that share no code with locsim: a hall with slanted walls and a pillar, and an office with rooms and
round columns; their own rays, clutter, noise and effects. Each case is a scenario (what the simulation knows) and a CARMEN log (what was measured). Standard library only.

    python3 tools/gap-worlds/worlds.py OUT [CASE ...]

writes OUT/CASE/scenario.yaml, OUT/CASE/measured.log and OUT/CASE/truth.json, for all cases where none is named.
`search.py` beside this file runs `locsim gap` on them and prints a table.
"""

import json
import math
import random
import sys
from pathlib import Path



class Hall:
    """Metres, counter-clockwise: no wall but two is along an axis."""
    outline = [(0.0, 0.0), (6.0, -0.5), (6.2, -1.7), (8.4, -1.8), (8.6, -0.4), (14.0, 0.0), (14.6, 5.6), (9.0, 6.4), (8.8, 7.6), (6.4, 7.5),
               (6.2, 6.5), (0.6, 6.0)]
    obstacles = [[(6.9, 2.6), (7.6, 2.7), (7.5, 3.4), (6.8, 3.3)]]
    stops = [(1.6, 1.4), (5.0, 1.2), (9.4, 1.5), (12.6, 1.6), (12.8, 4.2), (9.6, 4.8), (5.2, 4.9), (2.0, 4.5), (1.6, 1.4), (4.6, 1.9), (10.6, 2.0),
             (12.2, 3.4)]
    pause = 0.0  # seconds at each stop
    wall, surfaces, thing = 6, (0, 4, 6, 10), (10.5, 4.4)  # a long wall, walls of another surface, where something new stands


def partition(ax, ay, bx, by, thickness=0.12):
    """A thin wall along an axis."""
    t = thickness / 2
    return [(ax - t, ay - t), (bx + t, ay - t), (bx + t, by + t), (ax - t, by + t)]


def column(x, y, radius, corners=12):
    angles = [2 * math.pi * i / corners for i in range(corners)]
    return [(round(x + radius * math.cos(a), 4), round(y + radius * math.sin(a), 4)) for a in angles]


class Office:
    """A corridor between rooms with doors; the robot waits at each stop."""
    outline = [(0.0, 0.0), (17.0, 0.0), (17.0, 10.4), (0.0, 10.4)]
    obstacles = ([partition(ax, 4.2, bx, 4.2) for ax, bx in ((0.06, 2.0), (3.0, 7.6), (8.6, 13.4), (14.4, 16.94))]
                 + [partition(ax, 6.2, bx, 6.2) for ax, bx in ((0.06, 4.4), (5.4, 10.2), (11.2, 16.94))]
                 + [partition(x, 0.06, x, 4.02) for x in (5.2, 11.4)] + [partition(x, 6.38, x, 10.34) for x in (7.8, 13.0)]
                 + [column(8.4, 2.2, 0.25), column(10.4, 8.4, 0.2)])
    stops = [(1.0, 5.2), (2.5, 5.2), (2.5, 2.2), (4.0, 1.6), (2.5, 2.6), (2.5, 5.2), (8.1, 5.1), (8.1, 3.2), (6.6, 1.4), (8.1, 3.4), (8.1, 5.2), (10.7, 5.3),
             (10.7, 7.3), (9.2, 8.0), (10.7, 7.0), (10.7, 5.2), (15.6, 5.3)]
    pause = 1.5
    wall, surfaces, thing = 0, (0, 8, 20, 36), (6.2, 3.2)


SPEED, TURN = 0.6, 0.8  # m/s, rad/s
SCANS = 300
LOST, RANDOM = 0.004, 0.003


def wrap(angle):
    return (angle + math.pi) % (2 * math.pi) - math.pi


def edges(points):
    return [(a, b) for a, b in zip(points, points[1:] + points[:1])]


class Drive:
    """The drive as a function of time: turns on the spot and straight lines, with corners rounded over half a second."""

    def __init__(self, floor):
        self.legs = []  # start time, end time, pose at start, turn, length
        stops = floor.stops
        time, heading = 0.0, math.atan2(stops[1][1] - stops[0][1], stops[1][0] - stops[0][0])
        for (ax, ay), (bx, by) in zip(stops, stops[1:]):
            to = math.atan2(by - ay, bx - ax)
            turn, length = wrap(to - heading), math.hypot(bx - ax, by - ay)
            self.legs.append((time, time + abs(turn) / TURN, (ax, ay, heading), turn, 0.0))
            time += abs(turn) / TURN
            self.legs.append((time, time + length / SPEED, (ax, ay, to), 0.0, length))
            time, heading = time + length / SPEED, to
            self.legs.append((time, time + floor.pause, (bx, by, to), 0.0, 0.0))
            time += floor.pause
        self.duration = time

    def __call__(self, time):
        h0 = self.sharp(time)[2]
        near = [self.sharp(time + i / 16) for i in range(-4, 5)]
        return (sum(x for x, _, _ in near) / 9, sum(y for _, y, _ in near) / 9, wrap(h0 + sum(wrap(h - h0) for _, _, h in near) / 9))

    def sharp(self, time):
        time = min(max(time, 0.0), self.duration - 1e-9)
        for start, end, (x, y, heading), turn, length in self.legs:
            if time < end:
                share = (time - start) / max(end - start, 1e-9)
                d = share * length
                return (x + d * math.cos(heading), y + d * math.sin(heading), wrap(heading + share * turn))
        raise AssertionError


def cast(x, y, angle, walls):
    """Range, incidence and index of the first wall."""
    dx, dy = math.cos(angle), math.sin(angle)
    best, hit = math.inf, None
    for i, ((ax, ay), (bx, by)) in enumerate(walls):
        ex, ey = bx - ax, by - ay
        det = dx * ey - dy * ex
        if abs(det) < 1e-12:
            continue
        t = ((ax - x) * ey - (ay - y) * ex) / det
        s = ((ax - x) * dy - (ay - y) * dx) / det
        if 1e-6 < t < best and -1e-9 <= s <= 1 + 1e-9:
            best, hit = t, i
    if hit is None:
        return math.inf, 0.0, None
    (ax, ay), (bx, by) = walls[hit]
    ex, ey = bx - ax, by - ay
    across = abs(dx * ey - dy * ex) / math.hypot(ex, ey)
    return best, math.acos(min(1.0, across)), hit


def box(x, y, length, width, yaw):
    c, s = math.cos(yaw), math.sin(yaw)
    corners = [(u * length / 2, v * width / 2) for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return edges([(x + c * u - s * v, y + s * u + c * v) for u, v in corners])


def clutter(rng, walls, density, robot=(math.inf, math.inf)):
    """Boxes before the walls, none where the robot is."""
    found = []
    for (ax, ay), (bx, by) in walls:
        length = math.hypot(bx - ax, by - ay)
        ux, uy = (bx - ax) / length, (by - ay) / length
        along = rng.expovariate(density)
        while along < length:
            long, wide, gap, yaw = rng.uniform(0.12, 0.3), rng.uniform(0.1, 0.22), rng.uniform(0.0, 0.2), math.radians(rng.uniform(-30, 30))
            off = gap + (long * abs(math.sin(yaw)) + wide * math.cos(yaw)) / 2
            x, y = ax + ux * along - uy * off, ay + uy * along + ux * off
            if math.hypot(x - robot[0], y - robot[1]) > 0.5:
                found += box(x, y, long, wide, math.atan2(uy, ux) + yaw)
            along += rng.expovariate(density)
    return found


def spline(rng, lo, hi, knots):
    """A smooth course through random heights in [0, 1]: cosine pieces."""
    heights = [rng.random() for _ in range(knots)]

    def at(x):
        u = min(max((x - lo) / (hi - lo), 0.0), 1 - 1e-9) * (knots - 1)
        i = int(u)
        w = 0.5 - 0.5 * math.cos(math.pi * (u - i))
        return heights[i] * (1 - w) + heights[i + 1] * w

    return at


class World:
    """The nominal world; cases override a method each."""
    floor = Hall
    noise, max_range = 0.01, 12.0
    truth, covariate = None, None  # names of the library that are right, or what an effect outside it depends on
    stays = False  # clutter
    beams, field, first = 72, 2 * math.pi, -math.pi
    bare = False  # nothing optional in the scenario, nor in the world
    mount = (0.08, 0.0, 0.0)

    def __init__(self, seed):
        self.rng = random.Random(seed)
        self.draw = random.Random(seed + 1)  # of the effect's own shape

    def walls(self):
        return [edge for points in [self.floor.outline] + [obstacle[::-1] for obstacle in self.floor.obstacles] for edge in edges(points)]

    def bearings(self):
        step = self.field / self.beams if self.field > 6.28 else self.field / (self.beams - 1)
        return [self.first + i * step for i in range(self.beams)]

    def mounted(self):
        return self.mount

    def stamp(self, time):
        """When a scan was taken whose stamp is `time`."""
        return time

    def bias(self, z, incidence, bearing, time, place, wall):
        return 0.0

    def sigma(self, z, incidence, bearing, time, place):
        return self.noise

    def lost(self, z, incidence, bearing, time, place, wall):
        return 0.0

    def random_share(self, time):
        return 0.0

    def reading(self, z, b, beam, cast_on):
        """A reading that passes `z` on, or something else instead. `cast_on` casts from a point."""
        return z

    def finish(self, ranges, nominal):
        return ranges

    def step(self, forward, turn):
        """An increment of the wheels."""
        return forward, turn

    def reference(self, pose):
        return pose

    def odometry(self, poses):
        out, x, y, h = [], 0.0, 0.0, 0.0
        for i, pose in enumerate(poses):
            if i:
                a, b = poses[i - 1], pose
                turn = wrap(b[2] - a[2])
                middle = a[2] + turn / 2
                forward = (b[0] - a[0]) * math.cos(middle) + (b[1] - a[1]) * math.sin(middle)
                forward, turn = self.step(forward, turn)
                if not self.bare:
                    forward += self.rng.gauss(0, 0.02 * abs(forward))
                    turn += self.rng.gauss(0, 0.02 * abs(turn) + 0.005 * abs(forward))
                x, y, h = x + forward * math.cos(h + turn / 2), y + forward * math.sin(h + turn / 2), wrap(h + turn)
            out.append((x, y, h))
        return out

    def log(self):
        path, walls, rng = Drive(self.floor), self.walls(), self.rng
        standing = [] if self.bare else clutter(rng, walls, 0.3)
        mx, my, mt = self.mounted()
        times = [2.0 + i * (path.duration - 4.0) / SCANS for i in range(SCANS)]
        scans = []
        for time in times:
            x, y, h = path(self.stamp(time))
            if not self.stays and not self.bare:
                standing = clutter(rng, walls, 0.3, (x, y))
            lx, ly, lh = x + mx * math.cos(h) - my * math.sin(h), y + mx * math.sin(h) + my * math.cos(h), h + mt
            ranges, nominal = [], []
            for beam, bearing in enumerate(self.bearings()):
                angle = lh + bearing
                z, incidence, wall = cast(lx, ly, angle, walls + standing)
                nominal.append(z)
                place = (lx + z * math.cos(angle), ly + z * math.sin(angle))
                b = dict(z=z, incidence=incidence, bearing=bearing, time=time, place=place, wall=wall)
                z = z + self.bias(**b) + rng.gauss(0, self.sigma(z, incidence, bearing, time, place))
                z = self.reading(z, b, beam, lambda px, py, a: cast(px, py, a, walls + standing))
                if not self.bare and rng.random() < LOST or rng.random() < self.lost(**b):
                    z = self.max_range
                if not self.bare and rng.random() < RANDOM or rng.random() < self.random_share(time):
                    z = rng.uniform(0.05, self.max_range)
                ranges.append(min(max(z, 0.05), self.max_range))
            scans.append([round(z, 3) for z in self.finish(ranges, nominal)])
        poses = [path(time) for time in times]
        return times, poses, self.odometry(poses), scans

    def write(self, folder):
        times, poses, odometry, scans = self.log()
        folder.mkdir(parents=True, exist_ok=True)
        mx, my, mt = self.mount
        bearings = self.bearings()
        step = bearings[1] - bearings[0]
        lines = ["# CARMEN Logfile", f"PARAM robot_frontlaser_offset {mx} 0 w 0", f"PARAM robot_frontlaser_side_offset {my} 0 w 0",
                 f"PARAM robot_frontlaser_angular_offset {mt} 0 w 0"]
        for time, pose, (ox, oy, oh), scan in zip(times, poses, odometry, scans):
            end = f"{time:.6f} w {time:.6f}"
            robot = f"{ox:.9f} {oy:.9f} {oh:.9f}"
            px, py, ph = self.reference(pose)
            lines.append(f"ODOM {robot} 0 0 0 {end}")
            lines.append(f"TRUEPOS {px:.9f} {py:.9f} {ph:.9f} {robot} {end}")
            laser = f"{ox + mx * math.cos(oh):.9f} {oy + mx * math.sin(oh):.9f} {oh:.9f}"
            ranges = " ".join(f"{z:.3f}" for z in scan)
            lines.append(f"ROBOTLASER1 0 {bearings[0]:.9f} {step * (len(scan) - 1):.9f} {step:.9f} {self.max_range} 0.001 0 {len(scan)} {ranges}"
                         f" 0 {laser} {robot} 0 0 0 0 0 {end}")
        (folder / "measured.log").write_text("\n".join(lines) + "\n")
        (folder / "hall.yaml").write_text(self.map_yaml())
        (folder / "scenario.yaml").write_text(self.scenario_yaml(bearings, step))
        truth = dict(names=self.truth or [], covariate=self.covariate)
        (folder / "truth.json").write_text(json.dumps(truth) + "\n")

    def map_yaml(self):
        text = "outline:\n  name: outline\n  points_m: [" + ", ".join(f"[{x}, {y}]" for x, y in self.floor.outline) + "]\nobstacles:\n"
        return text + "".join(f"  - name: obstacle {i}\n    points_m: [" + ", ".join(f"[{x}, {y}]" for x, y in points) + "]\n"
                              for i, points in enumerate(self.floor.obstacles))

    def scenario_yaml(self, bearings, step):
        head = "name: hall\nseed: 1\ntrials: 2\nmap: {file: hall.yaml}\n"
        path = f"robot:\n  path: {{waypoints: {{points_m: {[list(stop) for stop in self.floor.stops[:2]]}, speed_m_s: 0.6, turn_rate_deg_s: 46}}}}\n"
        laser = (f"laser:\n  rate_hz: 4\n  beams: {len(bearings)}\n  field_of_view_deg: {math.degrees(step * (len(bearings) - 1)):.9f}\n"
                 f"  max_range_m: {self.max_range}\n  resolution_m: 0.001\n  noise: {{sigma_m: {self.noise}}}\n")
        middle = bearings[0] + 0.5 * step * (len(bearings) - 1)
        laser += f"  mount: {{x_m: {self.mount[0]}, y_m: {self.mount[1]}, yaw_deg: {math.degrees(self.mount[2] + middle):.9f}}}\n"
        tail = ("models: [likelihood_field]\nfilter:\n  particles: 500\n  motion: {model: odometry, alpha: [0.05, 0.05, 0.05, 0.05]}\n"
                "  start: {tracking: {sigma_m: 0.1, sigma_deg: 3}}\n")
        if self.bare:
            return head + path + laser + tail
        return (head + f"blocks:\n  per_metre_of_wall: 0.3\n  length_m: [0.12, 0.3]\n  width_m: [0.1, 0.22]\n  yaw_deg: [-30, 30]\n"
                f"  wall_distance_m: [0.0, 0.2]\n  resample: {'never' if self.stays else 'each_observation'}\n"
                + path + "  odometry_noise: {alpha: [0.02, 0.005, 0.02, 0.005]}\n" + laser
                + "effects:\n  - {name: range_dropout, p: 0.004, exponent: 0}\n  - {name: crosstalk, p: 0.003, share: 1}\n" + tail)


CASES = {}


def case(truth=None, covariate=None, **settings):
    def add(world):
        name = world.__name__
        CASES[name] = type(name, (world,), dict(truth=truth, covariate=covariate, **settings))
        return CASES[name]
    return add


def turned(wall, pivot, angle):
    (ax, ay), (bx, by) = wall
    (px, py), (qx, qy) = (wall if pivot == 0 else wall[::-1])
    c, s = math.cos(angle), math.sin(angle)
    q = (px + c * (qx - px) - s * (qy - py), py + s * (qx - px) + c * (qy - py))
    return ((px, py), q) if pivot == 0 else (q, (px, py))


LASERS = dict(around=dict(), half=dict(beams=181, field=math.pi, first=-math.pi / 2), wide=dict(beams=1080, field=math.radians(270),
              first=math.radians(-135)), fine=dict(beams=360, field=2 * math.pi, first=-math.pi))


@case()
class nothing(World):
    pass


@case(stays=True)
class nothing_stays(World):
    pass


@case(bare=True)
class nothing_bare(World):
    pass


@case(["range_bias"])
class bias(World):
    def bias(self, **b):
        return 0.015


@case(["range_scale"])
class scale(World):
    def bias(self, z, **b):
        return 0.004 * z


@case(["range_scale"])
class scale_square(World):
    def bias(self, z, **b):
        return 0.0011 * z * z


@case(["range_scale"])
class scale_spline(World):
    def bias(self, z, **b):
        self.course = getattr(self, "course", None) or spline(self.draw, 0.0, 9.0, 5)
        return 0.05 * (self.course(z) - self.course(0.0))


@case(["incidence_bias"])
class incidence_spline(World):
    def bias(self, incidence, **b):
        self.course = getattr(self, "course", None) or spline(self.draw, 0.0, 1.5, 5)
        return 0.06 * (self.course(incidence) - self.course(0.0))


@case(["warmup_drift"])
class drift_linear(World):
    def bias(self, time, **b):
        return 0.04 * max(0.0, 1 - time / 40)


@case(["range_noise"])
class noise_range(World):
    def sigma(self, z, *_):
        return self.noise * (1 + 0.15 * z)


@case(["incidence_noise"])
class noise_incidence(World):
    def sigma(self, z, incidence, *_):
        return self.noise * (1 + 4 * max(0.0, incidence - 0.6))


@case(["heavy_tail"])
class tail(World):
    def sigma(self, *_):
        return self.noise * (8 if self.rng.random() < 0.06 else 1)


@case(["incidence_dropout"])
class dropout(World):
    def lost(self, incidence, **b):
        return 0.4 / (1 + math.exp(-(math.degrees(incidence) - 62) / 3))


@case(["incidence_dropout"])
class dropout_linear(World):
    def lost(self, incidence, **b):
        return 0.6 * max(0.0, math.degrees(incidence) - 40) / 50


@case(["range_dropout"])
class lost_far(World):
    def lost(self, z, **b):
        return 0.5 if z > 6 else 0.0


@case(["crosstalk"])
class bursts(World):
    def random_share(self, time):
        return 0.4 if math.sin(time * 1.7) > 0.8 else 0.0


@case(["crosstalk"])
class bursts_of_all(World):
    """All readings of a burst, which begins and ends within a second of the log."""

    def random_share(self, time):
        return 1.0 if math.sin(time * 1.7) > 0.8 else 0.0


@case(["mixed_pixels"])
class mixed(World):
    def finish(self, ranges, nominal):
        out = list(ranges)
        for i in range(1, len(ranges)):
            a, b = nominal[i - 1], nominal[i]
            if abs(a - b) > 0.3 and max(a, b) < self.max_range and self.rng.random() < 0.5:
                out[i] = min(a, b) + self.rng.random() * abs(a - b)
        return out


@case(["mount_yaw"])
class yaw(World):
    mount_error = (0.0, 0.0, math.radians(1.0))

    def mounted(self):
        return tuple(a + b for a, b in zip(self.mount, self.mount_error))


@case(["mount_offset"])
class offset(yaw):
    mount_error = (0.0, 0.04, 0.0)


@case(["time_offset"])
class late(World):
    def stamp(self, time):
        return time - 0.06


@case(["quantization"])
class steps(World):
    def finish(self, ranges, nominal):
        return [z if z == self.max_range else 0.05 * round(z / 0.05) for z in ranges]


@case(["sector_occlusion"])
class sector(World):
    def reading(self, z, b, beam, cast_on):
        return 0.3 + self.rng.gauss(0, 0.01) if 0.4 < b["bearing"] < 0.8 else z


@case(["sector_occlusion"])
class sector_curved(World):
    def reading(self, z, b, beam, cast_on):
        off = b["bearing"] - 0.6
        return 0.25 + 0.8 * off * off + self.rng.gauss(0, 0.01) if abs(off) < 0.35 else z


@case(["glass"])
class glass_wall(World):
    def reading(self, z, b, beam, cast_on):
        if b["wall"] == self.floor.wall and self.rng.random() < 0.5:
            return z + 1.5 + 2 * self.rng.random()
        return z


@case(["missing_object"])
class thing(World):
    def walls(self):
        return super().walls() + box(*self.floor.thing, 0.35, 0.35, 0.5)


class MovedWall(World):
    out, wall = 0.06, 0

    def walls(self):
        walls = super().walls()
        (ax, ay), (bx, by) = walls[self.wall]
        length = math.hypot(bx - ax, by - ay)
        nx, ny = -(by - ay) / length * self.out, (bx - ax) / length * self.out
        # Longer at both ends, so that it still closes the hall.
        ux, uy = (bx - ax) / length * abs(self.out), (by - ay) / length * abs(self.out)
        walls[self.wall] = ((ax + nx - ux, ay + ny - uy), (bx + nx + ux, by + ny + uy))
        return walls


@case(["moved_wall"])
class moved(MovedWall):
    pass


@case(["moved_wall"], stays=True)
class moved_stays(MovedWall):
    pass


@case(["moved_wall"], stays=True)
class short_wall_nearer(MovedWall):
    wall, out = 8, 0.15


@case(["moved_wall"])
class short_wall_farther(MovedWall):
    wall, out = 8, -0.15


@case(["moved_wall"])
class wall_turned(World):
    def walls(self):
        walls = super().walls()
        walls[self.floor.wall] = turned(walls[self.floor.wall], 0, math.radians(1.2))
        return walls


@case(["odom_distance_scale"])
class odometry_long(World):
    def step(self, forward, turn):
        return 1.03 * forward, turn


@case(["odom_turn_scale"])
class odometry_turns(World):
    def step(self, forward, turn):
        return forward, 1.03 * turn


@case(["odom_imbalance"])
class odometry_bends(World):
    def step(self, forward, turn):
        return forward, turn + 0.03 * forward


@case(covariate="odometry")
class odometry_late(World):
    def odometry(self, poses):
        true = super().odometry(poses)
        return [true[0]] + true[:-1]


@case(covariate="bearing")
class ripple(World):
    def bias(self, bearing, **b):
        return 0.008 * math.sin(6 * bearing)


@case(covariate="time")
class swing(World):
    def bias(self, time, **b):
        return 0.01 * math.sin(2 * math.pi * time / 17)


@case(covariate="place")
class stripes(World):
    def bias(self, place, **b):
        return 0.02 if int(place[0] // 1.3) % 2 else 0.0


@case(covariate="incidence")
class second_reflection(World):
    def reading(self, z, b, beam, cast_on):
        if b["wall"] is None or b["incidence"] < 1.0 or self.rng.random() > 0.4:
            return z
        return z + self.rng.expovariate(1.0)


@case(covariate="neighbour")
class neighbours(World):
    def finish(self, ranges, nominal):
        out, error = list(ranges), 0.0
        for i, z in enumerate(ranges):
            error = 0.8 * error + self.rng.gauss(0, 0.6 * 0.012)
            out[i] = z if z == self.max_range else min(max(z + error, 0.05), self.max_range)
        return out


@case(covariate="bearing")
class floor_ahead(World):
    def reading(self, z, b, beam, cast_on):
        if abs(b["bearing"]) < 0.3:
            floor = 4.0 + 0.4 * math.sin(3 * b["time"]) + self.rng.gauss(0, 0.05)
            return min(z, floor / math.cos(b["bearing"]))
        return z


@case(covariate="place")
class frame_turned(World):
    def reference(self, pose):
        c, s = math.cos(math.radians(0.4)), math.sin(math.radians(0.4))
        x, y = pose[0] - 7.0, pose[1] - 3.0
        return (7.0 + c * x - s * y, 3.0 + s * x + c * y, wrap(pose[2] + math.radians(0.4)))


@case(covariate="everywhere")
class noisier(World):
    def sigma(self, *_):
        return 1.25 * self.noise


@case(["range_noise"])
class noise_range_table(World):
    def sigma(self, z, *_):
        self.levels = getattr(self, "levels", None) or [self.draw.random() for _ in range(6)]
        return self.noise * (1 + 2.5 * self.levels[min(int(z / 1.5), 5)])


@case(["incidence_dropout"])
class dropout_table(World):
    def lost(self, incidence, **b):
        return 0.0 if incidence < 0.7 else 0.15 if incidence < 1.1 else 0.45


@case(["range_dropout"])
class lost_with_range(World):
    def lost(self, z, **b):
        return min(0.7, 0.012 * z * z)


@case(["warmup_drift"])
class drift_in_steps(World):
    def bias(self, time, **b):
        return 0.035 if time < 10 else 0.02 if time < 25 else 0.008 if time < 40 else 0.0


@case(["heavy_tail"])
class tail_of_laplace(World):
    def bias(self, **b):
        return self.rng.choice((-1, 1)) * self.rng.expovariate(1 / 0.05) if self.rng.random() < 0.1 else 0.0


@case(["mixed_pixels"])
class mixed_near(World):
    def finish(self, ranges, nominal):
        out = list(ranges)
        for i in range(1, len(ranges)):
            near, far = sorted((nominal[i - 1], nominal[i]))
            if far - near > 0.3 and far < self.max_range and self.rng.random() < 0.6:
                out[i] = near + 0.4 * self.rng.random() ** 2 * (far - near)
        return out


@case(covariate="place")
class surface(World):
    def bias(self, wall, **b):
        return -0.012 if wall in self.floor.surfaces else 0.0


@case(covariate="range")
class near_loss(World):
    def lost(self, z, **b):
        return 0.4 if z < 1.4 else 0.0


@case(covariate="speed")
class noise_of_turns(World):
    turning = 0.0

    def stamp(self, time):
        if time > 0.1:
            path = Drive(self.floor)
            self.turning = abs(wrap(path(time)[2] - path(time - 0.1)[2])) / 0.1
        return time

    def sigma(self, *_):
        return self.noise * (1 + 4 * self.turning)


@case(["range_scale", "incidence_noise"])
class scale_and_noise(scale, noise_incidence):
    pass


@case(["mount_yaw", "incidence_dropout"])
class yaw_and_dropout(yaw, dropout):
    pass


@case(["range_bias", "odom_distance_scale"])
class bias_and_odometry(bias, odometry_long):
    pass


@case(["range_bias", "sector_occlusion"])
class bias_and_sector(bias, sector):
    pass


# The same on other lasers, and in scenarios with nothing optional.
for laser in ("half", "wide", "fine"):
    for base in ("nothing", "bias", "yaw", "dropout", "late", "ripple", "sector"):
        CASES[f"{base}_{laser}"] = type(f"{base}_{laser}", (CASES[base],), LASERS[laser])
for base in ("bias", "scale", "yaw", "late", "dropout", "noise_range", "moved", "thing", "odometry_long", "ripple", "swing"):
    CASES[f"{base}_bare"] = type(f"{base}_bare", (CASES[base],), dict(bare=True))
# An office with rooms, in which the robot waits at stops, seen by a laser with more noise over half of the circle.
OFFICE = dict(floor=Office, noise=0.015, max_range=16.0, beams=181, field=math.pi, first=-math.pi / 2)
for base in [name for name in CASES if name.rsplit("_", 1)[-1] not in ("half", "wide", "fine", "bare") and not name.startswith("short_wall")]:
    CASES[f"{base}_office"] = type(f"{base}_office", (CASES[base],), OFFICE)


def main():
    out, names = Path(sys.argv[1]), sys.argv[2:] or list(CASES)
    for name in names:
        CASES[name](sum(map(ord, name))).write(out / name)


if __name__ == "__main__":
    main()
