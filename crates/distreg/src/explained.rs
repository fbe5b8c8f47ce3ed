//! How much of the variation of numbers a grouping of them explains.

/// Number, sum and sum of squares.
type Sums = [f64; 3];

fn add([count, sum, squares]: Sums, value: f64) -> Sums {
    [count + 1.0, sum + value, squares + value * value]
}

/// Sum of the squares about the mean.
fn variation([count, sum, squares]: Sums) -> f64 {
    squares - sum * sum / f64::max(count, 1.0)
}

fn sums(values: &[f64]) -> Sums {
    values.iter().copied().fold([0.0; 3], add)
}

/// Whether numbers differ by rounding only.
#[must_use]
pub fn are_all_alike(values: &[f64]) -> bool {
    let all = sums(values);
    variation(all) <= 1e-9 * all[2]
}

/// Share of the variance of numbers that the means of their groups explain; `groups` has the group of each, from 0 on. NaN of
/// numbers that are all the same.
#[must_use]
pub fn explained_share(values: &[f64], groups: &[u16]) -> f64 {
    let count = groups.iter().max().map_or(0, |most| usize::from(*most) + 1);
    let mut of_groups = vec![[0.0; 3]; count];
    for (&value, &group) in values.iter().zip(groups) {
        of_groups[usize::from(group)] = add(of_groups[usize::from(group)], value);
    }
    1.0 - of_groups.into_iter().map(variation).sum::<f64>() / variation(sums(values))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Means of 1.5 and 3.5: of a variation of 5 about 2.5 they leave half a unit in each group.
    #[test]
    fn means_of_groups_explain_what_they_do() {
        let values = [1.0, 2.0, 3.0, 4.0];
        assert!((explained_share(&values, &[0, 0, 1, 1]) - 0.8).abs() < 1e-12);
        assert!(explained_share(&values, &[0, 0, 0, 0]).abs() < 1e-12);
        assert!(!are_all_alike(&values) && are_all_alike(&[0.3; 5]) && are_all_alike(&[]));
    }
}
