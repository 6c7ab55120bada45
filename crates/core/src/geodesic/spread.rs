//! How neighbouring geodesics spread: area, and the screen error of a displacement.
//!
//! The area of a unit solid angle is `|det J⊥|`; a displacement `e` looks like the angle `|δ|` with
//! `J δ = e`. Displacements are taken in the standard frame at the point.

use crate::manifold::LocalFrame;
use glam::{DMat2, DMat3, DVec2, DVec3};

/// Two unit vectors perpendicular to the unit vector `d`, so that (d, e₁, e₂) is right-handed.
/// Continuous except at `d = −z` (Duff et al., *Building an Orthonormal Basis, Revisited*, 2017).
pub fn perpendiculars(d: DVec3) -> [DVec3; 2] {
    let sign = 1.0_f64.copysign(d.z);
    let a = -1.0 / (sign + d.z);
    let b = d.x * d.y * a;
    [
        DVec3::new(1.0 + sign * d.x * d.x * a, sign * b, -sign * d.x),
        DVec3::new(b, sign + d.y * d.y * a, -d.y),
    ]
}

/// The singular values of `J/s` are raised to at least this before a displacement is divided by
/// them: near conjugate points the inverse map is unbounded.
const LEAST_MAGNIFICATION: f64 = 0.25;

/// How much of a path's tangent must point across its wave front for displacements to be moved along it
/// into that: below, they would become more than ten times longer than they are.
const LEAST_ALONG: f64 = 0.1;

/// The same for tangents: a sky that is magnified shows its own grain before the error of a tangent.
const LEAST_SKY_MAGNIFICATION: f64 = 1.0;

/// The transverse part of the deviation matrix at a point of a path.
#[derive(Debug, Clone, Copy)]
pub struct JacobiField {
    /// Two directions across the path, in the standard frame; covectors that vanish along it.
    across: [DVec3; 2],
    /// `J⊥` in those directions.
    matrix: DMat2,
}

impl JacobiField {
    /// From the tangent `v` and deviations `j` (chart components) and `s_inverse = S(u)⁻¹`.
    pub fn new(s_inverse: DMat3, v: DVec3, j: [DVec3; 2]) -> Self {
        let across = perpendiculars((s_inverse * v).normalize());
        let column = |k: usize| project(across, s_inverse * j[k]);
        Self {
            across,
            matrix: DMat2::from_cols(column(0), column(1)),
        }
    }

    /// The same as `local` sees it where there is a wind. A displacement is moved along the path into
    /// the wave front, the plane across the direction of sight in which neighbours of equal time lie.
    /// Where the path nearly runs within the wave front, it is measured across the path instead.
    pub fn seen_by(local: &LocalFrame, v: DVec3, j: [DVec3; 2]) -> Self {
        let inverse = local.frame.inverse();
        if local.wind.is_none() {
            return Self::new(inverse, v, j);
        }
        let path = inverse * v;
        let across = match front(inverse * local.sight(v), path) {
            Some(across) => across,
            None => perpendiculars(path.normalize_or(DVec3::Z)),
        };
        let column = |k: usize| project(across, inverse * j[k]);
        Self {
            across,
            matrix: DMat2::from_cols(column(0), column(1)),
        }
    }

    /// Area by which a unit solid angle has spread, with the sign of `det J⊥`: it changes at
    /// conjugate points.
    pub fn signed_area(&self) -> f64 {
        self.matrix.determinant()
    }

    /// The transverse length of a displacement `e` (standard frame).
    pub fn transverse(&self, e: DVec3) -> f64 {
        self.project(e).length()
    }

    fn project(&self, e: DVec3) -> DVec2 {
        project(self.across, e)
    }

    /// The smaller singular value of `J/s`: how much farther neighbouring rays part than in flat
    /// space, in the direction in which they part least.
    pub fn least_magnification(&self, s: f64) -> f64 {
        let m = self.matrix * (1.0 / s);
        let squares = m.x_axis.length_squared() + m.y_axis.length_squared();
        let product = m.determinant().abs();
        // σ₁² + σ₂² and σ₁σ₂ give both.
        let larger = 0.5
            * (squares
                + (squares * squares - 4.0 * product * product)
                    .max(0.0)
                    .sqrt());
        product / larger.max(f64::MIN_POSITIVE).sqrt()
    }

    /// The angle at the camera (radians) that a displacement `e` (standard frame) at arc length `s`
    /// looks like: `|δ|` with `J δ = e`.
    pub fn screen_angle(&self, e: DVec3, s: f64) -> f64 {
        let matrix = self.matrix * (1.0 / s);
        looks_like(matrix, self.project(e) / s, LEAST_MAGNIFICATION)
    }

    /// The same for an error `e` of the unit tangent, if this is the spread of tangents: the angle on
    /// the sky, or what it looks like at the camera where the sky is shrunk.
    pub fn sky_angle(&self, e: DVec3) -> f64 {
        looks_like(self.matrix, self.project(e), LEAST_SKY_MAGNIFICATION)
    }
}

/// `|δ|` with `m δ = e`, the singular values of `m` raised to at least `least`.
fn looks_like(m: DMat2, e: DVec2, least: f64) -> f64 {
    // Singular values and left vectors of m from the symmetric m mᵀ.
    let w = m * m.transpose();
    let (mean, half) = (
        0.5 * (w.x_axis.x + w.y_axis.y),
        0.5 * (w.x_axis.x - w.y_axis.y),
    );
    let off = w.x_axis.y;
    let spread = (half * half + off * off).sqrt();
    let angle = 0.5 * off.atan2(half);
    let major = DVec2::new(angle.cos(), angle.sin());
    let large = (mean + spread).max(0.0).sqrt().max(least);
    let small = m.determinant().abs() / (mean + spread).max(f64::MIN_POSITIVE).sqrt();
    let small = small.max(least);
    (major.dot(e) / large).hypot(major.perp().dot(e) / small)
}

/// The area by which a unit solid angle has spread, with the sign of [`JacobiField::signed_area`]: in the
/// wave front, from the tangent `v` and deviations `j` (chart components) at `local`.
pub fn signed_area(local: &LocalFrame, v: DVec3, j: [DVec3; 2]) -> f64 {
    let inverse = local.frame.inverse();
    let n = inverse * local.sight(v);
    let across = match local.wind {
        None => None,
        Some(_) => front(n, inverse * v),
    };
    // Without a drift deviations lie in the wave front already.
    let across = across.unwrap_or_else(|| perpendiculars(n.normalize()));
    let [a, b] = j.map(|j| project(across, inverse * j));
    DMat2::from_cols(a, b).determinant()
}

/// Covectors of two directions across the direction of sight `n` that vanish along the `path` (standard
/// frame); `None` where that is impossible or nearly so.
fn front(n: DVec3, path: DVec3) -> Option<[DVec3; 2]> {
    let n = n.normalize();
    let along = n.dot(path);
    (along.abs() >= LEAST_ALONG).then(|| perpendiculars(n).map(|e| e - n * (e.dot(path) / along)))
}

fn project(across: [DVec3; 2], e: DVec3) -> DVec2 {
    DVec2::new(across[0].dot(e), across[1].dot(e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn perpendiculars_are_right_handed_everywhere() {
        for d in [
            DVec3::X,
            DVec3::Y,
            DVec3::Z,
            -DVec3::Z,
            DVec3::new(0.36, -0.48, -0.8),
        ] {
            let [a, b] = perpendiculars(d);
            let m = DMat3::from_cols(d, a, b);
            assert!((m.determinant() - 1.0).abs() < 1e-14);
            assert!(
                (m.transpose() * m - DMat3::IDENTITY)
                    .to_cols_array()
                    .iter()
                    .all(|x| x.abs() < 1e-14)
            );
        }
    }

    #[test]
    fn screen_angle_divides_by_magnification_down_to_the_floor() {
        let spread = |a: f64, b: f64| JacobiField {
            across: [DVec3::Y, DVec3::Z],
            matrix: DMat2::from_cols(DVec2::new(a, 0.0), DVec2::new(0.0, b)),
        };
        let e = DVec3::new(7.0, 0.3, 0.4);
        assert!((spread(2.0, 2.0).screen_angle(e, 1.0) - 0.25).abs() < 1e-14);
        assert!((spread(0.0, 4.0).screen_angle(e, 2.0) - (0.6_f64).hypot(0.1)).abs() < 1e-14);
        assert!((spread(3.0, 3.0).screen_angle(e, 3.0) - 0.5 / 3.0).abs() < 1e-14);
    }
}
