//! The correlation of standardized errors with something that they may depend on.

/// The least variance of standardized errors.
const LEAST_VARIANCE: f64 = 0.1;

/// Correlation of standardized errors with something else, about zero, times the root of how many there are.
#[derive(Clone, Copy, Debug, Default)]
pub struct Correlation {
    product: f64,
    errors: f64,
    others: f64,
    count: f64,
}

impl Correlation {
    /// Adds an error, in its standard deviations, with what it may depend on.
    pub fn add(&mut self, error: f64, other: f64) {
        self.product += error * other;
        self.errors += error * error;
        self.others += other * other;
        self.count += 1.0;
    }

    /// About a standard normal number where there is none.
    pub fn value(&self) -> f64 {
        // Errors far below their least standard deviation are digits of the file.
        let errors = self.errors.max(LEAST_VARIANCE * self.count);
        self.product / (errors * self.others).sqrt().max(1e-300) * self.count.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Digits of a file that grow with the motion say nothing; errors of half a standard deviation that do are all that there is.
    #[test]
    fn digits_of_a_file_are_no_errors() {
        let of = |scale: f64| {
            let mut correlation = Correlation::default();
            for i in 0..100 {
                let motion = 700.0 + f64::from(i % 7);
                correlation.add(scale * motion / 700.0, motion);
            }
            correlation.value()
        };
        assert!(of(1e-11).abs() < 1e-9, "{}", of(1e-11));
        assert!((of(0.5) - 10.0).abs() < 1e-9, "{}", of(0.5));
    }
}
