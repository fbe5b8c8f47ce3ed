"""Writes the bags in recordings/ with programs other than locsim: python recordings.py FOLDER

pip install rosbags==0.11.9 mcap==1.6.0 lz4 numpy
"""

import math
import shutil
import sqlite3
import sys
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

T0 = 1_700_000_000_000_000_000
MS = 1_000_000
MOUNT = (0.2, 0.1, math.pi)


def rectangle(x, y, width, height):
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    return list(zip(corners, corners[1:] + corners[:1]))


# A room of 4 by 3 m with a pillar (m).
WALLS = np.array(rectangle(0, 0, 4, 3) + rectangle(3.0, 0.6, 0.4, 0.4), float)


def compose(a, b):
    c, s = math.cos(a[2]), math.sin(a[2])
    return (a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2])


def inverse(a):
    c, s = math.cos(a[2]), math.sin(a[2])
    return (-c * a[0] - s * a[1], s * a[0] - c * a[1], -a[2])


START = (0.8, 0.7, 0.2)


def odometry(secs):
    """The base after a time: 0.5 m/s along an arc of 2 m radius."""
    turn = 0.25 * secs
    return (2 * math.sin(turn), 2 * (1 - math.cos(turn)), turn)


def ranges(secs, bearings, mount):
    """Distances (m) from the laser to the walls."""
    x, y, heading = compose(compose(START, odometry(secs)), mount)
    along = np.stack([np.cos(heading + bearings), np.sin(heading + bearings)], 1)[:, None]
    from_laser, wall = WALLS[:, 0] - (x, y), WALLS[:, 1] - WALLS[:, 0]
    cross = lambda a, b: a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    with np.errstate(all="ignore"):
        distance = cross(from_laser, wall) / cross(along, wall)
        share = cross(from_laser[None], along) / cross(along, wall)
    distance[~((distance > 0) & (share >= 0) & (share <= 1))] = np.inf
    return distance.min(1)


class Robot:
    """The messages of a robot: time of recording (ns), topic, type, message."""

    def __init__(self):
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self.messages = []
        self.random = np.random.default_rng(1)

    def make(self, kind, *values):
        package, name = kind.split("/")
        return self.store.types[f"{package}/msg/{name}"](*values)

    def add(self, logged, topic, kind, message):
        package, name = kind.split("/")
        # Programs publish late, and recorders note later still.
        late = 500_000 + int(abs(self.random.normal()) * 2 * MS)
        self.messages.append((int(logged) + late, topic, f"{package}/msg/{name}", message))

    def header(self, stamp, frame):
        time = self.make("builtin_interfaces/Time", int(stamp) // 10**9, int(stamp) % 10**9)
        return self.make("std_msgs/Header", time, frame)

    def pose(self, pose):
        rotation = self.make("geometry_msgs/Quaternion", 0.0, 0.0, math.sin(pose[2] / 2), math.cos(pose[2] / 2))
        return self.make("geometry_msgs/Pose", self.make("geometry_msgs/Point", pose[0], pose[1], 0.0), rotation)

    def uncertain(self, pose, variance):
        return self.make("geometry_msgs/PoseWithCovariance", self.pose(pose), np.diag([variance] * 6).ravel())

    def transform(self, stamp, parent, child, pose, rotation=None):
        place = self.make("geometry_msgs/Vector3", pose[0], pose[1], 0.0)
        rotation = rotation or self.pose(pose).orientation
        transform = self.make("geometry_msgs/Transform", place, rotation)
        return self.make("geometry_msgs/TransformStamped", self.header(stamp, parent), child, transform)

    def tf(self, stamp, *transforms, topic="/tf"):
        self.add(stamp, topic, "tf2_msgs/TFMessage", self.make("tf2_msgs/TFMessage", list(transforms)))

    def moves(self, odom="/odom", odom_tf=True, base="base_footprint", prefix=""):
        """Odometry at 25 Hz, as a topic, as a transform, or both, by jittered stamps."""
        for i in range(-3, 106):
            stamp = T0 + i * 40 * MS + int(self.random.normal() * 300_000)
            pose = odometry((stamp - T0) * 1e-9)
            if odom:
                zero = self.make("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
                twist = self.make("geometry_msgs/Twist", zero, zero)
                twist = self.make("geometry_msgs/TwistWithCovariance", twist, np.zeros(36))
                values = self.header(stamp, prefix + "odom"), prefix + base, self.uncertain(pose, 1e-3), twist
                self.add(stamp, odom, "nav_msgs/Odometry", self.make("nav_msgs/Odometry", *values))
            if odom_tf:
                self.tf(stamp, self.transform(stamp, prefix + "odom", prefix + base, pose))

    def mounts(self, mount=MOUNT, laser="laser", base="base_footprint", prefix="", rotation=None):
        name = lambda frame: prefix + frame
        transforms = [self.transform(T0, name("base_link"), name(laser), mount, rotation)]
        if base != "base_link":
            transforms.append(self.transform(T0, name(base), name("base_link"), (0.0, 0.0, 0.0)))
        self.tf(T0 - 50 * MS, *transforms, topic="/tf_static")

    def localizer(self, topic=True, transform=True, prefix=""):
        """What AMCL publishes: a pose now and then, and at 10 Hz a transform that holds a while longer."""
        for i in range(-2, 43):
            stamp = T0 + i * 100 * MS
            if transform:
                self.tf(stamp, self.transform(stamp + 50 * MS, "map", prefix + "odom", START))
        for secs in (-0.05, 0.62, 1.9, 2.3, 4.12):
            if topic:
                stamp = T0 + int(secs * 1e9)
                pose = self.uncertain(compose(START, odometry(secs)), 0.01)
                message = self.make("geometry_msgs/PoseWithCovarianceStamped", self.header(stamp, "map"), pose)
                self.add(stamp + 40 * MS, "/amcl_pose", "geometry_msgs/PoseWithCovarianceStamped", message)

    def mocap(self, kind, topic):
        """Reference poses at 50 Hz."""
        for i in range(-3, 211):
            stamp = T0 + i * 20 * MS
            pose = compose(START, odometry(i * 0.02))
            header = self.header(stamp, "world")
            if kind == "geometry_msgs/PoseStamped":
                message = self.make(kind, header, self.pose(pose))
            else:
                message = self.transform(stamp, "world", "robot", pose)
            self.add(stamp, topic, kind, message)

    def scans(self, topic="/scan", frame="laser", mount=MOUNT, beams=36, first=-math.pi, step=None, none=math.inf,
              kind="LaserScan", reverse=False):
        """Scans at 10 Hz; each fifth beam has no return, beam 3 is NaN."""
        step = step or 2 * math.pi / beams
        bearings = first + step * np.arange(beams)
        for i in range(40):
            stamp = T0 + i * 100 * MS + int(self.random.normal() * 500_000)
            found = ranges((stamp - T0) * 1e-9, bearings, mount).astype(np.float32)
            found[::5], found[3] = none, np.nan
            found = found[::-1].copy() if reverse else found
            header, last = self.header(stamp, frame), float(bearings[-1])
            description = (float(first), last, float(step), 0.0, 0.1, 0.1, 12.0)
            if kind == "LaserScan":
                values = description + (found, np.zeros(0, np.float32))
            elif kind == "MultiEchoLaserScan":
                echo = lambda r: np.array([r, r + 0.5] if np.isfinite(r) else [], np.float32)
                values = description + ([self.make("sensor_msgs/LaserEcho", echo(r)) for r in found], [])
            else:
                points = np.zeros((beams, 4), np.float32)
                points[:, 0], points[:, 1] = found * np.cos(bearings), found * np.sin(bearings)
                points = points[np.isfinite(found)]
                fields = [self.make("sensor_msgs/PointField", n, 4 * k, 7, 1) for k, n in enumerate(["x", "y", "z", "intensity"])]
                data = points.view(np.uint8).ravel()
                values = (1, len(points), fields, False, 16, len(data), data, True)
            self.add(stamp + 30 * MS, topic, f"sensor_msgs/{kind}", self.make(f"sensor_msgs/{kind}", header, *values))

    def within(self, space, *kept):
        """Puts all topics into a namespace."""
        self.messages = [(t, topic if topic in kept else space + topic, kind, m) for t, topic, kind, m in self.messages]

    def write(self, folder, plugin=StoragePlugin.MCAP, version=9, mode=None):
        writer = Writer(folder, version=version, storage_plugin=plugin)
        if mode:
            writer.set_compression(mode, CompressionFormat.ZSTD)
        forever = QosTime(2147483647, 4294967295)
        with writer:
            # A topic on which nothing is published.
            connections = {"/diagnostics": writer.add_connection("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", typestore=self.store)}
            for logged, topic, kind, message in sorted(self.messages, key=lambda message: message[0]):
                if topic not in connections:
                    latched = topic.endswith("tf_static")
                    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
                    quality = Qos(QosHistory.KEEP_LAST, 1 if latched else 10, QosReliability.RELIABLE, durability, forever,
                                  forever, QosLiveliness.AUTOMATIC, forever, False)
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store, offered_qos_profiles=[quality])
                writer.write(connections[topic], logged, self.store.serialize_cdr(message, kind))


def usual(**scans):
    robot = Robot()
    robot.mounts()
    robot.moves()
    robot.localizer()
    robot.scans(**scans)
    return robot


def contents():
    """The recordings that differ in their messages."""
    yield "nav2", usual()
    robot = Robot()
    robot.mounts(base="base_link"), robot.moves(odom=None, base="base_link"), robot.localizer(topic=False), robot.scans()
    yield "tf_only", robot
    robot = Robot()
    robot.mounts(), robot.moves(odom_tf=False), robot.localizer(transform=False), robot.scans()
    yield "amcl_pose", robot
    for name, kind, topic in [("mocap_pose", "geometry_msgs/PoseStamped", "/vrpn_mocap/robot/pose"),
                              ("mocap_transform", "geometry_msgs/TransformStamped", "/vicon/robot/robot")]:
        robot = Robot()
        robot.mounts(), robot.moves(), robot.mocap(kind, topic), robot.scans()
        yield name, robot
    robot = Robot()
    robot.mounts(), robot.moves(), robot.scans()
    yield "no_reference", robot
    robot = usual(topic="/scan_front", beams=20, step=0.15, first=-1.4)
    rear = (-0.3, 0.0, 0.0)
    robot.tf(T0, robot.transform(T0, "base_link", "rear", rear), topic="/tf_static")
    robot.scans(topic="/scan_rear", frame="rear", mount=rear, beams=12, step=0.15, first=-0.8)
    yield "two_scanners", robot
    yield "cloud", usual(kind="PointCloud2", topic="/points")
    yield "multi_echo", usual(kind="MultiEchoLaserScan", topic="/echoes", beams=30, first=-2.0, step=4.0 / 29)
    yield "clockwise", usual(first=math.pi, step=-2 * math.pi / 36, none=0.0)
    yield "at_maximum", usual(none=12.0, beams=37, step=2 * math.pi / 36)
    robot = Robot()
    robot.mounts(mount=(0.2, 0.1, 0.0), rotation=robot.make("geometry_msgs/Quaternion", 1.0, 0.0, 0.0, 0.0))
    robot.moves(), robot.localizer(), robot.scans(mount=(0.2, 0.1, 0.0), beams=31, first=-1.5, step=0.1, reverse=True)
    yield "upside_down", robot
    robot = usual()
    robot.within("/robot1")
    yield "namespace", robot
    robot = Robot()
    robot.mounts(prefix="robot1/"), robot.moves(prefix="robot1/"), robot.localizer(topic=False, prefix="robot1/")
    robot.scans(frame="robot1/laser"), robot.within("/robot1", "/tf", "/tf_static")
    yield "prefixed_frames", robot
    robot = usual()
    robot.messages = [(t + int(abs(robot.random.normal()) * 120 * MS), *rest) for t, *rest in robot.messages]
    yield "out_of_order", robot
    robot = usual()
    time, topic, kind, scan = next(message for message in robot.messages if message[1] == "/scan")
    none = np.zeros(0, np.float32)
    robot.messages.append((time - 1, topic, kind, robot.make("sensor_msgs/LaserScan", scan.header, *[0.0] * 7, none, none)))
    yield "empty_scan", robot
    robot = Robot()
    robot.mounts(), robot.moves(odom="/odometry/filtered"), robot.moves(odom="/wheel/odometry", odom_tf=False)
    robot.localizer(), robot.scans()
    yield "two_odometries", robot


def written(robot, out, **how):
    """Writes a bag; returns its only file."""
    if out.exists():
        shutil.rmtree(out)
    robot.write(out, **how)
    return next(path for path in out.iterdir() if path.name != "metadata.yaml")


def main(folder):
    folder.mkdir(exist_ok=True)
    for name, robot in contents():
        file = written(robot, folder / name, mode=CompressionMode.FILE)
        shutil.move(file, folder / file.name)
        shutil.rmtree(folder / name)

    # The same content as rosbag2 stores it in other ways.
    def alone(name, robot, **how):
        file = written(robot, folder / name, **how)
        shutil.move(file, folder / file.name)
        shutil.rmtree(folder / name)
        return folder / file.name

    alone("chunks_zstd", usual(), mode=CompressionMode.STORAGE)
    robots = dict(contents())
    alone("messages_zstd", robots["amcl_pose"], plugin=StoragePlugin.SQLITE3, mode=CompressionMode.MESSAGE)
    # Humble's recorder notes no definitions of messages.
    file = alone("humble", robots["amcl_pose"], plugin=StoragePlugin.SQLITE3, version=8)
    connection = sqlite3.connect(file)
    connection.executescript("DROP TABLE IF EXISTS message_definitions; VACUUM;")
    connection.close()

    # rosbags doesn't split; the parts are two of its bags, of which `metadata.yaml` lists both files.
    split = folder / "split"
    shutil.rmtree(split, ignore_errors=True)
    whole = sorted(usual().messages, key=lambda message: message[0])
    middle = len(whole) // 2
    listed = []
    for part, messages in enumerate([whole[:middle], whole[middle:]]):
        robot = Robot()
        robot.messages = messages
        file = written(robot, folder / f"split_{part}", mode=CompressionMode.FILE)
        split.mkdir(exist_ok=True)
        metadata = (file.parent / "metadata.yaml").read_text()
        shutil.move(file, split / file.name)
        shutil.rmtree(file.parent)
        listed.append(f"  - {file.name}\n")
    before, after = metadata.split(listed[-1])
    (split / "metadata.yaml").write_text(before + "".join(listed) + after)

    # Chunks in lz4, by the package mcap.
    plain = written(usual(), folder / "plain")
    with open(plain, "rb") as source, open(folder / "chunks_lz4.mcap", "wb") as out:
        writer = McapWriter(out, compression=CompressionType.LZ4)
        writer.start(profile="ros2", library="mcap")
        channels = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in channels:
                schema = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema, channel.metadata)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
        writer.finish()
    shutil.rmtree(plain.parent)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
