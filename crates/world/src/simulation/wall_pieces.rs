use std::sync::Arc;

use glam::DVec2;

use super::SimulationError;
use super::error::check_count;
use crate::map::Geometry;

/// The longest piece of a wall \[m\]: door frames, radiators and posters are about as wide, and a piece of it has readings of several
/// scans.
const PIECE_M: f64 = 0.25;

/// The most pieces of a map: 250 km of wall.
const MOST_PIECES: f64 = 1e6;

/// Beams more grazing than this count as this (cosine of 81 deg): their range changes by at most this much more than the wall moves.
const GRAZING: f64 = 0.15;

/// The walls of a measured map, cut into pieces that may each stand a little off.
#[derive(Clone, Debug, PartialEq)]
pub struct WallPieces {
    /// The walls \[m\].
    walls: Vec<[DVec2; 2]>,
    /// The number of the first piece of each wall, and of one after the last.
    first: Vec<u32>,
    /// Standard deviation of the offset across of each piece, as the map has it \[m\].
    sigmas: Vec<f64>,
}

impl WallPieces {
    /// Those of a map; `None` of one whose walls are taken for exact.
    ///
    /// # Errors
    /// [`SimulationError::TooMany`] where the walls are too long.
    pub fn new(geometry: &Geometry) -> Result<Option<Self>, SimulationError> {
        if geometry.wall_sigmas().is_empty() {
            return Ok(None);
        }
        let pieces = |[a, b]: &[DVec2; 2]| (a.distance(*b) / PIECE_M).ceil().max(1.0);
        let all: f64 = geometry.walls().iter().map(pieces).sum();
        check_count("quarter metres of a measured map's walls", all, MOST_PIECES)?;
        let (mut first, mut sigmas) = (vec![0], Vec::new());
        for (wall, sigma) in geometry.walls().iter().zip(geometry.wall_sigmas()) {
            sigmas.extend(std::iter::repeat_n(*sigma, pieces(wall) as usize));
            first.push(sigmas.len() as u32);
        }
        Ok(Some(Self { walls: geometry.walls().to_vec(), first, sigmas }))
    }

    /// Standard deviation of the offset across of each piece, as the map has it \[m\].
    pub fn sigmas(&self) -> &[f64] {
        &self.sigmas
    }

    /// The piece of segment `segment` of the map that a point is nearest to; `None` where the segment isn't a wall.
    pub fn at(&self, segment: usize, point: DVec2) -> Option<usize> {
        let [a, b] = *self.walls.get(segment)?;
        let count = f64::from(self.first[segment + 1] - self.first[segment]);
        let share = (point - a).dot(b - a) / a.distance_squared(b);
        // Conversion takes what is below 0 to 0.
        let number = (share * count).min(count - 1.0) as usize;
        Some(self.first[segment] as usize + number)
    }

    /// The ends of a piece \[m\].
    pub fn ends(&self, piece: usize) -> [DVec2; 2] {
        let wall = self.first.partition_point(|&first| first as usize <= piece) - 1;
        let [a, b] = self.walls[wall];
        let [first, end] = [self.first[wall], self.first[wall + 1]].map(|first| first as usize);
        [piece - first, piece + 1 - first].map(|i| a.lerp(b, i as f64 / (end - first) as f64))
    }

    /// Change of a beam's range with the offset of the wall that it meets at this incidence \[m/m\].
    pub fn lean(incidence: f64) -> f64 {
        incidence.cos().max(GRAZING).recip()
    }
}

/// The walls of a measured map where they really stand.
#[derive(Clone, Debug)]
pub struct MovedWalls {
    /// The pieces.
    pub pieces: Arc<WallPieces>,
    /// How much farther from the laser each stands than the map has it, across the wall \[m\].
    pub offsets: Vec<f64>,
}

impl MovedWalls {
    /// The change of the range of a beam that meets segment `segment` at `point`, at this incidence \[m\].
    pub(super) fn change(&self, segment: usize, point: DVec2, incidence: f64) -> f64 {
        self.pieces.at(segment, point).map_or(0.0, |piece| self.offsets[piece] * WallPieces::lean(incidence))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::{MeasuredMap, MeasuredWall};

    /// Pieces are short and in their order along their walls, and a point of one is of it, whichever piece is nearest beyond the ends;
    /// the border of what was seen has none.
    #[test]
    fn a_wall_is_cut_into_pieces() {
        let wall =
            |to_m, sigma_m| MeasuredWall { from_m: [0.0, 0.0], to_m, sigma_m, hits: 9, hit_share: 1.0 };
        let walls = vec![wall([1.1, 0.0], 0.002), wall([0.0, 0.1], 0.005)];
        let seen = vec![vec![[-1.0, -1.0], [2.0, -1.0], [2.0, 2.0], [-1.0, 2.0]]];
        let geometry = MeasuredMap { seen, walls }.to_geometry().unwrap();
        let pieces = WallPieces::new(&geometry).unwrap().unwrap();
        assert_eq!(pieces.sigmas(), [0.002, 0.002, 0.002, 0.002, 0.002, 0.005]);
        for piece in 0..6 {
            let [a, b] = pieces.ends(piece);
            assert!(a.distance(b) <= PIECE_M);
            assert_eq!(pieces.at(usize::from(piece == 5), a.midpoint(b)), Some(piece));
        }
        assert_eq!(pieces.at(0, DVec2::new(-0.3, 0.1)), Some(0));
        assert_eq!(pieces.at(0, DVec2::new(1.3, 0.1)), Some(4));
        assert_eq!(pieces.at(2, DVec2::ZERO), None);
        let seen = vec![vec![[-1.0, -1.0], [1e6, -1.0], [1e6, 2.0], [-1.0, 2.0]]];
        let endless = MeasuredMap { seen, walls: vec![wall([9e5, 1.0], 0.01)] }.to_geometry().unwrap();
        assert!(WallPieces::new(&endless).unwrap_err().to_string().contains("quarter metres"));
    }
}
