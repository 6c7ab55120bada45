//! Tables of glued spaces: paths looked up again where a table ends, and the images that tables show, against closed
//! forms and exact paths.

mod support;

use geofan_bundle::{Bundle, Table, trace};
use geofan_core::{
    geodesic::{Ray, Sample, paths, sample},
    manifold::{DeckTransformation, Manifold},
    random::Stream,
};
use geofan_render::{
    Camera, ExactTracer, Lookup, Optics, Seen, ShiftedTracer, Stage, View,
    frame::{Outcomes, Paths, offsets, trace as frame},
    picture::{LayerValues, Picture},
    shade::with_layers,
};
use glam::{DVec3, DVec4};
use ndarray::Array2;
use support::{Place, asset, catalogue_text, random_point, settings};

/// The bundle of a manifold of the catalogue with paths of this length.
fn baked(place: &Place, name: &str, options: &str) -> Bundle {
    place
        .bake(&format!("{name}.toml -o {name}.fan --quiet {options}"))
        .success();
    Bundle::read(&place.path(&format!("{name}.fan"))).unwrap()
}

fn place(names: &[&str]) -> Place {
    let files: Vec<(String, String)> = names
        .iter()
        .map(|name| (format!("{name}.toml"), catalogue_text(name)))
        .collect();
    let files: Vec<(&str, &str)> = files
        .iter()
        .map(|(name, text)| (name.as_str(), text.as_str()))
        .collect();
    Place::with(&files)
}

/// The exact state at the end of a path of the glued space, with the area of its beam.
fn exactly(space: &Manifold, u: DVec3, d: DVec3, length: f64) -> Sample {
    let ray = Ray::new(space, u, d, length);
    let path = paths(space, settings(1e-12, true), [ray]).remove(0);
    sample(space, &ray, &path, length)
}

/// Magnifications are raised to this before dividing by them, as certificates do.
const LEAST_MAGNIFICATION: f64 = 0.25;

/// The distance across the path of a point from the exact one, wherever rounding has put either about a face, over
/// what an angle at the start has grown to; mrad.
fn screen_error(space: &Manifold, found: &Sample, exact: &Sample) -> f64 {
    let gluing = space.gluing().unwrap();
    let decks = gluing.faces().iter().filter_map(|face| face.deck());
    let images = decks.map(|deck| deck.point(found.u)).chain([found.u]);
    let g = space.metric(exact.u);
    let off = |u: DVec3| {
        let off = u - exact.u;
        let across = off - exact.v * off.dot(g * exact.v);
        across.dot(g * across).max(0.0).sqrt()
    };
    let nearest = images.map(off).fold(f64::INFINITY, f64::min);
    let grown = exact.area.unwrap().abs().sqrt();
    1e3 * nearest / grown.max(LEAST_MAGNIFICATION * exact.s)
}

/// Sorted screen errors (mrad) of `count` random paths of lengths in this interval, and how often they were looked up
/// again.
fn errors(
    table: &Table,
    space: &Manifold,
    [least, most]: [f64; 2],
    count: usize,
) -> (Vec<f64>, usize) {
    let mut stream = Stream::new(&[39, (most * 1e3) as u64]);
    let (mut errors, mut restarts) = (Vec::new(), 0);
    for _ in 0..count {
        // Cameras as of the certificate, brought in.
        let u = random_point(space, &mut stream);
        let (u, _) = space.gluing().unwrap().locate(u).unwrap();
        let d = stream.direction();
        let length = stream.between(least, most);
        let traced = trace(table, u, d, length, 2, 1e-10).unwrap();
        assert!(!traced.exact);
        restarts = restarts.max(traced.restarts);
        let last = traced.samples.last().unwrap();
        assert!((last.s - length).abs() < 1e-12);
        errors.push(screen_error(space, last, &exactly(space, u, d, length)));
    }
    errors.sort_by(f64::total_cmp);
    (errors, restarts)
}

fn quantile(errors: &[f64], q: f64) -> f64 {
    errors[((errors.len() as f64 * q) as usize).min(errors.len() - 1)]
}

#[test]
fn paths_are_looked_up_again_where_a_short_table_ends() {
    let place = place(&["poincare", "seifert-weber", "nil-torus"]);
    // A space, the table's length and promise (mrad), and lengths.
    let cases = [
        ("poincare", 1.5, 0.1, [2.8, 5.8]),
        ("seifert-weber", 2.5, 0.2, [4.9, 7.4]),
        ("nil-torus", 2.0, 0.1, [3.9, 7.9]),
    ];
    for (name, length, promise, farther) in cases {
        let bundle = baked(
            &place,
            name,
            &format!("--length {length} --max-error {promise}"),
        );
        let space = asset(name);
        let (own, restarts) = errors(&bundle.table, &space, [0.1, length], 200);
        println!("{name}, {length}: {:.3} {restarts}", quantile(&own, 0.99));
        assert_eq!(restarts, 0);
        for length in farther {
            let (errors, restarts) = errors(&bundle.table, &space, [length; 2], 200);
            let p99 = quantile(&errors, 0.99);
            println!(
                "{name}, {length}: p50 {:.3} p99 {p99:.3} max {:.3}, {restarts} restarts",
                quantile(&errors, 0.5),
                errors[errors.len() - 1]
            );
            assert_eq!(restarts, (length / bundle.table.length) as usize, "{name}");
            // Points of each part, and directions where each begins, which tables promise to four times as much.
            let times = restarts as f64;
            let promised = promise * (times + 1.0 + 4.0 * times);
            assert!(p99 < promised, "{name}, {length}: {p99} {promised}");
        }
    }
}

/// A space, a table's length, a start, where a path of length 6 ends, and the faces that it crosses.
type Known = (&'static str, f64, [f64; 3], [f64; 3], u32);

/// Where matrices take paths of length 6, by tables much shorter.
#[test]
fn short_tables_lead_where_matrices_do() {
    let place = place(&["poincare", "seifert-weber"]);
    let d = DVec3::new(0.3, 0.8, -0.5).normalize();
    let known: [Known; 2] = [
        (
            "poincare",
            1.5,
            [0.05, -0.03, 0.02],
            [0.00537716456, -0.14564469254, 0.09225229864],
            12,
        ),
        (
            "seifert-weber",
            2.5,
            [0.1, -0.05, 0.2],
            [-0.09478838637, 0.02413016849, 0.56072840831],
            5,
        ),
    ];
    for (name, length, from, to, crossings) in known {
        let bundle = baked(&place, name, &format!("--length {length} --max-error 0.05"));
        let traced = trace(&bundle.table, from.into(), d, 6.0, 7, 1e-10).unwrap();
        let last = traced.samples.last().unwrap();
        assert_eq!(traced.samples.len(), 7);
        assert_eq!(traced.restarts, (6.0 / length).ceil() as usize - 1);
        let off = (last.u - DVec3::from(to)).length();
        println!("{name}: {off:.2e} off, {} crossings", last.crossings);
        // At the end of a path of S3 an angle has grown to |sin 6|, in hyperbolic space to sinh 6.
        let allowed = if name == "poincare" { 3e-4 } else { 2e-2 };
        assert!(off < allowed, "{name}: {off}");
        assert_eq!(last.crossings, crossings, "{name}");
        // Its frame is carried along.
        let exact = exactly(&asset(name), from.into(), d, 6.0);
        let turned = last.frame.unwrap() - exact.frame.unwrap();
        let turned = turned
            .to_cols_array()
            .iter()
            .fold(0.0_f64, |a, b| a.max(b.abs()));
        assert!(turned < 0.02, "{name}: {turned}");
    }
}

#[test]
fn a_table_whose_cameras_are_elsewhere_says_so() {
    let text = catalogue_text("poincare").replace("{ c = [0.0, 0.2] }", "{ c = [0.0, 0.06] }");
    let place = Place::with(&[("m.toml", &text)]);
    place.bake("m.toml -o m.fan --length 1 --quiet").success();
    let told = assert_cmd::Command::cargo_bin("geofan")
        .unwrap()
        .current_dir(place.path(""))
        .args("trace --bundle m.fan --at 0.05,0,0 --dir 0.3,0.8,0.1 --length 2".split(' '))
        .assert()
        .code(2);
    let told = String::from_utf8_lossy(&told.get_output().stderr).into_owned();
    assert!(
        told.contains("paths end at 1") && told.contains("camera region"),
        "{told}"
    );
}

fn surfaces(outcomes: &Outcomes) -> usize {
    let surface = |seen: &&Seen| matches!(seen, Seen::Surface(_));
    outcomes.iter().filter(surface).count()
}

/// The share of samples that see the same, as far away.
fn alike(truth: &Outcomes, found: &Outcomes) -> f64 {
    let same = |(a, b): &(&Seen, &Seen)| match (a, b) {
        (Seen::Surface(a), Seen::Surface(b)) => (a.s - b.s).abs() <= 3e-3 * a.s,
        (a, b) => std::mem::discriminant(*a) == std::mem::discriminant(*b),
    };
    truth.iter().zip(found).filter(same).count() as f64 / truth.len() as f64
}

#[test]
fn a_frame_of_a_short_table_shows_what_exact_paths_do_far_away() {
    let square = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n";
    let scene = "manifold = 'poincare.toml'\n[camera]\nat = [0.05, -0.11, 0.03]\nlook = [-0.35, 1.0, -0.1]\nup = [0, 0, 1]\nfov = 90\n[[object]]\nmesh = 'square.obj'\nat = [0.0, 0.05, 0.0]\nscale = 0.04\n";
    let place = Place::with(&[
        ("square.obj", square),
        ("poincare.toml", &catalogue_text("poincare")),
        ("scene.toml", scene),
    ]);
    let bundle = baked(&place, "poincare", "--length 1 --max-error 0.1");
    let stage = Stage::load(&place.path("scene.toml"), &[])
        .unwrap_or_else(|e| panic!("{}", e.report(false)));
    let view = stage.view(&stage.scene.camera, (96, 64)).unwrap();
    // Past the point that the sphere's chart lacks.
    let length = 4.5;
    let lookup = Lookup::new(&bundle.table, 1e-4, 1e-8).continued(length);
    let fan = bundle.fan(view.u).unwrap();
    let tracer = lookup.tracer(&fan);
    let by = |paths| frame(&stage.world, &view, paths, &offsets(1));
    let traced = by(Paths::Lattice(&tracer, 5e-4));
    let near = Lookup::new(&bundle.table, 1e-4, 1e-8);
    let near = near.tracer(&fan);
    let near = by(Paths::Lattice(&near, 5e-4));
    let exact = ExactTracer::new(&stage.world.manifold, view.u, length, 1e-9);
    let truth = by(Paths::Exact(&exact)).outcomes;
    let all = surfaces(&truth);
    assert!(all > 2 * surfaces(&near.outcomes), "{all}");
    assert!(traced.flagged.is_empty());
    let share = alike(&truth, &traced.outcomes);
    println!(
        "{share} alike, {all} surfaces, {} near",
        surfaces(&near.outcomes)
    );
    assert!(share > 0.98, "{share}");
    // Whichever tracer saw them, surfaces are in the same copies.
    let copies = [&truth, &traced.outcomes].map(|seen| copies(&stage, &view, seen));
    let both = copies[0]
        .iter()
        .zip(&copies[1])
        .filter(|(a, b)| **a > 0 || **b > 0);
    let both: Vec<_> = both.collect();
    let same = both.iter().filter(|(a, b)| a == b).count();
    assert!(
        both.len() >= all && same as f64 > 0.97 * all as f64,
        "{same} of {all}"
    );
    // Parallel rays start beside the camera.
    let camera = Camera::looking(view.u, DVec3::new(-0.35, 1.0, -0.1), DVec3::Z);
    let view = View::through(&camera, Optics::Orthographic { width: 0.3 }, (48, 32));
    let truth = frame(&stage.world, &view, Paths::Exact(&exact), &offsets(1)).outcomes;
    let tracer = ShiftedTracer::new(&lookup, &view);
    let traced = frame(
        &stage.world,
        &view,
        Paths::Lattice(&tracer, 5e-4),
        &offsets(1),
    );
    let share = alike(&truth, &traced.outcomes);
    assert!(
        surfaces(&truth) > 40 && share > 0.98,
        "{} {share}",
        surfaces(&truth)
    );
}

/// The numbers of the copies that are seen.
fn copies(stage: &Stage, view: &View, outcomes: &Outcomes) -> Array2<u32> {
    let (height, width, _) = outcomes.dim();
    let picture = Picture::filled(width, height, [0.0; 3]);
    let layers = with_layers(picture, &stage.world, view, (outcomes, &[]), 1e-8);
    match layers.layer("copy") {
        Some(LayerValues::Index(numbers)) => numbers.clone(),
        _ => panic!("no copies"),
    }
}

#[test]
fn copies_are_counted_from_the_camera_where_parallel_rays_start_beyond_a_face() {
    let scene = "manifold = 'half-turn.toml'\n[camera]\nat = [0.9, 0, 0]\nlook = [0, 1, 0]\nup = [0, 0, 1]\n\
        [[object]]\nmesh = 'wall.obj'\nat = [1, 0.6, 0]\nplacement = 'chart'\n";
    let wall = "v -0.5 0 -0.3\nv 0.5 0 -0.3\nv 0.5 0 0.3\nv -0.5 0 0.3\nf 1 2 3 4\n";
    let space = catalogue_text("half-turn");
    let place = Place::with(&[
        ("half-turn.toml", &space),
        ("scene.toml", scene),
        ("wall.obj", wall),
    ]);
    let stage = Stage::load(&place.path("scene.toml"), &[])
        .unwrap_or_else(|e| panic!("{}", e.report(false)));
    let camera = Camera::looking(DVec3::new(0.9, 0.0, 0.0), DVec3::Y, DVec3::Z);
    let view = View::through(&camera, Optics::Orthographic { width: 0.7 }, (28, 8));
    let exact = ExactTracer::new(&stage.world.manifold, view.u, 1.0, 1e-9);
    let seen = frame(&stage.world, &view, Paths::Exact(&exact), &offsets(1)).outcomes;
    // The wall sticks out through the face at x = 1, and the window reaches as far: one image of it.
    let numbers = copies(&stage, &view, &seen);
    assert!(
        surfaces(&seen) == 28 * 8 && numbers.iter().all(|copy| *copy == 1),
        "{numbers}"
    );
}

#[test]
fn paths_leave_a_glued_space_by_its_exits_however_short_the_table_is() {
    let space = "name = 'slab'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n\
        exit = [{ name = 'up', when = 'z - 1.3' }, { name = 'down', when = '-1.1 - z' }]\n\
        glue = [{ face = '1 - x', map = ['x - 2', 'y', 'z'] }, { face = '1 + x', map = ['x + 2', 'y', 'z'] },\n\
        { face = '1 - y', map = ['x', 'y - 2', 'z'] }, { face = '1 + y', map = ['x', 'y + 2', 'z'] }]\n\
        symmetry = { group = ['x + px', 'y + py', 'z + pz'] }\n[cameras]\nlength = 1\n";
    let scene = "manifold = 'slab.toml'\n[camera]\nat = [0.1, -0.2, 0.1]\nlook = [-0.2, 1.0, 0.3]\nup = [0, 0, 1]\nfov = 95\n";
    let place = Place::with(&[("slab.toml", space), ("scene.toml", scene)]);
    let bundle = baked(&place, "slab", "--max-error 0.1");
    let stage = Stage::load(&place.path("scene.toml"), &[])
        .unwrap_or_else(|e| panic!("{}", e.report(false)));
    let view = stage.view(&stage.scene.camera, (60, 34)).unwrap();
    let lookup = Lookup::new(&bundle.table, 1e-4, 1e-8).continued(6.0);
    let fan = bundle.fan(view.u).unwrap();
    let tracer = lookup.tracer(&fan);
    let traced = frame(
        &stage.world,
        &view,
        Paths::Lattice(&tracer, 5e-4),
        &offsets(1),
    );
    // Integrated all, and said so.
    assert_eq!(traced.flagged.len(), traced.outcomes.len());
    let mut left = 0;
    for ((y, x, _), seen) in traced.outcomes.indexed_iter() {
        let rise = view.ray(x as f64 + 0.5, y as f64 + 0.5).direction.z;
        let s = 1.2 / rise.abs();
        match seen {
            Seen::Sky { s: found, .. } => assert!((f64::from(*found) - s).abs() < 1e-4 * s),
            Seen::Length => assert!(s > 6.0 * (1.0 - 1e-6), "{s}"),
            other => panic!("{other:?}"),
        }
        left += usize::from(s <= 6.0);
    }
    assert!(left > 1000, "{left}");
}

/// A geometry whose isometries are linear on vectors (x, y, z, w): the sphere or the hyperboloid.
struct Model {
    /// The sign of the curvature.
    sign: f64,
}

impl Model {
    fn lift(&self, u: DVec3) -> DVec4 {
        let r2 = self.sign * u.length_squared();
        (2.0 * u).extend(1.0 - r2) / (1.0 + r2)
    }

    fn product(&self, a: DVec4, b: DVec4) -> f64 {
        self.sign * a.truncate().dot(b.truncate()) + a.w * b.w
    }

    /// The distance from `u` to `p`, and the unit direction there, chart components.
    fn way(&self, u: DVec3, p: DVec3) -> (f64, DVec3) {
        let [a, b] = [u, p].map(|u| self.lift(u));
        let cos = self.product(a, b);
        let along = b - a * cos;
        let d = match self.sign > 0.0 {
            true => along.length().atan2(cos),
            false => cos.max(1.0).acosh(),
        };
        // Back to the chart: the derivative of x / (1 + w).
        let v = along.truncate() / (1.0 + a.w) - a.truncate() * (along.w / (1.0 + a.w).powi(2));
        (d, v.normalize())
    }
}

/// Sorted angles (mrad) by which the table's points at the distances of all images of `p` from `u` miss them.
fn image_errors(
    (bundle, model, space): (&Bundle, &Model, &Manifold),
    [u, p]: [DVec3; 2],
    most: f64,
) -> Vec<f64> {
    let gluing = space.gluing().unwrap();
    let near = |_: &DeckTransformation, place: DVec3| model.way(u, place).0 < most + 3.0;
    let copies: Vec<DeckTransformation> =
        gluing.copies(|deck, place| near(deck, place).then_some(0.0), 40_000);
    let fan = bundle.fan(u).unwrap();
    let mut errors = Vec::new();
    for deck in copies {
        let image = deck.point(p);
        let (d, v) = model.way(u, image);
        if d > most {
            continue;
        }
        // The chart is conformal.
        let (there, _) = fan.path(v).at(d).unwrap();
        errors.push(1e3 * model.way(there, image).0 / d);
    }
    errors.sort_by(f64::total_cmp);
    errors
}

#[test]
fn tables_put_the_images_of_points_where_closed_forms_do() {
    let place = place(&["poincare", "seifert-weber"]);
    let bundle = baked(&place, "poincare", "--max-error 0.05 --length 3");
    let points = [
        DVec3::new(-0.07572246, 0.01514449, 0.06057797),
        DVec3::new(0.05067406, 0.10134813, -0.02533703),
    ];
    let sphere = Model { sign: 1.0 };
    let space = asset("poincare");
    let errors = image_errors((&bundle, &sphere, &space), points, 3.0);
    let (p50, max) = (quantile(&errors, 0.5), errors[errors.len() - 1]);
    println!(
        "{} bytes: {} images, p50 {p50:.4} max {max:.4} mrad",
        std::fs::metadata(place.path("poincare.fan")).unwrap().len(),
        errors.len()
    );
    assert_eq!(errors.len(), 120);
    assert!(p50 < 0.02 && max < 0.08, "{p50} {max}");
    let bundle = baked(&place, "seifert-weber", "--length 5 --max-error 0.5");
    let ball = |x: [f64; 3]| {
        let x = DVec3::from(x);
        x / (1.0 + (1.0 + x.length_squared()).sqrt())
    };
    let points = [ball([-0.25, 0.15, 0.05]), ball([0.2, -0.1, 0.3])];
    let hyperboloid = Model { sign: -1.0 };
    let space = asset("seifert-weber");
    let errors = image_errors((&bundle, &hyperboloid, &space), points, 5.0);
    let (p50, max) = (quantile(&errors, 0.5), errors[errors.len() - 1]);
    println!("{} images, p50 {p50:.4} max {max:.4} mrad", errors.len());
    assert!(errors.len() > 2500, "{}", errors.len());
}

#[test]
fn the_space_of_seifert_and_weber_keeps_its_covers_promise_through_its_faces() {
    let place = place(&["seifert-weber"]);
    let bundle = baked(&place, "seifert-weber", "--length 6 --max-error 0.5");
    let (errors, restarts) = errors(&bundle.table, &asset("seifert-weber"), [0.1, 6.0], 600);
    let p99 = quantile(&errors, 0.99);
    println!("p50 {:.3} p99 {p99:.3} mrad", quantile(&errors, 0.5));
    assert_eq!(restarts, 0);
    assert!(p99 < 0.5, "{p99}");
}
