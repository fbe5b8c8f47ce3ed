//! Square cells of the plane.

use glam::DVec2;

/// The cell of a grid from the origin, with sides of this length \[m\], that a point \[m\] is in.
pub fn cell_at(point: DVec2, side_m: f64) -> [i32; 2] {
    [(point.x / side_m).floor() as i32, (point.y / side_m).floor() as i32]
}

/// The cells that a line crosses from one point to another \[m\], in order. Where it cuts less than half a side off a corner, that cell may be left out.
pub fn cells_between(from: DVec2, to: DVec2, side_m: f64) -> impl Iterator<Item = [i32; 2]> {
    let steps = (2.0 * from.distance(to) / side_m).ceil().max(1.0) as usize;
    let mut last = None;
    (0..=steps).filter_map(move |i| {
        let cell = cell_at(from.lerp(to, i as f64 / steps as f64), side_m);
        let is_new = last != Some(cell);
        last = Some(cell);
        is_new.then_some(cell)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_crosses_cells_in_order() {
        let cells: Vec<[i32; 2]> = cells_between(DVec2::new(-0.1, 0.1), DVec2::new(0.6, 0.1), 0.25).collect();
        assert_eq!(cells, [[-1, 0], [0, 0], [1, 0], [2, 0]]);
        assert_eq!(cells_between(DVec2::ZERO, DVec2::ZERO, 0.25).collect::<Vec<_>>(), [[0, 0]]);
    }
}
