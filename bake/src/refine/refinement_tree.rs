//! The refinement tree of one chunk: its boxes, grown level by level, and the error budget that they share.
//!
//! In: a [`Decision`] for each open box. Out: the boxes that these were divided into, and at last the
//! [`Tree`] that is stored.
//!
//! The promise is a quantile of all rays, not of those of each box. A miss costs the same wherever it is,
//! but saves most bytes in the boxes that are hard, which are small because they were halved again and
//! again. So the open boxes of a level may spend a share of the remaining error budget only
//! ([`LEVEL_SHARES`]), and those that need not be divided leave more than their own part to the others.

use super::{
    edges::{EdgeBounds, EdgeDivision},
    separatrix::{SeparatrixDivision, SeparatrixSide},
};
use geofan_bundle::{
    MappedChebyshev, Tree, Variables,
    rays::{FACES, parallel},
};
use geofan_core::random::Stream;
use std::{array::from_fn, sync::Arc};

/// Shares of the remaining error budget that a level may spend: that of the one box that has all, of
/// those that it is divided into, and of later ones. One of the largest chunks of three bumps in a volume
/// takes 3.62 MB if every box is allowed as many misses as its volume, 3.42 with 0.3 from the second
/// level on, 3.33 with 0.5, 3.37 with 0.75, 3.10 with 0.35 and then 0.65, and 2.94 with these.
const LEVEL_SHARES: [f64; 3] = [1.0, 0.5, 0.75];

/// Largest error budget of a box, in units of its volume's share: errors have long tails in hard boxes,
/// and those beyond the quantile are not bounded at all.
const LARGEST_BUDGET: f64 = 6.0;

/// A box of the table: an interval of [−1, 1] of each axis of the chunk, and its place in the tree.
#[derive(Debug, Clone)]
pub struct ParameterBox {
    /// Intervals of the axes camera…, direction…, arc length.
    pub intervals: Vec<[f64; 2]>,
    /// The face of its directions; `None` if it has the whole sphere of them.
    pub face: Option<usize>,
    /// Its part of the chunk's rays and of their lengths.
    pub share: f64,
    /// Name of the box: the chunk's, then one number for each halving.
    pub name: Vec<u64>,
    /// The edges between which its paths are, whose pieces the intervals of arc length then divide.
    pub edges: Option<Arc<EdgeBounds>>,
    /// The side of a separatrix that it is on, whose interval along the axis is then a part of that side.
    pub beside: Option<Arc<SeparatrixSide>>,
}

impl ParameterBox {
    /// Makes the box of a whole chunk with so many axes and the directions of `face`, called `name`.
    pub fn whole(axes: usize, face: Option<usize>, name: Vec<u64>) -> Self {
        Self {
            intervals: vec![[-1.0, 1.0]; axes],
            face,
            share: 1.0,
            name,
            edges: None,
            beside: None,
        }
    }

    /// Divides the whole sphere of directions into faces.
    pub fn faces(&self) -> Vec<Self> {
        let face = |face: usize| Self {
            face: Some(face),
            share: self.share / FACES as f64,
            name: [&self.name[..], &[(2 * self.intervals.len() + face) as u64]].concat(),
            ..self.clone()
        };
        (0..FACES).map(face).collect()
    }

    /// Divides into the parts before and behind the edge that `crossing` tells of.
    pub fn parts(&self, crossing: &EdgeDivision) -> [Self; 2] {
        let rays = self.arc();
        from_fn(|side| {
            let share = match side {
                0 => crossing.share,
                _ => 1.0 - crossing.share,
            };
            let bounds = EdgeBounds::beside(self, crossing, side);
            Self {
                share: self.share * share,
                name: [&self.name[..], &[(2 * rays + FACES + 2 + side) as u64]].concat(),
                edges: Some(Arc::new(bounds)),
                ..self.clone()
            }
        })
    }

    /// Divides into the lower and the upper side of the separatrix that `found` tells of.
    pub fn sides(&self, found: &Arc<SeparatrixDivision>) -> [Self; 2] {
        let kinds = 2 * self.arc() + FACES + 4;
        from_fn(|number| {
            let side = SeparatrixSide::new(self, found.clone(), number);
            let mut part = self.clone();
            part.intervals[found.reach.axis] = [-1.0, 1.0];
            part.share *= side.share();
            part.name
                .push((kinds + 2 * found.reach.axis + number) as u64);
            part.beside = Some(Arc::new(side));
            part
        })
    }

    /// Returns the lower (0) or upper (1) half along `axis`.
    pub fn half(&self, axis: usize, side: usize) -> Self {
        let mut half = self.clone();
        let [a, b] = half.intervals[axis];
        half.intervals[axis][1 - side] = 0.5 * (a + b);
        half.share *= 0.5;
        half.name.push((2 * axis + side) as u64);
        half
    }

    /// Says how the parameters of its rays enter polynomials.
    pub fn variables(&self, cameras: usize, mapping: MappedChebyshev) -> Variables {
        Variables {
            cameras,
            mapping,
            sphere: self.face.is_none(),
        }
    }

    /// Draws the parameters of a random ray, in [−1, 1]: uniform in those of a face, or over all
    /// directions of the sphere.
    pub fn random_ray(&self, stream: &mut Stream) -> Vec<f64> {
        let axes = 0..self.arc();
        let mut x: Vec<f64> = axes.map(|_| stream.between(-1.0, 1.0)).collect();
        if let (None, Some(b)) = (self.face, x.last_mut()) {
            *b = parallel(*b);
        }
        x
    }

    /// Returns the index of the arc length among the axes.
    pub fn arc(&self) -> usize {
        self.intervals.len() - 1
    }

    /// Returns its part of the chunk's rays, whatever part of their length.
    pub fn volume(&self) -> f64 {
        let all = &self.intervals[..self.arc()];
        let side = self.beside.as_ref().map_or(1.0, |side| side.volume());
        all.iter().map(|[a, b]| 0.5 * (b - a)).product::<f64>() * side
    }

    /// Counts how often the arc length was halved.
    pub fn arc_halvings(&self) -> u32 {
        let [a, b] = self.intervals[self.arc()];
        (2.0 / (b - a)).log2().round() as u32
    }

    /// Maps `x` in [−1, 1] to the interval of `axis`.
    pub fn at(&self, axis: usize, x: f64) -> f64 {
        let [a, b] = self.intervals[axis];
        0.5 * (a + b) + 0.5 * (b - a) * x
    }

    /// Returns the parameters in the chunk of a ray with these in the box.
    pub fn in_chunk(&self, x: &[f64]) -> Vec<f64> {
        let axes = 0..self.arc();
        let mut outer: Vec<f64> = axes.map(|axis| self.at(axis, x[axis])).collect();
        let mut beside = self.beside.as_deref();
        while let Some(side) = beside {
            beside = side.leave(&mut outer);
        }
        outer
    }

    /// Returns the parameters in the box of a ray with these in the chunk.
    pub fn in_box(&self, x: &[f64]) -> Vec<f64> {
        let mut inner = x.to_vec();
        if let Some(side) = &self.beside {
            side.enter(&mut inner);
        }
        self.scaled(&inner)
    }

    /// Maps parameters between the bounds of its intervals to [−1, 1].
    pub fn scaled(&self, x: &[f64]) -> Vec<f64> {
        let axes = x.iter().zip(&self.intervals);
        axes.map(|(x, [a, b])| (2.0 * x - a - b) / (b - a))
            .collect()
    }

    /// Returns the intervals of arc lengths on the paths of rays with these parameters, on paths of `length`.
    pub fn arc_intervals(&self, rays: &[Vec<f64>], length: f64) -> Vec<[f64; 2]> {
        let Some(edges) = &self.edges else {
            return vec![self.arc_interval(length); rays.len()];
        };
        let rays: Vec<Vec<f64>> = rays.iter().map(|x| self.in_chunk(x)).collect();
        let shares = self.intervals[self.arc()].map(|t| 0.5 * (t + 1.0));
        let pieces = edges.pieces(&rays, length).into_iter();
        pieces
            .map(|[start, end]| shares.map(|share| start + share * (end - start)))
            .collect()
    }

    /// Returns the interval of arc lengths, on paths of `length` that no edge divides.
    pub fn arc_interval(&self, length: f64) -> [f64; 2] {
        self.intervals[self.arc()].map(|t| 0.5 * (t + 1.0) * length)
    }
}

/// Says what becomes of a box.
pub enum Decision {
    /// One patch holds it.
    Fitted(Tree),
    /// Nothing is read from it: no ray gets there, or those that do are integrated.
    Unread(Tree),
    /// It is halved along an axis.
    Halve(usize),
    /// The whole sphere of directions is too much at once: each face by itself.
    Faces,
    /// Its paths do not meet the same edges, and the axis along which halving it parts them best.
    Mixed(usize),
    /// All its paths meet an edge, which divides them.
    Edge(Box<EdgeDivision>),
    /// Its paths do not meet the same edges, and a separatrix parts them.
    Separatrix(Arc<SeparatrixDivision>),
}

/// The share of a chunk in boxes whose paths do not meet the same edges that is not worth halving any more.
const LEAST_MIXED: f64 = 0.0003;

/// The share of a chunk in all boxes that are not done which is not worth halving any more, where edges divide paths: the
/// last ones, beside rays that circle for ever, take as many rays as all others and hold next to nothing.
const LEAST_OPEN: f64 = 0.0003;

/// The like share where rays have three and more axes: what is left beside edges there lies along a surface, and to halve
/// its share takes four times as many boxes.
const LEAST_OPEN_OF_MANY_AXES: f64 = 0.02;

/// The most boxes of a level that are halved because their paths do not meet the same edges. Those along a face of many dimensions get smaller slowly and ever
/// more.
const MOST_MIXED: usize = 384;

/// A tree of boxes that grows by levels.
pub struct RefinementTree {
    /// The decision about each box and the number of its first part; `None` while it is open.
    nodes: Vec<Option<(Decision, usize)>>,
    /// The open boxes with their numbers.
    open: Vec<(usize, ParameterBox)>,
    /// Misses of the promise that have not been spent, as a share of all.
    budget_left: f64,
    level: usize,
}

impl RefinementTree {
    /// Begins with one open box.
    pub fn new(root: ParameterBox) -> Self {
        Self {
            nodes: vec![None],
            open: vec![(0, root)],
            budget_left: 1.0,
            level: 0,
        }
    }

    /// Lists the open boxes.
    pub fn open(&self) -> impl ExactSizeIterator<Item = &ParameterBox> {
        self.open.iter().map(|(_, bounds)| bounds)
    }

    /// Returns the error budget of each open box: allowed misses in units of its volume's share.
    pub fn error_budget(&self) -> f64 {
        let volume: f64 = self.open().map(|bounds| bounds.share).sum();
        let share = LEVEL_SHARES[self.level.min(LEVEL_SHARES.len() - 1)];
        (share * self.budget_left / volume).min(LARGEST_BUDGET)
    }

    /// Decides about open boxes of a chunk whose paths edges may divide, or of which the share `flagged` may be left: those
    /// whose paths do not meet the same edges, and the last of all, are halved while that pays, and given up then. Returns
    /// how many are given up.
    pub fn settle(&self, decisions: &mut [Decision], flagged: Option<f64>) -> usize {
        let total = |counts: fn(&Decision) -> bool| {
            let boxes = self.open().zip(&*decisions);
            let shares = boxes.filter(|(_, decision)| counts(decision));
            shares.fold((0, 0.0), |(count, share), (bounds, _)| {
                (count + 1, share + bounds.share)
            })
        };
        let (count, share) = total(|decision| matches!(decision, Decision::Mixed(_)));
        let mixed = share > LEAST_MIXED && count <= MOST_MIXED;
        let (_, share) =
            total(|decision| matches!(decision, Decision::Halve(_) | Decision::Mixed(_)));
        let usual = || match self.open().next().map_or(0, ParameterBox::arc) {
            ..3 => LEAST_OPEN,
            _ => LEAST_OPEN_OF_MANY_AXES,
        };
        let least = flagged.unwrap_or_else(usual);
        let any = share > least;
        let mut given_up = 0;
        for (decision, (_, bounds)) in decisions.iter_mut().zip(&self.open) {
            // Beside a separatrix there are not more of them with each halving.
            let any = any || bounds.beside.is_some();
            *decision = match decision {
                Decision::Halve(axis) if any => Decision::Halve(*axis),
                Decision::Mixed(axis) if any && mixed => Decision::Halve(*axis),
                Decision::Halve(_) | Decision::Mixed(_) => {
                    given_up += 1;
                    Decision::Unread(Tree::Flagged)
                }
                _ => continue,
            };
        }
        given_up
    }

    /// Goes on to the boxes that the open ones are divided into.
    pub fn grow(&mut self, decisions: Vec<Decision>) {
        let budget = self.error_budget();
        self.level += 1;
        let open = std::mem::take(&mut self.open);
        for ((number, bounds), decision) in open.into_iter().zip(decisions) {
            let next = self.nodes.len();
            let parts = match &decision {
                Decision::Fitted(_) => {
                    self.budget_left -= budget * bounds.share;
                    Vec::new()
                }
                Decision::Unread(_) => Vec::new(),
                Decision::Edge(crossing) => bounds.parts(crossing).into(),
                Decision::Separatrix(found) => bounds.sides(found).into(),
                Decision::Halve(axis) | Decision::Mixed(axis) => {
                    [0, 1].map(|side| bounds.half(*axis, side)).into()
                }
                Decision::Faces => bounds.faces(),
            };
            self.nodes[number] = Some((decision, next));
            self.nodes.extend(parts.iter().map(|_| None));
            self.open.extend((next..).zip(parts));
        }
    }

    /// Returns the tree, when no box is open.
    pub fn into_tree(mut self) -> Tree {
        self.take(0)
    }

    /// Takes out the tree below the box of this `number`.
    fn take(&mut self, number: usize) -> Tree {
        // There is no open box; its rays would be integrated.
        let Some((decision, first)) = self.nodes[number].take() else {
            return Tree::Flagged;
        };
        match decision {
            Decision::Fitted(tree) | Decision::Unread(tree) => tree,
            Decision::Edge(crossing) => Tree::Edge {
                place: crossing.place,
                parts: Box::new(from_fn(|side| self.take(first + side))),
            },
            Decision::Separatrix(found) => Tree::Separatrix {
                place: found.place.clone(),
                reach: found.reach,
                sides: Box::new(from_fn(|side| self.take(first + side))),
            },
            Decision::Halve(axis) | Decision::Mixed(axis) => Tree::Split {
                axis,
                halves: Box::new(from_fn(|side| self.take(first + side))),
            },
            Decision::Faces => {
                let faces: [Tree; FACES] = from_fn(|face| self.take(first + face));
                Tree::Faces(Box::new(faces))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn root() -> RefinementTree {
        RefinementTree::new(ParameterBox::whole(4, None, vec![1]))
    }

    #[test]
    fn a_tree_keeps_the_order_of_its_boxes() {
        let mut growing = root();
        growing.grow(vec![Decision::Faces]);
        assert_eq!(growing.open().len(), FACES);
        let others = (1..FACES).map(|_| Decision::Unread(Tree::Flagged));
        growing.grow([Decision::Halve(2)].into_iter().chain(others).collect());
        let sides: Vec<[f64; 2]> = growing.open().map(|bounds| bounds.intervals[2]).collect();
        assert_eq!(sides, [[-1.0, 0.0], [0.0, 1.0]]);
        growing.grow(vec![Decision::Halve(0), Decision::Unread(Tree::Flagged)]);
        growing.grow(vec![
            Decision::Unread(Tree::Flagged),
            Decision::Unread(Tree::Flagged),
        ]);
        let Tree::Faces(faces) = growing.into_tree() else {
            panic!("faces")
        };
        let Tree::Split { axis: 2, halves } = &faces[0] else {
            panic!("halved")
        };
        assert!(matches!(halves[0], Tree::Split { axis: 0, .. }));
        assert!(faces[1..].iter().all(|face| matches!(face, Tree::Flagged)));
    }

    #[test]
    fn no_more_misses_are_allowed_than_there_are() {
        let mut growing = root();
        assert_eq!(growing.error_budget(), 1.0);
        growing.grow(vec![Decision::Faces]);
        let (mut used, mut last) = (0.0, 0.0);
        while growing.open().len() > 0 {
            let budget = growing.error_budget();
            assert!(budget >= last && budget <= LARGEST_BUDGET);
            last = budget;
            // The last box of each level is hard.
            let hard = growing.open().len() - 1;
            let decisions = growing.open().enumerate().map(|(k, bounds)| {
                if k == hard && bounds.share > 1e-3 {
                    return Decision::Halve(0);
                }
                used += budget * bounds.share;
                Decision::Fitted(Tree::Flagged)
            });
            let decisions = decisions.collect();
            growing.grow(decisions);
        }
        assert!(last > 2.0 && used <= 1.0, "{last} {used}");
    }
}
