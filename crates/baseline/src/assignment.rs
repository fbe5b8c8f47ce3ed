//! Stretches, and the log that each is of.

/// The stretches of the baseline and of today's log; a permutation assigns them anew.
#[derive(Clone)]
pub(super) struct Assignment {
    pub is_baseline: Vec<bool>,
    pub is_today: Vec<bool>,
}

impl Assignment {
    /// The gains on today's stretches.
    pub fn of_today(&self, gains: &[f64]) -> Vec<f64> {
        gains.iter().zip(&self.is_today).filter(|(_, is_today)| **is_today).map(|(gain, _)| *gain).collect()
    }

    pub fn used(&self) -> Vec<bool> {
        self.is_baseline.iter().zip(&self.is_today).map(|(baseline, today)| baseline | today).collect()
    }

    /// Mean gain of today's stretches less that of the baseline's, in its standard errors (Welch 1947). What all of today's stretches
    /// gain stands out in it even where permutations gain as well, because they mix stretches that gain with others. Gains that
    /// sum up to a nat or so are noise.
    pub fn contrast(&self, gains: &[f64]) -> f64 {
        let [today, baseline] = [&self.is_today, &self.is_baseline].map(|is_used| mean_of(gains, is_used));
        let stretches = self.is_today.iter().filter(|is| **is).count().max(1) as f64;
        (today[0] - baseline[0].max(0.0)) / (today[1] + baseline[1] + stretches.powi(-2)).sqrt()
    }

    /// The gain on today's stretches beyond that on as many stretches of the baseline: an effect that both logs have gains on
    /// both, as does one that makes up for what the baseline's histograms can't express.
    pub fn net(&self, today: &[f64], baseline: &[f64]) -> Vec<f64> {
        let of_baseline =
            || baseline.iter().zip(&self.is_baseline).filter(|(_, is)| **is).map(|(gain, _)| *gain);
        let stretches = of_baseline().count().max(1);
        let usual = (of_baseline().sum::<f64>() / stretches as f64).max(0.0);
        let gains = today.iter().zip(&self.is_today);
        gains.map(|(gain, is_today)| if *is_today { gain - usual } else { 0.0 }).collect()
    }
}

/// Mean over stretches and its variance.
fn mean_of(gains: &[f64], is_used: &[bool]) -> [f64; 2] {
    let own = || gains.iter().zip(is_used).filter(|(_, is)| **is).map(|(gain, _)| *gain);
    let n = f64::max(own().count() as f64, 2.0);
    let mean = own().sum::<f64>() / n;
    [mean, own().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))]
}
