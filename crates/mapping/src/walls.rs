//! Surfaces become walls: each part of a surface is held against the beams that reached it.

use glam::DVec2;

use crate::beams::Scan;
use crate::hits::Hit;
use crate::surface::{BIN_M, Surface};
use locsim_world::map::MeasuredWall;
use locsim_world::raycast::Boxes;

/// A beam that ends farther than this behind a surface \[m\] has passed it.
const PASSED_M: f64 = 0.1;

/// Where two surfaces of one direction are nearer to each other than [`PASSED_M`], the one in front would hide the other: where one has so many
/// times as many hits, the other is of the same wall, seen from poses that err.
const TWIN_SHARE: u32 = 3;

/// Cosine of the angle up to which they are of one direction: 15 degrees.
const SAME_NORMAL: f64 = 0.966;

/// Lines whose angle has a smaller sine than this, 20 degrees, aren't joined: they meet far away.
const PARALLEL: f64 = 0.34;

/// Bins that no beam reached are bridged up to this length \[m\].
const BRIDGED_M: f64 = 0.3;

/// Walls on which a smaller share of the beams ends are left out: they stood there for a while.
const SELDOM_SHARE: f64 = 0.2;

/// A wall has at least this many readings, of two scans or more: what one scan saw may have moved on.
const FEWEST_HITS: usize = 3;

/// The shortest wall \[m\].
const SHORTEST_M: f64 = 0.02;

/// Ends of walls this near to each other \[m\] are joined.
const JOINED_M: f64 = 0.15;

/// A part of a surface that beams ended on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Piece {
    /// The laser stood left of the line from the first to the second \[m\].
    pub ends: [DVec2; 2],
    pub normal: DVec2,
    pub sigma_m: f64,
    pub hits: u32,
    pub passes: u32,
}

impl Piece {
    /// The wall in the map frame, given the point that the piece is relative to \[m\].
    pub fn on_map(&self, centre: DVec2) -> MeasuredWall {
        let [from_m, to_m] = self.ends.map(|end| (end + centre).to_array());
        let hit_share = f64::from(self.hits) / f64::from(self.hits + self.passes);
        MeasuredWall { from_m, to_m, sigma_m: self.sigma_m, hits: self.hits, hit_share }
    }
}

/// The walls.
pub(crate) fn walls_of(scans: &[Scan], hits: &[Hit], surfaces: &[Surface]) -> Vec<Piece> {
    let boxes = Boxes::new(surfaces.iter().map(|surface| {
        let ends = [surface.point(surface.from), surface.point(surface.to)];
        [ends[0].min(ends[1]), ends[0].max(ends[1])]
    }));
    let mut counts: Vec<Vec<Count>> = surfaces.iter().map(|s| vec![Count::default(); s.bins()]).collect();
    for (surface, counts) in surfaces.iter().zip(&mut counts) {
        for &i in &surface.hits {
            counts[surface.bin(surface.along(hits[i as usize].at))].hits += 1;
        }
        // A surface goes on between two neighbouring readings of it.
        for pair in surface.hits.windows(2) {
            let (i, j) = (pair[0] as usize, pair[1] as usize);
            if j == i + 1 && hits[i].linked {
                let ends = [i, j].map(|i| surface.bin(surface.along(hits[i].at)));
                for count in &mut counts[ends[0].min(ends[1])..=ends[0].max(ends[1])] {
                    count.is_spanned = true;
                }
            }
        }
    }
    for scan in scans {
        for beam in &scan.beams {
            let length = scan.origin.distance(beam.end);
            if length < 1e-6 {
                continue;
            }
            let direction = (beam.end - scan.origin) / length;
            for number in boxes.met_by(scan.origin, direction, length) {
                let surface = &surfaces[number];
                let (before, after) = (surface.distance(scan.origin), surface.distance(beam.end));
                if before * after >= 0.0 || after.abs() < PASSED_M {
                    continue;
                }
                let at = scan.origin + (before / (before - after)) * (beam.end - scan.origin);
                let along = surface.along(at);
                if along < surface.from || along > surface.to {
                    continue;
                }
                counts[number][surface.bin(along)].passes += 1;
            }
        }
    }
    let are_twins: Vec<Vec<bool>> =
        (0..surfaces.len()).map(|number| twins(surfaces, &counts, &boxes, number)).collect();
    let mut walls = Vec::new();
    for ((surface, counts), are_twins) in surfaces.iter().zip(&mut counts).zip(&are_twins) {
        for (count, _) in counts.iter_mut().zip(are_twins).filter(|(_, is_twin)| **is_twin) {
            *count = Count::default();
        }
        pieces(hits, surface, counts, &mut walls);
    }
    join(&mut walls);
    walls
}

/// The bins of a surface that are of the same wall as another surface, which has far more hits there.
fn twins(surfaces: &[Surface], counts: &[Vec<Count>], boxes: &Boxes, number: usize) -> Vec<bool> {
    let surface = &surfaces[number];
    let is_twin = |bin: usize| {
        let own = hits_near(&counts[number], bin);
        let middle = surface.point(surface.from + BIN_M * (bin as f64 + 0.5));
        let across = boxes.met_by(middle + PASSED_M * surface.normal, -surface.normal, 2.0 * PASSED_M);
        across.into_iter().filter(|&other| other != number).any(|other| {
            let (theirs, counts) = (&surfaces[other], &counts[other]);
            let along = theirs.along(middle);
            theirs.normal.dot(surface.normal) > SAME_NORMAL
                && theirs.distance(middle).abs() < PASSED_M
                && (theirs.from..=theirs.to).contains(&along)
                && hits_near(counts, theirs.bin(along)) > TWIN_SHARE * own
        })
    };
    (0..surface.bins()).map(is_twin).collect()
}

/// Hits in a bin and its neighbours.
fn hits_near(counts: &[Count], bin: usize) -> u32 {
    counts[bin.saturating_sub(1)..(bin + 2).min(counts.len())].iter().map(|count| count.hits).sum()
}

/// The beams that reached a bin of a surface.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    hits: u32,
    passes: u32,
    /// Whether it lies between two neighbouring readings of the surface.
    is_spanned: bool,
}

impl Count {
    /// Most beams end here, or enough for something that is seen now and then.
    fn kind(near: &[Self], here: Self) -> Option<Kind> {
        let (hits, passes) = near.iter().fold((0, 0), |sum, near| (sum.0 + near.hits, sum.1 + near.passes));
        if here.hits > 0 && hits >= passes || here.is_spanned && passes == 0 {
            Some(Kind::Wall)
        } else if here.hits > 0 && f64::from(hits) >= SELDOM_SHARE * f64::from(hits + passes) {
            Some(Kind::Seldom)
        } else {
            None
        }
    }
}

/// Whether most beams that reach a place end there.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Wall,
    Seldom,
}

/// Cuts a surface into pieces of neighbouring bins of one kind.
fn pieces(hits: &[Hit], surface: &Surface, counts: &[Count], pieces: &mut Vec<Piece>) {
    let n = counts.len();
    let kinds: Vec<Option<Kind>> =
        (0..n).map(|i| Count::kind(&counts[i.saturating_sub(1)..(i + 2).min(n)], counts[i])).collect();
    let mut start = 0;
    while start < n {
        let Some(kind) = kinds[start] else {
            start += 1;
            continue;
        };
        let mut last = start;
        let bridged = (BRIDGED_M / BIN_M) as usize;
        for bin in start + 1..n {
            if kinds[bin] == Some(kind) {
                last = bin;
            } else if kinds[bin].is_some() || counts[bin].passes > 0 || bin - last > bridged {
                break;
            }
        }
        pieces.extend(piece(hits, surface, counts, start, last));
        start = last + 1;
    }
}

/// The bins from `first` to `last` as a piece, if enough readings say that it stayed where it is.
fn piece(hits: &[Hit], surface: &Surface, counts: &[Count], first: usize, last: usize) -> Option<Piece> {
    let along = |hit: &Hit| surface.along(hit.at);
    let own: Vec<&Hit> = surface
        .hits
        .iter()
        .map(|&i| &hits[i as usize])
        .filter(|hit| (first..=last).contains(&surface.bin(along(hit))))
        .collect();
    if own.len() < FEWEST_HITS || own.iter().all(|hit| hit.scan == own[0].scan) {
        return None;
    }
    // Bins between two readings have none of their own.
    let edge = |bin: usize| surface.from + BIN_M * bin as f64;
    let from = own.iter().map(|hit| along(hit)).fold(edge(first + 1), f64::min);
    let to = own.iter().map(|hit| along(hit)).fold(edge(last), f64::max);
    let (middle, half) = (0.5 * (from + to), (0.5 * (to - from)).max(SHORTEST_M / 2.0));
    Some(Piece {
        ends: [surface.point(middle + half), surface.point(middle - half)],
        normal: surface.normal,
        sigma_m: surface.sigma_m,
        hits: own.len() as u32,
        passes: counts[first..=last].iter().map(|count| count.passes).sum(),
    })
}

/// Moves ends that are near each other to where their lines meet, the nearest first.
fn join(pieces: &mut [Piece]) {
    let mut ends: Vec<(usize, usize)> = (0..pieces.len()).flat_map(|i| [(i, 0), (i, 1)]).collect();
    ends.sort_by(|a, b| pieces[a.0].ends[a.1].x.total_cmp(&pieces[b.0].ends[b.1].x));
    let mut corners = Vec::new();
    for (i, &a) in ends.iter().enumerate() {
        let (p, n) = (pieces[a.0].ends[a.1], pieces[a.0].normal);
        for &b in &ends[i + 1..] {
            let (q, m) = (pieces[b.0].ends[b.1], pieces[b.0].normal);
            if q.x - p.x > JOINED_M {
                break;
            }
            let sine = n.perp_dot(m);
            if a.0 == b.0 || sine.abs() < PARALLEL {
                continue;
            }
            let corner = DVec2::new(n.dot(p) * m.y - m.dot(q) * n.y, m.dot(q) * n.x - n.dot(p) * m.x) / sine;
            let reach = corner.distance(p).max(corner.distance(q));
            if reach <= JOINED_M {
                corners.push((reach, a, b, corner));
            }
        }
    }
    corners.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut is_joined = vec![[false; 2]; pieces.len()];
    for (_, a, b, corner) in corners {
        let is_free = |(piece, end): (usize, usize)| {
            !is_joined[piece][end] && corner.distance(pieces[piece].ends[1 - end]) >= SHORTEST_M
        };
        if is_free(a) && is_free(b) {
            for (piece, end) in [a, b] {
                is_joined[piece][end] = true;
                pieces[piece].ends[end] = corner;
            }
        }
    }
}
