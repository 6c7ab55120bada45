//! The command lines of the programs `geofan` and `geofan-bake`, and their commands, in files by what they are about:
//! options in, text or JSON on stdout out. No mathematics.

mod accuracy;
mod animation;
mod bake;
mod geodesics;
mod info;
mod path_traced;
mod render;
mod scenery;
mod transport;
mod view;

use crate::{
    terminal::{self, CommonArgs, Outcome},
    user_cache::with_kept_results,
};
use clap::CommandFactory;
use geofan_core::Result;
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

/// Names the commands.
#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Bake a manifold into a bundle
    Bake(bake::BakeCommand),
    /// Join the shards of one bake into a bundle
    Merge(bake::MergeArgs),
    /// Bake the wormhole, render it and compare
    Demo(accuracy::DemoArgs),
    /// Measure accuracy against table size (in programs built with --features sweep)
    Sweep(accuracy::SweepArgs),
    /// Follow one geodesic, exactly or through a bundle, and print samples of it
    Trace(geodesics::TraceArgs),
    /// Carry vectors along a curve in parallel, and tell how a closed one turns them
    Transport(transport::TransportArgs),
    /// Say where a point is in a picture: to first order, and by the geodesics to it
    ///
    /// Images by light that circles a black hole or a throat more than about once are too narrow for the search, and not
    /// listed; nor, in charts with angles, are those by light that passes an axis within some thousandths of a radian, as to a
    /// point right behind it. In a glued space `u` and `v` of an image (`--json`) are those of the copy of the point in the covering chart.
    Project(geodesics::ProjectArgs),
    /// Compare a bundle with exact paths of fresh random rays
    Check(accuracy::CheckArgs),
    /// Render a picture of a scene
    Render(render::RenderArgs),
    /// Compare a picture by table with the exact one
    Compare(accuracy::CompareArgs),
    /// Look around in a scene, in the browser until Ctrl-C, or write it as a page
    View(view::ViewArgs),
    /// Say what a file contains
    Info(info::InfoArgs),
    /// Print a completion script for a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

impl Command {
    /// Runs the command.
    fn run(&self, common: &CommonArgs) -> Result<Outcome> {
        match self {
            Self::Bake(args) => args.run(common),
            Self::Merge(args) => bake::merge(args, common),
            Self::Demo(args) => accuracy::demo(args, common),
            Self::Sweep(args) => accuracy::sweep(args, common),
            Self::Trace(args) => geodesics::trace(args, common),
            Self::Transport(args) => transport::run(args, common),
            Self::Project(args) => geodesics::project(args, common),
            Self::Check(args) => accuracy::check(args, common),
            Self::Render(args) => render::run(args, common),
            Self::Compare(args) => accuracy::compare(args, common),
            Self::View(args) => view::run(args, common),
            Self::Info(args) => info::run(args, common),
            Self::Completions { shell } => completions(*shell),
        }
    }
}

/// Prints the completion script for `shell`.
fn completions(shell: clap_complete::Shell) -> Result<Outcome> {
    let mut script = Vec::new();
    let mut program = Geofan::command();
    clap_complete::generate(shell, &mut program, "geofan", &mut script);
    terminal::print(&String::from_utf8_lossy(&script))?;
    Ok(Outcome::Done)
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
