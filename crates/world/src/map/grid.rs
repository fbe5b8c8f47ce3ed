use std::path::Path;
use std::sync::Arc;

use glam::DVec2;
use image::codecs::png::PngEncoder;
use image::codecs::pnm::{PnmEncoder, PnmSubtype, SampleEncoding};
use image::error::{ImageFormatHint, UnsupportedError};
use image::{ExtendedColorType, ImageEncoder, ImageError, ImageResult};
use locsim_core::Pose2;
use locsim_core::output::write_file;

use super::geometry::{FreeSpace, bounds_of};
use super::outline::cell_boundaries;
use super::{COARSEST_M, FARTHEST_M, FINEST_M, Geometry, ImageMode, MapError, OccupancyMapFile};

/// The state of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// Nothing is in it.
    Free,
    /// A surface is in it.
    Occupied,
    /// Neither is sure enough.
    Unknown,
}

/// Default thresholds of `map_saver`.
const THRESHOLDS: [f64; 2] = [0.196, 0.65];

/// The format of a grid's image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// A binary greymap (P5).
    Pgm,
    /// Portable Network Graphics.
    Png,
}

/// A grid of square cells over the plane, as in ROS `nav_msgs/OccupancyGrid`.
///
/// Cells are stored row by row from the lower left: cell (column, row) covers `column..column + 1` times the
/// resolution along the grid's x axis and the same along y. The grid's frame is at `origin` in the map frame.
#[derive(Clone, Debug, PartialEq)]
pub struct OccupancyGrid {
    width: usize,
    height: usize,
    resolution_m: f64,
    origin: Pose2,
    // Shared, as the geometry of a grid keeps the grid.
    cells: Arc<Vec<Cell>>,
    occupancy: Arc<Vec<f32>>,
}

impl OccupancyGrid {
    /// A grid of `width` x `height` cells, row by row from the lower left, with cells of `resolution_m` metres.
    /// `origin` is `map_from_grid`, the pose of the grid's lower left corner. `occupancy` is the probability that
    /// a cell is occupied.
    ///
    /// # Errors
    /// [`MapError`] when the sizes don't match or are zero, the resolution is not from [`FINEST_M`] to [`COARSEST_M`],
    /// the origin not finite, or part of the grid farther from 0 than [`FARTHEST_M`].
    pub fn new(
        width: usize,
        height: usize,
        resolution_m: f64,
        origin: Pose2,
        cells: Vec<Cell>,
        occupancy: Vec<f32>,
    ) -> Result<Self, MapError> {
        for given in [cells.len(), occupancy.len()] {
            if given == 0 || width.checked_mul(height) != Some(given) {
                return Err(MapError::GridSize { width, height, cells: given });
            }
        }
        if !(FINEST_M..=COARSEST_M).contains(&resolution_m) {
            return Err(MapError::Resolution(resolution_m));
        }
        let grid = Self {
            width,
            height,
            resolution_m,
            origin,
            cells: Arc::new(cells),
            occupancy: Arc::new(occupancy),
        };
        // False for NaN too.
        if origin.is_finite() && grid.corners().iter().all(|corner| corner.abs().max_element() <= FARTHEST_M)
        {
            return Ok(grid);
        }
        Err(MapError::Origin([origin.x, origin.y, origin.theta]))
    }

    /// [`OccupancyGrid::new`] from the origin, with the cells that the default thresholds of ROS make of probabilities.
    ///
    /// # Errors
    /// Those of [`OccupancyGrid::new`].
    pub fn of_occupancy(
        [width, height]: [usize; 2],
        resolution_m: f64,
        occupancy: Vec<f32>,
    ) -> Result<Self, MapError> {
        let cells = occupancy.iter().map(|&p| match f64::from(p) {
            p if p < THRESHOLDS[0] => Cell::Free,
            p if p > THRESHOLDS[1] => Cell::Occupied,
            _ => Cell::Unknown,
        });
        Self::new(width, height, resolution_m, Pose2::IDENTITY, cells.collect(), occupancy)
    }

    fn corners(&self) -> [DVec2; 4] {
        let (w, h) = (self.width as f64, self.height as f64);
        [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]]
            .map(|corner| self.origin.transform_point(self.resolution_m * DVec2::from_array(corner)))
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Edge length of a cell \[m\].
    pub fn resolution_m(&self) -> f64 {
        self.resolution_m
    }

    /// `map_from_grid`: the pose of the grid's lower left corner.
    pub fn origin(&self) -> Pose2 {
        self.origin
    }

    /// Every cell, row by row from the lower left.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// Probability that each cell is occupied, in the order of [`OccupancyGrid::cells`]; 0.5 where nothing is
    /// known.
    pub fn occupancy(&self) -> &[f32] {
        &self.occupancy
    }

    /// Index of the cell that holds a point of the map frame \[m\]; `None` outside the grid.
    pub fn index_at(&self, x: f64, y: f64) -> Option<usize> {
        let p = self.origin.inverse().transform_point(DVec2::new(x, y)) / self.resolution_m;
        // The comparisons are false for NaN too.
        let inside = p.x >= 0.0 && p.y >= 0.0 && p.x < self.width as f64 && p.y < self.height as f64;
        inside.then(|| p.y as usize * self.width + p.x as usize)
    }

    /// The cell that holds a point of the map frame \[m\]; `None` outside the grid.
    pub fn cell_at(&self, x: f64, y: f64) -> Option<Cell> {
        self.index_at(x, y).map(|i| self.cells[i])
    }

    /// The cells as an image in the shades of `map_saver`: free 254, occupied 0, unknown 205. Occupancies between are
    /// not kept.
    ///
    /// # Panics
    /// The grid has more than 2^32 columns or rows.
    pub fn image_bytes(&self, format: ImageFormat) -> Vec<u8> {
        let shades = self.cells.chunks(self.width).rev().flatten().map(|cell| match cell {
            Cell::Free => 254,
            Cell::Occupied => 0,
            Cell::Unknown => 205,
        });
        let shades: Vec<u8> = shades.collect();
        let [width, height] =
            [self.width, self.height].map(|n| u32::try_from(n).expect("as many as an image has"));
        let mut bytes = Vec::new();
        let written = match format {
            // A greymap (P5) has to be asked for: the default of `image` is PAM (P7), which map servers don't read.
            ImageFormat::Pgm => PnmEncoder::new(&mut bytes)
                .with_subtype(PnmSubtype::Graymap(SampleEncoding::Binary))
                .write_image(&shades, width, height, ExtendedColorType::L8),
            ImageFormat::Png => {
                PngEncoder::new(&mut bytes).write_image(&shades, width, height, ExtendedColorType::L8)
            }
        };
        written.expect("memory takes every byte");
        bytes
    }

    /// Writes [`OccupancyGrid::image_bytes`] to a file, whole or not at all; pgm or png, by the path's extension.
    ///
    /// # Errors
    /// [`MapError::Image`].
    pub fn write_image(&self, path: &Path) -> Result<(), MapError> {
        let write = || -> ImageResult<()> {
            let format = match path.extension().and_then(|extension| extension.to_str()) {
                Some("pgm") => ImageFormat::Pgm,
                Some("png") => ImageFormat::Png,
                _ => {
                    return Err(ImageError::Unsupported(UnsupportedError::from(ImageFormatHint::from(path))));
                }
            };
            Ok(write_file(path, |file| file.write_all(&self.image_bytes(format)))?)
        };
        write().map_err(|source| MapError::Image { path: path.to_owned(), source })
    }

    /// The description that goes with [`OccupancyGrid::write_image`]; `image` is relative to the yaml file.
    pub fn map_file(&self, image: &Path) -> OccupancyMapFile {
        OccupancyMapFile {
            image: image.to_owned(),
            mode: ImageMode::Trinary,
            resolution: self.resolution_m,
            origin: [self.origin.x, self.origin.y, self.origin.theta],
            negate: false,
            occupied_thresh: THRESHOLDS[1],
            free_thresh: THRESHOLDS[0],
        }
    }

    /// The boundaries between occupied cells and others as wall segments; beyond the grid counts as not occupied.
    ///
    /// Collinear boundaries that face the same way are one segment, and each segment is a surface of its own,
    /// called `wall-0`, `wall-1`, .. Unknown cells don't stop rays, and aren't free to stand in.
    ///
    /// # Errors
    /// [`MapError::TooMany`] for more segments than a map may have.
    pub fn to_geometry(&self) -> Result<Geometry, MapError> {
        let segments: Vec<[DVec2; 2]> = cell_boundaries(&self.cells, self.width, self.height)?
            .into_iter()
            .map(|ends| {
                ends.map(|[column, row]| {
                    self.origin.transform_point(self.resolution_m * DVec2::new(column, row))
                })
            })
            .collect();
        let n = segments.len() as u32;
        let bounds = bounds_of(self.corners());
        let names = (0..n).map(|i| format!("wall-{i}")).collect();
        Ok(Geometry::new(segments, (0..n).collect(), names, bounds, FreeSpace::Grid(self.clone())))
    }
}
