//! Tables and their lattice against exact paths, through every projection.

mod support;

use geofan_bundle::Bundle;
use geofan_core::quantiles::Quantiles;
use geofan_render::{
    ExactTracer, Lookup, PicturePanel, Seen, ShiftedTracer, Stage,
    frame::{Outcomes, Paths, offsets, trace},
};
use geofan_study::comparison::{CompareOptions, Comparison, compare};
use glam::DVec3;
use std::f64::consts::{PI, TAU};
use support::Place;

/// A wormhole whose cameras may be anywhere between two radii.
const WORMHOLE: &str = r#"
name = "wormhole"
coordinates = ["x", "y", "z"]
metric = { conformal = "1 + 1/(4*rho^2)" }
[let]
rho = "sqrt(x^2 + y^2 + z^2)"
l = "rho - 1/(4*rho)"
[domain]
inside = ["rho - 0.02"]
[[exit]]
name = "near"
when = "l - 6"
[[exit]]
name = "far"
when = "-6 - l"
[symmetry]
rotation = "origin"
[cameras]
parameters = { c = [1.6, 1.8] }
at = ["c", "0", "0"]
length = 12.0
"#;

const SQUARE: &str = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n";

fn scene(camera: &str) -> String {
    format!(
        "manifold = 'wormhole.toml'\n[camera]\nat = [1.6, 0.4, -0.3]\nlook = [-1, 0.1, 0.2]\nup = [0, 0, 1]\n{camera}\n\
         [[object]]\nmesh = 'square.obj'\nat = [1.0, 0.9, 0.2]\nscale = 0.3\n\
         [sky]\nnear = {{ pattern = 'grid' }}\nfar = {{ pattern = 'grid' }}\n"
    )
}

#[test]
fn tables_agree_with_exact_paths_in_all_projections_as_in_perspective() {
    let place = Place::with(&[("wormhole.toml", WORMHOLE), ("square.obj", SQUARE)]);
    place
        .bake("wormhole.toml -o w.fan --max-error 0.5 --quiet")
        .success();
    let bundle = Bundle::read(&place.path("w.fan")).unwrap();
    let options = CompareOptions {
        samples: 1,
        promise: 0.5,
        error: 0.5,
        tolerance: 1e-8,
        frames: 1,
    };
    let cameras = [
        ("fov = 90", (192, 128)),
        ("projection = 'panorama'", (384, 192)),
        ("projection = 'fisheye'", (192, 192)),
        ("projection = 'fisheye'\nfov = 360", (192, 192)),
        ("projection = 'cube'", (576, 384)),
        (
            "stereo = { separation = 0.1, convergence = 1.0 }",
            (256, 96),
        ),
    ];
    let mut perspective = None;
    for (camera, size) in cameras {
        std::fs::write(place.path("scene.toml"), scene(camera)).unwrap();
        let stage = Stage::load(&place.path("scene.toml"), &[]).unwrap();
        let panels = stage.panels(&stage.scene.camera, size, None).unwrap();
        assert!(panels.parts.iter().all(|panel| panel.view.is_central()));
        for panel in panels.parts {
            let Comparison { report, .. } =
                compare(&stage.world, &panel.view, &bundle.table, options).unwrap();
            let [lattice, screen] = [
                report.lattice_errors.lattice_mrad.p99,
                report.screen_mrad.unwrap().p99,
            ];
            println!(
                "{camera}: lattice {lattice:.3}, screen {screen:.3}, FLIP {:.5}",
                report.flip
            );
            let (most_lattice, most_flip) = *perspective.get_or_insert((lattice, report.flip));
            assert!(screen < 1.0, "{camera}: {screen}");
            assert!(
                lattice < f64::max(0.5, 1.5 * most_lattice),
                "{camera}: {lattice}"
            );
            assert!(
                report.flip < f64::max(0.005, 2.0 * most_flip),
                "{camera}: {}",
                report.flip
            );
        }
    }
}

/// Exit or triangle.
fn kind(seen: &Seen) -> (u8, u32) {
    match seen {
        Seen::Sky { exit, .. } => (0, *exit),
        Seen::Surface(hit) => (1, hit.triangle),
        Seen::Nothing | Seen::Length | Seen::Singular => (2, 0),
    }
}

/// Finds by how many pixels skies are off: by how much as by the next pixel.
fn pixels_off(found: &Outcomes, exact: &Outcomes) -> Vec<f64> {
    let sky = |at: (usize, usize, usize), like: &Seen| match exact.get(at) {
        Some(seen @ Seen::Sky { direction, .. }) if kind(seen) == kind(like) => Some(*direction),
        _ => None,
    };
    let off = |((y, x, k), a): ((usize, usize, usize), &Seen)| {
        let Seen::Sky { direction, .. } = a else {
            return None;
        };
        let here = sky((y, x, k), a)?;
        let pixel =
            [(y, x + 1, k), (y + 1, x, k)].map(|next| Some((sky(next, a)? - here).length()));
        let pixel = f32::max(pixel[0]?, pixel[1]?);
        Some(f64::from((*direction - here).length() / pixel))
    };
    found.indexed_iter().filter_map(off).collect()
}

#[test]
fn rays_that_start_beside_the_camera_are_looked_up_where_they_start() {
    let place = Place::with(&[("wormhole.toml", WORMHOLE), ("square.obj", SQUARE)]);
    place
        .bake("wormhole.toml -o w.fan --max-error 0.5 --quiet")
        .success();
    let bundle = Bundle::read(&place.path("w.fan")).unwrap();
    let lookup = Lookup::new(&bundle.table, 5e-4, 1e-8);
    // A promise of half a mrad at a distance of 2 is an eighth of a pixel of the one, and a hundredth of
    // one of the other.
    for (camera, size, within) in [
        ("projection = 'orthographic'\nwidth = 0.5", (64, 64), 0.125),
        (
            "projection = 'panorama'\nstereo = { separation = 0.1, layout = 'over-under' }",
            (128, 128),
            0.01,
        ),
    ] {
        std::fs::write(place.path("scene.toml"), scene(camera)).unwrap();
        let stage = Stage::load(&place.path("scene.toml"), &[]).unwrap();
        let panels = stage.panels(&stage.scene.camera, size, None).unwrap();
        assert!(!panels.parts.iter().all(|panel| panel.view.is_central()));
        for PicturePanel { view, .. } in panels.parts {
            let tracer = ShiftedTracer::new(&lookup, &view);
            let by = |paths| trace(&stage.world, &view, paths, &offsets(1));
            let table = by(Paths::Lattice(&tracer, 5e-4));
            let manifold = &stage.world.manifold;
            let exact = ExactTracer::new(manifold, view.u, bundle.table.length, 1e-8);
            let exact = by(Paths::Exact(&exact));
            let unlike = table.outcomes.iter().zip(&exact.outcomes);
            let unlike = unlike.filter(|(a, b)| kind(a) != kind(b)).count();
            let quantiles = Quantiles::of(&mut pixels_off(&table.outcomes, &exact.outcomes));
            let flagged = table.flagged.len();
            println!("{camera}: {unlike} unlike, {flagged} integrated, {quantiles:?}");
            // Most by the table.
            assert!(flagged < table.outcomes.len() / 10);
            assert!(unlike < table.outcomes.len() / 100);
            assert!(
                quantiles.p50 < within && quantiles.p95 < 4.0 * within,
                "{camera}: {quantiles:?}"
            );
            // Other numbers of a frame cannot be told of them.
            let options = CompareOptions {
                samples: 1,
                promise: 0.5,
                error: 0.5,
                tolerance: 1e-8,
                frames: 1,
            };
            let refused = compare(&stage.world, &view, &bundle.table, options);
            let failure = refused.err().expect("refused").to_string();
            assert!(failure.contains("position of its own"), "{failure}");
        }
    }
}

/// Space that is periodic in x, with cameras on both sides of the seam.
const SEAM: &str = r#"
name = "seam"
coordinates = ["x", "y", "z"]
metric = { conformal = "1 + 0.2*cos(x)*exp(-y^2)" }
domain = { x = [0, 6.283185307179586], periodic = ["x"] }
exit = [{ name = "over", when = "y - 3" }, { name = "under", when = "-3 - y" }]
[cameras]
parameters = { c = [-0.5, 0.5] }
at = ["c", "0.3*c", "0.1"]
length = 8.0
"#;

#[test]
fn a_place_has_a_table_by_both_of_its_coordinates() {
    let place = Place::with(&[("seam.toml", SEAM)]);
    place.bake("seam.toml -o seam.fan --max-error 2 --certify-rays 500 --quiet");
    let bundle = Bundle::read(&place.path("seam.fan")).unwrap();
    let period = DVec3::X * TAU;
    for c in [-0.5, -0.23, -1e-9, 0.2] {
        let u = DVec3::new(c, 0.3 * c, 0.1);
        let d = DVec3::new(0.3, 0.8, -0.4).normalize();
        let at = |u: DVec3| bundle.fan(u).unwrap().path(d).at(2.5).unwrap();
        for other in [u + period, u - period] {
            let (found, expected) = (at(other), at(u));
            // From where it was asked for.
            assert!(
                (found.0 - other - (expected.0 - u)).length() < 1e-12,
                "{c}: {found:?} {expected:?}"
            );
            assert!((found.1 - expected.1).length() < 1e-12);
        }
    }
    let outside = DVec3::new(PI, 0.3, 0.1);
    assert!(bundle.fan(outside).is_err());
}
