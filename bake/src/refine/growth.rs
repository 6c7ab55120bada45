//! A tree of boxes while it grows, level by level, and how many misses of the promise its boxes are
//! allowed.
//!
//! In: what becomes of each open box ([`Verdict`]). Out: the boxes that these were divided into, and at
//! last the [`Tree`].
//!
//! The promise is a quantile of all rays, not of those of each box. A miss costs the same wherever it is,
//! but spares most bytes in the boxes that are hard, which are small because they were halved again and
//! again. So the open boxes of a level are allowed a share of the misses left only ([`DEALT`]), and those
//! that need not be divided leave more than their own to the others.

use super::region::Region;
use geofan_bundle::{Tree, rays::FACES};
use std::array::from_fn;

/// The share of the misses left that the boxes of a level are allowed: of the one box that has all, of
/// those that it is divided into, and of later ones. One of the largest chunks of three bumps in a volume
/// takes 3.62 MB if every box is allowed as many misses as its volume, 3.42 with 0.3 from the second
/// level on, 3.33 with 0.5, 3.37 with 0.75, 3.10 with 0.35 and then 0.65, and 2.94 with these.
const DEALT: [f64; 3] = [1.0, 0.5, 0.75];

/// How many times as many misses as are its volume's share a box may be allowed: errors have long tails in hard
/// boxes, and those beyond the quantile are not bounded at all.
const MOST_LENIENT: f64 = 6.0;

/// What becomes of a box.
pub enum Verdict {
    /// One patch.
    Fitted(Tree),
    /// Nothing is read from it: no ray gets there, or those that do are integrated.
    Unread(Tree),
    /// It is halved along an axis.
    Halve(usize),
    /// The whole sphere of directions is too much at once.
    Part,
}

/// A box of the tree; those that it was divided into by the number of the first.
enum Node {
    Open,
    Done(Tree),
    Halved(usize, usize),
    Parted(usize),
}

/// A tree that grows.
pub struct Growth {
    nodes: Vec<Node>,
    /// The open boxes with their numbers.
    open: Vec<(usize, Region)>,
    /// The misses that have not been used, as a share of all; each box has as many as its volume.
    left: f64,
    level: usize,
}

impl Growth {
    /// One open box.
    pub fn new(root: Region) -> Self {
        Self {
            nodes: vec![Node::Open],
            open: vec![(0, root)],
            left: 1.0,
            level: 0,
        }
    }

    /// The open boxes.
    pub fn open(&self) -> impl ExactSizeIterator<Item = &Region> {
        self.open.iter().map(|(_, region)| region)
    }

    /// How many times as many misses as are its volume's share an open box is allowed.
    pub fn lenience(&self) -> f64 {
        let volume: f64 = self.open().map(|region| region.share).sum();
        let dealt = DEALT[self.level.min(DEALT.len() - 1)];
        (dealt * self.left / volume).min(MOST_LENIENT)
    }

    /// Goes on to the boxes that the open ones are divided into.
    pub fn grow(&mut self, verdicts: Vec<Verdict>) {
        let lenience = self.lenience();
        self.level += 1;
        for ((number, region), verdict) in std::mem::take(&mut self.open).into_iter().zip(verdicts)
        {
            let next = self.nodes.len();
            let (node, parts) = match verdict {
                Verdict::Fitted(tree) => {
                    self.left -= lenience * region.share;
                    (Node::Done(tree), Vec::new())
                }
                Verdict::Unread(tree) => (Node::Done(tree), Vec::new()),
                Verdict::Halve(axis) => {
                    let halves = [0, 1].map(|side| region.half(axis, side));
                    (Node::Halved(axis, next), halves.into())
                }
                Verdict::Part => (Node::Parted(next), region.faces()),
            };
            self.nodes[number] = node;
            self.nodes.extend(parts.iter().map(|_| Node::Open));
            self.open.extend((next..).zip(parts));
        }
    }

    /// The tree, when no box is open.
    pub fn into_tree(mut self) -> Tree {
        self.take(0)
    }

    fn take(&mut self, number: usize) -> Tree {
        match std::mem::replace(&mut self.nodes[number], Node::Open) {
            // There is none; its rays would be integrated.
            Node::Open => Tree::Flagged,
            Node::Done(tree) => tree,
            Node::Halved(axis, first) => Tree::Split {
                axis,
                halves: Box::new(from_fn(|side| self.take(first + side))),
            },
            Node::Parted(first) => {
                let faces: [Tree; FACES] = from_fn(|face| self.take(first + face));
                Tree::Faces(Box::new(faces))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn root() -> Growth {
        Growth::new(Region::whole(4, None, vec![1]))
    }

    #[test]
    fn a_tree_keeps_the_order_of_its_boxes() {
        let mut growth = root();
        growth.grow(vec![Verdict::Part]);
        assert_eq!(growth.open().len(), FACES);
        let others = (1..FACES).map(|_| Verdict::Unread(Tree::Flagged));
        growth.grow([Verdict::Halve(2)].into_iter().chain(others).collect());
        let sides: Vec<[f64; 2]> = growth.open().map(|region| region.intervals[2]).collect();
        assert_eq!(sides, [[-1.0, 0.0], [0.0, 1.0]]);
        growth.grow(vec![Verdict::Halve(0), Verdict::Unread(Tree::Flagged)]);
        growth.grow(vec![
            Verdict::Unread(Tree::Flagged),
            Verdict::Unread(Tree::Flagged),
        ]);
        let Tree::Faces(faces) = growth.into_tree() else {
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
        let mut growth = root();
        assert_eq!(growth.lenience(), 1.0);
        growth.grow(vec![Verdict::Part]);
        let (mut used, mut last) = (0.0, 0.0);
        while growth.open().len() > 0 {
            let lenience = growth.lenience();
            assert!(lenience >= last && lenience <= MOST_LENIENT);
            last = lenience;
            // The last box of each level is hard.
            let hard = growth.open().len() - 1;
            let verdicts = growth.open().enumerate().map(|(k, region)| {
                if k == hard && region.share > 1e-3 {
                    return Verdict::Halve(0);
                }
                used += lenience * region.share;
                Verdict::Fitted(Tree::Flagged)
            });
            let verdicts = verdicts.collect();
            growth.grow(verdicts);
        }
        assert!(last > 2.0 && used <= 1.0, "{last} {used}");
    }
}
