//! Any camera and direction in the parameters of a table, and the way back.
//!
//! In: a [`RaySpace`], a camera position and a direction. Out: the [`Place`] of the one, the
//! [`Located`] ray of the other, with the [`Isometry`] that carries the stored ray to the true one.
//!
//! In: how many equal cells each camera interval is divided into, and parameters. Out: the cell that
//! holds them and the parameters in it, in [−1, 1] ([`cell_of`]), and back ([`parameters_in_cell`]).

use super::{RaySpace, Reduction, StoredCamera};
use crate::rays::direction::{aim_of, direction, face_and_parameters};
use geofan_core::{
    error::{Error, Result},
    manifold::Isometry,
};
use geofan_expr::vectorised;
use glam::{DMat3, DVec2, DVec3};

/// A camera position as the bundle sees it.
#[derive(Debug, Clone)]
pub struct Place {
    /// The chart point.
    pub u: DVec3,
    /// `S(u)`.
    pub frame: DMat3,
    /// The wind at `u` and at the stored point.
    winds: Option<[DVec3; 2]>,
    /// Stored camera parameters.
    pub parameters: Vec<f64>,
    /// The stored camera, and the inverse of the standard frame there.
    stored: StoredCamera,
    stored_inverse: DMat3,
    /// The unit vector from the centre; `None` at the centre.
    radial: Option<DVec3>,
    /// Takes the stored point to `u` (for rotations: some rotation; the direction decides which).
    isometry: Isometry,
}

/// A ray as the bundle sees it.
#[derive(Debug, Clone)]
pub struct Located {
    /// Cube face, or face of [`ImpactParameter`](crate::rays::ImpactParameter) under rotation.
    pub face: usize,
    /// Direction parameters in [−1, 1]: (p, q), or one under rotation and then 0.
    pub direction: [f64; 2],
    /// The stored camera point.
    pub u: DVec3,
    /// The stored ray's tangent, chart components.
    pub v: DVec3,
    /// Takes the stored ray to the true one.
    pub isometry: Isometry,
}

/// A ray under rotation symmetry: which of the stored rays it is, and how it lies.
#[derive(Debug, Clone, Copy)]
pub struct Orbit {
    /// Face of [`ImpactParameter`](crate::rays::ImpactParameter).
    pub face: usize,
    /// Direction parameter in [−1, 1].
    pub parameter: f64,
    /// Takes the stored plane to the true one.
    pub rotation: DMat3,
}

impl Located {
    /// The unit vector that a ray on a cube face is known by.
    pub fn aim(&self) -> DVec3 {
        direction(self.face, DVec2::from_array(self.direction))
    }
}

impl RaySpace {
    /// The camera position `asked` in stored parameters: those of a place one period off, where only that is in the region, and
    /// back.
    ///
    /// # Errors
    /// No camera of the region can be carried to `asked` by the symmetry.
    pub fn place(&self, asked: DVec3) -> Result<Place> {
        let mut places = self.manifold.domain.same_places(asked).into_iter();
        let found = places.find_map(|u| Some((u, self.parameters_of(u)?)));
        let (u, parameters) = found.ok_or_else(|| {
            Error::input(
                "camera",
                format!(
                    "the position ({}, {}, {}) is not in the bundle's camera region {}",
                    asked.x,
                    asked.y,
                    asked.z,
                    self.describe()
                ),
            )
        })?;
        let stored = self.stored_camera(&parameters);
        let isometry = match self.reduction {
            Reduction::Whole if u != asked => Isometry::shift(asked - u),
            Reduction::Whole | Reduction::Rotation => Isometry::Identity,
            Reduction::Translation => Isometry::shift(asked - stored.u),
            Reduction::Group => {
                let law = self.manifold.symmetry.group.clone();
                law.map_or(Isometry::Identity, |law| Isometry::left(u, law))
            }
            Reduction::Axis => {
                let (axis, translated) = self.axis();
                let mut shift = asked - u;
                if translated {
                    shift[axis.0] = asked[axis.0] - stored.u[axis.0];
                }
                Isometry::Affine(axis.to(u), shift)
            }
        };
        let winds = self.manifold.wind(u).zip(self.manifold.wind(stored.u));
        Ok(Place {
            u,
            frame: self.manifold.standard_frame(u),
            winds: winds.map(|(here, stored)| [here, stored]),
            stored,
            stored_inverse: self.manifold.standard_frame(stored.u).inverse(),
            radial: u.try_normalize(),
            parameters,
            isometry,
        })
    }

    fn parameters_of(&self, u: DVec3) -> Option<Vec<f64>> {
        let values = self.invariants(u);
        match (self.by_region, self.reduction) {
            (true, Reduction::Whole) => self.region().locate(u),
            (true, Reduction::Axis) => self.match_axis(u),
            (true, _) => self.match_invariants(&values),
            (false, _) => values
                .iter()
                .zip(&self.cameras)
                .map(|(x, [low, high])| {
                    let slack = 1e-9 * (high - low) + 1e-12 * x.abs();
                    (low - slack..=high + slack)
                        .contains(x)
                        .then(|| x.clamp(*low, *high))
                })
                .collect(),
        }
    }

    /// Region parameters whose point has these invariants.
    fn match_invariants(&self, values: &[f64]) -> Option<Vec<f64>> {
        let region = self.region();
        if self.reduction == Reduction::Rotation {
            return self.match_radius(values[0]);
        }
        // Translation: any point with these coordinates will do.
        let translation = self.manifold.symmetry.translation;
        let kept = DVec3::from_array(translation.map(|moves| f64::from(!moves)));
        let mut target = DVec3::ZERO;
        for (k, x) in (0..3).filter(|k| !translation[*k]).zip(values) {
            target[k] = *x;
        }
        region.locate_by(target, &|u, columns| {
            columns.iter_mut().for_each(|column| *column *= kept);
            u * kept
        })
    }

    /// Region parameters whose point is as far from the axis as `u`, and as far along it.
    fn match_axis(&self, u: DVec3) -> Option<Vec<f64>> {
        let (axis, translated) = self.axis();
        let both = |[distance, along]: [f64; 2]| {
            let along = if translated { 0.0 } else { along };
            DVec3::new(distance, along, 0.0)
        };
        let value = |u: DVec3, columns: &mut [DVec3]| {
            for column in columns {
                *column = both(axis.change(u, *column));
            }
            both(axis.invariants(u))
        };
        self.region().locate_by(value(u, &mut []), &value)
    }

    /// The region parameter at which the radius, monotonic over the region, is `rho`, by bisection.
    fn match_radius(&self, rho: f64) -> Option<Vec<f64>> {
        let region = self.region();
        if region.dimension() == 0 {
            let own = region.at(&[]).length();
            return ((rho - own).abs() <= 1e-9 * own.max(1e-300)).then(Vec::new);
        }
        let radius = |p: f64| region.at(&[p]).length();
        let [mut low, mut high] = region.intervals[0];
        let rising = radius(high) > radius(low);
        let [least, most] = if rising { [low, high] } else { [high, low] }.map(radius);
        let slack = 1e-9 * (most - least) + 1e-12 * rho;
        if !(least - slack..=most + slack).contains(&rho) {
            return None;
        }
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if (radius(middle) < rho) == rising {
                low = middle;
            } else {
                high = middle;
            }
        }
        Some(vec![0.5 * (low + high)])
    }

    /// The stored ray at direction parameters, from the camera position stored for `place`.
    pub fn stored_ray(&self, place: &Place, face: usize, direction: [f64; 2]) -> Located {
        let d = self.direction_from(&place.stored, face, &direction);
        let n = place.stored_inverse.inverse() * d;
        Located {
            face,
            direction,
            u: place.stored.u,
            v: place.winds.map_or(n, |[_, wind]| n + wind),
            isometry: Isometry::Identity,
        }
    }

    /// The ray from `place` in the direction `d` (standard frame, unit) in stored parameters.
    pub fn locate(&self, place: &Place, d: DVec3) -> Located {
        let n = place.frame * d;
        let v = place.winds.map_or(n, |[wind, _]| n + wind);
        match self.reduction {
            Reduction::Rotation => {
                let [orbit] = self.orbits(place, &[d]);
                Located {
                    face: orbit.face,
                    direction: [orbit.parameter, 0.0],
                    u: place.stored.u,
                    v: orbit.rotation.transpose() * v,
                    isometry: Isometry::rotation(orbit.rotation),
                }
            }
            _ => {
                let (_, differential) = place.isometry.apply(place.stored.u);
                let back = differential.inverse();
                let (n, v) = (back * n, back * v);
                let d = place.stored_inverse * n;
                let (face, pq) = face_and_parameters(aim_of(d, place.stored.parallax));
                Located {
                    face,
                    direction: pq.to_array(),
                    u: place.stored.u,
                    v,
                    isometry: place.isometry.clone(),
                }
            }
        }
    }

    /// The rays from `place` in the directions `d` (standard frame, unit) under rotation symmetry, side by
    /// side.
    pub fn orbits<const W: usize>(&self, place: &Place, d: &[DVec3; W]) -> [Orbit; W] {
        vectorised(
            #[inline(always)]
            || {
                let [mut radials, mut acrosses] = [[[0.0; W]; 3]; 2];
                let mut stored = [[0.0; W]; 2];
                for l in 0..W {
                    let v = place.frame * d[l];
                    let (radial, across) = plane(place.radial, v);
                    let at = place.stored_inverse * DVec3::new(radial.dot(v), across.dot(v), 0.0);
                    for c in 0..2 {
                        stored[c][l] = at[c];
                    }
                    for c in 0..3 {
                        (radials[c][l], acrosses[c][l]) = (radial[c], across[c]);
                    }
                }
                let radius = place.stored.radius;
                let (faces, parameters) = self.orbits.parameters(&stored, radius);
                std::array::from_fn(|l| {
                    let [radial, across] =
                        [&radials, &acrosses].map(|x| DVec3::new(x[0][l], x[1][l], x[2][l]));
                    Orbit {
                        face: faces[l],
                        parameter: parameters[l],
                        rotation: DMat3::from_cols(radial, across, radial.cross(across)),
                    }
                })
            },
        )
    }
}

/// The axes of the plane through the centre along the tangent `v`: outwards, and across on the side of `v`.
#[inline(always)]
fn plane(radial: Option<DVec3>, v: DVec3) -> (DVec3, DVec3) {
    // At the centre every direction is radial.
    let radial = radial.unwrap_or_else(
        #[inline(always)]
        || v * v.length_recip(),
    );
    let across = v - radial * radial.dot(v);
    let square = across.length_squared();
    let across = match square > 1e-30 * v.length_squared() {
        true => across * (1.0 / square.sqrt()),
        false => radial.any_orthonormal_vector(),
    };
    (radial, across)
}

/// The cell that holds `parameters`, and the parameters in it.
pub fn cell_of(
    cells: &[usize],
    intervals: &[[f64; 2]],
    parameters: &[f64],
) -> (Vec<usize>, Vec<f64>) {
    let axes = cells.iter().zip(intervals).zip(parameters);
    let along = axes.map(|((&n, [low, high]), p)| {
        let t = if high > low {
            (p - low) / (high - low) * n as f64
        } else {
            0.5
        };
        let k = (t.max(0.0) as usize).min(n - 1);
        (k, (2.0 * (t - k as f64) - 1.0).clamp(-1.0, 1.0))
    });
    along.unzip()
}

/// The parameters at `inner` of `cell`: the inverse of [`cell_of`].
pub fn parameters_in_cell(
    cells: &[usize],
    intervals: &[[f64; 2]],
    cell: &[usize],
    inner: &[f64],
) -> Vec<f64> {
    let axes = cells.iter().zip(intervals).zip(cell.iter().zip(inner));
    let along = axes.map(|((&n, [low, high]), (&k, x))| {
        let t = (k as f64 + 0.5 * (x + 1.0)) / n as f64;
        low + (high - low) * t
    });
    along.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::{diagnostic::SourceText, manifold::Manifold, random::Stream};
    use std::sync::Arc;

    const BALL: &str = r#"
name = "ball"
coordinates = ["x", "y", "z"]
metric = { conformal = "1 + 0.3 * exp(-(x^2 + y^2 + z^2))" }
[symmetry]
rotation = "origin"
[cameras]
parameters = { c = [0.0, 3.0] }
at = ["c", "0", "0"]
length = 4.0
"#;

    #[test]
    fn sixteen_rays_side_by_side_are_located_as_each_alone() {
        let manifold = Manifold::from_source(SourceText::new("ball", BALL), &[]).unwrap();
        let space = RaySpace::new(Arc::new(manifold)).unwrap();
        let mut stream = Stream::new(&[6]);
        for u in [DVec3::ZERO, DVec3::new(0.3, -1.1, 0.7), DVec3::X * 2.5] {
            let place = space.place(u).unwrap();
            for _ in 0..20 {
                let d: [DVec3; 16] = std::array::from_fn(|_| stream.direction());
                for (orbit, d) in space.orbits(&place, &d).iter().zip(d) {
                    let [alone] = space.orbits(&place, &[d]);
                    assert_eq!(orbit.face, alone.face);
                    assert!((orbit.parameter - alone.parameter).abs() < 1e-14);
                    assert!(orbit.rotation.abs_diff_eq(alone.rotation, 1e-14));
                    // The ray lies in the first two axes of its plane.
                    let v = place.frame * d;
                    assert!(alone.rotation.z_axis.dot(v).abs() < 1e-12 * v.length());
                }
            }
        }
    }

    /// Flat space but for a ridge along x, with cameras at `at`.
    fn ridge(parameters: &str, at: &str) -> RaySpace {
        let text = format!(
            r#"
name = "ridge"
coordinates = ["x", "y", "z"]
metric = {{ conformal = "1 + 0.3*exp(-(y^2 + z^2))" }}
[symmetry]
translation = ["x"]
[cameras]
parameters = {{ {parameters} }}
at = [{at}]
length = 1.0
"#
        );
        let manifold = Manifold::from_source(SourceText::new("ridge", &text), &[]).unwrap();
        RaySpace::new(Arc::new(manifold)).unwrap()
    }

    #[test]
    fn cameras_are_found_where_the_region_runs_along_what_is_translated() {
        for (parameters, at) in [
            ("c = [-1, 1]", r#""c", "c", "0.2""#),
            ("c = [-1, 1]", r#""5", "c", "0.2""#),
            ("c = [-1, 1], d = [-1, 1]", r#""c + d", "d", "0.2""#),
            ("c = [-1, 1], d = [-1, 1]", r#""c + d", "d", "c""#),
            ("c = [-0.5, 0.5], d = [-0.5, 0.5]", r#""c", "c + d", "0.2""#),
        ] {
            let space = ridge(parameters, at);
            for t in [0.0, 0.03, 0.5, 0.91, 1.0] {
                let region = space.region();
                let point = region.at(&region.lerp(&[1.0 - t, t]));
                let place = space.place(point + DVec3::X * 17.3).unwrap();
                let off = (place.stored.u - point) * DVec3::new(0.0, 1.0, 1.0);
                assert!(off.length() < 1e-9, "{at} {t}");
            }
            assert!(space.place(DVec3::new(0.0, 1.01, 0.2)).is_err());
        }
    }

    #[test]
    fn cameras_are_found_where_a_plane_s_points_differ_by_their_distance_from_the_axis_only() {
        let text = BALL
            .replace("\"origin\"", "\"z\"")
            .replace("x^2 + y^2 + z^2", "x^2 + y^2 + 2*z^2");
        let text = text.replace("c = [0.0, 3.0]", "c = [-1, 1], d = [-1, 1]");
        let text = text.replace(r#""c", "0", "0""#, r#""c", "d", "0.2""#);
        let manifold = Manifold::from_source(SourceText::new("ball", &text), &[]).unwrap();
        let space = RaySpace::new(Arc::new(manifold)).unwrap();
        for u in [
            [0.95, 0.95],
            [-0.2, 0.9],
            [1.0, -1.0],
            [0.0, 0.01],
            [1.3, 0.1],
        ] {
            assert!(space.place(DVec3::new(u[0], u[1], 0.2)).is_ok(), "{u:?}");
        }
        assert!(space.place(DVec3::new(1.3, 0.8, 0.2)).is_err());
    }

    #[test]
    fn cameras_on_a_sphere_are_found_whatever_their_radius_is_rounded_to() {
        for at in [r#""c", "0", "0""#, r#""3", "0", "0""#] {
            let text = BALL.replace("c = [0.0, 3.0]", "c = [3.0, 3.0000001]");
            let text = text.replace(r#""c", "0", "0""#, at);
            let manifold = Manifold::from_source(SourceText::new("ball", &text), &[]).unwrap();
            let space = RaySpace::new(Arc::new(manifold)).unwrap();
            let mut stream = Stream::new(&[7]);
            assert!((0..100).all(|_| space.place(stream.direction() * 3.0).is_ok()));
            assert!(space.place(DVec3::X * 3.00001).is_err());
        }
    }

    #[test]
    fn parameters_come_back() {
        let (cells, intervals) = ([2, 3], [[0.0, 1.0], [-1.0, 1.0]]);
        let (cell, inner) = cell_of(&cells, &intervals, &[0.75, 1.0]);
        assert_eq!((&cell, &inner), (&vec![1, 2], &vec![0.0, 1.0]));
        assert_eq!(
            parameters_in_cell(&cells, &intervals, &cell, &inner),
            [0.75, 1.0]
        );
    }
}
