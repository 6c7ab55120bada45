//! Rays per second on one thread: the tracer beside its rivals, in one run.
//!
//! `cargo bench --bench throughput`. Every case traces the same number of random rays, so criterion's
//! `elem/s` are rays a second. Before the times, the errors of both sides are held against a much
//! tighter run: a time counts only at equal accuracy.

mod rival;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use geofan_core::{
    geodesic::{Ray, Settings, ends, fixed_steps, paths},
    manifold::{Carried, Manifold},
    quantiles::Quantiles,
    random::Stream,
};
use glam::DVec3;
use rival::{Bump, Limits};
use std::hint::black_box;

const RAYS: u64 = 2048;

/// The path of the bump's rays: from the middle of the bump until space is flat.
const LENGTH: f64 = 9.0;

const HEIGHT: f64 = 2.0;

fn load(name: &str, settings: &[(String, f64)]) -> Manifold {
    let path = format!(
        "{}/assets/manifolds/{name}.toml",
        env!("CARGO_MANIFEST_DIR")
    );
    Manifold::load(path.as_ref(), settings).unwrap_or_else(|e| panic!("{}", e.report(false)))
}

fn bump() -> Manifold {
    load("gaussian-bump", &[("H".into(), HEIGHT)])
}

/// Rays from random points of a box around the bump, in random directions.
fn bump_rays(manifold: &Manifold) -> Vec<Ray> {
    let mut random = Stream::new(&[1]);
    let mut ray = |_| {
        let u = [0; 3].map(|_| random.between(-2.0, 2.0));
        Ray::new(manifold, u.into(), random.direction(), LENGTH)
    };
    (0..RAYS).map(&mut ray).collect()
}

/// Rays from one point in random directions.
fn fan_rays(manifold: &Manifold, u: DVec3, length: f64) -> Vec<Ray> {
    let mut random = Stream::new(&[2]);
    let mut ray = |_| Ray::new(manifold, u, random.direction(), length);
    (0..RAYS).map(&mut ray).collect()
}

fn settings(tolerance: f64, frame: bool, events: bool) -> Settings {
    let carried = Carried {
        frame,
        deviation: false,
    };
    Settings {
        tolerance,
        carried,
        events,
    }
}

fn points(manifold: &Manifold, tolerance: f64, rays: &[Ray]) -> Vec<DVec3> {
    let ends = ends(
        manifold,
        settings(tolerance, false, false),
        rays.iter().copied(),
    );
    let point = |end: Option<_>| {
        let (step, s): (geofan_core::geodesic::Step, f64) = end.expect("the ray moves");
        step.position(s)
    };
    ends.into_iter().map(point).collect()
}

fn rival_point(limits: Limits, ray: &Ray, tolerance: f64) -> DVec3 {
    let bump = Bump {
        height: HEIGHT,
        limits,
    };
    let start = [ray.u, ray.v].map(|x| x.to_array()).concat();
    let start = start.try_into().expect("six numbers");
    let [x, y, z, ..] = bump.follow(start, ray.length, tolerance).0;
    DVec3::new(x, y, z)
}

fn errors(points: impl IntoIterator<Item = DVec3>, truth: &[DVec3]) -> Quantiles {
    let off = points.into_iter().zip(truth);
    let mut errors: Vec<f64> = off.map(|(p, t)| (p - *t).length() / LENGTH).collect();
    Quantiles::of(&mut errors)
}

/// A single bump as an expression file, end points only, against the same by hand.
fn against_scalar_code(criterion: &mut Criterion) {
    let manifold = bump();
    let rays = bump_rays(&manifold);
    let truth = points(&manifold, 1e-12, &rays);
    let mut group = criterion.benchmark_group("bump, end points");
    group.throughput(Throughput::Elements(RAYS));
    for tolerance in [1e-6, 1e-8] {
        let ours = errors(points(&manifold, tolerance, &rays), &truth);
        println!("geofan {tolerance:.0e}: {ours:?}");
        group.bench_function(BenchmarkId::new("geofan", tolerance), |b| {
            b.iter(|| {
                let rays = rays.iter().copied();
                ends(&manifold, settings(tolerance, false, false), rays)
            });
        });
        for (name, limits) in [
            ("scalar, the same limits", Limits::Tracers),
            ("scalar, no limits", Limits::None),
        ] {
            let points = rays.iter().map(|r| rival_point(limits, r, tolerance));
            let theirs = errors(points, &truth);
            println!("{name} {tolerance:.0e}: {theirs:?}");
            assert!(
                ours.p50 < 2.0 * theirs.p50 && ours.p99 < 1.5 * theirs.p99,
                "{ours:?} is not as exact as {theirs:?}"
            );
            group.bench_function(BenchmarkId::new(name, tolerance), |b| {
                b.iter(|| {
                    for ray in &rays {
                        black_box(rival_point(limits, ray, tolerance));
                    }
                });
            });
        }
    }
    group.finish();
}

/// What renderers and tables ask for: whole paths and frames at a tight tolerance, with exits.
fn tight_paths(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("tolerance 1e-8");
    group.throughput(Throughput::Elements(RAYS));
    let bump = bump();
    let rays = bump_rays(&bump);
    let framed = settings(1e-8, true, false);
    group.bench_function("bump, frame", |b| {
        b.iter(|| ends(&bump, framed, rays.iter().copied()));
    });
    for (name, u) in [("ellis-wormhole", 6.0), ("schwarzschild", 9.0)] {
        let manifold = load(name, &[]);
        let rays = fan_rays(&manifold, DVec3::new(u, 0.5, 0.3), 24.0);
        let settings = settings(1e-8, false, true);
        group.bench_function(BenchmarkId::new(name, "end points"), |b| {
            b.iter(|| ends(&manifold, settings, rays.iter().copied()));
        });
        group.bench_function(BenchmarkId::new(name, "paths"), |b| {
            b.iter(|| paths(&manifold, settings, rays.iter().copied()));
        });
    }
    group.finish();
}

/// The quick integrator that a table must beat at equal error.
fn equal_steps(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("three bumps, 24 equal steps");
    group.throughput(Throughput::Elements(RAYS));
    let manifold = load("three-bumps", &[]);
    let rays = fan_rays(&manifold, DVec3::new(2.0, 0.5, 0.3), LENGTH);
    let starts: Vec<(DVec3, DVec3)> = rays.iter().map(|r| (r.u, r.v)).collect();
    group.bench_function("single precision", |b| {
        b.iter(|| fixed_steps::<f32>(&manifold, &starts, LENGTH, 24));
    });
    group.bench_function("double precision", |b| {
        b.iter(|| fixed_steps::<f64>(&manifold, &starts, LENGTH, 24));
    });
    group.finish();
}

criterion_group!(benches, against_scalar_code, tight_paths, equal_steps);
criterion_main!(benches);
