//! Light in a wind against closed forms: rotating frames, rivers, Gödel's universe, spinning strings,
//! warp drives. Numbers without a source were computed by 40-digit quadrature or by two independent
//! integrators of null geodesics in four dimensions.

mod support;

use geofan_core::{
    geodesic::{End, Path, Ray, Settings, Step, elapsed, paths, signed_area},
    manifold::Manifold,
    random::Stream,
};
use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::{PI, SQRT_2, TAU};
use support::{asset, manifold, settings};

const TOLERANCE: f64 = 1e-13;

/// The path seen from `u` in the direction `d`, over `length` whatever is in its way.
fn path(manifold: &Manifold, u: DVec3, d: DVec3, length: f64) -> Path {
    let ray = Ray::new(manifold, u, d.normalize(), length);
    paths(manifold, settings(TOLERANCE, false), [ray]).remove(0)
}

fn last(path: &Path) -> &Step {
    assert_eq!(path.end, End::Length);
    path.steps.last().unwrap()
}

fn end(path: &Path) -> DVec3 {
    last(path).position(path.length)
}

/// Frequency seen over frequency sent by normal observers at both ends of a line of sight.
fn redshift(manifold: &Manifold, path: &Path) -> f64 {
    let frequency = |step: &Step, s: f64| {
        let (u, v) = (step.position(s), step.tangent(s));
        manifold.normal_frequency(u, manifold.sight(u, v))
    };
    frequency(&path.steps[0], 0.0) / frequency(last(path), path.length)
}

#[track_caller]
fn assert_near(found: DVec3, expected: DVec3, within: f64) {
    let off = (found - expected).length();
    assert!(off < within, "{found} is {off:.1e} from {expected}");
}

const TURNING: &str =
    "metric = { conformal = '1' }\nwind = ['w*y', '-w*x', '0']\n[parameters]\nw = 0.7\n";

/// Points and directions off every plane, from slow places to where the frame turns faster than light.
fn starts() -> [(DVec3, DVec3); 3] {
    [
        (DVec3::new(0.3, -0.2, 0.5), DVec3::new(0.4, 0.8, -0.3)),
        (DVec3::new(-1.9, 0.7, 0.1), DVec3::new(-0.5, 0.1, 0.7)),
        (DVec3::new(3.0, -7.3, 0.4), DVec3::new(0.2, -0.9, 0.6)),
    ]
}

#[test]
fn in_a_turning_frame_light_goes_straight_in_the_frame_that_does_not_turn() {
    let turning = manifold(TURNING);
    let forward = turning.forward().unwrap();
    for (u, d) in starts() {
        let d = d.normalize();
        let s = 3.0;
        for (space, sign) in [(&turning, 1.0), (&*forward, -1.0)] {
            let path = path(space, u, d, s);
            let turn = DMat3::from_rotation_z(sign * 0.7 * s);
            assert_near(end(&path), turn * (u + d * s), 1e-10);
            // Everything carried stays as it was in that frame: directions, polarisation, area.
            let frame = DMat3::from_quat(last(&path).rotation(s).unwrap());
            for e in d.any_orthonormal_pair().into_iter_with(d) {
                assert_near(frame * e, turn * e, 1e-9);
            }
            let local = space.local_frame(end(&path));
            let columns = last(&path).deviation(s).unwrap();
            let area = signed_area(&local, last(&path).tangent(s), columns);
            assert!((area / (s * s) - 1.0).abs() < 1e-9);
        }
    }
}

/// A pair of vectors and a third.
trait With {
    fn into_iter_with(self, third: DVec3) -> [DVec3; 3];
}

impl With for (DVec3, DVec3) {
    fn into_iter_with(self, third: DVec3) -> [DVec3; 3] {
        [self.0, self.1, third]
    }
}

#[test]
fn observers_at_rest_in_a_turning_frame_see_the_same_paths_at_the_same_times() {
    // λ = 1 - w²ρ², h = (λ + W W)/λ², b = -W/λ.
    let langevin = manifold(
        "metric = { xx = '(q + (w*y)^2)/q^2', yy = '(q + (w*x)^2)/q^2', zz = '1/q', xy = '-w^2*x*y/q^2' }
        drift = ['-w*y/q', 'w*x/q', '0']
        [parameters]\nw = 0.3\n[let]\nq = '1 - w^2*(x^2 + y^2)'\n",
    );
    let forward = langevin.forward().unwrap();
    let (u, d) = (DVec3::new(0.4, -0.7, 0.2), DVec3::new(-0.6, 0.3, 0.5));
    let path = path(&forward, u, d, 2.5);
    let ray = Ray::new(&forward, u, d.normalize(), 2.5);
    let wind = DVec3::new(0.3 * u.y, -0.3 * u.x, 0.0);
    let velocity = ray.v / forward.time_rate(u, ray.v);
    let (n, t) = (velocity - wind, elapsed(&forward, &path, 2.5));
    assert!((n.length() - 1.0).abs() < 1e-14);
    let turn = DMat3::from_rotation_z(-0.3 * t);
    assert_near(end(&path), turn * (u + n * t), 1e-11);
    // Polarisation: across the direction of sight of either observer, up to multiples of the tangent.
    let across = |g: DMat3, v: DVec3, e: DVec3| e - v * (e.dot(g * v) / v.dot(g * v));
    let (g, v) = (forward.metric(end(&path)), last(&path).tangent(2.5));
    let carried = forward.standard_frame(end(&path))
        * DMat3::from_quat(last(&path).rotation(2.5).unwrap())
        * forward.standard_frame(u).inverse();
    let (e, _) = n.any_orthonormal_pair();
    let unit = |e: DVec3| e / e.dot(g * e).sqrt();
    let expected = unit(across(g, v, turn * e));
    let found = unit(carried * across(forward.metric(u), ray.v, e));
    assert_near(found, expected, 1e-10);
}

/// The rays seen from the x axis at `r` under the angle `angle` from the way to the centre.
fn tilted(angle: f64) -> DVec3 {
    DVec3::new(-angle.cos(), angle.sin(), 0.0)
}

/// The angle at which rays begin to escape, by bisection.
fn edge(space: &Manifold, u: DVec3, length: f64, direction: impl Fn(f64) -> DVec3) -> f64 {
    let sky = End::Exit(space.exit_named("sky").unwrap());
    let settings = Settings::bare(1e-12).with_events();
    let (mut low, mut high) = (1e-3, PI - 1e-3);
    // As many rays as the integrator has lanes, then the interval between two of them.
    while high - low > 1e-11 {
        let width = (high - low) / 31.0;
        let angle = |k: u32| low + width * f64::from(k);
        let rays = (0..32).map(|k| Ray::new(space, u, direction(angle(k)), length));
        let ends: Vec<End> = paths(space, settings, rays).iter().map(|p| p.end).collect();
        let first = ends.iter().position(|end| *end == sky).unwrap();
        (low, high) = (angle(first as u32 - 1), angle(first as u32));
    }
    0.5 * (low + high)
}

#[test]
fn falling_observers_see_the_shadow_grow_through_the_horizon() {
    let rain = asset("schwarzschild-rain");
    // sin α = (3√3/r)(1 - √(2/r) cos α)
    for (r, degrees) in [
        (10.0, 17.3241986566),
        (6.0, 24.2034283393),
        (3.0, 35.2643896828),
        (1.5, 46.8783738823),
        (0.5, 62.7927334184),
    ] {
        let tilt = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.4, 1.1, -0.6));
        let u = tilt * DVec3::new(r, 0.0, 0.0);
        let found = edge(&rain, u, 300.0, |angle| tilt * tilted(angle)).to_degrees();
        assert!((found - degrees).abs() < 3e-9, "{r}: {found} {degrees}");
    }
}

/// The angle about z that `path` sweeps.
fn swept(path: &Path) -> f64 {
    let mut sum = 0.0;
    for step in &path.steps {
        for k in 0..8 {
            let at = |k: f64| step.position(step.start + (step.end - step.start) * k / 8.0);
            let (a, b) = (
                at(f64::from(k)).truncate(),
                at(f64::from(k) + 1.0).truncate(),
            );
            sum += a.perp_dot(b).atan2(a.dot(b));
        }
    }
    sum
}

#[test]
fn the_river_bends_light_as_the_hole_does() {
    let text = std::fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/manifolds/schwarzschild-river.toml"
    ));
    let text = text.unwrap().replace("r - 45*M", "r - 50*M");
    let source = geofan_core::diagnostic::SourceText::new("river", text);
    let river = Manifold::from_source(source, &[]).unwrap();
    for (b, angle) in [
        (6.0, 4.6204187268812),
        (10.0, 3.3293558649459),
        (20.0, 2.5554529686639),
    ] {
        // b = r sin θ/(1 + W·n), where the line of sight meets the wind the other way round.
        let u = DVec3::new(50.0, 0.0, 0.0);
        let momentum = |angle: f64| 50.0 * angle.sin() / river.share(u, tilted(angle));
        let (mut low, mut high) = (0.0, 0.5 * PI);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if momentum(middle) < b {
                low = middle;
            } else {
                high = middle;
            }
        }
        let ray = Ray::new(&river, u, tilted(low), 400.0);
        let path = paths(&river, settings(TOLERANCE, true), [ray]).remove(0);
        assert_eq!(path.end.name(&river), "sky");
        let found = swept(&path);
        assert!((found - angle).abs() < 1e-9, "{b}: {found} {angle}");
    }
}

#[test]
fn light_in_goedels_universe_comes_back_and_time_has_passed() {
    let goedel = asset("goedel");
    let forward = goedel.forward().unwrap();
    let mut stream = Stream::new(&[11]);
    for _ in 0..6 {
        let u = DVec3::from_array([0; 3].map(|_| stream.between(-0.8, 0.8)));
        let d = stream.direction();
        let v = (1.0 - d.z * d.z).sqrt();
        // A circle of radius ρ in the plane of constant curvature, tanh ρ = v/√2.
        let rho = (v / SQRT_2).atanh();
        let round = TAU * rho.sinh() / v;
        let closed = path(&forward, u, d, round);
        assert_near(end(&closed), u + DVec3::Z * (d.z * round), 1e-9);
        let t = elapsed(&forward, &closed, round);
        let expected = round - TAU * SQRT_2 * (rho.cosh() - 1.0);
        assert!((t - expected).abs() < 1e-9, "{t} {expected}");
        // Half of the distance between two points of the circle.
        let s = 0.37 * round;
        let at = end(&path(&forward, u, d, s));
        let chord = 1.0
            + ((at.y - u.y).powi(2) / 2.0 + ((-at.x).exp() - (-u.x).exp()).powi(2))
                / (2.0 * (-at.x - u.x).exp());
        let expected = rho.sinh() * (v * s / (2.0 * rho.sinh())).sin().abs();
        assert!(((0.5 * chord.acosh()).sinh() - expected).abs() < 1e-9);
    }
    let flat = path(&forward, DVec3::ZERO, DVec3::new(0.3, -0.5, 0.0), TAU);
    assert!((elapsed(&forward, &flat, TAU) - 2.602580569137).abs() < 1e-10);
    let start = DVec3::new(0.3, -0.7, 0.2);
    let known = path(&forward, start, DVec3::new(0.3, -0.5, 0.6), 2.5);
    assert_near(
        end(&known),
        DVec3::new(1.32060203, -0.45934405, 1.99284291),
        1e-8,
    );
}

#[test]
fn a_spinning_string_delays_light_and_bends_it_as_one_at_rest() {
    let string = asset("spinning-string").forward().unwrap().into_owned();
    let cone = string.still();
    for (u, d) in [
        (DVec3::new(1.2, 0.4, -0.3), DVec3::new(-0.9, -0.1, 0.2)),
        (DVec3::new(-0.3, 1.5, 0.1), DVec3::new(0.5, -0.8, -0.4)),
    ] {
        let (found, still) = (path(&string, u, d, 4.0), path(&cone, u, d, 4.0));
        assert_near(end(&found), end(&still), 1e-10);
        let late = elapsed(&string, &found, 4.0) - 4.0;
        let expected = -4.0 * 0.1 * swept(&found);
        assert!((late - expected).abs() < 1e-10, "{late} {expected}");
    }
}

#[test]
fn a_warp_drive_crowds_the_sky_ahead() {
    let drive = asset("alcubierre");
    let u = DVec3::new(0.05, 0.02, -0.03);
    for (degrees, expected, g) in [
        (
            0.0,
            [20.420958461919, -0.109093788676, 0.163640683014],
            Some(2.9985906085),
        ),
        (
            40.0,
            [18.211577695314, 4.280057834566, 3.373558739986],
            Some(2.4407447114),
        ),
        (
            80.0,
            [13.391135068006, 6.324604935271, 4.740019202944],
            None,
        ),
        (
            120.0,
            [8.524056391283, 5.912810660785, 4.282436393633],
            Some(0.2738958433),
        ),
    ] {
        let angle = f64::to_radians(degrees);
        let d = DVec3::new(angle.cos(), 0.8 * angle.sin(), 0.6 * angle.sin());
        let found = path(&drive, u, d, 8.0);
        assert_near(end(&found), expected.into(), 1e-9);
        if let Some(g) = g {
            let found = redshift(&drive, &found);
            assert!((found - g).abs() < 1e-9, "{found} {g}");
        }
    }
    // From behind, light comes across the bubble's way at last, as red as can be.
    let behind = path(&drive, u, DVec3::new(-0.9, 0.3, 0.2), 40.0);
    let far = last(&behind);
    let n = drive.sight(end(&behind), far.tangent(40.0));
    assert!((n.x + 0.5).abs() < 0.02, "{n}");
    assert!(redshift(&drive, &behind) < 1e-3);
}

#[test]
fn along_the_axis_of_a_warp_drive_light_takes_its_time() {
    let drive = asset("alcubierre");
    // Ahead, a line of sight runs at the speed 1 + v (1 - f).
    let f = |x: f64| {
        let (x, size) = (x.abs(), (4.0 * 2.0_f64).tanh());
        ((4.0 * (x + 2.0)).tanh() - (4.0 * (x - 2.0)).tanh()) / (2.0 * size)
    };
    let (steps, from, to) = (40_000, 0.05, 12.0);
    let h = (to - from) / f64::from(steps);
    let slowness = |x: f64| 1.0 / (1.0 + 2.0 * (1.0 - f(x)));
    let mut time = 0.0;
    for k in 0..steps {
        let x = from + h * f64::from(k);
        time += h / 6.0 * (slowness(x) + 4.0 * slowness(x + 0.5 * h) + slowness(x + h));
    }
    let found = path(&drive, DVec3::X * from, DVec3::X, time);
    assert_near(end(&found), DVec3::X * to, 1e-10);
}

#[test]
fn areas_there_and_back_differ_by_the_square_of_what_observers_see() {
    let kerr = asset("kerr");
    let forward = kerr.forward().unwrap();
    let mut stream = Stream::new(&[5]);
    for _ in 0..8 {
        let u = stream.direction() * stream.between(5.0, 12.0);
        // Past the hole, not into it.
        let d = (stream.direction() - u.normalize()).normalize();
        let there = path(&forward, u, d, 9.0);
        let (at, v) = (end(&there), last(&there).tangent(9.0));
        let back_ray = kerr.local_frame(at).direction(-v);
        let back = path(&kerr, at, back_ray, 9.0);
        assert_near(end(&back), u, 1e-8);
        let area = |space: &Manifold, path: &Path| {
            let step = last(path);
            let columns = step.deviation(9.0).unwrap();
            signed_area(&space.local_frame(end(path)), step.tangent(9.0), columns)
        };
        let ratio = area(&forward, &there) / area(&kerr, &back);
        let share = |u: DVec3, v: DVec3| forward.share(u, forward.sight(u, v));
        let start = Ray::new(&forward, u, d, 9.0);
        let expected = (share(at, v) / share(u, start.v)).powi(2);
        assert!((ratio / expected - 1.0).abs() < 1e-6, "{ratio} {expected}");
    }
}
