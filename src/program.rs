//! The command lines of the programs `geofan` and `geofan-bake`. No mathematics: each command is a file
//! in `commands/`.

use crate::{
    commands::Command,
    terminal::{self, CommonArgs},
    user_cache::with_kept_results,
};
use clap::CommandFactory;
use std::{ffi::OsString, process::ExitCode};

/// Geodesic lookup tables for curved 3-dimensional spaces: bake, inspect, render
#[derive(Debug, clap::Parser)]
#[command(
    name = "geofan",
    version,
    propagate_version = true,
    arg_required_else_help = true
)]
struct Geofan {
    #[command(flatten)]
    common: CommonArgs,
    #[command(subcommand)]
    command: Command,
}

/// Returns the definition of the command line of `geofan`.
pub(crate) fn command_line() -> clap::Command {
    Geofan::command()
}

/// Runs the program `geofan`.
pub fn geofan() -> ExitCode {
    run(std::env::args_os())
}

/// Runs the program `geofan-bake`: another name for `geofan bake`.
pub fn geofan_bake() -> ExitCode {
    run(as_geofan(std::env::args_os()))
}

/// Runs a command line.
fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let parsed: Geofan = terminal::parse(arguments);
    terminal::run(&parsed.common, || {
        with_kept_results(|| parsed.command.run(&parsed.common))
    })
}

/// Turns the arguments of `geofan-bake` into those of `geofan bake`.
fn as_geofan(arguments: impl IntoIterator<Item = OsString>) -> impl Iterator<Item = OsString> {
    let own = arguments.into_iter().skip(1);
    ["geofan", "bake"]
        .map(OsString::from)
        .into_iter()
        .chain(own)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[test]
    fn the_command_line_is_consistent() {
        Geofan::command().debug_assert();
    }

    #[test]
    fn bakes_have_two_names() {
        let read = |line: &str| {
            let words = line.split(' ').map(OsString::from);
            match line.starts_with("geofan-bake") {
                true => Geofan::try_parse_from(as_geofan(words)).is_ok(),
                false => Geofan::try_parse_from(words).is_ok(),
            }
        };
        for program in ["geofan-bake", "geofan bake"] {
            assert!(read(&format!("{program} m.toml -o b.fan")));
            assert!(read(&format!("{program} merge a -o b.fan")));
            assert!(read(&format!("{program} demo")));
            assert!(read(&format!("{program} --threads 2 demo")));
            assert!(!read(&format!("{program} m.toml")));
            assert!(!read(&format!("{program} -o b.fan")));
        }
        assert!(read("geofan merge a -o b.fan"));
        assert!(read("geofan demo --size 160x90"));
    }
}
