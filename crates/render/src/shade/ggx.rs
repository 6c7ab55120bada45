//! The glossy lobe: microfacets distributed after Trowbridge and Reitz (GGX), with Smith's
//! height-correlated masking.
//!
//! In: unit vectors in a frame whose z is the normal, and the roughness α. Out: distribution and masking.

use glam::DVec3;
use std::f64::consts::PI;

/// Returns the roughness of a Phong exponent: the lobes are equally wide for `α² = 2 / (Ns + 2)` (B. Walter
/// et al., *Microfacet Models for Refraction through Rough Surfaces*, EGSR 2007). Not below 1e-3: a
/// sharper lobe is a mirror, and has a model of its own.
pub fn roughness(exponent: f64) -> f64 {
    (2.0 / (exponent.max(0.0) + 2.0)).sqrt().max(1e-3)
}

/// Returns the density of microfacets with the normal `m`.
pub fn distribution(m: DVec3, alpha: f64) -> f64 {
    let a2 = alpha * alpha;
    let d = m.z * m.z * (a2 - 1.0) + 1.0;
    a2 / (PI * d * d)
}

/// Computes Smith's Λ.
pub fn lambda(w: DVec3, alpha: f64) -> f64 {
    let z2 = w.z * w.z;
    let tan2 = (1.0 - z2).max(0.0) / z2.max(f64::MIN_POSITIVE);
    0.5 * ((1.0 + alpha * alpha * tan2).sqrt() - 1.0)
}

/// Computes the lobe without Fresnel's factor, `D G / (4 cosθ cosθ')`; both directions above the surface.
pub fn lobe(wo: DVec3, wi: DVec3, alpha: f64) -> f64 {
    let m = (wo + wi).normalize_or_zero();
    let masking = 1.0 / (1.0 + lambda(wo, alpha) + lambda(wi, alpha));
    distribution(m, alpha) * masking / (4.0 * wo.z * wi.z)
}
