//! `geofan trace`: one geodesic, followed exactly.
//!
//! In: a manifold file, a point, a direction, a length. Out: samples as a table or as JSON
//! (DESIGN §5), the path's end and its conjugate points.

use geofan::{
    Result,
    geodesic::{Path, Sample, Settings, conjugate_points, depart, paths, samples},
    manifold::{Carried, Manifold},
    terminal::{self, CommonArgs, Outcome, values},
};
use glam::DVec3;
use serde::Serialize;
use std::{fmt::Write, path::PathBuf};

/// Options of `geofan trace`.
#[derive(Debug, clap::Args)]
pub struct TraceArgs {
    /// The manifold file
    manifold: PathBuf,
    /// Where to start: a point in the chart's coordinates
    #[arg(long, value_name = "A,B,C", allow_hyphen_values = true, value_parser = values::vector)]
    at: DVec3,
    /// Where to go: a direction in the standard frame at the start, of any length
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = values::direction)]
    dir: DVec3,
    /// How far to go (arc length) [default: the manifold file's]
    #[arg(long, value_name = "L", allow_negative_numbers = true, value_parser = values::positive)]
    length: Option<f64>,
    /// How many samples to print, equally spaced from the start to the end
    #[arg(long, value_name = "N", default_value_t = 2,
          value_parser = clap::value_parser!(u32).range(2..=10_000_000))]
    samples: u32,
    /// Largest local error of a step, in radians
    #[arg(long, value_name = "T", default_value = "1e-10", value_parser = values::tolerance)]
    tolerance: f64,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    set: Vec<(String, f64)>,
}

/// What is printed.
struct Trace {
    manifold: Manifold,
    path: Path,
    samples: Vec<Sample>,
    conjugate: Vec<f64>,
}

/// Follows the geodesic and prints it.
pub fn run(args: &TraceArgs, common: &CommonArgs) -> Result<Outcome> {
    let trace = trace(args)?;
    if common.json {
        terminal::print_json(&trace.as_json())?;
    } else {
        terminal::print(&trace.as_text())?;
    }
    Ok(Outcome::Done)
}

fn trace(args: &TraceArgs) -> Result<Trace> {
    let manifold = Manifold::load(&args.manifold, &args.set)?;
    let length = manifold.length_or(args.length)?;
    let ray = depart(&manifold, "--at", args.at, args.dir, length)?;
    let settings = Settings {
        tolerance: args.tolerance,
        carried: Carried {
            frame: true,
            deviation: true,
        },
        events: true,
    };
    let path = paths(&manifold, settings, [ray]).remove(0);
    let samples = samples(&manifold, &ray, &path, args.samples as usize);
    let conjugate = conjugate_points(&manifold, &ray, &path);
    Ok(Trace {
        manifold,
        path,
        samples,
        conjugate,
    })
}

/// The JSON object of DESIGN §5, with the conjugate points besides.
#[derive(Serialize)]
struct TraceJson<'a> {
    samples: Vec<SampleJson>,
    end: &'a str,
    steps: usize,
    conjugate: &'a [f64],
}

#[derive(Serialize)]
struct SampleJson {
    s: f64,
    u: [f64; 3],
    v: [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    frame: Option<[[f64; 3]; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    area: Option<f64>,
}

impl From<&Sample> for SampleJson {
    fn from(sample: &Sample) -> Self {
        Self {
            s: sample.s,
            u: sample.u.to_array(),
            v: sample.v.to_array(),
            frame: sample.frame.map(|f| f.to_cols_array_2d()),
            area: sample.area,
        }
    }
}

impl Trace {
    fn as_json(&self) -> TraceJson<'_> {
        TraceJson {
            samples: self.samples.iter().map(SampleJson::from).collect(),
            end: self.path.end.name(&self.manifold),
            steps: self.path.tried,
            conjugate: &self.conjugate,
        }
    }

    fn as_text(&self) -> String {
        let mut text = self.heading();
        for sample in &self.samples {
            text += &row(sample);
        }
        if !self.conjugate.is_empty() {
            let places: Vec<_> = self.conjugate.iter().map(|s| format!("{s:.9}")).collect();
            let _ = writeln!(text, "conjugate points at s = {}", places.join(", "));
        }
        let _ = writeln!(
            text,
            "end: {} at s = {}, {} steps",
            self.path.end.name(&self.manifold),
            self.path.length,
            self.path.tried
        );
        text
    }

    fn heading(&self) -> String {
        let coordinates = &self.manifold.coordinates;
        let mut names = vec!["s".to_string()];
        names.extend(coordinates.iter().cloned());
        names.extend(coordinates.iter().map(|name| format!("v{name}")));
        names.push("area".into());
        line(&names)
    }
}

fn row(sample: &Sample) -> String {
    let numbers = [sample.s].into_iter();
    let numbers = numbers
        .chain(sample.u.to_array())
        .chain(sample.v.to_array());
    let mut cells: Vec<_> = numbers.map(cell).collect();
    cells.push(sample.area.map_or_else(|| "-".into(), cell));
    line(&cells)
}

fn line(cells: &[String]) -> String {
    let cells: Vec<_> = cells.iter().map(|c| format!("{c:>15}")).collect();
    cells.join(" ") + "\n"
}

/// Nine decimals, as long as that shows the number.
fn cell(x: f64) -> String {
    if x == 0.0 || (1e-4..1e5).contains(&x.abs()) {
        format!("{x:.9}")
    } else {
        format!("{x:.8e}")
    }
}
