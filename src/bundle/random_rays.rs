//! Random rays for comparing tables with exact paths.
//!
//! In: a space of rays, how many, and a key. Out: [`RandomRays`], the same for any number of threads.
//! Cameras are uniform over the region's parameters and moved by a random element of the symmetry;
//! directions are uniform over the sphere; each ray is compared at one arc length, uniform up to the
//! end of its exact path.

use crate::{
    error::{Error, Result},
    fan::{Axis, FanSpace, Reduction},
    manifold::{CameraRegion, Manifold},
    random::Stream,
};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Random rays from one camera.
#[derive(Debug, Clone)]
pub struct RandomRays {
    /// The camera.
    pub u: DVec3,
    /// Directions in the standard frame, unit.
    pub directions: Vec<DVec3>,
    /// For each, the share of its path at which it is compared, in (0, 1].
    pub shares: Vec<f64>,
}

/// Rays from each camera: contracting the table for one costs about as much as so many exact rays.
const DIRECTIONS: usize = 16;

/// Random cameras tried for one that lies in the domain.
const ATTEMPTS: usize = 1000;

impl RandomRays {
    /// `rays` rays of `space`, those of each camera together; another `key` gives others.
    ///
    /// # Errors
    /// There is no region, or none of many cameras lies in the domain.
    pub fn all(
        space: &FanSpace,
        rays: usize,
        key: [u64; 2],
    ) -> impl IndexedParallelIterator<Item = Result<Self>> {
        let cameras = (0..rays.div_ceil(DIRECTIONS)).into_par_iter();
        cameras.map(move |camera| {
            let count = DIRECTIONS.min(rays - camera * DIRECTIONS);
            let mut stream = Stream::new(&[key[0], key[1], camera as u64]);
            Ok(Self {
                u: random_camera(space, &mut stream)?,
                directions: (0..count).map(|_| stream.direction()).collect(),
                shares: (0..count).map(|_| 1.0 - stream.uniform()).collect(),
            })
        })
    }
}

/// A camera of the region, moved by the symmetry, where rays can start.
fn random_camera(space: &FanSpace, stream: &mut Stream) -> Result<DVec3> {
    let manifold = space.manifold();
    let region = manifold.cameras.as_ref();
    let region = region.ok_or_else(|| Error::input(&manifold.source.name, "no camera region"))?;
    let found = (0..ATTEMPTS)
        .map(|_| moved(space.reduction(), manifold, region, stream))
        .find(|u| crate::geodesic::check_point(manifold, "camera", *u).is_ok());
    found.ok_or_else(|| {
        let message = format!("none of {ATTEMPTS} random cameras lies in the domain");
        Error::input(&manifold.source.name, message)
    })
}

fn moved(
    reduction: Reduction,
    manifold: &Manifold,
    region: &CameraRegion,
    stream: &mut Stream,
) -> DVec3 {
    let t: Vec<f64> = (0..region.dimension()).map(|_| stream.uniform()).collect();
    let mut u = region.at(&region.lerp(&t));
    let mut anywhere = |k: usize| {
        let [low, high] = manifold.domain.limits[k].unwrap_or([-1.0, 1.0]);
        stream.between(low, high)
    };
    match reduction {
        Reduction::Whole => {}
        Reduction::Rotation => u = stream.rotation() * u,
        Reduction::Axis => {
            let axis = manifold.symmetry.axis.unwrap_or(2);
            if manifold.symmetry.translation[axis] {
                u[axis] = anywhere(axis);
            }
            u = Axis(axis).rotation(stream.between(-PI, PI)) * u;
        }
        Reduction::Translation => {
            for k in (0..3).filter(|k| manifold.symmetry.translation[*k]) {
                u[k] = anywhere(k);
            }
        }
        // The group acts simply transitively: the identity goes to any point.
        Reduction::Group => u = DVec3::from_array([0, 1, 2].map(anywhere)),
    }
    u
}
