//! Exits that paths meet only briefly, between the places where they are looked at: by exact paths, in pictures by tables
//! and in certificates. What is expected are closed formulas in flat space, and exact paths elsewhere.

mod support;

use geofan_bake::certify;
use geofan_bundle::Bundle;
use geofan_core::{
    diagnostic::SourceText,
    geodesic::{End, Ray, Settings, ends_alone, paths},
    manifold::Manifold,
};
use geofan_render::{
    ExactTracer, Seen, Stage, View,
    frame::{Outcomes, Paths, offsets, trace},
};
use glam::DVec3;
use std::fs;
use support::{Place, by_table, catalogue_text};

const TEAPOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/meshes/teapot.obj");

/// A ball in flat space that is an exit, a hundredth of the length of paths large.
fn ball(radius: f64) -> String {
    format!(
        r#"name = "a ball in flat space"
coordinates = ["x", "y", "z"]
metric = {{ conformal = "1" }}
[[exit]]
name = "sky"
when = "x^2 + y^2 + z^2 - 400"
[[exit]]
name = "ball"
when = "{radius} - sqrt(x^2 + y^2 + z^2)"
[symmetry]
rotation = "origin"
[cameras]
parameters = {{ c = [2.0, 10.0] }}
at = ["c", "0", "0"]
length = 40.0
"#
    )
}

/// A scene with its table, and the view of a camera.
struct Pictured {
    stage: Stage,
    view: View,
    bundle: Bundle,
}

impl Pictured {
    /// Bakes `manifold` to 3 mrad and looks at it from `camera`.
    fn of(manifold: &str, camera: &str, size: (usize, usize)) -> Self {
        let scene = format!("manifold = 'space.toml'\n[camera]\n{camera}\n");
        let place = Place::with(&[
            ("space.toml", manifold),
            ("scene.toml", &scene),
            ("teapot.obj", &fs::read_to_string(TEAPOT).unwrap()),
        ]);
        let flags = "--max-error 3 --certify-rays 1000 --quiet";
        place.bake(&format!("space.toml -o table.fan {flags}"));
        let stage = Stage::load(&place.path("scene.toml"), &[]).unwrap();
        let view = stage.view(&stage.scene.camera, size).unwrap();
        let bundle = Bundle::read(&place.path("table.fan")).unwrap();
        Self {
            stage,
            view,
            bundle,
        }
    }

    /// What is seen by exact paths, and by the table.
    fn both(&self) -> [Outcomes; 2] {
        let world = &self.stage.world;
        let length = self.bundle.table.length;
        let tracer = ExactTracer::new(&world.manifold, self.view.u, length, 1e-9);
        let exact = trace(world, &self.view, Paths::Exact(&tracer), &offsets(1)).outcomes;
        [exact, by_table(&self.stage, &self.view, &self.bundle, 3e-3)]
    }
}

/// Counts the samples of each of two pictures that `is_it`.
fn counts(both: &[Outcomes; 2], is_it: impl Fn(&Seen) -> bool) -> [usize; 2] {
    both.each_ref()
        .map(|outcomes| outcomes.iter().filter(|seen| is_it(seen)).count())
}

#[test]
fn exact_paths_meet_balls_however_small() {
    let from = DVec3::new(3.1, 0.4, -0.2);
    for radius in [0.5, 0.03, 1e-3] {
        let source = SourceText::new("ball.toml", ball(radius));
        let space = Manifold::from_source(source, &[]).unwrap();
        let aside = from.cross(DVec3::new(0.2, -0.7, 0.4)).normalize();
        // So far from the middle, in radii.
        for share in [0.0, 0.5, 0.97, 1.03] {
            let sine = share * radius / from.length();
            let direction = aside * sine - from.normalize() * (1.0 - sine * sine).sqrt();
            let ray = Ray::new(&space, from, direction, 40.0);
            let settings = Settings::bare(1e-10).with_events();
            let (how, end) = ends_alone(&space, settings, &[ray])[0];
            assert!(matches!(how, End::Exit(_)), "{how:?}");
            let along = -from.dot(direction);
            let aside = (share * radius).powi(2);
            let expected = match share < 1.0 {
                true => along - (radius * radius - aside).sqrt(),
                false => along + (400.0 - aside).sqrt(),
            };
            assert!(
                (end - expected).abs() < 1e-8,
                "{radius} {share}: {end} {expected}"
            );
        }
    }
}

/// A sheet at z = 2, beside a lens, that is an exit: its formula says only on which side it is, and nothing of how far it is.
fn sheet(thickness: f64, medium: &str) -> Manifold {
    let text = format!(
        "name = 'sheet'\ncoordinates = ['x', 'y', 'z']\n\
         metric = {{ conformal = '1 + 0.3*exp(-x^2 - y^2 - z^2)' }}\n{medium}\n\
         exit = [{{ name = 'sheet', when = 'if(abs(z - 2) < {thickness}, 1, -1)' }}, \
         {{ name = 'sky', when = 'x^2 + y^2 + z^2 - 16' }}]\n"
    );
    Manifold::from_source(SourceText::new("sheet", &text), &[]).unwrap()
}

/// Asserts that paths that set out towards the sheet end on its near side.
fn assert_met(sheet: &Manifold, thickness: f64) {
    let directions = (0..200).map(|k| {
        let angle = f64::from(k) * 2.4;
        DVec3::new(0.8 * angle.cos(), 0.8 * angle.sin(), 1.0).normalize()
    });
    let start = DVec3::new(0.01, 0.0, -0.1);
    let rays = directions.map(|d| Ray::new(sheet, start, d, 12.0));
    for path in paths(sheet, Settings::bare(1e-9).with_events(), rays) {
        let z = path.steps.last().unwrap().position(path.length).z;
        let follows = sheet.follows();
        assert_eq!(
            path.end,
            End::Exit(0),
            "{follows:?} {thickness}: ends at z = {z}"
        );
        let off = z - (2.0 - thickness);
        assert!(off.abs() < 1e-9, "{follows:?} {thickness}: {z}");
    }
}

#[test]
fn exact_paths_meet_thin_sheets_whose_formula_jumps() {
    for thickness in [0.002, 0.02, 0.2] {
        assert_met(&sheet(thickness, ""), thickness);
    }
}

/// Of paths in a wind: lines of sight, light into the future, and geodesics of the metric.
#[test]
fn all_kinds_of_paths_meet_thin_sheets_in_a_wind() {
    for thickness in [0.002, 0.02, 0.2] {
        let sheet = sheet(thickness, "wind = ['0.1*y', '-0.1*x', '0.05']");
        assert_met(&sheet, thickness);
        assert_met(&sheet.forward().unwrap(), thickness);
        assert_met(&sheet.still(), thickness);
    }
}

#[test]
fn tables_show_exits_that_lie_between_knots() {
    let camera = "at = [5, 0, 0]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\nfov = 60";
    let pictured = Pictured::of(&ball(1.0), camera, (320, 180));
    let both = pictured.both();
    let [exact, table] = counts(&both, |seen| matches!(seen, Seen::Sky { exit: 1, .. }));
    // The pixels whose middles are within a cone of sin 1/5.
    assert_eq!(exact, 10_032);
    assert!(table.abs_diff(exact) < 100, "{table}");
}

#[test]
fn tables_show_the_sky_behind_a_horizon_in_a_wind() {
    let camera = "at = [9, 0, 0]\nlook = [-1, 0.2, 0.1]\nup = [0, 0, 1]\nfov = 80";
    let pictured = Pictured::of(&catalogue_text("schwarzschild-river"), camera, (128, 72));
    let [exact, table] = pictured.both();
    let mut off: Vec<f32> = exact
        .iter()
        .zip(&table)
        .filter_map(|pair| match pair {
            (
                Seen::Sky {
                    exit: a,
                    direction: x,
                    ..
                },
                Seen::Sky {
                    exit: b,
                    direction: y,
                    ..
                },
            ) => (a == b).then(|| 1e3 * x.angle_between(*y)),
            _ => None,
        })
        .collect();
    off.sort_by(f32::total_cmp);
    let quantile = |share: f64| off[(share * (off.len() - 1) as f64) as usize];
    // Rays to the horizon's rim are spread a dozen times as far.
    let [middle, high] = [0.5, 0.95].map(quantile);
    assert!(
        off.len() > 9000 && middle < 3.0 && high < 30.0,
        "{middle} {high}"
    );
}

#[test]
fn small_pictures_show_what_a_ball_of_glass_shows() {
    let object = "[[object]]\nmesh = 'teapot.obj'\nat = [3.4, 0, -0.3]\nscale = 0.7";
    let sky = "[sky]\nsky = { color = [0.1, 0.2, 0.3] }";
    let camera = "at = [-3.4, 0, 0.5]\nlook = [1, 0, -0.14]\nup = [0, 0, 1]\nfov = 90";
    let camera = format!("{camera}\n{object}\n{sky}");
    let pictured = Pictured::of(&catalogue_text("glass-ball"), &camera, (64, 64));
    let [exact, table] = counts(&pictured.both(), |seen| matches!(seen, Seen::Surface(_)));
    assert!(exact > 60 && table.abs_diff(exact) <= 4, "{exact} {table}");
}

/// De Sitter's static patch in Klein's chart: its horizon is infinitely far, and arc lengths near it grow without bound.
const PATCH: &str = r#"name = "static patch"
coordinates = ["x", "y", "z"]
[let]
f = "1 - x^2 - y^2 - z^2"
[metric]
xx = "1/f + x^2/f^2"
yy = "1/f + y^2/f^2"
zz = "1/f + z^2/f^2"
xy = "x*y/f^2"
xz = "x*z/f^2"
yz = "y*z/f^2"
[[exit]]
name = "horizon"
when = "x^2 + y^2 + z^2 - 0.9999"
[symmetry]
rotation = "origin"
[cameras]
parameters = { c = [0.1, 0.6] }
at = ["c", "0", "0"]
length = 6.0
"#;

#[test]
fn certificates_tell_of_exits_that_a_table_does_not_reach() {
    let place = Place::with(&[("space.toml", PATCH)]);
    place.bake("space.toml -o table.fan --max-error 3 --certify-rays 1000 --quiet");
    let bundle = Bundle::read(&place.path("table.fan")).unwrap();
    let checked = certify(&bundle.table, 1000, 5, 1e-10, 3.0, |_| Ok(())).unwrap();
    let sky = checked.certificate.sky_mrad.expect("exits");
    println!("{sky:?}");
    assert!(sky.p99 > 3000.0);
}

/// A camera beside a lens in the middle of a ball; paths are as long as the straight one needs to leave, and a little.
#[test]
fn paths_that_leave_where_the_table_ends_are_no_errors() {
    let text = r#"
name = "ball"
coordinates = ["x", "y", "z"]
metric = { conformal = "1 + 0.05*exp(-(x - 1)^2 - y^2 - z^2)" }
exit = [{ name = "sky", when = "x^2 + y^2 + z^2 - 9" }]
[cameras]
at = ["0", "0", "0"]
"#;
    let place = Place::with(&[("space.toml", text)]);
    let space = Manifold::from_source(SourceText::new("space", text), &[]).unwrap();
    // Where the path along -x, which is straight, leaves.
    let ray = Ray::new(&space, DVec3::ZERO, -DVec3::X, 4.0);
    let least = paths(&space, Settings::bare(1e-12).with_events(), [ray])
        .remove(0)
        .length;
    let flags = "--max-error 3 --certify-rays 4000 --quiet";
    place.bake(&format!(
        "space.toml -o table.fan --length {} {flags}",
        least * 1.00001
    ));
    let bundle = Bundle::read(&place.path("table.fan")).unwrap();
    let checked = certify(&bundle.table, 4000, 5, 1e-10, 3.0, |_| Ok(())).unwrap();
    let sky = checked.certificate.sky_mrad.expect("exits");
    assert!(sky.max < 30.0, "{sky:?}");
}
