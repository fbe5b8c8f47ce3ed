//! Logs with other stamps.

/// A CARMEN log whose scans and poses all have one stamp, as logs have whose stamps were written with six digits.
pub fn with_one_stamp(log: &[u8]) -> String {
    let line = |line: &str| {
        let mut words: Vec<&str> = line.split(' ').collect();
        if let ["ROBOTLASER1" | "ODOM" | "TRUEPOS", .., stamp, _, logged] = &mut words[..] {
            (*stamp, *logged) = ("1.01893e+09", "1.01893e+09");
        }
        words.join(" ")
    };
    std::str::from_utf8(log).unwrap().lines().map(line).collect::<Vec<_>>().join("\n") + "\n"
}
