//! Density, cdf, quantile, samples and mean of one distribution agree; density estimates agree with their
//! equations.

use distreg::{Distribution, Error, Grid, Kernel, Outcomes, PointMass, histogram, kernel_density};
use proptest::prelude::*;
use rand_philox::{Philox, u32_to_unit_f64};

fn any_distribution() -> impl Strategy<Value = Distribution> {
    let mass = prop::collection::vec(prop_oneof![Just(0.0), 0.0..1.0f64], 1..40);
    let point = prop::option::of((-3.0..9.0f64, 0.0..2.0f64));
    (mass, point, -1.0..1.0f64, 0.05..0.3f64)
        .prop_filter("all empty", |(mass, point, _, _)| {
            mass.iter().sum::<f64>() + point.map_or(0.0, |p| p.1) > 1e-3
        })
        .prop_map(|(mass, point, lo, width)| {
            let grid = Grid { lo, width, bins: mass.len() };
            Distribution::new(grid, mass, point.map(|(at, mass)| PointMass { at, mass })).unwrap()
        })
}

proptest! {
    #[test]
    fn masses_sum_to_one_and_the_cdf_rises_from_0_to_1(d in any_distribution()) {
        let total = d.mass().iter().sum::<f64>() + d.point().map_or(0.0, |p| p.mass);
        prop_assert!((total - 1.0).abs() < 1e-12);
        prop_assert_eq!(d.cdf(-10.0), 0.0);
        prop_assert!((d.cdf(20.0) - 1.0).abs() < 1e-12);
        let values: Vec<f64> = (0..500).map(|k| d.cdf(-4.0 + f64::from(k) * 0.03)).collect();
        prop_assert!(values.is_sorted());
    }

    /// quantile(u) is the smallest z with cdf(z) >= u.
    #[test]
    fn quantile_inverts_the_cdf(d in any_distribution(), u in 0.0..=1.0f64) {
        let z = d.quantile(u);
        prop_assert!(z.is_finite());
        prop_assert!(d.cdf(z + 1e-9) >= u - 1e-9);
        prop_assert!(d.cdf(z - 1e-9) <= u + 1e-9);
        prop_assert_eq!(d.sample(u), z);
    }

    /// The density between two points integrates to the difference of the cdf (200 midpoints per bin edge pair
    /// would be exact but for the edges; the tolerance is two steps of the largest density).
    #[test]
    fn density_integrates_to_the_cdf(d in any_distribution(), a in -1.0..3.0f64, length in 0.0..4.0f64) {
        let steps = 4000;
        let dz = length / f64::from(steps);
        let point = d.point().filter(|p| p.at > a && p.at <= a + length).map_or(0.0, |p| p.mass);
        let integral: f64 = (0..steps)
            .map(|k| a + (f64::from(k) + 0.5) * dz)
            .filter(|&z| d.point().is_none_or(|p| p.at != z))
            .map(|z| d.density(z) * dz)
            .sum();
        let largest = d.mass().iter().copied().fold(0.0, f64::max) / d.grid().width;
        prop_assert!((integral + point - (d.cdf(a + length) - d.cdf(a))).abs() < 45.0 * dz * largest + 1e-9);
    }

    #[test]
    fn serialized_distributions_come_back_equal(d in any_distribution()) {
        let mut file = Vec::new();
        ciborium::into_writer(&d, &mut file).unwrap();
        let back: Distribution = ciborium::from_reader(&file[..]).unwrap();
        // Reading normalizes again, which may change the last bits.
        prop_assert_eq!(d.grid(), back.grid());
        for (a, b) in d.mass().iter().zip(back.mass()) {
            prop_assert!((a - b).abs() < 1e-14);
        }
    }

    #[test]
    fn histograms_and_kernel_densities_sum_to_one(
        z in prop::collection::vec(-1.0..6.0f64, 1..50),
        bandwidth in 0.01..20.0f64,
    ) {
        let outcomes = Outcomes::of_values(0.0, 5.0, 0.1).unwrap().with_point_mass(5.0);
        let plain = histogram(&z, &outcomes).unwrap();
        prop_assert!((plain.mass().iter().sum::<f64>() - 1.0).abs() < 1e-12);
        for kernel in [Kernel::Gaussian, Kernel::Boxcar, Kernel::Epanechnikov] {
            let smooth = kernel_density(&z, &outcomes, kernel, bandwidth).unwrap();
            prop_assert!((smooth.mass().iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }
}

/// One-sample Kolmogorov-Smirnov of 10,000 draws: the statistic exceeds sqrt(ln(2 / 1e-6) / (2 n)) with a
/// probability of at most 1e-6 (Dvoretzky, Kiefer, Wolfowitz, Massart), also where the cdf jumps.
#[test]
fn samples_follow_the_cdf() {
    let grid = Grid { lo: 0.0, width: 0.25, bins: 8 };
    let mass = vec![1.0, 0.0, 2.0, 0.5, 0.0, 0.0, 3.0, 1.0];
    let d = Distribution::new(grid, mass.clone(), Some(PointMass { at: 1.3, mass: 2.0 })).unwrap();
    let n = 10_000;
    let mut random = Philox::from_u64_seed(3);
    let mut draws: Vec<f64> = (0..n).map(|_| d.sample(u32_to_unit_f64(random.next_u32()))).collect();
    draws.sort_by(f64::total_cmp);
    let statistic = |d: &Distribution| {
        (0..=80)
            .map(|k| f64::from(k) * 0.025)
            .map(|z| (draws.partition_point(|&x| x <= z) as f64 / f64::from(n) - d.cdf(z)).abs())
            .fold(0.0, f64::max)
    };
    let limit = ((2.0f64 / 1e-6).ln() / (2.0 * f64::from(n))).sqrt();
    assert!(statistic(&d) < limit);
    let mean = draws.iter().sum::<f64>() / f64::from(n);
    // Standard deviation below 0.6: 4.9 standard errors are 0.03.
    assert!((mean - d.mean()).abs() < 0.03);
    // Negative control: a point mass a tenth larger.
    let other = Distribution::new(grid, mass, Some(PointMass { at: 1.3, mass: 3.0 })).unwrap();
    assert!(statistic(&other) > limit);
}

/// Eq. 5 evaluated directly at the bin centres, for observations at bin centres away from the ends.
#[test]
fn kernel_density_is_equation_5() {
    let outcomes = Outcomes::of_values(0.0, 10.0, 0.05).unwrap();
    let grid = outcomes.grid;
    let (z, h) = ([4.0, 4.2, 5.5, 5.55], 0.2);
    let d = kernel_density(&z, &outcomes, Kernel::Gaussian, h).unwrap();
    for b in 0..grid.bins {
        let direct = z.iter().map(|z| (-0.5 * ((grid.centre(b) - z) / h).powi(2)).exp()).sum::<f64>()
            / (4.0 * h * (2.0 * std::f64::consts::PI).sqrt());
        assert!((d.density(grid.centre(b)) - direct).abs() < 1e-12);
    }
}

#[test]
fn a_narrow_kernel_is_the_histogram() {
    let outcomes = Outcomes::of_values(0.0, 1.0, 0.1).unwrap();
    let z = [0.0, 0.1, 0.1, 1.0];
    for kernel in [Kernel::Gaussian, Kernel::Boxcar, Kernel::Epanechnikov] {
        let narrow = kernel_density(&z, &outcomes, kernel, 0.01).unwrap();
        assert_eq!(narrow, histogram(&z, &outcomes).unwrap());
    }
}

#[test]
fn values_of_a_discrete_sensor_have_a_bin_each() {
    let grid = Grid::of_values(0.0, 4.5, 0.001).unwrap();
    assert_eq!(grid.bins, 4501);
    for k in 0..4501 {
        assert_eq!(grid.bin(f64::from(k) * 0.001), k as usize);
    }
    assert_eq!(grid.bin(-3.0), 0);
    assert_eq!(grid.bin(99.0), 4500);
}

#[test]
fn impossible_input_is_an_error() {
    let grid = Grid { lo: 0.0, width: 1.0, bins: 2 };
    let new = |mass: &[f64]| Distribution::new(grid, mass.to_vec(), None);
    assert!(matches!(new(&[1.0]), Err(Error::Length { .. })));
    for mass in [[0.0, 0.0], [-1.0, 2.0], [f64::NAN, 1.0], [f64::INFINITY, 1.0], [f64::MAX, f64::MAX]] {
        assert_eq!(new(&mass), Err(Error::NoDistribution));
    }
    assert!(Distribution::new(Grid { width: 0.0, ..grid }, vec![1.0; 2], None).is_err());
    assert!(Distribution::new(Grid { lo: f64::NAN, ..grid }, vec![1.0; 2], None).is_err());
    assert!(Distribution::new(Grid { bins: 0, ..grid }, vec![], None).is_err());
    assert!(Grid::of_values(1.0, 0.0, 0.1).is_err());
    assert!(Grid::of_values(0.0, f64::INFINITY, 0.1).is_err());
    let outcomes = Outcomes { grid, point_mass_at: None };
    assert!(histogram(&[], &outcomes).is_err());
    assert!(histogram(&[f64::NAN], &outcomes).is_err());
    assert!(histogram(&[1.0], &outcomes.with_point_mass(f64::INFINITY)).is_err());
    assert!(kernel_density(&[1.0], &outcomes, Kernel::Gaussian, 0.0).is_err());
    let damaged = r#"{"grid":{"lo":0.0,"width":1.0,"bins":2},"mass":[1.0],"point":null}"#;
    assert!(serde_json::from_str::<Distribution>(damaged).is_err());
}
