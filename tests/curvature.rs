//! Curvature against closed forms, at random points off every symmetry plane.

mod support;

use geofan_core::{manifold::Curvature, random::Stream};
use glam::{DMat3, DVec3};
use num_dual::{DualNum, second_derivative};
use support::{asset, catalogue, manifold, random_point, worse};

/// Curvature of `name` at ten random points, with the points.
fn at_random_points(name: &str) -> Vec<(DVec3, Curvature)> {
    let manifold = asset(name);
    let mut stream = Stream::new(&[name.len() as u64, 5]);
    (0..10)
        .map(|_| random_point(&manifold, &mut stream))
        .map(|u| (u, manifold.curvature(u).unwrap()))
        .collect()
}

/// The Ricci curvature in an orthonormal frame, its eigenvalues in order.
fn principal(curvature: &Curvature, name: &str, u: DVec3) -> [f64; 3] {
    let s = asset(name).standard_frame(u);
    let m = s.transpose() * curvature.ricci * s;
    // Jacobi's rotations, plenty of them.
    let mut m = m;
    for _ in 0..20 {
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let angle = 0.5 * (2.0 * m.col(j)[i]).atan2(m.col(j)[j] - m.col(i)[i]);
            let mut q = DMat3::IDENTITY;
            (q.col_mut(i)[i], q.col_mut(j)[j]) = (angle.cos(), angle.cos());
            (q.col_mut(j)[i], q.col_mut(i)[j]) = (angle.sin(), -angle.sin());
            m = q.transpose() * m * q;
        }
    }
    let mut values = [m.x_axis.x, m.y_axis.y, m.z_axis.z];
    values.sort_by(f64::total_cmp);
    values
}

#[track_caller]
fn close(name: &str, found: f64, expected: f64) {
    let off = (found - expected).abs() / expected.abs().max(1.0);
    assert!(off < 1e-9, "{name}: {found} instead of {expected}");
}

#[test]
fn spaces_of_constant_curvature_have_it_in_every_plane() {
    let known = [
        ("flat", 0.0),
        ("flat-torus", 0.0),
        ("rolled-sheet", 0.0),
        ("s3", 1.0),
        ("s3-graph", 1.0),
        ("h3-ball", -1.0),
        ("h3-half-space", -1.0),
    ];
    let mut stream = Stream::new(&[3]);
    for (name, k) in known {
        for (_, found) in at_random_points(name) {
            close(name, found.scalar, 6.0 * k);
            let plane = (stream.direction(), stream.direction());
            close(name, found.sectional(plane.0, plane.1), k);
            let ricci = found.inverse * found.ricci - DMat3::IDENTITY * (2.0 * k);
            assert!(
                ricci.to_cols_array().iter().all(|x| x.abs() < 1e-9),
                "{name}"
            );
        }
    }
}

#[test]
fn thurstons_other_geometries_have_the_known_principal_curvatures() {
    // A circle bundle over a surface of curvature κ whose connection has curvature 1: base planes
    // have κ − 3/4, planes with the fibre 1/4 (B. O'Neill, Michigan Math. J. 13 (1966) 459).
    let known = [
        ("s2xr", [0.0, 1.0, 1.0]),
        ("h2xr", [-1.0, -1.0, 0.0]),
        ("nil", [-0.5, -0.5, 0.5]),
        ("sol", [-2.0, 0.0, 0.0]),
        ("sl2r", [-1.5, -1.5, 0.5]),
    ];
    for (name, expected) in known {
        for (u, found) in at_random_points(name) {
            close(name, found.scalar, expected.iter().sum());
            for (a, b) in principal(&found, name, u).into_iter().zip(expected) {
                close(name, a, b);
            }
        }
    }
}

/// `r, r', r''` of a space `dl² + r(l)² dΩ²`.
type Radius = [f64; 3];

/// Planes with the radius have −r''/r, planes across it (1 − r'²)/r².
fn check_spherical(name: &str, radius: impl Fn(f64) -> Radius) {
    for (u, found) in at_random_points(name) {
        let [r, first, second] = radius(u.length());
        let (a, b) = across(u);
        close(name, found.sectional(u, a), -second / r);
        close(name, found.sectional(u, a + b * 0.3), -second / r);
        close(name, found.sectional(a, b), (1.0 - first * first) / (r * r));
        let scalar = 2.0 * (1.0 - first * first - 2.0 * r * second) / (r * r);
        close(name, found.scalar, scalar);
    }
}

/// Two unit vectors across `u` and each other.
fn across(u: DVec3) -> (DVec3, DVec3) {
    u.normalize().any_orthonormal_pair()
}

#[test]
fn wormholes_are_curved_by_their_radius_as_a_function_of_distance() {
    check_spherical("ellis-wormhole", |p| {
        let l = p - 0.25 / p;
        let r = (l * l + 1.0).sqrt();
        [r, l / r, 1.0 / r.powi(3)]
    });
    check_spherical("interstellar-wormhole", |p| {
        let (l, a, m) = (p - 0.25 / p, 0.005, 0.05 / 1.42953);
        let x = 2.0 * (l.abs() - a) / (std::f64::consts::PI * m);
        if x < 0.0 {
            return [1.0, 0.0, 0.0];
        }
        let slope = 2.0 / std::f64::consts::PI;
        let r = 1.0 + m * (x * x.atan() - (1.0 + x * x).ln() / 2.0);
        // r'² only: its sign is that of l.
        [r, slope * x.atan(), slope * slope / m / (1.0 + x * x)]
    });
}

#[test]
fn space_around_a_hole_and_a_monopole_are_curved_as_known() {
    // Space around a Schwarzschild hole of mass ½: −M/r³ with the radius, 2M/r³ across, scalar 0.
    for (u, found) in at_random_points("flamm-paraboloid") {
        let rho = u.length();
        let r = rho * (1.0 + 0.25 / rho).powi(2);
        let (a, b) = across(u);
        close("flamm", found.sectional(u, a), -0.5 / r.powi(3));
        close("flamm", found.sectional(a, b), 1.0 / r.powi(3));
        close("flamm", found.scalar, 0.0);
    }
    check_spherical("cone", |p| [0.8 * p, 0.8, 0.0]);
}

#[test]
fn a_torus_of_revolution_is_curved_as_its_profile_says() {
    for (u, found) in at_random_points("torus-s1xs2") {
        let r = 3.0 + 0.6 * u.x.cos();
        let (along, sideways) = (u.x.cos() / (0.6 * r), (u.x.cos() / r).powi(2));
        close(
            "torus",
            found.sectional(DVec3::X, DVec3::new(0.0, 0.3, 0.8)),
            along,
        );
        close("torus", found.sectional(DVec3::Y, DVec3::Z), sideways);
        close("torus", found.scalar, 2.0 * (2.0 * along + sideways));
    }
}

/// Scalar curvature of `e^{2φ} δ`, `φ` a function of the radius in `dimensions` of the coordinates:
/// −e^{−2φ} (4 Δφ + 2 |∇φ|²).
fn conformal(
    phi: impl Fn(num_dual::Dual2_64) -> num_dual::Dual2_64,
    r: f64,
    dimensions: f64,
) -> f64 {
    let (value, first, second) = second_derivative(phi, r);
    let laplacian = second + (dimensions - 1.0) * first / r;
    -(-2.0 * value).exp() * (4.0 * laplacian + 2.0 * first * first)
}

#[test]
fn optical_metrics_have_the_curvature_of_their_index() {
    for (u, found) in at_random_points("schwarzschild") {
        let phi = |r: num_dual::Dual2_64| {
            let q = (r * 2.0).recip();
            (q + 1.0).ln() * 3.0 - (-q + 1.0).ln()
        };
        close(
            "schwarzschild",
            found.scalar,
            conformal(phi, u.length(), 3.0),
        );
    }
    for (u, found) in at_random_points("reissner-nordstrom") {
        let phi = |r: num_dual::Dual2_64| {
            let areal = r + 1.0 + (r * 4.0).recip() * 0.36;
            areal.ln() * 2.0 - (r * r - 0.09).ln()
        };
        close("reissner", found.scalar, conformal(phi, u.length(), 3.0));
    }
    for (u, found) in at_random_points("gaussian-lens") {
        let phi = |r: num_dual::Dual2_64| (-(r * r) / 2.0).exp() * 0.5;
        close("lens", found.scalar, conformal(phi, u.length(), 3.0));
    }
    for (u, found) in at_random_points("grin-rod") {
        let phi = |r: num_dual::Dual2_64| (-(r * r) + 1.0).ln() * 0.5 + 1.5_f64.ln();
        close("rod", found.scalar, conformal(phi, u.x.hypot(u.y), 2.0));
    }
    for (u, found) in at_random_points("luneburg") {
        let phi = |r: num_dual::Dual2_64| (-(r * r) + 2.0).ln() * 0.5;
        let r = u.length();
        let expected = if r < 1.0 { conformal(phi, r, 3.0) } else { 0.0 };
        close("luneburg", found.scalar, expected);
    }
    for (u, found) in at_random_points("maxwell-fish-eye") {
        let expected = if u.length() < 1.0 { 6.0 } else { 0.0 };
        close("fish-eye", found.scalar, expected);
    }
}

/// Height, width and centre of a Gaussian.
type Bump = (f64, f64, DVec3);

/// Slope and second derivatives of a sum of Gaussians.
fn bent(bumps: &[Bump], u: DVec3) -> (DVec3, DMat3) {
    let (mut slope, mut bend) = (DVec3::ZERO, DMat3::ZERO);
    for (height, width, centre) in bumps {
        let x = (u - *centre) / (width * width);
        let value = height * (-0.5 * (u - *centre).dot(x)).exp();
        let outer = DMat3::from_cols(x * x.x, x * x.y, x * x.z);
        slope -= x * value;
        bend += (outer - DMat3::IDENTITY * (1.0 / (width * width))) * value;
    }
    (slope, bend)
}

#[test]
fn graphs_obey_the_equation_of_gauss() {
    let bump = vec![(1.0, 1.0, DVec3::ZERO)];
    let three = vec![
        (1.5, 0.9, DVec3::new(1.1, 0.3, -0.4)),
        (1.3, 0.8, DVec3::new(-0.8, 0.9, 0.5)),
        (1.6, 1.0, DVec3::new(-0.2, -1.0, 0.1)),
    ];
    for (name, bumps) in [("gaussian-bump", bump), ("three-bumps", three)] {
        for (u, found) in at_random_points(name) {
            let (slope, bend) = bent(&bumps, u);
            let second = bend * (1.0 / (1.0 + slope.length_squared()).sqrt());
            let ii = |a: usize, b: usize| second.col(a)[b];
            for (a, b, c, d) in indices() {
                let expected = ii(a, c) * ii(b, d) - ii(a, d) * ii(b, c);
                close(name, found.riemann[a][b][c][d], expected);
            }
        }
    }
}

fn indices() -> impl Iterator<Item = (usize, usize, usize, usize)> {
    (0..81).map(|i| (i / 27, i / 9 % 3, i / 3 % 3, i % 3))
}

#[test]
fn the_curvature_of_every_manifold_has_its_symmetries() {
    for name in catalogue() {
        for (_, found) in at_random_points(&name) {
            let r = |a: usize, b: usize, c: usize, d: usize| found.riemann[a][b][c][d];
            let size = indices()
                .map(|(a, b, c, d)| r(a, b, c, d).abs())
                .fold(1.0, worse);
            for (a, b, c, d) in indices() {
                let bianchi = r(a, b, c, d) + r(a, c, d, b) + r(a, d, b, c);
                let faults = [
                    r(a, b, c, d) + r(b, a, c, d),
                    r(a, b, c, d) - r(c, d, a, b),
                    bianchi,
                ];
                for fault in faults {
                    assert!(fault.abs() < 1e-10 * size, "{name}: {fault}");
                }
            }
        }
    }
}

#[test]
fn christoffel_symbols_are_those_of_the_accelerations() {
    let mut stream = Stream::new(&[11]);
    for name in catalogue() {
        let manifold = asset(&name);
        for (u, found) in at_random_points(&name) {
            let v = manifold.standard_frame(u) * stream.direction();
            let input = [
                u.to_array(),
                v.to_array(),
                [0.0; 3],
                [0.0; 3],
                [0.0; 3],
                [0.0; 3],
            ];
            let geodesics = manifold.still();
            let output = geodesics.flow(Default::default()).at(&input.concat());
            let acceleration = DVec3::from_slice(&output[..3]);
            let off = (found.parallel_rate(v, v) - acceleration).length();
            assert!(
                off <= 1e-11 * acceleration.length().max(1.0),
                "{name}: {off}"
            );
            for skew in manifold.connection(u) {
                assert_eq!(skew.transpose(), skew * -1.0, "{name}");
            }
        }
    }
}

#[test]
fn rates_of_parallel_vectors_are_those_of_the_christoffel_symbols() {
    let mut stream = Stream::new(&[23]);
    for name in catalogue() {
        let manifold = asset(&name);
        for (u, curvature) in at_random_points(&name) {
            let v = stream.direction();
            // As long as deviations become, and none.
            let vectors = [1e5 * stream.direction(), DVec3::ZERO];
            let found = manifold.parallel_rates(&[(u, v, vectors)])[0];
            for (w, found) in vectors.into_iter().zip(found) {
                let expected = curvature.parallel_rate(v, w);
                let off = (found - expected).length();
                assert!(
                    off <= 1e-9 * (w.length() + expected.length()),
                    "{name} {off}"
                );
            }
        }
    }
}

#[test]
fn an_embedding_into_sixteen_dimensions_is_measured_as_its_metric() {
    // Three planes turned at rates 1 to 5, and a product of circles: g_ij by hand.
    let components = "'x', 'y', 'z', 'sin(x)', 'cos(x)', 'sin(2*y)', 'cos(2*y)', 'sin(3*z)', \
        'cos(3*z)', 'x*y', 'y*z', 'z*x', 'x^2/2', 'y^2/2', 'z^2/2', 'x*y*z'";
    let manifold = manifold(&format!("embedding = [{components}]"));
    assert_eq!(manifold.ambient, Some(16));
    let u = DVec3::new(0.3, -0.7, 0.5);
    let (x, y, z) = (u.x, u.y, u.z);
    let metric = DMat3::from_cols_array(&[
        2.0 + y * y + z * z + x * x + y * y * z * z,
        x * y + y * z * x * z,
        x * z + y * z * x * y,
        x * y + y * z * x * z,
        5.0 + x * x + z * z + y * y + x * x * z * z,
        y * z + x * z * x * y,
        x * z + y * z * x * y,
        y * z + x * z * x * y,
        10.0 + x * x + y * y + z * z + x * x * y * y,
    ]);
    let off = manifold.metric(u) - metric;
    assert!(off.to_cols_array().iter().all(|x| x.abs() < 1e-13), "{off}");
}

#[test]
fn parameters_that_are_set_change_the_curvature() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds");
    let path = format!("{folder}/cone.toml");
    let settings = [(String::from("k"), 0.6)];
    let cone = geofan_core::manifold::Manifold::load(path.as_ref(), &settings).unwrap();
    let u = DVec3::new(1.0, -2.0, 0.7);
    let (a, b) = across(u);
    let expected = (1.0 - 0.36) / (0.36 * u.length_squared());
    close("cone", cone.curvature(u).unwrap().sectional(a, b), expected);
}
