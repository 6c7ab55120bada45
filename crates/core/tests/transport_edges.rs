//! Parallel transport over edges, where the metric jumps, against soft edges that become narrow.

mod support;

use geofan_core::{
    geodesic::{EdgeFault, TransportFailed, transport},
    manifold::{ChartCurve, Manifold},
};
use glam::{DQuat, DVec3};
use std::f64::consts::TAU;
use support::{asset, manifold};

/// A surface that is bent and in no plane of symmetry.
const SURFACE: &str = "(x + 0.7*y - 0.4*z + 0.3*x^2 - 0.1)";

/// A curve that crosses it twice, slanted, and its interval.
const CURVE: [&str; 3] = ["1.3*cos(t) + 0.2*t", "0.8*sin(t)", "0.3*t - 0.2"];
const WAY: [f64; 2] = [-2.4, 2.1];

fn rotation(space: &Manifold, curve: [&str; 3], way: [f64; 2]) -> DQuat {
    let curve = ChartCurve::parse(space, "t", curve).unwrap();
    let found = transport(space, |t| curve.at(t), way, 1e-12).unwrap();
    found.rotation
}

fn fault(space: &Manifold, curve: [&str; 3], way: [f64; 2]) -> (f64, DVec3, EdgeFault) {
    let curve = ChartCurve::parse(space, "t", curve).unwrap();
    match transport(space, |t| curve.at(t), way, 1e-12) {
        Err(TransportFailed::Edge { at, point, fault }) => (at, point, fault),
        other => panic!("{other:?}"),
    }
}

fn angle(turn: DQuat) -> f64 {
    2.0 * turn.xyz().length().min(1.0).asin()
}

fn apart(a: DQuat, b: DQuat) -> f64 {
    angle(a.inverse() * b)
}

/// Compares a sharp edge with soft ones, whose difference falls with their width.
fn check_limit(space: impl Fn(&str) -> Manifold, sharp: &str, soft: impl Fn(f64) -> String) {
    let sharp = rotation(&space(sharp), CURVE, WAY);
    assert!(angle(sharp) > 0.05);
    let off = |w: f64| apart(sharp, rotation(&space(&soft(w)), CURVE, WAY));
    let [wide, narrow] = [2e-4, 2e-5].map(off);
    assert!(
        wide < 1e-2 && narrow < 0.15 * wide + 1e-9,
        "{wide} {narrow}"
    );
}

#[test]
fn an_edge_between_multiples_of_a_metric_turns_as_soft_ones_do_whatever_their_profile() {
    let twisted = |n: &str| {
        let n = format!("({n})^2");
        manifold(&format!(
            "[metric]\nxx = '{n}*(1 + 0.2*y^2)'\nxy = '0.1*{n}'\nyy = '{n}'\nyz = '{n}*0.3*sin(x)'\nzz = '2*{n}'"
        ))
    };
    let sharp = format!("if({SURFACE} < 0, 1.5, 1 + 0.1*x^2)");
    check_limit(twisted, &sharp, |w| {
        format!("1.5 + (0.1*x^2 - 0.5)*(1 + tanh({SURFACE}/{w}))/2")
    });
    check_limit(twisted, &sharp, |w| {
        format!("1.5 + (0.1*x^2 - 0.5)*(1 + tanh({SURFACE}/{w}))^2/4")
    });
}

#[test]
fn a_fold_turns_as_soft_ones_do() {
    let folded = |h: &str| manifold(&format!("embedding = ['x', 'y', 'z', '{h}']"));
    let soft = |w: f64| format!("0.4*({SURFACE} + sqrt({SURFACE}^2 + {w}^2))");
    check_limit(folded, &format!("0.8*max(0, {SURFACE})"), soft);
}

#[test]
fn a_ball_of_glass_turns_by_its_index_and_the_slope_at_which_it_is_crossed() {
    let ball = asset("glass-ball");
    let found = rotation(&ball, ["1+0.5*cos(t)", "0.5*sin(t)", "0"], [0.0, TAU]);
    // 2 ln n tan α, with cos t = −1/4 where r = 1.
    let expected = 2.0 * 1.5_f64.ln() / 15.0_f64.sqrt();
    assert!((angle(found) - expected).abs() < 1e-12, "{}", angle(found));
    // Begun and ended on the edge, either way round.
    let start = (-0.25_f64).acos();
    for way in [[start, start + TAU], [start + TAU, start]] {
        let found = rotation(&ball, ["1+0.5*cos(t)", "0.5*sin(t)", "0"], way);
        assert!((angle(found) - expected).abs() < 1e-11, "{}", angle(found));
    }
}

#[test]
fn layers_are_found_however_thin_they_are() {
    // The factor rises by e² within the layer, and falls at its end: no turn in all.
    for w in [1e-2, 1e-5, 1e-7] {
        let space = manifold(&format!(
            "metric = {{ conformal = 'exp(if(abs(x - 0.31) < {w}, 1, 0)*(x - 0.31 + {w})/{w})' }}"
        ));
        let found = rotation(&space, ["t", "2*t", "0"], [-1.0, 1.0]);
        // Rounding of the edge's place counts by the steepness within.
        let most = 1e-9 + 1e-12 / w;
        assert!(angle(found) < most, "{w}: {}", angle(found));
        let found = rotation(&space, ["t", "2*t", "0"], [-1.0, 0.31]);
        assert!((angle(found) - 2.0).abs() < most, "{w}: {}", angle(found));
    }
}

#[test]
fn nothing_is_carried_where_soft_edges_disagree() {
    let stretched = manifold("metric = { xx = '1', yy = 'if(x < 0.2, 1, 2)', zz = '1' }");
    let (at, point, why) = fault(&stretched, ["t", "t^2", "0"], [-1.0, 1.0]);
    assert!((at - 0.2).abs() < 1e-12 && (point.y - 0.04).abs() < 1e-12);
    assert_eq!(why, EdgeFault::Profile);
    let ball = asset("glass-ball");
    let along = fault(&ball, ["cos(t)", "sin(t)", "0"], [0.0, 1.0]);
    assert_eq!(along.2, EdgeFault::Along);
    let cube = manifold("metric = { conformal = 'if(max(abs(x), abs(y)) < 1, 2, 1)' }");
    let corner = fault(&cube, ["t", "t", "0.2"], [0.0, 2.0]);
    assert_eq!(corner.2, EdgeFault::Corner);
    assert!((corner.0 - 1.0).abs() < 1e-12);
    // Beside the corner, and in a plane of symmetry, nothing is ambiguous.
    assert!(angle(rotation(&cube, ["t", "0", "0.2"], [0.0, 2.0])) < 1e-12);
    assert!(angle(rotation(&cube, ["t", "t/2", "0"], [0.0, 2.0])) > 0.1);
}
