//! The largest of many statistics as one test, in groups.

use crate::tail::Tail;

/// The largest statistics of a sample and of replicates of it, by groups that share a false-alarm rate (max-T; Westfall and Young
/// 1993).
///
/// What a value says is minus the logarithm of the chance that the largest of its group is as large, over the group's share: its weight.
/// Each group has its share however many statistics it has, and one whose largest is now and then far off doesn't raise what the
/// others have to exceed.
#[derive(Clone, Debug)]
pub struct MaxT<const GROUPS: usize> {
    tails: [Tail; GROUPS],
    shares: [f64; GROUPS],
    /// The weights of the largest of each group: of each replicate, the sample last.
    weights: Vec<[f64; GROUPS]>,
}

impl<const GROUPS: usize> MaxT<GROUPS> {
    /// Of the largest of each group of each replicate, with those of the sample last, and the shares of the groups, whose sum is 1.
    pub fn new(largest: &[[f64; GROUPS]], shares: [f64; GROUPS]) -> Self {
        let tails: [Tail; GROUPS] = std::array::from_fn(|g| Tail::of(largest.iter().map(|of| of[g])));
        let weight =
            |of: &[f64; GROUPS]| std::array::from_fn(|g| tails[g].minus_log_p(of[g]) + shares[g].ln());
        let weights = largest.iter().map(weight).collect();
        Self { tails, shares, weights }
    }

    /// What a value in a group says \[nats\].
    pub fn weight(&self, group: usize, value: f64) -> f64 {
        self.tails[group].minus_log_p(value) + self.shares[group].ln()
    }

    /// The largest weight of each, the sample last, among the groups that `is_of` holds for.
    fn largest(&self, is_of: impl Fn(usize) -> bool) -> Vec<f64> {
        let of = |weights: &[f64; GROUPS]| {
            let among = weights.iter().enumerate().filter(|(group, _)| is_of(*group));
            among.fold(f64::NEG_INFINITY, |most, (_, weight)| most.max(*weight))
        };
        self.weights.iter().map(of).collect()
    }

    /// The rank of the sample by its largest weight among the groups that `is_of` holds for: the share that says as much, itself
    /// included.
    pub fn p(&self, is_of: impl Fn(usize) -> bool) -> f64 {
        let largest = self.largest(is_of);
        let own = largest[largest.len() - 1];
        largest.iter().filter(|other| **other >= own).count() as f64 / largest.len() as f64
    }

    /// The largest weight of each replicate, in order.
    pub fn of_replicates(&self) -> Vec<f64> {
        let mut largest = self.largest(|_| true);
        largest.pop();
        largest.sort_by(f64::total_cmp);
        largest
    }

    /// The value in each group that says as much as a weight.
    pub fn values_at(&self, weight: f64) -> [f64; GROUPS] {
        std::array::from_fn(|g| self.tails[g].at(weight - self.shares[g].ln()))
    }
}

#[cfg(test)]
mod tests {
    use rand::RngExt;
    use rand_philox::Philox;

    use super::*;

    /// Two groups of equal shares, one of them with outliers in one replicate of ten. A sample that is far off in the other one is beyond all
    /// replicates; one that is as far off where outliers are isn't.
    #[test]
    fn outliers_of_one_group_are_not_what_another_has_to_exceed() {
        let mut rng = Philox::from_u64_seed(5);
        let mut number = || -(1.0 - rng.random::<f64>()).ln();
        let replicates: Vec<[f64; 2]> =
            (0..99).map(|i| [number(), number() + if i % 10 == 0 { 30.0 } else { 0.0 }]).collect();
        let p = |sample: [f64; 2]| {
            let all = [&replicates[..], &[sample]].concat();
            MaxT::new(&all, [0.5, 0.5]).p(|_| true)
        };
        assert!((p([15.0, 0.5]) - 0.01).abs() < 1e-9 && p([0.5, 15.0]) > 0.1);
    }

    /// A share of the false-alarm rate is a weight, and a weight a value.
    #[test]
    fn weights_are_logarithms_of_chances_and_shares() {
        let all: Vec<[f64; 1]> = (0..1000).map(|i| [-((f64::from(i) + 0.5) / 1000.0).ln()]).collect();
        let test = MaxT::new(&all, [0.2]);
        assert!((test.weight(0, 5.0) - (5.0 + 0.2_f64.ln())).abs() < 0.3);
        assert!((test.values_at(test.weight(0, 5.0))[0] - 5.0).abs() < 1e-9);
        assert_eq!(test.of_replicates().len(), 999);
    }
}
