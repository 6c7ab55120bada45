//! Surfaces lit by the world's baked light, or without it by a lamp at the camera; and gloss: what a material reflects of
//! the light of lamps besides what is matt.
//!
//! In: hits. Out: colours. Baked light is reflected by what is matt as radiance `Kd E / π`, for the irradiance `E` on the
//! side of the surface that the ray meets, and by what is glossy image by image. For the lamp, the cosine between
//! ray and normal is taken in the metric at the hit, `|n·v| / (|Sᵀn| |v|)` for a covector `n` and tangent `v`; the metric
//! of sixteen hits is evaluated at once.
//!
//! In: a material, where it is met, and images of lamps with where their light comes from. Out: reflectances, and
//! radiance. It is the model of the path tracer's direct light (`geofan-light`): microfacets distributed after
//! Trowbridge and Reitz (GGX), with Smith's height-correlated masking, of the roughness that `Ns` asks for. Their
//! functions take unit vectors in a frame whose z is the normal, and the roughness α.

use crate::{
    filter::Footprint,
    intersect::Hit,
    lanes::LANES,
    lightmap::{LampImage, Lightmap},
    redshift::SurfaceFrame,
    scene::Material,
    world::World,
};
use geofan_core::geodesic::perpendiculars;
use geofan_expr::{Registers, real::Real, vectorised};
use glam::{DMat3, DVec3};
use std::{f32::consts::FRAC_1_PI, f64::consts::PI};

/// The share of light that reaches surfaces from all sides.
const AMBIENT: f32 = 0.2;

/// Strength of the lamp's mirror image in glossy surfaces, as a share of their `Ks`: a matter of taste.
const GLOSS: f32 = 0.3;

/// A highlight fainter than exp(−this) is none: it is lost beside what surfaces reflect from all sides.
const DARK: f32 = 16.0;

/// Hits waiting to be lit.
pub(super) struct Lamp<'w> {
    world: &'w World,
    registers: Registers<f64, LANES>,
    /// The place of each in the row, the hit, and the footprint of its texture.
    waiting: Vec<(usize, Hit, Footprint)>,
    /// Images of lamps at one of them.
    images: Vec<LampImage>,
}

impl<'w> Lamp<'w> {
    /// Makes an empty list.
    pub(super) fn new(world: &'w World) -> Self {
        Self {
            world,
            registers: world.manifold.metric_tape().registers(),
            waiting: Vec::new(),
            images: Vec::new(),
        }
    }

    /// Puts a hit on the list; its colour belongs at place `index` of the row.
    pub(super) fn add(&mut self, index: usize, hit: Hit, footprint: Footprint) {
        self.waiting.push((index, hit, footprint));
    }

    /// Lights all on the list into `row`, three numbers for each place.
    pub(super) fn light(&mut self, row: &mut [f32]) {
        let waiting = std::mem::take(&mut self.waiting);
        match &self.world.light {
            Some(light) => self.by_baked(light, &waiting, row),
            None => self.by_lamp(&waiting, row),
        }
        self.waiting = waiting;
        self.waiting.clear();
    }

    /// Lights hits by baked light.
    fn by_baked(&mut self, light: &Lightmap, waiting: &[(usize, Hit, Footprint)], row: &mut [f32]) {
        let world = self.world;
        let mut frames = glossy_frames(world, waiting.iter().map(|(_, hit, _)| hit)).into_iter();
        for (index, hit, footprint) in waiting {
            let glossy = is_glossy_triangle(world, hit.triangle);
            let frame = glossy.then(|| frames.next()).flatten();
            let colour = reflected(world, light, (hit, footprint, frame), &mut self.images);
            put(row, *index, colour);
        }
    }

    /// Lights hits by the lamp at the camera. Of a conformal metric cosines do not ask the factor.
    fn by_lamp(&mut self, waiting: &[(usize, Hit, Footprint)], row: &mut [f32]) {
        let (world, manifold) = (self.world, &*self.world.manifold);
        let asked = !manifold.has_wind() && !manifold.is_conformal();
        // In a wind the surface is at rest and the metric's frame is not.
        let windy = waiting.iter().filter(|_| manifold.has_wind());
        let points: Vec<DVec3> = windy.map(|(_, hit, _)| world.point(hit)).collect();
        let mut frames = manifold.rest_frames(&points).into_iter();
        for sixteen in waiting.chunks(LANES) {
            if asked {
                self.ask_metric(sixteen);
            }
            for (lane, (index, hit, footprint)) in sixteen.iter().enumerate() {
                let (n, v) = (world.covector(hit), hit.v.as_dvec3());
                let cosine = match frames.next() {
                    Some(frame) => in_frame(frame, n, v),
                    None if asked => self.by_metric(lane, n, v),
                    None => cosine(n.dot(v), n.length() * v.length()),
                };
                put(row, *index, self.surface(hit, footprint, cosine as f32));
            }
        }
    }

    /// Evaluates the metric at sixteen hits.
    fn ask_metric(&mut self, sixteen: &[(usize, Hit, Footprint)]) {
        for (lane, (_, hit, _)) in sixteen.iter().enumerate() {
            let u = self.world.point(hit);
            for c in 0..3 {
                self.registers.input(c)[lane] = u[c];
            }
        }
        let tape = self.world.manifold.metric_tape();
        vectorised(
            #[inline(always)]
            || tape.run(&mut self.registers),
        );
    }

    /// Computes the cosine between ray and normal, from the metric (outputs 0 to 5: xx, yy, zz, xy, xz, yz)
    /// and the frame (6 to 11: 11, 22, 33, 12, 13, 23) in `lane`.
    fn by_metric(&self, lane: usize, n: DVec3, v: DVec3) -> f64 {
        let o = |k: usize| self.registers.output(k)[lane];
        let across = DVec3::new(
            o(6) * n.x,
            o(9) * n.x + o(7) * n.y,
            o(10) * n.x + o(11) * n.y + o(8) * n.z,
        );
        let squared = o(0) * v.x * v.x
            + o(1) * v.y * v.y
            + o(2) * v.z * v.z
            + 2.0 * (o(3) * v.x * v.y + o(4) * v.x * v.z + o(5) * v.y * v.z);
        cosine(n.dot(v), across.length() * squared.sqrt())
    }

    /// Returns the colour of a surface that the lamp meets at this cosine.
    fn surface(&self, hit: &Hit, footprint: &Footprint, cosine: f32) -> [f32; 3] {
        let material = material(self.world, hit.triangle);
        let diffuse = diffuse(self.world, hit, footprint);
        // The lamp is at the eye: the mirror direction makes twice the angle of incidence with it.
        let mirrored = (2.0 * cosine * cosine - 1.0).max(0.0);
        let exponent = material.ns.max(1.0);
        // x^n <= exp(n (x - 1)).
        let ks = specular(self.world, hit);
        let dark = ks == [0.0; 3] || exponent * (1.0 - mirrored) > DARK;
        let gloss = match dark {
            true => 0.0,
            false => GLOSS * Real::pow(mirrored, exponent),
        };
        let light = AMBIENT + (1.0 - AMBIENT) * cosine;
        let emitted = emission(self.world, hit, footprint);
        std::array::from_fn(|k| diffuse[k] * light + ks[k] * gloss + emitted[k])
    }
}

/// Computes the cosine between the covector `n` and the tangent `v` in a frame.
fn in_frame(frame: DMat3, n: DVec3, v: DVec3) -> f64 {
    let (across, along) = (frame.transpose() * n, frame.inverse() * v);
    cosine(across.dot(along), across.length() * along.length())
}

/// Returns the magnitude of a cosine by a product and lengths; 0 where that is no number.
fn cosine(product: f64, lengths: f64) -> f64 {
    let cosine = product.abs() / lengths;
    if cosine.is_finite() {
        cosine.min(1.0)
    } else {
        0.0
    }
}

/// Puts a colour at place `index` of a row.
fn put(row: &mut [f32], index: usize, colour: [f32; 3]) {
    row[3 * index..3 * index + 3].copy_from_slice(&colour);
}

/// Returns the reflected light that was baked, and the light that the surface emits itself. Where it is glossy, its frame
/// is given.
fn reflected(
    world: &World,
    light: &Lightmap,
    (hit, footprint, frame): (&Hit, &Footprint, Option<SurfaceFrame>),
    images: &mut Vec<LampImage>,
) -> [f32; 3] {
    let front = world.covector(hit).dot(hit.v.as_dvec3()) <= 0.0;
    let irradiance = light.at(hit.triangle, hit.barycentric, front);
    let mut diffuse = diffuse(world, hit, footprint);
    let mut gloss = [0.0; 3];
    if let Some(frame) = frame {
        let both = Reflectances::new(diffuse, specular(world, hit));
        diffuse = both.diffuse.as_vec3().to_array();
        let highlights = highlights(world, (hit, front), frame, images);
        gloss = (both.specular * highlights).as_vec3().to_array();
    }
    let emitted = emission(world, hit, footprint);
    std::array::from_fn(|k| diffuse[k] * irradiance[k] * FRAC_1_PI + gloss[k] + emitted[k])
}

/// Returns the texture coordinates of a hit.
fn uv(world: &World, hit: &Hit) -> [f32; 2] {
    let uvs = world.uvs(hit.triangle as usize);
    let [b, c] = hit.barycentric;
    [0, 1].map(|k| uvs[0][k] * (1.0 - b - c) + uvs[1][k] * b + uvs[2][k] * c)
}

/// Returns the radiance given off by what was hit: `Ke`, times its texture averaged over `footprint`, and times the
/// colour of the mesh there if it reflects nothing, as an unlit material of glTF.
pub fn emission(world: &World, hit: &Hit, footprint: &Footprint) -> [f32; 3] {
    let material = material(world, hit.triangle);
    let mut colour = material.ke;
    if let Some(map) = &material.map_ke {
        let texture = map.filtered(uv(world, hit), footprint);
        colour = std::array::from_fn(|k| texture[k] * colour[k]);
    }
    match material.kd == [0.0; 3] && material.gloss() == [0.0; 3] {
        true => tinted(world, hit, colour),
        false => colour,
    }
}

/// Returns the specular reflectance of what was hit: `Ks` where it is glossy or a mirror, times the colour of the mesh
/// there if nothing of it is matt, as metal.
pub fn specular(world: &World, hit: &Hit) -> [f32; 3] {
    let material = material(world, hit.triangle);
    match material.kd == [0.0; 3] {
        true => tinted(world, hit, material.gloss()),
        false => material.gloss(),
    }
}

/// Returns `colour` times that of the mesh at a hit.
fn tinted(world: &World, hit: &Hit, colour: [f32; 3]) -> [f32; 3] {
    if world.colours.is_empty() {
        return colour;
    }
    let own = world.colour(hit);
    std::array::from_fn(|k| own[k] * colour[k])
}

/// Returns the diffuse reflectance of what was hit: `Kd`, times the colour of the mesh there, times its texture
/// averaged over `footprint`.
pub fn diffuse(world: &World, hit: &Hit, footprint: &Footprint) -> [f32; 3] {
    let material = material(world, hit.triangle);
    let mut colour = material.kd;
    if let Some(map) = &material.map_kd {
        let texture = map.filtered(uv(world, hit), footprint);
        colour = std::array::from_fn(|k| texture[k] * colour[k]);
    }
    tinted(world, hit, colour)
}

/// What a surface reflects in all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reflectances {
    /// Of its matt part, linear red, green and blue.
    pub diffuse: DVec3,
    /// Of its gloss or mirror.
    pub specular: DVec3,
}

impl Reflectances {
    /// Takes the diffuse and the specular reflectance. Where both together exceed 1, both are scaled down.
    pub fn new(kd: [f32; 3], ks: [f32; 3]) -> Self {
        let [diffuse, specular] = [kd, ks].map(|c| DVec3::from_array(c.map(f64::from)));
        let most = (diffuse + specular).max_element().max(1.0);
        Self {
            diffuse: diffuse / most,
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
