//! What several tests need: the catalogue, manifolds from text, random rays.

// Each test uses a part of it.
#![allow(dead_code, unused_imports)]

mod by_table;
pub mod camera_scene;
mod film;
#[path = "../../crates/core/tests/support/mod.rs"]
mod manifolds;
mod place;
pub mod sampled;

pub use by_table::by_table;
pub use film::{film, mean};
pub use manifolds::{manifold, settings};
pub use place::Place;

use geofan_bundle::rays::Axis;
use geofan_core::{
    diagnostic::SourceText,
    geodesic::{Path, Ray, Settings, check_point},
    manifold::{Carried, Manifold},
    random::Stream,
};
use glam::DVec3;
use std::f64::consts::PI;

/// The names of all files of `assets/manifolds`.
pub fn catalogue() -> Vec<String> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds");
    let files = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = files
        .map(|file| file.unwrap().file_name().into_string().unwrap())
        .filter_map(|name| name.strip_suffix(".toml").map(String::from))
        .collect();
    names.sort();
    names
}

/// The text of a manifold of the catalogue.
pub fn catalogue_text(name: &str) -> String {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds");
    std::fs::read_to_string(format!("{folder}/{name}.toml")).unwrap()
}

/// A manifold of the catalogue.
pub fn asset(name: &str) -> Manifold {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds");
    let path = format!("{folder}/{name}.toml");
    Manifold::load(path.as_ref(), &[]).unwrap_or_else(|e| panic!("{}", e.report(false)))
}

/// A random point of the domain: a camera of the region moved by the manifold's symmetry, so that it
/// lies off every symmetry plane.
pub fn random_point(manifold: &Manifold, stream: &mut Stream) -> DVec3 {
    let region = manifold.cameras.as_ref().expect("a camera region");
    for _ in 0..1000 {
        let t = [stream.uniform(), stream.uniform(), stream.uniform()];
        let mut u = region.at(&region.lerp(&t[..region.dimension()]));
        if manifold.symmetry.rotation {
            u = stream.rotation() * u;
        }
        if let Some(axis) = manifold.symmetry.axis {
            u = Axis(axis).rotation(stream.between(-PI, PI)) * u;
        }
        for k in 0..3 {
            if manifold.symmetry.translation[k] || manifold.symmetry.group.is_some() {
                u[k] = stream.between(-1.0, 1.0);
            }
        }
        if check_point(manifold, "point", u).is_ok() {
            return u;
        }
    }
    panic!("{}: no point found", manifold.name)
}

/// The rays that go back along `paths` from their ends.
pub fn turned(paths: &[Path]) -> impl Iterator<Item = Ray> {
    paths.iter().map(|path| {
        let step = path.steps.last().unwrap();
        Ray {
            u: step.position(path.length),
            v: -step.tangent(path.length),
            length: path.length,
            spread: [DVec3::ZERO; 2],
        }
    })
}

/// How far the paths `back` miss the starts of the rays that went `there`: the largest distance over
/// arc length, or difference of tangents.
pub fn missed(manifold: &Manifold, back: &[Path], there: &[Ray]) -> f64 {
    let mut worst = 0.0;
    for (path, ray) in back.iter().zip(there) {
        let inverse = manifold.standard_frame(ray.u).inverse();
        let step = path.steps.last().unwrap();
        let point = inverse * (step.position(path.length) - ray.u);
        let tangent = inverse * (step.tangent(path.length) + ray.v);
        worst = worse(worst, point.length() / path.length);
        worst = worse(worst, tangent.length());
    }
    worst
}

/// The larger of two numbers; NaN is the largest.
pub fn worse(a: f64, b: f64) -> f64 {
    if a > b || a.is_nan() { a } else { b }
}
