//! Paths from one camera that a single parameter tells apart, at the knots of a frame.
//!
//! In: a fan whose directions have one parameter (a rotation takes out the other) and knots. Out: for a
//! direction its path as one of a [`FamilyInterval`], that of the interval around it, made when it is first asked
//! for. Intervals are halved until the strip's polynomials have converged, which grades them toward
//! photon spheres; patches are halved too, so no interval straddles two.

use super::{
    endings::EventLocator,
    lanes::LANES,
    strip::{FamilyInterval, FamilyPath},
};
use geofan_bundle::{Fan, rays::Orbit};
use glam::DVec3;
use std::sync::{Arc, OnceLock};

/// Intervals are not tried before they have been halved this often, because none so wide converges, and
/// not halved more often, because few paths of a frame are left in one. Chosen, not measured.
const DEPTHS: [u32; 2] = [3, 11];

/// All paths from one camera.
pub(super) struct RayFamily<'f> {
    fan: &'f Fan,
    knots: Arc<[f64]>,
    faces: Vec<OnceLock<Node<'f>>>,
}

/// An interval of the parameter.
enum Node<'f> {
    FamilyInterval(Box<FamilyInterval<'f>>),
    Halves(Box<[OnceLock<Node<'f>>; 2]>),
    /// Dearer to know than the few paths in it.
    Bare,
}

/// An interval with its strip.
type Known<'p, 'f> = ([f64; 2], &'p FamilyInterval<'f>);

/// Where the last path was found, and most likely the next will be.
#[derive(Default)]
pub(super) struct Near<'p, 'f>(Option<(usize, Known<'p, 'f>)>);

impl<'f> RayFamily<'f> {
    /// `None` if directions have two parameters.
    pub(super) fn new(fan: &'f Fan, knots: &Arc<[f64]>) -> Option<Self> {
        let space = fan.space();
        space.planar().then(|| Self {
            fan,
            knots: knots.clone(),
            faces: (0..space.faces()).map(|_| OnceLock::new()).collect(),
        })
    }

    /// What tells the paths in at most sixteen directions from the others; behind the last come more of its
    /// kind.
    pub(super) fn orbits(&self, directions: &[DVec3]) -> [Orbit; LANES] {
        let last = directions.len() - 1;
        let sixteen = std::array::from_fn(|l| directions[l.min(last)]);
        self.fan.space().orbits(&self.fan.place, &sixteen)
    }

    /// The path; `None` where intervals do not pay.
    pub(super) fn rung<'p>(
        &'p self,
        orbit: &Orbit,
        near: &mut Near<'p, 'f>,
        endings: &mut EventLocator<'_>,
    ) -> Option<FamilyPath<'p, 'f>> {
        near.rung(orbit, || {
            self.descend(orbit, |node, interval, depth| {
                Some(node.get_or_init(|| self.node(orbit.face, interval, depth, endings)))
            })
        })
    }

    /// The same for a path that has been asked for before.
    pub(super) fn known<'p>(
        &'p self,
        orbit: &Orbit,
        near: &mut Near<'p, 'f>,
    ) -> Option<FamilyPath<'p, 'f>> {
        near.rung(orbit, || self.descend(orbit, |node, _, _| node.get()))
    }

    /// Goes down to the strip around a path, where `open` gives the node of an interval at a depth.
    fn descend<'p>(
        &'p self,
        orbit: &Orbit,
        mut open: impl FnMut(&'p OnceLock<Node<'f>>, [f64; 2], u32) -> Option<&'p Node<'f>>,
    ) -> Option<Known<'p, 'f>> {
        let (mut node, mut interval) = (&self.faces[orbit.face], [-1.0, 1.0]);
        for depth in 0.. {
            let [low, high] = interval;
            let middle = 0.5 * (low + high);
            match open(node, interval, depth)? {
                Node::Bare => break,
                Node::Halves(halves) => {
                    let upper = orbit.parameter >= middle;
                    node = &halves[usize::from(upper)];
                    interval = if upper { [middle, high] } else { [low, middle] };
                }
                Node::FamilyInterval(strip) => return Some((interval, strip)),
            }
        }
        None
    }

    fn node(
        &self,
        face: usize,
        interval: [f64; 2],
        depth: u32,
        endings: &mut EventLocator<'_>,
    ) -> Node<'f> {
        let [least, most] = DEPTHS;
        let strip = match depth >= least {
            true => FamilyInterval::new(self.fan, (face, interval), &self.knots, endings),
            false => None,
        };
        let ends_alike = self.fan.space().ends_alike();
        match strip {
            Some(strip) if strip.knows_end() || !ends_alike || depth == most => {
                Node::FamilyInterval(Box::new(strip))
            }
            _ if depth < most => Node::Halves(Box::default()),
            _ => Node::Bare,
        }
    }
}

impl<'p, 'f> Near<'p, 'f> {
    /// The path, from the interval that the last one came from or what `find` finds for it.
    fn rung(
        &mut self,
        orbit: &Orbit,
        find: impl FnOnce() -> Option<Known<'p, 'f>>,
    ) -> Option<FamilyPath<'p, 'f>> {
        let (p, face) = (orbit.parameter, orbit.face);
        let last = self
            .0
            .filter(|(last, ([low, high], _))| *last == face && *low <= p && p < *high);
        let found = match last {
            Some((_, known)) => known,
            None => find()?,
        };
        self.0 = Some((face, found));
        let ([low, high], strip) = found;
        let x = (p - 0.5 * (low + high)) / (0.5 * (high - low));
        Some(strip.rung(x, orbit.rotation))
    }
}
