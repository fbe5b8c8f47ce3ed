//! The `locsim` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    let mut arguments: Vec<_> = std::env::args_os().collect();
    if let (Some(first), Ok(program)) = (arguments.first_mut(), std::env::current_exe()) {
        *first = program.into();
    }
    locsim::run(&arguments).into()
}
