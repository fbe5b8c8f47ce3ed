//! Scans from the point clouds of a 2D lidar.
//!
//! A cloud has points where a scan has beams: points without a return are missing from it. The beams are those that
//! the clouds of a whole log have points on.

use std::f64::consts::TAU;

use super::messages::{Header, LaserScan, PointCloud2, PointField};

/// A point lies this much above or below the plane of its lidar, at the most (m), and per metre of range.
const OFF_PLANE_M: f64 = 0.02;
const OFF_PLANE_PER_M: f64 = 0.05;

/// Points nearer to each other than this are returns of one beam (rad); beams of lidars are 1e-3 rad apart or more.
const SAME_BEAM_RAD: f64 = 1e-4;

/// A point of a lidar's plane.
struct Point {
    /// (rad).
    bearing: f64,
    /// (m).
    range: f32,
}

/// The points of a cloud.
struct Cloud {
    header: Header,
    /// When it was recorded (ns).
    logged: i64,
    points: Vec<Point>,
}

/// The clouds of a log.
#[derive(Default)]
pub struct Clouds {
    clouds: Vec<Cloud>,
}

impl Clouds {
    /// Takes in a cloud that was recorded at this time (ns); returns how many points it has.
    ///
    /// # Errors
    /// The cloud's description is wrong, or its points aren't in a plane.
    pub fn push(&mut self, cloud: PointCloud2, logged: i64) -> Result<usize, String> {
        let points = points(&cloud)?;
        let count = points.len();
        self.clouds.push(Cloud { header: cloud.header, logged, points });
        Ok(count)
    }

    /// The scans that the clouds stand for, in their order, with their times of recording (ns). A beam without a point is NaN: whether it had no return isn't
    /// known. The maximum range is just above the longest reading.
    ///
    /// # Errors
    /// There are too few points to tell the beams.
    pub fn into_scans(self) -> Result<impl Iterator<Item = (LaserScan, i64)>, String> {
        let Some(beams) = Beams::of(&self.clouds) else {
            return Err(
                "the clouds have too few points to tell the beams; allowed: two beams or more".to_owned()
            );
        };
        let ranges = self.clouds.iter().flat_map(|cloud| &cloud.points).map(|point| point.range);
        let longest = ranges.fold(0.0, f32::max);
        Ok(self.clouds.into_iter().map(move |Cloud { header, logged, points }| {
            let mut ranges = vec![f32::NAN; beams.count];
            for Point { bearing, range } in points {
                let reading = &mut ranges[beams.nearest(bearing)];
                // The nearest of several returns; the least number where one isn't known.
                *reading = reading.min(range);
            }
            let scan = LaserScan {
                header,
                angle_min: beams.first as f32,
                angle_max: (beams.first + (beams.count - 1) as f64 * beams.step) as f32,
                angle_increment: beams.step as f32,
                time_increment: 0.0,
                scan_time: 0.0,
                range_min: 0.0,
                range_max: longest.next_up(),
                ranges,
                intensities: Vec::new(),
            };
            (scan, logged)
        }))
    }
}

/// Evenly spaced beams (rad).
struct Beams {
    first: f64,
    step: f64,
    count: usize,
}

impl Beams {
    /// The beams that clouds have points on: as far apart as most points of the fullest cloud.
    fn of(clouds: &[Cloud]) -> Option<Self> {
        let sorted = |points: &[Point]| {
            let mut bearings: Vec<f64> = points.iter().map(|point| point.bearing).collect();
            bearings.sort_by(f64::total_cmp);
            bearings
        };
        let fullest = clouds.iter().max_by_key(|cloud| cloud.points.len())?;
        let bearings = sorted(&fullest.points);
        let mut steps: Vec<f64> = bearings.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.retain(|step| *step > SAME_BEAM_RAD);
        steps.sort_by(f64::total_cmp);
        let step = *steps.get(steps.len() / 2)?;
        let all = clouds.iter().flat_map(|cloud| &cloud.points).map(|point| point.bearing);
        let (first, last) = all.fold((f64::MAX, f64::MIN), |(lo, hi), b| (b.min(lo), b.max(hi)));
        let span = last - first;
        // Where not even one beam is missing, the beams go around.
        Some(if span + 1.5 * step > TAU {
            let count = (TAU / step).round().max(1.0);
            Self { first, step: TAU / count, count: count as usize }
        } else {
            let gaps = (span / step).round().max(1.0);
            Self { first, step: span / gaps, count: gaps as usize + 1 }
        })
    }

    fn nearest(&self, bearing: f64) -> usize {
        ((bearing - self.first) / self.step).round() as usize % self.count
    }
}

/// The points of a cloud that are finite and not at the lidar itself.
fn points(cloud: &PointCloud2) -> Result<Vec<Point>, String> {
    let offset = |name: &str| {
        let field = cloud.fields.iter().find(|field| field.name == name);
        let field = field.filter(|field| field.datatype == PointField::FLOAT32);
        let field = field.filter(|field| u64::from(field.offset) + 4 <= u64::from(cloud.point_step));
        let field =
            field.ok_or_else(|| format!("the cloud has no field `{name}` of FLOAT32 in its points"))?;
        Ok::<_, String>(field.offset as usize)
    };
    let [x, y, z] = [offset("x")?, offset("y")?, offset("z")?];
    let points = u64::from(cloud.width) * u64::from(cloud.height);
    if points.checked_mul(u64::from(cloud.point_step)) != Some(cloud.data.len() as u64) {
        let (found, step) = (cloud.data.len(), cloud.point_step);
        return Err(format!("the cloud has {found} bytes; allowed: {step} for each of {points} points"));
    }
    let mut planar = Vec::new();
    for point in cloud.data.chunks_exact(cloud.point_step as usize) {
        let number = |offset: usize| {
            let bytes = [point[offset], point[offset + 1], point[offset + 2], point[offset + 3]];
            f64::from(if cloud.is_bigendian { f32::from_be_bytes(bytes) } else { f32::from_le_bytes(bytes) })
        };
        let (x, y, z) = (number(x), number(y), number(z));
        let range = x.hypot(y);
        if !(range > 0.0 && range.is_finite() && z.is_finite()) {
            continue;
        }
        let off_plane = OFF_PLANE_M + OFF_PLANE_PER_M * range;
        if z.abs() > off_plane {
            return Err(format!(
                "a point lies {z} m off the plane of the lidar; allowed: at most {off_plane:.3} m, as of a 2D lidar"
            ));
        }
        planar.push(Point { bearing: y.atan2(x), range: range as f32 });
    }
    Ok(planar)
}
