//! One colour per sensor model, the same in figures, reports and recordings.

/// Okabe and Ito's palette, which colour-blind readers can tell apart, without its yellow (too pale on white) and
/// with grey for black (recordings are seen on black).
const COLORS: [[u8; 3]; 7] = [
    [0xd5, 0x5e, 0x00],
    [0x00, 0x72, 0xb2],
    [0x00, 0x9e, 0x73],
    [0xcc, 0x79, 0xa7],
    [0x56, 0xb4, 0xe9],
    [0xe6, 0x9f, 0x00],
    [0x77, 0x77, 0x77],
];

/// Colour of the model at `index` in a scenario's order (red, green, blue); repeats after seven.
pub fn rgb(index: usize) -> [u8; 3] {
    COLORS[index % COLORS.len()]
}
