//! `geofan completions`: a completion script on stdout.

use crate::terminal::{self, Outcome};
use clap::CommandFactory;
use clap_complete::{Shell, generate};
use geofan_core::Result;

/// Options of `geofan completions`.
#[derive(Debug, clap::Args)]
pub struct CompletionsArgs {
    /// The shell
    shell: Shell,
}

/// Prints the script.
pub fn run(args: &CompletionsArgs) -> Result<Outcome> {
    let mut script = Vec::new();
    generate(
        args.shell,
        &mut crate::program::Geofan::command(),
        "geofan",
        &mut script,
    );
    terminal::print(&String::from_utf8_lossy(&script))?;
    Ok(Outcome::Done)
}
