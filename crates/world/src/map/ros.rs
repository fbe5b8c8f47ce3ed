use std::path::{Path, PathBuf};

use image::{DynamicImage, GenericImageView, ImageReader};
use locsim_core::Pose2;
use serde::{Deserialize, Deserializer, Serialize};

use super::{Cell, MapError, OccupancyGrid};

/// How the brightness of a pixel becomes an occupancy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ImageMode {
    /// Occupied, free or unknown, by the two thresholds.
    #[default]
    Trinary,
    /// As trinary, but between the thresholds the occupancy rises linearly from 0 to 1, and pixels that are not
    /// opaque are unknown.
    Scale,
    /// The pixel's value, 0 to 255, is the occupancy in percent; values above 100 are unknown. The thresholds
    /// then say which cells are free and which occupied.
    Raw,
}

/// The yaml file of a ROS `map_server` map (`nav2_map_server`, `map_io.cpp`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OccupancyMapFile {
    /// The image, relative to the yaml file's folder. Its first row is the top of the map.
    pub image: PathBuf,
    /// How pixels are read.
    #[serde(default)]
    pub mode: ImageMode,
    /// Edge length of a pixel \[m\].
    pub resolution: f64,
    /// Pose of the lower left pixel's outer corner in the map frame: x \[m\], y \[m\], yaw \[rad\].
    pub origin: [f64; 3],
    /// Whether white is occupied; 0 and 1 are also understood. Raw values are not affected.
    #[serde(default, deserialize_with = "bool_or_integer")]
    pub negate: bool,
    /// Darker than this share is occupied.
    pub occupied_thresh: f64,
    /// Lighter than this share is free.
    pub free_thresh: f64,
}

impl OccupancyMapFile {
    /// Loads the image (pgm, png; 8 or 16 bits; colours are averaged) and reads each pixel as a cell.
    ///
    /// # Errors
    /// [`MapError`] for an image that cannot be read and for values that are out of range.
    pub fn load(&self, folder: &Path) -> Result<OccupancyGrid, MapError> {
        let path = folder.join(&self.image);
        let image = ImageReader::open(&path)
            .and_then(ImageReader::with_guessed_format)
            .map_err(image::ImageError::from)
            .and_then(ImageReader::decode)
            .map_err(|source| MapError::Image { path, source })?;
        self.read_pixels(&image)
    }

    /// The text of the yaml file.
    pub fn to_yaml(&self) -> String {
        let mode = match self.mode {
            ImageMode::Trinary => "trinary",
            ImageMode::Scale => "scale",
            ImageMode::Raw => "raw",
        };
        // Rust quotes printable text as YAML does.
        format!(
            "image: {:?}\nmode: {mode}\nresolution: {}\norigin: {:?}\nnegate: {}\noccupied_thresh: {}\nfree_thresh: {}\n",
            self.image.to_string_lossy(),
            self.resolution,
            self.origin,
            u8::from(self.negate),
            self.occupied_thresh,
            self.free_thresh,
        )
    }

    fn read_pixels(&self, image: &DynamicImage) -> Result<OccupancyGrid, MapError> {
        let thresholds = [self.free_thresh, self.occupied_thresh];
        if !(thresholds.iter().all(|t| (0.0..=1.0).contains(t)) && thresholds[0] < thresholds[1]) {
            return Err(MapError::Thresholds { free: thresholds[0], occupied: thresholds[1] });
        }
        let [x, y, yaw] = self.origin;
        if !self.origin.iter().all(|v| v.is_finite()) {
            return Err(MapError::Origin(self.origin));
        }
        let (width, height) = image.dimensions();
        let pixels = image.to_rgba16();
        let (cells, occupancy) = pixels
            .rows()
            .rev()
            .flatten()
            .map(|pixel| {
                let [r, g, b, alpha] = pixel.0.map(|channel| f64::from(channel) / 65535.0);
                self.read_pixel((r + g + b) / 3.0, alpha)
            })
            .unzip();
        OccupancyGrid::new(
            width as usize,
            height as usize,
            self.resolution,
            Pose2::new(x, y, yaw),
            cells,
            occupancy,
        )
    }

    /// The cell and its occupancy for a pixel of brightness `shade` and opacity `alpha`, both 0 to 1.
    fn read_pixel(&self, shade: f64, alpha: f64) -> (Cell, f32) {
        let (free, occupied) = (self.free_thresh, self.occupied_thresh);
        let darkness = if self.negate { shade } else { 1.0 - shade };
        let unknown = (Cell::Unknown, 0.5);
        let classify = |p: f64, between: f64| {
            if p > occupied {
                (Cell::Occupied, 1.0)
            } else if p < free {
                (Cell::Free, 0.0)
            } else {
                (Cell::Unknown, between as f32)
            }
        };
        match self.mode {
            ImageMode::Trinary => classify(darkness, 0.5),
            ImageMode::Scale if alpha < 1.0 => unknown,
            ImageMode::Scale => classify(darkness, (darkness - free) / (occupied - free)),
            ImageMode::Raw => {
                let percent = (shade * 255.0).round();
                if percent > 100.0 {
                    return unknown;
                }
                let p = percent / 100.0;
                (classify(p, p).0, p as f32)
            }
        }
    }
}

/// `map_server` files write `negate: 0`.
fn bool_or_integer<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "0, 1, true or false")]
    enum BoolOrInteger {
        Bool(bool),
        Integer(u8),
    }
    match BoolOrInteger::deserialize(deserializer)? {
        BoolOrInteger::Bool(value) => Ok(value),
        BoolOrInteger::Integer(0) => Ok(false),
        BoolOrInteger::Integer(1) => Ok(true),
        BoolOrInteger::Integer(other) => {
            Err(serde::de::Error::invalid_value(serde::de::Unexpected::Unsigned(other.into()), &"0 or 1"))
        }
    }
}
