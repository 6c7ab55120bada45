//! The symmetry that is taken out of cameras: rotations about an axis, the ranges of what is left, and whether rays
//! that are carried into each other end together.
//!
//! In: a chart point. Out: its distance from an axis of the chart and its place along it, the stored point on the
//! meridian with the same two, and the rotation that takes the stored point to it ([`Axis`]). For the axis z the
//! stored point is (ρ, 0, z); for x and y the coordinates follow each other in the same order.
//!
//! In: the camera region. Out: intervals that hold the invariants, and the angular momenta, of all its
//! points: a search on a grid, then from its best point downhill, because extremes lie between the
//! points of a grid.
//!
//! In: a manifold and the symmetry taken out. Out: whether rays that it carries into each other end at the same arc
//! length, found at random points; also whether skies turn with rays. The metric has the symmetry, but exits, limits
//! and conditions need not: a sphere of exits around the origin turns with a rotation, and does not move with a
//! translation. Where the answer is no a stored path must hold beyond its own end, because another camera sees
//! farther along it.

use super::RaySpace;
use crate::rays::Reduction;
use geofan_core::{manifold::Manifold, random::Stream};
use glam::{DMat3, DVec3};
use std::f64::consts::PI;

/// An axis of the chart about which everything may be turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Axis(pub usize);

impl Axis {
    /// The coordinates in which the stored meridian lies and across it.
    fn across(self) -> [usize; 2] {
        [(self.0 + 1) % 3, (self.0 + 2) % 3]
    }

    /// The distance of `u` from the axis and its place along it.
    pub fn invariants(self, u: DVec3) -> [f64; 2] {
        let [i, j] = self.across();
        [u[i].hypot(u[j]), u[self.0]]
    }

    /// The stored point with these invariants.
    pub fn stored(self, [distance, along]: [f64; 2]) -> DVec3 {
        let mut u = DVec3::ZERO;
        u[self.across()[0]] = distance;
        u[self.0] = along;
        u
    }

    /// The rotation by `angle`.
    pub fn rotation(self, angle: f64) -> DMat3 {
        DMat3::from_axis_angle(DVec3::AXES[self.0], angle)
    }

    /// The rotation that takes the stored meridian to `u`; any on the axis itself.
    pub fn to(self, u: DVec3) -> DMat3 {
        let [i, j] = self.across();
        let distance = u[i].hypot(u[j]);
        let (cos, sin) = match distance > 0.0 {
            true => (u[i] / distance, u[j] / distance),
            false => (1.0, 0.0),
        };
        let mut columns = [DVec3::AXES[self.0]; 3];
        columns[i] = DVec3::AXES[i] * cos + DVec3::AXES[j] * sin;
        columns[j] = DVec3::AXES[j] * cos - DVec3::AXES[i] * sin;
        DMat3::from_cols(columns[0], columns[1], columns[2])
    }

    /// Computes the change of the invariants when the point `u` moves by `du`: the distance, then the place.
    pub fn change(self, u: DVec3, du: DVec3) -> [f64; 2] {
        let [i, j] = self.across();
        let distance = u[i].hypot(u[j]);
        let outwards = (u[i] * du[i] + u[j] * du[j]) / distance;
        [if distance > 0.0 { outwards } else { 0.0 }, du[self.0]]
    }
}

/// Number of places at which the region is searched for the range of an invariant.
const RANGE_SAMPLES: usize = 4096;

/// How finely the camera's interval is searched for its least angular momentum.
const ORBIT_SAMPLES: usize = 256;

impl RaySpace {
    /// Returns whether the radius only rises or only falls over a region of one parameter, or none.
    pub(super) fn radius_is_monotonic(&self) -> bool {
        let region = self.region();
        let radius = |i: usize| region.at(&region.lerp(&[i as f64 / 256.0])).length();
        if region.dimension() == 0 {
            return true;
        }
        let rises: Vec<bool> = (0..256).map(|i| radius(i + 1) > radius(i)).collect();
        rises.iter().all(|r| *r) || rises.iter().all(|r| !*r)
    }

    /// Of the largest angular momentum of a ray from a stored camera, the least and the largest over them;
    /// without a wind, those of their areal radii.
    pub(super) fn largest_momenta(&self) -> [f64; 2] {
        let radius = |t: &[f64]| {
            let camera = self.cameras.iter().zip(t);
            let camera: Vec<f64> = camera
                .map(|([low, high], t)| low + (high - low) * t)
                .collect();
            self.radius(self.stored_point(&camera)).most()
        };
        let step = 1.0 / ORBIT_SAMPLES as f64;
        [1.0, -1.0].map(|sign| {
            let value = |t: &[f64]| sign * radius(t);
            let grid = (0..=ORBIT_SAMPLES).map(|i| i as f64 * step);
            let best = grid.min_by(|a, b| value(&[*a]).total_cmp(&value(&[*b])));
            sign * descend(value, vec![best.unwrap_or(0.5)], step)
        })
    }

    /// The intervals of the invariants over the region.
    pub(super) fn ranges(&self) -> Vec<[f64; 2]> {
        let k = self.region().dimension();
        let side = (RANGE_SAMPLES as f64).powf(1.0 / k.max(1) as f64).round() as usize;
        let count = if k == 0 { 1 } else { side.pow(k as u32) };
        let place = |i: usize| -> Vec<f64> {
            let along = |j: usize| i / side.pow(j as u32) % side;
            (0..k)
                .map(|j| along(j) as f64 / (side - 1) as f64)
                .collect()
        };
        let values = |t: &[f64]| self.invariants(self.region().at(&self.region().lerp(t)));
        let grid: Vec<Vec<f64>> = (0..count).map(|i| values(&place(i))).collect();
        let extreme = |j: usize, sign: f64| {
            let value = |t: &[f64]| sign * values(t)[j];
            let best = (0..count).min_by(|&a, &b| {
                let [a, b] = [a, b].map(|i| sign * grid[i][j]);
                a.total_cmp(&b)
            });
            sign * descend(value, place(best.unwrap_or(0)), 1.0 / side as f64)
        };
        let invariants = grid[0].len();
        (0..invariants)
            .map(|j| [extreme(j, 1.0), extreme(j, -1.0)])
            .collect()
    }
}

/// The least value near `t` in the unit cube, by trying both ways along each axis with steps that
/// halve when none helps.
fn descend(value: impl Fn(&[f64]) -> f64, mut t: Vec<f64>, mut step: f64) -> f64 {
    let mut least = value(&t);
    while step > 1e-12 {
        let mut better = false;
        for j in 0..t.len() {
            for to in [t[j] - step, t[j] + step].map(|x| x.clamp(0.0, 1.0)) {
                let before = std::mem::replace(&mut t[j], to);
                let found = value(&t);
                if found < least {
                    (least, better) = (found, true);
                } else {
                    t[j] = before;
                }
            }
        }
        step *= if better { 1.0 } else { 0.5 };
    }
    least
}

/// Random points tried.
const TRIALS: usize = 64;

/// Difference allowed between values of a condition that is unchanged, as a share of their size.
const ROUNDING: f64 = 1e-9;

/// Points are tried up to this many times nearer to the origin and farther than `distance`.
const REACH: f64 = 10.0;

/// Returns whether the ends of rays are unchanged by the symmetry; cameras are about `distance` from the
/// origin.
pub fn follow_symmetry(manifold: &Manifold, reduction: Reduction, distance: f64) -> bool {
    if !manifold.domain.ends_rays() || reduction == Reduction::Whole {
        return true;
    }
    let mut stream = Stream::new(&[0x656e_6473]);
    (0..TRIALS).all(|_| {
        let (scale, u, v) = ray(&mut stream, distance);
        let (moved, turned) = match reduction {
            Reduction::Rotation => {
                let q = stream.rotation();
                (q * u, q * v)
            }
            Reduction::Translation => {
                let free = manifold.symmetry.translation;
                let shift = free.map(|free| if free { stream.between(-1.0, 1.0) } else { 0.0 });
                (u + scale * DVec3::from_array(shift), v)
            }
            Reduction::Axis => {
                let axis = manifold.symmetry.axis.unwrap_or(2);
                let q = Axis(axis).rotation(stream.between(-PI, PI));
                let mut shift = DVec3::ZERO;
                if manifold.symmetry.translation[axis] {
                    shift[axis] = scale * stream.between(-1.0, 1.0);
                }
                (q * u + shift, q * v)
            }
            // No condition but a constant one is unchanged by all left translations.
            Reduction::Group | Reduction::Whole => return false,
        };
        end_together(manifold, (u, v), (moved, turned))
    })
}

/// Returns whether the direction in which a ray looks up the sky of each exit turns with the ray, about the origin.
pub fn skies_turn(manifold: &Manifold, distance: f64) -> bool {
    let mut stream = Stream::new(&[0x736b_6965]);
    (0..manifold.exits.len()).all(|exit| {
        (0..TRIALS).all(|_| {
            let (_, u, v) = ray(&mut stream, distance);
            let q = stream.rotation();
            let sky = |u, v| manifold.sky_direction(Some(exit), u, v);
            let [turned, own] = [q * sky(u, v), sky(q * u, q * v)].map(|sky| sky.to_array());
            turned.iter().zip(own).all(|(x, y)| close(*x, y, 1.0))
        })
    })
}

/// A random ray, and how far from the origin it is.
fn ray(stream: &mut Stream, distance: f64) -> (f64, DVec3, DVec3) {
    let scale = distance.max(f64::MIN_POSITIVE) * REACH.powf(stream.between(-1.0, 1.0));
    let u = stream.direction() * scale;
    (scale, u, stream.direction())
}

/// Returns whether rays at two places (chart point, tangent) end or go on together; which of the ends it is
/// does not matter.
pub fn end_together(manifold: &Manifold, a: (DVec3, DVec3), b: (DVec3, DVec3)) -> bool {
    if !manifold.domain.ends_rays() {
        return true;
    }
    let first = |at| {
        let values = values(manifold, at).into_iter();
        values.fold(f64::NEG_INFINITY, f64::max)
    };
    // The size of what a condition is the difference of, as at a place twice as far from the other.
    let farther = first((2.0 * a.0 - b.0, a.1)).abs();
    let scale = if farther.is_finite() { farther } else { 1.0 };
    close(first(a), first(b), scale)
}

/// The values of all conditions for a ray at `u` with tangent `v`.
fn values(manifold: &Manifold, (u, v): (DVec3, DVec3)) -> Vec<f64> {
    let events = manifold.domain.events();
    events.at(&[u.x, u.y, u.z, v.x, v.y, v.z])
}

/// Compares values but for rounding, where those of this size are common.
fn close(x: f64, y: f64, scale: f64) -> bool {
    (x - y).abs() <= ROUNDING * (scale + x.abs()) || (x.is_nan() && y.is_nan())
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::{diagnostic::SourceText, manifold::Manifold};
    use glam::DVec3;
    use std::sync::Arc;

    #[test]
    fn the_least_radius_of_a_box_around_the_centre_is_found() {
        let text = r#"
name = "flat"
coordinates = ["x", "y", "z"]
metric = { conformal = "1" }
[symmetry]
rotation = "origin"
[cameras]
parameters = { a = [-1, 2], b = [-2, 1], c = [-1, 1] }
at = ["a", "b", "c"]
"#;
        let source = SourceText::new("flat", text);
        let manifold = Arc::new(Manifold::from_source(source, &[]).unwrap());
        let space = RaySpace::new(manifold).unwrap();
        let [least, most] = space.cameras()[0];
        assert!(least.abs() < 1e-9 && (most - 3.0).abs() < 1e-12);
        assert!(space.place(DVec3::new(1e-3, 0.0, 0.0)).is_ok());
    }

    #[test]
    fn points_come_back_from_the_meridian() {
        for axis in [Axis(0), Axis(1), Axis(2)] {
            for u in [
                DVec3::new(0.3, -1.2, 0.7),
                DVec3::AXES[axis.0],
                DVec3::ZERO,
                -DVec3::AXES[(axis.0 + 1) % 3],
            ] {
                let stored = axis.stored(axis.invariants(u));
                let rotation = axis.to(u);
                assert!((rotation * stored - u).length() < 1e-15);
                assert!((rotation.determinant() - 1.0).abs() < 1e-15);
                let turned = axis.rotation(0.4) * u;
                assert!((axis.stored(axis.invariants(turned)) - stored).length() < 1e-15);
            }
        }
    }

    #[test]
    fn changes_of_invariants_are_their_derivatives() {
        let (axis, u, du) = (
            Axis(1),
            DVec3::new(0.3, -1.2, 0.7),
            DVec3::new(2.0, 0.1, -0.4),
        );
        let h = 1e-6;
        let [above, below] = [h, -h].map(|h| axis.invariants(u + du * h));
        let found = axis.change(u, du);
        for k in 0..2 {
            assert!((found[k] - (above[k] - below[k]) / (2.0 * h)).abs() < 1e-8);
        }
    }

    fn manifold(when: &str) -> Manifold {
        with_sky(when, "")
    }

    fn with_sky(when: &str, direction: &str) -> Manifold {
        let text = format!(
            r#"
name = "flat"
coordinates = ["x", "y", "z"]
metric = {{ conformal = "1" }}
[[exit]]
name = "sky"
when = "{when}"
{direction}
[symmetry]
rotation = "origin"
[cameras]
at = ["0", "0", "0"]
length = 1.0
"#
        );
        Manifold::from_source(SourceText::new("flat", &text), &[]).unwrap()
    }

    #[test]
    fn a_sphere_follows_rotations_and_a_plane_does_not() {
        let sphere = manifold("sqrt(x^2 + y^2 + z^2) - 3");
        assert!(follow_symmetry(&sphere, Reduction::Rotation, 1.0));
        assert!(!follow_symmetry(&sphere, Reduction::Group, 1.0));
        let plane = manifold("z - 3");
        assert!(!follow_symmetry(&plane, Reduction::Rotation, 1.0));
        assert!(follow_symmetry(&plane, Reduction::Whole, 1.0));
    }

    #[test]
    fn conditions_are_told_apart_in_any_unit() {
        for scale in [1e-10, 1.0, 1e10] {
            let plane = manifold(&format!("z - {}", 0.7 * scale));
            assert!(!follow_symmetry(&plane, Reduction::Rotation, scale));
            let sphere = manifold(&format!("x^2 + y^2 + z^2 - {}", 9.0 * scale * scale));
            assert!(follow_symmetry(&sphere, Reduction::Rotation, scale));
            // Far from the origin of the chart, as discrete symmetries ask.
            let when = format!(
                "(x - {})^2 + (y - {})^2 + z^2 - {}",
                1e5 * scale,
                0.5 * scale,
                9.0 * scale * scale
            );
            let text = format!(
                "name = 'far'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = '1' }}\nexit = [{{ name = 'sky', when = '{when}' }}]\n"
            );
            let far = Manifold::from_source(SourceText::new("far", &text), &[]).unwrap();
            let at = |y: f64| (DVec3::new(1e5, y, 0.3) * scale, DVec3::X);
            assert!(!end_together(&far, at(0.2), at(-0.2)));
            assert!(end_together(&far, at(0.7), at(0.3)));
        }
    }

    #[test]
    fn skies_turn_with_rays_unless_an_exit_has_axes_of_its_own() {
        let sphere = "sqrt(x^2 + y^2 + z^2) - 3";
        let direction = |d: &str| with_sky(sphere, &format!("direction = {d}"));
        assert!(skies_turn(&manifold(sphere), 1.0));
        assert!(skies_turn(&direction(r#"["x", "y", "z"]"#), 1.0));
        assert!(!skies_turn(&direction(r#"["vx", "vz", "-vy"]"#), 1.0));
    }
}
