//! A first scene for a bare manifold.
//!
//! In: a manifold and the length of paths. Out: the text of a scene file and its meshes, so that it is loaded
//! like any other: a camera in the manifold's region, the lettered grid and stars in its skies, and small globes
//! on a lattice of the chart, as large as a share of the length of paths, in the metric, everywhere.

use geofan_core::{
    Error, Result,
    document::quoted,
    geodesic::check_point,
    manifold::{EventKind, Manifold},
};
use geofan_render::{Curve, Ending, ExactTracer};
use glam::{DVec3, USizeVec3};
use std::{
    f64::consts::{PI, TAU},
    fmt::Write,
};

/// A scene made for a manifold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StartScene {
    /// The text of the scene file.
    pub text: String,
    /// Names, beside the scene file, and texts of its meshes and their materials.
    pub files: Vec<(String, String)>,
}

/// Radius of a globe: a share of the length of paths, and at most a share of the distance of two globes.
const RADIUS: [f64; 2] = [0.02, 0.15];

/// Share of the length of paths that the lattice reaches from the camera.
const REACH: f64 = 1.0 / 3.0;

/// Globes along each coordinate.
const SIDE: usize = 3;

/// Colours of the two materials of each kind of globe (the palette of M. Okabe and K. Ito, which colour-blind
/// people tell apart), linear.
const COLOURS: [[[f64; 3]; 2]; 3] = [
    [[0.79, 0.35, 0.0], [0.9, 0.9, 0.85]],
    [[0.09, 0.46, 0.82], [0.9, 0.9, 0.85]],
    [[0.0, 0.34, 0.17], [0.9, 0.9, 0.85]],
];

/// Circles of latitude and meridians of a globe.
const LATITUDES: usize = 12;
const MERIDIANS: usize = 24;

impl StartScene {
    /// Tells whether the text of a file is that of a manifold and not of a scene.
    pub fn is_manifold(text: &str) -> bool {
        let key = |line: &str| {
            line.split_once('=')
                .map(|(key, _)| key.trim() == "coordinates")
        };
        text.lines().any(|line| key(line) == Some(true))
    }

    /// Makes the scene; `file` is the name of the manifold's file beside the scene's.
    ///
    /// # Errors
    /// No place for a camera is found.
    pub fn new(manifold: &Manifold, file: &str, length: f64) -> Result<Self> {
        let camera = camera_place(manifold, length).ok_or_else(|| {
            let message =
                "no place for a camera was found; say where cameras may be under [cameras]";
            Error::input(manifold.source.name.clone(), message)
        })?;
        let (look, up) = line_of_sight(manifold, camera);
        let mut text = format!(
            "manifold = {}\n[camera]\nat = {:?}\n",
            quoted(file),
            camera.to_array()
        );
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "look = {:?}\nup = {:?}",
            look.to_array(),
            up.to_array()
        );
        for (kind, at, radius) in globes(manifold, camera, length) {
            let (name, at) = (mesh_name(kind), at.to_array());
            let _ = writeln!(
                text,
                "[[object]]\nmesh = {name:?}\nat = {at:?}\nscale = {radius:?}"
            );
        }
        let _ = writeln!(text, "[sky]\nlength = {{ color = [0.02, 0.02, 0.03] }}");
        for (k, exit) in manifold.exits.iter().enumerate() {
            let sky = match (exit.name.as_str(), k % 2) {
                ("inside", _) => "{ color = [0, 0, 0] }",
                ("limit", _) | (_, 0) => "{ pattern = \"grid\" }",
                _ => "{ pattern = \"stars\" }",
            };
            let _ = writeln!(text, "{} = {sky}", quoted(&exit.name));
        }
        let meshes = (0..COLOURS.len()).map(|kind| (mesh_name(kind), globe(kind)));
        let materials = (MATERIALS.to_string(), materials());
        Ok(Self {
            text,
            files: meshes.chain([materials]).collect(),
        })
    }
}

const MATERIALS: &str = "geofan-globes.mtl";

fn mesh_name(kind: usize) -> String {
    format!("geofan-globe-{kind}.obj")
}

/// Tells whether something can be at `u`: in the domain, and before every exit.
fn is_free(manifold: &Manifold, u: DVec3) -> bool {
    let values = manifold.domain.events().at(&[u.x, u.y, u.z, 0.0, 0.0, 0.0]);
    let mut events = manifold.domain.kinds.iter().zip(values);
    let out = events.any(|(kind, value)| matches!(kind, EventKind::Exit(_)) && !(value < 0.0));
    !out && check_point(manifold, "globe", u).is_ok()
}

/// Finds a place for the camera: in the region towards its end, where most is in front; else in the middle of
/// the chart's limits or around its origin, as near to these as there is room for paths of this `length`.
fn camera_place(manifold: &Manifold, length: f64) -> Option<DVec3> {
    let region = manifold.cameras.iter();
    let mut region =
        region.flat_map(|region| [0.8, 0.6, 0.5, 0.3].map(|t| region.at(&region.lerp(&[t; 3]))));
    if let Some(place) = region.find(|u| is_free(manifold, *u)) {
        return Some(place);
    }
    let middle = DVec3::from_array([0, 1, 2].map(|k| match manifold.domain.limits[k] {
        Some([low, high]) if low.is_finite() && high.is_finite() => 0.5 * (low + high),
        _ => 0.0,
    }));
    // Off every plane of symmetry, farther and farther away.
    let around = [0.0, 0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0];
    let around = around.map(|r| middle + DVec3::new(0.8, 0.5, 0.3) * r);
    let free = around.into_iter().filter(|u| is_free(manifold, *u));
    let rooms: Vec<(DVec3, f64)> = free.map(|u| (u, room(manifold, u, length))).collect();
    let largest = rooms
        .iter()
        .fold(0.0, |most: f64, (_, room)| most.max(*room));
    let mut roomy = rooms.iter().filter(|(_, room)| *room >= ROOMY * largest);
    roomy.next().map(|(u, _)| *u)
}

/// Share of the largest room that is enough.
const ROOMY: f64 = 0.7;

/// Returns how far paths from `u` get along the axes on both sides, all together; each at most `length`.
fn room(manifold: &Manifold, u: DVec3, length: f64) -> f64 {
    let curves = along_axes(manifold, u, length);
    let ended = |curve: &Curve| {
        let last = curve.s.last().copied().unwrap_or(0.0);
        curve.ending.limit().min(last)
    };
    curves.iter().map(ended).sum()
}

/// Follows the geodesics from `u` along the axes, on both sides, over `length`.
fn along_axes(manifold: &Manifold, u: DVec3, length: f64) -> Vec<Curve> {
    let axes = DVec3::AXES.into_iter().chain(DVec3::AXES.map(|axis| -axis));
    let tracer = ExactTracer::new(manifold, u, length, 1e-6);
    tracer.trace(&axes.collect::<Vec<_>>())
}

/// Returns where the camera looks, towards the middle of its region or the chart's origin, and which way is up;
/// in the standard frame.
fn line_of_sight(manifold: &Manifold, camera: DVec3) -> (DVec3, DVec3) {
    let middle = manifold
        .cameras
        .as_ref()
        .map(|region| region.at(&region.lerp(&[0.5; 3])));
    let inverse = manifold.standard_frame(camera).inverse();
    let towards = |target: DVec3| (inverse * (target - camera)).try_normalize();
    let look = middle.and_then(towards).or_else(|| towards(DVec3::ZERO));
    let look = look.filter(|look| look.is_finite()).unwrap_or(DVec3::X);
    let up = if look.z.abs() < 0.9 {
        DVec3::Z
    } else {
        DVec3::Y
    };
    (look, up)
}

/// Places globes: their kinds, places and radii.
fn globes(manifold: &Manifold, camera: DVec3, length: f64) -> Vec<(usize, DVec3, f64)> {
    let (low, high) = reach(manifold, camera, REACH * length);
    let spacing = (high - low) / SIDE as f64;
    let (mut globes, mut largest) = (Vec::new(), 0.0);
    for i in 0..SIDE * SIDE * SIDE {
        let cell = USizeVec3::new(i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE));
        let at = low + (cell.as_dvec3() + 0.5) * spacing;
        if !is_free(manifold, at) {
            continue;
        }
        let metric = manifold.metric(at);
        let apart = (0..3).map(|k| spacing[k].abs() * metric.col(k)[k].sqrt());
        let radius = (RADIUS[0] * length).min(RADIUS[1] * apart.fold(f64::INFINITY, f64::min));
        let way = manifold.standard_frame(camera).inverse() * (at - camera);
        if radius.is_finite() && radius > 1e-6 * length && way.length() > 3.0 * radius {
            globes.push(((cell.x + cell.y + cell.z) % COLOURS.len(), at, radius));
            largest = f64::max(largest, radius / way.length());
        }
    }
    if largest < SMALL {
        globes.extend(near_globes(manifold, camera, length));
    }
    globes
}

/// Angle (radians) below which no globe of the lattice is large enough: the chart is far from even there.
const SMALL: f64 = 0.02;

/// Share of the length of paths at which globes are placed along geodesics then.
const NEAR: f64 = 0.125;

/// Places globes at the ends of geodesics from the camera into the eight octants.
fn near_globes(manifold: &Manifold, camera: DVec3, length: f64) -> Vec<(usize, DVec3, f64)> {
    let sides = |i: usize| [i & 1, i >> 1 & 1, i >> 2 & 1].map(|bit| 2.0 * bit as f64 - 1.0);
    let directions: Vec<DVec3> = (0..8).map(|i| DVec3::from(sides(i)).normalize()).collect();
    let tracer = ExactTracer::new(manifold, camera, NEAR * length, 1e-6);
    let curves = tracer.trace(&directions).into_iter().enumerate();
    let placed = curves.filter_map(|(i, curve)| {
        let arrives = matches!(curve.ending, Ending::Length);
        let at = curve.u.last().copied().filter(|_| arrives)?;
        is_free(manifold, at).then_some((i % COLOURS.len(), at, RADIUS[0] * length))
    });
    placed.collect()
}

/// Returns the corners of the box of the chart that geodesics along the axes reach from `camera`, within the
/// chart's limits.
fn reach(manifold: &Manifold, camera: DVec3, length: f64) -> (DVec3, DVec3) {
    let mut corners = (camera, camera);
    for curve in along_axes(manifold, camera, length) {
        for u in curve.u.iter().filter(|u| u.is_finite()) {
            corners = (corners.0.min(*u), corners.1.max(*u));
        }
    }
    for k in 0..3 {
        if let Some([low, high]) = manifold.domain.limits[k] {
            corners.0[k] = corners.0[k].clamp(low, high);
            corners.1[k] = corners.1[k].clamp(low, high);
        }
    }
    corners
}

/// Writes a globe of radius 1 with fields of two colours.
fn globe(kind: usize) -> String {
    let mut text = format!("mtllib {MATERIALS}\n");
    for i in 0..=LATITUDES {
        let latitude = PI * (i as f64 / LATITUDES as f64 - 0.5);
        for j in 0..MERIDIANS {
            let longitude = TAU * j as f64 / MERIDIANS as f64;
            let (x, y) = (
                latitude.cos() * longitude.cos(),
                latitude.cos() * longitude.sin(),
            );
            let z = latitude.sin();
            let _ = writeln!(text, "v {x:.6} {y:.6} {z:.6}\nvn {x:.6} {y:.6} {z:.6}");
        }
    }
    for field in 0..2 {
        let _ = writeln!(text, "usemtl globe-{kind}-{field}");
        let cells = (0..LATITUDES).flat_map(|i| (0..MERIDIANS).map(move |j| (i, j)));
        for (i, j) in cells.filter(|(i, j)| (i / 2 + j / 3) % 2 == field) {
            let corner = |i: usize, j: usize| {
                let n = i * MERIDIANS + j % MERIDIANS + 1;
                format!("{n}//{n}")
            };
            let [a, b, c, d] =
                [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)].map(|(i, j)| corner(i, j));
            // At the poles one side of a field has no length.
            if i > 0 {
                let _ = writeln!(text, "f {a} {b} {c}");
            }
            if i + 1 < LATITUDES {
                let _ = writeln!(text, "f {a} {c} {d}");
            }
        }
    }
    text
}

fn materials() -> String {
    let mut text = String::new();
    for (kind, fields) in COLOURS.iter().enumerate() {
        for (field, [r, g, b]) in fields.iter().enumerate() {
            let _ = writeln!(text, "newmtl globe-{kind}-{field}\nKd {r} {g} {b}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::tests::start_stage;
    use geofan_core::diagnostic::SourceText;
    use std::{fs, sync::Arc};

    #[test]
    fn every_manifold_of_the_catalogue_has_a_first_scene_with_globes_that_loads() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/manifolds");
        let mut count = 0;
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let text = fs::read_to_string(&path).unwrap();
            assert!(StartScene::is_manifold(&text), "{}", path.display());
            let source = SourceText::new(path.display().to_string(), text);
            let manifold = Arc::new(Manifold::from_source(source, &[]).unwrap());
            let length = manifold.length.unwrap_or(10.0);
            let stage = start_stage(&manifold, length);
            assert!(
                !stage.scene.objects.is_empty(),
                "{}: no globes",
                path.display()
            );
            assert!(!stage.world.faces.is_empty());
            count += 1;
        }
        assert!(count > 20);
        assert!(!StartScene::is_manifold(
            "manifold = \"../manifolds/coordinates.toml\"\n"
        ));
    }

    #[test]
    fn the_first_camera_has_room_around_it() {
        let text = "name = 'half'\ncoordinates = ['x', 'y', 'z']\nmetric = { xx = '1/y^2', yy = '1/y^2', zz = '1/y^2' }\n[domain]\ninside = ['y - 0.01']\n";
        let manifold = Manifold::from_source(SourceText::new("half.toml", text), &[]).unwrap();
        let place = camera_place(&manifold, 10.0).unwrap();
        // The edge is log(y/0.01) away.
        assert!(place.y > 0.5, "{place}");
        // The lattice of the chart is far above.
        let globes = globes(&manifold, place, 10.0);
        assert!(
            globes
                .iter()
                .filter(|(_, _, radius)| *radius == 0.2)
                .count()
                >= 8
        );
    }
}
