//! Conjugate points: where neighbouring geodesics from the same start meet again.
//!
//! In: a [`Ray`] and its [`Path`] with frame and deviation carried. Out: the arc lengths at which
//! the transverse deviation `J⊥` is singular, each as often as its rank drops there.
//!
//! `J⊥` is taken in the transported frame, where it begins as `s·1` and turns slowly. Where one
//! direction focuses, `det J⊥` changes sign. Where both focus at once (every direction on S³) it
//! only touches zero, but `J⊥` comes out of it reversed.

use super::{Path, Ray, Step, perpendiculars};
use crate::manifold::Manifold;
use glam::{DMat2, DMat3, DVec2, DVec3};

/// How small `det J⊥` must be against `|J⊥|²` of its neighbourhood for a reversal to count as a
/// double point. An honest one reaches the square of the tolerance; a mere quick turn of `J⊥`
/// leaves about 1.
const FOCUSED: f64 = 1e-3;

/// The conjugate points of `path`, which must be the path of `ray`, in order; empty when frame or
/// deviation was not carried.
pub fn conjugate_points(manifold: &Manifold, ray: &Ray, path: &Path) -> Vec<f64> {
    let d = manifold.local_frame(ray.u).direction(ray.v);
    let across = perpendiculars(d.normalize());
    let mut found = Vec::new();
    // J⊥/s at the start.
    let mut before = DMat2::IDENTITY;
    for step in &path.steps {
        let field = |s: f64| transverse(manifold, step, across, s);
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
            };
            found.extend(piece.conjugate_points());
            before = after;
        }
    }
    found
}

/// `J⊥` at `s` in the transported frame, in the directions `across` of the start.
fn transverse(manifold: &Manifold, step: &Step, across: [DVec3; 2], s: f64) -> Option<DMat2> {
    let u = step.position(s);
    let frame = manifold.standard_frame(u) * DMat3::from_quat(step.rotation(s)?);
    let inverse = frame.inverse();
    // In the wave front, where that is not all across the path.
    let slant = manifold.has_wind().then(|| {
        let v = step.tangent(s);
        let n = inverse * manifold.sight(u, v);
        let path = inverse * v;
        (n, path / n.dot(path))
    });
    let columns = step.deviation(s)?.map(|j| {
        let e = inverse * j;
        let e = match slant {
            Some((n, path)) if path.is_finite() => e - path * n.dot(e),
            _ => e,
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
}

impl Piece<'_> {
    fn conjugate_points(&self) -> Vec<f64> {
        let determinant = |s: f64| (self.field)(s).determinant();
        let negative = self.before.determinant() < 0.0;
        if (self.after.determinant() < 0.0) != negative {
            return vec![crossing(determinant, self.low, self.high, negative)];
        }
        if inner(self.before, self.after) >= 0.0 {
            return Vec::new();
        }
        // Both directions focus; where J⊥ reverses lies between the two, or is both.
        let turn = crossing(
            |s| inner(self.before, (self.field)(s)),
            self.low,
            self.high,
            false,
        );
        let there = determinant(turn);
        let size = inner(self.before, self.before).max(inner(self.after, self.after));
        if (there < 0.0) != negative {
            return vec![
                crossing(determinant, self.low, turn, negative),
                crossing(determinant, turn, self.high, !negative),
            ];
        }
        match there.abs() <= FOCUSED * size {
            true => vec![turn; 2],
            false => Vec::new(),
        }
    }
}

/// `tr aᵀb`.
fn inner(a: DMat2, b: DMat2) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis)
}

/// Where `value` changes sign between `low`, where it is negative or not as said, and `high`; by
/// bisection, to rounding.
fn crossing(value: impl Fn(f64) -> f64, low: f64, high: f64, negative: bool) -> f64 {
    let (mut low, mut high) = (low, high);
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return middle;
        }
        if (value(middle) < 0.0) == negative {
            low = middle;
        } else {
            high = middle;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        diagnostic::SourceText,
        geodesic::{Settings, paths},
        manifold::Carried,
    };

    fn conjugates(text: &str, u: DVec3, d: DVec3, length: f64) -> Vec<f64> {
        let manifold = Manifold::from_source(SourceText::new("test", text), &[]).unwrap();
        let ray = Ray::new(&manifold, u, d.normalize(), length);
        let settings = Settings {
            tolerance: 1e-10,
            carried: Carried {
                frame: true,
                deviation: true,
            },
            events: true,
        };
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
