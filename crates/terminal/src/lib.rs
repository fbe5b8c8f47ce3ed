//! Parts that the programs `locsim` and `locsim-bench` share: common options, progress bars, Ctrl-C, printed lines,
//! exit codes. A program parses its arguments, calls its libraries and ends with [`exit_code`].

mod failure;
mod interrupt;
mod options;
mod output;
mod progress;
mod session;

pub use failure::{BAD_INPUT, DONE, Failure, INTERRUPTED, exit_code};
pub use options::{LimitOptions, OutputOptions, Share, Threads, number, whole};
pub use output::{columns, complain, say};
pub use session::Session;
