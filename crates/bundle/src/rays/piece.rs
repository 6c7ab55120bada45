//! Pieces of paths between the edges of the metric that they meet, sampled.
//!
//! In: the edges that bound a piece, and exact paths. Out: the steps of the piece, if the path meets the same
//! edges as its neighbours do, and points and tangents of it.
//!
//! A path jumps in direction where it meets an edge, and no polynomial follows it across. Between two edges it
//! is smooth, and so it is from ray to ray, as long as all of them meet the same edges in the same sense.

use super::RaySpace;
use geofan_core::geodesic::{Path, Step, first_event};
use glam::DVec3;
use std::num::NonZeroU32;

/// Factor by which paths are followed farther than to an edge.
const BEHIND_EDGE: f64 = 1.01;

/// A piece of paths that meet the same edges.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct EdgePiece {
    /// Edges that are met before it, in order, as [`Step::edge`] numbers them.
    pub before: Vec<NonZeroU32>,
    /// The edge that ends it; `None` if it goes on to the end of the path.
    pub next: Option<NonZeroU32>,
}

impl EdgePiece {
    /// Returns how far paths are to be followed on which the piece has these `intervals`: an edge that ends it is seen
    /// from a little behind where it should be.
    pub fn reach(&self, intervals: &[[f64; 2]]) -> f64 {
        let farthest = intervals.iter().map(|[_, end]| *end).fold(0.0, f64::max);
        match self.next {
            Some(_) => BEHIND_EDGE * farthest,
            None => farthest,
        }
    }

    /// Returns the piece of a path that meets `edges`.
    fn number(&self, edges: &[NonZeroU32]) -> Option<usize> {
        let count = self.before.len();
        let same = edges.len() >= count && edges[..count] == self.before;
        let ends = self.next.is_none() || edges.get(count).copied() == self.next;
        (same && ends).then_some(count)
    }

    /// Returns the place where a path meets the edge that ends the piece; not a number for one that meets others.
    pub fn end(&self, path: &Path) -> f64 {
        let (places, edges): (Vec<f64>, Vec<NonZeroU32>) = path.edges().unzip();
        let end = self
            .number(&edges)
            .filter(|_| self.next.is_some())
            .and_then(|number| places.get(number));
        end.copied().unwrap_or(f64::NAN)
    }

    /// Returns the numbers of the first step of the piece and of the first behind it; `None` if the path meets
    /// others, or more of them up to the arc length `end`.
    pub(super) fn steps(&self, space: &RaySpace, path: &Path, end: f64) -> Option<[usize; 2]> {
        let met = path.steps.iter().enumerate();
        let (starts, edges): (Vec<usize>, Vec<NonZeroU32>) = met
            .filter_map(|(number, step)| Some((number, step.edge?)))
            .unzip();
        let number = self.number(&edges)?;
        let first = match number {
            0 => 0,
            _ => starts[number - 1],
        };
        let Some(&last) = starts.get(number) else {
            return Some([first, path.steps.len()]);
        };
        // Nobody looks at edges behind the end of a path.
        let more = self.next.is_none() && path.steps[last].start < end;
        (!more || ends_before(space, path, path.steps[last].start)).then_some([first, last])
    }
}

/// Returns whether the domain ends a path before the arc length `s`, for all who see it.
fn ends_before(space: &RaySpace, path: &Path, s: f64) -> bool {
    let curve = |s: f64| match path.step_at(s) {
        Some(step) => state_on(step, s),
        None => (DVec3::NAN, DVec3::NAN),
    };
    space.ends_alike() && first_event(&space.manifold().domain, s, curve).is_some()
}

/// Returns point and tangent at arc length `s` on `step`, or straight on beside it.
pub(super) fn state_on(step: &Step, s: f64) -> (DVec3, DVec3) {
    let at = s.clamp(step.start, step.end);
    let v = step.tangent(at);
    (step.position(at) + v * (s - at), v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::{
        diagnostic::SourceText,
        geodesic::{Ray, Settings, paths},
        manifold::{Carried, Manifold},
    };
    use std::sync::Arc;

    const SLAB: &str = r#"
name = "two halves"
coordinates = ["x", "y", "z"]
metric = { conformal = "if(x > 1, 1.5, 1)" }
[cameras]
at = ["0", "0", "0"]
length = 4.0
"#;

    #[test]
    fn the_piece_behind_an_edge_begins_there_and_others_are_told_apart() {
        let manifold = Manifold::from_source(SourceText::new("slab", SLAB), &[]).unwrap();
        let space = RaySpace::new(Arc::new(manifold)).unwrap();
        let manifold = space.manifold();
        let settings = Settings {
            tolerance: 1e-9,
            carried: Carried::default(),
            events: false,
        };
        let ray = |d: DVec3| Ray::new(manifold, DVec3::ZERO, d.normalize(), 4.0);
        let rays = [ray(DVec3::new(0.8, 0.6, 0.0)), ray(DVec3::NEG_X)];
        let found = paths(manifold, settings, rays);
        let edges: Vec<_> = found[0].edges().collect();
        assert_eq!(edges.len(), 1);
        assert!((edges[0].0 - 1.25).abs() < 1e-9);
        assert_eq!(found[1].edges().count(), 0);
        let before = EdgePiece {
            before: Vec::new(),
            next: Some(edges[0].1),
        };
        let behind = EdgePiece {
            before: vec![edges[0].1],
            next: None,
        };
        assert!((before.end(&found[0]) - 1.25).abs() < 1e-9);
        assert!(before.end(&found[1]).is_nan() && behind.steps(&space, &found[1], 4.0).is_none());
        let [first, last] = behind.steps(&space, &found[0], 4.0).unwrap();
        assert_eq!(last, found[0].steps.len());
        assert_eq!(before.steps(&space, &found[0], 1.25), Some([0, first]));
        // A path that meets an edge is not one that meets none.
        assert!(EdgePiece::default().steps(&space, &found[0], 4.0).is_none());
    }
}
