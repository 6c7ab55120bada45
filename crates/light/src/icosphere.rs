//! Triangles over the sphere of directions, as even as they can be.
//!
//! In: nothing. Out: the icosahedron, whose faces are halved edge by edge where a finer mesh is
//! wanted.

use glam::DVec3;

/// The corners of an icosahedron.
pub(super) fn corners() -> Vec<DVec3> {
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let around = |(a, b): (f64, f64)| {
        let (x, y) = (a, b * golden);
        [
            DVec3::new(0.0, x, y),
            DVec3::new(x, y, 0.0),
            DVec3::new(y, 0.0, x),
        ]
    };
    signs
        .into_iter()
        .flat_map(around)
        .map(DVec3::normalize)
        .collect()
}

/// Its faces: all triples of neighbouring corners.
pub(super) fn faces(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let near = |i: usize, j: usize| corners[i].dot(corners[j]) > 0.4;
    let mut faces = Vec::new();
    for i in 0..corners.len() {
        for j in i + 1..corners.len() {
            for k in j + 1..corners.len() {
                if near(i, j) && near(j, k) && near(k, i) {
                    faces.push([i, j, k]);
                }
            }
        }
    }
    faces
}

#[cfg(test)]
mod tests {
    #[test]
    fn an_icosahedron_has_twelve_corners_and_twenty_faces() {
        let corners = super::corners();
        assert_eq!((corners.len(), super::faces(&corners).len()), (12, 20));
    }
}
