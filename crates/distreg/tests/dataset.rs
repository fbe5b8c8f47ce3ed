//! Data, splits over states and searches.

use distreg::{Dataset, Error, grid_search, optimize, product};

fn data(states: usize) -> Dataset {
    let mut data = Dataset::new(1);
    for i in 0..states {
        data.push(&[i as f64], &vec![i as f64 + 0.5; i % 3 + 1]).unwrap();
    }
    data
}

fn states(data: &Dataset) -> Vec<usize> {
    (0..data.len()).map(|i| data.state(i)[0] as usize).collect()
}

#[test]
fn observations_are_ragged_and_stay_with_their_state() {
    let data = data(7);
    assert_eq!((data.len(), data.dim(), data.is_empty()), (7, 1, false));
    assert_eq!(data.observations(5), [5.5; 3]);
    let subset = data.subset(&[5, 0]);
    assert_eq!(states(&subset), [5, 0]);
    assert_eq!((subset.observations(0), subset.observations(1)), (&[5.5; 3][..], &[0.5][..]));
    let mut file = Vec::new();
    ciborium::into_writer(&data, &mut file).unwrap();
    assert_eq!(ciborium::from_reader::<Dataset, _>(&file[..]).unwrap(), data);
}

#[test]
fn a_refused_state_leaves_the_data_unchanged() {
    let mut data = data(2);
    let before = data.clone();
    assert_eq!(data.push(&[1.0, 2.0], &[1.0]), Err(Error::Dimension { expected: 1, found: 2 }));
    assert!(matches!(data.push(&[f64::NAN], &[1.0]), Err(Error::NotFinite { .. })));
    assert!(matches!(data.push(&[1.0], &[1.0, f64::INFINITY]), Err(Error::NotFinite { .. })));
    assert!(matches!(data.push(&[1.0], &[]), Err(Error::Empty { .. })));
    assert_eq!(data, before);
}

#[test]
fn a_split_divides_the_states_and_repeats() {
    let data = data(100);
    let (train, held_out) = data.split(0.3, 1);
    assert_eq!((train.len(), held_out.len()), (70, 30));
    let mut all = [states(&train), states(&held_out)].concat();
    all.sort_unstable();
    assert_eq!(all, (0..100).collect::<Vec<_>>());
    assert_eq!(data.split(0.3, 1), (train, held_out.clone()));
    assert_ne!(data.split(0.3, 2).1, held_out);
    assert_eq!(data.split(7.0, 1).1.len(), 100);
    assert!(data.split(-1.0, 1).1.is_empty());
}

#[test]
fn every_state_is_held_out_once() {
    let data = data(11);
    let folds = data.folds(4, 3).unwrap();
    let mut held: Vec<usize> = folds.iter().flat_map(|(_, held_out)| states(held_out)).collect();
    held.sort_unstable();
    assert_eq!(held, (0..11).collect::<Vec<_>>());
    for (train, held_out) in &folds {
        assert_eq!(train.len() + held_out.len(), 11);
        assert!(states(held_out).iter().all(|s| !states(train).contains(s)));
    }
    for folds in [0, 1, 12] {
        assert!(matches!(data.folds(folds, 3), Err(Error::Folds { .. })));
    }
}

#[test]
fn a_search_finds_the_smallest_finite_score() {
    let candidates = product(&[&[1.0, 2.0], &[10.0, 20.0, 30.0]]);
    assert_eq!(candidates[1], [1.0, 20.0]);
    assert_eq!(candidates[3], [2.0, 10.0]);
    let found = grid_search(&candidates, |c| {
        Ok::<_, Error>(if c[0] == 1.0 { f64::NAN } else { (c[1] - 21.0).abs() })
    })
    .unwrap();
    assert_eq!((found.candidate, found.score), (vec![2.0, 20.0], 1.0));
    assert_eq!(found.scores[0], f64::INFINITY);
    // The first of equals.
    assert_eq!(grid_search(&[3, 4], |_| Ok::<_, Error>(0.0)).unwrap().candidate, 3);
    let none = grid_search(&[1, 2], |_| Ok::<_, Error>(f64::NAN));
    assert_eq!(none, Err(Error::NoFiniteScore { candidates: 2 }));
    let failed = grid_search(&[1], |_| Err::<f64, _>(Error::GridMismatch));
    assert_eq!(failed, Err(Error::GridMismatch));
}

/// A bowl over the logarithms, steeper along one axis, from a start five times off.
#[test]
fn the_simplex_search_finds_the_bottom_of_a_bowl() {
    let bowl = |h: &[f64]| {
        let [a, b] = [(h[0] / 0.02).ln(), (h[1] / 7.0).ln()];
        Ok(1.0 + a * a + 3.0 * b * b + a * b)
    };
    let found = optimize(&[0.1, 1.4], 1.5, 60, bowl).unwrap();
    assert!((found.candidate[0] / 0.02).ln().abs() < 0.1, "{found:?}");
    assert!((found.candidate[1] / 7.0).ln().abs() < 0.1, "{found:?}");
    assert_eq!(found.score, found.scores.iter().copied().fold(f64::INFINITY, f64::min));
    assert!(found.scores.len() < 120);
    // The start is the first candidate, and what isn't finite is never chosen.
    let wall = |h: &[f64]| Ok(if h[0] > 0.2 { f64::NAN } else { -h[0] });
    let found = optimize(&[0.1], 1.5, 30, wall).unwrap();
    assert!(found.candidate[0] > 0.1 && found.candidate[0] <= 0.2);
    assert_eq!(found.scores[0], -(0.1f64.ln().exp()));
}

#[test]
fn a_search_passes_errors_on() {
    let failed = optimize(&[1.0], 2.0, 10, |h| if h[0] > 1.5 { Err(Error::GridMismatch) } else { Ok(h[0]) });
    assert_eq!(failed, Err(Error::GridMismatch));
    let none = optimize(&[1.0], 2.0, 10, |_| Ok(f64::NAN));
    assert!(matches!(none, Err(Error::NoFiniteScore { .. })));
    for (start, spread) in [(&[][..], 2.0), (&[0.0], 2.0), (&[1.0], -2.0), (&[f64::NAN], 2.0)] {
        assert!(optimize(start, spread, 10, |_| Ok(1.0)).is_err());
    }
}
