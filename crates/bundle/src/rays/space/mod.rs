//! The space of rays that a bundle has to know: camera positions and directions after symmetry has
//! been taken out.
//!
//! In: a manifold with its camera region. Out: [`RaySpace`]: the intervals of the camera and
//! direction parameters, the map parameters → ray ([`RaySpace::ray`]), and its inverse: any camera
//! and direction → parameters and the [`Isometry`] that carries the stored ray to the true one
//! ([`RaySpace::place`], [`RaySpace::locate`]).
//!
//! Directions are those in which the normal observer sees light come: where there is a wind, tangents
//! differ from them by it.
//!
//! On cube faces directions are known by what they aim at ([`ReferenceSphere`]).
//!
//! | symmetry | stored cameras | stored directions |
//! |---|---|---|
//! | none | the region's parameters | the sphere, on cube faces |
//! | rotation | (ρ, 0, 0) | (cos θ, sin θ, 0), 0 ≤ θ ≤ π, by [`ImpactParameter`] |
//! | rotation about an axis | (ρ, 0, z), or (ρ, 0, 0) if that is translated along | the sphere |
//! | translation | the other coordinates, or the region's parameters if fewer | the sphere |
//! | group | the identity | the sphere |

mod place;
mod reduction;

pub use place::{Located, Orbit, Place, cell_of, parameters_in_cell};
pub use reduction::Axis;
pub(super) use reduction::end_together;

use super::{
    direction::{FACES, ImpactParameter, Radius, ReferenceSphere, Sphere, direction, direction_of},
    mirror::Mirror,
    position::ChartMap,
};
use geofan_core::{
    error::{Error, Result},
    manifold::{Manifold, Symmetry},
};
use glam::{DVec2, DVec3};
use reduction::{follow_symmetry, skies_turn};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The symmetry that has been taken out.
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
    /// Rotations about an axis of the chart, and translations along it if there are any.
    Axis,
}

impl Reduction {
    /// Names the symmetry.
    pub fn name(self) -> &'static str {
        match self {
            Self::Whole => "none",
            Self::Rotation => "rotation",
            Self::Translation => "translation",
            Self::Group => "group",
            Self::Axis => "axis",
        }
    }

    /// The one that leaves the fewest invariants, and their number.
    fn best(symmetry: &Symmetry) -> (Self, usize) {
        let translated = symmetry.translation.iter().filter(|t| **t).count();
        let about = symmetry
            .axis
            .map(|k| 2 - usize::from(symmetry.translation[k]));
        match about {
            _ if symmetry.group.is_some() => (Self::Group, 0),
            _ if symmetry.rotation => (Self::Rotation, 1),
            Some(left) if left < 3 - translated => (Self::Axis, left),
            _ if translated > 0 => (Self::Translation, 3 - translated),
            _ => (Self::Whole, 3),
        }
    }
}

/// The rays a bundle covers.
#[derive(Debug, Clone)]
pub struct RaySpace {
    manifold: Arc<Manifold>,
    reduction: Reduction,
    /// Intervals of the stored camera parameters.
    cameras: Vec<[f64; 2]>,
    /// Set if the stored camera parameters are the region's own (else invariants: the radius, or
    /// the coordinates not translated).
    by_region: bool,
    /// Parameters of directions under rotation.
    orbits: ImpactParameter,
    /// The coordinates in which chart points are stored.
    chart_map: ChartMap,
    /// Set if rays that the symmetry carries into each other end alike.
    ends_alike: bool,
    /// How far behind each exit tables end paths.
    ends: Vec<Option<f64>>,
    /// Set if skies turn with rays under rotation.
    skies_turn: bool,
    /// Discrete symmetries beside the one taken out.
    mirrors: Vec<Mirror>,
    /// The sphere at which directions on cube faces aim.
    reference_sphere: ReferenceSphere,
    /// The axes of the sphere if all directions are held together.
    sphere: Option<Sphere>,
}

/// The part of stored rays that all from one camera share.
#[derive(Debug, Clone, Copy)]
pub struct StoredCamera {
    /// The chart point.
    pub u: DVec3,
    parallax: DVec3,
    /// Where stored paths are planar.
    radius: Radius,
}

impl StoredCamera {
    /// The direction of the ray that is known by the unit vector `aim`.
    pub fn direction(&self, aim: DVec3) -> DVec3 {
        direction_of(aim, self.parallax)
    }
}

impl RaySpace {
    /// The rays of all cameras in the manifold's region.
    ///
    /// # Errors
    /// The manifold has no camera region.
    pub fn new(manifold: Arc<Manifold>) -> Result<Self> {
        // Paths are those of the covering space, whatever is glued.
        let manifold = match manifold.gluing() {
            Some(_) => Arc::new(manifold.cover().into_owned()),
            None => manifold,
        };
        let Some(region) = &manifold.cameras else {
            return Err(Error::input(
                manifold.source.name.clone(),
                "no camera region: add [cameras] with `at`, or limits for all coordinates under [domain]",
            ));
        };
        let (reduction, invariants) = Reduction::best(&manifold.symmetry);
        let mut space = Self {
            reduction,
            cameras: region.intervals.clone(),
            by_region: true,
            manifold: manifold.clone(),
            orbits: ImpactParameter::default(),
            chart_map: ChartMap::None,
            ends_alike: true,
            ends: Vec::new(),
            skies_turn: false,
            mirrors: Vec::new(),
            reference_sphere: ReferenceSphere::default(),
            sphere: None,
        };
        let own = reduction != Reduction::Group && region.dimension() <= invariants;
        if !(own && (reduction != Reduction::Rotation || space.radius_is_monotonic())) {
            space.by_region = false;
            space.cameras = space.ranges();
        }
        if reduction == Reduction::Rotation {
            let [least, most] = space.largest_momenta();
            space.orbits = ImpactParameter::new(least, most);
        }
        let middle = region.at(&region.lerp(&[0.5; 3])).length();
        let distance = middle.max(1.0);
        space.ends_alike = follow_symmetry(&space.manifold, reduction, distance);
        space.skies_turn =
            reduction == Reduction::Rotation && skies_turn(&space.manifold, distance);
        Ok(space)
    }

    /// The manifold; of a glued one the covering space.
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

    /// Returns whether a stored ray ends where every ray does that the symmetry makes of it: if not, what
    /// is stored must hold beyond its end.
    pub fn ends_alike(&self) -> bool {
        self.ends_alike
    }

    /// Returns how far behind the exit of this number in [`Manifold::exits`] tables end paths, as a share of their arc
    /// length; `None` if they go on.
    pub fn end_behind(&self, exit: usize) -> Option<f64> {
        self.ends.get(exit).copied().flatten()
    }

    /// Tells whether tables end paths behind any exit.
    pub fn has_ends(&self) -> bool {
        self.ends.iter().any(Option::is_some)
    }

    /// Returns whether rays that rotations carry into each other look up the sky in directions that they carry into
    /// each other.
    pub fn skies_turn(&self) -> bool {
        self.skies_turn
    }

    /// The coordinates in which chart points are stored.
    pub fn chart_map(&self) -> ChartMap {
        self.chart_map
    }

    /// Returns these rays with chart points stored in another way.
    pub fn with_chart_map(mut self, chart_map: ChartMap) -> Self {
        self.chart_map = chart_map;
        self
    }

    /// Returns these rays, whose paths tables end so far behind each exit, as a share of their arc length. Only who bakes
    /// needs to know.
    pub fn ending_behind(mut self, ends: Vec<Option<f64>>) -> Self {
        self.ends = ends;
        self
    }

    /// Returns these rays, of which `mirrors` carry some into others.
    pub fn mirrored(mut self, mirrors: Vec<Mirror>) -> Self {
        self.mirrors = mirrors;
        self
    }

    /// Returns these rays, aimed in another way; `focus` has the cells of the table.
    pub fn with_reference_sphere(mut self, reference_sphere: ReferenceSphere) -> Self {
        self.reference_sphere = reference_sphere;
        self
    }

    /// Returns these rays, those in all directions held together on this sphere; `None` if each face is held
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

    /// Returns whether stored paths stay in the plane z = 0, whose normal then stays parallel.
    pub fn planar(&self) -> bool {
        self.reduction == Reduction::Rotation
    }

    /// Lists the channels that can differ from zero for stored rays.
    pub fn channels(&self) -> &'static [usize] {
        self.chart_map.channels(self.planar())
    }

    fn region(&self) -> &geofan_core::manifold::CameraRegion {
        // `new` refuses manifolds without a region.
        self.manifold.cameras.as_ref().expect("checked on creation")
    }

    /// The circumference over 2π of the circle through the stored point `u` on the x axis, and the wind
    /// there, which is radial.
    fn radius(&self, u: DVec3) -> Radius {
        let g = self.manifold.metric(u);
        let wind = self.manifold.wind(u);
        Radius {
            areal: u.x * g.y_axis.y.sqrt(),
            wind: wind.map_or(0.0, |wind| wind.x * g.x_axis.x.sqrt()),
        }
    }

    /// The axis about which rotations have been taken out, and whether translations along it have.
    fn axis(&self) -> (Axis, bool) {
        let symmetry = &self.manifold.symmetry;
        let axis = symmetry.axis.unwrap_or(2);
        (Axis(axis), symmetry.translation[axis])
    }

    /// The values at `u` of what the symmetry leaves unchanged.
    fn invariants(&self, u: DVec3) -> Vec<f64> {
        match self.reduction {
            Reduction::Axis => {
                let (axis, translated) = self.axis();
                let mut both = axis.invariants(u).to_vec();
                both.truncate(if translated { 1 } else { 2 });
                both
            }
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
                Reduction::Axis => {
                    let (axis, _) = self.axis();
                    let [_, along] = axis.invariants(point);
                    let along = parameters.get(1).copied().unwrap_or(along);
                    point = axis.stored([parameters[0], along]);
                }
            }
            point
        };
        match self.reduction {
            Reduction::Rotation => DVec3::X * point.length(),
            Reduction::Axis => {
                let (axis, _) = self.axis();
                axis.stored(axis.invariants(point))
            }
            _ => point,
        }
    }

    /// The stored ray at camera and direction parameters: chart point and direction in the standard
    /// frame.
    pub fn ray(&self, face: usize, camera: &[f64], directions: &[f64]) -> (DVec3, DVec3) {
        let camera = self.stored_camera(camera);
        (camera.u, self.direction_from(&camera, face, directions))
    }

    /// The stored ray at camera parameters that is known by the unit vector `aim`.
    pub fn ray_aimed(&self, camera: &[f64], aim: DVec3) -> (DVec3, DVec3) {
        let camera = self.stored_camera(camera);
        (camera.u, camera.direction(aim))
    }

    /// Computes what all stored rays at camera parameters share.
    pub fn stored_camera(&self, parameters: &[f64]) -> StoredCamera {
        let u = self.stored_point(parameters);
        let planar = self.planar();
        StoredCamera {
            u,
            parallax: if planar {
                DVec3::ZERO
            } else {
                self.parallax(u, parameters)
            },
            radius: if planar {
                self.radius(u)
            } else {
                Radius::default()
            },
        }
    }

    /// The direction, in the standard frame, of the stored ray from `camera` at direction parameters.
    pub fn direction_from(&self, camera: &StoredCamera, face: usize, directions: &[f64]) -> DVec3 {
        if !self.planar() {
            let aim = direction(face, DVec2::new(directions[0], directions[1]));
            return camera.direction(aim);
        }
        let theta = self.orbits.angle(face, directions[0], camera.radius);
        DVec3::new(theta.cos(), theta.sin(), 0.0)
    }

    /// The parallax of the camera at the stored point `u` with these parameters.
    fn parallax(&self, u: DVec3, camera: &[f64]) -> DVec3 {
        match self.reference_sphere.middle(&self.cameras, camera) {
            Some(middle) => self
                .reference_sphere
                .parallax(u - self.stored_point(&middle)),
            None => DVec3::ZERO,
        }
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
            Reduction::Whole => String::new(),
            Reduction::Rotation => " (and its rotations about the origin)".into(),
            Reduction::Translation => " (and its translations)".into(),
            Reduction::Group => " (and its left translations)".into(),
            Reduction::Axis => {
                let (Axis(axis), translated) = self.axis();
                let along = if translated {
                    ", and translations along it"
                } else {
                    ""
                };
                let name = &self.manifold.coordinates[axis];
                format!(" (and its rotations about the {name} axis{along})")
            }
        };
        match intervals.is_empty() {
            true => format!("of one point{symmetry}"),
            false => format!("{}{symmetry}", intervals.join(", ")),
        }
    }
}
