//! `geofan info`: what a file contains.
//!
//! In: a manifold file or a bundle, told apart by the bundle's first bytes. Out: a description as text or
//! JSON.

mod manifold;

use crate::terminal::{self, CommonArgs, Outcome, values};
use geofan_bundle::{
    Contents, Table, TangentPromise, Tree,
    container::{MAGIC, VERSION},
    measure::tangents_at_exits,
};
use geofan_core::{Error, Result};
use glam::DVec3;
use serde_json::{Map, Value, json};
use std::{
    fmt::Write,
    fs::File,
    io::Read,
    path::{Path, PathBuf},
};

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
    match is_bundle(&args.file)? {
        true => describe_bundle(args, common)?,
        false => manifold::describe(args, common)?,
    }
    Ok(Outcome::Done)
}

/// Tells by its first bytes whether a file is a bundle.
fn is_bundle(file: &Path) -> Result<bool> {
    let mut start = Vec::new();
    File::open(file)
        .and_then(|file| file.take(MAGIC.len() as u64).read_to_end(&mut start))
        .map_err(|e| Error::io(file, e))?;
    Ok(start == MAGIC)
}

/// Lines of a name and a value.
#[derive(Default)]
struct DescriptionText(String);

impl DescriptionText {
    /// Adds a line.
    fn line(&mut self, name: &str, value: impl std::fmt::Display) {
        let _ = writeln!(self.0, "{name:<16} {value}");
    }
}

/// Describes a bundle, or a shard of one.
fn describe_bundle(args: &InfoArgs, common: &CommonArgs) -> Result<()> {
    if args.at.is_some() || !args.set.is_empty() {
        let option = if args.at.is_some() { "--at" } else { "--set" };
        return Err(Error::input(option, "is for manifold files only"));
    }
    let size = std::fs::metadata(&args.file);
    let bytes = size.map_err(|e| Error::io(&args.file, e))?.len();
    let contents = Contents::read(&args.file)?;
    let counts = count_patches(&args.file, &contents)?;
    match common.json {
        true => terminal::print_json(&bundle_json(&contents, counts, bytes)),
        false => terminal::print(&bundle_text(&contents, counts, bytes)),
    }
}

/// Counts patches and flagged boxes of all chunks.
fn count_patches(file: &Path, contents: &Contents) -> Result<(usize, usize)> {
    let mut sum = (0, 0);
    let budget = contents.budget();
    for (chunk, bytes) in &contents.chunks {
        let shape = Table::tensor_shape(&contents.space, contents.header.plan.stretch);
        let tree = Tree::outline(bytes, shape, &budget).map_err(|damage| {
            let message = format!("is not a valid bundle: chunk {chunk}: {damage}");
            Error::input(file.display().to_string(), message)
        })?;
        let (patches, flagged) = tree.count();
        sum = (sum.0 + patches, sum.1 + flagged);
    }
    Ok(sum)
}

/// Writes a bundle's id in hexadecimal digits.
fn id(contents: &Contents) -> String {
    contents.id.iter().map(|b| format!("{b:02x}")).collect()
}

/// Names the places at which directions are promised; `None` if they are not.
fn sky_place(contents: &Contents) -> Option<&'static str> {
    let promised = contents.header.plan.tangents != TangentPromise::None;
    promised.then(|| match tangents_at_exits(&contents.space) {
        true => "exits",
        false => "paths",
    })
}

/// Describes a bundle as JSON.
fn bundle_json(contents: &Contents, (patches, flagged): (usize, usize), bytes: u64) -> Value {
    let header = &contents.header;
    let plan = &header.plan;
    let parameters = header.manifold.parameters.iter();
    let parameters: Map<_, _> = parameters.map(|(k, v)| (k.clone(), json!(v))).collect();
    json!({
        "kind": if header.shard.is_some() { "shard" } else { "bundle" },
        "shard": header.shard.map(|s| json!({ "index": s.index, "of": s.of })),
        "format": VERSION,
        "generator": header.generator,
        "id": id(contents),
        "name": header.manifold.name,
        "manifold": header.manifold.source,
        "parameters": parameters,
        "cameras": contents.space.describe(),
        "reduction": header.reduction.name(),
        "stored_cameras": header.cameras,
        "mirrors": plan.mirrors.len(),
        "length": plan.length,
        "frames": plan.tangents != TangentPromise::None,
        "promise": plan.max_error,
        "sky_promise": plan.tangents.mrad(plan.max_error),
        "sky_promise_at": sky_place(contents),
        "tolerance": plan.tolerance,
        "chunks": contents.chunks.len(),
        "patches": patches,
        "flagged_boxes": flagged,
        "bytes": bytes,
        "certificate": header.certificate,
    })
}

/// Describes a bundle in words.
fn bundle_text(contents: &Contents, (patches, flagged): (usize, usize), bytes: u64) -> String {
    let header = &contents.header;
    let (plan, manifold) = (&header.plan, &header.manifold);
    let mut text = DescriptionText::default();
    // Its manifold.
    if let Some(shard) = header.shard {
        text.line("shard", format!("{} of {}", shard.index, shard.of));
    }
    text.line("name", format!("{} ({})", manifold.name, manifold.source));
    for (name, value) in &manifold.parameters {
        text.line("parameter", format!("{name} = {value}"));
    }
    // What is stored of it.
    text.line("cameras", contents.space.describe());
    text.line("symmetry used", header.reduction.name());
    text.line("mirrors used", plan.mirrors.len());
    text.line("length", plan.length);
    text.line("chunks", contents.chunks.len());
    text.line("patches", patches);
    text.line("flagged boxes", flagged);
    text.line("bytes", bytes);
    text.line(
        "id",
        format!("{}, geofan {}", id(contents), header.generator),
    );
    // How well.
    text.line("promise", plan.promises(&contents.space));
    let Some(certificate) = &header.certificate else {
        text.line("certificate", "none");
        return text.0;
    };
    text.line("rays baked", certificate.exact_rays_baked);
    text.0 += &format!("certificate (seed {})\n", certificate.seed);
    text.0 += &certificate.lines();
    text.0
}
