//! A face of a wall.

use glam::DVec2;

/// The wall is cut into bins of this length along the line \[m\].
pub(crate) const BIN_M: f64 = 0.05;

/// A face of a wall: hits along a line.
#[derive(Clone, Debug)]
pub(crate) struct Surface {
    /// Unit normal, towards the laser.
    pub normal: DVec2,
    /// `normal . q` of the points q on the line \[m\].
    pub offset: f64,
    /// Standard deviation of the offset \[m\].
    pub sigma_m: f64,
    /// Where it starts and ends along [`Surface::tangent`] \[m\].
    pub from: f64,
    pub to: f64,
    /// Its hits.
    pub hits: Vec<u32>,
}

impl Surface {
    pub fn tangent(&self) -> DVec2 {
        self.normal.perp()
    }

    pub fn along(&self, point: DVec2) -> f64 {
        self.tangent().dot(point)
    }

    /// Signed distance from the line, positive on the laser's side \[m\].
    pub fn distance(&self, point: DVec2) -> f64 {
        self.normal.dot(point) - self.offset
    }

    pub fn point(&self, along: f64) -> DVec2 {
        self.offset * self.normal + along * self.tangent()
    }

    /// Number of bins.
    pub fn bins(&self) -> usize {
        (((self.to - self.from) / BIN_M).ceil() as usize).max(1)
    }

    /// The bin of a coordinate along the line.
    pub fn bin(&self, along: f64) -> usize {
        (((along - self.from) / BIN_M).max(0.0) as usize).min(self.bins() - 1)
    }
}
