//! `geofan info` on a manifold file.

use super::{InfoArgs, place::Place};
use geofan::{
    Result,
    manifold::{Carried, Form, Manifold},
    terminal::{self, CommonArgs, Outcome},
};
use serde_json::{Map, Value, json};
use std::fmt::Write;

/// Describes the manifold.
pub fn run(args: &InfoArgs, common: &CommonArgs) -> Result<Outcome> {
    let manifold = Manifold::load(&args.file, &args.set)?;
    let at = args.at.map(|u| Place::new(&manifold, u)).transpose()?;
    if common.json {
        terminal::print_json(&as_json(&manifold, at.as_ref()))?;
    } else {
        terminal::print(&as_text(&manifold, at.as_ref()))?;
    }
    Ok(Outcome::Done)
}

/// What a right-hand side carries, by name.
const CARRIED: [(&str, Carried); 4] = [
    ("path", carried(false, false)),
    ("path and frame", carried(true, false)),
    ("path and deviation", carried(false, true)),
    ("path, frame and deviation", carried(true, true)),
];

const fn carried(frame: bool, deviation: bool) -> Carried {
    Carried { frame, deviation }
}

fn as_json(manifold: &Manifold, at: Option<&Place>) -> Value {
    let mut value = json!({
        "kind": "manifold",
        "name": manifold.name,
        "coordinates": manifold.coordinates,
        "definition": definition(manifold),
        "ambient": manifold.ambient,
        "light": medium(manifold),
        "parameters": object(manifold.parameters.clone()),
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
    if let Some(place) = at {
        value["at"] = place.as_json();
    }
    value
}

fn object<N, V>(entries: impl IntoIterator<Item = (N, V)>) -> Value
where
    N: Into<String>,
    V: serde::Serialize,
{
    let entry = |(name, value): (N, V)| (name.into(), json!(value));
    Value::Object(entries.into_iter().map(entry).collect::<Map<_, _>>())
}

fn definition(manifold: &Manifold) -> &'static str {
    match manifold.form {
        Form::Embedding => "embedding",
        Form::Metric => "metric",
        Form::Normal | Form::Static => "spacetime",
    }
}

/// What light meets besides the metric.
fn medium(manifold: &Manifold) -> Vec<&'static str> {
    let all = [
        (manifold.blows(), "a wind"),
        (manifold.has_drift(), "a drift of time"),
        (manifold.has_lapse(), "a lapse of clocks"),
    ];
    all.into_iter().filter(|m| m.0).map(|m| m.1).collect()
}

fn exits(manifold: &Manifold) -> Vec<&str> {
    manifold.exits.iter().map(|e| e.name.as_str()).collect()
}

fn translations(manifold: &Manifold) -> Vec<&str> {
    let names = manifold.coordinates.iter().map(String::as_str);
    let claims = names.zip(manifold.symmetry.translation);
    claims.filter(|c| c.1).map(|c| c.0).collect()
}

fn symmetry_json(manifold: &Manifold) -> Value {
    json!({
        "rotation": manifold.symmetry.rotation,
        "axis": manifold.symmetry.axis.map(|k| &manifold.coordinates[k]),
        "translation": translations(manifold),
        "group": manifold.symmetry.group.is_some(),
    })
}

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

fn as_text(manifold: &Manifold, at: Option<&Place>) -> String {
    let mut text = Lines::default();
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
    let medium = medium(manifold);
    if !medium.is_empty() {
        text.line("light", format!("meets {}", medium.join(" and ")));
    }
    for (name, value) in &manifold.parameters {
        text.line("parameter", format!("{name} = {value}"));
    }
    for line in domain(manifold) {
        text.line("domain", line);
    }
    text.line("exits", exits(manifold).join(", "));
    text.line("symmetry", symmetry(manifold));
    text.line("cameras", cameras(manifold));
    if let Some(length) = manifold.length {
        text.line("length", length);
    }
    for (name, carried) in CARRIED {
        let (arithmetic, functions) = manifold.flow(carried).operations();
        let cost = format!("{name}: {arithmetic} operations, {functions} functions");
        text.line("right-hand side", cost);
    }
    if let Some(place) = at {
        text.0 += &place.as_text(&manifold.coordinates);
    }
    text.0
}

/// Lines of a name and a value.
#[derive(Default)]
struct Lines(String);

impl Lines {
    fn line(&mut self, name: &str, value: impl std::fmt::Display) {
        let _ = writeln!(self.0, "{name:<16} {value}");
    }
}

fn domain(manifold: &Manifold) -> Vec<String> {
    use geofan::manifold::EventKind;
    let domain = &manifold.domain;
    let mut lines = Vec::new();
    for (k, name) in manifold.coordinates.iter().enumerate() {
        if let Some([low, high]) = domain.limits[k] {
            let glued = if domain.periodic[k] { ", glued" } else { "" };
            lines.push(format!("{name} in [{low}, {high}]{glued}"));
        }
    }
    let conditions = domain.kinds.iter().filter(|k| **k == EventKind::Inside);
    match conditions.count() {
        0 => {}
        1 => lines.push("1 condition".into()),
        n => lines.push(format!("{n} conditions")),
    }
    lines
}

fn symmetry(manifold: &Manifold) -> String {
    let mut claims = Vec::new();
    if manifold.symmetry.rotation {
        claims.push("rotations about the origin".to_string());
    }
    if let Some(axis) = manifold.symmetry.axis {
        claims.push(format!(
            "rotations about the {} axis",
            manifold.coordinates[axis]
        ));
    }
    let translations = translations(manifold);
    if !translations.is_empty() {
        claims.push(format!("translations along {}", translations.join(", ")));
    }
    if manifold.symmetry.group.is_some() {
        claims.push("left translations of a group".into());
    }
    match claims.is_empty() {
        true => "none claimed".into(),
        false => format!("{} (verified)", claims.join("; ")),
    }
}

fn cameras(manifold: &Manifold) -> String {
    match &manifold.cameras {
        None => "no region given".into(),
        Some(_) if manifold.symmetry.group.is_some() => "any point, by the group".into(),
        Some(region) if region.dimension() == 0 => {
            let u = region.at(&[]);
            format!("one point: {}, {}, {}", u.x, u.y, u.z)
        }
        Some(region) => {
            let intervals = region.names.iter().zip(&region.intervals);
            let interval =
                |(name, [low, high]): (&String, &[f64; 2])| format!("{name} in [{low}, {high}]");
            intervals.map(interval).collect::<Vec<_>>().join(", ")
        }
    }
}
