//! Light that takes time: objects that move are seen where they were when they sent it.

mod support;

use geofan_bundle::Bundle;
use geofan_core::geodesic::{Path, Ray, Settings, paths};
use geofan_light::path_tracer::{Estimator, PathTracerSettings};
use geofan_render::{
    ExactGridTracer, ExactTracer, Seen, Stage, View,
    drawing::draw,
    frame::{Outcomes, Paths, offsets, trace},
    no_clock,
    shade::Footprints,
    starts::{RayStart, starts},
};
use glam::{DMat3, DVec2, DVec3};
use support::{Place, by_table, catalogue_text, film};

/// The unit sphere as a mesh, an octahedron's faces cut into `n²` pieces each, stretched along z.
fn sphere(n: usize, stretch: f64) -> String {
    let mut text = String::new();
    let mut count = 0;
    for signs in 0..8 {
        let sign = |bit: usize| if signs >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let mut corner = |i: usize, j: usize| {
            let p = DVec3::new(i as f64, j as f64, (n - i - j) as f64);
            let p = (p * DVec3::new(sign(0), sign(1), sign(2))).normalize();
            text += &format!("v {} {} {}\n", p.x, p.y, p.z * stretch);
        };
        for i in 0..n {
            for j in 0..n - i {
                let mut triangle = |corners: [(usize, usize); 3]| {
                    corners.into_iter().for_each(|(i, j)| corner(i, j));
                    count += 1;
                };
                triangle([(i, j), (i + 1, j), (i, j + 1)]);
                if i + j + 2 <= n {
                    triangle([(i + 1, j), (i + 1, j + 1), (i, j + 1)]);
                }
            }
        }
    }
    for k in 0..count {
        text += &format!("f {} {} {}\n", 3 * k + 1, 3 * k + 2, 3 * k + 3);
    }
    text
}

const SIZE: (usize, usize) = (96, 64);

/// A space with a sphere of the chart on a path.
struct Flight {
    place: Place,
    length: f64,
}

impl Flight {
    fn new(space: &str, camera: &str, object: &str, mesh: &str, length: f64) -> Self {
        let scene = format!(
            "manifold = 'space.toml'\ndelay = true\n[camera]\n{camera}\n[[object]]\nmesh = 'sphere.obj'\nplacement = 'chart'\n{object}\n"
        );
        let files = [
            ("space.toml", space),
            ("scene.toml", &scene),
            ("sphere.obj", mesh),
        ];
        Self {
            place: Place::with(&files),
            length,
        }
    }

    fn stage(&self, time: f64) -> (Stage, View) {
        let loaded = Stage::load(&self.place.path("scene.toml"), &[]);
        let mut stage = loaded.unwrap_or_else(|e| panic!("{}", e.report(false)));
        let moved = stage.set_time(time);
        moved.unwrap_or_else(|e| panic!("{}", e.report(false)));
        let view = stage.view(&stage.scene.camera, SIZE).unwrap();
        (stage, view)
    }

    fn exact(&self, stage: &Stage, view: &View) -> Outcomes {
        let tracer = ExactTracer::new(&stage.world.manifold, view.u, self.length, 1e-9);
        trace(&stage.world, view, Paths::Exact(&tracer), &offsets(1)).outcomes
    }

    /// Follows the paths of all samples, farther than any of them is looked at.
    fn paths(&self, stage: &Stage, view: &View) -> Vec<(DVec2, Path)> {
        let manifold = &stage.world.manifold;
        let places =
            (0..SIZE.0 * SIZE.1).map(|i| DVec2::new((i % SIZE.0) as f64, (i / SIZE.0) as f64));
        let middles: Vec<DVec2> = places.map(|at| at + 0.5).collect();
        let starts = starts(manifold, view, middles.iter().copied());
        let ray = |start: RayStart| Ray::without_spread(start.u, start.v, self.length);
        let rays: Vec<Ray> = starts.into_iter().flatten().map(ray).collect();
        let settings = Settings::bare(1e-10).with_events();
        middles
            .into_iter()
            .zip(paths(manifold, settings, rays))
            .collect()
    }
}

/// Holds outcomes against the world line of the sphere's middle: a path sees the sphere where it first comes as near to where
/// the middle was when light left there as the sphere is large. Returns the arc lengths of the hits. `periods` are those of
/// the chart, 0 where there is none.
fn check(
    flight: &Flight,
    (stage, view, time): (&Stage, &View, f64),
    outcomes: &Outcomes,
    (middle, radius, periods): (&dyn Fn(f64) -> DVec3, f64, DVec3),
    allowed: f64,
) -> Vec<f64> {
    let distance = |u: DVec3, s: f64| {
        let off = u - middle(time - s);
        let wrapped = |x: f64, period: f64| match period > 0.0 {
            true => x - period * (x / period).round(),
            false => x,
        };
        let off = [0, 1, 2].map(|k| wrapped(off[k], periods[k]));
        DVec3::from(off).length() / radius
    };
    let mut hits = Vec::new();
    let mut wrong = 0;
    for ((_, path), seen) in flight.paths(stage, view).iter().zip(outcomes) {
        let count = 1500;
        let places = (0..=count).map(|i| path.length * f64::from(i) / f64::from(count));
        let along = |s: f64| {
            path.step_at(s)
                .map_or(f64::INFINITY, |step| distance(step.position(s), s))
        };
        let first = places.into_iter().find(|s| along(*s) < 1.0 - allowed);
        match (seen, first) {
            (Seen::Surface(hit), first) => {
                let s = f64::from(hit.s);
                hits.push(s);
                assert!((along(s) - 1.0).abs() < allowed, "{} at {s}", along(s));
                assert!((distance(stage.world.point(hit), s) - 1.0).abs() < allowed);
                wrong += usize::from(first.is_some_and(|first| first < s));
            }
            (_, None) => {}
            (_, Some(_)) => wrong += 1,
        }
    }
    assert_eq!(wrong, 0);
    hits
}

const FLAT: &str = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n";

/// Fits a circular cone to directions of lines of sight; returns how far, in radians, they are from it at most.
fn off_a_cone(directions: &[DVec3]) -> f64 {
    let mut square = DMat3::ZERO;
    let mut sum = DVec3::ZERO;
    for d in directions {
        square += DMat3::from_cols(*d * d.x, *d * d.y, *d * d.z);
        sum += *d;
    }
    let axis = square.inverse() * sum;
    let angles = directions.iter().map(|d| d.dot(axis.normalize()).acos());
    let angles: Vec<f64> = angles.collect();
    let mean = angles.iter().sum::<f64>() / angles.len() as f64;
    angles
        .iter()
        .fold(0.0, |most: f64, angle| most.max((angle - mean).abs()))
}

/// Directions between neighbouring samples of which one sees a surface.
fn outline(view: &View, outcomes: &Outcomes) -> Vec<DVec3> {
    let on = |x: usize, y: usize| matches!(outcomes[(y, x, 0)], Seen::Surface(_));
    let mut found = Vec::new();
    for y in 0..SIZE.1 - 1 {
        for x in 0..SIZE.0 - 1 {
            let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            for (i, j) in [(1, 0), (0, 1)] {
                if on(x, y) != on(x + i, y + j) {
                    let between = at + 0.5 * DVec2::new(i as f64, j as f64);
                    found.push(view.direction(between.x, between.y));
                }
            }
        }
    }
    found
}

/// R. Penrose, *The apparent shape of a relativistically moving sphere*, Proc. Cambridge Phil. Soc. 55 (1959) 137.
#[test]
fn a_fast_sphere_has_a_circular_outline() {
    let speed: f64 = 0.8;
    let contracted = (1.0 - speed * speed).sqrt();
    let mesh = sphere(24, contracted);
    let object = format!("path = ['0.3', '5', '{speed}*t']\nduring = [-30, 30]\nscale = 1.2");
    let camera = "at = [0, 0, 0]\nlook = [0, 5, -4]\nup = [1, 0, 0]\nfov = 40";
    let flight = Flight::new(FLAT, camera, &object, &mesh, 20.0);
    // What is seen at the time 1.5 was at z = 0.8 (1.5 - s).
    let (mut stage, view) = flight.stage(1.5);
    let seen = outline(&view, &flight.exact(&stage, &view));
    let pixel = 40_f64.to_radians() / SIZE.0 as f64;
    assert!(seen.len() > 100, "{}", seen.len());
    assert!(off_a_cone(&seen) < pixel, "{} {pixel}", off_a_cone(&seen));
    // Without delay it is elsewhere, and looks as short as it is.
    stage.scene.delay = None;
    stage.set_time(-5.0).unwrap();
    let now = outline(&view, &flight.exact(&stage, &view));
    assert!(
        now.len() > 50 && off_a_cone(&now) > 3.0 * pixel,
        "{}",
        off_a_cone(&now)
    );
}

/// A star that circles the hole, in a plane through none of the chart's axes, at three fifths of the speed of light.
fn star() -> (Flight, impl Fn(f64) -> DVec3) {
    let middle = |t: f64| {
        let (sin, cos) = (0.06 * t.max(-200.0)).sin_cos();
        8.0 * (DVec3::new(0.6, 0.64, -0.48) * cos + DVec3::new(0.0, 0.6, 0.8) * sin)
    };
    let object = "path = ['8*0.6*cos(0.06*t)', '8*(0.64*cos(0.06*t) + 0.6*sin(0.06*t))', '8*(-0.48*cos(0.06*t) + 0.8*sin(0.06*t))']\nduring = [-200, 400]\nscale = 2.2\nturning = { axis = [0, 0, 1], degrees = '5*t' }";
    let camera = "at = [17, 1.5, 10.5]\nlook = [-1, -0.1, -0.6]\nup = [0, 0, 1]\nfov = 70";
    let mesh = sphere(10, 1.0);
    let space = catalogue_text("schwarzschild");
    (Flight::new(&space, camera, object, &mesh, 90.0), middle)
}

#[test]
fn a_star_about_a_hole_is_seen_where_it_was_in_each_of_its_images() {
    let (flight, middle) = star();
    let time = 47.0;
    let (stage, view) = flight.stage(time);
    let outcomes = flight.exact(&stage, &view);
    let hits = check(
        &flight,
        (&stage, &view, time),
        &outcomes,
        (&middle, 2.2, DVec3::ZERO),
        0.03,
    );
    assert!(hits.len() > 30, "{}", hits.len());
    // One of its images has gone about the hole.
    let range = hits
        .iter()
        .fold([f64::INFINITY, 0.0], |[a, b], s| [s.min(a), s.max(b)]);
    assert!(range[1] - range[0] > 6.0, "{range:?}");
    // Interpolated paths, and each by itself.
    let knots = ExactGridTracer::choose_knots(&stage.world.cover, view.u, flight.length, 1e-7);
    let grid = ExactGridTracer::new(&stage.world.cover, view.u, knots, 1e-7);
    for paths in [Paths::Lattice(&grid, 5e-4), Paths::Direct(&grid)] {
        let fast = trace(&stage.world, &view, paths, &offsets(1)).outcomes;
        let other = differing(&outcomes, &fast);
        assert!(other <= 6, "{other}");
    }
}

/// Tells whether two samples see one place.
fn alike(a: &Seen, b: &Seen) -> bool {
    match (a, b) {
        (Seen::Surface(a), Seen::Surface(b)) => (a.s - b.s).abs() < 2e-3 * a.s,
        (Seen::Surface(_), _) | (_, Seen::Surface(_)) => false,
        _ => true,
    }
}

/// Counts the samples that do not see one place.
fn differing(a: &Outcomes, b: &Outcomes) -> usize {
    let other = a.iter().zip(b).filter(|(a, b)| !alike(a, b));
    other.count()
}

#[test]
fn a_table_shows_the_star_where_exact_paths_do() {
    let (flight, middle) = star();
    // From a place of the table's cameras.
    let text = std::fs::read_to_string(flight.place.path("space.toml")).unwrap();
    let text = text
        .replace("r = [2.2, 40.0]", "r = [20.0, 23.0]")
        .replace("length = 120.0", "length = 90.0");
    std::fs::write(flight.place.path("space.toml"), text).unwrap();
    flight
        .place
        .bake("space.toml -o space.fan --max-error 0.5 --quiet")
        .success();
    let bundle = Bundle::from_bytes(&flight.place.bytes("space.fan")).unwrap();
    let (stage, view) = flight.stage(47.0);
    let seen = by_table(&stage, &view, &bundle, 2e-4);
    let hits = check(
        &flight,
        (&stage, &view, 47.0),
        &seen,
        (&middle, 2.2, DVec3::ZERO),
        0.04,
    );
    assert!(hits.len() > 30, "{}", hits.len());
    let exact = flight.exact(&stage, &view);
    let other = differing(&exact, &seen);
    assert!(other <= 8, "{other}");
}

#[test]
fn in_a_wind_light_takes_the_time_of_the_spacetime() {
    let space = "name = 'river'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1.1' }\nwind = ['0.3', '0.1*x', '-0.2']\nlapse = '1'\n[cameras]\nlength = 25\n";
    let object =
        "path = ['2*sin(0.1*t)', '5 + cos(0.1*t)', '0.15*t']\nduring = [-40, 40]\nscale = 0.9";
    let middle = |t: f64| DVec3::new(2.0 * (0.1 * t).sin(), 5.0 + (0.1 * t).cos(), 0.15 * t);
    let camera = "at = [0.2, 0.1, 0.4]\nlook = [0, 1, 0]\nup = [0, 0, 1]\nfov = 100";
    let flight = Flight::new(space, camera, object, &sphere(10, 1.0), 20.0);
    let (stage, view) = flight.stage(6.0);
    let outcomes = flight.exact(&stage, &view);
    let hits = check(
        &flight,
        (&stage, &view, 6.0),
        &outcomes,
        (&middle, 0.9, DVec3::ZERO),
        0.03,
    );
    assert!(hits.len() > 40, "{}", hits.len());
}

#[test]
fn copies_of_a_glued_space_are_seen_at_earlier_times_the_farther_they_are() {
    let torus = "name = 'torus'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n[domain]\nx = [-1, 1]\ny = [-1, 1]\nz = [-1, 1]\nperiodic = ['x', 'y', 'z']\n[cameras]\nlength = 12\n";
    let object =
        "path = ['0.3 + 0.2*t', '0.4*sin(t)', '-0.2 - 0.13*t']\nduring = [-9, 6]\nscale = 0.3";
    let middle = |t: f64| {
        let t = t.max(-9.0);
        DVec3::new(0.3 + 0.2 * t, 0.4 * t.sin(), -0.2 - 0.13 * t)
    };
    let camera = "at = [0.1, -0.8, 0.15]\nlook = [0.3, 1, 0.2]\nup = [0, 0, 1]\nfov = 80";
    let flight = Flight::new(torus, camera, object, &sphere(8, 1.0), 10.0);
    let (stage, view) = flight.stage(2.5);
    let outcomes = flight.exact(&stage, &view);
    let hits = check(
        &flight,
        (&stage, &view, 2.5),
        &outcomes,
        (&middle, 0.3, DVec3::splat(2.0)),
        0.04,
    );
    let far = hits.iter().filter(|s| **s > 5.0).count();
    assert!(hits.len() > 500 && far > 100, "{} {far}", hits.len());
}

#[test]
fn copies_beyond_glued_faces_are_as_late_as_those_of_the_same_space_unfolded() {
    let camera = "at = [0.1, -0.8, 0.15]\nlook = [0.3, 1, 0.5]\nup = [0, 0, 1]\nfov = 80";
    let flight = |layer: i32, i: i32, j: i32| {
        let sign = if layer % 2 == 0 { "" } else { "-" };
        format!(
            "path = ['{sign}(0.3 + 0.2*t) + {}', '{sign}0.4*sin(t) + {}', '-0.2 - 0.13*t + {}']\nduring = [2, 5.5]\nscale = 0.3\n",
            2 * i,
            2 * j,
            2 * layer
        )
    };
    let mesh = sphere(3, 1.0);
    let space = catalogue_text("half-turn");
    let glued = Flight::new(&space, camera, &flight(0, 0, 0), &mesh, 2.6);
    let mut copies = String::new();
    for layer in -1..=1 {
        for (i, j) in (-2..=1).flat_map(|i| (-2..=1).map(move |j| (i, j))) {
            let first = if copies.is_empty() {
                ""
            } else {
                "[[object]]\nmesh = 'sphere.obj'\nplacement = 'chart'\n"
            };
            copies += &(first.to_owned() + &flight(layer, i, j));
        }
    }
    let unfolded = Flight::new(FLAT, camera, &copies, &mesh, 2.6);
    // The path has left the cube by then.
    let (stage, view) = glued.stage(5.0);
    let (flat, flat_view) = unfolded.stage(5.0);
    let truth = unfolded.exact(&flat, &flat_view);
    let seen = |seen: &&Seen| matches!(seen, Seen::Surface(_));
    assert!(truth.iter().filter(seen).count() > 150);
    let knots = ExactGridTracer::choose_knots(&stage.world.cover, view.u, 2.6, 1e-7);
    let grid = ExactGridTracer::new(&stage.world.cover, view.u, knots, 1e-7);
    let interpolated = Paths::Lattice(&grid, 5e-4);
    let interpolated = trace(&stage.world, &view, interpolated, &offsets(1)).outcomes;
    for found in [glued.exact(&stage, &view), interpolated] {
        let other = differing(&truth, &found);
        assert!(other <= 6, "{other}");
    }
}

#[test]
fn what_is_behind_glass_and_what_paths_are_traced_to_is_seen_as_late() {
    let object = "path = ['0', '6', '0.5*t']\nduring = [-40, 40]\nscale = 1";
    let camera = "at = [0, 0, 0]\nlook = [0, 1, -0.45]\nup = [0, 0, 1]\nfov = 50";
    let flight = Flight::new(
        FLAT,
        camera,
        object,
        &format!("mtllib sphere.mtl\nusemtl glow\n{}", sphere(10, 1.0)),
        20.0,
    );
    let write = |name: &str, text: &str| std::fs::write(flight.place.path(name), text).unwrap();
    write("sphere.mtl", "newmtl glow\nKd 0 0 0\nKa 0 0 0\nKe 1 1 1\n");
    let (stage, view) = flight.stage(1.0);
    let bare = flight.exact(&stage, &view);
    let lit = |seen: &Seen| matches!(seen, Seen::Surface(_));
    // Every pixel of the path tracer that is not on an edge is black or white.
    let settings = PathTracerSettings {
        length: 20.0,
        tolerance: 1e-8,
        bounces: 2,
        seed: 1,
        estimator: Estimator::Connected,
    };
    let traced = film(&stage, &view, settings, 4);
    let mut agreeing = 0;
    for y in 1..SIZE.1 - 1 {
        for x in 1..SIZE.0 - 1 {
            let around = [(x, y), (x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)];
            let here = lit(&bare[(y, x, 0)]);
            if around.iter().all(|(x, y)| lit(&bare[(*y, *x, 0)]) == here) {
                let light = traced.pixel(x, y).0.y;
                assert!(
                    (light - f64::from(u8::from(here))).abs() < 1e-6,
                    "{x} {y} {light}"
                );
                agreeing += usize::from(here);
            }
        }
    }
    assert!(agreeing > 200, "{agreeing}");
    // A pane that lets nearly everything through, in front: what is behind is where it was.
    write("pane.mtl", "newmtl pane\nKd 0 0 0\nd 0.01\n");
    write(
        "pane.obj",
        "mtllib pane.mtl\nusemtl pane\nv -9 0 -9\nv 9 0 -9\nv 9 0 9\nv -9 0 9\nf 1 2 3\nf 1 3 4\n",
    );
    let scene = std::fs::read_to_string(flight.place.path("scene.toml")).unwrap();
    let pane = "[[object]]\nmesh = 'pane.obj'\nplacement = 'chart'\nat = [0, 2, 0]\nscale = 1\n";
    write("scene.toml", &(scene + pane));
    let drawn = |stage: &Stage, view: &View| {
        let tracer = ExactTracer::new(&stage.world.manifold, view.u, 20.0, 1e-9);
        let paths = Paths::Exact(&tracer);
        draw(
            &stage.world,
            view,
            paths,
            1,
            Footprints::Filtered,
            &no_clock,
        )
        .picture
    };
    let (glazed, glazed_view) = flight.stage(1.0);
    let (before, after) = (drawn(&stage, &view), drawn(&glazed, &glazed_view));
    let mut white = 0;
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (before, after) = (before.pixel(x, y)[1], after.pixel(x, y)[1]);
            white += usize::from(before > 0.9);
            assert!(
                (after - 0.99 * before).abs() < 1e-3,
                "{x} {y} {before} {after}"
            );
        }
    }
    assert!(white > 300, "{white}");
}

/// What is said of a flight that cannot be shown.
fn refusal(space: &str, object: &str, mesh: &str) -> String {
    let camera = "at = [0, 0, 0]\nlook = [0, 1, 0]\nup = [0, 0, 1]";
    let flight = Flight::new(space, camera, object, mesh, 10.0);
    match Stage::load(&flight.place.path("scene.toml"), &[]) {
        Err(error) => error.report(false),
        Ok(_) => panic!("accepted"),
    }
}

#[test]
fn where_light_has_no_time_it_is_said() {
    let mesh = sphere(2, 1.0);
    let path = |path: &str| format!("path = {path}\nduring = [-200, 0]\nscale = 0.1\n");
    let fast = refusal(FLAT, &path("['0', '5', '1.2*t']"), &mesh);
    assert!(fast.contains("not slower than light") && fast.contains("path = "));
    let slow = path("['0', '5', '0.01*t']");
    let lamp = "[[light]]\nkind = 'point'\nat = [1, 1, 1]\nintensity = [1, 1, 1]";
    let lit = refusal(FLAT, &(slow.clone() + lamp), &mesh);
    assert!(
        lit.contains("lamps") && lit.contains("delay = true"),
        "{lit}"
    );
    let string = refusal(&catalogue_text("spinning-string"), &slow, &mesh);
    assert!(string.contains("drift"), "{string}");
    // A fine mesh at seven hundred places.
    let swings = refusal(FLAT, &path("['0.5*sin(t)', '5', '0']"), &sphere(60, 1.0));
    assert!(swings.contains("more evenly"), "{swings}");
}
