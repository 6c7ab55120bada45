//! Whether rays that the symmetry carries into each other end at the same arc length.
//!
//! In: a manifold and the symmetry taken out. Out: a yes or no, found at random points; also whether skies
//! turn with rays. The metric
//! has the symmetry, but exits, limits and conditions need not: a sphere of exits around the origin
//! turns with a rotation, and does not move with a translation. Where the answer is no a stored path
//! must hold beyond its own end, because another camera sees farther along it.

use super::{Axis, Reduction};
use geofan_core::{manifold::Manifold, random::Stream};
use glam::DVec3;
use std::f64::consts::PI;

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
            turned.iter().zip(own).all(|(x, y)| close(*x, y))
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
    let first = |at| {
        let values = values(manifold, at).into_iter();
        values.fold(f64::NEG_INFINITY, f64::max)
    };
    !manifold.domain.ends_rays() || close(first(a), first(b))
}

/// The values of all conditions for a ray at `u` with tangent `v`.
fn values(manifold: &Manifold, (u, v): (DVec3, DVec3)) -> Vec<f64> {
    let events = manifold.domain.events();
    events.at(&[u.x, u.y, u.z, v.x, v.y, v.z])
}

fn close(x: f64, y: f64) -> bool {
    (x - y).abs() <= ROUNDING * (1.0 + x.abs()) || (x.is_nan() && y.is_nan())
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::diagnostic::SourceText;

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
at = ["1", "0", "0"]
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
    fn skies_turn_with_rays_unless_an_exit_has_axes_of_its_own() {
        let sphere = "sqrt(x^2 + y^2 + z^2) - 3";
        let direction = |d: &str| with_sky(sphere, &format!("direction = {d}"));
        assert!(skies_turn(&manifold(sphere), 1.0));
        assert!(skies_turn(&direction(r#"["x", "y", "z"]"#), 1.0));
        assert!(!skies_turn(&direction(r#"["vx", "vz", "-vy"]"#), 1.0));
    }
}
