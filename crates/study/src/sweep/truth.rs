//! Fresh rays followed exactly, and the errors of any table on them.
//!
//! In: a manifold's rays, their number and a seed. Out: [`Truth`], made once for a manifold so that
//! all tables answer the same rays, and the [`Errors`] of one. Rays and errors are those of
//! `geofan check`: [`RandomRays`].

use geofan_bake::RandomRays;
use geofan_bundle::{
    Fan, Table,
    measure::{Deviation, Probe, Probed, probe, settings, with_end},
    rays::RaySpace,
};
use geofan_core::{Result, quantiles::Quantiles};
use glam::{DQuat, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::sweep::grid::{Grid, GridFan};

/// Keeps these random numbers apart from those that steer a bake.
const KEY: u64 = 0x7377_6565_7021;

/// Local tolerance of the exact tracer, radians: far below the best table's error.
const TOLERANCE: f64 = 1e-11;

/// What is exactly known about rays from one camera.
#[derive(Debug, Clone)]
pub struct Camera {
    /// The camera.
    pub u: DVec3,
    /// Directions in the standard frame, and what is exact along them.
    pub rays: Vec<(DVec3, Probed)>,
}

/// What is exactly known.
#[derive(Debug, Clone)]
pub struct Truth {
    /// Cameras with their rays.
    pub cameras: Vec<Camera>,
    /// How far paths go.
    pub length: f64,
}

/// Quantiles of the errors of a table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Transverse distance over arc length, mrad.
    pub mrad: Quantiles,
    /// The same divided by the ray's magnification, mrad.
    pub screen: Quantiles,
    /// Sky error of the tangents at exits, mrad; without exits at the same places as the others.
    pub sky: Quantiles,
    /// Angle between the transported rotations, mrad; none if the table has none.
    pub rotation: Option<Quantiles>,
    /// The share of rays of which the table gives up a part.
    pub flagged: f64,
}

/// A table that answers from a camera.
pub trait Lookup: Sync {
    /// Its answers from one camera.
    type Fan<'a>: Answers
    where
        Self: 'a;

    /// The answers from the camera position `u`.
    ///
    /// # Errors
    /// `u` is not in the camera region.
    fn fan_at(&self, u: DVec3) -> Result<Self::Fan<'_>>;
}

/// Chart point with tangent, and the transported rotation of a table that has one.
pub type Answer = ((DVec3, DVec3), Option<DQuat>);

/// What a table says from one camera.
pub trait Answers {
    /// What is known in direction `d` at arc length `s`; `None` where the table gives up. The second
    /// number says from where on it does.
    fn answer(&self, d: DVec3, s: f64) -> (Option<Answer>, f64);
}

impl Lookup for Table {
    type Fan<'a> = Fan<'a>;

    fn fan_at(&self, u: DVec3) -> Result<Fan<'_>> {
        self.fan(u)
    }
}

impl Answers for Fan<'_> {
    fn answer(&self, d: DVec3, s: f64) -> (Option<Answer>, f64) {
        let path = self.path(d);
        let known = path.at(s).map(|state| (state, path.rotation(s)));
        (known, path.flagged_from())
    }
}

impl Lookup for Grid {
    type Fan<'a> = GridFan<'a>;

    fn fan_at(&self, u: DVec3) -> Result<GridFan<'_>> {
        self.fan(u)
    }
}

impl Answers for GridFan<'_> {
    fn answer(&self, d: DVec3, s: f64) -> (Option<Answer>, f64) {
        let path = self.path(d);
        (Some((path.at(s), path.rotation(s))), f64::INFINITY)
    }
}

impl Truth {
    /// Follows `rays` fresh rays of `space`.
    ///
    /// # Errors
    /// No camera lies in the domain.
    pub fn new(space: &RaySpace, length: f64, rays: usize, seed: u64) -> Result<Self> {
        let cameras = RandomRays::all(space, rays, [KEY, seed]).map(|random| {
            let RandomRays {
                u,
                directions,
                shares,
            } = random?;
            Ok(Camera::new(space, u, length, directions, |ray| shares[ray]))
        });
        Ok(Self {
            cameras: cameras.collect::<Result<_>>()?,
            length,
        })
    }

    /// The errors of `table`.
    ///
    /// # Errors
    /// A camera is not in its region.
    pub fn errors<L: Lookup>(&self, table: &L) -> Result<Errors> {
        let cameras = self.cameras.par_iter();
        let found: Vec<Found> = cameras.map(|c| c.compared(table)).collect::<Result<_>>()?;
        let mut all = Found::default();
        let mut rays = 0;
        for (mut found, camera) in found.into_iter().zip(&self.cameras) {
            all.deviations.append(&mut found.deviations);
            all.sky.append(&mut found.sky);
            all.flagged += found.flagged;
            rays += camera.rays.len();
        }
        let quantiles = |of: &dyn Fn(&Deviation) -> Option<f64>| {
            let values = all.deviations.iter().flatten().filter_map(of);
            let mut values: Vec<f64> = values.map(tellable).collect();
            (!values.is_empty()).then(|| Quantiles::of(&mut values))
        };
        Ok(Errors {
            mrad: quantiles(&|d| Some(d.mrad)).unwrap_or_default(),
            screen: quantiles(&|d| Some(d.screen_mrad)).unwrap_or_default(),
            sky: Quantiles::of(&mut all.sky),
            rotation: quantiles(&|d| d.rotation_mrad),
            flagged: all.flagged as f64 / rays.max(1) as f64,
        })
    }
}

/// An error that can be written: JSON has no infinity, and beyond this nothing is worse.
pub fn tellable(mrad: f64) -> f64 {
    mrad.min(1e6)
}

/// The deviation of each ray, `None` where there is nothing to compare or the table gives up.
#[derive(Default)]
struct Found {
    deviations: Vec<Option<Deviation>>,
    /// Of the tangents, where the table tells them.
    sky: Vec<f64>,
    flagged: usize,
}

impl Camera {
    /// What is exact along `directions` from `u`, each at the share `share(ray)` of its path.
    pub fn new(
        space: &RaySpace,
        u: DVec3,
        length: f64,
        directions: Vec<DVec3>,
        share: impl Fn(usize) -> f64,
    ) -> Self {
        let rays: Vec<(DVec3, DVec3)> = directions.iter().map(|d| (u, *d)).collect();
        let lengths = |ray: usize, end: f64| with_end(share(ray), end);
        let probed = probe(
            space.manifold(),
            settings(TOLERANCE),
            length,
            &rays,
            lengths,
        );
        Self {
            u,
            rays: directions.into_iter().zip(probed).collect(),
        }
    }

    /// The screen error of `table` on each ray, mrad; NaN where there is none.
    ///
    /// # Errors
    /// The camera is not in the table's region.
    pub fn screen_errors<L: Lookup>(&self, table: &L) -> Result<Vec<f64>> {
        let found = self.compared(table)?.deviations;
        let error = |d: Option<Deviation>| d.map_or(f64::NAN, |d| d.screen_mrad);
        Ok(found.into_iter().map(error).collect())
    }

    fn compared<L: Lookup>(&self, table: &L) -> Result<Found> {
        let fan = table.fan_at(self.u)?;
        let mut found = Found::default();
        for (d, exact) in &self.rays {
            let Some(probe) = exact.probes.first() else {
                found.deviations.push(None);
                continue;
            };
            let (answer, flagged_from) = fan.answer(*d, probe.s);
            let deviation = |((u, _), q): Answer| probe.deviation(u, q);
            found.deviations.push(answer.map(deviation));
            found.flagged += usize::from(flagged_from < exact.length);
            if let Some(end) = exact.tangent() {
                let sky = |((_, v), _): Answer| tellable(end.sky_mrad(v - end.v));
                found.sky.extend(fan.answer(*d, end.s).0.map(sky));
            }
        }
        Ok(found)
    }

    /// The rays that went anywhere: direction and exact state.
    pub fn probes(&self) -> impl Iterator<Item = (DVec3, &Probe)> {
        self.rays
            .iter()
            .filter_map(|(d, probed)| Some((*d, probed.probes.first()?)))
    }
}
