//! `geofan-bake demo`: bakes the wormhole, renders it and compares.

use geofan::{
    Error, Result,
    terminal::{CommonArgs, Outcome},
};
use std::path::PathBuf;

/// Options of `geofan-bake demo`.
#[derive(Debug, clap::Args)]
pub struct DemoArgs {
    /// The folder for the results
    #[arg(long, value_name = "DIR", default_value = "demo")]
    pub out: PathBuf,
}

/// Runs the demonstration.
pub fn run(_: &DemoArgs, _: &CommonArgs) -> Result<Outcome> {
    Err(Error::input("demo", "not built yet"))
}
