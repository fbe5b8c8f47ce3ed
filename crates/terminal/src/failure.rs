use crate::complain;

/// Exit code for work that is done.
pub const DONE: u8 = 0;
/// Exit code for bad input.
pub const BAD_INPUT: u8 = 2;
/// Exit code for work that the user stopped, as shells report it.
pub const INTERRUPTED: u8 = 130;

/// Why a command failed, with the exit code that says so.
#[derive(Debug)]
pub struct Failure {
    error: anyhow::Error,
    code: u8,
}

impl Failure {
    /// The failure of work that can be interrupted.
    pub fn of_work(error: impl Into<anyhow::Error>, is_interruption: bool) -> Self {
        Self { error: error.into(), code: if is_interruption { INTERRUPTED } else { BAD_INPUT } }
    }

    /// The error with its causes. A cause that the message quotes already is left out.
    pub fn explain(&self) -> String {
        let mut text = self.error.to_string();
        for cause in self.error.chain().skip(1).map(ToString::to_string) {
            if !text.contains(&cause) {
                text = format!("{text}: {cause}");
            }
        }
        text
    }
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { error: error.into(), code: BAD_INPUT }
    }
}

/// Prints the failure of a command, if it failed. Returns the exit code of the program.
pub fn exit_code(done: Result<u8, Failure>) -> u8 {
    done.unwrap_or_else(|failure| {
        complain(&format!("error: {}", failure.explain()));
        failure.code
    })
}
