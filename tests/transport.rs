//! Parallel transport along given curves, the exponential map and its differential.

mod support;

use geofan_core::{
    geodesic::{Ray, Transport, carry, exponential, paths, transport},
    manifold::{ChartCurve, Manifold},
    random::Stream,
};
use glam::{DMat3, DVec3};
use std::f64::consts::{PI, TAU};
use support::{asset, catalogue, manifold, random_point, settings};

fn turn_of(matrix: DMat3) -> f64 {
    // cos θ = (tr − 1)/2
    let trace = matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z;
    ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos()
}

#[test]
fn a_vector_taken_round_a_circle_of_latitude_turns_by_the_area_inside() {
    // In the plane z = 0 of S³: the circle of radius θ bounds the area 2π (1 − cos θ).
    let sphere = asset("s3");
    for theta in [0.4, 1.0, 1.5, 2.2] {
        let r = (theta / 2.0_f64).tan();
        let x = format!("{r}*cos(t)");
        let y = format!("{r}*sin(t)");
        let curve = ChartCurve::parse(&sphere, "t", [&x, &y, "0"]).unwrap();
        let round = transport(&sphere, |t| curve.at(t), [0.0, TAU], 1e-13).unwrap();
        let (axis, angle) = round.rotation.to_axis_angle();
        let expected = TAU * (1.0 - theta.cos());
        let off = (axis.z.signum() * angle - expected).rem_euclid(TAU);
        assert!(off.min(TAU - off) < 1e-11, "{theta}: {angle} {expected}");
        assert!(axis.z.abs() > 1.0 - 1e-14);
        // The normal of the plane stays parallel.
        let normal = round.vector(DVec3::Z);
        assert!((normal - DVec3::Z).length() < 1e-13);
    }
}

#[test]
fn a_curve_may_have_its_kink_where_it_ends() {
    let sphere = asset("s3");
    let curve = |y: &str| ChartCurve::parse(&sphere, "t", ["t", y, "0"]).unwrap();
    let straight = curve("t");
    let straight = transport(&sphere, |t| straight.at(t), [0.0, 1.0], 1e-12).unwrap();
    for y in ["min(t, 1)", "1 - abs(t - 1)"] {
        let kinked = curve(y);
        let found = transport(&sphere, |t| kinked.at(t), [0.0, 1.0], 1e-12).unwrap();
        let off = (straight.rotation.inverse() * found.rotation)
            .xyz()
            .length();
        assert!(off < 1e-9, "{y}: {off}");
    }
}

#[test]
fn a_cone_turns_vectors_by_its_missing_angle_whatever_the_curve() {
    // A closed curve round the axis of a cone, in its plane: 2π (1 − k), k = 0.8.
    let cone = asset("cone");
    let wobbly = ["(2 + sin(3*t))*cos(t)", "(2 + sin(3*t))*sin(t)", "0"];
    let curve = ChartCurve::parse(&cone, "t", wobbly).unwrap();
    let round = transport(&cone, |t| curve.at(t), [0.0, TAU], 1e-13).unwrap();
    let turn = turn_of(DMat3::from_quat(round.rotation));
    assert!((turn - TAU * 0.2).abs() < 1e-11, "{turn}");
}

/// Transport by the classical Runge–Kutta method on ẇ = −Γ(u̇, w).
fn by_christoffel(
    manifold: &Manifold,
    curve: &ChartCurve,
    mut w: DVec3,
    [from, to]: [f64; 2],
    steps: u32,
) -> DVec3 {
    let h = (to - from) / f64::from(steps);
    let rate = |t: f64, w: DVec3| {
        let (u, v) = curve.at(t);
        manifold.curvature(u).unwrap().parallel_rate(v, w)
    };
    for i in 0..steps {
        let t = from + h * f64::from(i);
        let k1 = rate(t, w);
        let k2 = rate(t + h / 2.0, w + k1 * (h / 2.0));
        let k3 = rate(t + h / 2.0, w + k2 * (h / 2.0));
        let k4 = rate(t + h, w + k3 * h);
        w += (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0);
    }
    w
}

#[test]
fn transport_agrees_with_christoffel_symbols_along_any_curve() {
    for name in [
        "three-bumps",
        "nil",
        "sl2r",
        "sol",
        "torus-s1xs2",
        "schwarzschild",
    ] {
        let manifold = asset(name);
        let curve = ["2 + 0.3*sin(2*t)", "1 - 0.4*t^2", "0.2*exp(t) - 0.5"];
        let curve = ChartCurve::parse(&manifold, "t", curve).unwrap();
        let way = [-0.7, 0.9];
        let carried = transport(&manifold, |t| curve.at(t), way, 1e-13).unwrap();
        let back = transport(&manifold, |t| curve.at(t), [way[1], way[0]], 1e-13).unwrap();
        for w in DVec3::AXES {
            let off = |steps| {
                let other = by_christoffel(&manifold, &curve, w, way, steps);
                (carried.vector(w) - other).length() / w.length()
            };
            let errors = [off(100), off(200)];
            // What differs is the other method's error, of order four.
            assert!(
                (13.0..20.0).contains(&(errors[0] / errors[1])),
                "{name}: {errors:?}"
            );
            assert!(off(1600) < 1e-11, "{name}: {}", off(1600));
            assert!((back.vector(carried.vector(w)) - w).length() < 1e-11);
            assert!(
                (carried.matrix() * w - carried.vector(w)).length() < 1e-14 * w.length() * 10.0
            );
        }
    }
}

#[test]
fn the_frame_of_a_path_is_the_one_transported_along_it() {
    let [mut stream, mut winds, mut glued] = [21, 22, 23].map(|key| Stream::new(&[key]));
    for name in catalogue() {
        let asset = asset(&name).cover().into_owned();
        if asset.has_wind() {
            follow_and_transport(&name, &asset, &mut winds, |space, curve, s| {
                carry(space, curve, [0.0, s], 1e-11).unwrap()
            });
        } else {
            let stream = match asset.glued().gluing() {
                Some(_) => &mut glued,
                None => &mut stream,
            };
            follow_and_transport(&name, &asset, stream, |space, curve, s| {
                transport(space, curve, [0.0, s], 1e-11).unwrap()
            });
        }
    }
}

/// Compares the frame that a random path carries with the one that `along` makes of its curve.
fn follow_and_transport(
    name: &str,
    manifold: &Manifold,
    stream: &mut Stream,
    along: impl Fn(&Manifold, &dyn Fn(f64) -> (DVec3, DVec3), f64) -> Transport,
) {
    let (u, d) = (random_point(manifold, stream), stream.direction());
    let length = manifold.length.unwrap_or(6.0).min(4.0);
    let ray = Ray::new(manifold, u, d, length);
    let path = paths(manifold, settings(1e-12, true), [ray]).remove(0);
    let curve = |s: f64| {
        let step = path.step_at(s).unwrap();
        (step.position(s), step.tangent(s))
    };
    // A curve of quintic pieces: what its third derivative jumps by is small.
    let carried = along(manifold, &curve, path.length);
    let step = path.steps.last().unwrap();
    let own = step.rotation(path.length).unwrap();
    let off = 2.0 * (own.inverse() * carried.rotation).xyz().length();
    assert!(off < 1e-8, "{name}: {off}");
    let end = step.position(path.length);
    let sight = carried.vector(manifold.sight(ray.u, ray.v));
    let g = manifold.metric(end);
    let off = sight - manifold.sight(end, step.tangent(path.length));
    assert!(off.dot(g * off).sqrt() < 1e-8, "{name}");
}

#[test]
fn a_curve_that_leaves_the_manifold_is_refused() {
    // Finite at the points that are probed on loading.
    let pole = manifold(
        "metric = { conformal = '1/x' }\n[domain]\nx = [0, 9]\n[cameras]\nat = ['1', '0', '0']",
    );
    let curve = ChartCurve::parse(&pole, "t", ["1 - t", "t", "0"]).unwrap();
    let failed = transport(&pole, |t| curve.at(t), [0.0, 2.0], 1e-10).unwrap_err();
    assert!(failed.at() > 0.9 && failed.at() <= 1.0, "{failed}");
}

#[test]
fn a_curve_knows_the_parameters_and_points_at_what_it_does_not_know() {
    let cone = asset("cone");
    let curve = ChartCurve::parse(&cone, "q", ["k*q", "q^2", "1"]).unwrap();
    assert_eq!(
        curve.at(2.0),
        (DVec3::new(1.6, 4.0, 1.0), DVec3::new(0.8, 4.0, 0.0))
    );
    let (component, error) = ChartCurve::parse(&cone, "t", ["t", "2*q", "1"]).unwrap_err();
    assert_eq!((component, error.span), (1, 2..3));
}

#[test]
fn the_exponential_map_of_the_sphere_wraps_it() {
    let sphere = asset("s3");
    let u = DVec3::new(0.3, -0.2, 0.4);
    let s = sphere.standard_frame(u);
    let d = DVec3::new(0.5, 0.1, -0.7).normalize();
    let half = exponential(&sphere, u, s * d * PI, 1e-12).unwrap();
    assert!((half.point + u / u.length_squared()).length() < 1e-9);
    // At the antipode every direction across has been focused.
    let size = half.differential * (s * d);
    assert!(half.differential.determinant().abs() < 1e-9 * size.length().powi(3));
    let still = exponential(&sphere, u, DVec3::ZERO, 1e-12).unwrap();
    assert_eq!((still.point, still.differential), (u, DMat3::IDENTITY));
}

#[test]
fn the_differential_of_the_exponential_map_is_its_derivative() {
    let mut stream = Stream::new(&[22]);
    for name in [
        "three-bumps",
        "nil",
        "sl2r",
        "h3-half-space",
        "torus-s1xs2",
        "luneburg",
    ] {
        let manifold = asset(name);
        let u = random_point(&manifold, &mut stream);
        let w = manifold.standard_frame(u) * stream.direction() * 1.7;
        let at = |w: DVec3| exponential(&manifold, u, w, 1e-13).unwrap();
        let found = at(w);
        for axis in DVec3::AXES {
            // Richardson's extrapolation of central differences.
            let central = |h: f64| (at(w + axis * h).point - at(w - axis * h).point) / (2.0 * h);
            let expected = (central(1e-3) * 4.0 - central(2e-3)) / 3.0;
            let off = (found.differential * axis - expected).length();
            assert!(off < 1e-8 * expected.length().max(1.0), "{name}: {off}");
        }
        let length = |v: DVec3, u: DVec3| v.dot(manifold.metric(u) * v).sqrt();
        assert!((length(found.velocity, found.point) - length(w, u)).abs() < 1e-11);
    }
}

#[test]
fn the_program_carries_nothing_across_a_jump() {
    let space = format!("{}/assets/manifolds/s3.toml", env!("CARGO_MANIFEST_DIR"));
    let carried = |curve: &str| {
        let mut command = assert_cmd::cargo::cargo_bin_cmd!("geofan");
        let flags = ["--from", "0", "--to", "1", "--vector", "1,0,0"];
        command
            .args(["transport", &space, "--curve", curve])
            .args(flags);
        let output = command.output().unwrap();
        (
            output.status.code(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    // Steps, poles, and the branch of an angle.
    for curve in [
        "if(t < 1/3, 0, 1),0,0",
        "0,tan(5*t),0",
        "atan2(0.2, t - 0.7) - atan2(0.2*(0.6 - t), t - 0.7),0,0",
    ] {
        let (code, said) = carried(curve);
        assert!(code == Some(2) && said.contains("jumps"), "{curve}: {said}");
    }
    // Kinks, steep parts and fast turns are none.
    for curve in [
        "abs(t - 0.3),0,0",
        "0,0.3*tanh(900*(t - 0.4)),0",
        "0,0,0.1*sin(60*t)",
    ] {
        let (code, said) = carried(curve);
        assert!(code == Some(0), "{curve}: {said}");
    }
}
