use crate::Pose2;

/// A set of poses as a structure of arrays, all of one length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Particles {
    /// x of each pose in its parent frame \[m\].
    pub x: Vec<f64>,
    /// y of each pose \[m\].
    pub y: Vec<f64>,
    /// Heading of each pose \[rad\], in (-pi, pi].
    pub theta: Vec<f64>,
}

impl Particles {
    /// `n` poses at the origin.
    pub fn zeros(n: usize) -> Self {
        Self { x: vec![0.0; n], y: vec![0.0; n], theta: vec![0.0; n] }
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// No poses at all.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Pose `i`. Panics beyond the end, as slices do.
    pub fn get(&self, i: usize) -> Pose2 {
        Pose2 { x: self.x[i], y: self.y[i], theta: self.theta[i] }
    }

    /// Overwrites pose `i`.
    pub fn set(&mut self, i: usize, pose: Pose2) {
        self.x[i] = pose.x;
        self.y[i] = pose.y;
        self.theta[i] = pose.theta;
    }

    /// Appends a pose.
    pub fn push(&mut self, pose: Pose2) {
        self.x.push(pose.x);
        self.y.push(pose.y);
        self.theta.push(pose.theta);
    }

    /// Makes room for `n` poses in all.
    pub fn reserve(&mut self, n: usize) {
        for values in [&mut self.x, &mut self.y, &mut self.theta] {
            values.reserve_exact(n.saturating_sub(values.len()));
        }
    }

    /// Makes the length `n`; new poses are at the origin.
    pub fn resize(&mut self, n: usize) {
        self.x.resize(n, 0.0);
        self.y.resize(n, 0.0);
        self.theta.resize(n, 0.0);
    }

    /// Every pose, in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Pose2> + '_ {
        (0..self.len()).map(|i| self.get(i))
    }

    /// Becomes `source[ancestors[i]]` for each `i`; keeps its buffers.
    pub fn gather(&mut self, source: &Self, ancestors: &[u32]) {
        // Ancestors per batch: a batch is still in the first-level cache when y and theta follow x.
        const RUN: usize = 1024;
        self.resize(ancestors.len());
        let Self { x, y, theta } = self;
        let runs = x.chunks_mut(RUN).zip(y.chunks_mut(RUN)).zip(theta.chunks_mut(RUN));
        for (ancestors, ((x, y), theta)) in ancestors.chunks(RUN).zip(runs) {
            for (out, from) in [(x, &source.x), (y, &source.y), (theta, &source.theta)] {
                for (out, ancestor) in out.iter_mut().zip(ancestors) {
                    *out = from[*ancestor as usize];
                }
            }
        }
    }

    /// All poses, borrowed.
    pub fn as_poses(&self) -> Poses<'_> {
        Poses { x: &self.x, y: &self.y, theta: &self.theta }
    }
}

impl FromIterator<Pose2> for Particles {
    fn from_iter<I: IntoIterator<Item = Pose2>>(poses: I) -> Self {
        let mut particles = Self::default();
        poses.into_iter().for_each(|pose| particles.push(pose));
        particles
    }
}

/// A borrowed run of poses, structure of arrays.
#[derive(Clone, Copy, Debug)]
pub struct Poses<'a> {
    /// x \[m\].
    pub x: &'a [f64],
    /// y \[m\].
    pub y: &'a [f64],
    /// Heading \[rad\].
    pub theta: &'a [f64],
}

impl<'a> Poses<'a> {
    /// Number of poses.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// No poses at all.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Pose `i`. Panics beyond the end, as slices do.
    pub fn get(&self, i: usize) -> Pose2 {
        Pose2 { x: self.x[i], y: self.y[i], theta: self.theta[i] }
    }

    /// Poses `start..end`.
    #[must_use]
    pub fn slice(&self, start: usize, end: usize) -> Poses<'a> {
        Poses { x: &self.x[start..end], y: &self.y[start..end], theta: &self.theta[start..end] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gathering_copies_whole_poses_whatever_the_lengths() {
        let source: Particles =
            (0..3000).map(|i| Pose2::new(f64::from(i), -f64::from(i), 0.001 * f64::from(i))).collect();
        let mut gathered = Particles::zeros(5);
        for ancestors in [vec![7_u32; 2500], (0..3000).rev().collect(), vec![], vec![2999, 0, 1]] {
            gathered.gather(&source, &ancestors);
            assert_eq!(gathered.len(), ancestors.len());
            assert!(gathered.iter().zip(&ancestors).all(|(pose, a)| pose == source.get(*a as usize)));
        }
    }
}
