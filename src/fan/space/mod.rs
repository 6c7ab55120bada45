//! The space of rays that a bundle has to know: camera positions and directions after symmetry has
//! been taken out.
//!
//! In: a manifold with its camera region. Out: [`FanSpace`]: the intervals of the camera and
//! direction parameters, the map parameters → ray ([`FanSpace::ray`]), and its inverse: any camera
//! and direction → parameters and the [`Isometry`] that carries the stored ray to the true one
//! ([`FanSpace::place`], [`FanSpace::locate`]).
//!
//! On cube faces directions are known by what they aim at ([`Focus`]).
//!
//! | symmetry | stored cameras | stored directions |
//! |---|---|---|
//! | none | the region's parameters | the sphere, on cube faces |
//! | rotation | (ρ, 0, 0) | (cos θ, sin θ, 0), 0 ≤ θ ≤ π, by [`OrbitAngles`] |
//! | translation | the other coordinates, or the region's parameters if fewer | the sphere |
//! | group | the identity | the sphere |

mod ranges;

use super::{
    direction::{FACES, direction, face_and_parameters},
    ends::follow_symmetry,
    focus::{Focus, aim_of, direction_of},
    mirror::Mirror,
    orbit::OrbitAngles,
    position::Lift,
    sphere::Sphere,
};
use crate::{
    error::{Error, Result},
    manifold::{Isometry, Manifold},
};
use glam::{DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Which symmetry has been taken out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reduction {
    /// None.
    Whole,
    /// Rotations about the origin: one direction parameter is left.
    Rotation,
    /// Translations along coordinates.
    Translation,
    /// Left translations: one camera position is left.
    Group,
}

/// The rays a bundle covers.
#[derive(Debug, Clone)]
pub struct FanSpace {
    manifold: Arc<Manifold>,
    reduction: Reduction,
    /// Intervals of the stored camera parameters.
    cameras: Vec<[f64; 2]>,
    /// Whether the stored camera parameters are the region's own (else invariants: the radius, or
    /// the coordinates not translated).
    by_region: bool,
    /// How directions are divided under rotation.
    orbits: OrbitAngles,
    /// How chart points are stored.
    lift: Lift,
    /// Whether rays that the symmetry carries into each other end alike.
    ends_alike: bool,
    /// Discrete symmetries beside the one taken out.
    mirrors: Vec<Mirror>,
    /// How far away directions on cube faces aim.
    focus: Focus,
    /// The axes of the sphere if all directions are held together.
    sphere: Option<Sphere>,
}

/// A camera position as the bundle sees it.
#[derive(Debug, Clone)]
pub struct Place {
    /// The chart point.
    pub u: DVec3,
    /// `S(u)`.
    pub frame: DMat3,
    /// Stored camera parameters.
    pub parameters: Vec<f64>,
    /// The stored chart point, the inverse of its standard frame, and (under rotation) its areal
    /// radius.
    stored: DVec3,
    stored_inverse: DMat3,
    areal_radius: f64,
    /// Of the stored point in its cell.
    parallax: DVec3,
    /// Takes the stored point to `u` (for rotations: some rotation; the direction decides which).
    isometry: Isometry,
}

/// A ray as the bundle sees it.
#[derive(Debug, Clone)]
pub struct Located {
    /// Cube face, or face of [`OrbitAngles`] under rotation.
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

impl Located {
    /// The unit vector that a ray on a cube face is known by.
    pub fn aim(&self) -> DVec3 {
        direction(self.face, DVec2::from_array(self.direction))
    }
}

impl FanSpace {
    /// The rays of all cameras in the manifold's region.
    ///
    /// # Errors
    /// The manifold has no camera region.
    pub fn new(manifold: Arc<Manifold>) -> Result<Self> {
        let Some(region) = &manifold.cameras else {
            return Err(Error::input(
                manifold.source.name.clone(),
                "no camera region: add [cameras] with `at`, or limits for all coordinates under [domain]",
            ));
        };
        let symmetry = &manifold.symmetry;
        let translated = symmetry.translation.iter().filter(|t| **t).count();
        let (reduction, invariants) = if symmetry.group.is_some() {
            (Reduction::Group, 0)
        } else if symmetry.rotation {
            (Reduction::Rotation, 1)
        } else if translated > 0 {
            (Reduction::Translation, 3 - translated)
        } else {
            (Reduction::Whole, 3)
        };
        let mut space = Self {
            reduction,
            cameras: region.intervals.clone(),
            by_region: true,
            manifold: manifold.clone(),
            orbits: OrbitAngles::default(),
            lift: Lift::None,
            ends_alike: true,
            mirrors: Vec::new(),
            focus: Focus::default(),
            sphere: None,
        };
        let own = reduction != Reduction::Group && region.dimension() <= invariants;
        if !(own && (reduction != Reduction::Rotation || space.radius_is_monotonic())) {
            space.by_region = false;
            space.cameras = space.ranges();
        }
        if reduction == Reduction::Rotation {
            let [least, most] = space.areal_radii();
            space.orbits = OrbitAngles::new(least, most);
        }
        let middle = region.at(&region.lerp(&[0.5; 3])).length();
        space.ends_alike = follow_symmetry(&space.manifold, reduction, middle.max(1.0));
        Ok(space)
    }

    /// The manifold.
    pub fn manifold(&self) -> &Arc<Manifold> {
        &self.manifold
    }

    /// The symmetry taken out.
    pub fn reduction(&self) -> Reduction {
        self.reduction
    }

    /// Intervals of the stored camera parameters.
    pub fn cameras(&self) -> &[[f64; 2]] {
        &self.cameras
    }

    /// The number of faces that directions are divided into.
    pub fn faces(&self) -> usize {
        match self.reduction {
            Reduction::Rotation => self.orbits.faces(),
            _ => FACES,
        }
    }

    /// The number of direction parameters; each runs over [−1, 1].
    pub fn directions(&self) -> usize {
        match self.reduction {
            Reduction::Rotation => 1,
            _ => 2,
        }
    }

    /// Whether a stored ray ends where every ray does that the symmetry makes of it: if not, what
    /// is stored must hold beyond its end.
    pub fn ends_alike(&self) -> bool {
        self.ends_alike
    }

    /// How chart points are stored.
    pub fn lift(&self) -> Lift {
        self.lift
    }

    /// The same rays with chart points stored in another way.
    pub fn lifted(mut self, lift: Lift) -> Self {
        self.lift = lift;
        self
    }

    /// The same rays, of which `mirrors` carry some into others.
    pub fn mirrored(mut self, mirrors: Vec<Mirror>) -> Self {
        self.mirrors = mirrors;
        self
    }

    /// The same rays, aimed in another way; `focus` has the cells of the table.
    pub fn focused(mut self, focus: Focus) -> Self {
        self.focus = focus;
        self
    }

    /// The same rays, those in all directions held together on this sphere; `None` if each face is held
    /// by itself.
    pub fn on_sphere(mut self, sphere: Option<Sphere>) -> Self {
        self.sphere = sphere;
        self
    }

    /// The sphere if all directions are held together.
    pub fn sphere(&self) -> Option<Sphere> {
        self.sphere
    }

    /// The number of blocks in which directions are held: each face is one, or all are together.
    pub fn blocks(&self) -> usize {
        match self.sphere {
            Some(_) => 1,
            None => self.faces(),
        }
    }

    /// The block that holds a face.
    pub fn block(&self, face: usize) -> usize {
        match self.sphere {
            Some(_) => 0,
            None => face,
        }
    }

    /// Discrete symmetries that are used.
    pub fn mirrors(&self) -> &[Mirror] {
        &self.mirrors
    }

    /// The stored chart point at camera parameters scaled to [−1, 1].
    pub(super) fn stored_at(&self, t: &[f64]) -> DVec3 {
        let scaled = self.cameras.iter().zip(t);
        let scaled = scaled.map(|([low, high], t)| low + 0.5 * (t + 1.0) * (high - low));
        self.stored_point(&scaled.collect::<Vec<f64>>())
    }

    /// The stored chart point in the middle of the camera region.
    pub(super) fn middle(&self) -> DVec3 {
        self.stored_at(&vec![0.0; self.cameras.len()])
    }

    /// Whether stored paths stay in the plane z = 0, whose normal then stays parallel.
    pub fn planar(&self) -> bool {
        self.reduction == Reduction::Rotation
    }

    /// Which channels can differ from zero for stored rays.
    pub fn channels(&self) -> &'static [usize] {
        self.lift.channels(self.planar())
    }

    fn region(&self) -> &crate::manifold::CameraRegion {
        // `new` refuses manifolds without a region.
        self.manifold.cameras.as_ref().expect("checked on creation")
    }

    /// The circumference over 2π of the circle through the stored point `u` on the x axis.
    fn areal_radius(&self, u: DVec3) -> f64 {
        u.x * self.manifold.metric(u).y_axis.y.sqrt()
    }

    /// The values at `u` of what the symmetry leaves unchanged.
    fn invariants(&self, u: DVec3) -> Vec<f64> {
        match self.reduction {
            Reduction::Whole => u.to_array().to_vec(),
            Reduction::Rotation => vec![u.length()],
            Reduction::Translation => {
                let kept = |k: &usize| !self.manifold.symmetry.translation[*k];
                (0..3).filter(kept).map(|k| u[k]).collect()
            }
            Reduction::Group => Vec::new(),
        }
    }

    /// The stored chart point at stored camera parameters.
    pub fn stored_point(&self, parameters: &[f64]) -> DVec3 {
        let point = if self.by_region {
            self.region().at(parameters)
        } else {
            let mut point = self.region().at(&self.region().lerp(&[0.5; 3]));
            match self.reduction {
                Reduction::Rotation => point = DVec3::X * parameters[0],
                Reduction::Translation => {
                    let kept = (0..3).filter(|k| !self.manifold.symmetry.translation[*k]);
                    for (k, value) in kept.zip(parameters) {
                        point[k] = *value;
                    }
                }
                Reduction::Group => point = DVec3::ZERO,
                Reduction::Whole => {}
            }
            point
        };
        match self.reduction {
            Reduction::Rotation => DVec3::X * point.length(),
            _ => point,
        }
    }

    /// The stored ray at camera and direction parameters: chart point and direction in the standard
    /// frame.
    pub fn ray(&self, face: usize, camera: &[f64], directions: &[f64]) -> (DVec3, DVec3) {
        if self.reduction != Reduction::Rotation {
            let aim = direction(face, DVec2::new(directions[0], directions[1]));
            return self.ray_aimed(camera, aim);
        }
        let u = self.stored_point(camera);
        let theta = self.orbits.angle(face, directions[0], self.areal_radius(u));
        (u, DVec3::new(theta.cos(), theta.sin(), 0.0))
    }

    /// The stored ray at camera parameters that is known by the unit vector `aim`.
    pub fn ray_aimed(&self, camera: &[f64], aim: DVec3) -> (DVec3, DVec3) {
        let u = self.stored_point(camera);
        (u, direction_of(aim, self.parallax(u, camera)))
    }

    /// The parallax of the camera at the stored point `u` with these parameters.
    fn parallax(&self, u: DVec3, camera: &[f64]) -> DVec3 {
        match self.focus.middle(&self.cameras, camera) {
            Some(middle) => self.focus.parallax(u - self.stored_point(&middle)),
            None => DVec3::ZERO,
        }
    }

    /// The camera position `u` in stored parameters.
    ///
    /// # Errors
    /// No camera of the region can be carried to `u` by the symmetry.
    pub fn place(&self, u: DVec3) -> Result<Place> {
        let parameters = self.parameters_of(u).ok_or_else(|| {
            Error::input(
                "camera",
                format!(
                    "the position ({}, {}, {}) is not in the bundle's camera region {}",
                    u.x,
                    u.y,
                    u.z,
                    self.describe()
                ),
            )
        })?;
        let stored = self.stored_point(&parameters);
        let isometry = match self.reduction {
            Reduction::Whole | Reduction::Rotation => Isometry::Identity,
            Reduction::Translation => Isometry::shift(u - stored),
            Reduction::Group => {
                let tape = self.manifold.symmetry.group.clone();
                tape.map_or(Isometry::Identity, |tape| Isometry::left(u, tape))
            }
        };
        Ok(Place {
            u,
            frame: self.manifold.standard_frame(u),
            stored,
            stored_inverse: self.manifold.standard_frame(stored).inverse(),
            areal_radius: self.areal_radius(stored),
            parallax: self.parallax(stored, &parameters),
            parameters,
            isometry,
        })
    }

    /// The region in words, for messages.
    pub fn describe(&self) -> String {
        let region = self.region();
        let intervals: Vec<String> = region
            .names
            .iter()
            .zip(&region.intervals)
            .map(|(name, [low, high])| format!("{low} <= {name} <= {high}"))
            .collect();
        let symmetry = match self.reduction {
            Reduction::Whole => "",
            Reduction::Rotation => " (and its rotations about the origin)",
            Reduction::Translation => " (and its translations)",
            Reduction::Group => " (and its left translations)",
        };
        match intervals.is_empty() {
            true => format!("of one point{symmetry}"),
            false => format!("{}{symmetry}", intervals.join(", ")),
        }
    }

    fn parameters_of(&self, u: DVec3) -> Option<Vec<f64>> {
        let values = self.invariants(u);
        match (self.by_region, self.reduction) {
            (true, Reduction::Whole) => self.region().locate(u),
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
        // Translation: any point with these coordinates will do; move the region's middle there.
        let mut target = region.at(&region.lerp(&[0.5; 3]));
        let kept = (0..3).filter(|k| !self.manifold.symmetry.translation[*k]);
        for (k, x) in kept.zip(values) {
            target[k] = *x;
        }
        region.locate(target)
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
        let slack = 1e-9 * (most - least);
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
        let (u, d) = self.ray(face, &place.parameters, &direction);
        Located {
            face,
            direction,
            u,
            v: place.stored_inverse.inverse() * d,
            isometry: Isometry::Identity,
        }
    }

    /// The ray from `place` in the direction `d` (standard frame, unit) in stored parameters.
    pub fn locate(&self, place: &Place, d: DVec3) -> Located {
        let v = place.frame * d;
        match self.reduction {
            Reduction::Rotation => self.locate_rotated(place, v),
            _ => {
                let (_, differential) = place.isometry.apply(place.stored);
                let v = differential.inverse() * v;
                let d = place.stored_inverse * v;
                let (face, pq) = face_and_parameters(aim_of(d, place.parallax));
                Located {
                    face,
                    direction: pq.to_array(),
                    u: place.stored,
                    v,
                    isometry: place.isometry.clone(),
                }
            }
        }
    }

    fn locate_rotated(&self, place: &Place, v: DVec3) -> Located {
        // At the centre every direction is radial.
        let radial = place.u.try_normalize().unwrap_or(v.normalize());
        let across = v - radial * radial.dot(v);
        let across = match across.length() > 1e-15 * v.length() {
            true => across.normalize(),
            false => radial.any_orthonormal_vector(),
        };
        let q = DMat3::from_cols(radial, across, radial.cross(across));
        let v = q.transpose() * v;
        let d = place.stored_inverse * v;
        let theta = d.y.atan2(d.x);
        let (face, parameter) = self.orbits.parameter(theta, place.areal_radius);
        Located {
            face,
            direction: [parameter, 0.0],
            u: place.stored,
            v,
            isometry: Isometry::rotation(q),
        }
    }
}
