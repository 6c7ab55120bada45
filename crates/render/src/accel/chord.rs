//! Where a chord meets one triangle.
//!
//! In: the chord's ends and the triangle's corners, double precision. Out: place on the chord and
//! on the triangle.
//!
//! The test is the watertight one of Woop, Benthin and Wald (2013): two triangles that share an
//! edge compute the same number for it with opposite sign, so no chord slips between them.

use glam::DVec3;

/// How far before its start and past its end, in its own length, a chord still hits. Consecutive
/// chords share an end, and rounding (1e-16 times the distance to the triangle) must not let a hit
/// there fall out of both.
pub(super) const END_MARGIN: f64 = 1e-12;
/// Coordinates beyond this are treated like infinite ones, so that no product overflows.
const LARGEST: f64 = 1e100;

/// A chord sheared so that it runs along the third axis from 0 to 1.
pub(super) struct Chord {
    start: DVec3,
    axes: [usize; 3],
    shear: DVec3,
}

impl Chord {
    /// `None` for a chord without length or with an end that is not finite.
    pub(super) fn new(a: DVec3, b: DVec3) -> Option<Self> {
        let way = b - a;
        if !is_usable(a) || !is_usable(b) || way == DVec3::ZERO {
            return None;
        }
        let z = way.abs().max_position();
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        let shear = DVec3::new(way[axes[0]], way[axes[1]], 1.0) / way[z];
        Some(Self {
            start: a,
            axes,
            shear,
        })
    }

    /// Where the chord meets the triangle: place on the chord, weights of corners two and three.
    pub(super) fn meet(&self, corners: &[DVec3; 3]) -> Option<(f64, (f64, f64))> {
        let [a, b, c] = corners.map(|p| self.sheared(p));
        let edges = DVec3::new(
            c.x * b.y - c.y * b.x,
            a.x * c.y - a.y * c.x,
            b.x * a.y - b.y * a.x,
        );
        if edges.min_element() < 0.0 && edges.max_element() > 0.0 {
            return None;
        }
        let sum = edges.x + edges.y + edges.z;
        let weights = edges / sum;
        let t = weights.dot(DVec3::new(a.z, b.z, c.z));
        // Seen edge-on the sum is zero and `t` not a number, which no range contains.
        let on_chord = (-END_MARGIN..=1.0 + END_MARGIN).contains(&t);
        on_chord.then(|| (t.clamp(0.0, 1.0), (weights.y, weights.z)))
    }

    fn sheared(&self, p: DVec3) -> DVec3 {
        let p = p - self.start;
        let [x, y, z] = self.axes.map(|axis| p[axis]);
        DVec3::new(x - self.shear.x * z, y - self.shear.y * z, self.shear.z * z)
    }
}

/// Whether the point is finite, with room to multiply.
pub(super) fn is_usable(p: DVec3) -> bool {
    p.abs().cmple(DVec3::splat(LARGEST)).all()
}
