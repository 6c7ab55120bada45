//! Whether all directions are held together, and about which pole.
//!
//! One patch for the whole sphere of directions takes fewer bytes than six for its faces, if mirrors do
//! not spare most of the faces. What a camera sees along its way hardly changes when it moves, what is
//! beside it turns about that way: with the pole there, motion changes polar angles only.

use geofan_bundle::{
    Division, PlanRecord,
    rays::{RaySpace, cell},
};
use glam::{DMat3, DVec3};

/// The fewest chunks of faces, for each of whole spheres, that are worth replacing: three bumps take 0.7
/// to 0.8 of the bytes of six.
const FEWEST_FACES: usize = 5;

/// Steps of the iteration that finds the longest axis of an ellipsoid.
const STEPS: usize = 100;

/// The axes of the sphere (columns, the pole last) for the rays of `plan`; `None` if faces are better
/// held each by itself.
pub fn axes(space: &RaySpace, plan: &PlanRecord) -> Option<[[f64; 3]; 3]> {
    if space.planar() {
        return None;
    }
    let pole = pole(space, plan);
    let (first, second) = pole.any_orthonormal_pair();
    let together = PlanRecord {
        sphere: Some(DMat3::from_cols(first, second, pole).to_cols_array_2d()),
        ..plan.clone()
    };
    let chunks = |plan: &PlanRecord| plan.division(&plan.applied(space.clone())).chunks();
    let worth = chunks(plan) >= FEWEST_FACES * chunks(&together);
    together.sphere.filter(|_| worth)
}

/// The direction in the standard frame along which cells of cameras are longest.
fn pole(space: &RaySpace, plan: &PlanRecord) -> DVec3 {
    let counts: Vec<usize> = plan.cells.iter().map(|n| *n as usize).collect();
    let cells = Division::new(counts.clone(), 1, &[]);
    let spreads = (0..cells.chunks()).map(|cell| spread(space, &counts, &cells.of(cell).0));
    longest(spreads.fold(DMat3::ZERO, |sum, spread| sum + spread))
}

/// The sum of `o oᵀ` over the offsets o, in the standard frame, from the middle of a cell to its sides.
fn spread(space: &RaySpace, counts: &[usize], cell: &[usize]) -> DMat3 {
    let at =
        |inner: &[f64]| space.stored_point(&cell::parameters(counts, space.cameras(), cell, inner));
    let middle = vec![0.0; counts.len()];
    let inverse = space.manifold().standard_frame(at(&middle)).inverse();
    let side = |axis: usize| {
        let mut inner = middle.clone();
        inner[axis] = 1.0;
        let o = inverse * (at(&inner) - at(&middle));
        DMat3::from_cols(o * o.x, o * o.y, o * o.z)
    };
    let sides = (0..counts.len()).map(side);
    sides.fold(DMat3::ZERO, |sum, side| sum + side)
}

/// The longest axis of a symmetric matrix without negative eigenvalues, by iteration from the coordinate
/// that has most; z if there is none.
fn longest(spread: DMat3) -> DVec3 {
    let diagonal = DVec3::new(spread.x_axis.x, spread.y_axis.y, spread.z_axis.z);
    let mut axis = DVec3::AXES[diagonal.max_position()];
    if !(diagonal.max_element() > 0.0 && diagonal.is_finite()) {
        return DVec3::Z;
    }
    for _ in 0..STEPS {
        axis = (spread * axis).normalize();
    }
    axis
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_axis_is_found() {
        let axes = DMat3::from_euler(glam::EulerRot::XYZ, 0.4, 1.0, -0.3);
        let spread = axes * DMat3::from_diagonal(DVec3::new(0.2, 3.0, 1.0)) * axes.transpose();
        assert!(longest(spread).dot(axes.y_axis).abs() > 1.0 - 1e-12);
        assert_eq!(longest(DMat3::ZERO), DVec3::Z);
        assert_eq!(
            longest(DMat3::from_diagonal(DVec3::new(2.0, 2.0, 0.0))),
            DVec3::X
        );
    }
}
