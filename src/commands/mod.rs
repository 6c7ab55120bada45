//! The commands of `geofan`, in files by what they are about: options in, text or JSON on stdout out. No mathematics.

mod accuracy;
mod animation;
mod bake;
mod demo;
mod geodesics;
mod info;
mod path_traced;
mod render;
mod scenery;
mod transport;
mod view;

use crate::terminal::{self, CommonArgs, Outcome};
use geofan_core::Result;

/// Names the commands.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Bake a manifold into a bundle
    Bake(bake::BakeCommand),
    /// Join the shards of one bake into a bundle
    Merge(bake::MergeArgs),
    /// Bake the wormhole, render it and compare
    Demo(demo::DemoArgs),
    /// Measure accuracy against table size
    Sweep(accuracy::SweepArgs),
    /// Follow one geodesic, exactly or through a bundle, and print samples of it
    Trace(geodesics::TraceArgs),
    /// Carry vectors along a curve in parallel, and tell how a closed one turns them
    Transport(transport::TransportArgs),
    /// Say where a point is in a picture: to first order, and by every geodesic to it
    Project(geodesics::ProjectArgs),
    /// Compare a bundle with exact paths of fresh random rays
    Check(accuracy::CheckArgs),
    /// Render a picture of a scene
    Render(render::RenderArgs),
    /// Hold a picture by table against the exact one
    Compare(accuracy::CompareArgs),
    /// Look around in a scene, in the browser, or write it as a page
    View(view::ViewArgs),
    /// Say what a file contains
    Info(info::InfoArgs),
    /// Print a completion script for a shell
    #[command(hide = true)]
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

impl Command {
    /// Runs the command.
    ///
    /// # Errors
    /// Any that the command meets.
    pub fn run(&self, common: &CommonArgs) -> Result<Outcome> {
        match self {
            Self::Bake(args) => args.run(common),
            Self::Merge(args) => bake::merge(args, common),
            Self::Demo(args) => demo::run(args, common),
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
    let mut program = crate::program::command_line();
    clap_complete::generate(shell, &mut program, "geofan", &mut script);
    terminal::print(&String::from_utf8_lossy(&script))?;
    Ok(Outcome::Done)
}
