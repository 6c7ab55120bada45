//! Fresh rays followed exactly, and the errors of any table on them.
//!
//! In: a manifold's rays, their number and a seed. Out: [`ExactFan`]s, made once for a manifold so that
//! all tables are compared on the same rays, and the [`TableErrors`] of one. Rays and errors are those
//! of `geofan check`: [`RandomRays`].

use crate::{
    rival::{ProbedFan, finite},
    sweep::grid::Grid,
};
use geofan_bake::RandomRays;
use geofan_bundle::{
    Table,
    measure::{Deviation, Probed, probe, settings, with_end},
    rays::RaySpace,
};
use geofan_core::{Result, quantiles::Quantiles};
use glam::{DQuat, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Keeps these random numbers apart from those that steer a bake.
const KEY: u64 = 0x7377_6565_7021;

/// Local tolerance of the exact tracer, radians: far below the best table's error.
const TOLERANCE: f64 = 1e-11;

/// Rays from one camera, with their exact states.
#[derive(Debug, Clone)]
pub struct ExactFan {
    /// The camera.
    pub u: DVec3,
    /// Directions in the standard frame, and the exact states along them.
    pub rays: Vec<(DVec3, Probed)>,
}

/// Tells the errors of a table as quantiles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TableErrors {
    /// Transverse distance over arc length, mrad.
    pub mrad: Quantiles,
    /// The distance divided by the ray's magnification, mrad.
    pub screen: Quantiles,
    /// Sky error of the tangents at exits, mrad; without exits, at the places of the others.
    pub sky: Quantiles,
    /// Angle between the transported rotations, mrad; none if the table has none.
    pub rotation: Option<Quantiles>,
    /// The share of rays of which the table gives up a part.
    pub flagged: f64,
}

/// A table's paths from one camera: the value in a direction at an arc length (chart point with tangent, and the transported
/// rotation of a table that has one), `None` where the table gives up, and the arc length from which on it does.
pub type FanValues<'a> =
    Box<dyn Fn(DVec3, f64) -> (Option<((DVec3, DVec3), Option<DQuat>)>, f64) + 'a>;

/// Gives paths from any camera of a region.
pub trait FanTable: Sync {
    /// Fixes the camera at `u`.
    ///
    /// # Errors
    /// `u` is not in the camera region.
    fn fan_at(&self, u: DVec3) -> Result<FanValues<'_>>;
}

impl FanTable for Table {
    fn fan_at(&self, u: DVec3) -> Result<FanValues<'_>> {
        let fan = self.fan(u)?;
        Ok(Box::new(move |d, s| {
            let path = fan.path(d);
            let known = path.at(s).map(|state| (state, path.rotation(s)));
            (known, path.flagged_from())
        }))
    }
}

impl FanTable for Grid {
    fn fan_at(&self, u: DVec3) -> Result<FanValues<'_>> {
        let fan = self.fan(u)?;
        Ok(Box::new(move |d, s| {
            let path = fan.path(d);
            (Some((path.at(s), path.rotation(s))), f64::INFINITY)
        }))
    }
}

/// Follows `rays` fresh rays of `space`.
///
/// # Errors
/// No camera lies in the domain.
pub fn exact_fans(space: &RaySpace, length: f64, rays: usize, seed: u64) -> Result<Vec<ExactFan>> {
    let fans = RandomRays::all(space, rays, [KEY, seed]).map(|random| {
        let RandomRays {
            u,
            directions,
            shares,
        } = random?;
        Ok(ExactFan::new(space, u, length, directions, |ray| {
            shares[ray]
        }))
    });
    fans.collect()
}

/// Returns what a rival is measured on.
pub fn probed(fans: &[ExactFan]) -> Vec<ProbedFan> {
    let first = |(d, probed): &(DVec3, Probed)| Some((*d, *probed.probes.first()?));
    let fan = |fan: &ExactFan| (fan.u, fan.rays.iter().filter_map(first).collect());
    fans.iter().map(fan).collect()
}

impl TableErrors {
    /// Measures `table` on `fans`.
    ///
    /// # Errors
    /// A camera is not in its region.
    pub fn new<T: FanTable>(table: &T, fans: &[ExactFan]) -> Result<Self> {
        let found = fans.par_iter().map(|fan| fan.compared(table));
        let found: Vec<RayErrors> = found.collect::<Result<Vec<_>>>()?.concat();
        let quantiles = |of: &dyn Fn(&Deviation) -> Option<f64>| {
            let values = found.iter().filter_map(|(d, ..)| of(d.as_ref()?));
            let mut values: Vec<f64> = values.map(finite).collect();
            (!values.is_empty()).then(|| Quantiles::of(&mut values))
        };
        let mut sky: Vec<f64> = found.iter().filter_map(|(_, sky, _)| *sky).collect();
        let flagged = found.iter().filter(|(.., flagged)| *flagged).count();
        Ok(Self {
            mrad: quantiles(&|d| Some(d.mrad)).unwrap_or_default(),
            screen: quantiles(&|d| Some(d.screen_mrad)).unwrap_or_default(),
            sky: Quantiles::of(&mut sky),
            rotation: quantiles(&|d| d.rotation_mrad),
            flagged: flagged as f64 / found.len().max(1) as f64,
        })
    }
}

/// A ray's deviation, `None` where there is nothing to compare or the table gives up; the error of its
/// tangent, mrad, where the table tells it; and whether the table gives up a part.
type RayErrors = (Option<Deviation>, Option<f64>, bool);

impl ExactFan {
    /// Follows rays along `directions` from `u`, and probes each at the share `share(ray)` of its path.
    pub fn new(
        space: &RaySpace,
        u: DVec3,
        length: f64,
        directions: Vec<DVec3>,
        share: impl Fn(usize) -> f64,
    ) -> Self {
        let rays: Vec<(DVec3, DVec3)> = directions.iter().map(|d| (u, *d)).collect();
        let lengths = |ray: usize, end: f64| with_end(share(ray), end);
        let manifold = space.manifold();
        let probed = probe(manifold, settings(TOLERANCE), length, &rays, lengths);
        Self {
            u,
            rays: directions.into_iter().zip(probed).collect(),
        }
    }

    /// Measures the screen error of `table` on each ray, mrad; NaN where there is none.
    ///
    /// # Errors
    /// The camera is not in the table's region.
    pub fn screen_errors<T: FanTable>(&self, table: &T) -> Result<Vec<f64>> {
        let error = |(d, ..): RayErrors| d.map_or(f64::NAN, |d| d.screen_mrad);
        Ok(self.compared(table)?.into_iter().map(error).collect())
    }

    /// Compares `table` on each ray.
    fn compared<T: FanTable>(&self, table: &T) -> Result<Vec<RayErrors>> {
        let fan = table.fan_at(self.u)?;
        let of = |(d, exact): &(DVec3, Probed)| -> RayErrors {
            let Some(probe) = exact.probes.first() else {
                return (None, None, false);
            };
            let (value, flagged_from) = fan(*d, probe.s);
            let deviation = value.map(|((u, _), rotation)| probe.deviation(u, rotation));
            let sky = exact.tangent().and_then(|end| {
                let ((_, v), _) = fan(*d, end.s).0?;
                Some(finite(end.sky_mrad(v - end.v)))
            });
            (deviation, sky, flagged_from < exact.length)
        };
        Ok(self.rays.iter().map(of).collect())
    }
}
