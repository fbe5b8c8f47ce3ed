use std::fmt;
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use image::{DynamicImage, ImageBuffer, ImageDecoder, ImageError, ImageReader, ImageResult, Pixel};
use locsim_core::Pose2;
use locsim_core::limits::Limits;
use serde::de::{self, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{Cell, MapError, OccupancyGrid};

/// How the brightness of a pixel becomes an occupancy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, strum::Display)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
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
    #[serde(default, deserialize_with = "bool_or_integer", serialize_with = "as_integer")]
    pub negate: bool,
    /// Darker than this share is occupied.
    pub occupied_thresh: f64,
    /// Lighter than this share is free.
    pub free_thresh: f64,
}

/// A yaw beyond a turn is one in degrees \[rad\].
const MOST_YAW_RAD: f64 = 7.0;

impl OccupancyMapFile {
    /// Loads the image (pgm, png; 8 or 16 bits; colours are averaged) and reads each pixel as a cell.
    ///
    /// # Errors
    /// [`MapError`] for an image that cannot be read and for values that are out of range.
    pub fn load(&self, folder: &Path) -> Result<OccupancyGrid, MapError> {
        let thresholds = [self.free_thresh, self.occupied_thresh];
        if !(thresholds.iter().all(|t| (0.0..=1.0).contains(t)) && thresholds[0] < thresholds[1]) {
            return Err(MapError::Thresholds { free: thresholds[0], occupied: thresholds[1] });
        }
        let image = decode(&folder.join(&self.image), &self.image)?;
        let eight_bits = |channel: u8| f64::from(u16::from(channel) * 257) / 65535.0;
        let sixteen_bits = |channel: u16| f64::from(channel) / 65535.0;
        match &image {
            DynamicImage::ImageLuma8(image) => self.read_pixels(image, eight_bits),
            DynamicImage::ImageLumaA8(image) => self.read_pixels(image, eight_bits),
            DynamicImage::ImageRgb8(image) => self.read_pixels(image, eight_bits),
            DynamicImage::ImageRgba8(image) => self.read_pixels(image, eight_bits),
            DynamicImage::ImageLuma16(image) => self.read_pixels(image, sixteen_bits),
            DynamicImage::ImageLumaA16(image) => self.read_pixels(image, sixteen_bits),
            DynamicImage::ImageRgb16(image) => self.read_pixels(image, sixteen_bits),
            DynamicImage::ImageRgba16(image) => self.read_pixels(image, sixteen_bits),
            image => self.read_pixels(&image.to_rgba16(), sixteen_bits),
        }
    }

    /// Reads each pixel as a cell; `share` is a channel's share of full brightness or opacity.
    fn read_pixels<P: Pixel>(
        &self,
        image: &ImageBuffer<P, Vec<P::Subpixel>>,
        share: impl Fn(P::Subpixel) -> f64,
    ) -> Result<OccupancyGrid, MapError> {
        let [x, y, yaw] = self.origin;
        // A yaw in degrees would turn the map anyhow.
        if !(self.origin.iter().all(|v| v.is_finite()) && yaw.abs() <= MOST_YAW_RAD) {
            return Err(MapError::Origin(self.origin));
        }
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut cells = Vec::with_capacity(width * height);
        let mut occupancy = Vec::with_capacity(width * height);
        for pixel in image.rows().rev().flatten() {
            let [r, g, b, alpha] = pixel.to_rgba().0.map(&share);
            let (cell, p) = self.read_pixel((r + g + b) / 3.0, alpha);
            cells.push(cell);
            occupancy.push(p);
        }
        OccupancyGrid::new(width, height, self.resolution, Pose2::new(x, y, yaw), cells, occupancy)
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

/// Bytes of an image file beside its pixels: names, comments, profiles.
const MOST_BESIDE: u64 = 1 << 20;
/// Greatest size of a decoded pixel \[bytes\]: four channels of 16 bits.
const MOST_PER_PIXEL: u64 = 8;
/// Greatest size of a pixel in a file \[bytes\]: three channels of five digits and a blank.
const MOST_WRITTEN: u64 = 18;

const CUT_OFF: &str = "it ends before its last pixel";

/// Decodes an image that has no more pixels than are allowed. Errors call it by `name`, as its map does.
fn decode(path: &Path, name: &Path) -> Result<DynamicImage, MapError> {
    let limits = Limits::current();
    let other = |what: &str| {
        let source = ImageError::IoError(io::Error::other(what));
        MapError::Image { path: name.to_owned(), source }
    };
    let failed = |source| match source {
        ImageError::IoError(error) if error.kind() == io::ErrorKind::UnexpectedEof => other(CUT_OFF),
        ImageError::Limits(_) => other(&format!(
            "it needs more memory than images of {} pixels do; `--limit map_pixels=N` raises it",
            limits.map_pixels
        )),
        source => MapError::Image { path: name.to_owned(), source },
    };
    let size_is_allowed = |pixels: u64| {
        if pixels <= limits.map_pixels {
            return Ok(());
        }
        let refusal = limits.refusal("map_pixels", pixels);
        Err(MapError::ImageSize { path: name.to_owned(), refusal })
    };
    let found = fs::metadata(path).map_err(|error| failed(error.into()))?;
    if !found.is_file() {
        return Err(other("it is no file"));
    }
    size_is_allowed(found.len().saturating_sub(MOST_BESIDE) / MOST_WRITTEN)?;
    let decoder = || -> ImageResult<_> {
        let mut reader = ImageReader::open(path)?.with_guessed_format()?;
        let mut allocated = image::Limits::no_limits();
        let most = limits.map_pixels.saturating_mul(MOST_PER_PIXEL).saturating_add(MOST_BESIDE);
        allocated.max_alloc = Some(most);
        reader.limits(allocated);
        let is_compressed = reader.format() == Some(image::ImageFormat::Png);
        Ok((reader.into_decoder()?, is_compressed))
    };
    let (decoder, is_compressed) = decoder().map_err(failed)?;
    let (width, height) = decoder.dimensions();
    size_is_allowed(u64::from(width) * u64::from(height))?;
    // Packed bitmaps have eight pixels in a byte; nothing else is shorter than its pixels without compression.
    if !is_compressed && decoder.total_bytes() / 8 > found.len() {
        return Err(other(CUT_OFF));
    }
    let raster = decoder.total_bytes();
    if let Some(header) = pgm_header(path).map_err(|error| failed(error.into()))? {
        if header.is_text && header.end + 2 + raster == found.len() {
            return Err(other(
                "its header ends in CR LF, of which the second would be its first pixel: one blank is needed there",
            ));
        }
        if let Some(sample) = header.sample_above(path).map_err(|error| failed(error.into()))? {
            return Err(other(&format!(
                "it has a sample of {sample}; at most {}, the greatest that its header tells",
                header.greatest
            )));
        }
    }
    DynamicImage::from_decoder(decoder).map_err(failed)
}

/// Bytes that the header of a PGM is looked for in.
const MOST_HEADER: u64 = 4096;

/// The header of a binary PGM: magic, width, height, greatest value.
struct PgmHeader {
    /// Bytes up to the blank before the first sample.
    end: u64,
    greatest: u16,
    /// It ends in CR LF, as programs write it that take it for text.
    is_text: bool,
}

impl PgmHeader {
    /// The first sample above the greatest that the header tells. No larger image than is allowed is looked at.
    fn sample_above(&self, path: &Path) -> io::Result<Option<u16>> {
        if [u16::from(u8::MAX), u16::MAX].contains(&self.greatest) {
            return Ok(None);
        }
        let bytes = fs::read(path)?;
        let samples = bytes.get(self.end as usize + 1..).unwrap_or_default();
        let is_above = |sample: &u16| *sample > self.greatest;
        Ok(if self.greatest < u8::MAX.into() {
            samples.iter().map(|&sample| sample.into()).find(is_above)
        } else {
            samples.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).find(is_above)
        })
    }
}

/// The header of a file; `None` where it is no binary PGM.
fn pgm_header(path: &Path) -> io::Result<Option<PgmHeader>> {
    let mut head = Vec::new();
    fs::File::open(path)?.take(MOST_HEADER).read_to_end(&mut head)?;
    let (mut tokens, mut at) = (0, 0);
    while head.starts_with(b"P5") && at < head.len() {
        if head[at] == b'#' {
            at += head[at..].iter().take_while(|byte| **byte != b'\n').count();
        } else if head[at].is_ascii_whitespace() {
            at += 1;
        } else {
            let token = head[at..].split(u8::is_ascii_whitespace).next().unwrap_or_default();
            at += token.len();
            tokens += 1;
            if tokens == 4 {
                let greatest = std::str::from_utf8(token).ok().and_then(|token| token.parse().ok());
                let is_text = head[at..].starts_with(b"\r\n");
                return Ok(greatest.map(|greatest| PgmHeader { end: at as u64, greatest, is_text }));
            }
        }
    }
    Ok(None)
}

/// `map_server` files write `negate: 0`.
/// ROS 1 reads nothing else.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn as_integer<S: Serializer>(value: &bool, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_u8(u8::from(*value))
}

fn bool_or_integer<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    struct BoolOrInteger;

    impl Visitor<'_> for BoolOrInteger {
        type Value = bool;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("0, 1, true or false")
        }

        fn visit_bool<E: de::Error>(self, value: bool) -> Result<bool, E> {
            Ok(value)
        }

        fn visit_u64<E: de::Error>(self, value: u64) -> Result<bool, E> {
            match value {
                0 => Ok(false),
                1 => Ok(true),
                other => Err(E::invalid_value(Unexpected::Unsigned(other), &self)),
            }
        }
    }

    deserializer.deserialize_any(BoolOrInteger)
}
