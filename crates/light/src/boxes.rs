//! Which of many boxes hold a point.
//!
//! In: boxes in chart coordinates. Out: the numbers of those around a point.

use geofan_render::accel::BoxTree;
use glam::DVec3;

/// Boxes, sorted.
pub(super) struct Boxes(BoxTree<(u32, (DVec3, DVec3))>);

impl Boxes {
    /// Sorts the boxes, given by their corners.
    pub fn new(boxes: &[(DVec3, DVec3)]) -> Self {
        let numbered: Vec<_> = (0..).zip(boxes.iter().copied()).collect();
        Self(BoxTree::build(&numbered, |(_, bounds)| *bounds))
    }

    /// Puts the numbers of the boxes around `u` into `found`, emptied first.
    pub fn around(&self, u: DVec3, found: &mut Vec<u32>) {
        found.clear();
        self.0.visit(u, u, |(number, (low, high))| {
            if low.cmple(u).all() && u.cmple(*high).all() {
                found.push(*number);
            }
        });
    }

    /// Corners of the box around all of them.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.0.bounds()
    }
}
