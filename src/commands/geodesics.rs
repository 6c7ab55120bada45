//! `geofan trace` and `geofan project`: geodesics from a point, one in a direction or all to another point.
//!
//! - `trace` takes a manifold file or a bundle, a point, a direction, a length, and gives samples as a table or as
//!   JSON, the path's end and, of an exact path, its conjugate points. Where light may change its frequency, samples
//!   tell by how much; where time is not the path's parameter, what time it is.
//! - `project` takes a scene, one of its cameras and a chart point, and says where the point is in the picture: to first
//!   order in its distance, and by its images, every geodesic by which the camera sees it, whatever stands in between.

use crate::terminal::{self, CommonArgs, Outcome, values};
use geofan_bundle::{self, Bundle};
use geofan_core::{
    Error, Result,
    geodesic::{
        End, MOST_STEPS, PASSING_ANGLE, Sample, Settings, check_point, check_start, depart,
        elapsed, paths_beside_poles,
    },
    manifold::Manifold,
};
use geofan_light::{Connection, LightFan};
use geofan_render::{Stage, View, local::projection, usual_size};
use glam::DVec3;
use serde::Serialize;
use serde_json::{Value, json};
use std::{
    fmt::Write,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Options of `geofan trace`.
#[derive(Debug, clap::Args)]
pub struct TraceArgs {
    /// The manifold file
    #[arg(required_unless_present = "bundle", conflicts_with = "bundle")]
    manifold: Option<PathBuf>,
    /// Read the path from this bundle; only flagged rays are followed exactly
    #[arg(long, value_name = "B.fan", conflicts_with = "set")]
    bundle: Option<PathBuf>,
    /// Where to start: a point in the chart's coordinates
    #[arg(long, value_name = "A,B,C", allow_hyphen_values = true, value_parser = values::vector)]
    at: DVec3,
    /// Where to go: a direction in the standard frame at the start, of any length
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = values::direction)]
    dir: DVec3,
    /// Arc length of the path [default: the manifold file's, the bundle's]
    #[arg(long, value_name = "L", value_parser = values::length)]
    length: Option<f64>,
    /// Number of samples to print, equally spaced from the start to the end
    #[arg(long, value_name = "N", default_value_t = 2,
          value_parser = clap::value_parser!(u32).range(2..=10_000_000))]
    samples: u32,
    /// Follow light into the future; without, the line of sight, along which light has come
    #[arg(long, conflicts_with = "bundle")]
    forward: bool,
    /// Largest local error of a step, in radians
    #[arg(long, value_name = "T", default_value = "1e-10", value_parser = values::tolerance)]
    tolerance: f64,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    set: Vec<(String, f64)>,
}

/// A path to be printed.
struct Trace {
    manifold: Arc<Manifold>,
    samples: Vec<Sample>,
    /// The time at each sample, from the start on, where it is not the arc length: in a drift.
    times: Option<Vec<f64>>,
    end: End,
    length: f64,
    steps: usize,
    /// Only exact paths know them.
    conjugate: Option<Vec<f64>>,
    /// Set if it was turned by [`PASSING_ANGLE`] to pass a pole of the chart.
    turned: bool,
    /// How often it was looked up again where the bundle's paths end.
    restarts: usize,
    /// Set if a bundle left this ray to the integrator.
    flagged: bool,
}

/// Follows the geodesic and prints it.
pub fn trace(args: &TraceArgs, common: &CommonArgs) -> Result<Outcome> {
    let trace = match (&args.bundle, &args.manifold) {
        (Some(bundle), _) => from_bundle(args, bundle)?,
        (None, Some(manifold)) => exact(args, manifold)?,
        (None, None) => return Err(Error::input("MANIFOLD", "is missing")),
    };
    if common.json {
        terminal::print_json(&trace.as_json())?;
    } else {
        terminal::print(&trace.as_text())?;
    }
    Ok(Outcome::Done)
}

/// Follows the geodesic by integration.
fn exact(args: &TraceArgs, file: &Path) -> Result<Trace> {
    let mut manifold = Manifold::load(file, &args.set)?;
    if args.forward {
        manifold = manifold.forward()?.into_owned();
    }
    let length = manifold.length_or(args.length)?;
    let ray = depart(&manifold, "--at", args.at, args.dir, length)?;
    let settings = Settings::bare(args.tolerance)
        .with_frame()
        .with_deviation()
        .with_events();
    let followed = paths_beside_poles(&manifold, settings, &[ray]).remove(0);
    let path = &followed.path;
    let samples = followed.samples(&manifold, args.samples as usize);
    let times = |s: &Sample| elapsed(&manifold, path, s.s);
    if path.end == End::Singular && path.tried >= MOST_STEPS {
        tracing::warn!(
            "given up at s = {} after {MOST_STEPS} steps, which tells nothing about the space there; with a larger --tolerance steps are longer",
            path.length
        );
    }
    Ok(Trace {
        times: (manifold.has_drift()).then(|| samples.iter().map(times).collect()),
        samples,
        conjugate: Some(followed.conjugate_points(&manifold)),
        turned: followed.ray.v != ray.v,
        end: path.end,
        length: path.length,
        steps: path.tried,
        manifold: Arc::new(manifold),
        restarts: 0,
        flagged: false,
    })
}

/// Reads the geodesic from a bundle.
fn from_bundle(args: &TraceArgs, file: &Path) -> Result<Trace> {
    let Bundle {
        table, manifold, ..
    } = Bundle::read(file)?;
    let length = args.length.unwrap_or(table.length);
    if length > table.length && !table.restarts() {
        let message = format!("the bundle's paths end at {}", table.length);
        return Err(Error::input("--length", message));
    }
    if length > MOST_PARTS * table.length {
        let message = format!(
            "more than {MOST_PARTS} times the length of the bundle's paths, {}; without --bundle it is integrated",
            table.length
        );
        return Err(Error::input("--length", message));
    }
    check_start(&manifold, "--at", args.at)?;
    table.space.place(args.at).map_err(about_at)?;
    let count = args.samples as usize;
    // In a drift the path is looked at in places between the samples, too: between two of them so many parts.
    let parts = match manifold.has_drift() {
        true => TIME_PLACES.div_ceil(count - 1).next_multiple_of(2),
        false => 1,
    };
    let places = (count - 1) * parts + 1;
    let traced = geofan_bundle::trace(&table, args.at, args.dir, length, places, args.tolerance);
    let traced = traced.map_err(|error| match length > table.length {
        true => about_restart(error, table.length),
        false => error,
    })?;
    let times = || times_along(&manifold, &traced.samples, parts);
    Ok(Trace {
        times: manifold.has_drift().then(times),
        manifold,
        samples: traced.samples.into_iter().step_by(parts).collect(),
        end: traced.end,
        length: traced.length,
        steps: traced.steps,
        conjugate: None,
        turned: traced.turned,
        restarts: traced.restarts,
        flagged: traced.exact,
    })
}

/// Most times that a path of a bundle is looked up: each takes some kilobytes until the samples are made.
const MOST_PARTS: f64 = 1e4;

/// Places along a bundle's path at which the rate of time is looked at, at least.
const TIME_PLACES: usize = 512;

/// Integrates the time along a path that is known at equally spaced places, by Simpson's rule; returns it at the first of
/// every so many parts, which must be an even number, and at the end.
fn times_along(manifold: &Manifold, places: &[Sample], parts: usize) -> Vec<f64> {
    let rates: Vec<f64> = places
        .iter()
        .map(|x| manifold.time_rate(x.u, x.v))
        .collect();
    let step = places.last().map_or(0.0, |last| last.s) / (places.len() - 1) as f64;
    let two_steps = rates.windows(3).step_by(2);
    let mut time = 0.0;
    let mut times = vec![0.0];
    times.extend(two_steps.map(|rates| {
        time += step / 3.0 * (rates[0] + 4.0 * rates[1] + rates[2]);
        time
    }));
    times.into_iter().step_by(parts / 2).collect()
}

/// Makes an error one about the option that gave the camera.
fn about_at(error: Error) -> Error {
    match error {
        Error::Input { message, .. } => Error::input("--at", message),
        other => other,
    }
}

/// Makes an error about a camera one about the place where a path of this bundle was to be looked up again.
fn about_restart(error: Error, length: f64) -> Error {
    match error {
        Error::Input { message, .. } => {
            let told = format!(
                "the bundle's paths end at {length}, and from there it knows none: {message}"
            );
            Error::input("--length", told)
        }
        other => other,
    }
}

/// A path as JSON.
#[derive(Serialize)]
struct TraceJson<'a> {
    samples: Vec<SampleJson>,
    end: &'a str,
    steps: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    conjugate: Option<&'a [f64]>,
    /// Angle (radians) by which the direction was turned to pass a pole of the chart.
    #[serde(skip_serializing_if = "Option::is_none")]
    turned: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    restarts: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    exact: Option<bool>,
}

/// A sample of a path as JSON.
#[derive(Serialize)]
struct SampleJson {
    s: f64,
    u: [f64; 3],
    v: [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    frame: Option<[[f64; 3]; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    area: Option<f64>,
    /// Frequency seen over frequency sent, by normal observers at the start and here.
    #[serde(skip_serializing_if = "Option::is_none")]
    g: Option<f64>,
    /// Time since the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    t: Option<f64>,
    /// Faces of a glued space crossed up to here, and 1, or −1 where they have turned right into left.
    #[serde(skip_serializing_if = "Option::is_none")]
    crossings: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    handedness: Option<i8>,
}

impl SampleJson {
    fn new(sample: &Sample, g: Option<f64>, t: Option<f64>, glued: bool) -> Self {
        let handedness = if sample.reversed { -1 } else { 1 };
        Self {
            s: sample.s,
            u: sample.u.to_array(),
            v: sample.v.to_array(),
            frame: sample.frame.map(|f| f.to_cols_array_2d()),
            area: sample.area,
            g,
            t,
            crossings: glued.then_some(sample.crossings),
            handedness: glued.then_some(handedness),
        }
    }
}

impl Trace {
    /// Returns the frequency seen over frequency sent, by normal observers at the start and at `sample`; `None` where
    /// light keeps its frequency.
    fn redshift(&self, sample: &Sample) -> Option<f64> {
        let first = self.samples.first()?;
        let start = (first.u, first.v);
        self.manifold.redshift(start, (sample.u, sample.v))
    }

    /// Pairs each sample with its redshift and its time.
    fn rows(&self) -> impl Iterator<Item = (&Sample, Option<f64>, Option<f64>)> {
        let row = |(i, sample)| {
            let time = self.times.as_ref().map(|times| times[i]);
            (sample, self.redshift(sample), time)
        };
        self.samples.iter().enumerate().map(row)
    }

    /// Returns what JSON is made of.
    fn as_json(&self) -> TraceJson<'_> {
        let glued = self.manifold.gluing().is_some();
        TraceJson {
            samples: self
                .rows()
                .map(|(x, g, t)| SampleJson::new(x, g, t, glued))
                .collect(),
            end: self.end.name(&self.manifold),
            steps: self.steps,
            conjugate: self.conjugate.as_deref(),
            turned: self.turned.then_some(PASSING_ANGLE),
            restarts: (self.restarts > 0).then_some(self.restarts),
            exact: self.flagged.then_some(true),
        }
    }

    /// Writes the path as a table.
    fn as_text(&self) -> String {
        let mut text = self.heading();
        for (sample, g, t) in self.rows() {
            text += &row(sample, [g, t]);
        }
        let conjugate = self.conjugate.as_deref().unwrap_or_default();
        if !conjugate.is_empty() {
            let places: Vec<_> = conjugate.iter().map(|s| format!("{s:.9}")).collect();
            let _ = writeln!(text, "conjugate points at s = {}", places.join(", "));
        }
        let _ = writeln!(
            text,
            "end: {} at s = {}, {} steps",
            self.end.name(&self.manifold),
            self.length,
            self.steps
        );
        if self.manifold.gluing().is_some()
            && let Some(last) = self.samples.last()
        {
            let handedness = if last.reversed { "left" } else { "right" };
            let crossings = last.crossings;
            let _ = writeln!(text, "{crossings} faces crossed, {handedness}-handed");
        }
        if self.restarts > 0 {
            let _ = writeln!(
                text,
                "looked up again {} times where the bundle's paths end",
                self.restarts
            );
        }
        if self.turned {
            let _ = writeln!(
                text,
                "turned by {PASSING_ANGLE:e} rad: straight on it would meet a pole of the chart"
            );
        }
        if self.flagged {
            text += "the ray is flagged in the bundle and was followed exactly\n";
        }
        text
    }

    /// Writes the heading of the table.
    fn heading(&self) -> String {
        let coordinates = &self.manifold.coordinates;
        let mut names = vec!["s".to_string()];
        names.extend(coordinates.iter().cloned());
        names.extend(coordinates.iter().map(|name| format!("v{name}")));
        names.push("area".into());
        if self.manifold.has_redshift() {
            names.push("g".into());
        }
        if self.times.is_some() {
            names.push("t".into());
        }
        line(&names)
    }
}

/// Writes a sample as a line of the table.
fn row(sample: &Sample, more: [Option<f64>; 2]) -> String {
    let numbers = [sample.s].into_iter();
    let numbers = numbers
        .chain(sample.u.to_array())
        .chain(sample.v.to_array());
    let mut cells: Vec<_> = numbers.map(cell).collect();
    cells.push(sample.area.map_or_else(|| "-".into(), cell));
    cells.extend(more.into_iter().flatten().map(cell));
    line(&cells)
}

/// Joins cells to a line of the table.
fn line(cells: &[String]) -> String {
    let cells: Vec<_> = cells.iter().map(|c| format!("{c:>15}")).collect();
    cells.join(" ") + "\n"
}

/// Writes a number with nine decimals, as long as that shows it.
fn cell(x: f64) -> String {
    if x == 0.0 || (1e-4..1e5).contains(&x.abs()) {
        format!("{x:.9}")
    } else {
        format!("{x:.8e}")
    }
}

/// Options of `geofan project`.
#[derive(Debug, clap::Args)]
pub struct ProjectArgs {
    /// The scene file
    scene: PathBuf,
    /// The point, in the chart's coordinates
    #[arg(long, value_name = "A,B,C", allow_hyphen_values = true, value_parser = values::vector)]
    point: DVec3,
    /// The camera: the name of one of the scene's views [default: its main camera]
    #[arg(long, value_name = "NAME")]
    view: Option<String>,
    /// Picture size [default: 1280x720, or what suits the projection]
    #[arg(long, value_name = "WxH", value_parser = values::picture_size)]
    size: Option<(usize, usize)>,
    /// Arc length up to which images are looked for [default: the manifold file's]
    #[arg(long, value_name = "L", value_parser = values::length)]
    length: Option<f64>,
    /// Local tolerance of geodesics
    #[arg(long, value_name = "T", default_value = "1e-11", value_parser = values::tolerance)]
    tolerance: f64,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    set: Vec<(String, f64)>,
}

/// The box about the point for which rays are spread finely, as a share of its distance in the chart.
const NEIGHBOURHOOD: f64 = 0.25;

/// A point's places in a picture.
struct Projected {
    view: View,
    length: f64,
    /// In the camera's axes (right, up, backwards), to first order.
    local: DVec3,
    /// The geodesics that bring its images, and whether those show left for right.
    images: Vec<(Connection, bool)>,
}

/// Tells whether the image that a geodesic of `manifold`, perhaps the cover of a glued space, brings shows left for right.
fn is_mirrored(manifold: &Manifold, connection: &Connection) -> bool {
    let gluing = manifold
        .gluing_below()
        .filter(|_| manifold.gluing().is_none());
    let reversed = gluing.is_some_and(|gluing| {
        let found = gluing.locate(connection.u);
        found.is_some_and(|(_, word)| gluing.reverses(&word))
    });
    (connection.area < 0.0) != reversed
}

/// Finds the point and prints where it is.
pub fn project(args: &ProjectArgs, common: &CommonArgs) -> Result<Outcome> {
    let projected = images(args)?;
    match common.json {
        true => terminal::print_json(&projected.as_json())?,
        false => terminal::print(&projected.as_text())?,
    }
    Ok(Outcome::Done)
}

/// Finds the point to first order, and every geodesic to it.
fn images(args: &ProjectArgs) -> Result<Projected> {
    let stage = Stage::load(&args.scene, &args.set)?;
    let name = args.view.as_deref();
    let size = args.size.unwrap_or(usual_size(&stage.camera(name)?.lens));
    let view = stage.view_of(name, size)?;
    if !view.is_central() {
        let message = "parallel rays do not start at one point, and this takes images along geodesics from the camera; `geofan render` draws them";
        return Err(Error::input("the camera", message));
    }
    // Of a glued space the cover: the point has an image in every copy.
    let manifold = stage.world.manifold.developed();
    check_point(&manifold, "--point", args.point)?;
    if args.point == view.u {
        return Err(Error::input("--point", "is where the camera is"));
    }
    let length = manifold.length_or(args.length)?;
    let margin = NEIGHBOURHOOD * (args.point - view.u).length();
    let fan = LightFan::to_point(&manifold, view.u, length, (args.point, margin));
    if !fan.reaches_all_copies() {
        tracing::warn!(
            "there are more copies of the glued domain about the end of the paths than are looked into: images in others, if any, are left out; a shorter --length has fewer"
        );
    }
    let (found, _) = fan.connections(&[args.point], args.tolerance);
    let found = found.into_iter().map(|(_, connection)| connection);
    let images: Vec<_> = found
        .map(|connection| (connection, is_mirrored(&manifold, &connection)))
        .collect();
    let beyond = manifold
        .domain
        .exit_beyond(manifold.domain.wrap(args.point));
    if let Some((exit, _)) = beyond.filter(|_| images.is_empty()) {
        let name = &manifold.exits[exit].name;
        tracing::warn!(
            "--point lies beyond the exit `{name}`, where paths end before they get there"
        );
    }
    Ok(Projected {
        local: projection(&stage.world, &view, args.point),
        images,
        length,
        view,
    })
}

impl Projected {
    /// The point of the picture in a direction of the standard frame, where it has one.
    fn pixel(&self, direction: DVec3) -> Option<[f64; 2]> {
        self.view.pixel(direction).map(|(x, y)| [x, y])
    }

    /// The first-order place in the picture.
    fn local_pixel(&self) -> Option<[f64; 2]> {
        self.view.pixel_of(self.local).map(|(x, y)| [x, y])
    }

    fn as_json(&self) -> Value {
        let image = |(image, mirrored): &(Connection, bool)| {
            json!({
                "direction": image.direction.to_array(),
                "distance": image.s,
                "area": image.area.abs(),
                "mirrored": mirrored,
                "pixel": self.pixel(image.direction),
                "u": image.u.to_array(),
                "v": image.v.to_array(),
            })
        };
        json!({
            "camera": self.view.u.to_array(),
            "size": [self.view.size.0, self.view.size.1],
            "local": { "p": self.local.to_array(), "pixel": self.local_pixel() },
            "length": self.length,
            "images": self.images.iter().map(image).collect::<Vec<_>>(),
        })
    }

    fn as_text(&self) -> String {
        let p = self.local;
        let mut text = format!(
            "local  right {:.9}, up {:.9}, ahead {:.9}, {}\n",
            p.x,
            p.y,
            -p.z,
            place(self.local_pixel())
        );
        let _ = writeln!(
            text,
            "images up to length {}: {}",
            self.length,
            self.images.len()
        );
        for (image, mirrored) in &self.images {
            let d = image.direction;
            let side = if *mirrored { ", mirrored" } else { "" };
            let _ = writeln!(
                text,
                "  distance {:.9}, area {:.9}, direction ({:.9}, {:.9}, {:.9}), {}{side}",
                image.s,
                image.area.abs(),
                d.x,
                d.y,
                d.z,
                place(self.pixel(d))
            );
        }
        text
    }
}

/// Says where a pixel is.
fn place(pixel: Option<[f64; 2]>) -> String {
    match pixel {
        Some([x, y]) => format!("pixel ({x:.3}, {y:.3})"),
        None => "no place in the picture".into(),
    }
}
