//! The one-parameter family of rays from one camera, at the knots of a frame.
//!
//! In: a fan whose directions have one parameter (a rotation takes out the other) and knots. Out: for a
//! direction its path as a [`FamilyPath`] of the [`FamilyInterval`] of parameters around it, which is
//! made when it is first asked for. Intervals are halved until their polynomials have converged, which
//! grades them toward photon spheres; patches are halved too, so no interval straddles two.

mod edge_pieces;
mod interval;

pub(super) use interval::{FamilyPath, refine_sixteen};

use super::{endings::EventLocator, lanes::LANES};
use geofan_bundle::{Fan, rays::Orbit};
use glam::DVec3;
use interval::FamilyInterval;
use std::sync::{Arc, OnceLock};

/// Intervals are not tried before they have been halved this often, because none so wide converges, and
/// not halved more often, because few paths of a frame are left in one. Chosen, not measured.
const DEPTHS: [u32; 2] = [3, 11];

/// All paths from one camera.
pub(super) struct RayFamily<'f> {
    fan: &'f Fan,
    knots: Arc<[f64]>,
    /// The table's promise.
    promise: f64,
    faces: Vec<OnceLock<ParameterTree<'f>>>,
}

/// An interval of the parameter, halved or not.
enum ParameterTree<'f> {
    Leaf(Box<FamilyInterval<'f>>),
    Halves(Box<[OnceLock<ParameterTree<'f>>; 2]>),
    /// Takes more time to know than the few paths in it.
    Bare,
}

impl<'f> RayFamily<'f> {
    /// Makes the family of `fan`, whose table promises this error; `None` if directions have two parameters.
    pub(super) fn new(fan: &'f Fan, knots: &Arc<[f64]>, promise: f64) -> Option<Self> {
        let space = fan.space();
        space.planar().then(|| Self {
            fan,
            knots: knots.clone(),
            promise,
            faces: (0..space.faces()).map(|_| OnceLock::new()).collect(),
        })
    }

    /// Returns the parameters and rotations of the paths in at most sixteen directions; behind the last
    /// direction come repetitions of it.
    pub(super) fn orbits(&self, directions: &[DVec3]) -> [Orbit; LANES] {
        let last = directions.len() - 1;
        let sixteen = std::array::from_fn(|l| directions[l.min(last)]);
        self.fan.space().orbits(&self.fan.place, &sixteen)
    }

    /// Returns a path; `None` where intervals do not pay. `near` is the interval where the last path was found, and most
    /// likely the next will be.
    pub(super) fn path<'p>(
        &'p self,
        orbit: &Orbit,
        near: &mut Option<&'p FamilyInterval<'f>>,
        events: &mut EventLocator<'_>,
    ) -> Option<FamilyPath<'p, 'f>> {
        self.path_by(orbit, near, |tree, parameters, depth| {
            Some(tree.get_or_init(|| self.tree(orbit.face, parameters, depth, events)))
        })
    }

    /// Returns a path that has been asked for before.
    pub(super) fn known_path<'p>(
        &'p self,
        orbit: &Orbit,
        near: &mut Option<&'p FamilyInterval<'f>>,
    ) -> Option<FamilyPath<'p, 'f>> {
        self.path_by(orbit, near, |tree, _, _| tree.get())
    }

    /// Returns a path from the interval that the last one came from, or else descends to the one around it,
    /// where `open` gives the tree of an interval at a depth.
    fn path_by<'p>(
        &'p self,
        orbit: &Orbit,
        near: &mut Option<&'p FamilyInterval<'f>>,
        open: impl FnMut(
            &'p OnceLock<ParameterTree<'f>>,
            [f64; 2],
            u32,
        ) -> Option<&'p ParameterTree<'f>>,
    ) -> Option<FamilyPath<'p, 'f>> {
        let interval = match near.filter(|interval| interval.holds(orbit)) {
            Some(interval) => interval,
            None => self.descend(orbit, open)?,
        };
        *near = Some(interval);
        Some(interval.path(orbit))
    }

    fn descend<'p>(
        &'p self,
        orbit: &Orbit,
        mut open: impl FnMut(
            &'p OnceLock<ParameterTree<'f>>,
            [f64; 2],
            u32,
        ) -> Option<&'p ParameterTree<'f>>,
    ) -> Option<&'p FamilyInterval<'f>> {
        let (mut tree, mut parameters) = (&self.faces[orbit.face], [-1.0, 1.0]);
        for depth in 0.. {
            let [low, high] = parameters;
            let middle = 0.5 * (low + high);
            match open(tree, parameters, depth)? {
                ParameterTree::Bare => break,
                ParameterTree::Halves(halves) => {
                    let upper = orbit.parameter >= middle;
                    tree = &halves[usize::from(upper)];
                    parameters = if upper { [middle, high] } else { [low, middle] };
                }
                ParameterTree::Leaf(interval) => return Some(interval),
            }
        }
        None
    }

    /// Makes the tree of an interval of a face: a leaf if its paths have converged and their end is known,
    /// as far as it can be.
    fn tree(
        &self,
        face: usize,
        parameters: [f64; 2],
        depth: u32,
        events: &mut EventLocator<'_>,
    ) -> ParameterTree<'f> {
        let [least, most] = DEPTHS;
        let from = (&self.knots, self.promise);
        let interval = match depth >= least {
            true => FamilyInterval::new(self.fan, (face, parameters), from, events),
            false => None,
        };
        let ends_alike = self.fan.space().ends_alike();
        match interval {
            Some(interval) if interval.knows_end() || !ends_alike || depth == most => {
                ParameterTree::Leaf(Box::new(interval))
            }
            _ if depth < most => ParameterTree::Halves(Box::default()),
            _ => ParameterTree::Bare,
        }
    }
}
