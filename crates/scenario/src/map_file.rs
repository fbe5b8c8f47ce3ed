use std::path::{Path, PathBuf};

use locsim_world::map::{
    Cell, Geometry, ImageMode, MapError, MeasuredMap, OccupancyMapFile, Polyline, VectorMap,
};
use serde::Deserialize;

use super::key_path::join;
use super::{Problem, ScenarioError};
use crate::yaml;

/// A map as read from its file.
#[derive(Clone, Debug)]
pub struct LoadedMap {
    /// Its walls.
    pub geometry: Geometry,
    /// The image that a ROS `map_server` YAML names; `None` for a vector map.
    pub image: Option<PathBuf>,
    /// Side of a cell \[m\]; `None` for a map of lines.
    pub cell_m: Option<f64>,
}

/// The keys that distinguish the kinds of map files.
#[derive(Deserialize)]
struct Kind {
    image: Option<serde::de::IgnoredAny>,
    resolution: Option<serde::de::IgnoredAny>,
    occupied_thresh: Option<serde::de::IgnoredAny>,
    seen: Option<serde::de::IgnoredAny>,
}

/// Reads a map file: a ROS `map_server` YAML if it has the key `image`, a measured map if it has `seen`, a vector map
/// otherwise. An image is looked up in the file's own folder.
///
/// # Errors
/// [`ScenarioError`] naming the map file, and where it can the line and the key that are wrong.
pub fn load_map(path: &Path) -> Result<LoadedMap, ScenarioError> {
    let read = || {
        let text = yaml::read(path)?;
        let (kind, locations) = yaml::parse::<Kind>(path, &text)?;
        Ok((text, kind, locations))
    };
    let (text, kind, locations) =
        read().map_err(|error| if locsim_dataset::is_beesoft_map(path) { beesoft(path) } else { error })?;
    let invalid = |key: String, error: &MapError| ScenarioError::Invalid {
        file: path.to_owned(),
        problems: vec![Problem { line: locations.line(&key), key, message: error.to_string() }],
    };
    // One without `image` lacks that key.
    if kind.image.is_some() || kind.resolution.is_some() || kind.occupied_thresh.is_some() {
        let (map, _) = yaml::parse::<OccupancyMapFile>(path, &text)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let geometry = map
            .load(folder)
            .and_then(|grid| grid.to_geometry())
            .map_err(|error| invalid(key_of_grid_error(&error).to_owned(), &error))?;
        Ok(LoadedMap { geometry, image: Some(folder.join(&map.image)), cell_m: Some(map.resolution) })
    } else if kind.seen.is_some() {
        let (map, _) = yaml::parse::<MeasuredMap>(path, &text)?;
        let geometry = map.to_geometry().map_err(|error| invalid(key_of_measured_error(&error), &error))?;
        Ok(LoadedMap { geometry, image: None, cell_m: None })
    } else {
        let (map, _) = yaml::parse::<VectorMap>(path, &text)?;
        let geometry =
            map.to_geometry().map_err(|error| invalid(key_of_vector_error(&map, &error), &error))?;
        Ok(LoadedMap { geometry, image: None, cell_m: None })
    }
}

/// Share of a robot's positions that a right reading of a map leaves in free space, at least.
const MOSTLY: f64 = 0.9;

/// Checks that a ROS map isn't read the wrong way around: by a wrong `negate`, or by a `mode` that its image wasn't written for.
/// `map` was read from `path`, and `positions` are places where the robot was \[m\].
///
/// A key is wrong if at most half of the positions are in free space, and with another value of the key nearly all are and more
/// cells are free. Positions inside walls don't do that alone: a floor has more cells than its walls.
///
/// # Errors
/// [`ScenarioError`] naming the map file, the line and the key.
pub fn check_reading(path: &Path, map: &Geometry, positions: &[[f64; 2]]) -> Result<(), ScenarioError> {
    let count = |map: &Geometry| positions.iter().filter(|[x, y]| map.is_free(*x, *y)).count();
    let free = count(map);
    if 2 * free > positions.len() || positions.is_empty() {
        return Ok(());
    }
    let text = yaml::read(path)?;
    if !yaml::has_key(&text, "image") {
        return Ok(());
    }
    let (file, locations) = yaml::parse::<OccupancyMapFile>(path, &text)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let read = |file: &OccupancyMapFile| {
        let grid = file.load(folder).ok()?;
        let cells = |cell| grid.cells().iter().filter(|other| **other == cell).count();
        Some(Reading {
            free: cells(Cell::Free),
            unknown: cells(Cell::Unknown),
            positions: count(&grid.to_geometry().ok()?),
        })
    };
    let Some(own) = read(&file) else { return Ok(()) };
    let negated = OccupancyMapFile { negate: !file.negate, ..file.clone() };
    let digit = |negate| u8::from(negate).to_string();
    let mut others = vec![("negate", digit(file.negate), digit(negated.negate), negated)];
    for mode in [ImageMode::Trinary, ImageMode::Scale, ImageMode::Raw] {
        let other = OccupancyMapFile { mode, ..file.clone() };
        others.push(("mode", file.mode.to_string(), mode.to_string(), other));
    }
    // The first of those that leave the fewest cells unknown.
    let right = others
        .into_iter()
        .filter_map(|(key, value, other, file)| Some((read(&file)?, key, value, other)))
        .filter(|(other, ..)| {
            other.free > own.free && other.positions as f64 >= MOSTLY * positions.len() as f64
        })
        .min_by_key(|(other, ..)| other.unknown);
    let Some((right, key, value, other)) = right else { return Ok(()) };
    let message = format!(
        "{value} is not allowed for this image: {free} of the {} positions of the robot would be in free space; with `{key}: \
         {other}` {} are",
        positions.len(),
        right.positions
    );
    let problems = vec![Problem { line: locations.line(key), key: key.to_owned(), message }];
    Err(ScenarioError::Invalid { file: path.to_owned(), problems })
}

/// What one way of reading a map's image gives.
struct Reading {
    /// Cells.
    free: usize,
    unknown: usize,
    /// Positions of the robot that are in free space.
    positions: usize,
}

/// The error for a map that has to be converted.
fn beesoft(path: &Path) -> ScenarioError {
    let message = "this is a map of BeeSoft, which `locsim convert` makes a ROS map of".to_owned();
    ScenarioError::Invalid { file: path.to_owned(), problems: vec![Problem::of_file(message)] }
}

/// The key of a `map_server` file that an error is about; empty for the whole file.
fn key_of_grid_error(error: &MapError) -> &'static str {
    match error {
        MapError::Resolution(_) => "resolution",
        MapError::Origin(_) => "origin",
        MapError::Thresholds { free, .. } if !(0.0..1.0).contains(free) => "free_thresh",
        MapError::Thresholds { .. } => "occupied_thresh",
        MapError::Image { .. }
        | MapError::ImageSize { .. }
        | MapError::TooMany(_)
        | MapError::Extent { .. }
        | MapError::GridSize { .. } => "image",
        _ => "",
    }
}

/// The key of a measured map that an error is about; empty for the whole file.
fn key_of_measured_error(error: &MapError) -> String {
    let (name, point) = match error {
        MapError::NotFinite { polyline, point, .. }
        | MapError::TooFar { polyline, point, .. }
        | MapError::ZeroLengthEdge { polyline, point, .. } => (polyline, *point),
        MapError::Wall { wall, key, .. } => {
            return format!("walls[{}].{key}", wall.strip_prefix("wall-").unwrap_or_default());
        }
        _ => return "seen".to_owned(),
    };
    match (name.strip_prefix("wall-"), name.strip_prefix("seen-")) {
        (Some(wall), _) => format!("walls[{wall}].{}", if point == 0 { "from_m" } else { "to_m" }),
        (_, Some(ring)) => format!("seen[{ring}][{point}]"),
        _ => String::new(),
    }
}

/// The key of a vector map that an error is about; empty for the whole file.
fn key_of_vector_error(map: &VectorMap, error: &MapError) -> String {
    let (name, point) = match error {
        MapError::NotFinite { polyline, point, .. }
        | MapError::TooFar { polyline, point, .. }
        | MapError::ZeroLengthEdge { polyline, point, .. } => (polyline, Some(*point)),
        MapError::OutOfReach { wall, point, .. } => (wall, Some(*point)),
        MapError::TooFewPoints { polyline, .. }
        | MapError::NoArea { polyline }
        | MapError::Crosses { polyline, .. }
        | MapError::DuplicateName { polyline, .. }
        | MapError::NoSuchEdge { polyline, .. }
        | MapError::EdgeNamedTwice { polyline, .. } => (polyline, None),
        _ => return String::new(),
    };
    if let Some(i) = map.walls.iter().position(|wall| wall.name == *name) {
        let end = point.map_or("", |point| if point == 0 { ".from_m" } else { ".to_m" });
        return format!("walls[{i}]{end}");
    }
    let named = |polyline: &Polyline, default: &str| polyline.name.as_deref().unwrap_or(default) == *name;
    let polyline = if named(&map.outline, "outline") {
        "outline".to_owned()
    } else {
        let mut obstacles = map.obstacles.iter().enumerate();
        match obstacles.find(|(i, obstacle)| named(obstacle, &format!("obstacle-{i}"))) {
            Some((i, _)) => format!("obstacles[{i}]"),
            None => return String::new(),
        }
    };
    point.map_or_else(|| polyline.clone(), |point| join(&polyline, &format!("points_m[{point}]")))
}
