//! Neighbouring geodesics: how far they spread, and where they meet again.
//!
//! In: deviations carried along a [`Path`], displacements in the standard frame at a point. Out: the
//! [`JacobiField`] across the path, the area of a unit solid angle `|det J⊥|`, the angle `|δ|` with `J δ = e`
//! that a displacement `e` looks like at the camera, and the conjugate points: the arc lengths at which
//! `J⊥` is singular, each as often as its rank drops there.
//!
//! For conjugate points `J⊥` is taken in the transported frame, where it begins as `s·1` and turns slowly.
//! Where one direction focuses, `det J⊥` changes sign. Where both focus at once (every direction on S³) it
//! only touches zero, but `J⊥` comes out of it reversed.

use super::{Path, Ray, Step, domain_events::crossing};
use crate::manifold::{LocalFrame, Manifold};
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

/// Share of a path's tangent that must point across its wave front for displacements to be moved along it
/// into that: below, they would become more than ten times longer than they are.
const LEAST_ALONG: f64 = 0.1;

/// Least magnification of tangents: a sky that is magnified shows its own grain before the error of a tangent.
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

    /// Computes the field as `local` sees it where there is a wind. A displacement is moved along the path into
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

    /// Computes the angle of an error `e` of the unit tangent, if this is the spread of tangents: the angle on
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

/// Share below which `det J⊥` must fall against its neighbourhood for a reversal to count as a
/// double point. An honest one reaches the square of the tolerance; a mere quick turn of `J⊥`
/// leaves about 1.
const FOCUSED: f64 = 1e-3;

/// Share below which `det J⊥` at a reversal is rounding, so that its sign says nothing.
const DOUBLE: f64 = 1e-14;

/// Share of `|J⊥|²` below which `det J⊥` is rounding and the error of its path: where neighbours part by ten million times
/// more in one direction than in the other, nothing is known of the other.
const NOISE: f64 = 1e-7;

/// Tells whether `det J⊥` is negative; `None` where that is not known.
fn is_negative(j: DMat2) -> Option<bool> {
    let determinant = j.determinant();
    (determinant.abs() > NOISE * inner(j, j)).then_some(determinant < 0.0)
}

/// The conjugate points of `path`, which must be the path of `ray`, in order; empty when frame or
/// deviation was not carried.
pub fn conjugate_points(manifold: &Manifold, ray: &Ray, path: &Path) -> Vec<f64> {
    let d = manifold.local_frame(ray.u).direction(ray.v);
    let across = perpendiculars(d.normalize());
    let mut found = Vec::new();
    // J⊥/s at the start.
    let mut before = DMat2::IDENTITY;
    // The last known sign of its determinant.
    let mut negative = false;
    for step in &path.steps {
        let field = |s: f64| transverse(manifold, step, across, s);
        // Across an edge of the metric `J⊥` jumps; a reflection turns it round without a focus.
        if step.start > 0.0
            && let Some(start) = field(step.start)
            && !near(start, before)
        {
            before = start;
            negative = is_negative(start).unwrap_or(negative);
        }
        let middle = 0.5 * (step.start + step.end);
        for (low, high) in [(step.start, middle), (middle, step.end)] {
            let Some(after) = field(high) else {
                return found;
            };
            let piece = Piece {
                field: &|s| field(s).unwrap_or(DMat2::NAN),
                low,
                high,
                before,
                after,
                negative,
            };
            found.extend(piece.conjugate_points());
            before = after;
            negative = is_negative(after).unwrap_or(negative);
        }
    }
    found
}

/// Returns whether two values of `J⊥` are those of one place but for the errors of two steps' curves.
fn near(a: DMat2, b: DMat2) -> bool {
    let size = |m: DMat2| m.x_axis.length_squared() + m.y_axis.length_squared();
    size(a - b) <= 1e-6 * size(b)
}

/// Computes `J⊥` at `s` in the transported frame, in the directions `across` of the start; of no numbers where the path nearly
/// runs within its wave front.
fn transverse(manifold: &Manifold, step: &Step, across: [DVec3; 2], s: f64) -> Option<DMat2> {
    let u = step.position(s);
    let frame = manifold.standard_frame(u) * step.frame(s)?;
    let inverse = frame.inverse();
    // In the wave front, where that is not all across the path.
    let slant = manifold.has_wind().then(|| {
        let v = step.tangent(s);
        let n = inverse * manifold.sight(u, v);
        let path = inverse * v;
        let along = n.dot(path);
        match along.abs() > LEAST_ALONG * path.length() {
            true => (n, path / along),
            false => (n, DVec3::NAN),
        }
    });
    let columns = step.deviation(s)?.map(|j| {
        let e = inverse * j;
        let e = match slant {
            Some((n, path)) => e - path * n.dot(e),
            None => e,
        };
        DVec2::new(across[0].dot(e), across[1].dot(e))
    });
    Some(DMat2::from_cols(columns[0], columns[1]))
}

/// A piece of a path so short that each direction focuses at most once on it.
struct Piece<'a> {
    field: &'a dyn Fn(f64) -> DMat2,
    low: f64,
    high: f64,
    before: DMat2,
    after: DMat2,
    /// The last known sign of `det J⊥` before.
    negative: bool,
}

impl Piece<'_> {
    fn conjugate_points(&self) -> Vec<f64> {
        let negative = self.negative;
        let zero = |low: f64, high: f64, rises: bool| {
            let sign = if rises { 1.0 } else { -1.0 };
            crossing(low, high, |s| sign * (self.field)(s).determinant())
        };
        let Some(after) = is_negative(self.after) else {
            return Vec::new();
        };
        if after != negative {
            return vec![zero(self.low, self.high, negative)];
        }
        if inner(self.before, self.after) >= 0.0 {
            return Vec::new();
        }
        // Both directions focus; where J⊥ reverses lies between the two, or is both.
        let turn = crossing(self.low, self.high, |s| {
            -inner(self.before, (self.field)(s))
        });
        let there = (self.field)(turn);
        let beside = [self.before, self.after].map(|j| j.determinant().abs());
        let share = there.determinant().abs() / beside[0].max(beside[1]);
        if share > DOUBLE && is_negative(there).is_some_and(|there| there != negative) {
            return vec![
                zero(self.low, turn, negative),
                zero(turn, self.high, !negative),
            ];
        }
        match share <= FOCUSED {
            true => vec![turn; 2],
            false => Vec::new(),
        }
    }
}

/// `tr aᵀb`.
fn inner(a: DMat2, b: DMat2) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        diagnostic::SourceText,
        geodesic::{Settings, paths},
    };

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

    fn conjugates(text: &str, u: DVec3, d: DVec3, length: f64) -> Vec<f64> {
        let manifold = Manifold::from_source(SourceText::new("test", text), &[]).unwrap();
        let ray = Ray::new(&manifold, u, d.normalize(), length);
        let settings = Settings::bare(1e-10)
            .with_frame()
            .with_deviation()
            .with_events();
        let path = paths(&manifold, settings, [ray]).remove(0);
        conjugate_points(&manifold, &ray, &path)
    }

    #[test]
    fn every_direction_focuses_twice_on_the_sphere() {
        let s3 = "name = 's3'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }";
        let found = conjugates(
            s3,
            DVec3::new(0.2, 0.1, -0.3),
            DVec3::new(1.0, 2.0, -0.5),
            7.0,
        );
        let pi = std::f64::consts::PI;
        assert_eq!(found.len(), 4, "{found:?}");
        for (s, expected) in found.iter().zip([pi, pi, 2.0 * pi, 2.0 * pi]) {
            assert!((s - expected).abs() < 1e-7, "{found:?}");
        }
    }

    #[test]
    fn nothing_focuses_where_one_direction_parts_exponentially() {
        let s = "2/(1 - x^2 - y^2)";
        let text = format!(
            "name = 'h2xr'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ xx = '({s})^2', yy = '({s})^2', zz = '1' }}"
        );
        let (u, d) = (DVec3::new(0.1, 0.0, 0.0), DVec3::new(0.3, 1.0, 0.9));
        assert_eq!(conjugates(&text, u, d, 30.0), Vec::<f64>::new());
        // A ray that hugs the horizon of a drain runs within its wave front at last.
        let text = "name = 'drain'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\nwind = ['(-0.6*y - 0.4*x)/(x^2 + y^2)', '(0.6*x - 0.4*y)/(x^2 + y^2)', '0']\n[domain]\ninside = ['x^2 + y^2 - 0.02']\n[cameras]\nat = ['3', '0', '0']";
        let (u, d) = (DVec3::new(3.0, 0.0, 0.0), DVec3::new(-1.0, 0.8, -0.1));
        assert_eq!(conjugates(text, u, d, 18.0), Vec::<f64>::new());
    }

    #[test]
    fn one_direction_focuses_on_a_sphere_times_a_line() {
        let text = "name = 's2xr'\ncoordinates = ['x', 'y', 'z']\nmetric = { xx = '4/(1 + x^2 + y^2)^2', yy = '4/(1 + x^2 + y^2)^2', zz = '1' }";
        // The part across the line runs at 0.8 of the speed.
        let found = conjugates(
            text,
            DVec3::new(0.3, 0.2, 0.0),
            DVec3::new(0.8, 0.0, 0.6),
            8.0,
        );
        let first = std::f64::consts::PI / 0.8;
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((found[0] - first).abs() < 1e-8 && (found[1] - 2.0 * first).abs() < 1e-8);
    }

    #[test]
    fn nothing_focuses_in_flat_space() {
        let flat = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }";
        assert!(conjugates(flat, DVec3::ZERO, DVec3::X, 30.0).is_empty());
    }
}
