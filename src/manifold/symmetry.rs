//! Symmetries that a manifold file claims, and the isometries they give.
//!
//! In: claims and (for groups) the left translation's expressions. Out: [`Isometry`]: a map of the
//! chart with its differential, and the measured [`discrepancy`] of the metric under it.

use super::Manifold;
use crate::expr::Tape;
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// The symmetries claimed by a file.
#[derive(Debug, Clone, Default)]
pub struct Symmetry {
    /// `u -> Q u` is an isometry for every rotation `Q` of the chart.
    pub rotation: bool,
    /// Nothing depends on these coordinates.
    pub translation: [bool; 3],
    /// Left translation: (u, p) -> u' (3), ∂u'/∂u (9, by rows).
    pub group: Option<Arc<Tape>>,
}

/// A map of the chart that keeps all lengths.
#[derive(Debug, Clone)]
pub enum Isometry {
    /// Everything stays.
    Identity,
    /// `u -> Q u`.
    Rotation(DMat3),
    /// `u -> u + t`.
    Shift(DVec3),
    /// `u -> p·u`, by the group's tape.
    Left(DVec3, Arc<Tape>),
}

impl Isometry {
    /// `Q` and `t` if the map is `u -> Q u + t` everywhere.
    pub fn affine(&self) -> Option<(DMat3, DVec3)> {
        match self {
            Self::Identity => Some((DMat3::IDENTITY, DVec3::ZERO)),
            Self::Rotation(q) => Some((*q, DVec3::ZERO)),
            Self::Shift(t) => Some((DMat3::IDENTITY, *t)),
            Self::Left(..) => None,
        }
    }

    /// The image of `u` and the differential there (chart components to chart components).
    pub fn apply(&self, u: DVec3) -> (DVec3, DMat3) {
        match self {
            Self::Identity => (u, DMat3::IDENTITY),
            Self::Rotation(q) => (*q * u, *q),
            Self::Shift(t) => (u + *t, DMat3::IDENTITY),
            Self::Left(p, tape) => {
                let o = tape.at(&[u.x, u.y, u.z, p.x, p.y, p.z]);
                let rows = DMat3::from_cols_slice(&o[3..12]);
                (DVec3::from_slice(&o[..3]), rows.transpose())
            }
        }
    }
}

/// How far the metric at `u` is from the metric pulled back by `isometry`: the largest entry of
/// `Sᵀ (φ*G − G) S`, in which 1 means lengths wrong by a factor of about √2.
pub(super) fn discrepancy(manifold: &Manifold, isometry: &Isometry, u: DVec3) -> f64 {
    let (image, d) = isometry.apply(u);
    let (g, s) = manifold.metric_and_frame(u);
    let pulled = d.transpose() * manifold.metric(image) * d;
    largest(s.transpose() * (pulled - g) * s)
}

/// The largest entry by size; infinite if one is not a number.
pub(super) fn largest(m: DMat3) -> f64 {
    let sizes = m.to_cols_array().map(f64::abs);
    sizes.into_iter().fold(0.0, |a, b| match b.is_nan() {
        true => f64::INFINITY,
        false => a.max(b),
    })
}
