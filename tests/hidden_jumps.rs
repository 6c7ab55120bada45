//! Metrics that jump without an `if`, and layers so thin that no stage of a step lies in them: paths keep what they
//! must keep. And light beside the edge between two faces of glass.

mod support;

use geofan_core::geodesic::{End, JacobiField, Path, Ray, paths};
use geofan_core::manifold::Manifold;
use glam::DVec3;
use support::{manifold, settings};

/// An index of refraction that depends on x alone, as a formula and as the function that it is.
type Index = (&'static str, fn(f64) -> f64);

const SIGN: fn(f64) -> f64 = |x| 1.25 + 0.25 * x.signum();

const JUMPS: [Index; 11] = [
    ("1.25 + 0.25*x/sqrt(x^2)", SIGN),
    ("1.25 + 0.25*x/abs(x)", SIGN),
    ("1.25 - abs(x)*0.25/(-x)", SIGN),
    ("1.25 + 0.25*sin(x)/abs(sin(x))", |x| SIGN(x.sin())),
    ("1.25 + 0.5*atan(1/x)/pi", |x| {
        1.25 + (1.0 / x).atan() / std::f64::consts::TAU
    }),
    ("1 + 0.5/(1 + exp(1/x))", |x| {
        1.0 + 0.5 / (1.0 + (1.0 / x).exp())
    }),
    ("1.25 + 0.25*tanh(1/x)", |x| 1.25 + 0.25 * (1.0 / x).tanh()),
    ("1.5 + 0.2*atan(tan(2*x))", |x| {
        1.5 + 0.2 * (2.0 * x).tan().atan()
    }),
    ("1.25 + 0.25*tanh(x*1e3)", |x| {
        1.25 + 0.25 * (x * 1e3).tanh()
    }),
    ("1.25 + 0.25*tanh(x*1e6)", |x| {
        1.25 + 0.25 * (x * 1e6).tanh()
    }),
    ("1.25 + 0.25*tanh(x*1e9)", |x| {
        1.25 + 0.25 * (x * 1e9).tanh()
    }),
];

/// Places beside the jump with directions: into glass and out of it, steep, shallow and reflected.
const RAYS: [([f64; 3], [f64; 3]); 5] = [
    ([-1.0, 0.3, 0.0], [1.0, 1.0, 0.0]),
    ([1.0, 0.0, 0.0], [-1.0, 1.2, 0.0]),
    ([-1.0, 0.1, 0.2], [1.0, -0.01, 0.05]),
    ([1.0, 0.1, 0.2], [-1.0, 0.3, -0.2]),
    ([-1.0, 0.1, 0.2], [0.5, 1.2, 0.3]),
];

fn follow(manifold: &Manifold, at: DVec3, direction: DVec3, length: f64, tolerance: f64) -> Path {
    let ray = Ray::new(manifold, at, direction.normalize(), length);
    paths(manifold, settings(tolerance, false), [ray]).remove(0)
}

/// Where the index depends on x alone, n² v_y stays (Snell's law).
#[test]
fn rays_are_refracted_and_reflected_however_a_jump_is_written() {
    for (formula, index) in JUMPS {
        let space = manifold(&format!("metric = {{ conformal = '{formula}' }}"));
        for (at, direction) in RAYS.map(|(at, d)| (DVec3::from(at), DVec3::from(d))) {
            for tolerance in [1e-6, 1e-10] {
                let path = follow(&space, at, direction, 3.0, tolerance);
                assert_eq!(path.end, End::Length, "{formula}: {at} {direction}");
                let (n, last) = (index(at.x), path.steps.last().unwrap());
                let kept = n * direction.normalize().y;
                let (u, v) = (last.position(3.0), last.tangent(3.0));
                let off = (index(u.x).powi(2) * v.y - kept).abs();
                assert!(
                    off < 30.0 * tolerance,
                    "{formula}: {at} {direction}: {off:e}"
                );
            }
        }
    }
}

/// The area to which light has spread changes little from beside an edge of a cube of glass to the edge itself, and not at
/// once beside the rim of a lens.
#[test]
fn light_beside_the_edge_of_a_surface_spreads_as_farther_away() {
    let cube = "if(max(max(abs(x), abs(y)), abs(z)) < 0.5, 1.5, 1)";
    let lens = "if(min(4 - ((x - 1.5)^2 + y^2 + z^2), 4 - ((x + 1.5)^2 + y^2 + z^2)) > 0, 1.6, 1)";
    let rim = DVec3::new(0.0, 1.75_f64.sqrt(), 0.0);
    let inwards = [DVec3::X, -DVec3::Y];
    let cases = [
        (
            cube,
            DVec3::new(-1.0, -1.0, 0.0),
            DVec3::new(-0.5, -0.5, 0.02),
            inwards[0],
            1.5,
        ),
        (lens, DVec3::new(-3.0, 0.2, 0.1), rim, inwards[1], 4.5),
    ];
    for (formula, at, edge, inwards, length) in cases {
        let space = manifold(&format!("metric = {{ conformal = '{formula}' }}"));
        let area = |off: f64| {
            let path = follow(&space, at, edge + inwards * off - at, length, 1e-10);
            let last = path.steps.last().unwrap();
            let inverse = space.standard_frame(last.position(length)).inverse();
            let spread = last.deviation(length).unwrap();
            JacobiField::new(inverse, last.tangent(length), spread).signed_area()
        };
        let beside = area(1e-4);
        for off in [1e-7, 1e-6, 1e-5] {
            let change = area(off) / beside - 1.0;
            assert!(change.abs() < 3e-3, "{formula}: {off:e}: {change:e}");
        }
    }
}
