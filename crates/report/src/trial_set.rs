//! The trials of a sweep as Parquet: one row per cell, trial and model, with a column for each axis. A shard writes one
//! file; the merge streams the files of all shards into one data set, partitioned by model.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use arrow::array::{
    Array, ArrayRef, AsArray, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray, UInt32Array,
};
use arrow::compute::{concat_batches, filter_record_batch};
use arrow::datatypes::{DataType, Field, Float64Type, Schema, SchemaRef, UInt32Type};
use indexmap::IndexMap;
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::schema::types::ColumnPath;
use rayon::prelude::*;
use serde_json::Value;

use crate::ReportError;
use crate::store::Folder;
use crate::tables::{properties, trial_columns};
use crate::trial_row::TrialRow;

/// Rows that are written at once. Fixed, so that a file's bytes don't depend on how its rows arrive.
const CHUNK: usize = 1 << 16;
/// Rows of a row group: 20 MB or so while it is written, for each model.
const ROW_GROUP: usize = 2 * CHUNK;

/// The type of an axis' column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisKind {
    /// Whole numbers.
    Whole,
    /// Real numbers.
    Real,
    /// True or false.
    Flag,
    /// Words; lists and maps as JSON.
    Text,
}

impl AxisKind {
    /// The narrowest type that holds all values.
    pub fn of(values: &[Value]) -> Self {
        if values.iter().all(Value::is_boolean) {
            Self::Flag
        } else if values.iter().all(Value::is_i64) {
            Self::Whole
        } else if values.iter().all(Value::is_number) {
            Self::Real
        } else {
            Self::Text
        }
    }

    fn data_type(self) -> DataType {
        match self {
            Self::Whole => DataType::Int64,
            Self::Real => DataType::Float64,
            Self::Flag => DataType::Boolean,
            Self::Text => DataType::Utf8,
        }
    }

    /// A column that holds one value in each of `rows` rows.
    fn column(self, value: &Value, rows: usize) -> ArrayRef {
        match self {
            Self::Whole => Arc::new(Int64Array::from_value(value.as_i64().unwrap_or_default(), rows)),
            Self::Real => Arc::new(Float64Array::from_value(value.as_f64().unwrap_or(f64::NAN), rows)),
            Self::Flag => Arc::new(BooleanArray::from(vec![value.as_bool().unwrap_or_default(); rows])),
            Self::Text => Arc::new(StringArray::from(vec![plain(value); rows])),
        }
    }
}

/// A value as text: a word without quotes, anything else as JSON.
pub fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// Rows of trials with their columns.
pub type Table = RecordBatch;

/// One cell of a sweep.
#[derive(Clone, Copy, Debug)]
pub struct CellRows<'a> {
    /// Its number, from 0.
    pub cell: u32,
    /// Its value on each axis.
    pub values: &'a [Value],
    /// Beams of a scan that the filter used.
    pub beams: u32,
    /// Its rows.
    pub rows: &'a [TrialRow],
}

impl CellRows<'_> {
    /// The rows as a table; `axes` names the columns of the values.
    ///
    /// # Errors
    /// [`ReportError::Table`], where two axes have the same name.
    pub fn table(&self, axes: &[(String, AxisKind)]) -> Result<Table, ReportError> {
        let rows = self.rows;
        let of_all = |value: u32| Arc::new(UInt32Array::from_value(value, rows.len())) as ArrayRef;
        let mut columns = vec![("cell".to_owned(), of_all(self.cell))];
        for ((name, kind), value) in axes.iter().zip(self.values) {
            columns.push((name.clone(), kind.column(value, rows.len())));
        }
        let measured = trial_columns(rows);
        columns.extend(measured.into_iter().map(|(name, column)| (name.to_owned(), column)));
        let particles = Float64Array::from_iter_values(rows.iter().map(|row| row.particles_mean));
        let events = UInt32Array::from_iter_values(rows.iter().map(|row| row.events.len() as u32));
        columns.push(("particles_mean".to_owned(), Arc::new(particles)));
        columns.push(("beams".to_owned(), of_all(self.beams)));
        columns.push(("event_count".to_owned(), Arc::new(events)));
        let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = columns
            .into_iter()
            .map(|(name, array)| (Field::new(name, array.data_type().clone(), false), array))
            .unzip();
        Ok(RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays)?)
    }
}

/// The columns of a table of these axes.
fn schema(axes: &[(String, AxisKind)]) -> Result<SchemaRef, ReportError> {
    let values: Vec<Value> = axes
        .iter()
        .map(|(_, kind)| match kind.data_type() {
            DataType::Boolean => Value::from(false),
            DataType::Utf8 => Value::from(""),
            _ => Value::from(0),
        })
        .collect();
    Ok(CellRows { cell: 0, values: &values, beams: 0, rows: &[] }.table(axes)?.schema())
}

/// Names of the columns that are there on any axes; no axis may have one of them.
pub fn reserved() -> Vec<String> {
    let fields = schema(&[]).map(|schema| schema.fields().iter().map(|field| field.name().clone()).collect());
    fields.unwrap_or_default()
}

/// Writes tables into a Parquet file, one after another.
pub struct TrialFile {
    writer: ArrowWriter<File>,
    schema: SchemaRef,
    waiting: Vec<RecordBatch>,
    waiting_rows: usize,
    rows: u64,
}

impl TrialFile {
    /// A file at `path` for tables of these axes.
    ///
    /// # Errors
    /// [`ReportError`] for a file that cannot be written.
    pub fn create(path: &Path, axes: &[(String, AxisKind)]) -> Result<Self, ReportError> {
        Self::with_schema(path, schema(axes)?)
    }

    fn with_schema(path: &Path, schema: SchemaRef) -> Result<Self, ReportError> {
        let file = File::create(path).map_err(parquet::errors::ParquetError::from)?;
        let mut properties = properties().set_max_row_group_row_count(Some(ROW_GROUP));
        // Measured numbers hardly repeat: a dictionary of them takes time and saves nothing.
        for field in schema.fields().iter().filter(|field| *field.data_type() == DataType::Float64) {
            let column = ColumnPath::new(vec![field.name().clone()]);
            properties = properties.set_column_dictionary_enabled(column, false);
        }
        let writer = ArrowWriter::try_new(file, Arc::clone(&schema), Some(properties.build()))?;
        Ok(Self { writer, schema, waiting: Vec::new(), waiting_rows: 0, rows: 0 })
    }

    /// Appends a table.
    ///
    /// # Errors
    /// [`ReportError`] for a table of other columns, and a file that cannot be written.
    pub fn push(&mut self, table: Table) -> Result<(), ReportError> {
        self.waiting_rows += table.num_rows();
        self.rows += table.num_rows() as u64;
        self.waiting.push(table);
        if self.waiting_rows >= CHUNK {
            let table = concat_batches(&self.schema, &self.waiting)?;
            let whole = table.num_rows() / CHUNK * CHUNK;
            for start in (0..whole).step_by(CHUNK) {
                self.writer.write(&table.slice(start, CHUNK))?;
            }
            // Copied, so that the rest doesn't keep all of it in memory.
            let rest = concat_batches(&self.schema, [&table.slice(whole, table.num_rows() - whole)])?;
            self.waiting_rows = rest.num_rows();
            self.waiting = vec![rest];
        }
        Ok(())
    }

    /// Completes the file. Returns its number of rows.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn finish(mut self) -> Result<u64, ReportError> {
        let rest = concat_batches(&self.schema, &self.waiting)?;
        if rest.num_rows() > 0 {
            self.writer.write(&rest)?;
        }
        let file = self.writer.into_inner()?;
        file.sync_all().map_err(parquet::errors::ParquetError::from)?;
        Ok(self.rows)
    }
}

/// The tables of a Parquet file, of some ten thousand rows each.
///
/// # Errors
/// [`ReportError::Parquet`] for a file that is not whole.
pub fn read(path: &Path) -> Result<impl Iterator<Item = Result<Table, ReportError>> + use<>, ReportError> {
    let file = File::open(path).map_err(parquet::errors::ParquetError::from)?;
    let reader = ParquetRecordBatchReaderBuilder::try_new(file)?.with_batch_size(CHUNK).build()?;
    Ok(reader.map(|table| Ok(table?)))
}

/// A data set in a folder: `NAME/model=LABEL/part-0.parquet`.
pub struct TrialSet<'a> {
    folder: &'a Folder,
    name: &'static str,
    models: IndexMap<String, TrialFile>,
}

impl<'a> TrialSet<'a> {
    /// A data set called `name`, without rows.
    pub fn new(folder: &'a Folder, name: &'static str) -> Self {
        Self { folder, name, models: IndexMap::new() }
    }

    /// Appends a table, each row to the part of its model.
    ///
    /// # Errors
    /// [`ReportError`] for a file that cannot be written.
    pub fn push(&mut self, table: &Table) -> Result<(), ReportError> {
        let place = table.schema_ref().index_of("model")?;
        let labels = table.column(place).as_string::<i32>();
        let mut rest = table.clone();
        rest.remove_column(place);
        // Index of the file of each row.
        let mut places = Vec::with_capacity(table.num_rows());
        for label in labels.iter().flatten() {
            places.push(if let Some(place) = self.models.get_index_of(label) {
                place
            } else {
                let path = self.folder.claim(&format!("{}/model={label}/part-0.parquet", self.name))?;
                self.models.insert_full(label.to_owned(), TrialFile::with_schema(&path, rest.schema())?).0
            });
        }
        // Writing the files is most of the work of a merge.
        let files: Vec<(usize, &mut TrialFile)> = self.models.values_mut().enumerate().collect();
        files.into_par_iter().try_for_each(|(i, file)| {
            let mask: BooleanArray = places.iter().map(|place| Some(*place == i)).collect();
            file.push(filter_record_batch(&rest, &mask)?)
        })
    }

    /// Completes the files. Returns the number of rows of each model.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn finish(self) -> Result<IndexMap<String, u64>, ReportError> {
        self.models.into_iter().map(|(model, file)| Ok((model, file.finish()?))).collect()
    }
}

/// The figures of a row that summaries of cells are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured<'a> {
    /// The cell.
    pub cell: u32,
    /// Label of the model.
    pub model: &'a str,
    /// Number of scans.
    pub steps: u32,
    /// Whether the trial is lost.
    pub lost: bool,
    /// Root of the mean squared position error \[m\].
    pub position_rmse_m: f64,
    /// Mean number of particles.
    pub particles_mean: f64,
    /// Beams of a scan.
    pub beams: u32,
}

/// Calls `tell` with each row of a table.
///
/// # Errors
/// [`ReportError::Table`] for a table of other columns.
pub fn for_each(table: &Table, mut tell: impl FnMut(Measured<'_>)) -> Result<(), ReportError> {
    let column = |name: &str| Ok::<_, ReportError>(table.column(table.schema_ref().index_of(name)?));
    let (cell, steps, beams) = (column("cell")?, column("steps")?, column("beams")?);
    let [cell, steps, beams] = [cell, steps, beams].map(AsArray::as_primitive::<UInt32Type>);
    let (rmse, particles) = (column("position_rmse_m")?, column("particles_mean")?);
    let [rmse, particles] = [rmse, particles].map(AsArray::as_primitive::<Float64Type>);
    let (model, lost) = (column("model")?.as_string::<i32>(), column("lost")?.as_boolean());
    for row in 0..table.num_rows() {
        tell(Measured {
            cell: cell.value(row),
            model: model.value(row),
            steps: steps.value(row),
            lost: lost.value(row),
            position_rmse_m: rmse.value(row),
            particles_mean: particles.value(row),
            beams: beams.value(row),
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(count: u32) -> Vec<TrialRow> {
        let row = |i: u32| TrialRow {
            trial: i / 2,
            seed: u64::from(i),
            model: ["a", "b"][i as usize % 2].to_owned(),
            steps: 5,
            lost: i.is_multiple_of(7),
            position_rmse_m: f64::from(i).sin().abs(),
            position_median_m: 0.1,
            position_p95_m: 0.2,
            position_max_m: 0.3,
            position_final_m: f64::NAN,
            along_mean_m: 0.0,
            along_std_m: 0.0,
            across_mean_m: 0.0,
            across_std_m: 0.0,
            heading_mean_rad: 0.0,
            heading_std_rad: 0.0,
            ess_mean: 50.0,
            resamplings: i,
            log_evidence_nats: -f64::from(i),
            particles_mean: 100.0,
            step_ms: 0.1,
            events: Vec::new(),
        };
        (0..count).map(row).collect()
    }

    /// The bytes of a data set don't depend on how many rows come at once.
    #[test]
    fn bytes_do_not_depend_on_how_rows_arrive() {
        let axes = [("laser.beams".to_owned(), AxisKind::Whole), ("map.file".to_owned(), AxisKind::Text)];
        let rows = rows(300_000);
        let values = [Value::from(12), Value::from("a.yaml")];
        let bytes = |at_once: usize| {
            let folder = tempfile::tempdir().unwrap();
            let folder = Folder::new(&folder.path().join("set")).unwrap();
            let mut set = TrialSet::new(&folder, "trials");
            for rows in rows.chunks(at_once) {
                let cell = CellRows { cell: 0, values: &values, beams: 12, rows };
                set.push(&cell.table(&axes).unwrap()).unwrap();
            }
            let counts = set.finish().unwrap();
            assert_eq!(
                counts.into_iter().collect::<Vec<_>>(),
                [("a".to_owned(), 150_000), ("b".to_owned(), 150_000)]
            );
            ["a", "b"].map(|model| {
                std::fs::read(folder.path().join(format!("trials/model={model}/part-0.parquet"))).unwrap()
            })
        };
        let whole = bytes(300_000);
        assert_eq!(whole, bytes(1000));
        assert_eq!(whole, bytes(70_001));
        assert_ne!(whole[0], whole[1]);
    }

    #[test]
    fn columns_have_the_type_of_their_values() {
        let kind = |values: serde_json::Value| AxisKind::of(values.as_array().unwrap());
        for (values, expected) in [
            (serde_json::json!([1, 2]), AxisKind::Whole),
            (serde_json::json!([1, 2.5]), AxisKind::Real),
            (serde_json::json!([true, false]), AxisKind::Flag),
            (serde_json::json!(["a", 1]), AxisKind::Text),
            (serde_json::json!([["classic"]]), AxisKind::Text),
        ] {
            assert_eq!(kind(values), expected);
        }
        assert_eq!(plain(&serde_json::json!({"kld": {"min": 1}})), "{\"kld\":{\"min\":1}}");
    }
}
