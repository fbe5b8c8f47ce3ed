//! Distances of samples of one distribution from each other: what a distance has to exceed to say something.

/// Mean and standard deviation of distances between samples of one distribution.
#[derive(Clone, Copy, Debug)]
pub struct Floor {
    /// Their mean.
    pub mean: f64,
    /// Their standard deviation.
    pub deviation: f64,
}

/// A distance has come down to the floor's border where it came at least this share of the way.
const HALF: f64 = 0.5;

impl Floor {
    /// That of two distances or more.
    #[must_use]
    pub fn of(distances: &[f64]) -> Self {
        let n = distances.len() as f64;
        let mean = distances.iter().sum::<f64>() / n;
        let squares: f64 = distances.iter().map(|distance| (distance - mean).powi(2)).sum();
        Self { mean, deviation: (squares / (n - 1.0)).sqrt() }
    }

    /// A distance beyond this isn't one of the floor: three standard deviations, as mean and deviation are of few distances.
    #[must_use]
    pub fn visible(&self) -> f64 {
        self.mean + 3.0 * self.deviation
    }

    /// Standard error of the difference of two distances, each from so many samples together.
    #[must_use]
    pub fn error(&self, samples: usize) -> f64 {
        self.deviation * (2.0 / samples as f64).sqrt()
    }

    /// Whether a distance is larger than another by more than samples of one distribution differ.
    #[must_use]
    pub fn is_farther(&self, before: f64, after: f64) -> bool {
        after - before > self.visible() - self.mean
    }

    /// Whether a distance is more than twice another, and larger by more than samples of one distribution differ on average. Where they
    /// differ by as much as their mean, as with bursts, three standard deviations are more than any distance.
    #[must_use]
    pub fn doubles(&self, before: f64, after: f64) -> bool {
        after > 2.0 * before && after - before > self.mean
    }

    /// The share of what is above the floor that is gone; `None` where both are at the floor, to within what it may be by chance.
    #[must_use]
    pub fn closed(&self, before: f64, after: f64) -> Option<f64> {
        let is_visible = |distance: f64| distance > self.visible();
        let share = (before - after) / (before - self.mean);
        match (is_visible(before), is_visible(after)) {
            (false, false) => None,
            // It was as near as can be, and isn't any more.
            (false, true) => Some(0.0),
            // All of the way, but not by a step across the border.
            (true, false) if share >= HALF => Some(1.0),
            (true, _) => Some(share),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distance_comes_down_to_its_floor() {
        let floor = Floor::of(&[9.0, 10.0, 11.0]);
        assert_eq!((floor.mean, floor.deviation, floor.visible()), (10.0, 1.0, 13.0));
        assert_eq!(floor.closed(30.0, 15.0), Some(0.75));
        assert_eq!(floor.closed(30.0, 12.0), Some(1.0), "at its floor");
        assert_eq!((floor.closed(12.0, 9.0), floor.closed(12.0, 20.0)), (None, Some(0.0)));
        assert!(floor.is_farther(10.0, 13.5) && !floor.is_farther(10.0, 12.5));
        let bursts = Floor { mean: 286.0, deviation: 240.0 };
        assert!(bursts.doubles(243.0, 735.0) && !bursts.is_farther(243.0, 735.0));
        assert!(!bursts.doubles(243.0, 480.0) && !bursts.doubles(100.0, 380.0));
    }
}
