/// Receives the progress of long work; `()` ignores it.
pub trait Progress: Sync {
    /// A stage of `total` units of work begins.
    fn stage(&self, _name: &str, _total: u64) {}
    /// `n` units of the stage are done.
    fn advance(&self, _n: u64) {}
    /// All stages are done.
    fn finish(&self) {}
    /// Something that the user may want to know and that changes no result.
    fn note(&self, _text: &str) {}
    /// Something that the user should know, asked for or not.
    fn warn(&self, _text: &str) {}
}

impl Progress for () {}
