//! Paths of keys in a file, such as `filter.motion.alpha[0]`.

/// The path of a key inside the map at `path`.
pub fn join(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}
