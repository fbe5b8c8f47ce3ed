use std::path::PathBuf;

use locsim_core::Pose2;
use locsim_dataset::{BagTopics, LogFormat};
use locsim_world::simulation::{
    BlockOptions, BlockResampling, LaserOptions, OdometryNoise, Robot, RobotPath, VelocitySegment,
};

use super::{MAX_BEAMS, effect, residual};
use crate::check::Allowed::{Within, ZeroOrWithin};
use crate::check::{
    ANGLE, COORDINATE, Checker, LENGTH, MAX_RANGE, NOISE, OFFSET, POSITIVE_LENGTH, STEP, number,
};
use crate::key_path::join;
use crate::raw::{
    MapFromScans, RawBlockResampling, RawBlocks, RawLaser, RawLog, RawPath, RawPose, RawRayCast, RawRobot,
    RawScenario, RawSegment, RayCastMethod, default,
};
use crate::{Log, LogMap, RayCast, Simulation, SimulatorOptions, Source};

/// Way points or segments of a path.
const MOST_POINTS: usize = 100_000;
/// Points nearer to each other than this have no direction between them (m).
const SAME_POINT_M: f64 = 1e-6;
/// The highest speed, of a robot or a block (m/s).
const FASTEST_M_S: f64 = 1e3;
/// The highest turn rate (deg/s).
const FASTEST_TURN_DEG_S: f64 = 1e5;

pub(super) fn ray_cast(check: &mut Checker<'_>, raw: &RawRayCast) -> RayCast {
    match raw.method {
        RayCastMethod::Table => RayCast::Table {
            cell_m: check.number(
                "ray_cast.cell_m",
                raw.cell_m.unwrap_or(default::CELL_M),
                Within(0.001, 10.0),
            ),
            memory_mb: check.count(
                "ray_cast.memory_mb",
                raw.memory_mb.unwrap_or(default::MEMORY_MB),
                16,
                65536,
            ),
        },
        RayCastMethod::Exact => {
            let why = "it belongs to `method: table`";
            check.absent("ray_cast", "cell_m", raw.cell_m.as_ref(), why);
            check.absent("ray_cast", "memory_mb", raw.memory_mb.as_ref(), why);
            RayCast::Exact
        }
    }
}

/// `None` where so much is missing that there is nothing to return; the problem is remembered.
pub(super) fn source(check: &mut Checker<'_>, raw: &RawScenario) -> Option<Source> {
    let map = raw.map.as_ref().map(|map| {
        let (key, file) = map.file();
        check.file(key, file)
    });
    match (&raw.robot, &raw.log) {
        (Some(robot), None) => {
            let blocks = raw.blocks.as_ref().map(|raw| blocks(check, raw));
            let robot = self::robot(check, robot);
            let laser = raw.laser.as_ref().map(|raw| laser(check, raw));
            check.refuse(map.is_none(), "map", || "the key is missing; `robot` drives in a map".to_owned());
            check.refuse(laser.is_none(), "laser", || {
                "the key is missing; `robot` carries a laser".to_owned()
            });
            let effects = effect::effects(check, raw);
            let residuals = residual::residuals(check, raw);
            let (map, robot, laser) = (map?, robot?, laser?);
            Some(Source::Simulation(Simulation { map, blocks, robot, laser, effects, residuals }))
        }
        (robot, Some(log)) => {
            let simulator = simulator(check, raw, robot.as_ref());
            check.refuse(log.train_scans.is_none() && raw.laser.is_none(), "log.train_scans", || {
                "the key is missing; without it, models are trained on simulated scans, and `laser` is needed".to_owned()
            });
            let log = self::log(check, log, map);
            Some(Source::Log(Log { simulator, ..log }))
        }
        (None, None) => {
            check.problem("", "`robot` and `log` are both missing; one of them is needed");
            None
        }
    }
}

/// The simulator beside a log; `None` where there is none, or too much is missing.
fn simulator(
    check: &mut Checker<'_>,
    raw: &RawScenario,
    robot: Option<&RawRobot>,
) -> Option<SimulatorOptions> {
    let odometry_noise = robot.map_or_else(OdometryNoise::default, |robot| {
        let why = "with a `log`, the robot drives the log's poses";
        check.absent("robot", "path", robot.path.as_ref(), why);
        let jitter = Some(robot.start_jitter_m).filter(|jitter| *jitter != 0.0);
        check.absent("robot", "start_jitter_m", jitter.as_ref(), why);
        odometry_noise(check, robot)
    });
    let Some(laser) = &raw.laser else {
        let why = "without `laser`, nothing is simulated beside a log";
        check.absent("", "blocks", raw.blocks.as_ref(), why);
        check.absent("", "effects", raw.effects.first(), why);
        check.absent("", "residuals", raw.residuals.first(), why);
        check.absent("", "robot", robot, why);
        return None;
    };
    Some(SimulatorOptions {
        blocks: raw.blocks.as_ref().map(|raw| blocks(check, raw)),
        laser: self::laser(check, laser),
        odometry_noise,
        effects: effect::effects(check, raw),
        residuals: residual::residuals(check, raw),
    })
}

fn odometry_noise(check: &mut Checker<'_>, raw: &RawRobot) -> OdometryNoise {
    let alpha = raw.odometry_noise.alpha;
    check.numbers("robot.odometry_noise.alpha", &alpha, NOISE);
    // Where an alpha is refused, it has been said above.
    OdometryNoise::new(alpha).unwrap_or_default()
}

fn blocks(check: &mut Checker<'_>, raw: &RawBlocks) -> BlockOptions {
    let resample = match raw.resample {
        RawBlockResampling::EachObservation => BlockResampling::EachObservation,
        RawBlockResampling::Never => BlockResampling::Never,
        RawBlockResampling::EachScanN(n) => {
            BlockResampling::EachScanN(check.count("blocks.resample.each_scan_n", n, 1, 1_000_000))
        }
    };
    let speed_m_s = check.interval("blocks.speed_m_s", raw.speed_m_s, Within(0.0, FASTEST_M_S));
    let persists = resample != BlockResampling::EachObservation;
    check.refuse(!persists && speed_m_s != [0.0; 2], "blocks.speed_m_s", || {
        let [lo, hi] = speed_m_s.map(number);
        format!(
            "[{lo}, {hi}] is not allowed; blocks move only with `resample: never` or `{{each_scan_n: ...}}`"
        )
    });
    let [yaw_lo, yaw_hi] = check.interval("blocks.yaw_deg", raw.yaw_deg, Within(-180.0, 180.0));
    BlockOptions {
        per_metre_of_wall: check.number(
            "blocks.per_metre_of_wall",
            raw.per_metre_of_wall,
            Within(0.0, 100.0),
        ),
        length_m: check.interval("blocks.length_m", raw.length_m, POSITIVE_LENGTH),
        width_m: check.interval("blocks.width_m", raw.width_m, POSITIVE_LENGTH),
        yaw_rad: [yaw_lo.to_radians(), yaw_hi.to_radians()],
        wall_distance_m: check.interval("blocks.wall_distance_m", raw.wall_distance_m, LENGTH),
        resample,
        speed_m_s,
        clearance_m: check.number("blocks.clearance_m", raw.clearance_m, LENGTH),
    }
}

/// `None` without a path; the problem is remembered.
fn robot(check: &mut Checker<'_>, raw: &RawRobot) -> Option<Robot> {
    let odometry_noise = odometry_noise(check, raw);
    check.refuse(raw.path.is_none(), "robot.path", || {
        "the key is missing; without a `log`, a robot needs one".to_owned()
    });
    Some(Robot {
        path: match raw.path.as_ref()? {
            RawPath::Waypoints { points_m, speed_m_s, turn_rate_deg_s } => {
                let key = "robot.path.waypoints";
                waypoints(check, &join(key, "points_m"), points_m);
                RobotPath::Waypoints {
                    points_m: points_m.clone(),
                    speed_m_s: check.number(&join(key, "speed_m_s"), *speed_m_s, Within(1e-3, FASTEST_M_S)),
                    turn_rate_rad_s: check.degrees(
                        &join(key, "turn_rate_deg_s"),
                        *turn_rate_deg_s,
                        Within(1e-3, FASTEST_TURN_DEG_S),
                    ),
                }
            }
            RawPath::VelocityProfile { start, segments } => velocity_profile(check, *start, segments),
        },
        start_jitter_m: check.number("robot.start_jitter_m", raw.start_jitter_m, LENGTH),
        odometry_noise,
    })
}

fn waypoints(check: &mut Checker<'_>, key: &str, points: &[[f64; 2]]) {
    check.refuse(points.len() < 2, key, || {
        format!("{} points are not allowed; a path needs at least 2", points.len())
    });
    check.length(key, points, MOST_POINTS);
    for (i, point) in points.iter().enumerate() {
        let key = format!("{key}[{i}]");
        check.numbers(&key, point, COORDINATE);
        let [x, y] = *point;
        let repeats = |[x0, y0]: [f64; 2]| (x - x0).hypot(y - y0) < SAME_POINT_M;
        check.refuse(i > 0 && repeats(points[i - 1]), &key, || {
            let [x, y] = [x, y].map(number);
            format!("[{x}, {y}] is not allowed; it repeats the point before it")
        });
    }
}

fn velocity_profile(check: &mut Checker<'_>, start: RawPose, segments: &[RawSegment]) -> RobotPath {
    let key = "robot.path.velocity_profile";
    let start = Pose2::new(
        check.number(&join(key, "start.x_m"), start.x_m, COORDINATE),
        check.number(&join(key, "start.y_m"), start.y_m, COORDINATE),
        check.degrees(&join(key, "start.heading_deg"), start.heading_deg, ANGLE),
    );
    let list = join(key, "segments");
    check.refuse(segments.is_empty(), &list, || {
        "an empty list is not allowed; at least one segment".to_owned()
    });
    check.length(&list, segments, MOST_POINTS);
    let segments = segments.iter().enumerate().map(|(i, raw)| {
        let key = format!("{list}[{i}]");
        let turn_rate = Within(-FASTEST_TURN_DEG_S, FASTEST_TURN_DEG_S);
        VelocitySegment {
            secs: check.number(&join(&key, "secs"), raw.secs, Within(1e-6, 1e7)),
            speed_m_s: check.number(
                &join(&key, "speed_m_s"),
                raw.speed_m_s,
                Within(-FASTEST_M_S, FASTEST_M_S),
            ),
            turn_rate_rad_s: check.degrees(&join(&key, "turn_rate_deg_s"), raw.turn_rate_deg_s, turn_rate),
        }
    });
    RobotPath::VelocityProfile { start, segments: segments.collect() }
}

/// By so much of the time between two scans a sweep may be rounded up.
const ROUNDED: f64 = 0.01;

fn laser(check: &mut Checker<'_>, raw: &RawLaser) -> LaserOptions {
    let rate_hz = check.number("laser.rate_hz", raw.rate_hz, Within(1e-3, 1e5));
    let min_range_m = check.number("laser.min_range_m", raw.min_range_m, LENGTH);
    let max_range_m = check.number("laser.max_range_m", raw.max_range_m, MAX_RANGE);
    check.refuse(max_range_m <= min_range_m, "laser.max_range_m", || {
        let [max, min] = [max_range_m, min_range_m].map(number);
        format!("{max} is not allowed; above laser.min_range_m, which is {min}")
    });
    let resolution_m = check.number("laser.resolution_m", raw.resolution_m, STEP);
    check.refuse(resolution_m > max_range_m, "laser.resolution_m", || {
        let [resolution, max] = [resolution_m, max_range_m].map(number);
        format!("{resolution} is not allowed; at most laser.max_range_m, which is {max}")
    });
    let scan_secs = check.number("laser.scan_secs", raw.scan_secs, Within(0.0, 1e3));
    check.refuse(scan_secs * rate_hz > 1.0 + ROUNDED, "laser.scan_secs", || {
        let [sweep, period] = [scan_secs, (1e4 / rate_hz).floor() / 1e4].map(number);
        format!("{sweep} is not allowed; a sweep ends before the next begins, after {period} s")
    });
    // A sweep of 0.143 s, 7 times a second, is a rounded one.
    let scan_secs = scan_secs.min(1.0 / rate_hz);
    LaserOptions {
        rate_hz,
        beams: check.count("laser.beams", raw.beams, 1, MAX_BEAMS),
        field_of_view_rad: check.degrees(
            "laser.field_of_view_deg",
            raw.field_of_view_deg,
            Within(1e-3, 360.0),
        ),
        first_bearing_rad: raw
            .first_beam_deg
            .map(|first| check.degrees("laser.first_beam_deg", first, Within(-180.0, 180.0))),
        min_range_m,
        max_range_m,
        resolution_m,
        sigma_m: check.number("laser.noise.sigma_m", raw.noise.sigma_m, ZeroOrWithin(1e-6, 1.0)),
        sigma_per_m: check.number("laser.noise.sigma_per_m", raw.noise.sigma_per_m, NOISE),
        mount: Pose2::new(
            check.number("laser.mount.x_m", raw.mount.x_m, OFFSET),
            check.number("laser.mount.y_m", raw.mount.y_m, OFFSET),
            check.degrees("laser.mount.yaw_deg", raw.mount.yaw_deg, ANGLE),
        ),
        scan_secs,
    }
}

fn log(check: &mut Checker<'_>, raw: &RawLog, map: Option<PathBuf>) -> Log {
    let file = check.log("log.file", &raw.file);
    let map = if let Some(map) = map {
        let why = "there is a `map`";
        check.absent("log", "map_scans", raw.map_scans.as_ref(), why);
        check.absent("log", "map_resolution_m", raw.map_resolution_m.as_ref(), why);
        check.absent("log", "map", raw.map.as_ref(), why);
        LogMap::File(map)
    } else {
        check.refuse(raw.map_scans.is_none(), "log.map_scans", || {
            "the key is missing; without a `map`, one is built from these scans".to_owned()
        });
        let scans =
            raw.map_scans.as_ref().map_or_else(Vec::new, |scans| check.shares("log.map_scans", scans));
        let has_resolution = raw.map_resolution_m.is_some();
        let default = if has_resolution { MapFromScans::Cells } else { MapFromScans::Walls };
        match raw.map.unwrap_or(default) {
            MapFromScans::Cells => {
                let resolution_m = raw.map_resolution_m.unwrap_or(default::MAP_RESOLUTION_M);
                let resolution_m = check.number("log.map_resolution_m", resolution_m, Within(0.001, 10.0));
                LogMap::FromScans { scans, resolution_m }
            }
            MapFromScans::Walls => {
                let why = "a map of walls has no cells";
                check.absent("log", "map_resolution_m", raw.map_resolution_m.as_ref(), why);
                LogMap::Walls { scans }
            }
        }
    };
    let train_scans =
        raw.train_scans.as_ref().map_or_else(Vec::new, |scans| check.shares("log.train_scans", scans));
    let localize_scans = check.shares("log.localize_scans", &raw.localize_scans);
    check.refuse(localize_scans.len() > 1, "log.localize_scans", || {
        let n = localize_scans.len();
        format!("a list of {n} intervals is not allowed; one interval, between several the drive would jump")
    });
    for (i, [from, to]) in localize_scans.iter().enumerate() {
        let taken = train_scans.iter().chain(raw.map_scans.iter().flatten());
        for [a, b] in taken.filter(|[a, b]| from < b && a < to) {
            check.problem(
                &format!("log.localize_scans[{i}]"),
                format!(
                    "[{}, {}] is not allowed; scans of [{}, {}] serve for training or for the map",
                    number(*from),
                    number(*to),
                    number(*a),
                    number(*b),
                ),
            );
        }
    }
    let max_range_m = raw.max_range_m.map(|max| check.number("log.max_range_m", max, MAX_RANGE));
    // A file that is no log at all is refused when it is read.
    if LogFormat::of_content(&file).is_ok_and(|format| format != LogFormat::Bag) {
        check.absent("log", "topics", raw.topics.as_ref(), "only a ROS 2 bag has topics");
    }
    let topics = raw.topics.clone().map_or_else(BagTopics::default, |topics| BagTopics {
        scan: topics.scan,
        odometry: topics.odometry,
        reference: topics.reference,
    });
    Log { file, map, train_scans, localize_scans, max_range_m, topics, simulator: None }
}
