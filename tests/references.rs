//! The exact tracer against an independent program: `data/make_references.py` follows 300 geodesics
//! through the manifold files in 80-bit arithmetic, from formulas of its own.
//!
//! Distances are taken in the metric at the reference end point: a position's over the arc length,
//! a tangent's and a frame's as they are (angles), an area's relative to its size.

mod support;

use geofan_core::{
    geodesic::{End, JacobiField, Path, Ray, paths},
    manifold::Manifold,
};
use glam::{DMat3, DVec3};
use serde::Deserialize;
use std::{collections::BTreeMap, fmt};
use support::{asset, missed, settings, turned, worse};

const TOLERANCE: f64 = 1e-12;

/// What end points, tangents, frames and areas must agree to.
const AGREEMENT: f64 = 1e-8;

#[derive(Deserialize)]
struct Reference {
    manifold: String,
    start: DVec3,
    direction: DVec3,
    length: f64,
    end: DVec3,
    velocity: DVec3,
    frame: [DVec3; 3],
    area: f64,
}

/// The reference rays of each manifold file.
fn references() -> BTreeMap<String, Vec<Reference>> {
    let all: Vec<Reference> = serde_json::from_str(include_str!("data/references.json")).unwrap();
    let mut sorted = BTreeMap::<_, Vec<_>>::new();
    for reference in all {
        let rays = sorted.entry(reference.manifold.clone()).or_default();
        rays.push(reference);
    }
    sorted
}

fn follow(manifold: &Manifold, rays: impl IntoIterator<Item = Ray>) -> Vec<Path> {
    let paths = paths(manifold, settings(TOLERANCE, false), rays);
    assert!(paths.iter().all(|p| p.end == End::Length));
    paths
}

fn rays(manifold: &Manifold, references: &[Reference]) -> Vec<Ray> {
    let ray = |r: &Reference| Ray::new(manifold, r.start, r.direction, r.length);
    references.iter().map(ray).collect()
}

/// Discrepancies of one ray, or the largest of several.
#[derive(Default, Clone, Copy)]
struct Off {
    position: f64,
    tangent: f64,
    frame: f64,
    area: f64,
}

impl Off {
    fn of(manifold: &Manifold, path: &Path, reference: &Reference) -> Self {
        let s = path.length;
        let step = path.steps.last().unwrap();
        let (u, v) = (step.position(s), step.tangent(s));
        let inverse = manifold.standard_frame(reference.end).inverse();
        let frame = manifold.standard_frame(u) * DMat3::from_quat(step.rotation(s).unwrap());
        let frame_off = [0, 1, 2].map(|k| (inverse * (frame.col(k) - reference.frame[k])).length());
        let here = manifold.standard_frame(u).inverse();
        let area = JacobiField::new(here, v, step.deviation(s).unwrap()).signed_area();
        Self {
            position: (inverse * (u - reference.end)).length() / s,
            tangent: (inverse * (v - reference.velocity)).length(),
            frame: frame_off.into_iter().fold(0.0, worse),
            area: (area.abs() - reference.area).abs() / reference.area,
        }
    }

    fn larger(self, other: Self) -> Self {
        Self {
            position: worse(self.position, other.position),
            tangent: worse(self.tangent, other.tangent),
            frame: worse(self.frame, other.frame),
            area: worse(self.area, other.area),
        }
    }
}

impl fmt::Display for Off {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self {
            position,
            tangent,
            frame,
            area,
        } = self;
        write!(
            f,
            "position {position:.1e}  tangent {tangent:.1e}  frame {frame:.1e}  area {area:.1e}"
        )
    }
}

#[test]
fn every_manifold_agrees_with_the_independent_program() {
    let mut report = String::new();
    let mut wrong = 0;
    let references = references();
    assert_eq!(references.len(), 25);
    for (name, references) in &references {
        let manifold = asset(name);
        let paths = follow(&manifold, rays(&manifold, references));
        let off = paths.iter().zip(references);
        let off = off.map(|(path, reference)| Off::of(&manifold, path, reference));
        let worst = off.fold(Off::default(), Off::larger);
        let fine = [worst.position, worst.tangent, worst.frame, worst.area]
            .into_iter()
            .all(|x| x <= AGREEMENT);
        wrong += usize::from(!fine);
        report += &format!(
            "{name:22} {worst}{}\n",
            if fine { "" } else { "  <- wrong" }
        );
    }
    println!("{report}");
    assert_eq!(wrong, 0, "\n{report}");
}

#[test]
fn rays_turned_back_return_to_their_start() {
    let mut report = String::new();
    let mut worst_of_all = 0.0;
    for (name, references) in &references() {
        let manifold = asset(name);
        let there = rays(&manifold, references);
        let forth = follow(&manifold, there.iter().copied());
        let back = follow(&manifold, turned(&forth));
        let worst = missed(&manifold, &back, &there);
        report += &format!("{name:22} {worst:.1e}\n");
        worst_of_all = worse(worst_of_all, worst);
    }
    println!("{report}");
    assert!(worst_of_all <= AGREEMENT, "\n{report}");
}

#[test]
fn tangents_and_frames_keep_unit_length() {
    for (name, references) in &references() {
        let manifold = asset(name);
        for path in follow(&manifold, rays(&manifold, references)) {
            for step in &path.steps {
                let u = step.position(step.end);
                let (g, standard) = manifold.metric_and_frame(u);
                let v = step.tangent(step.end);
                let speed = v.dot(g * v).sqrt();
                assert!((speed - 1.0).abs() < 1e-13, "{name}: {speed}");
                let frame = standard * DMat3::from_quat(step.rotation(step.end).unwrap());
                let gram = frame.transpose() * g * frame - DMat3::IDENTITY;
                let off = gram
                    .to_cols_array()
                    .into_iter()
                    .map(f64::abs)
                    .fold(0.0, worse);
                assert!(off < 1e-12, "{name}: {off}");
            }
        }
    }
}
