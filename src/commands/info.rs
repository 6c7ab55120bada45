//! `geofan info`: what a file contains, and the differential geometry at one point of a manifold.
//!
//! In: a manifold file or a bundle, told apart by the bundle's first bytes. Out: a description as text or
//! JSON.

use crate::terminal::{self, CommonArgs, Outcome, values};
use geofan_bundle::{
    Contents, Table, TangentPromise, Tree,
    container::{MAGIC, VERSION},
    measure::tangents_at_exits,
};
use geofan_core::{
    Error, Result,
    field::{Field, Outside},
    geodesic::check_point,
    manifold::{Carried, Curvature, Form, GluedFace, Manifold},
    reading::{FileSource, MOST_OF_A_FILE, read_file, with_source},
};
use glam::{DMat3, DVec3};
use serde_json::{Map, Value, json};
use std::{
    fmt::Write,
    path::{Path, PathBuf},
    rc::Rc,
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
    let is_plain = args.file.metadata().is_ok_and(|found| found.is_file());
    // Of a plain file that is no bundle the first bytes are enough; what comes through a pipe is gone when it is read.
    let magic: &[u8] = if is_plain { MAGIC } else { &[] };
    let bytes = read_file(&args.file, magic, MOST_OF_A_FILE)?;
    let (is_bundle, size) = (bytes.starts_with(MAGIC), bytes.len());
    if !is_bundle && !may_be_text(&bytes) {
        let message = "is neither a bundle nor the UTF-8 text of a manifold; a bundle whose first bytes have changed is damaged";
        return Err(Error::input(args.file.display().to_string(), message));
    }
    let (file, is_whole) = (args.file.clone(), is_bundle || !is_plain);
    let read: FileSource = Rc::new(move |path| (is_whole && path == file).then(|| bytes.clone()));
    with_source(read, || match is_bundle {
        true => describe_bundle(args, size, common),
        false => describe_manifold(args, common),
    })?;
    Ok(Outcome::Done)
}

/// Returns whether a text may begin with these bytes, the last of which may be a part of a letter.
fn may_be_text(bytes: &[u8]) -> bool {
    let is_cut = |e: std::str::Utf8Error| e.error_len().is_none();
    !bytes.contains(&0) && str::from_utf8(bytes).err().is_none_or(is_cut)
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

/// Describes a bundle, or a shard of one, of so many bytes.
fn describe_bundle(args: &InfoArgs, bytes: usize, common: &CommonArgs) -> Result<()> {
    if args.at.is_some() || !args.set.is_empty() {
        let option = if args.at.is_some() { "--at" } else { "--set" };
        return Err(Error::input(option, "is for manifold files only"));
    }
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
        let shape = Table::tensor_shape(&contents.space, contents.header.plan.mapping);
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
fn bundle_json(contents: &Contents, (patches, flagged): (usize, usize), bytes: usize) -> Value {
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
fn bundle_text(contents: &Contents, (patches, flagged): (usize, usize), bytes: usize) -> String {
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

/// Describes the manifold.
fn describe_manifold(args: &InfoArgs, common: &CommonArgs) -> Result<()> {
    let manifold = Manifold::load(&args.file, &args.set)?;
    let at = args.at.map(|u| PointGeometry::new(&manifold, u));
    let at = at.transpose()?;
    match common.json {
        true => terminal::print_json(&as_json(&manifold, at.as_ref())),
        false => terminal::print(&as_text(&manifold, at.as_ref())),
    }
}

/// Right-hand sides by what they carry, with their names.
const CARRIED: [(&str, Carried); 4] = [
    ("path", carried(false, false)),
    ("path and frame", carried(true, false)),
    ("path and deviation", carried(false, true)),
    ("path, frame and deviation", carried(true, true)),
];

/// Names its arguments.
const fn carried(frame: bool, deviation: bool) -> Carried {
    Carried { frame, deviation }
}

/// Describes the manifold as JSON.
fn as_json(manifold: &Manifold, at: Option<&PointGeometry>) -> Value {
    let mut value = json!({
        "kind": "manifold",
        "name": manifold.name,
        "coordinates": manifold.coordinates,
        "definition": manifold.form.name(),
        "ambient": manifold.ambient,
        "light": manifold.medium_names(),
        "parameters": object(manifold.parameters.clone()),
        "fields": fields_json(manifold),
        "limits": manifold.domain.limits,
        "periodic": manifold.domain.periodic,
        "exits": exits(manifold),
        "symmetry": symmetry_json(manifold),
        "cameras": manifold.cameras.as_ref().map(|region| {
            object(region.names.iter().cloned().zip(&region.intervals))
        }),
        "length": manifold.length,
        "operations": operations_json(manifold),
    });
    if let Some(gluing) = manifold.gluing() {
        value["faces"] = gluing.faces().iter().map(face_json).collect();
    }
    if let Some(point) = at {
        value["at"] = point.as_json();
    }
    value
}

/// Describes a glued face as JSON; faces are numbered from 1.
fn face_json(face: &GluedFace) -> Value {
    json!({
        "partner": face.partner().map(|k| k + 1),
        "reverses": face.reverses(),
        "mirror": face.is_mirror(),
        "opening": face.is_portal(),
    })
}

/// Makes a JSON object of names and values.
fn object<N, V>(entries: impl IntoIterator<Item = (N, V)>) -> Value
where
    N: Into<String>,
    V: serde::Serialize,
{
    let entry = |(name, value): (N, V)| (name.into(), json!(value));
    Value::Object(entries.into_iter().map(entry).collect::<Map<_, _>>())
}

/// Describes the sampled fields as JSON.
fn fields_json(manifold: &Manifold) -> Value {
    let field = |field: &Field| {
        let plan = &field.plan;
        json!({
            "name": field.name,
            "files": field.files,
            "shape": field.samples.shape,
            "range": field.samples.range(),
            "box": plan.limits,
            "degree": plan.degree,
            "outside": plan.outside.map(Outside::name),
            "smooth": plan.smooth,
        })
    };
    manifold.fields.iter().map(field).collect()
}

/// Lists the names of exits.
fn exits(manifold: &Manifold) -> Vec<&str> {
    manifold.exits.iter().map(|e| e.name.as_str()).collect()
}

/// Describes the claims of symmetry as JSON.
fn symmetry_json(manifold: &Manifold) -> Value {
    json!({
        "rotation": manifold.symmetry.rotation,
        "axis": manifold.symmetry.axis.map(|k| &manifold.coordinates[k]),
        "translation": manifold.translations(),
        "group": manifold.symmetry.group.is_some(),
    })
}

/// Counts the operations of right-hand sides.
fn operations_json(manifold: &Manifold) -> Value {
    let entry = |(name, carried)| {
        let (arithmetic, functions) = manifold.flow(carried).operations();
        (
            name,
            json!({ "arithmetic": arithmetic, "functions": functions }),
        )
    };
    object(CARRIED.map(entry))
}

/// Describes the manifold in words.
fn as_text(manifold: &Manifold, at: Option<&PointGeometry>) -> String {
    let mut text = DescriptionText::default();
    text.line("name", &manifold.name);
    text.line("coordinates", manifold.coordinates.join(", "));
    text.line(
        "given by",
        match (manifold.form, manifold.ambient) {
            (Form::Embedding, Some(n)) => format!("embedding in R^{n}"),
            (Form::Normal, _) => "spacetime, seen by observers at rest on its slices".into(),
            (Form::Static, _) => "spacetime, seen by observers at rest in its coordinates".into(),
            _ => "metric".into(),
        },
    );
    let medium = manifold.medium_names();
    if !medium.is_empty() {
        text.line("light", format!("meets {}", medium.join(" and ")));
    }
    for (name, value) in &manifold.parameters {
        text.line("parameter", format!("{name} = {value}"));
    }
    for line in manifold.field_lines() {
        text.line("field", line);
    }
    for line in manifold.domain_lines() {
        text.line("domain", line);
    }
    if let Some(line) = manifold.gluing_line() {
        text.line("gluing", line);
    }
    text.line("exits", exits(manifold).join(", "));
    text.line("symmetry", manifold.symmetry_line());
    text.line("cameras", manifold.cameras_line());
    if let Some(length) = manifold.length {
        text.line("length", length);
    }
    for (name, carried) in CARRIED {
        let (arithmetic, functions) = manifold.flow(carried).operations();
        let cost = format!("{name}: {arithmetic} operations, {functions} functions");
        text.line("right-hand side", cost);
    }
    if let Some(point) = at {
        text.0 += &point.as_text(&manifold.coordinates);
    }
    text.0
}

/// Differential geometry at one point of the chart.
struct PointGeometry {
    u: DVec3,
    curvature: Curvature,
    frame: DMat3,
    /// `Ω(∂_k)` for each coordinate.
    connection: [DMat3; 3],
}

impl PointGeometry {
    /// Computes it, and refuses a point outside the domain.
    fn new(manifold: &Manifold, u: DVec3) -> Result<Self> {
        check_point(manifold, "--at", u)?;
        Ok(Self {
            u,
            curvature: manifold.curvature(u)?,
            frame: manifold.standard_frame(u),
            connection: manifold.connection(u),
        })
    }

    /// Describes it as JSON: matrices by rows, but `frame` as three vectors; `christoffel[k][i][j]` is Γ^k_ij,
    /// `connection[k]` is Ω(∂_k) in the standard frame, `riemann[a][b][c][d]` is R_abcd.
    fn as_json(&self) -> Value {
        let Curvature {
            metric,
            inverse,
            christoffel,
            riemann,
            ricci,
            scalar,
            ..
        } = &self.curvature;
        json!({
            "u": self.u.to_array(),
            "metric": rows(*metric),
            "inverse": rows(*inverse),
            "frame": self.frame.to_cols_array_2d(),
            "christoffel": christoffel,
            "connection": self.connection.map(rows),
            "riemann": riemann,
            "ricci": rows(*ricci),
            "scalar": scalar,
        })
    }

    /// Describes it in words; the Riemann tensor as its independent components.
    fn as_text(&self, names: &[String; 3]) -> String {
        let mut text = String::new();
        let mut matrix = |name: &str, rows| text += &block(name, rows);
        matrix("metric", rows(self.curvature.metric));
        matrix("inverse metric", rows(self.curvature.inverse));
        matrix("standard frame (columns)", rows(self.frame));
        for (name, gamma) in names.iter().zip(self.curvature.christoffel) {
            matrix(&format!("Christoffel symbols Γ^{name}_ij"), gamma);
        }
        for (name, omega) in names.iter().zip(self.connection) {
            let title = format!("connection Ω(∂_{name}) in the standard frame");
            matrix(&title, rows(omega));
        }
        text += &self.riemann(names);
        text += &block("Ricci curvature", rows(self.curvature.ricci));
        let _ = writeln!(text, "scalar curvature {}", self.curvature.scalar);
        text
    }

    /// Writes R_abcd for the planes (x, y), (x, z), (y, z): six numbers give all.
    fn riemann(&self, names: &[String; 3]) -> String {
        let planes = [(0, 1), (0, 2), (1, 2)];
        let mut text = String::from("Riemann curvature R_abcd\n");
        for (i, (a, b)) in planes.into_iter().enumerate() {
            for (c, d) in &planes[i..] {
                let [a_, b_, c_, d_] = [a, b, *c, *d].map(|k| names[k].as_str());
                let value = self.curvature.riemann[a][b][*c][*d];
                let _ = writeln!(text, "  {a_} {b_} {c_} {d_} {value:>16.9e}");
            }
        }
        text
    }
}

/// Returns the rows of a matrix.
fn rows(m: DMat3) -> [[f64; 3]; 3] {
    m.transpose().to_cols_array_2d()
}

/// Writes a matrix under its name.
fn block(name: &str, rows: [[f64; 3]; 3]) -> String {
    let mut text = format!("{name}\n");
    for row in rows {
        // No negative zeros.
        let [a, b, c] = row.map(|x| x + 0.0);
        let _ = writeln!(text, "  {a:>16.9e} {b:>16.9e} {c:>16.9e}");
    }
    text
}
