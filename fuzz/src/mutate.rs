//! Inputs made from seeds by keyed chance: input `number` of a target follows from the seed of the whole, the target
//! and its corpus alone, so that each one can be made again.

use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::{Form, Target};

/// Words of scenarios.
pub const SCENARIO_WORDS: &[&str] = &[
    "name",
    "seed",
    "trials",
    "map: {file: room.yaml}",
    "map: {file: grid.yaml}",
    "ray_cast",
    "method: exact",
    "cell_m",
    "memory_mb",
    "blocks",
    "per_metre_of_wall",
    "resample: {each_scan_n: 5}",
    "speed_m_s",
    "waypoints",
    "points_m",
    "velocity_profile",
    "segments",
    "laser",
    "beams",
    "rate_hz",
    "max_range_m",
    "resolution_m",
    "training",
    "poses",
    "observations",
    "held_out_share",
    "models",
    "oracle",
    "np_reg",
    "{name: classic, file: fitted.model}",
    "filter",
    "particles: {kld: {min: 1, max: 100}}",
    "annealing",
    "candidates",
    "moves",
    "start: global",
    "expect",
    "effects",
    "{name: glass, wall: room/0, p: 0.3}",
    "{name: moved_wall, from_m: [0, 0], to_m: [1, 0], distance_m: 0.1}",
    "log: {file: drive.log}",
    "log: {file: drive.mcap}",
    "map_scans",
    "${LOCSIM_DATA}",
    "${HOME}",
    "../",
];
/// Words of studies.
pub const STUDY_WORDS: &[&str] = &[
    "sensor",
    "laser",
    "field_sensor",
    "forceps",
    "grass",
    "static_lidar",
    "table",
    "file: readings.csv",
    "file: scans.csv",
    "map: room.yaml",
    "values",
    "resolution",
    "point_mass_at",
    "align: {shift: x}",
    "criterion: crps",
    "states",
    "counts",
    "bandwidths",
    "thinning: true",
    "repeats",
    "folds",
    "test_states",
    "truth_observations",
    "observations",
    "frechet",
    "np_reg_registered",
    "beams",
    "blades_per_m2",
    "resolution_m",
    "map_scans",
];
/// Words of vector maps.
pub const MAP_WORDS: &[&str] = &[
    "outline",
    "points_m",
    "surfaces",
    "edges",
    "obstacles",
    "walls",
    "from_m",
    "to_m",
    "name",
    "image: grid.pgm",
    "resolution: 0.1",
    "origin: [0, 0, 0]",
    "mode: raw",
    "negate: 1",
    "occupied_thresh: 0.65",
    "free_thresh: 0.2",
    "[0, 0]",
    "[1e300, 1]",
    "[.nan, 1]",
];
/// Words of images.
pub const IMAGE_WORDS: &[&str] = &[
    "P1",
    "P2",
    "P3",
    "P4",
    "P5",
    "P6",
    "P7",
    "PF",
    "# c\n",
    "\n65535\n",
    "IHDR",
    "IDAT",
    "IEND",
    "PLTE",
    "tRNS",
    "acTL",
];
/// Words of CARMEN logs.
pub const CARMEN_WORDS: &[&str] = &[
    "FLASER",
    "RLASER",
    "ODOM",
    "ROBOTLASER1",
    "RAWLASER1",
    "TRUEPOS",
    "PARAM",
    "PARAM laser_max_range ",
    "PARAM robot_front_laser_max ",
    "PARAM laser_front_laser_resolution ",
    "PARAM laser_front_laser_fov ",
    "SYNC",
    "MARKER",
    "# ",
    "\n",
    " nohost ",
    "FLASER 4294967295 ",
    "FLASER 1000000000 1 1",
    "L 0 0 0 25 0 0 66 1",
    "O 0 0 0 1",
];
/// Words of `BeeSoft`'s maps.
pub const BEESOFT_WORDS: &[&str] = &[
    "robot_specifications->",
    "robot_specifications->resolution ",
    "robot_specifications->global_mapsize_x ",
    "global_map[0]:",
    "global_map[0]: 4294967295 4294967295",
    "global_map[0]: 100000 100000",
    "-1.000",
    "1.000",
    "\n",
];
/// Words of bags.
pub const BAG_WORDS: &[&str] = &[
    "\u{89}MCAP0\r\n",
    "lz4",
    "zstd",
    "bz2",
    "cdr",
    "ros2msg",
    "json",
    "/scan",
    "/odom",
    "/tf",
    "/reference",
    "sensor_msgs/msg/LaserScan",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "tf2_msgs/msg/TFMessage",
    "SQLite format 3\0",
    "CREATE TABLE messages",
    "CREATE TABLE topics",
    "base_link",
    "laser",
    "map",
];
/// Words of model files and of kept trials.
pub const MODEL_WORDS: &[&str] = &[
    "kind",
    "max_range",
    "chosen",
    "form",
    "Mixture",
    "Field",
    "Normal",
    "Histogram",
    "parts",
    "weights",
    "grid",
    "cells",
    "axis",
    "origin",
    "quantum",
    "ends",
    "log_density",
    "below",
    "classic",
    "p_reg",
    "np_reg_registered",
    "trial",
    "steps",
];
/// Words of a benchmark's files.
pub const WORKLOAD_WORDS: &[&str] = &[
    "true_pose",
    "max_range_m",
    "n_beams",
    "n_particles",
    "sigma_xy",
    "odom_delta_fullstep",
    "alphas",
    "sigma_hit",
    "lambda_short",
    "angle_rad",
    "range_m",
    "gt_x",
    "odom_theta",
    "r0",
    "step",
    "P5\n",
    "[1e300, 0, 0]",
    "resolution: 1e-9",
];
/// Words of tables.
pub const TABLE_WORDS: &[&str] =
    &[",", "\"", "\"\"", "#", "\r\n", ";", "inf", "NaN", "x,z\n", "1e400", "0x1p3"];

/// Numbers that readers are surprised by.
const NUMBERS: [&str; 34] = [
    "0",
    "-0",
    "-1",
    "1",
    "2",
    "0.5",
    "1e-300",
    "1e-12",
    "1e-6",
    "1e6",
    "1e9",
    "1e18",
    "1e300",
    "-1e300",
    "1e400",
    "nan",
    ".nan",
    "inf",
    ".inf",
    "-.inf",
    "255",
    "65536",
    "2147483648",
    "4294967295",
    "4294967296",
    "9007199254740993",
    "9223372036854775807",
    "9223372036854775808",
    "-9223372036854775809",
    "18446744073709551615",
    "18446744073709551616",
    "99999999999999999999999999999999999999999999",
    "",
    "null",
];

/// What stands in YAML and means more than it says.
const YAML: [&str; 30] = [
    "&a ",
    "*a",
    "*b",
    "<<: *a\n",
    "!!binary ",
    "!!float ",
    "!x ",
    "---\n",
    "...\n",
    "%YAML 1.2\n",
    "? ",
    ": ",
    "- ",
    "[",
    "]",
    "{",
    "}",
    "[[",
    "]]",
    "|\n",
    ">-\n",
    "'",
    "\"",
    "#",
    "\u{feff}",
    "\t",
    "\r",
    "\0",
    "~",
    "\\x",
];

/// The size of an input at the most \[bytes\].
const MOST_BYTES: usize = 1 << 20;

/// The generator behind an input.
fn generator(seed: u64, target: &str, number: u64) -> Pcg64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes()).update(&number.to_le_bytes()).update(target.as_bytes());
    Pcg64::from_seed(*hasher.finalize().as_bytes())
}

/// Input `number` of a target: first the seeds as they are, then mutations of them.
///
/// # Panics
/// There is no seed.
pub fn input(target: &Target, seeds: &[Vec<u8>], seed: u64, number: u64) -> Vec<u8> {
    if let Some(seed) = seeds.get(number as usize) {
        return seed.clone();
    }
    let mut mutation = Mutation { target, seeds, random: generator(seed, target.name, number) };
    let mut data = seeds.choose(&mut mutation.random).expect("a seed").clone();
    // Mostly few changes, so that most of an input stays right and is looked at.
    while {
        mutation.change(&mut data);
        mutation.random.random_bool(0.5)
    } {}
    data.truncate(MOST_BYTES);
    data
}

struct Mutation<'a> {
    target: &'a Target,
    seeds: &'a [Vec<u8>],
    random: Pcg64,
}

impl Mutation<'_> {
    fn below(&mut self, end: usize) -> usize {
        self.random.random_range(0..end.max(1))
    }

    /// A range of bytes, mostly short.
    fn run(&mut self, data: &[u8]) -> std::ops::Range<usize> {
        let start = self.below(data.len() + 1);
        let longest = [4, 32, 256, data.len()][self.below(4)];
        start..(start + self.below(longest + 1)).min(data.len())
    }

    fn change(&mut self, data: &mut Vec<u8>) {
        let by_form = match self.target.form {
            Form::Yaml => 7,
            Form::Text => 4,
            Form::Binary => 3,
        };
        match self.below(8 + by_form) {
            0 => self.flip(data),
            1 => drop(data.drain(self.run(data))),
            2 => self.repeat(data),
            3 => self.noise(data),
            4 => self.splice(data),
            5 => self.word(data),
            6 => data.truncate(self.below(data.len() + 1)),
            7 => self.swap(data),
            _ if self.target.form == Form::Binary => self.length(data),
            8..=11 => self.number(data),
            12 => self.insert(data, YAML),
            13 => self.nest(data),
            _ => self.line(data),
        }
    }

    fn flip(&mut self, data: &mut [u8]) {
        let at = self.below(data.len());
        if let Some(byte) = data.get_mut(at) {
            *byte ^= 1 << self.random.random_range(0..8);
        }
    }

    /// Repeats a part, now and then so often that its cost shows.
    fn repeat(&mut self, data: &mut Vec<u8>) {
        let part = data[self.run(data)].to_vec();
        let times = if self.random.random_bool(0.02) {
            MOST_BYTES / 8 / part.len().max(1)
        } else {
            1 + self.below(4)
        };
        let at = self.below(data.len() + 1);
        data.splice(at..at, part.repeat(times));
    }

    fn noise(&mut self, data: &mut Vec<u8>) {
        let at = self.run(data);
        let noise: Vec<u8> = (0..at.len()).map(|_| self.random.random()).collect();
        data.splice(at, noise);
    }

    /// A part of another seed in the place of a part.
    fn splice(&mut self, data: &mut Vec<u8>) {
        let other = self.seeds.choose(&mut self.random).expect("a seed");
        let part = other[self.run(other)].to_vec();
        let at = self.run(data);
        data.splice(at, part);
    }

    fn insert<'a>(&mut self, data: &mut Vec<u8>, words: impl AsRef<[&'a str]>) {
        if let Some(word) = words.as_ref().choose(&mut self.random) {
            let at = if self.random.random() { self.run(data) } else { self.word_start(data) };
            data.splice(at, word.bytes());
        }
    }

    fn word(&mut self, data: &mut Vec<u8>) {
        self.insert(data, self.target.words);
    }

    /// An empty range where a word begins.
    fn word_start(&mut self, data: &[u8]) -> std::ops::Range<usize> {
        let from = self.below(data.len() + 1);
        let at = data[from..].windows(2).position(|pair| b" ,[{\n:".contains(&pair[0]) && pair[1] > b' ');
        let at = at.map_or(from, |at| from + at + 1);
        at..at
    }

    fn swap(&mut self, data: &mut Vec<u8>) {
        let (a, b) = (self.run(data), self.run(data));
        let (a, b) = if a.start <= b.start { (a, b) } else { (b, a) };
        if a.end <= b.start {
            let first = data[a.clone()].to_vec();
            let second = data[b.clone()].to_vec();
            data.splice(b, first);
            data.splice(a, second);
        }
    }

    /// A number in a text becomes another one.
    fn number(&mut self, data: &mut Vec<u8>) {
        let part = |byte: &u8| byte.is_ascii_digit() || b".-+".contains(byte);
        let from = self.below(data.len());
        let Some(start) = data[from..].iter().position(part).map(|at| from + at) else { return };
        let end =
            data[start..].iter().position(|byte| !part(byte)).map_or(data.len(), |length| start + length);
        let new = *NUMBERS.choose(&mut self.random).expect("a number");
        data.splice(start..end, new.bytes());
    }

    /// A length or a number in bytes becomes another one.
    fn length(&mut self, data: &mut [u8]) {
        let edge =
            [0, 1, 0x7f, 0x80, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0xffff_ffff, 1 << 32, 1 << 40, 1 << 62, !0]
                [self.below(13)];
        let near: u64 = data.len() as u64;
        let float = [f64::NAN, f64::INFINITY, -1.0, 1e300, 1e-300, 0.0][self.below(6)];
        let single = (float as f32).to_bits();
        let value: u64 = match self.below(4) {
            0 | 1 => edge,
            2 => near.wrapping_add_signed(self.random.random_range(-8..8)),
            _ => self.random.random::<u64>() >> self.random.random_range(0..64),
        };
        let bytes: Vec<u8> = match self.below(12) {
            0 => vec![value as u8],
            1 => (value as u16).to_le_bytes().to_vec(),
            2 => (value as u16).to_be_bytes().to_vec(),
            3 | 4 => (value as u32).to_le_bytes().to_vec(),
            5 => (value as u32).to_be_bytes().to_vec(),
            6 | 7 => value.to_le_bytes().to_vec(),
            8 => value.to_be_bytes().to_vec(),
            9 => float.to_le_bytes().to_vec(),
            10 => float.to_be_bytes().to_vec(),
            _ => if self.random.random() { single.to_le_bytes() } else { single.to_be_bytes() }.to_vec(),
        };
        let at = self.below(data.len());
        // Over what is there, so that what follows stays in its place.
        for (byte, new) in data[at..].iter_mut().zip(bytes) {
            *byte = new;
        }
    }

    /// Collections in collections, now and then very deep.
    fn nest(&mut self, data: &mut Vec<u8>) {
        let depth = if self.random.random_bool(0.05) { 40_000 } else { 1 + self.below(80) };
        let [open, close] =
            [["[", "]"], ["{a: ", "}"], ["[", ""], ["- ", ""], ["[*a, ", "]"], ["? ", ""]][self.below(6)];
        let at = self.word_start(data).start;
        let end = data[at..]
            .iter()
            .position(|byte| b",\n]}".contains(byte))
            .map_or(data.len(), |length| at + length);
        data.splice(end..end, close.repeat(depth).into_bytes());
        data.splice(at..at, open.repeat(depth).into_bytes());
    }

    /// A line twice, away, or deeper.
    fn line(&mut self, data: &mut Vec<u8>) {
        let from = self.below(data.len());
        let start = data[..from].iter().rposition(|byte| *byte == b'\n').map_or(0, |at| at + 1);
        let end = data[from..].iter().position(|byte| *byte == b'\n').map_or(data.len(), |at| from + at + 1);
        let line = data[start..end].to_vec();
        match self.below(4) {
            0 => drop(data.drain(start..end)),
            1 => drop(data.splice(start..start, line)),
            2 => drop(data.splice(start..start, *b"  ")),
            _ => {
                let anchor = [
                    b"a: &a ".to_vec(),
                    line,
                    b"b: [".to_vec(),
                    b"*a, ".repeat(1 + self.below(200)),
                    b"]\n".to_vec(),
                ];
                drop(data.splice(start..start, anchor.concat()));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_input_follows_from_seed_target_and_number() {
        let target = crate::target("yaml").unwrap();
        let seeds = [b"a: 1\nb: [2, 3]\n".to_vec()];
        let make = |seed, number| input(&target, &seeds, seed, number);
        assert_eq!(make(1, 0), seeds[0]);
        let inputs: Vec<_> = (1..100).map(|number| make(1, number)).collect();
        assert_eq!(inputs, (1..100).map(|number| make(1, number)).collect::<Vec<_>>());
        assert_ne!(inputs, (1..100).map(|number| make(2, number)).collect::<Vec<_>>());
        assert!(inputs.iter().filter(|input| **input == seeds[0]).count() < 20);
    }
}
