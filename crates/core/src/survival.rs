/// The first bin in which clutter is expected, and the probability that none stands before the beginning of this bin and of
/// each after it, up to the end of the last bin in which some is expected; `counts[i]` is expected in bin `i`.
pub fn survival_of(counts: &[f64]) -> (usize, impl Iterator<Item = f32>) {
    let first = counts.iter().position(|&count| count > 0.0).unwrap_or(counts.len());
    let end = counts.iter().rposition(|&count| count > 0.0).map_or(first, |last| last + 1);
    let mut expected = 0.0;
    let entries = counts[first..end].iter().map(move |count| {
        expected += count;
        f64::exp(-expected) as f32
    });
    (first, std::iter::once(1.0).chain(entries))
}
