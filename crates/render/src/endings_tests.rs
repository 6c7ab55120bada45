//! Tests of endings: roots, sixteen paths at once, straight lines.

use super::*;
use geofan_core::{diagnostic::SourceText, manifold::Manifold};
use glam::DVec3;

#[test]
fn the_root_of_a_parabola_is_nearer_than_that_of_its_chord() {
    let f = |t: f64| (t - 0.3) * (t + 2.0);
    let t = root([f(0.0), f(1.0), f(2.0)]);
    assert!((t - 0.3).abs() < 0.005, "{t}");
    // A line is its own chord.
    assert_eq!(root([-1.0, 3.0, 7.0]), 0.25);
}

#[test]
fn pieces_beside_each_other_are_looked_at_at_once() {
    let together: Vec<[usize; 2]> = passed_together(&[3, 4, 5, 6, 9]).collect();
    assert_eq!(together, [[3, 7], [6, 8], [9, 11]]);
}

#[test]
fn what_is_positive_already_or_no_number_begins_at_once() {
    assert_eq!(root([0.5, 1.0, 1.5]), 0.0);
    assert_eq!(root([f64::NAN, 1.0, 2.0]), 0.0);
}

/// Flat space with an exit out of a ball of radius 2.
fn ball() -> Manifold {
    let text = r#"
        name = "flat"
        coordinates = ["x", "y", "z"]
        metric = { conformal = "1" }
        [[exit]]
        name = "sky"
        when = "x^2 + y^2 + z^2 - 4"
    "#;
    let source = SourceText::new("flat.toml", text);
    Manifold::from_source(source, &[]).expect("a manifold")
}

/// The start of a line in direction x.
fn start(l: usize) -> DVec3 {
    DVec3::new(0.0, 0.1 * l as f64, 0.0)
}

/// The arc length at which it leaves the ball.
fn way_out(l: usize) -> f64 {
    (4.0 - start(l).length_squared()).sqrt()
}

#[test]
fn sixteen_paths_end_as_each_by_itself() {
    let manifold = ball();
    let mut finder = EventLocator::new(&manifold);
    // The lower ones are still inside after 1.7.
    let knots: Vec<f64> = (0..=17).map(|k| 0.1 * f64::from(k)).collect();
    let point = |s: f64| {
        let point = each_vector(|c, l| start(l)[c] + if c == 0 { s } else { 0.0 });
        (s, point)
    };
    let tangent = |_| each_vector(|c, _| f64::from(c == 0));
    let together = finder.endings_of_sixteen((1, 17), |i| point(knots[i]), tangent);
    let parted = finder.endings_of_sixteen((17, 1), |i| point(knots[i]), tangent);
    assert_eq!(together, parted);
    for (l, ending) in together.into_iter().enumerate() {
        let s = way_out(l);
        match ending {
            Ending::Exit { exit, s: at, sky } => {
                assert_eq!((exit, sky), (0, DVec3::X));
                assert!((at - s).abs() < 2e-3, "{at} {s}");
            }
            other => assert!(other == Ending::Length && s > 1.7),
        }
    }
}

#[test]
fn straight_lines_end_where_they_leave_however_long_they_are() {
    let manifold = ball();
    let mut finder = EventLocator::new(&manifold);
    let starts = each_vector(|c, l| start(l)[c]);
    let tangents = each_vector(|c, _| f64::from(c == 0));
    for length in [8.0, 64.0] {
        let endings = finder.endings_of_lines((&starts, &tangents), (length, length as usize));
        for (l, ending) in endings.into_iter().enumerate() {
            let Ending::Exit { exit, s, sky } = ending else {
                panic!("{ending:?}");
            };
            assert_eq!((exit, sky), (0, DVec3::X));
            assert!((s - way_out(l)).abs() < 1e-3, "{s} {}", way_out(l));
        }
    }
}
