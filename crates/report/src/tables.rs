//! Per-step and per-trial tables. CSV and Parquet are written from one Arrow batch, so they hold the same columns
//! in the same order. No timings: the same results give the same bytes.

use std::sync::Arc;

use arrow::array::{
    Array, ArrayRef, AsArray, BooleanArray, Float64Array, RecordBatch, StringArray, UInt32Array, UInt64Array,
};
use arrow::datatypes::{DataType, Float64Type, UInt32Type, UInt64Type};
use locsim_core::Pose2;
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::{WriterProperties, WriterPropertiesBuilder};

use super::ReportError;
use crate::results::{ModelTrial, RunResults, StepRow};
use crate::trial_row::TrialRow;

/// One row per trial, model and step.
///
/// # Errors
/// None: the columns are of one length.
pub fn steps(results: &RunResults) -> Result<RecordBatch, ReportError> {
    let rows: Vec<(u32, &ModelTrial, &StepRow)> = results
        .trials
        .iter()
        .flat_map(|t| t.models.iter().map(move |m| (t.trial, m)))
        .flat_map(|(trial, m)| m.steps.iter().map(move |s| (trial, m, s)))
        .collect();
    let real = |value: fn(&StepRow) -> f64| -> ArrayRef {
        Arc::new(Float64Array::from_iter_values(rows.iter().map(|(_, _, s)| value(s))))
    };
    let count = |value: fn(&StepRow) -> u32| -> ArrayRef {
        Arc::new(UInt32Array::from_iter_values(rows.iter().map(|(_, _, s)| value(s))))
    };
    let pose = |names: [&'static str; 3], pose: fn(&StepRow) -> Pose2| {
        let component = |pick: fn(Pose2) -> f64| -> ArrayRef {
            Arc::new(Float64Array::from_iter_values(rows.iter().map(|(_, _, s)| pick(pose(s)))))
        };
        names.into_iter().zip([component(|p| p.x), component(|p| p.y), component(|p| p.theta)])
    };
    let columns = [
        ("trial", Arc::new(UInt32Array::from_iter_values(rows.iter().map(|r| r.0))) as ArrayRef),
        ("model", Arc::new(StringArray::from_iter_values(rows.iter().map(|r| &r.1.model)))),
        ("step", count(|s| s.step)),
        ("stamp_secs", real(|s| s.stamp_secs)),
    ]
    .into_iter()
    .chain(pose(["truth_x_m", "truth_y_m", "truth_theta_rad"], |s| s.truth))
    .chain(pose(["dead_reckoning_x_m", "dead_reckoning_y_m", "dead_reckoning_theta_rad"], |s| {
        s.dead_reckoning
    }))
    .chain(pose(["estimate_x_m", "estimate_y_m", "estimate_theta_rad"], |s| s.estimate))
    .chain([
        ("error_along_m", real(|s| s.error_along_m)),
        ("error_across_m", real(|s| s.error_across_m)),
        ("error_heading_rad", real(|s| s.error_heading_rad)),
        ("position_error_m", real(StepRow::position_error_m)),
        ("effective_sample_size", real(|s| s.effective_sample_size)),
        ("likelihood_power", real(|s| s.likelihood_power)),
        ("particles", count(|s| s.particles)),
        ("log_evidence_nats", real(|s| s.log_evidence_nats)),
        ("scan_log_density_nats", real(|s| s.scan_log_density_nats)),
        ("nees", real(|s| s.nees)),
        ("nees_with_shared_errors", real(|s| s.nees_with_shared_errors)),
        ("resampled", Arc::new(rows.iter().map(|(_, _, s)| Some(s.resampled)).collect::<BooleanArray>())),
    ]);
    Ok(RecordBatch::try_from_iter(columns)?)
}

/// One row per trial and model.
///
/// # Errors
/// None: the columns are of one length.
pub fn trials(results: &RunResults) -> Result<RecordBatch, ReportError> {
    let rows =
        results.trials.iter().flat_map(|trial| trial.models.iter().map(move |m| TrialRow::new(trial, m)));
    let rows: Vec<TrialRow> = rows.collect();
    let events = rows.iter().map(TrialRow::events_text);
    let columns = trial_columns(&rows).into_iter();
    let columns = columns.chain([("events", Arc::new(StringArray::from_iter_values(events)) as ArrayRef)]);
    Ok(RecordBatch::try_from_iter(columns)?)
}

/// The figures of rows, a column each.
pub fn trial_columns(rows: &[TrialRow]) -> Vec<(&'static str, ArrayRef)> {
    let count = |value: fn(&TrialRow) -> u32| -> ArrayRef {
        Arc::new(UInt32Array::from_iter_values(rows.iter().map(value)))
    };
    let real = |value: fn(&TrialRow) -> f64| -> ArrayRef {
        Arc::new(Float64Array::from_iter_values(rows.iter().map(value)))
    };
    vec![
        ("trial", count(|row| row.trial)),
        ("seed", Arc::new(UInt64Array::from_iter_values(rows.iter().map(|row| row.seed)))),
        ("model", Arc::new(StringArray::from_iter_values(rows.iter().map(|row| &row.model)))),
        ("steps", count(|row| row.steps)),
        ("lost", Arc::new(rows.iter().map(|row| Some(row.lost)).collect::<BooleanArray>())),
        ("position_rmse_m", real(|row| row.position_rmse_m)),
        ("position_median_m", real(|row| row.position_median_m)),
        ("position_p95_m", real(|row| row.position_p95_m)),
        ("position_max_m", real(|row| row.position_max_m)),
        ("position_final_m", real(|row| row.position_final_m)),
        ("along_mean_m", real(|row| row.along_mean_m)),
        ("along_std_m", real(|row| row.along_std_m)),
        ("across_mean_m", real(|row| row.across_mean_m)),
        ("across_std_m", real(|row| row.across_std_m)),
        ("heading_mean_rad", real(|row| row.heading_mean_rad)),
        ("heading_std_rad", real(|row| row.heading_std_rad)),
        ("ess_mean", real(|row| row.ess_mean)),
        ("resamplings", count(|row| row.resamplings)),
        ("log_evidence_nats", real(|row| row.log_evidence_nats)),
    ]
}

/// The table as CSV (RFC 4180, header first). Reals have as many digits as they need to be read back exactly;
/// one that isn't finite is an empty field.
///
/// # Errors
/// None: memory takes every byte.
pub fn csv(batch: &RecordBatch) -> Result<Vec<u8>, ReportError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(batch.schema_ref().fields().iter().map(|field| field.name()))?;
    for row in 0..batch.num_rows() {
        writer.write_record(batch.columns().iter().map(|column| cell(column, row)))?;
    }
    writer.into_inner().map_err(|error| ReportError::Csv(error.into_error().into()))
}

fn cell(column: &ArrayRef, row: usize) -> String {
    match column.data_type() {
        DataType::UInt32 => column.as_primitive::<UInt32Type>().value(row).to_string(),
        DataType::UInt64 => column.as_primitive::<UInt64Type>().value(row).to_string(),
        DataType::Boolean => column.as_boolean().value(row).to_string(),
        DataType::Float64 => {
            let value = column.as_primitive::<Float64Type>().value(row);
            if value.is_finite() { value.to_string() } else { String::new() }
        }
        _ => column.as_string::<i32>().value(row).to_owned(),
    }
}

/// The table as Parquet, snappy-compressed.
///
/// # Errors
/// None: memory takes every byte.
pub fn parquet(batch: &RecordBatch) -> Result<Vec<u8>, ReportError> {
    let mut bytes = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties().build()))?;
    writer.write(batch)?;
    writer.close()?;
    Ok(bytes)
}

/// How Parquet files are written.
pub fn properties() -> WriterPropertiesBuilder {
    WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_created_by(concat!("locsim ", env!("CARGO_PKG_VERSION")).to_owned())
}
