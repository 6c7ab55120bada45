//! Rays that a table gets far more wrong than it promises, and where in the table they lie.
//!
//! In: a comparison that went wrong. Out: an [`Outlier`]: the ray, its errors, and the box of the
//! table that answered.

use super::{DecodeError, Table, fan::half, measure::Deviation, tree::Tree};
use crate::rays::{Located, Place};
use glam::DVec3;
use serde::Serialize;

/// By what factor an error must exceed the promise to be told apart.
pub const FAR: f64 = 20.0;

/// The most outliers listed: the worst.
pub const MOST: usize = 20;

/// A box of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BoxPlace {
    /// The chunk.
    pub chunk: usize,
    /// Its face of directions; `None` if it has all of them.
    pub face: Option<usize>,
    /// Its intervals within the chunk, which is [−1, 1] along camera…, direction…, arc length.
    pub intervals: Vec<[f64; 2]>,
    /// Whether it is flagged.
    pub flagged: bool,
}

/// A ray of which the table is far off.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outlier {
    /// Chart point of the camera.
    pub at: [f64; 3],
    /// Direction in the standard frame.
    pub dir: [f64; 3],
    /// Arc length of the comparison.
    pub s: f64,
    /// Where the exact path ends.
    pub length: f64,
    /// Screen error, mrad.
    pub screen_mrad: f64,
    /// Position error, mrad.
    pub mrad: f64,
    /// How much farther a neighbouring ray gets from this one than in flat space, the smaller way.
    pub magnification: f64,
    /// The box that answered.
    pub patch: BoxPlace,
}

impl Outlier {
    /// What sets the ray apart, in words.
    pub fn why(&self) -> String {
        let size = |[a, b]: &[f64; 2]| 0.5 * (b - a);
        let smallest = self.patch.intervals.iter().map(size).fold(1.0, f64::min);
        let magnified = self.mrad / self.screen_mrad.max(f64::MIN_POSITIVE);
        if magnified > FAR {
            format!("paths part by {magnified:.0} times here")
        } else if self.magnification < 0.3 {
            "near a conjugate point, where position hardly depends on direction".into()
        } else if smallest < 0.05 {
            "in a small box, beside a place that no polynomial resolves".into()
        } else {
            "a narrow failure that the held-out rays of the box did not meet".into()
        }
    }
}

impl Table {
    /// The box that answers for the ray `located` from `place` at arc length `s`.
    ///
    /// # Errors
    /// The chunk is damaged.
    pub fn box_at(
        &self,
        place: &Place,
        located: &Located,
        s: f64,
    ) -> Result<BoxPlace, DecodeError> {
        let kept = self.kept(place, located.face);
        let (chunk, mut point) = (kept.chunk, kept.camera);
        let carried = located.clone().carried(kept.image.as_ref());
        point.extend(&carried.direction[..self.space.directions()]);
        point.push(2.0 * s / self.length - 1.0);
        let mut intervals = vec![[-1.0, 1.0]; point.len()];
        let mut tree = self.chunks[chunk].tree()?;
        let mut face = (self.division.blocks == self.space.faces()).then_some(carried.face);
        loop {
            match tree {
                Tree::Split { axis, halves } => {
                    let (side, inner) = half(point[*axis]);
                    point[*axis] = inner;
                    let [a, b] = intervals[*axis];
                    intervals[*axis][1 - side] = 0.5 * (a + b);
                    tree = &halves[side];
                }
                Tree::Faces(faces) => {
                    face = Some(carried.face);
                    tree = &faces[carried.face];
                }
                Tree::Leaf(_) | Tree::Flagged => break,
            }
        }
        Ok(BoxPlace {
            chunk,
            face,
            intervals,
            flagged: matches!(tree, Tree::Flagged),
        })
    }

    /// The outlier of a comparison.
    ///
    /// # Errors
    /// The chunk is damaged.
    pub fn outlier(
        &self,
        place: &Place,
        d: DVec3,
        (s, length): (f64, f64),
        found: Deviation,
        magnification: f64,
    ) -> Result<Outlier, DecodeError> {
        let located = self.space.locate(place, d);
        Ok(Outlier {
            at: place.u.to_array(),
            dir: d.to_array(),
            s,
            length,
            screen_mrad: found.screen_mrad,
            mrad: found.mrad,
            magnification,
            patch: self.box_at(place, &located, s)?,
        })
    }
}
