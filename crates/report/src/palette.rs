//! One colour per sensor model, the same in figures, reports and recordings.

use crate::summary::ORACLE;

/// Okabe and Ito's palette, which colour-blind readers can tell apart, without its yellow (too pale on white) and
/// with lavender for black (recordings are seen on black).
const COLORS: [[u8; 3]; 7] = [
    [0xd5, 0x5e, 0x00],
    [0x00, 0x72, 0xb2],
    [0x00, 0x9e, 0x73],
    [0xcc, 0x79, 0xa7],
    [0x56, 0xb4, 0xe9],
    [0xe6, 0x9f, 0x00],
    [0x8c, 0x6b, 0xb1],
];

/// The oracle, which is a bound and no rival.
const ORACLE_COLOR: [u8; 3] = [0x99, 0x99, 0x33];
/// Odometry alone, no model's colour.
pub const DEAD_RECKONING: [u8; 3] = [0x77, 0x77, 0x77];

/// The colour of a model: fixed by its place among the models of the run, in figures, reports and recordings. The oracle has
/// one of its own.
pub fn of_model(models: &[String], name: &str) -> [u8; 3] {
    if name == ORACLE {
        return ORACLE_COLOR;
    }
    let mut others = models.iter().filter(|model| *model != ORACLE);
    rgb(others.position(|model| model == name).unwrap_or(models.len()))
}

/// The colour with this number (red, green, blue); repeats after seven.
pub fn rgb(index: usize) -> [u8; 3] {
    COLORS[index % COLORS.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oracle_takes_no_model_s_colour() {
        let models = ["classic", ORACLE, "np_reg"].map(str::to_owned);
        let [classic, oracle, np_reg] = models.each_ref().map(|name| of_model(&models, name));
        assert_eq!([classic, np_reg], [rgb(0), rgb(1)]);
        assert!(!COLORS.contains(&oracle) && !COLORS.contains(&DEAD_RECKONING) && oracle != DEAD_RECKONING);
    }
}
