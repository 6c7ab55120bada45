//! Directions over the sphere as parameters on cube faces, both ways.
//!
//! In: a unit direction `d` (standard frame). Out: a face 0..6 and (p, q) in [−1, 1]², and back.
//! The tangent warp makes equal steps of p and q nearly equal angles (within a factor √2 over a
//! face), so that polynomials in p and q spend their freedom evenly.

use glam::{DVec2, DVec3};
use std::f64::consts::FRAC_PI_4;

/// The number of faces.
pub const FACES: usize = 6;

/// The direction at (p, q) of `face`: axis `face / 2`, negative if `face` is odd; p and q run along
/// the next two axes in cyclic order.
pub fn direction(face: usize, pq: DVec2) -> DVec3 {
    let axis = face / 2;
    let mut d = [0.0; 3];
    d[axis] = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    d[(axis + 1) % 3] = (pq.x * FRAC_PI_4).tan();
    d[(axis + 2) % 3] = (pq.y * FRAC_PI_4).tan();
    DVec3::from_array(d).normalize()
}

/// The face and (p, q) of a direction: the inverse of [`direction`].
pub fn face_and_parameters(d: DVec3) -> (usize, DVec2) {
    let size = d.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let warp = |x: f64| (x / size[axis]).atan() / FRAC_PI_4;
    let pq = DVec2::new(warp(d[(axis + 1) % 3]), warp(d[(axis + 2) % 3]));
    (2 * axis + usize::from(d[axis] < 0.0), pq)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_and_directions_are_inverse() {
        for face in 0..FACES {
            for i in 0..=20 {
                for j in 0..=20 {
                    let pq = DVec2::new(i as f64 - 10.0, j as f64 - 10.0) / 10.001;
                    let d = direction(face, pq);
                    assert!((d.length() - 1.0).abs() < 1e-15);
                    let (back, found) = face_and_parameters(d);
                    assert_eq!(back, face);
                    assert!((found - pq).length() < 1e-14);
                }
            }
        }
    }
}
