//! How far light gets from a point.
//!
//! In: a point of a manifold. Out: a length beyond which nothing placed around the point along geodesics
//! is seen: geodesics in many directions are followed until they leave the space, or are as long as its
//! paths are.

use crate::lookup::fibonacci_direction;
use geofan_core::{
    geodesic::{End, Ray, Settings, Sink, Step, follow},
    manifold::{Carried, Manifold},
};
use glam::DVec3;

/// Geodesics that are followed: neighbours are 0.2 rad apart.
const DIRECTIONS: usize = 256;

/// Between them the space may go on by so much: a corner of a box at 0.1 rad from a geodesic is a tenth
/// farther away than where that leaves the box.
const BETWEEN: f64 = 1.25;

/// A camera sees from as far away as paths are long, and as far on the other side.
const BOTH_SIDES: f64 = 2.0;

/// Steps after which a geodesic has gone far enough: those of pictures take some hundred. To go as far with
/// every vertex of a mesh must not take for ever.
const MOST_STEPS: usize = 4096;

/// Tolerance of the geodesics: their lengths need few digits.
const TOLERANCE: f64 = 1e-6;

/// Finds how far light gets from `at`, at most `most`.
pub(super) fn reach(manifold: &Manifold, at: DVec3, most: f64) -> f64 {
    let length = manifold.length.map_or(most, |length| length.min(most));
    let events = manifold.domain.events();
    let events = events.at(&[at.x, at.y, at.z, 0.0, 0.0, 0.0]);
    let settings = Settings {
        tolerance: TOLERANCE,
        carried: Carried::default(),
        // The point may be beyond an exit, and a part of what is around it not.
        events: events.iter().all(|event| *event <= 0.0),
    };
    let directions = (0..DIRECTIONS).map(|i| fibonacci_direction(i, DIRECTIONS));
    let rays = directions.map(|d| Ray::new(manifold, at, d, length));
    let mut sink = ReachSink {
        steps: vec![0; DIRECTIONS],
        farthest: 0.0,
    };
    follow(manifold, settings, rays, &mut sink);
    (BETWEEN * sink.farthest).min(most)
}

/// Keeps how far the farthest ray has come.
struct ReachSink {
    /// Steps of each ray.
    steps: Vec<usize>,
    farthest: f64,
}

impl Sink for ReachSink {
    fn step(&mut self, ray: usize, _: &Step) {
        self.steps[ray] += 1;
    }

    fn wants_more(&self, ray: usize) -> bool {
        self.steps[ray] < MOST_STEPS
    }

    fn end(&mut self, _: usize, end: End, s: f64, _: usize) {
        let s = match end {
            End::Length => BOTH_SIDES * s,
            End::Exit(_) | End::Singular => s,
        };
        self.farthest = self.farthest.max(s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::diagnostic::SourceText;

    fn found(space: &str, at: DVec3, most: f64) -> f64 {
        let text = format!("name = 'a'\ncoordinates = ['x', 'y', 'z']\n{space}");
        let manifold = Manifold::from_source(SourceText::new("a.toml", text), &[]).unwrap();
        reach(&manifold, at, most)
    }

    #[test]
    fn light_gets_to_the_farthest_corner_of_a_box_and_not_much_farther() {
        let space = "metric = { conformal = '2' }\n\
                     domain = { x = [-1, 3], y = [-1, 3], z = [-2, 2] }\n";
        for at in [DVec3::ZERO, DVec3::new(-0.9, 2.5, 1.9), DVec3::ONE] {
            let farthest = (at - DVec3::new(1.0, 1.0, 0.0)).abs() + 2.0;
            let farthest = 2.0 * farthest.length();
            let found = found(space, at, 1e5);
            assert!(
                found >= farthest && found < 1.3 * farthest,
                "{found} {farthest}"
            );
        }
    }

    #[test]
    fn without_an_end_the_length_of_paths_counts_and_never_more_than_is_asked_for() {
        let space = "metric = { conformal = '1' }\ncameras = { length = 3 }\n";
        assert_eq!(found(space, DVec3::ZERO, 1e5), 7.5);
        assert_eq!(found(space, DVec3::ZERO, 2.0), 2.0);
        let alone = "metric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }\n";
        let far = found(alone, DVec3::new(0.3, 0.2, 0.1), 1e9);
        assert!(far < 1e5, "{far}");
    }
}
