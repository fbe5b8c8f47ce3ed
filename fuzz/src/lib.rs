//! Damaged and hostile inputs for every reader of locsim.
//!
//! One function for each kind of input takes any bytes and must come back: an input is accepted or refused, and never
//! brings the program down. [`TARGETS`] lists them, `fuzz_targets/` gives them to `cargo fuzz`, [`mutate`] makes inputs
//! for the driver in `main.rs`, which needs neither that tool nor a nightly compiler.

pub mod mutate;
mod targets;

pub use targets::{
    beesoft_map, carmen, csv, db3, map_image, mcap, model, range_table, resume, seeds, study, tum,
    vector_map, workload, yaml,
};

/// What a reader says of an input: nothing if it accepts it, or why not.
pub type Outcome = Result<(), String>;

/// How mutations see a target's inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// YAML, and JSON, which is YAML too.
    Yaml,
    /// Lines of words and numbers.
    Text,
    /// Numbers and lengths in bytes.
    Binary,
}

/// A kind of input.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Its name, which its folders under `corpus/` and `regressions/` have too.
    pub name: &'static str,
    /// Reads an input.
    pub run: fn(&[u8]) -> Outcome,
    /// How its inputs are mutated.
    pub form: Form,
    /// Words of its format.
    pub words: &'static [&'static str],
}

/// Every kind of input.
pub const TARGETS: [Target; 14] = [
    Target { name: "yaml", run: yaml, form: Form::Yaml, words: mutate::SCENARIO_WORDS },
    Target { name: "study", run: study, form: Form::Yaml, words: mutate::STUDY_WORDS },
    Target { name: "vector_map", run: vector_map, form: Form::Yaml, words: mutate::MAP_WORDS },
    Target { name: "map_image", run: map_image, form: Form::Binary, words: mutate::IMAGE_WORDS },
    Target { name: "carmen", run: carmen, form: Form::Text, words: mutate::CARMEN_WORDS },
    Target { name: "beesoft_map", run: beesoft_map, form: Form::Text, words: mutate::BEESOFT_WORDS },
    Target { name: "mcap", run: mcap, form: Form::Binary, words: mutate::BAG_WORDS },
    Target { name: "db3", run: db3, form: Form::Binary, words: mutate::BAG_WORDS },
    Target { name: "tum", run: tum, form: Form::Text, words: mutate::TABLE_WORDS },
    Target { name: "model", run: model, form: Form::Binary, words: mutate::MODEL_WORDS },
    Target { name: "resume", run: resume, form: Form::Binary, words: mutate::MODEL_WORDS },
    Target { name: "workload", run: workload, form: Form::Text, words: mutate::WORKLOAD_WORDS },
    Target { name: "csv", run: csv, form: Form::Text, words: mutate::TABLE_WORDS },
    Target { name: "range_table", run: range_table, form: Form::Binary, words: &[] },
];

/// The target of a name.
pub fn target(name: &str) -> Option<Target> {
    TARGETS.into_iter().find(|target| target.name == name)
}
