//! Pieces of paths between the edges of the metric that they meet, sampled.
//!
//! In: the edges that bound a piece, and exact paths. Out: the steps of the piece, if the path meets the same
//! edges as its neighbours do, and points and tangents of it.
//!
//! A path jumps in direction where it meets an edge, and no polynomial follows it across. Between two edges it
//! is smooth, and so it is from ray to ray, as long as all of them meet the same edges in the same sense.
//!
//! An exit behind which paths get rough counts as an edge, too: nobody looks behind it, and what comes there takes many
//! times the coefficients of all before it. Where only the metric bends light, paths come to rest near a horizon by
//! themselves; in a wind they cross it, and are soon torn about a singularity. Behind such an *end*, which is a little
//! behind the exit, paths of a table nearly stand still: there they are within what the exit bounds, and nobody who looks
//! for it from knot to knot misses it.

use super::RaySpace;
use geofan_core::geodesic::{End, Path, Step, first_event};
use glam::DVec3;
use std::num::NonZeroU32;

/// Factor by which paths are followed farther than to an edge.
const BEHIND_EDGE: f64 = 1.01;

/// Numbers of ends begin here, beyond those of edges: one for each exit.
const FIRST_END: u32 = 1 << 31;

/// Tells whether an edge of this number is an end.
fn is_end(number: NonZeroU32) -> bool {
    number.get() >= FIRST_END
}

/// Where a path meets an edge, or its end.
#[derive(Debug, Clone, Copy)]
struct EdgeMet {
    /// Arc length.
    place: f64,
    /// The edge, as [`Step::edge`] numbers it, or the end.
    number: NonZeroU32,
    /// The step behind an edge; of an end, the one in which it is.
    step: usize,
}

/// Lists the edges that an exact path meets up to its end.
fn edges_met(space: &RaySpace, path: &Path) -> Vec<EdgeMet> {
    let steps = path.steps.iter().enumerate();
    let edges = steps.filter_map(|(number, step)| {
        Some(EdgeMet {
            place: step.start,
            number: step.edge?,
            step: number,
        })
    });
    match end_met(space, path) {
        Some(end) => edges
            .take_while(|edge| edge.place < end.place)
            .chain([end])
            .collect(),
        None => edges.collect(),
    }
}

/// Finds the end of a path, if it has one, whether or not it was followed past its exits.
fn end_met(space: &RaySpace, path: &Path) -> Option<EdgeMet> {
    let (exit, place) = match path.end {
        _ if !space.has_ends() => return None,
        End::Exit(exit) => (exit, path.length),
        _ => exit_met(space, path, path.length)?,
    };
    let (place, number) = end_at(space, exit, place)?;
    let after = path.steps.partition_point(|step| step.end < place);
    Some(EdgeMet {
        place,
        number,
        step: after.min(path.steps.len() - 1),
    })
}

/// Returns the arc length and the number of the end of a path that meets the exit of a number at arc length `s`; `None`
/// if paths have no end there.
pub fn end_at(space: &RaySpace, exit: usize, s: f64) -> Option<(f64, NonZeroU32)> {
    let number = FIRST_END.checked_add(u32::try_from(exit).ok()?)?;
    let share = space.end_behind(exit)?;
    Some((s * (1.0 + share), NonZeroU32::new(number)?))
}

/// A piece of paths that meet the same edges.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct EdgePiece {
    /// Edges that are met before it, in order, as [`Step::edge`] numbers them.
    pub before: Vec<NonZeroU32>,
    /// The edge that ends it; `None` if it goes on to the end of the path.
    pub next: Option<NonZeroU32>,
}

impl EdgePiece {
    /// Tells whether the piece is up to the end of its paths.
    pub fn is_at_end(&self) -> bool {
        self.next.is_some_and(is_end)
    }

    /// Returns how far the end of the paths of `space` is behind their exit, as a share of the arc length; `None` if the
    /// piece is not behind their end.
    pub fn behind_end(&self, space: &RaySpace) -> Option<f64> {
        let exit = self.before.last()?.get().checked_sub(FIRST_END)?;
        space.end_behind(exit as usize)
    }

    /// Returns how far a path is to be followed on which the piece has the interval from `low` to `high`: an edge that
    /// ends it is seen from a little behind where it should be, and behind the end of a path nobody looks.
    pub fn reach(&self, space: &RaySpace, [low, high]: [f64; 2]) -> f64 {
        match (self.behind_end(space), self.next) {
            (Some(_), _) => BEHIND_EDGE * low,
            (None, Some(_)) => BEHIND_EDGE * high,
            (None, None) => high,
        }
    }

    /// Returns the piece of a path that meets `edges`.
    fn number(&self, edges: &[EdgeMet]) -> Option<usize> {
        let count = self.before.len();
        let numbers = edges.iter().map(|edge| edge.number);
        let same =
            edges.len() >= count && numbers.clone().take(count).eq(self.before.iter().copied());
        let ends = self.next.is_none() || numbers.clone().nth(count) == self.next;
        (same && ends).then_some(count)
    }

    /// Returns the place where a path meets the edge that ends the piece; not a number for one that meets others.
    pub fn end(&self, space: &RaySpace, path: &Path) -> f64 {
        let edges = edges_met(space, path);
        let end = self
            .number(&edges)
            .filter(|_| self.next.is_some())
            .and_then(|number| edges.get(number));
        end.map_or(f64::NAN, |edge| edge.place)
    }

    /// Returns the numbers of the first step of the piece and of the first behind it; `None` if the path meets
    /// others, or more of them up to the arc length `end`.
    pub(super) fn steps(&self, space: &RaySpace, path: &Path, end: f64) -> Option<[usize; 2]> {
        let edges = edges_met(space, path);
        let number = self.number(&edges)?;
        let first = match number {
            0 => 0,
            _ => edges[number - 1].step,
        };
        let Some(last) = edges.get(number) else {
            return Some([first, path.steps.len()]);
        };
        // Nobody looks at edges behind the end of a path.
        let more = self.next.is_none() && last.place < end;
        let kept = !more || exit_met(space, path, last.place).is_some();
        // The step with an end in it goes on behind it.
        kept.then_some([first, last.step + usize::from(is_end(last.number))])
    }
}

/// Finds the first exit that a path meets before the arc length `s`, and where, if all who see the path end there.
pub fn exit_met(space: &RaySpace, path: &Path, s: f64) -> Option<(usize, f64)> {
    if !space.ends_alike() {
        return None;
    }
    let curve = |s: f64| match path.step_at(s) {
        Some(step) => state_on(step, s),
        None => (DVec3::NAN, DVec3::NAN),
    };
    match first_event(&space.manifold().domain, s, curve)? {
        (End::Exit(exit), place) => Some((exit, place)),
        // The limits of the domain.
        (_, place) => Some((usize::MAX, place)),
    }
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
        manifold::Manifold,
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
        let settings = Settings::bare(1e-9);
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
        assert!((before.end(&space, &found[0]) - 1.25).abs() < 1e-9);
        assert!(
            before.end(&space, &found[1]).is_nan()
                && behind.steps(&space, &found[1], 4.0).is_none()
        );
        let [first, last] = behind.steps(&space, &found[0], 4.0).unwrap();
        assert_eq!(last, found[0].steps.len());
        assert_eq!(before.steps(&space, &found[0], 1.25), Some([0, first]));
        // A path that meets an edge is not one that meets none.
        assert!(EdgePiece::default().steps(&space, &found[0], 4.0).is_none());
    }
}
