//! `geofan transport`: vectors and the standard frame carried in parallel along any curve.
//!
//! In: a manifold file, a curve by expressions, an interval of its parameter, vectors. Out: what becomes of them
//! at the curve's end and, of a closed curve, the holonomy: the rotation by which everything comes back turned.

use crate::terminal::{self, CommonArgs, Outcome, values};
use geofan_core::{
    Error, Result,
    diagnostic::{Diagnostic, SourceText},
    geodesic::{Transport, check_inside, check_jumps, to_nearest_image, transport},
    manifold::{ChartCurve, Manifold, known_names},
};
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};
use std::{fmt::Write, path::PathBuf};

/// Options of `geofan transport`.
#[derive(Debug, clap::Args)]
pub struct TransportArgs {
    /// The manifold file
    manifold: PathBuf,
    /// The curve: three expressions of t and the manifold's parameters, the chart's coordinates
    #[arg(long, value_name = "\"X(t)\",\"Y(t)\",\"Z(t)\"", allow_hyphen_values = true, value_parser = values::expressions)]
    curve: [String; 3],
    /// Where t begins: a number or an expression such as -pi/2
    #[arg(long, value_name = "A", allow_hyphen_values = true, value_parser = values::constant)]
    from: f64,
    /// Where t ends
    #[arg(long, value_name = "B", allow_hyphen_values = true, value_parser = values::constant)]
    to: f64,
    /// A vector at the start to carry along, components in the chart's coordinates; may be repeated
    #[arg(long, value_name = "A,B,C", allow_hyphen_values = true, value_parser = values::vector)]
    vector: Vec<DVec3>,
    /// Largest error of a step, in radians
    #[arg(long, value_name = "T", default_value = "1e-12", value_parser = values::tolerance)]
    tolerance: f64,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    set: Vec<(String, f64)>,
}

/// A curve whose ends are nearer than this share of its length (in the metric, by chords) is closed.
const CLOSED: f64 = 1e-9;

/// A transport to be printed.
struct TransportReport {
    manifold: Manifold,
    transport: Transport,
    /// Parameter and point, of both ends.
    ends: [(f64, DVec3); 2],
    vectors: Vec<DVec3>,
    holonomy: Option<Holonomy>,
}

/// By what a closed curve turns.
#[derive(Clone, Copy)]
struct Holonomy {
    /// Axis (standard frame at the start), and angle.
    axis: DVec3,
    angle: f64,
    /// Set if left and right are exchanged: then everything is reflected in the point first.
    reflected: bool,
}

impl Holonomy {
    /// Takes the matrix from axes at the start to those that come back.
    fn new(matrix: DMat3) -> Self {
        let reflected = matrix.determinant() < 0.0;
        let rotation = if reflected { -matrix } else { matrix };
        let (axis, angle) = DQuat::from_mat3(&rotation).normalize().to_axis_angle();
        Self {
            axis,
            angle,
            reflected,
        }
    }
}

/// Carries the vectors along and prints them.
pub fn run(args: &TransportArgs, common: &CommonArgs) -> Result<Outcome> {
    let carried = carry(args)?;
    match common.json {
        true => terminal::print_json(&carried.as_json())?,
        false => terminal::print(&carried.as_text())?,
    }
    Ok(Outcome::Done)
}

fn carry(args: &TransportArgs) -> Result<TransportReport> {
    let manifold = Manifold::load(&args.manifold, &args.set)?;
    let curve = read_curve(&manifold, &args.curve)?;
    let way = [args.from, args.to];
    let length = check_inside(&manifold, "--curve", |t| curve.at(t), way, 1)?;
    check_jumps(&manifold, "--curve", |t| curve.at(t), way, length)?;
    let transport = transport(&manifold, |t| curve.at(t), way, args.tolerance)
        .map_err(|e| Error::input("--curve", e.to_string()))?;
    let ends = way.map(|t| (t, curve.at(t).0));
    let [start, end] = ends.map(|(_, u)| manifold.domain.wrap(u));
    let near = |gap: DVec3| {
        let gap = manifold.standard_frame(start).inverse() * gap;
        length.is_finite() && gap.length() <= CLOSED * length
    };
    // As it is where the curve begins.
    let back = match near(to_nearest_image(&manifold, start, end)) {
        true => Some(transport.matrix() * manifold.standard_frame(ends[0].1)),
        false => brought_back(&manifold, [start, end], near)
            .map(|back| back * transport.matrix() * manifold.standard_frame(ends[0].1)),
    };
    let frame = manifold.standard_frame(start);
    Ok(TransportReport {
        holonomy: back.map(|back| Holonomy::new(frame.inverse() * back)),
        transport,
        ends,
        vectors: args.vector.clone(),
        manifold,
    })
}

/// Finds the differential of the map of a glued space that takes the curve's end to its start; `None` if there is none
/// that does.
fn brought_back(
    manifold: &Manifold,
    [start, end]: [DVec3; 2],
    near: impl Fn(DVec3) -> bool,
) -> Option<DMat3> {
    let gluing = manifold.gluing()?;
    let (_, out) = gluing.locate(start)?;
    let (inside, into) = gluing.locate(end)?;
    let (way, out) = (gluing.way_in(&into)?, gluing.way_back(&out)?);
    // A point on a face stands for others on faces.
    let faces = gluing.faces().iter().filter_map(|face| face.deck());
    let across = faces.filter(|deck| gluing.violated(deck.point(inside)).is_none());
    let ways = std::iter::once(way.clone()).chain(across.map(|deck| way.then(deck)));
    let mut ways = ways.map(|way| way.then(&out).apply(end));
    let found = ways.find(|(image, _)| near(*image - start));
    found.map(|(_, differential)| differential)
}

fn read_curve(manifold: &Manifold, texts: &[String; 3]) -> Result<ChartCurve> {
    let components = [0, 1, 2].map(|k| texts[k].as_str());
    ChartCurve::parse(manifold, "t", components).map_err(|(k, error)| {
        let source = SourceText::new("--curve", texts[k].clone());
        let advice = error.advice(&known_names("`t`"));
        let complaint = Diagnostic::new(&source, error.span, error.message);
        match advice {
            Some(hint) => complaint.with_hint(hint).into(),
            None => complaint.into(),
        }
    })
}

impl TransportReport {
    /// The vectors in the standard frames at the start and at the end.
    fn in_frames(&self, w: DVec3) -> [DVec3; 2] {
        let into = |u: DVec3| self.manifold.standard_frame(u).inverse();
        let [start, end] = self.ends.map(|(_, u)| into(u));
        [start * w, end * self.transport.vector(w)]
    }

    /// The standard frame of the start, carried to the end: columns, chart components.
    fn frame(&self) -> DMat3 {
        self.transport.matrix() * self.manifold.standard_frame(self.ends[0].1)
    }

    fn as_json(&self) -> Value {
        let end = |(t, u): (f64, DVec3)| json!({ "t": t, "u": u.to_array() });
        let vector = |w: &DVec3| {
            let [before, after] = self.in_frames(*w).map(|w| w.to_array());
            json!({
                "from": w.to_array(),
                "to": self.transport.vector(*w).to_array(),
                "standard_from": before,
                "standard_to": after,
            })
        };
        let holonomy = self.holonomy.map(|found| {
            json!({
                "axis": found.axis.to_array(),
                "angle": found.angle,
                "reflected": found.reflected,
            })
        });
        json!({
            "from": end(self.ends[0]),
            "to": end(self.ends[1]),
            "vectors": self.vectors.iter().map(vector).collect::<Vec<_>>(),
            "frame": self.frame().to_cols_array_2d(),
            "rotation": self.transport.rotation.to_array(),
            "closed": self.holonomy.is_some(),
            "holonomy": holonomy,
            "steps": self.transport.steps,
        })
    }

    fn as_text(&self) -> String {
        let mut text = String::new();
        for (name, (t, u)) in ["from", "to"].into_iter().zip(self.ends) {
            let _ = writeln!(text, "{name:<10} t = {t}, {}", numbers(u));
        }
        for w in &self.vectors {
            let (to, [before, after]) = (self.transport.vector(*w), self.in_frames(*w));
            let _ = writeln!(text, "vector     {} becomes {}", numbers(*w), numbers(to));
            let _ = writeln!(
                text,
                "           in standard frames {} becomes {}",
                numbers(before),
                numbers(after)
            );
        }
        for (k, column) in self.frame().to_cols_array_2d().into_iter().enumerate() {
            let axis = numbers(column.into());
            let _ = writeln!(text, "frame {}    becomes {axis}", k + 1);
        }
        match self.holonomy {
            Some(Holonomy {
                axis,
                angle,
                reflected,
            }) => {
                let reflects = match reflected {
                    true => "reflects in the point and ",
                    false => "",
                };
                let _ = writeln!(
                    text,
                    "holonomy   {reflects}turns by {angle:.12} ({:.9}°) about {} of the standard frame",
                    angle.to_degrees(),
                    numbers(axis)
                );
            }
            None => text += "the curve is open\n",
        }
        text
    }
}

/// Writes three numbers.
fn numbers(v: DVec3) -> String {
    // No negative zeros.
    let [x, y, z] = v.to_array().map(|x| x + 0.0);
    format!("({x:.12}, {y:.12}, {z:.12})")
}
