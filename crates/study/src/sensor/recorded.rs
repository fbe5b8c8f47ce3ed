use std::collections::BTreeMap;
use std::path::Path;

use distreg::Dataset;
use locsim_core::limits::{Limits, is_hidden, quoted};

use crate::StudyError;
use locsim_report::statistics::quantile;
use locsim_scenario::limited;

/// Rows of a table, at the most.
const MOST_ROWS: usize = 1_000_000;
/// Columns of a table, at the most.
const MOST_COLUMNS: usize = 10_000;
/// State columns of a table, at the most; each takes bandwidths.
const MOST_COORDINATES: usize = 100;
/// Letters of a column's name, at the most.
const MOST_LETTERS: usize = 100;
/// The largest number of a table, either way.
const LARGEST: f64 = 1e12;

/// One ray of a static lidar.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RaySummary {
    /// Its number.
    pub ray: usize,
    /// Its readings, but for the first scans, in the order of the scans \[m\]; no return is left out.
    pub readings: Vec<f64>,
}

/// A static lidar's states and observations, and its rays.
pub(crate) struct StaticLidar {
    /// One state per ray that is used.
    pub data: Dataset,
    /// The same rays.
    pub rays: Vec<RaySummary>,
    /// Rays of the file.
    pub all_rays: usize,
    /// Scans of the file.
    pub scans: usize,
    /// Share of readings that had no return, over the rays that are used.
    pub no_return_share: f64,
}

/// Reads scans of a lidar that stands still: one scan per line, one range \[m\] per ray, `inf` where nothing
/// returned.
///
/// Without a map the first `map_scans` scans stand in for it. The state of a ray is (median range, half the difference of
/// its neighbours' median ranges, distance of its own from their mean), all in metres: how far the surface is, how it
/// slants, and whether there is an edge. The other scans are the observations, given that something returned.
///
/// # Errors
/// [`StudyError::Data`] naming the line.
pub(crate) fn read_static_lidar(
    path: &Path,
    map_scans: usize,
    least_share: f64,
) -> Result<StaticLidar, StudyError> {
    let scans: Vec<Vec<f64>> = read_rows(path, false)?.1.into_iter().map(|(_, scan)| scan).collect();
    let wrong = |line, what| StudyError::Data { path: path.to_owned(), line, what };
    let all_rays = scans.first().map_or(0, Vec::len);
    if all_rays < 3 {
        return Err(wrong(Some(1), format!("{all_rays} columns are not allowed; at least 3 rays")));
    }
    if scans.len() < map_scans + 2 {
        let what = format!(
            "{} scans are not enough; more than sensor.static_lidar.map_scans = {map_scans}",
            scans.len()
        );
        return Err(wrong(None, what));
    }
    let (first, rest) = scans.split_at(map_scans);
    let returned = |scans: &[Vec<f64>], ray: usize| -> Vec<f64> {
        scans.iter().map(|scan| scan[ray]).filter(|range| range.is_finite()).collect()
    };
    let enough = |count: usize, of: usize| count > 1 && count as f64 >= least_share * of as f64;
    let mut medians = Vec::new();
    let mut rays = Vec::new();
    let mut no_return = 0;
    for ray in 0..all_rays {
        let (mut before, readings) = (returned(first, ray), returned(rest, ray));
        if enough(before.len(), first.len()) && enough(readings.len(), rest.len()) {
            before.sort_by(f64::total_cmp);
            medians.push(quantile(&before, 0.5));
            no_return += rest.len() - readings.len();
            rays.push(RaySummary { ray, readings });
        }
    }
    if rays.len() < 3 {
        return Err(wrong(None, format!("{} rays return often enough; at least 3 are needed", rays.len())));
    }
    let mut data = Dataset::new(3);
    let n = rays.len();
    for (i, ray) in rays.iter().enumerate() {
        let (left, own, right) = (medians[(i + n - 1) % n], medians[i], medians[(i + 1) % n]);
        let state = [own, 0.5 * (right - left).abs(), (0.5 * (left + right) - own).abs()];
        data.push(&state, &ray.readings)?;
    }
    let no_return_share = no_return as f64 / (n * rest.len()) as f64;
    Ok(StaticLidar { data, rays, all_rays, scans: scans.len(), no_return_share })
}

/// Reads a table with a line of names: state columns, then the observation. Rows with equal states are repeated
/// observations of one state, wherever they stand.
///
/// # Errors
/// [`StudyError::Data`] naming the line.
pub(crate) fn read_table(path: &Path) -> Result<(Vec<String>, Dataset), StudyError> {
    let (names, rows) = read_rows(path, true)?;
    let wrong = |line, what: String| StudyError::Data { path: path.to_owned(), line, what };
    let Some(dim) = names.len().checked_sub(1).filter(|dim| *dim > 0) else {
        return Err(wrong(
            Some(1),
            "one column is not allowed; state columns, then the observation".to_owned(),
        ));
    };
    if dim > MOST_COORDINATES {
        return Err(wrong(
            Some(1),
            format!("{dim} state columns are not allowed; at most {MOST_COORDINATES}"),
        ));
    }
    for (i, name) in names.iter().enumerate() {
        let fits = (1..=MOST_LETTERS).contains(&name.chars().count()) && !name.contains(is_hidden);
        if !fits || names[..i].contains(name) {
            let allowed = "a name of its own for each column, up to 100 letters";
            return Err(wrong(Some(1), format!("the name `{}` is not allowed; {allowed}", quoted(name))));
        }
    }
    let mut order: Vec<(Vec<f64>, Vec<f64>)> = Vec::new();
    let mut found: BTreeMap<Vec<u64>, usize> = BTreeMap::new();
    for (line, row) in &rows {
        if let Some(value) = row.iter().find(|value| !value.is_finite()) {
            return Err(wrong(Some(*line), format!("{value} is not allowed; a finite number")));
        }
        let (state, z) = (&row[..dim], row[dim]);
        // Adding zero makes -0 and 0 one state.
        let key: Vec<u64> = state.iter().map(|x| (x + 0.0).to_bits()).collect();
        let place = *found.entry(key).or_insert_with(|| {
            order.push((state.to_vec(), Vec::new()));
            order.len() - 1
        });
        order[place].1.push(z);
    }
    let mut data = Dataset::new(dim);
    for (state, observations) in &order {
        data.push(state, observations)?;
    }
    Ok((names[..dim].to_vec(), data))
}

/// The line that a row of numbers stands on, and the row.
type Row = (usize, Vec<f64>);

/// The names in the first line, if there are any, and rows of as many numbers with their lines.
fn read_rows(path: &Path, names: bool) -> Result<(Vec<String>, Vec<Row>), StudyError> {
    let wrong = |line, what: String| StudyError::Data { path: path.to_owned(), line, what };
    let bytes = limited::read(path, "table_bytes", Limits::current().table_bytes)?;
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(names)
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(bytes.as_slice());
    let line_of = |position: Option<&csv::Position>| position.map(|p| p.line() as usize);
    let unreadable = |error: csv::Error| {
        let line = line_of(error.position());
        let what = match error.kind() {
            csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
                format!("{len} columns are not allowed; {expected_len} as in the line before")
            }
            _ => error.to_string(),
        };
        wrong(line, what)
    };
    let header = if names {
        reader.headers().map_err(unreadable)?.iter().map(str::to_owned).collect()
    } else {
        Vec::new()
    };
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(unreadable)?;
        let line = line_of(record.position());
        if rows.len() == MOST_ROWS {
            return Err(wrong(line, format!("more than {MOST_ROWS} rows are not allowed")));
        }
        if record.len() > MOST_COLUMNS {
            let found = record.len();
            return Err(wrong(line, format!("{found} columns are not allowed; at most {MOST_COLUMNS}")));
        }
        let row = record.iter().map(|cell| {
            // Infinity by its name, not by a number that is too large.
            let named = !cell.contains(|c: char| c.is_ascii_digit());
            let allowed = |value: &f64| value.abs() <= LARGEST || value.is_infinite() && named;
            cell.parse::<f64>().ok().filter(allowed).ok_or_else(|| {
                wrong(
                    line,
                    format!("`{}` is not allowed; a number from -{LARGEST} to {LARGEST}", quoted(cell)),
                )
            })
        });
        let row = row.collect::<Result<Vec<f64>, _>>()?;
        rows.push((line.unwrap_or(0), row));
    }
    Ok((header, rows))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use locsim_core::{Draw, Stage};
    use rand::RngExt;

    use super::*;

    fn table(text: &[u8]) -> Result<(Vec<String>, Dataset), StudyError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        fs::write(&path, text).unwrap();
        // The same bytes as scans of a lidar: whatever comes of it, no panic.
        let _ = read_static_lidar(&path, 2, 0.5);
        read_table(&path)
    }

    #[test]
    fn hostile_tables_are_refused_with_a_short_reason() {
        let long = "9".repeat(1_000_000);
        let columns: Vec<String> = (0..200).map(|i| format!("c{i}")).collect();
        for (text, said) in [
            (format!("x,z\n1,{long}\n"), "is not allowed; a number"),
            ("x,z\n1,1e300\n".to_owned(), "t.csv:2: `1e300` is not allowed; a number"),
            ("x,z\n1,\u{1b}[2J\u{202e}\n".to_owned(), "`\\u{1b}[2J\\u{202e}` is not allowed"),
            (format!("{long},z\n1,2\n"), "is not allowed; a name of its own"),
            ("x,x,z\n1,2,3\n".to_owned(), "the name `x` is not allowed; a name of its own"),
            ("\u{0},z\n1,2\n".to_owned(), "the name `\\u{0}` is not allowed"),
            (format!("{}\n", columns.join(",")), "199 state columns are not allowed"),
            ("z\n1\n".to_owned(), "one column is not allowed"),
            ("x,z\n1,inf\n".to_owned(), "inf is not allowed; a finite number"),
        ] {
            let error = table(text.as_bytes()).err().unwrap().to_string();
            assert!(error.contains(said) && error.len() < 400, "{error}");
        }
    }

    #[test]
    fn damaged_tables_are_survived() {
        let rows: Vec<String> = (0..40).map(|i| format!("{},{}\n", i / 4, 0.01 * f64::from(i))).collect();
        let good = format!("# readings\nx,z\n{}", rows.concat()).into_bytes();
        assert_eq!(table(&good).unwrap().1.len(), 10);
        let put = b"\"\",\n\r#-+.e0123456789\xff\0xinfnan ";
        for i in 0..2000 {
            let mut random = Draw::new(1, Stage::Trial, 0).item(i);
            let mut text = good.clone();
            for _ in 0..random.random_range(1..6) {
                let at = random.random_range(0..text.len());
                let end = (at + random.random_range(0..9)).min(text.len());
                let new: Vec<u8> =
                    (0..random.random_range(0..6)).map(|_| put[random.random_range(0..put.len())]).collect();
                text.splice(at..end, new);
            }
            if let Err(error) = table(&text) {
                assert!(error.to_string().len() < 400, "{error}");
            }
        }
    }
}
