//! Figures as SVG, and as PNG from the same SVG.

pub mod canvas;
mod density;
mod errors;
pub mod geometry;
pub mod map;

use std::sync::Arc;

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};

use super::ReportError;
use crate::results::{DetailedTrial, RunResults};
use crate::summary::{ORACLE, Summary};
use crate::text::code;

/// Pixels of a PNG per pixel of its SVG: sharp on dense displays and in print.
const PNG_SCALE: f32 = 2.0;

/// The models whose filter is drawn in the snapshots, the first that was recorded.
const SNAPSHOT_PREFERENCE: [&str; 2] = ["np_reg_registered", "np_reg"];

/// One figure of a report.
#[derive(Clone, Debug)]
pub struct Figure {
    /// File name without extension.
    pub name: &'static str,
    /// Content of the figure and how to read it, in one or two sentences.
    pub caption: String,
    /// The picture.
    pub svg: String,
}

impl Figure {
    /// Path of the SVG within the results folder.
    pub fn path(&self) -> String {
        format!("figures/{}.svg", self.name)
    }
}

/// Every figure that the results allow: those of a single trial need `detail`. A simulated drive has a truth, a measured
/// one a reference.
pub(crate) fn all(
    results: &RunResults,
    summary: &Summary,
    detail: Option<&DetailedTrial>,
    simulated: bool,
) -> Result<Vec<Figure>, ReportError> {
    let figure =
        |name, caption: &str, svg: Result<String, canvas::DrawError>| -> Result<Figure, ReportError> {
            let svg = svg.map_err(|error| ReportError::Figure { name, reason: error.to_string() })?;
            Ok(Figure { name, caption: caption.to_owned(), svg })
        };
    let truth = if simulated { "truth" } else { "reference" };
    let oracle = if summary.models.contains_key(ORACLE) { " and `oracle`" } else { "" };
    let mut figures = vec![
        figure(
            "rmse",
            &format!(
                "Position RMSE of each model with its 95 % interval, and its ratio to {}{oracle}. Rings: without the trials lost \
                 by the models compared. Logarithmic axes.",
                code(summary.baseline())
            ),
            errors::forest(summary),
        )?,
        figure(
            "error_distribution",
            "Share of all steps of all trials whose position error is below a value. Further left is better.",
            errors::distribution(results),
        )?,
        figure(
            "error_over_time",
            "Position error over the drive: median over trials and the middle 80 % of them, one panel per model.",
            errors::over_time(results),
        )?,
        figure(
            "effective_sample_size",
            "Median over trials of the effective sample size before resampling.",
            errors::effective_sample_size(results),
        )?,
    ];
    if let Some(detail) = detail {
        figures.push(figure(
            "trajectories",
            &format!(
                "One trial: {truth}, dead reckoning and the most likely trajectory of each model on the map, and the distance \
                 of each to the {truth}."
            ),
            map::trajectories(&results.models, detail, truth),
        )?);
        let preferred = SNAPSHOT_PREFERENCE
            .iter()
            .find_map(|name| detail.models.iter().find(|m| m.name == *name))
            .or(detail.models.first());
        if let Some(model) = preferred {
            figures.push(figure(
                "filter_snapshots",
                "The filter at four steps of the recorded trial, as in the paper's Fig. 10. Right: the particles close \
                 up, stronger with more weight.",
                map::snapshots(&results.models, detail, model, truth),
            )?);
        }
        let probes = density::shortened_beam(detail);
        if !probes.is_empty() {
            figures.push(figure(
                "predicted_densities",
                &format!(
                    "What each model predicts for the same beam of the same particle near the {truth}, whose reading fell \
                     short of the nominal range, as in the paper's Fig. 11; of all such steps of the recorded trial the one \
                     with the median shortfall. The models' own densities, without the floor and the exponent that the filter \
                     applies, on a logarithmic axis."
                ),
                density::predicted(&results.models, &probes),
            )?);
        }
    }
    Ok(figures)
}

/// Turns SVG into PNG with a typeface of its own, so that the picture doesn't depend on the machine's fonts.
pub struct Rasterizer {
    options: Options<'static>,
}

impl Rasterizer {
    /// With the typeface Ubuntu Light.
    #[expect(clippy::new_without_default, reason = "it loads a font")]
    pub fn new() -> Self {
        let mut fonts = fontdb::Database::new();
        fonts.load_font_data(epaint_default_fonts::UBUNTU_LIGHT.to_vec());
        Self { options: Options { fontdb: Arc::new(fonts), ..Options::default() } }
    }

    /// The PNG of a figure.
    ///
    /// # Errors
    /// [`ReportError::Figure`] when the SVG cannot be read or the PNG not be encoded.
    pub fn png(&self, figure: &Figure) -> Result<Vec<u8>, ReportError> {
        let failed = |reason: String| ReportError::Figure { name: figure.name, reason };
        let tree = Tree::from_str(&figure.svg, &self.options).map_err(|error| failed(error.to_string()))?;
        let size = tree.size().to_int_size().scale_by(PNG_SCALE);
        let mut pixmap = size
            .and_then(|size| Pixmap::new(size.width(), size.height()))
            .ok_or_else(|| failed("the figure has no size".to_owned()))?;
        resvg::render(&tree, Transform::from_scale(PNG_SCALE, PNG_SCALE), &mut pixmap.as_mut());
        pixmap.encode_png().map_err(|error| failed(error.to_string()))
    }
}
