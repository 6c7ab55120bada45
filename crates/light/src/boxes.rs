//! Which of many boxes hold a point.
//!
//! In: boxes in chart coordinates. Out: the numbers of those around a point.

use geofan_render::accel::Accelerator;
use glam::DVec3;

/// Boxes, sorted.
pub(super) struct Boxes(Accelerator);

impl Boxes {
    /// Sorts the boxes, given by their corners.
    pub fn new(boxes: &[(DVec3, DVec3)]) -> Self {
        // The box around a triangle with two opposite corners of a box is that box.
        let triangles: Vec<[DVec3; 3]> = boxes.iter().map(|(a, b)| [*a, *b, *a]).collect();
        Self(Accelerator::build(&triangles))
    }

    /// Puts the numbers of the boxes around `u` into `found`, emptied first.
    pub fn around(&self, u: DVec3, found: &mut Vec<u32>) {
        self.0.candidates(u, u, found);
    }

    /// Corners of the box around all of them.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.0.bounds()
    }
}
