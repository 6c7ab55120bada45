//! Sixteen boxes against the tree at once: those of neighbouring paths visit nearly the same nodes.

use super::{Accelerator, MARGIN, Stack};
use crate::lanes::{LANES, SinglePoints, any};
use obvhs::{aabb::Aabb, bvh2::node::Bvh2Node};

/// Boxes in tree coordinates; one that asks for nothing is inside out.
#[repr(C, align(64))]
struct Boxes {
    low: SinglePoints,
    high: SinglePoints,
}

impl Accelerator {
    /// Which of the boxes between the corners `low` and `high` meet the box of any leaf, as
    /// [`Accelerator::touches`] tells of one.
    #[inline(always)]
    pub fn touched(&self, low: &SinglePoints, high: &SinglePoints) -> [bool; LANES] {
        let mut touched = [false; LANES];
        let Some(mut boxes) = self.boxes(low, high) else {
            return touched;
        };
        let mut stack = Stack::default();
        stack.push_if(true, (0, 0.0));
        while let Some((index, _)) = stack.pop() {
            let node: &Bvh2Node = &self.nodes[index as usize];
            let met = boxes.meet(node.aabb());
            if !any(&met) {
                continue;
            }
            if node.is_leaf() {
                for l in 0..LANES {
                    touched[l] |= met[l];
                    // Asks no more.
                    boxes.low[0][l] += if met[l] { f32::INFINITY } else { 0.0 };
                }
            } else {
                stack.push_if(true, (node.first_index + 1, 0.0));
                stack.push_if(true, (node.first_index, 0.0));
            }
        }
        touched
    }

    /// The parts of the boxes inside the bounds; `None` if there are none.
    #[inline(always)]
    fn boxes(&self, low: &SinglePoints, high: &SinglePoints) -> Option<Boxes> {
        let (least, most) = self.bounds?;
        let unit = self.unit();
        let mut boxes = Boxes {
            low: [[0.0; LANES]; 3],
            high: [[0.0; LANES]; 3],
        };
        for c in 0..3 {
            let (least, most, centre) = (least[c], most[c], self.centre[c]);
            for l in 0..LANES {
                let (low, high) = (f64::from(low[c][l]), f64::from(high[c][l]));
                let from = if low > least { low } else { least };
                let to = if high < most { high } else { most };
                let beside = (low > most) | (high < least);
                let inside_out = if beside { f32::INFINITY } else { 0.0 };
                boxes.low[c][l] = ((from - centre) * unit) as f32 - MARGIN + inside_out;
                boxes.high[c][l] = ((to - centre) * unit) as f32 + MARGIN;
            }
        }
        Some(boxes)
    }
}

impl Boxes {
    #[inline(always)]
    fn meet(&self, node: &Aabb) -> [bool; LANES] {
        let (min, max) = (node.min.to_array(), node.max.to_array());
        let mut met = [true; LANES];
        for c in 0..3 {
            for l in 0..LANES {
                met[l] &= (self.low[c][l] <= max[c]) & (self.high[c][l] >= min[c]);
            }
        }
        met
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::random::Stream;
    use glam::{DVec3, Vec3};

    #[test]
    fn sixteen_boxes_touch_what_each_does_alone() {
        let mut stream = Stream::new(&[4]);
        let mut point = |size: f64| DVec3::from_array([0; 3].map(|_| stream.between(-size, size)));
        let mut triangle = || {
            let centre = point(1.0);
            [0; 3].map(|_| centre + point(0.1))
        };
        let triangles: Vec<[DVec3; 3]> = (0..60).map(|_| triangle()).collect();
        let accelerator = Accelerator::build(&triangles);
        let mut counts = [0; 2];
        for _ in 0..200 {
            let boxes: [(Vec3, Vec3); LANES] = std::array::from_fn(|_| {
                let (centre, half) = (point(1.6).as_vec3(), point(0.3).abs().as_vec3());
                (centre - half, centre + half)
            });
            let lanes = |of: fn(&(Vec3, Vec3)) -> Vec3| -> SinglePoints {
                [0, 1, 2].map(|c| boxes.each_ref().map(|b| of(b)[c]))
            };
            let touched = accelerator.touched(&lanes(|b| b.0), &lanes(|b| b.1));
            for (touched, (min, max)) in touched.iter().zip(boxes) {
                assert_eq!(
                    *touched,
                    accelerator.touches(min.as_dvec3(), max.as_dvec3())
                );
                counts[usize::from(*touched)] += 1;
            }
        }
        assert!(counts.iter().all(|n| *n > 300), "{counts:?}");
        let inside_out = [f32::INFINITY, f32::NEG_INFINITY].map(|x| [[x; LANES]; 3]);
        let touched = accelerator.touched(&inside_out[0], &inside_out[1]);
        assert_eq!(touched, [false; LANES]);
    }
}
