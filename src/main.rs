//! The command line of `geofan`. No mathematics: each command is a file in `commands/`.

mod commands;

use clap::Parser;
use geofan::terminal::{self, CommonArgs};
use std::process::ExitCode;

/// Geodesic lookup tables for curved 3-dimensional spaces: trace, inspect, render
#[derive(Debug, Parser)]
#[command(name = "geofan", version, arg_required_else_help = true)]
struct Cli {
    #[command(flatten)]
    common: CommonArgs,
    #[command(subcommand)]
    command: commands::Command,
}

fn main() -> ExitCode {
    let cli: Cli = terminal::parse();
    terminal::run(&cli.common, || cli.command.run(&cli.common))
}
