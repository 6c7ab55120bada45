//! Refraction and total reflection where the metric jumps, against Snell's law, Fermat's principle and
//! neighbouring rays.

mod support;

use geofan_core::{
    geodesic::{End, Path, Ray, exponential, fixed_steps, paths, signed_area},
    manifold::Manifold,
    random::Stream,
};
use glam::{DMat3, DVec3};
use support::{manifold, settings};

/// Follows the ray from `u` in the direction `d` (standard frame).
fn follow(manifold: &Manifold, u: DVec3, d: DVec3, length: f64) -> Path {
    let ray = Ray::new(manifold, u, d.normalize(), length);
    paths(manifold, settings(1e-12, false), [ray]).remove(0)
}

/// Chart point and unit chart direction at the end of a path.
fn arrival(path: &Path) -> (DVec3, DVec3) {
    let step = path.steps.last().unwrap();
    (
        step.position(path.length),
        step.tangent(path.length).normalize(),
    )
}

#[test]
fn a_half_space_refracts_by_snells_law() {
    let glass = manifold("metric = { conformal = 'if(x > 0, 1.5, 1)' }");
    let path = follow(
        &glass,
        DVec3::new(-1.0, 0.2, 0.4),
        DVec3::new(1.0, 1.0, 0.0),
        6.0,
    );
    let (_, v) = arrival(&path);
    let sine = 0.5_f64.sqrt() / 1.5;
    assert!((v.y / v.x - sine / (1.0 - sine * sine).sqrt()).abs() < 1e-11);
    assert!((v.y / v.x - 0.534_522_48).abs() < 1e-8);
    assert!(v.z.abs() < 1e-14);
}

#[test]
fn a_ball_with_an_edge_as_soft_as_an_exponential_function_makes_it_is_left() {
    let ball = |index: &str| {
        manifold(&format!(
            "metric = {{ conformal = '1 + 0.5*{index}' }}\n[[exit]]\nname = 'sky'\nwhen = 'x^2 + y^2 + z^2 - 100'"
        ))
    };
    let sharp = "if(sqrt(x^2 + y^2 + z^2) < 3, 1, 0)";
    let soft = "(1/(1 + exp(((x^2 + y^2 + z^2)^2 - 81)/4)))";
    // From where the exponential function is infinite to where it is again.
    let leaves = |space: &Manifold| {
        let (u, d) = (DVec3::new(8.5, 0.4, 0.3), DVec3::new(-1.0, 0.1, 0.2));
        let ray = Ray::new(space, u, d.normalize(), 40.0);
        let path = paths(space, settings(1e-10, true), [ray]).remove(0);
        assert_eq!(path.end, End::Exit(0));
        arrival(&path)
    };
    let [sharp, soft] = [sharp, soft].map(|index| leaves(&ball(index)));
    assert!(sharp.1.distance(soft.1) < 0.03, "{sharp:?} {soft:?}");
    let straight = DVec3::new(-1.0, 0.1, 0.2).normalize();
    assert!(soft.1.distance(straight) > 0.3);
}

#[test]
fn an_edge_is_told_however_close_an_exit_lies_behind_it() {
    for behind in [0.9, 0.5, 0.3, 0.2, 0.1, 0.05, 0.03, 0.01, 1e-3, 1e-4] {
        let glass = manifold(&format!(
            "metric = {{ conformal = 'if(x > 0, 1.5, 1)' }}\n[[exit]]\nname = 'sky'\nwhen = 'tanh(40*(x - {behind}))'"
        ));
        let (u, d) = (DVec3::new(-1.0, 0.2, 0.4), DVec3::new(1.0, 0.4, 0.1));
        for tolerance in [1e-5, 1e-8, 1e-12] {
            let ray = Ray::new(&glass, u, d.normalize(), 20.0);
            let path = paths(&glass, settings(tolerance, true), [ray]).remove(0);
            assert_eq!(path.end, End::Exit(0));
            assert_eq!(path.edges().count(), 1, "{behind} behind, at {tolerance:e}");
        }
    }
}

#[test]
fn beyond_the_critical_angle_all_light_is_reflected() {
    let glass = manifold("metric = { conformal = 'if(x > 0, 1.5, 1)' }");
    let critical = (1.0 / 1.5_f64).asin();
    let v = |angle: f64| {
        let d = DVec3::new(-angle.cos(), angle.sin() * 0.6, angle.sin() * 0.8);
        let (_, v) = arrival(&follow(&glass, DVec3::new(0.7, 0.1, 0.2), d, 5.0));
        (d, v)
    };
    let (d, back) = v(56.3_f64.to_radians());
    assert!((back - DVec3::new(-d.x, d.y, d.z)).length() < 1e-11);
    let (d, back) = v(critical + 1e-6);
    assert!((back - DVec3::new(-d.x, d.y, d.z)).length() < 1e-11);
    let (d, through) = v(critical - 1e-3);
    assert!(through.x < 0.0 && (through.y / (1.5 * d.y) - 1.0).abs() < 1e-10);
}

#[test]
fn the_component_along_an_anisotropic_surface_stays() {
    let glass = manifold(
        "metric = { xx = '1', yy = 'if(x > 0, 4, 1)', zz = '1', xy = 'if(x > 0, 0.3, 0)' }",
    );
    let d = DVec3::new(0.7, 0.5, -0.2).normalize();
    let path = follow(&glass, DVec3::new(-0.8, 0.0, 0.1), d, 4.0);
    let (u, _) = arrival(&path);
    let v = path.steps.last().unwrap().tangent(path.length);
    let p = glass.metric(u) * v;
    assert!((p.y - d.y).abs() < 1e-11 && (p.z - d.z).abs() < 1e-11);
    assert!((v.dot(p) - 1.0).abs() < 1e-11 && v.x > 0.0);
}

/// A ball of index 1.5 and radius 1 about `centre`.
fn ball(centre: DVec3) -> Manifold {
    let DVec3 { x, y, z } = centre;
    manifold(&format!(
        "metric = {{ conformal = 'if((x - {x})^2 + (y - {y})^2 + (z - {z})^2 < 1, 1.5, 1)' }}"
    ))
}

#[test]
fn a_ball_deflects_as_the_closed_form_says_wherever_it_stands() {
    let mut stream = Stream::new(&[11]);
    for b in [0.0, 0.1, 0.3, 0.5, 0.8, 0.95, 0.999] {
        let centre = DVec3::new(
            stream.between(-2.0, 2.0),
            stream.between(-2.0, 2.0),
            stream.between(-2.0, 2.0),
        );
        let axes = DMat3::from_quat(stream.rotation());
        let (d, across) = (axes.x_axis, axes.y_axis);
        let path = follow(&ball(centre), centre - d * 3.0 + across * b, d, 9.0);
        let (_, v) = arrival(&path);
        let found = d.cross(v).length().atan2(d.dot(v));
        let expected = 2.0 * (b.asin() - (b / 1.5).asin());
        assert!((found - expected).abs() < 1e-9, "{b}: {found}, {expected}");
        assert!(path.tried < 120, "{b}: {} steps", path.tried);
    }
    for (b, degrees) in [(0.3_f64, 11.8413), (0.5, 21.0575), (0.8, 41.7983)] {
        let expected = 2.0 * (b.asin() - (b / 1.5).asin());
        assert!((expected.to_degrees() - degrees).abs() < 1e-4);
    }
}

#[test]
fn layers_much_thinner_than_a_step_are_not_missed() {
    for thickness in [0.5, 0.03, 1e-3] {
        let pane = manifold(&format!(
            "metric = {{ conformal = 'if(abs(x - 7.3) < {}, 1.7, 1)' }}",
            0.5 * thickness
        ));
        let d = DVec3::new(0.6, 0.8, 0.0);
        let path = follow(&pane, DVec3::new(0.0, 0.0, 0.3), d, 60.0);
        let (u, v) = arrival(&path);
        // The same direction, moved aside.
        let inside = (0.8_f64 / 1.7).asin();
        let aside = thickness * (0.8 / 0.6 - inside.tan());
        let off = u.y - u.x * 0.8 / 0.6;
        assert!((v - d).length() < 1e-11, "{thickness}");
        assert!((off + aside).abs() < 1e-10, "{thickness}: {off}, {aside}");
    }
    // Chords of a ball that a step spans.
    let centre = DVec3::new(11.0, 0.0, 0.0);
    for b in [0.9, 0.99, 0.9999] {
        let path = follow(&ball(centre), DVec3::new(0.0, b, 0.0), DVec3::X, 40.0);
        let (_, v) = arrival(&path);
        let expected = 2.0 * (f64::asin(b) - (b / 1.5).asin());
        assert!((v.y.atan2(v.x) + expected).abs() < 1e-8, "{b}");
    }
}

/// A ray through balls of one index by plain geometry: the straight line between surfaces of the set
/// where all of `balls` (centre, radius) overlap, Snell's law in vectors on them.
fn snell(
    balls: &[(DVec3, f64)],
    index: f64,
    mut u: DVec3,
    mut d: DVec3,
    path: f64,
) -> (DVec3, DVec3) {
    let within = |u: DVec3| balls.iter().all(|(c, r)| (u - *c).length() < *r);
    let mut left = path;
    loop {
        let inside = within(u + d * 1e-9);
        let n = if inside { index } else { 1.0 };
        // The nearest surface behind which the medium is another.
        let hits = balls.iter().flat_map(|(c, r)| {
            let (b, q) = ((u - *c).dot(d), (u - *c).length_squared() - r * r);
            let root = (b * b - q).sqrt();
            [-b - root, -b + root].map(|t| (t, *c))
        });
        let hits = hits.filter(|(t, _)| *t > 1e-9 && within(u + d * (t + 1e-9)) != inside);
        let Some((t, c)) = hits.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            return (u + d * (left / n), d);
        };
        if t * n > left {
            return (u + d * (left / n), d);
        }
        (u, left) = (u + d * t, left - t * n);
        let normal = (u - c).normalize();
        let normal = normal * -normal.dot(d).signum();
        let ratio = if inside { index } else { 1.0 / index };
        let cosine = -normal.dot(d);
        let square = 1.0 - ratio * ratio * (1.0 - cosine * cosine);
        d = match square < 0.0 {
            true => d + normal * (2.0 * cosine),
            false => d * ratio + normal * (ratio * cosine - square.sqrt()),
        };
    }
}

#[test]
fn a_lens_of_two_balls_agrees_with_ray_by_ray_snell() {
    let balls = [
        (DVec3::new(-0.8, 0.1, 0.0), 1.3),
        (DVec3::new(0.9, -0.1, 0.2), 1.4),
    ];
    let squares = balls.map(|(c, r): (DVec3, f64)| {
        format!(
            "(x - {})^2 + (y - {})^2 + (z - {})^2 - {}",
            c.x,
            c.y,
            c.z,
            r * r
        )
    });
    let lens = manifold(&format!(
        "metric = {{ conformal = 'if(max({}, {}) < 0, 1.6, 1)' }}",
        squares[0], squares[1]
    ));
    let mut stream = Stream::new(&[5]);
    let (mut bent, mut worst) = (0, 0.0_f64);
    for _ in 0..200 {
        let u = DVec3::new(-3.0, stream.between(-0.5, 0.5), stream.between(-0.5, 0.5));
        let aim = DVec3::new(0.0, stream.between(-1.0, 1.0), stream.between(-1.0, 1.0));
        let d = (aim - u).normalize();
        let path = follow(&lens, u, d, 8.0);
        if path.end == End::Singular {
            continue;
        }
        let ((found, v), (expected, w)) = (arrival(&path), snell(&balls, 1.6, u, d, 8.0));
        bent += usize::from((w - d).length() > 1e-3);
        worst = worst.max((found - expected).length()).max((v - w).length());
    }
    assert!(bent > 80, "{bent}");
    assert!(worst < 1e-9, "{worst}");
}

/// Media whose geometry jumps, with a ray that meets the jump off every symmetry plane.
fn jumping() -> Vec<(Manifold, DVec3, DVec3)> {
    let ray = (DVec3::new(-1.6, 0.4, -0.1), DVec3::new(0.9, -0.2, 0.15));
    let texts = [
        "metric = { conformal = 'if(x > 0.3*y + 0.2*z^2, 1.5, 1)' }",
        "metric = { conformal = 'if(x^2 + y^2 + z^2 < 1, 1.5 + 0.2*x, 1 + 0.1*y)' }",
        "metric = { xx = '1', yy = 'if(x > 0.1*y^2, 4, 1)', zz = '1 + 0.1*x', xy = 'if(x > 0.1*y^2, 0.3, 0)' }",
        "metric = { conformal = '2 + atan2(x, -y - 3)/4' }",
    ];
    let mut cases: Vec<_> = texts
        .iter()
        .map(|text| (manifold(text), ray.0, ray.1))
        .collect();
    // From glass against its surface, beyond the critical angle.
    let reflecting = manifold("metric = { conformal = 'if(x < 0.1*y^2, 1.5 + 0.1*z, 1)' }");
    cases.push((reflecting, ray.0, DVec3::new(0.5, -0.8, 0.3)));
    cases
}

#[test]
fn deviations_behind_an_edge_are_those_of_neighbouring_rays() {
    for (case, (manifold, u, d)) in jumping().into_iter().enumerate() {
        let ray = Ray::new(&manifold, u, d.normalize(), 4.0);
        let w = ray.v * ray.length;
        let at = |w: DVec3| exponential(&manifold, u, w, 1e-13).unwrap();
        let found = at(w).differential;
        for axis in DVec3::AXES {
            let central = |h: f64| (at(w + axis * h).point - at(w - axis * h).point) / (2.0 * h);
            let expected = (central(1e-3) * 4.0 - central(2e-3)) / 3.0;
            let off = (found * axis - expected).length() / expected.length();
            assert!(off < 1e-6, "case {case}, {axis}: {off}");
        }
    }
}

#[test]
fn carried_frames_turn_with_the_tangent_and_keep_their_angles() {
    for (case, (manifold, u, d)) in jumping().into_iter().enumerate() {
        let path = follow(&manifold, u, d, 4.0);
        let step = path.steps.last().unwrap();
        let (end, v) = (step.position(path.length), step.tangent(path.length));
        let seen = step.rotation(path.length).unwrap() * d.normalize();
        let direction = manifold.local_frame(end).direction(v);
        assert!((seen - direction).length() < 1e-10, "case {case}");
    }
}

/// The time from `a` to `b` in a steady wind: `|b − a − W t| = n t`.
fn travel_time(a: DVec3, b: DVec3, wind: DVec3, index: f64) -> f64 {
    let way = b - a;
    let speed = 1.0 / index;
    let (p, q) = (way.dot(wind), speed * speed - wind.length_squared());
    // q t² + 2 p t − |way|² = 0
    (-p + (p * p + q * way.length_squared()).sqrt()) / q
}

#[test]
fn a_jump_of_wind_refracts_by_fermats_principle() {
    // Lines of sight run against the wind.
    let wind = DVec3::new(0.1, 0.25, -0.2);
    let air = manifold(&format!(
        "metric = {{ conformal = 'if(x > 0, 1.3, 1)' }}\nwind = ['if(x > 0, {}, 0)', 'if(x > 0, {}, 0)', 'if(x > 0, {}, 0)']",
        wind.x, wind.y, wind.z
    ));
    let u = DVec3::new(-0.9, 0.3, 0.1);
    let path = follow(&air, u, DVec3::new(0.8, 0.3, 0.45), 3.0);
    let (end, _) = arrival(&path);
    assert!(end.x > 0.2);
    let time = |y: f64, z: f64| {
        let edge = DVec3::new(0.0, y, z);
        travel_time(u, edge, DVec3::ZERO, 1.0) + travel_time(edge, end, -wind, 1.3)
    };
    // Newton's method for the stationary point of the time.
    let (mut y, mut z) = (0.5, 0.5);
    for _ in 0..60 {
        let h = 1e-4;
        let slope = |f: &dyn Fn(f64) -> f64| (f(h) - f(-h)) / (2.0 * h);
        let bend = |f: &dyn Fn(f64) -> f64| (f(h) - 2.0 * f(0.0) + f(-h)) / (h * h);
        let along_y = |e: f64| time(y + e, z);
        let dy = slope(&along_y) / bend(&along_y);
        let along_z = |e: f64| time(y, z + e);
        let dz = slope(&along_z) / bend(&along_z);
        (y, z) = (y - 0.7 * dy, z - 0.7 * dz);
    }
    let edge = path
        .steps
        .iter()
        .map(|step| step.position(step.end))
        .min_by(|a, b| a.x.abs().total_cmp(&b.x.abs()))
        .unwrap();
    assert!((time(y, z) - 3.0).abs() < 1e-10, "{}", time(y, z));
    assert!(
        (edge - DVec3::new(0.0, y, z)).length() < 1e-6,
        "{edge} {y} {z}"
    );
}

#[test]
fn a_jump_in_the_formula_alone_changes_nothing() {
    let cut = manifold("metric = { conformal = '1.5 + 0.2*cos(atan2(x, -y - 3))' }");
    let plain = manifold("metric = { conformal = '1.5 - 0.2*(y + 3)/sqrt(x^2 + (y + 3)^2)' }");
    let end = |m: &Manifold| {
        arrival(&follow(
            m,
            DVec3::new(-1.6, 0.4, -0.1),
            DVec3::new(0.9, -0.2, 0.15),
            4.0,
        ))
    };
    let ((a, v), (b, w)) = (end(&cut), end(&plain));
    assert!((a - b).length() < 1e-11 && (v - w).length() < 1e-11);
}

#[test]
fn a_path_along_an_edge_ends_and_its_neighbours_are_right() {
    let ball = ball(DVec3::ZERO);
    let end = |b: f64| follow(&ball, DVec3::new(-3.0, b, 0.0), DVec3::X, 7.0);
    for depth in [1e-9, 1e-11, 1e-13] {
        assert_eq!(end(1.0 - depth).end, End::Singular, "{depth}");
    }
    let (_, beside) = arrival(&end(1.0 + 1e-7));
    assert!((beside - DVec3::X).length() < 1e-13);
    let b = 1.0 - 1e-7;
    let (_, within) = arrival(&end(b));
    let expected = 2.0 * (b.asin() - (b / 1.5).asin());
    assert!((within.y.atan2(within.x) + expected).abs() < 1e-8);
}

#[test]
fn equal_steps_are_refracted_too() {
    for (case, (manifold, u, d)) in jumping().into_iter().enumerate() {
        let (expected, _) = arrival(&follow(&manifold, u, d, 4.0));
        let ray = Ray::new(&manifold, u, d.normalize(), 4.0);
        let off = |steps: usize| {
            let knots = fixed_steps::<f64>(&manifold, &[(ray.u, ray.v)], 4.0, steps);
            (knots[0].0[steps] - expected).length()
        };
        assert!(off(64) < 1e-4, "case {case}: {}", off(64));
        assert!(off(1024) < 1e-8, "case {case}: {}", off(1024));
    }
}

/// Conditions on what jumps itself say nothing about where its surface is.
#[test]
fn a_ball_told_by_masks_is_the_ball() {
    let tellings = [
        "if(r2 < 1, 1.5, 1)",
        "if(if(r2 < 1, 1, 0) > 0.5, 1.5, 1)",
        "if(if(r2 < 1, 1, 0) >= 1, 1.5, 1)",
        "max(1, if(r2 < 1, 1.5, 0.3))",
        "min(1.5, if(r2 < 1, 9, 1))",
        "abs(if(r2 < 1, 1.5, -1))",
        "1 + 0.5*max(if(r2 < 1, 1, 0), if((x - 9)^2 + y^2 + z^2 < 1, 1, 0))",
    ];
    let followed = tellings.map(|index| {
        let ball = format!("metric = {{ conformal = '{index}' }}\n[let]\nr2 = 'x^2 + y^2 + z^2'");
        let ball = manifold(&ball);
        let path = follow(
            &ball,
            DVec3::new(-3.0, 0.5, 0.0),
            DVec3::new(1.0, 0.025, 0.02),
            7.0,
        );
        let ((u, v), last) = (arrival(&path), path.steps.last().unwrap());
        let spread = last.deviation(path.length).unwrap();
        let area = signed_area(&ball.local_frame(u), last.tangent(path.length), spread);
        ((u, v), area)
    });
    let ((u, v), area) = followed[0];
    assert!(u.x > 2.0, "{u}");
    for (told, ((other, w), other_area)) in tellings.iter().zip(followed) {
        assert!(
            (other - u).length() < 1e-10 && (w - v).length() < 1e-10,
            "{told}: {other} {u}"
        );
        assert!(
            (other_area / area - 1.0).abs() < 1e-6,
            "{told}: {other_area} {area}"
        );
    }
}

/// An exit is where its condition becomes positive, also where that is zero before.
#[test]
fn an_exit_may_be_zero_before_it_is_met() {
    let conditions = [
        "r2 - 15",
        "max(r2 - 15, 0)",
        "if(r2 < 15, 0, 1)",
        "r2 - 15 + abs(r2 - 15)",
    ];
    let lengths = conditions.map(|when| {
        let space = manifold(&format!(
            "metric = {{ conformal = '1 + 0.3*exp(-r2)' }}\n[let]\nr2 = 'x^2 + y^2 + z^2'\n\
             [[exit]]\nname = 'sky'\nwhen = '{when}'"
        ));
        let ray = Ray::new(
            &space,
            DVec3::new(0.1, 0.2, -0.3),
            DVec3::new(0.6, 0.64, 0.48),
            20.0,
        );
        let path = paths(&space, settings(1e-12, true), [ray]).remove(0);
        assert!(matches!(path.end, End::Exit(_)), "{when}: {:?}", path.end);
        path.length
    });
    for (when, length) in conditions.iter().zip(lengths) {
        assert!(
            (length - lengths[0]).abs() < 1e-11,
            "{when}: {length} {}",
            lengths[0]
        );
    }
}
