//! The command lines of the programs `geofan` and `geofan-bake`. No mathematics: each command is a file
//! in `commands/`.

use crate::{
    commands::{BakeCommand, Command},
    terminal::{self, CommonArgs},
};
use std::process::ExitCode;

/// Geodesic lookup tables for curved 3-dimensional spaces: bake, inspect, render
#[derive(Debug, clap::Parser)]
#[command(name = "geofan", version, arg_required_else_help = true)]
pub(crate) struct Geofan {
    #[command(flatten)]
    common: CommonArgs,
    #[command(subcommand)]
    command: Command,
}

/// Bakes geodesic bundles: another name for `geofan bake`
#[derive(Debug, clap::Parser)]
#[command(
    name = "geofan-bake",
    version,
    arg_required_else_help = true,
    subcommand_negates_reqs = true
)]
struct GeofanBake {
    #[command(flatten)]
    common: CommonArgs,
    #[command(flatten)]
    command: BakeCommand,
}

/// Runs the program `geofan`.
pub fn geofan() -> ExitCode {
    let cli: Geofan = terminal::parse();
    terminal::run(&cli.common, || cli.command.run(&cli.common))
}

/// Runs the program `geofan-bake`.
pub fn geofan_bake() -> ExitCode {
    let cli: GeofanBake = terminal::parse();
    terminal::run(&cli.common, || cli.command.run(&cli.common))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{CommandFactory, Parser};

    #[test]
    fn the_command_lines_are_consistent() {
        Geofan::command().debug_assert();
        GeofanBake::command().debug_assert();
    }

    #[test]
    fn bakes_have_two_names() {
        let read = |line: &str| {
            let words = line.split(' ');
            match line.starts_with("geofan-bake") {
                true => GeofanBake::try_parse_from(words).is_ok(),
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
