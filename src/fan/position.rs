//! How a chart point on a path is stored.
//!
//! In: a path's start (chart point `u₀`, tangent `v₀`) and its chart point `u` at arc length `s`.
//! Out: channels that are smooth in all parameters, and back. A point is first lifted to `X ∈ R⁴`,
//! and what is stored is the displacement from the straight line there, over the arc length:
//! `D = (X(s) − X₀)/s − X₀'`.
//!
//! - [`Lift::None`]: `X = (u, 0)`.
//! - [`Lift::Sphere`] of radius ℓ: `X = (2ℓu, |u|² − ℓ²)/(|u|² + ℓ²)`, the inverse of stereographic
//!   projection, for charts whose infinity is an ordinary place: paths through it are smooth on the
//!   sphere, and no polynomial in the chart. The chart's standard frame has no limit there; seen
//!   from a frame of left-invariant fields of the sphere (unit quaternions) it is turned by
//!   `p(u) = (ℓ + u)/√(ℓ² + |u|²)` ([`Lift::twist`]), and `p(u) q` is continuous along paths through
//!   infinity where the transported rotation `q` is not.

use glam::{DQuat, DVec3, DVec4};
use serde::{Deserialize, Serialize};

/// How chart points are stored.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub enum Lift {
    /// As they are.
    #[default]
    None,
    /// On a sphere that touches the chart's space; the chart's `|u| = radius` is its equator.
    Sphere {
        /// ℓ, in chart units.
        radius: f64,
    },
}

/// The start of a path, lifted.
#[derive(Debug, Clone, Copy)]
pub struct Start {
    x: DVec4,
    slope: DVec4,
}

impl Lift {
    /// The lifted point.
    fn point(self, u: DVec3) -> DVec4 {
        match self {
            Self::None => u.extend(0.0),
            Self::Sphere { radius } => {
                let w = u / radius;
                (2.0 * w).extend(w.length_squared() - 1.0) / (w.length_squared() + 1.0)
            }
        }
    }

    /// The lifted tangent.
    fn tangent(self, u: DVec3, v: DVec3) -> DVec4 {
        match self {
            Self::None => v.extend(0.0),
            Self::Sphere { radius } => {
                let (w, dw) = (u / radius, v / radius);
                let (sum, change) = (w.length_squared() + 1.0, 2.0 * w.dot(dw));
                (2.0 * dw).extend(change) / sum - self.point(u) * (change / sum)
            }
        }
    }

    /// The chart point of the lifted one.
    fn project(self, x: DVec4) -> DVec3 {
        match self {
            Self::None => x.truncate(),
            Self::Sphere { radius } => {
                let x = x.normalize();
                radius * x.truncate() / (1.0 - x.w)
            }
        }
    }

    /// The chart tangent of the lifted one.
    fn project_tangent(self, x: DVec4, slope: DVec4) -> DVec3 {
        match self {
            Self::None => slope.truncate(),
            Self::Sphere { radius } => {
                let length = x.length();
                let x = x / length;
                let slope = (slope - x * x.dot(slope)) / length;
                let below = 1.0 - x.w;
                radius * (slope.truncate() + x.truncate() * (slope.w / below)) / below
            }
        }
    }

    /// By how much the chart point `u` moves when its lifted one moves by `change`.
    pub fn chart_change(self, u: DVec3, change: DVec4) -> DVec3 {
        self.project_tangent(self.point(u), change)
    }

    /// The path's start at chart point `u` with tangent `v`.
    pub fn start(self, u: DVec3, v: DVec3) -> Start {
        Start {
            x: self.point(u),
            slope: self.tangent(u, v),
        }
    }

    /// What is stored for the chart point `u` at arc length `s`.
    pub fn encode(self, start: &Start, u: DVec3, s: f64) -> [f64; 4] {
        ((self.point(u) - start.x) / s - start.slope).to_array()
    }

    /// The chart point of stored values.
    pub fn decode(self, start: &Start, values: [f64; 4], s: f64) -> DVec3 {
        let rate = start.slope + DVec4::from_array(values);
        self.project(start.x + rate * s)
    }

    /// Chart point and tangent of stored values and their slopes in `s`.
    pub fn decode_state(
        self,
        start: &Start,
        values: [f64; 4],
        slopes: [f64; 4],
        s: f64,
    ) -> (DVec3, DVec3) {
        let rate = start.slope + DVec4::from_array(values);
        let x = start.x + rate * s;
        let slope = rate + DVec4::from_array(slopes) * s;
        (self.project(x), self.project_tangent(x, slope))
    }

    /// The rotation that takes the standard frame at `u` to one that is continuous wherever the
    /// lifted point is; up to the frame's own departure from the chart's axes.
    pub fn twist(self, u: DVec3) -> DQuat {
        match self {
            Self::None => DQuat::IDENTITY,
            Self::Sphere { radius } => {
                let w = u / radius;
                DQuat::from_vec4(w.extend(1.0)).normalize()
            }
        }
    }

    /// Which of the stored values can differ from zero; for paths in the plane z = 0 if `planar`.
    pub fn displacement_channels(self, planar: bool) -> &'static [usize] {
        match (self, planar) {
            (Self::None, false) => &[0, 1, 2],
            (Self::None, true) => &[0, 1],
            (Self::Sphere { .. }, false) => &[0, 1, 2, 3],
            (Self::Sphere { .. }, true) => &[0, 1, 3],
        }
    }

    /// Which quaternion components (x, y, z, w) can differ from zero; for rotations about the z axis
    /// if `planar`.
    pub fn rotation_channels(self, planar: bool) -> &'static [usize] {
        match (self, planar) {
            (Self::None, true) => &[2, 3],
            _ => &[0, 1, 2, 3],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIFTS: [Lift; 2] = [Lift::None, Lift::Sphere { radius: 0.7 }];

    #[test]
    fn decoding_inverts_encoding() {
        for lift in LIFTS {
            let (u, v) = (DVec3::new(0.3, -1.2, 0.5), DVec3::new(0.2, 0.9, -0.4));
            let start = lift.start(u, v);
            for (to, s) in [
                (DVec3::new(5.0, -3.0, 40.0), 2.5),
                (DVec3::splat(1e-3), 0.1),
            ] {
                let found = lift.decode(&start, lift.encode(&start, to, s), s);
                assert!((found - to).length() < 1e-11 * (1.0 + to.length_squared()));
            }
        }
    }

    #[test]
    fn the_tangent_is_the_derivative_of_the_point() {
        for lift in LIFTS {
            let start = lift.start(DVec3::new(0.3, -1.2, 0.5), DVec3::new(0.2, 0.9, -0.4));
            let values = |s: f64| [0.1 * s, 0.3 * s * s, -0.2 * s, 0.05 * s];
            let slopes = |s: f64| [0.1, 0.6 * s, -0.2, 0.05];
            let at = |s: f64| lift.decode(&start, values(s), s);
            let (u, v) = lift.decode_state(&start, values(0.8), slopes(0.8), 0.8);
            let h = 1e-5;
            let difference = (at(0.8 + h) - at(0.8 - h)) / (2.0 * h);
            assert!((u - at(0.8)).length() < 1e-14);
            assert!((v - difference).length() < 1e-8, "{v} {difference}");
        }
    }
}
