//! Symmetries that a manifold file claims, and the isometries they give.
//!
//! In: claims and (for groups) the left translation's expressions. Out: [`Isometry`]: a map of the
//! chart with its differential, and the measured discrepancy of the metric under it.

use super::Manifold;
use geofan_expr::Tape;
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// The symmetries claimed by a file.
#[derive(Debug, Clone, Default)]
pub struct Symmetry {
    /// `u -> Q u` is an isometry for every rotation `Q` of the chart.
    pub rotation: bool,
    /// Every rotation about this axis of the chart is an isometry.
    pub axis: Option<usize>,
    /// Nothing depends on these coordinates.
    pub translation: [bool; 3],
    /// Left translations.
    pub group: Option<Arc<GroupLaw>>,
}

/// The left translations of a group, `u -> p·u`.
#[derive(Debug, Clone)]
pub struct GroupLaw {
    /// (u, p) -> p·u (3), ∂(p·u)/∂u (9, by rows).
    pub tape: Tape,
    /// Set if the differential is the same at all `u`.
    pub is_affine: bool,
}

impl GroupLaw {
    /// Returns `p·u` and the differential there.
    fn translated(&self, p: DVec3, u: DVec3) -> (DVec3, DMat3) {
        let o = self.tape.at(&[u.x, u.y, u.z, p.x, p.y, p.z]);
        let rows = DMat3::from_cols_slice(&o[3..12]);
        (DVec3::from_slice(&o[..3]), rows.transpose())
    }
}

/// A map of the chart that keeps all lengths.
#[derive(Debug, Clone)]
pub enum Isometry {
    /// Everything stays.
    Identity,
    /// `u -> A u + t`.
    Affine(DMat3, DVec3),
    /// `u -> p·(A u + t)`, by the group's tape.
    Left {
        /// The translation.
        p: DVec3,
        /// `A` and `t`.
        first: (DMat3, DVec3),
        /// See [`Symmetry::group`].
        law: Arc<GroupLaw>,
    },
}

impl Isometry {
    /// `u -> Q u`.
    pub fn rotation(q: DMat3) -> Self {
        Self::Affine(q, DVec3::ZERO)
    }

    /// `u -> u + t`.
    pub fn shift(t: DVec3) -> Self {
        Self::Affine(DMat3::IDENTITY, t)
    }

    /// `u -> p·u`: one matrix where the law is affine, which costs a fraction of its tape.
    pub fn left(p: DVec3, law: Arc<GroupLaw>) -> Self {
        if law.is_affine {
            let (t, a) = law.translated(p, DVec3::ZERO);
            return Self::Affine(a, t);
        }
        let first = (DMat3::IDENTITY, DVec3::ZERO);
        Self::Left { p, first, law }
    }

    /// This after `u -> A u + t`.
    pub fn after(&self, (q, t): (DMat3, DVec3)) -> Self {
        let both = |a: DMat3, b: DVec3| (a * q, a * t + b);
        match self {
            Self::Identity => Self::Affine(q, t),
            Self::Affine(a, b) => {
                let (q, t) = both(*a, *b);
                Self::Affine(q, t)
            }
            Self::Left { p, first, law } => Self::Left {
                p: *p,
                first: both(first.0, first.1),
                law: law.clone(),
            },
        }
    }

    /// The image of `u` and the differential there (chart components to chart components).
    pub fn apply(&self, u: DVec3) -> (DVec3, DMat3) {
        match self {
            Self::Identity => (u, DMat3::IDENTITY),
            Self::Affine(q, t) => (*q * u + *t, *q),
            Self::Left { p, first, law } => {
                let (image, differential) = law.translated(*p, first.0 * u + first.1);
                (image, differential * first.0)
            }
        }
    }
}

impl Manifold {
    /// Measures how far metric, wind and drift at `u` are from those pulled back by `isometry`: the larger of
    /// [`Manifold::metric_discrepancy`] and [`Manifold::wind_discrepancy`].
    pub fn discrepancy(&self, isometry: &Isometry, u: DVec3) -> f64 {
        self.discrepancy_by(isometry.apply(u), u)
    }

    /// Measures the same for a map with this image of `u` and this differential there.
    pub(super) fn discrepancy_by(&self, map: (DVec3, DMat3), u: DVec3) -> f64 {
        let metric = self.metric_discrepancy_by(map, u);
        metric.max(self.wind_discrepancy_by(map, u))
    }

    /// Measures how far the lapse at `image` is from that at `u`, as a share of it.
    pub(super) fn lapse_discrepancy(&self, image: DVec3, u: DVec3) -> f64 {
        let [here, there] = [u, self.domain.wrap(image)].map(|u| self.frequencies(u).lapse());
        (there / here - 1.0).abs()
    }

    /// Measures how far the drift at `there` is from that at `here` itself, of which paths know the derivative alone: the
    /// largest component in the standard frame.
    pub(super) fn drift_discrepancy(&self, there: DVec3, here: DVec3) -> f64 {
        if !self.has_drift() {
            return 0.0;
        }
        let off = self.standard_frame(here).transpose() * (self.drift(there) - self.drift(here));
        largest(DMat3::from_cols(off, DVec3::ZERO, DVec3::ZERO))
    }

    /// Measures how far the metric at `u` is from the metric pulled back by `isometry`: the largest entry of
    /// `Sᵀ (φ*G − G) S`, in which 1 means lengths wrong by a factor of about √2.
    pub fn metric_discrepancy(&self, isometry: &Isometry, u: DVec3) -> f64 {
        self.metric_discrepancy_by(isometry.apply(u), u)
    }

    pub(super) fn metric_discrepancy_by(&self, (image, d): (DVec3, DMat3), u: DVec3) -> f64 {
        let (g, s) = self.metric_and_frame(u);
        let pulled = d.transpose() * self.metric(self.domain.wrap(image)) * d;
        largest(s.transpose() * (pulled - g) * s)
    }

    /// Measures how far wind and drift at `u` are from those pulled back by `isometry`: in the standard frame, the
    /// largest component of the difference of the winds or of the exterior derivatives of the drifts.
    pub fn wind_discrepancy(&self, isometry: &Isometry, u: DVec3) -> f64 {
        self.wind_discrepancy_by(isometry.apply(u), u)
    }

    pub(super) fn wind_discrepancy_by(&self, (image, d): (DVec3, DMat3), u: DVec3) -> f64 {
        if !self.has_wind() {
            return 0.0;
        }
        let s = self.standard_frame(u);
        let (wind, exterior) = self.currents(u);
        let (there, exterior_there) = self.currents(self.domain.wrap(image));
        let wind = s.inverse() * (d.inverse() * there - wind);
        let pulled = d.transpose() * skew(exterior_there) * d;
        let exterior = s.transpose() * (pulled - skew(exterior)) * s;
        largest(DMat3::from_cols(wind, DVec3::ZERO, DVec3::ZERO)).max(largest(exterior))
    }
}

/// The antisymmetric matrix with the entries 12, 13, 23.
fn skew(e: DVec3) -> DMat3 {
    DMat3::from_cols_array(&[0.0, -e.x, -e.y, e.x, 0.0, -e.z, e.y, e.z, 0.0])
}

/// The largest entry by size; infinite if one is not a number.
fn largest(m: DMat3) -> f64 {
    let sizes = m.to_cols_array().map(f64::abs);
    sizes.into_iter().fold(0.0, |a, b| match b.is_nan() {
        true => f64::INFINITY,
        false => a.max(b),
    })
}
