/// Point `i` of the sequence of Halton (1960), which fills the unit cube evenly: the digits of `i` in four bases, mirrored at
/// the point.
pub fn low_discrepancy(i: u32) -> [f64; 4] {
    [2, 3, 5, 7].map(|base| {
        let (mut rest, mut place, mut sum) = (i + 1, 1.0, 0.0);
        while rest > 0 {
            place /= f64::from(base);
            sum += place * f64::from(rest % base);
            rest /= base;
        }
        sum
    })
}
