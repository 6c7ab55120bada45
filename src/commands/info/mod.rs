//! `geofan info`: what a file contains.
//!
//! In: a manifold file or a bundle, told apart by the bundle's first bytes. Out: a description, or
//! the same as JSON.

mod bundle;
mod manifold;
mod place;

use crate::terminal::{CommonArgs, Outcome, values};
use geofan_bundle::container::MAGIC;
use geofan_core::{Error, Result};
use glam::DVec3;
use std::{fs::File, io::Read, path::PathBuf};

/// Options of `geofan info`.
#[derive(Debug, clap::Args)]
pub struct InfoArgs {
    /// A manifold file or a bundle
    file: PathBuf,
    /// Also show metric, standard frame, connection and curvature at this point of the chart
    #[arg(long, value_name = "A,B,C", allow_hyphen_values = true, value_parser = values::vector)]
    at: Option<DVec3>,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    set: Vec<(String, f64)>,
}

/// Describes the file.
pub fn run(args: &InfoArgs, common: &CommonArgs) -> Result<Outcome> {
    if is_bundle(args)? {
        bundle::run(args, common)
    } else {
        manifold::run(args, common)
    }
}

fn is_bundle(args: &InfoArgs) -> Result<bool> {
    let mut start = Vec::new();
    File::open(&args.file)
        .and_then(|file| file.take(MAGIC.len() as u64).read_to_end(&mut start))
        .map_err(|e| Error::io(&args.file, e))?;
    Ok(start == MAGIC)
}
