//! Gloss: what a material reflects of the light of lamps besides what is matt.
//!
//! In: a material, where it is met, and images of lamps with where their light comes from. Out: reflectances, and
//! radiance. It is the model of the path tracer's direct light (`geofan-light`): microfacets distributed after
//! Trowbridge and Reitz (GGX), with Smith's height-correlated masking, of the roughness that `Ns` asks for. Their
//! functions take unit vectors in a frame whose z is the normal, and the roughness α.

use crate::{
    intersect::Hit, lightmap::LampImage, redshift::SurfaceFrame, scene::Material, world::World,
};
use geofan_core::geodesic::perpendiculars;
use glam::{DMat3, DVec3};
use std::f64::consts::PI;

/// What a surface reflects in all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reflectances {
    /// Of its matt part, linear red, green and blue.
    pub diffuse: DVec3,
    /// Of its gloss or mirror.
    pub specular: DVec3,
}

impl Reflectances {
    /// Takes `material` where its diffuse reflectance is `kd`. Where both together exceed 1, both are scaled down.
    pub fn new(material: &Material, kd: [f32; 3]) -> Self {
        let colour = |c: [f32; 3]| DVec3::from_array(c.map(f64::from));
        let specular = match material.illumination {
            0 | 1 => DVec3::ZERO,
            _ => colour(material.ks),
        };
        let most = (colour(kd) + specular).max_element().max(1.0);
        Self {
            diffuse: colour(kd) / most,
            specular: specular / most,
        }
    }
}

/// Tells whether a material reflects light of lamps in highlights: not as a mirror or glass does, in which they are points.
pub fn is_glossy(material: &Material) -> bool {
    let model = !matches!(material.illumination, 0 | 1 | 3 | 4 | 5 | 8) && !material.is_glass();
    model && material.ks.iter().any(|k| *k > 0.0)
}

/// Returns the material of a triangle.
fn material(world: &World, triangle: u32) -> &Material {
    &world.materials[world.faces[triangle as usize].material as usize]
}

/// Tells whether a triangle is of a glossy material.
pub fn is_glossy_triangle(world: &World, triangle: u32) -> bool {
    is_glossy(material(world, triangle))
}

/// Returns the frames of the surfaces at those `hits` that are glossy, in order.
pub(super) fn glossy_frames<'a>(
    world: &World,
    hits: impl Iterator<Item = &'a Hit>,
) -> Vec<SurfaceFrame> {
    let glossy = hits.filter(|hit| is_glossy_triangle(world, hit.triangle));
    let places: Vec<(DVec3, u32)> = glossy.map(|hit| (world.point(hit), hit.triangle)).collect();
    let states = world.surface_states(&places);
    world.surface_frames(&places, states.as_deref())
}

/// Computes how much of the light of lamps the gloss of what `hit` met sends back, for a specular reflectance of 1; `front`
/// says whether it is seen from the side to which its normal points, and `images` are put where others were.
pub(super) fn highlights(
    world: &World,
    (hit, front): (&Hit, bool),
    surface: SurfaceFrame,
    images: &mut Vec<LampImage>,
) -> DVec3 {
    let Some(light) = &world.light else {
        return DVec3::ZERO;
    };
    let (inverse, pace) = (surface.frame.inverse(), surface.pace);
    let smooth = surface.normal(world.covector(hit));
    let normal = if front { smooth } else { -smooth };
    let [x, y] = perpendiculars(normal);
    let around = DMat3::from_cols(x, y, normal).transpose();
    let wo = around * -(inverse * (hit.v.as_dvec3() - pace)).normalize_or_zero();
    let alpha = roughness(f64::from(material(world, hit.triangle).ns));
    light.images(
        (hit.triangle, hit.barycentric),
        front,
        (inverse, pace),
        images,
    );
    let mut sum = DVec3::ZERO;
    for image in images.iter() {
        let wi = around * image.towards();
        if wo.z > 0.0 && wi.z > 0.0 {
            sum += image.irradiance() * lobe(wo, wi, alpha);
        }
    }
    sum
}

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
