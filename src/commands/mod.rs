//! The commands of `geofan`, one file each: options in, text or JSON on stdout out. No mathematics.

mod animation;
mod check;
mod compare;
mod completions;
mod info;
mod light;
mod path_traced;
mod render;
mod scenery;
mod trace;

use geofan::{
    Result,
    terminal::{CommonArgs, Outcome},
};

/// What to do.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Follow one geodesic, exactly or through a bundle, and print samples of it
    Trace(trace::TraceArgs),
    /// Compare a bundle with exact paths of fresh random rays
    Check(check::CheckArgs),
    /// Render a picture of a scene
    Render(render::RenderArgs),
    /// Hold a picture by table against the exact one
    Compare(compare::CompareArgs),
    /// Say what a file contains
    Info(info::InfoArgs),
    /// Print a completion script for a shell
    #[command(hide = true)]
    Completions(completions::CompletionsArgs),
}

impl Command {
    /// Does it.
    pub fn run(&self, common: &CommonArgs) -> Result<Outcome> {
        match self {
            Self::Trace(args) => trace::run(args, common),
            Self::Check(args) => check::run(args, common),
            Self::Render(args) => render::run(args, common),
            Self::Compare(args) => compare::run(args, common),
            Self::Info(args) => info::run(args, common),
            Self::Completions(args) => completions::run(args),
        }
    }
}
