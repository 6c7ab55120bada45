//! The steps of a frame, one by one: contract, lattice, tiles, pixels, shade; and whole frames.
//!
//! In: a bundle of the Ellis wormhole, `demo/ellis-wormhole.fan` as `geofan-bake demo` leaves it, and the wormhole
//! gallery; or the files that `GEOFAN_BENCH_BUNDLE` and `GEOFAN_BENCH_SCENE` name. Without a bundle there is nothing
//! to measure. Each step works on one thread on the whole picture of 640 × 360 pixels.

use criterion::{Criterion, criterion_group, criterion_main};
use geofan_bundle::Bundle;
use geofan_render::{
    EventLocator, GridTracer, Lookup, PathBatch, Stage, TileScratch,
    drawing::draw,
    frame::{Paths, offsets, trace},
    lattice::{Divided, LARGEST_TILE, Lattice, smallest_tile},
    no_clock,
    shade::{Footprints, shade},
    tiles::{PixelSamples, TileOutcomes},
};
use std::{hint::black_box, path::PathBuf};

const SIZE: (usize, usize) = (640, 360);

/// The default lattice budget, radians.
const BUDGET: f64 = 5e-4;

/// The default tolerance of the exact tracer.
const TOLERANCE: f64 = 1e-8;

/// Returns the file that an environment variable names, or else `usual`.
fn file(variable: &str, usual: &str) -> PathBuf {
    std::env::var_os(variable).map_or_else(|| PathBuf::from(usual), PathBuf::from)
}

fn bundle() -> Option<Bundle> {
    Bundle::read(&file("GEOFAN_BENCH_BUNDLE", "demo/ellis-wormhole.fan"))
        .map_err(|e| eprintln!("nothing measured: {e}"))
        .ok()
}

fn steps(criterion: &mut Criterion) {
    let Some(bundle) = bundle() else { return };
    let scene = file("GEOFAN_BENCH_SCENE", "assets/scenes/wormhole-gallery.toml");
    let stage = Stage::load(&scene, &[]).expect("the scene of the repository");
    let (world, camera) = (&stage.world, &stage.scene.camera);
    let view = stage.view(camera, SIZE).expect("a camera in the domain");
    let lookup = Lookup::new(&bundle.table, bundle.promise(), TOLERANCE);
    let fan = bundle.table.fan(view.u).expect("a camera in the table");
    let tracer = lookup.tracer(&fan);
    let offsets = offsets(1);
    let lattice = Lattice {
        tracer: &tracer,
        world,
        view: &view,
        budget: BUDGET,
        smallest: smallest_tile(1),
    };
    let samples = PixelSamples {
        world,
        view: &view,
        offsets: &offsets,
        clock: &no_clock,
    };
    let corners: Vec<(usize, usize)> = (0..SIZE.1)
        .step_by(LARGEST_TILE)
        .flat_map(|y| (0..SIZE.0).step_by(LARGEST_TILE).map(move |x| (x, y)))
        .collect();
    let refine = || -> Vec<Divided> {
        let mut endings = EventLocator::new(&world.manifold);
        corners
            .iter()
            .map(|corner| {
                let mut undivided = lattice.undivided(*corner);
                let spare = PathBatch::new(tracer.knots().clone());
                let divided = lattice.refine(&mut undivided, spare, &mut endings);
                assert!(undivided.is_empty(), "few paths at one sample a pixel");
                divided
            })
            .collect()
    };
    let divided = refine();
    let mut traced = trace(world, &view, Paths::Lattice(&tracer, BUDGET), &offsets);

    let mut group = criterion.benchmark_group("frame");
    group.sample_size(20);
    group.bench_function("contract", |b| {
        b.iter(|| black_box(bundle.table.fan(view.u)))
    });
    group.bench_function("lattice", |b| b.iter(|| black_box(refine())));
    group.bench_function("tiles", |b| {
        b.iter(|| {
            for divided in &divided {
                for leaf in &divided.leaves {
                    let patch = divided.patch(leaf);
                    black_box(samples.flatten(&tracer, divided, (leaf, &patch)));
                }
            }
        });
    });
    group.bench_function("pixels", |b| {
        let mut scratch = TileScratch::new(&world.manifold, tracer.knots());
        b.iter(|| {
            let mut tiles = TileOutcomes::split(&mut traced.outcomes);
            for (divided, tile) in divided.iter().zip(&mut tiles) {
                samples.interpolate(divided, &tracer, &mut scratch, tile);
            }
        });
    });
    let outcomes = trace(world, &view, Paths::Lattice(&tracer, BUDGET), &offsets).outcomes;
    group.bench_function("shade", |b| {
        b.iter(|| {
            black_box(shade(
                world,
                &view,
                outcomes.view(),
                1,
                Footprints::Filtered,
            ))
        });
    });
    group.bench_function("whole", |b| {
        b.iter(|| {
            let fan = bundle.table.fan(view.u).expect("a camera in the table");
            let tracer = lookup.tracer(&fan);
            let paths = Paths::Lattice(&tracer, BUDGET);
            black_box(draw(world, &view, paths, 1, Footprints::Filtered, &no_clock).picture)
        });
    });
    group.finish();
}

criterion_group!(benches, steps);
criterion_main!(benches);
