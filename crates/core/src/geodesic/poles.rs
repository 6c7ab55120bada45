//! Geodesics that meet a pole of the chart: the metric ends there and the space does not, as on the axis of polar
//! coordinates.
//!
//! In: how a geodesic ended. Out: whether that was at a pole; directions beside it, turned by an angle so small that what
//! is met is the same, in which the geodesic passes the pole. At a true singularity they end as well.
//!
//! So close to a pole the coordinates of neighbours part and come back by ten million times, and their spread drowns in
//! rounding. It is the mean of those of two geodesics farther off on either side.

use super::{End, Path, Ray, Sample, Settings, conjugate_points, paths, perpendiculars, sample};
use crate::manifold::{LocalFrame, Manifold};
use glam::DVec3;

/// Axes of the standard frame that are so many times as long as each other are those of a pole.
const POLE_STRETCH: f64 = 1e6;

/// Angle (radians) by which a geodesic that meets a pole is turned. A smaller one moves the path less, and takes more steps.
/// In flat space in polar coordinates the path is off by 1e-7 of its length, in two thousand steps.
pub const PASSING_ANGLE: f64 = 1e-7;

/// Angle (radians) by which those are turned whose spread is taken: on a sphere rounding leaves 1e-7 of the area then, with a
/// tenth of the angle 3e-5, with a hundredth 1e-3. The mean of both sides is off by the square.
const SPREAD_ANGLE: f64 = 1e-4;

/// A ray, or one beside it, and its path.
#[derive(Debug, Clone)]
pub struct RayPath {
    /// The ray that was followed.
    pub ray: Ray,
    /// Its path.
    pub path: Path,
    /// Where it was turned to pass a pole and deviations were carried: rays on either side, whose spread has a mean that is
    /// the path's own.
    beside: Option<[(Ray, Path); 2]>,
}

impl RayPath {
    /// Computes the sample of the path at arc length `s` up to its end.
    pub fn sample(&self, manifold: &Manifold, s: f64) -> Sample {
        let mut found = sample(manifold, &self.ray, &self.path, s);
        if let Some(beside) = &self.beside {
            let areas = beside.each_ref().map(|(ray, path)| {
                let s = s.min(path.length);
                sample(manifold, ray, path, s).area
            });
            found.area = areas[0].zip(areas[1]).map(|(a, b)| 0.5 * (a + b));
        }
        found
    }

    /// Returns `count` equally spaced samples of the path; at least two.
    pub fn samples(&self, manifold: &Manifold, count: usize) -> Vec<Sample> {
        let last = count.max(2) - 1;
        (0..=last)
            .map(|i| self.path.length * (i as f64 / last as f64))
            .map(|s| self.sample(manifold, s))
            .collect()
    }

    /// Returns the conjugate points of the path, in order; none when frame or deviation was not carried.
    pub fn conjugate_points(&self, manifold: &Manifold) -> Vec<f64> {
        let of = |(ray, path): &(Ray, Path)| conjugate_points(manifold, ray, path);
        match self.beside.as_ref().map(|beside| beside.each_ref().map(of)) {
            Some([a, b]) if a.len() == b.len() => {
                let means = a.iter().zip(b).map(|(a, b)| 0.5 * (a + b));
                means.filter(|s| *s <= self.path.length).collect()
            }
            // One has come to its end before the other.
            _ => conjugate_points(manifold, &self.ray, &self.path),
        }
    }
}

/// Tells whether a geodesic that ended at `u` met a pole of the chart: the metric broke down, or did so where
/// the coordinates have their limit.
pub fn meets_pole(manifold: &Manifold, end: End, u: DVec3) -> bool {
    match end {
        End::Singular => true,
        End::Exit(k) if manifold.exits[k].name == "limit" => {
            let frame = manifold.standard_frame(u);
            let lengths = [0, 1, 2].map(|k| frame.col(k).length());
            let [least, most] = [f64::min, f64::max].map(|of| lengths.into_iter().reduce(of));
            !(most.unwrap_or(1.0) <= POLE_STRETCH * least.unwrap_or(1.0))
        }
        _ => false,
    }
}

/// Turns the direction of the tangent `v` by `angle` to two sides, across each other (standard frame, unit).
pub fn beside(local: &LocalFrame, v: DVec3, angle: f64) -> [DVec3; 2] {
    let d = local.direction(v);
    perpendiculars(d).map(|across| (d + across * angle).normalize())
}

/// Follows all `starts`. One whose result `meets` a pole of the chart is followed again from the start `turned` to
/// side 0, and if it meets a pole there too, to side 1; if that does as well, its first result stays. Returns each
/// result with the start that led to it.
pub fn follow_past_poles<S: Clone, T>(
    starts: &[S],
    follow: impl Fn(&[S]) -> Vec<T>,
    meets: impl Fn(&(S, T)) -> bool,
    turned: impl Fn(&S, usize) -> S,
) -> Vec<(S, T)> {
    let follow = |starts: Vec<S>| -> Vec<(S, T)> {
        let found = follow(&starts);
        starts.into_iter().zip(found).collect()
    };
    let mut all = follow(starts.to_vec());
    for side in 0..2 {
        let lost: Vec<usize> = (0..all.len()).filter(|i| meets(&all[*i])).collect();
        if lost.is_empty() {
            break;
        }
        let again = follow(lost.iter().map(|i| turned(&starts[*i], side)).collect());
        for (i, found) in lost.into_iter().zip(again) {
            if !meets(&found) {
                all[i] = found;
            }
        }
    }
    all
}

/// Follows `rays` and keeps their paths: instead of one that meets a pole of the chart, that of the first of those turned
/// by [`PASSING_ANGLE`] that does not.
pub fn paths_beside_poles(manifold: &Manifold, settings: Settings, rays: &[Ray]) -> Vec<RayPath> {
    let follow = |rays: &[Ray]| paths(manifold, settings, rays.iter().copied());
    let meets = |(ray, path): &(Ray, Path)| {
        let end = path.steps.last().map_or(ray.u, |s| s.position(path.length));
        meets_pole(manifold, path.end, end)
    };
    let aside = |ray: &Ray, side: usize| turned(manifold, ray, PASSING_ANGLE, side);
    let followed = follow_past_poles(rays, follow, meets, aside);
    let each = rays.iter().zip(followed);
    each.map(|(asked, (ray, path))| RayPath {
        beside: match settings.carried.deviation && ray.v != asked.v {
            true => farther_aside(manifold, settings, asked, (&ray, &path)),
            false => None,
        },
        ray,
        path,
    })
    .collect()
}

/// Follows two rays farther off on either side of the one `asked` for, in the plane in which it was `turned`; `None` if they
/// end otherwise.
fn farther_aside(
    manifold: &Manifold,
    settings: Settings,
    asked: &Ray,
    (turned_ray, path): (&Ray, &Path),
) -> Option<[(Ray, Path); 2]> {
    let side =
        (0..2).find(|side| turned(manifold, asked, PASSING_ANGLE, *side).v == turned_ray.v)?;
    let rays = [SPREAD_ANGLE, -SPREAD_ANGLE].map(|angle| turned(manifold, asked, angle, side));
    let followed: [Path; 2] = paths(manifold, settings, rays).try_into().ok()?;
    let alike = followed.iter().all(|other| other.end == path.end);
    let [first, second] = followed;
    alike.then(|| [(rays[0], first), (rays[1], second)])
}

/// Turns a ray to one of two sides by an angle.
fn turned(manifold: &Manifold, ray: &Ray, angle: f64, side: usize) -> Ray {
    let local = manifold.local_frame(ray.u);
    let d = beside(&local, ray.v, angle)[side];
    Ray::seen_by(&local, ray.u, d, ray.length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::SourceText;
    use glam::DMat3;

    const POLAR: &str = r#"
        name = "Flat space in polar coordinates"
        coordinates = ["r", "theta", "phi"]
        metric = { rr = "1", thetatheta = "r^2", phiphi = "(r*sin(theta))^2" }
        [domain]
        theta = [0, 3.14159265358979]
        phi = [-3.14159265358979, 3.14159265358979]
        periodic = ["phi"]
        [cameras]
        parameters = { c = [1.0, 6.0] }
        at = ["c", "1.2", "0.3"]
        length = 12
    "#;

    fn cartesian(u: DVec3) -> DVec3 {
        let (theta, phi) = (u.y.sin_cos(), u.z.sin_cos());
        u.x * DVec3::new(theta.0 * phi.1, theta.0 * phi.0, theta.1)
    }

    /// Columns: the unit vectors along the coordinates.
    fn axes(u: DVec3) -> DMat3 {
        let (theta, phi) = (u.y.sin_cos(), u.z.sin_cos());
        DMat3::from_cols(
            DVec3::new(theta.0 * phi.1, theta.0 * phi.0, theta.1),
            DVec3::new(theta.1 * phi.1, theta.1 * phi.0, -theta.0),
            DVec3::new(-phi.0, phi.1, 0.0),
        )
    }

    #[test]
    fn straight_lines_go_on_through_the_axis_of_polar_coordinates() {
        let manifold = Manifold::from_source(SourceText::new("polar", POLAR), &[]).unwrap();
        let start = DVec3::new(5.0, 1.2, 0.3);
        // Through the origin, and through the axis beside it.
        for to in [
            DVec3::ZERO,
            DVec3::new(0.0, 0.0, 3.0),
            DVec3::new(0.0, 0.0, -1.5),
        ] {
            let (from, axes) = (cartesian(start), axes(start));
            let direction = (to - from).normalize();
            let ray = Ray::new(&manifold, start, axes.transpose() * direction, 12.0);
            let settings = Settings::bare(1e-10).with_events().with_frame();
            let followed = paths_beside_poles(&manifold, settings, &[ray]).remove(0);
            let (turned, path) = (followed.ray, followed.path);
            assert_eq!(path.end, End::Length, "towards {to}");
            assert!((turned.v - ray.v).length() < 2.0 * PASSING_ANGLE);
            let step = path.steps.last().unwrap();
            let (u, v) = (step.position(12.0), step.tangent(12.0));
            let expected = from + 12.0 * direction;
            let off = cartesian(manifold.domain.wrap(u)).distance(expected);
            assert!(off < 20.0 * PASSING_ANGLE, "towards {to}: off by {off:e}");
            let along = self::axes(u) * manifold.local_frame(u).direction(v);
            assert!(
                along.distance(direction) < 5.0 * PASSING_ANGLE,
                "towards {to}"
            );
        }
    }

    #[test]
    fn what_ends_at_a_singularity_ends_there() {
        let text = "name = 'wall'\ncoordinates = ['x', 'y', 'z']\n\
                    metric = { conformal = '1/sqrt(x)' }\n[cameras]\n\
                    parameters = { c = [1.0, 2.0] }\nat = ['c', '0', '0']";
        let manifold = Manifold::from_source(SourceText::new("wall", text), &[]).unwrap();
        let ray = Ray::new(&manifold, DVec3::new(1.0, 0.2, 0.1), -DVec3::X, 12.0);
        let settings = Settings::bare(1e-10).with_events();
        let RayPath {
            ray: followed,
            path,
            ..
        } = paths_beside_poles(&manifold, settings, &[ray]).remove(0);
        assert_eq!((path.end, followed.v), (End::Singular, ray.v));
        assert!((path.length - 2.0).abs() < 1e-6, "{}", path.length);
    }

    #[test]
    fn the_spread_behind_a_pole_is_that_of_other_geodesics() {
        let text = "name = 's2xr'\ncoordinates = ['theta', 'phi', 'w']\n\
                    metric = { thetatheta = '1', phiphi = 'sin(theta)^2', ww = '1' }\n\
                    domain = { theta = [0, 3.141592653589793], phi = [0, 6.283185307179586], periodic = ['phi'] }";
        let manifold = Manifold::from_source(SourceText::new("s2xr", text), &[]).unwrap();
        for (climb, tolerance) in [(0.0, 1e-10), (0.3, 1e-11), (-1.0, 1e-12)] {
            let direction = DVec3::new(1.0, 0.0, climb).normalize();
            let ray = Ray::new(&manifold, DVec3::new(1.2, 0.5, 0.0), direction, 4.0);
            let settings = Settings::bare(tolerance).with_events();
            let settings = settings.with_frame().with_deviation();
            let followed = paths_beside_poles(&manifold, settings, &[ray]).remove(0);
            assert!(followed.ray.v != ray.v);
            // The part along the sphere runs at this speed; its area is s sin(speed s)/speed.
            let speed = direction.x;
            for s in [1.0, 2.0, 3.5] {
                let expected = (s * (speed * s).sin() / speed).abs();
                let area = followed.sample(&manifold, s).area.unwrap();
                assert!((area - expected).abs() < 1e-5, "{s}: {area} {expected}");
            }
            let conjugate = followed.conjugate_points(&manifold);
            let first = std::f64::consts::PI / speed;
            assert_eq!(conjugate.len(), usize::from(first < 4.0));
            assert!(
                conjugate.iter().all(|s| (s - first).abs() < 1e-5),
                "{conjugate:?}"
            );
        }
    }
}
