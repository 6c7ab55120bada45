//! How well a table keeps its promise: the errors found on fresh random rays, as published.
//!
//! A quantile of a sample is not a bound: it is published with the number of rays.

use crate::outlier::Outlier;
use geofan_core::quantiles::Quantiles;
use serde::{Deserialize, Serialize};

/// The result of a comparison of a table with exact paths.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// Transverse distance over arc length.
    pub mrad: Quantiles,
    /// The same divided by the ray's magnification.
    pub screen_mrad: Quantiles,
    /// Sky error of the tangent at the exit, or, in a manifold without exits, where the other errors
    /// are; none if the table does not promise it.
    pub sky_mrad: Option<Quantiles>,
    /// Angle between the transported rotations; none if the table does not promise them.
    pub rotation_mrad: Option<Quantiles>,
    /// The fraction of rays of which the table gives up a part.
    pub flagged: f64,
    /// The number of rays.
    pub rays: u64,
    /// Their seed.
    pub seed: u64,
    /// Local tolerance of the exact tracer.
    pub tolerance: f64,
    /// Rays that the bake integrated; 0 in a check.
    pub exact_rays_baked: u64,
}

impl Certificate {
    /// Whether the table is as good as promised: 99 % of the screen errors within `promise` mrad.
    pub fn keeps(&self, promise: f64) -> bool {
        self.screen_mrad.p99 <= promise
    }

    /// The errors as lines of a table for people.
    pub fn lines(&self) -> String {
        let mut text = format!(
            "{:<10} {:>10} {:>10} {:>10} {:>10}\n",
            "mrad", "p50", "p95", "p99", "max"
        );
        let rows = [
            ("screen", Some(self.screen_mrad)),
            ("position", Some(self.mrad)),
            ("sky", self.sky_mrad),
            ("rotation", self.rotation_mrad),
        ];
        for (name, q) in rows {
            let Some(q) = q else { continue };
            let cells = [q.p50, q.p95, q.p99, q.max].map(|x| format!("{x:>10.4}"));
            text += &format!("{name:<10} {}\n", cells.join(" "));
        }
        let (flagged, rays) = (100.0 * self.flagged, self.rays);
        text + &format!("flagged    {flagged:.3} % of {rays} rays (integrated exactly)\n")
    }
}

/// A certificate and what it cannot say.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    /// The certificate.
    pub certificate: Certificate,
    /// The number of rays whose error is more than [`FAR`](crate::FAR) times the promise.
    pub far: usize,
    /// The worst of them, worst first.
    pub worst: Vec<Outlier>,
}
