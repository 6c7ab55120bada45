//! The path tracer where light changes its frequency, against thermal equilibrium (Tolman and Ehrenfest, 1930: the
//! temperature times the length of the Killing vector of those at rest is the same everywhere) and against itself.

mod support;

use geofan_light::{
    cache::{self, LightmapSource},
    path_tracer::{Estimator, PassAccumulator, PathTracerSettings},
};
use geofan_render::{
    ExactTracer, Stage, View,
    drawing::draw,
    frame::{Paths, no_clock},
    redshift::blackbody,
    shade::Footprints,
};
use glam::DVec3;
use support::{Place, film, mean};

/// Walls at x = −1 and x = 1 of a space that is glued along y and z; the frequency of light depends on x alone.
const SPACE: &str = "name = 'between walls'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1.2 + 0.1*x' }\nwind = ['0.2 + 0.1*x', '0.15', '0.05*x']\nlapse = 'exp(0.2*x)'\n[domain]\nx = [-2, 2]\ny = [-1, 1]\nz = [-1, 1]\nperiodic = ['y', 'z']\n[cameras]\nlength = 60\n";

const WALL: &str =
    "mtllib wall.mtl\nusemtl m\ns off\nv 0 -1 -1\nv 0 1 -1\nv 0 1 1\nv 0 -1 1\nf 1 2 3\nf 1 3 4\n";

/// Metric (a factor of lengths), wind and lapse of [`SPACE`].
fn medium(x: f64) -> (f64, DVec3, f64) {
    let wind = DVec3::new(0.2 + 0.1 * x, 0.15, 0.05 * x);
    (1.2 + 0.1 * x, wind, f64::exp(0.2 * x))
}

/// The square of the length of the Killing vector `∂_t + u ∂_y` at `x`.
fn killing(x: f64, u: f64) -> f64 {
    let (factor, wind, lapse) = medium(x);
    let past = (DVec3::new(0.0, u, 0.0) - wind) * factor;
    lapse * lapse * (1.0 - past.length_squared())
}

fn stage(place: &Place) -> Stage {
    Stage::load(&place.path("scene.toml"), &[]).unwrap_or_else(|e| panic!("{}", e.report(false)))
}

fn settings(estimator: Estimator, length: f64) -> PathTracerSettings {
    PathTracerSettings {
        seed: 7,
        length,
        tolerance: 1e-6,
        bounces: u32::MAX,
        estimator,
    }
}

/// A wall at `x`: its material, and what its object says besides its place.
type Wall = (f64, String, String);

/// A wall of albedo `albedo` that moves with `u` along y and is as hot as others and light between them.
fn grey_wall(x: f64, albedo: f64, u: f64) -> Wall {
    let emitted = (1.0 - albedo) / killing(x, u).powi(2);
    let material = format!("newmtl m\nKd {albedo}\nKe {emitted}\nillum 1\n");
    (x, material, format!("velocity = [0, {u}, 0]\n"))
}

/// The space between two walls.
fn furnace(walls: [Wall; 2]) -> Place {
    let mut scene = String::from(
        "manifold = 'space.toml'\nredshift = true\n[camera]\nat = [0.3, 0.1, -0.2]\nlook = [1, 0.2, 0.1]\nup = [0, 0, 1]\nfov = 100\n",
    );
    let mut files = vec![("space.toml".to_string(), SPACE.to_string())];
    for (name, (x, material, more)) in ["left", "right"].into_iter().zip(walls) {
        files.push((format!("{name}.mtl"), material));
        files.push((format!("{name}.obj"), WALL.replace("wall", name)));
        scene += &format!(
            "[[object]]\nmesh = '{name}.obj'\nplacement = 'chart'\nat = [{x}, 0, 0]\n{more}"
        );
    }
    files.push(("scene.toml".to_string(), scene));
    let files: Vec<(&str, &str)> = files.iter().map(|(n, t)| (&n[..], &t[..])).collect();
    Place::with(&files)
}

/// The frequency that the normal observer at the camera of a [`furnace`] measures of light that he sees at a pixel, as a
/// multiple of that of the same light at rest where the Killing vector of walls that move with `u` has the length 1.
fn shift(view: &View, u: f64, x: usize, y: usize) -> f64 {
    let (factor, wind, lapse) = medium(view.u.x);
    // The light goes against the line of sight.
    let d = -view.direction(x as f64 + 0.5, y as f64 + 0.5);
    let share = 1.0 + factor * d.dot(wind);
    let momentum = factor * d.y / share;
    1.0 / (lapse * share * (1.0 - u * momentum))
}

#[test]
fn in_equilibrium_light_is_as_hot_as_tolman_says_whatever_walls_reflect_and_however_they_move() {
    for (albedo, u) in [(0.6, 0.0), (0.6, 0.35)] {
        let walls = [-1.0, 1.0].map(|x| grey_wall(x, albedo, u));
        let stage = stage(&furnace(walls));
        let view = stage.view(&stage.scene.camera, (10, 10)).unwrap();
        let expected = |x: usize, y: usize| shift(&view, u, x, y).powi(4);
        for estimator in [Estimator::Connected, Estimator::Scattered] {
            let film = film(&stage, &view, settings(estimator, 60.0), 40);
            let (mut sum, mut variance) = (0.0, 0.0);
            let mut extremes = [f64::INFINITY, 0.0];
            for (x, y) in (0..100).map(|i| (i % 10, i / 10)) {
                let (mean, of_mean) = film.pixel(x, y);
                let should = expected(x, y);
                extremes = [extremes[0].min(should), extremes[1].max(should)];
                sum += mean.y / should / 100.0;
                variance += of_mean.y / (should * should) / 1e4;
            }
            let error = variance.sqrt();
            assert!(extremes[1] > 1.5 * extremes[0], "{extremes:?}");
            assert!(error < 0.02, "{estimator:?}, {u}: error {error}");
            // Middles of pixels stand for pixels.
            assert!(
                (sum - 1.0).abs() < 4.0 * error + 5e-3,
                "{estimator:?}, {u}: {sum} ± {error}"
            );
        }
    }
}

#[test]
fn light_of_a_glowing_wall_that_a_white_one_reflects_has_the_colour_of_the_glowing_one() {
    // A black wall that glows, and one that reflects all light: there is equilibrium between them.
    let (u, kelvin) = (0.35, 3000.0);
    let local = kelvin / killing(-1.0, u).sqrt();
    let glowing = (
        -1.0,
        "newmtl m\nKd 0\nillum 1\n".to_string(),
        format!("velocity = [0, {u}, 0]\ntemperature = '{local} + 0*x'\n"),
    );
    let white = (
        1.0,
        "newmtl m\nKd 1\nillum 1\n".to_string(),
        format!("velocity = [0, {u}, 0]\n"),
    );
    let stage = stage(&furnace([glowing, white]));
    // Towards the white wall.
    let view = stage.view(&stage.scene.camera, (10, 10)).unwrap();
    let middle = |film: &PassAccumulator, c: usize| {
        let (mut sum, mut variance) = (0.0, 0.0);
        for (x, y) in (0..100).map(|i| (i % 10, i / 10)) {
            let (mean, of_mean) = film.pixel(x, y);
            let should = f64::from(blackbody(kelvin * shift(&view, u, x, y))[c]);
            sum += mean[c] / should / 100.0;
            variance += of_mean[c] / (should * should) / 1e4;
        }
        (sum, variance.sqrt())
    };
    for estimator in [Estimator::Connected, Estimator::Scattered] {
        let film = film(&stage, &view, settings(estimator, 60.0), 40);
        for c in 0..3 {
            let (mean, error) = middle(&film, c);
            let off = (mean - 1.0).abs();
            assert!(error < 0.02, "{estimator:?}, {c}: {error}");
            assert!(
                off < 4.0 * error + 5e-3,
                "{estimator:?}, {c}: {mean} ± {error}"
            );
        }
    }
}

#[test]
fn a_small_glowing_body_lights_a_floor_as_one_that_shines_with_its_colour_and_with_little_noise() {
    let body =
        "mtllib lamp.mtl\nusemtl m\ns off\nv 1 0 0\nv -0.5 0.8 0.1\nv -0.5 -0.8 0.2\nf 1 2 3\n";
    let lamp = |more: &str| {
        format!(
            "[[object]]\nmesh = 'lamp.obj'\nplacement = 'chart'\nat = [0.1, 0.2, 0.6]\nscale = 0.05\n{more}"
        )
    };
    let [r, g, b] = blackbody(9000.0);
    let ke = format!("newmtl m\nKd 0\nKe {r} {g} {b}\nillum 1\n");
    let dark = "newmtl m\nKd 0\nillum 1\n";
    let stage = |more: &str, material: &str| {
        // Floor and body are at rest, where lapse and wind are such that frequencies differ.
        let mut stage = floor(
            0.0,
            &lamp(more),
            &[("lamp.obj", body), ("lamp.mtl", material)],
        );
        stage.world.redshift = false;
        stage
    };
    let (shining, error_of_shining) = direct(&stage("", &ke), 40);
    let (glowing, error) = direct(&stage("temperature = '9000 + 0*x'\n", dark), 40);
    assert!(error < 0.02 * glowing, "{glowing} ± {error}");
    let off = (glowing - shining).abs();
    assert!(
        off < 4.0 * error.hypot(error_of_shining),
        "{glowing}, {shining}"
    );
}

const LAMP: &str = "[[light]]\nkind = 'point'\nat = [0.1, 0.2, 0.6]\nintensity = [1, 1, 1]\n";

/// A floor that moves, in a spacetime at rest around (0.1, 0.2, 0.6), where a lamp is.
fn floor(velocity: f64, light: &str, more: &[(&str, &str)]) -> Stage {
    let space = "name = 'above a floor'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1.1 + 0.1*z' }\nwind = ['0.3*(z - 0.6)', '0.2*(z - 0.6)', '0']\nlapse = 'exp(0.5*z)'\n[cameras]\nlength = 8\n";
    let square = "mtllib floor.mtl\nusemtl m\ns off\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3\nf 1 3 4\n";
    let scene = format!(
        "manifold = 'space.toml'\nredshift = true\n[camera]\nat = [-0.7, 0.1, 0.3]\nlook = [0.7, 0, -0.8]\nup = [0, 0, 1]\nfov = 40\n[[object]]\nmesh = 'floor.obj'\nplacement = 'chart'\nat = [0, 0, -0.5]\nvelocity = [{velocity}, -0.3, 0]\n{light}"
    );
    let mut files = vec![
        ("space.toml", space),
        ("floor.obj", square),
        ("floor.mtl", "newmtl m\nKd 0.6\nillum 1\n"),
        ("scene.toml", &scene),
    ];
    files.extend_from_slice(more);
    let place = Place::with(&files);
    stage(&place)
}

/// The mean of a picture of direct light (green), and its error.
fn direct(stage: &Stage, passes: u64) -> (f64, f64) {
    let view = stage.view(&stage.scene.camera, (12, 8)).unwrap();
    let settings = PathTracerSettings {
        bounces: 1,
        ..settings(Estimator::Connected, 8.0)
    };
    mean(&film(stage, &view, settings, passes), 0..12, 0..8)
}

#[test]
fn a_lamp_is_as_bright_as_a_small_surface_at_rest_where_it_is() {
    let (point, _) = direct(&floor(0.45, LAMP, &[]), 4);
    // An octahedron with edges of √2 h has the surface 4 √3 h² and sends a quarter of it in the mean of all directions; the
    // metric makes it (1.1 + 0.1 z)² as large.
    let half: f64 = 0.02;
    let surface = 4.0 * 3.0_f64.sqrt() * (half * (1.1 + 0.06)).powi(2);
    let body = "mtllib lamp.mtl\nusemtl m\ns off\nv 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\nf 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n";
    // Turned about many axes, it is as bright as from all directions.
    let mut areas = Vec::new();
    for (k, axis) in ["1, 0.3, 0.2", "0.2, 1, 0.5", "-0.4, 0.3, 1", "1, -1, 0.3"]
        .into_iter()
        .enumerate()
    {
        let degrees = 37 + 50 * k;
        let light = format!(
            "[[object]]\nmesh = 'lamp.obj'\nplacement = 'chart'\nat = [0.1, 0.2, 0.6]\nscale = {half}\nrotate = {{ axis = [{axis}], degrees = {degrees} }}\n"
        );
        let material = format!("newmtl m\nKd 0\nKe {}\nillum 1\n", 4.0 / surface);
        let stage = floor(0.45, &light, &[("lamp.obj", body), ("lamp.mtl", &material)]);
        areas.push(direct(&stage, 60));
    }
    let area = areas.iter().map(|(mean, _)| mean).sum::<f64>() / areas.len() as f64;
    let error = areas.iter().map(|(_, error)| error * error).sum::<f64>();
    let error = error.sqrt() / areas.len() as f64;
    assert!(error < 0.02 * area, "{error} of {area}");
    // From one direction an octahedron shows 0.8 to 1.15 times as much as in the mean.
    let off = (area / point - 1.0).abs();
    assert!(off < 0.06 + 4.0 * error / area, "{area} ± {error}, {point}");
}

#[test]
fn kept_light_is_of_the_motion_of_surfaces_also_where_nobody_asks_for_frequencies() {
    let place = Place::with(&[]);
    let path = place.path("scene.light");
    let source = |velocity: f64| {
        let mut stage = floor(velocity, LAMP, &[]);
        stage.world.redshift = false;
        cache::light(&stage.world, 8.0, 1e-6, Some(&path), |_, _| {}).1
    };
    assert_eq!(source(0.45), LightmapSource::Computed);
    assert_eq!(source(0.1), LightmapSource::Outdated);
    assert_eq!(source(0.1), LightmapSource::File);
}

#[test]
fn what_the_camera_sees_first_is_as_in_a_drawing() {
    let manifold = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/manifolds/schwarzschild-river.toml"
    );
    // Glowing matter in orbit, and a plain surface beside it that shines.
    let square = "v 1 1 0\nv -1 1 0\nv -1 -1 0\nv 1 -1 0\nf 1 2 3\nf 1 3 4\n";
    let shining = format!("mtllib shining.mtl\nusemtl m\n{square}");
    let scene = format!(
        "manifold = '{manifold}'\nredshift = true\n[camera]\nat = [9, 2, 5]\nlook = [-4, -1.5, -5]\nup = [0, 0, 1]\nfov = 50\nvelocity = [0.1, 0.2, 0]\n[sky]\nsky = {{ pattern = \"grid\" }}\n[[object]]\nmesh = 'square.obj'\nplacement = 'chart'\nat = [6, 1, 0]\nscale = 1.5\ntemperature = '5000 + 300*x'\nvelocity = ['-y/(x^2 + y^2)^0.75', 'x/(x^2 + y^2)^0.75', 0]\n[[object]]\nmesh = 'shining.obj'\nplacement = 'chart'\nat = [3, -2, 1]\n"
    );
    let place = Place::with(&[
        ("square.obj", square),
        ("shining.obj", &shining),
        ("shining.mtl", "newmtl m\nKd 0\nKe 0.7 0.6 0.5\nillum 1\n"),
        ("scene.toml", &scene),
    ]);
    let stage = stage(&place);
    let view = stage.view(&stage.scene.camera, (24, 16)).unwrap();
    let tracer = ExactTracer::new(&stage.world.manifold, view.u, 400.0, 1e-7);
    let paths = Paths::Exact(&tracer);
    let drawn = draw(
        &stage.world,
        &view,
        paths,
        25,
        Footprints::Points,
        &no_clock,
    )
    .picture;
    let film = film(&stage, &view, settings(Estimator::Connected, 400.0), 25);
    // Both are means of random samples, of blocks of pixels.
    let mut bright = 0;
    for (left, top) in (0..24).map(|i| (i % 6 * 4, i / 6 * 4)) {
        let (mut sum, mut should, mut variance) = (DVec3::ZERO, DVec3::ZERO, 0.0);
        for (x, y) in (0..16).map(|i| (left + i % 4, top + i / 4)) {
            let (mean, of_mean) = film.pixel(x, y);
            sum += mean;
            should += DVec3::from_array(drawn.pixel(x, y).map(f64::from));
            variance += of_mean.max_element();
        }
        let off = (sum - should).abs().max_element();
        let most = 0.01 * should.max_element() + 5.0 * f64::sqrt(2.0 * variance);
        assert!(
            off <= most + 2e-3,
            "({left}, {top}): {sum} ± {}, {should}",
            variance.sqrt()
        );
        bright += i32::from(should.max_element() > 0.1);
    }
    assert!(bright >= 6, "{bright}");
}
