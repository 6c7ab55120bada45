//! `geofan info` on a bundle or a shard of one.

use super::InfoArgs;
use geofan::{
    Error, Result,
    bundle::{Contents, Header, Table, Tree, container::VERSION},
    fan::Reduction,
    terminal::{self, CommonArgs, Outcome},
};
use serde_json::{Map, Value, json};
use std::fmt::Write;

/// Describes the bundle.
pub fn run(args: &InfoArgs, common: &CommonArgs) -> Result<Outcome> {
    if args.at.is_some() || !args.set.is_empty() {
        let option = if args.at.is_some() { "--at" } else { "--set" };
        return Err(Error::input(option, "is for manifold files only"));
    }
    let size = std::fs::metadata(&args.file);
    let bytes = size.map_err(|e| Error::io(&args.file, e))?.len();
    let contents = Contents::read(&args.file)?;
    let (patches, flagged) = count(args, &contents)?;
    let summary = Summary {
        contents,
        bytes,
        patches,
        flagged,
    };
    if common.json {
        terminal::print_json(&summary.as_json())?;
    } else {
        terminal::print(&summary.as_text())?;
    }
    Ok(Outcome::Done)
}

/// Patches and flagged boxes of all chunks.
fn count(args: &InfoArgs, contents: &Contents) -> Result<(usize, usize)> {
    let mut sum = (0, 0);
    for (chunk, bytes) in &contents.chunks {
        let shape = Table::shape(&contents.space, contents.header.plan.stretch);
        let tree = Tree::outline(bytes, shape).map_err(|damage| {
            let message = format!("is not a valid bundle: chunk {chunk}: {damage}");
            Error::input(args.file.display().to_string(), message)
        })?;
        let (patches, flagged) = tree.count();
        sum = (sum.0 + patches, sum.1 + flagged);
    }
    Ok(sum)
}

struct Summary {
    contents: Contents,
    bytes: u64,
    patches: usize,
    flagged: usize,
}

fn reduction(header: &Header) -> &'static str {
    match header.reduction {
        Reduction::Whole => "none",
        Reduction::Rotation => "rotation",
        Reduction::Translation => "translation",
        Reduction::Group => "group",
        Reduction::Axis => "axis",
    }
}

impl Summary {
    fn id(&self) -> String {
        self.contents
            .id
            .iter()
            .map(|b| format!("{b:02x}"))
            .collect()
    }

    fn as_json(&self) -> Value {
        let header = &self.contents.header;
        let plan = &header.plan;
        let parameters = header.manifold.parameters.iter();
        let parameters: Map<_, _> = parameters.map(|(k, v)| (k.clone(), json!(v))).collect();
        json!({
            "kind": if header.shard.is_some() { "shard" } else { "bundle" },
            "shard": header.shard.map(|s| json!({ "index": s.index, "of": s.of })),
            "format": VERSION,
            "generator": header.generator,
            "id": self.id(),
            "name": header.manifold.name,
            "manifold": header.manifold.source,
            "parameters": parameters,
            "cameras": self.contents.space.describe(),
            "reduction": reduction(header),
            "stored_cameras": header.cameras,
            "mirrors": plan.mirrors.len(),
            "length": plan.length,
            "frames": plan.frames,
            "promise": plan.max_error,
            "tolerance": plan.tolerance,
            "chunks": self.contents.chunks.len(),
            "patches": self.patches,
            "flagged_boxes": self.flagged,
            "bytes": self.bytes,
            "certificate": header.certificate,
        })
    }

    fn as_text(&self) -> String {
        let header = &self.contents.header;
        let (plan, manifold) = (&header.plan, &header.manifold);
        let mut text = String::new();
        let mut line = |name: &str, value: String| {
            let _ = writeln!(text, "{name:<16} {value}");
        };
        if let Some(shard) = header.shard {
            line("shard", format!("{} of {}", shard.index, shard.of));
        }
        line("name", format!("{} ({})", manifold.name, manifold.source));
        for (name, value) in &manifold.parameters {
            line("parameter", format!("{name} = {value}"));
        }
        line("cameras", self.contents.space.describe());
        line("symmetry used", reduction(header).into());
        line("mirrors used", plan.mirrors.len().to_string());
        line("length", plan.length.to_string());
        let frames = if plan.frames {
            "promised"
        } else {
            "not promised"
        };
        line("tangents", frames.into());
        line("chunks", self.contents.chunks.len().to_string());
        line("patches", self.patches.to_string());
        line("flagged boxes", self.flagged.to_string());
        line("bytes", self.bytes.to_string());
        line("id", format!("{}, geofan {}", self.id(), header.generator));
        let promise = format!("99 % of screen errors within {} mrad", plan.max_error);
        line("promise", promise);
        match &header.certificate {
            None => line("certificate", "none".into()),
            Some(certificate) => {
                let rays = certificate.exact_rays_baked;
                line("rays baked", rays.to_string());
                text += &format!("certificate (seed {})\n", certificate.seed);
                text += &certificate.lines();
            }
        }
        text
    }
}
