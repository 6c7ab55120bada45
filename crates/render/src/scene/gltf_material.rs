//! Materials of glTF files.
//!
//! In: a material of metallic-roughness. Out: a [`Material`]: what is not metal is matt in its base
//! colour with a reflectance of 0.04, metal reflects in its base colour, and the exponent is that of
//! the same roughness. Metalness and roughness do not change over a surface here: where a texture says
//! so, its means count.

use super::{
    gltf_source::Source,
    material::Material,
    material_shelf::Loaded,
    texture::{Mapping, OpacityMap, TextureMap},
};
use crate::picture::srgb_encode;
use gltf::{
    material::AlphaMode,
    texture::{Info, WrappingMode},
};
use ndarray::{Array2, Axis};
use std::{collections::HashMap, sync::Arc};

/// Reflectance of what is not metal, straight on (glTF 2.0, appendix B).
const DIELECTRIC: f32 = 0.04;

/// The materials of a file as they come into use.
pub(super) struct GltfMaterials<'s> {
    source: &'s Source,
    pictures: HashMap<usize, Option<Loaded>>,
}

/// A texture of a material with its picture.
struct Laid {
    picture: Loaded,
    mapping: Mapping,
}

impl<'s> GltfMaterials<'s> {
    /// Prepares the materials of `source`.
    pub(super) fn new(source: &'s Source) -> Self {
        Self {
            source,
            pictures: HashMap::new(),
        }
    }

    /// Returns a material as it is drawn.
    pub(super) fn material(
        &mut self,
        from: &gltf::Material<'_>,
        warnings: &mut Vec<String>,
    ) -> Material {
        let number = from.index().map(|i| i.to_string());
        let name = from.name().map(str::to_owned).or(number);
        let name = name.unwrap_or_else(|| String::from("default"));
        let file = &self.source.name;
        let mut say = |text: &str| warnings.push(format!("{file}: material `{name}`: {text}"));
        let pbr = from.pbr_metallic_roughness();
        let mut laid = |info: Option<Info<'_>>| info.and_then(|t| self.laid(&t, &mut say));
        let base = laid(pbr.base_color_texture());
        let rough = laid(pbr.metallic_roughness_texture());
        let emission = laid(from.emissive_texture());
        let left_out = [
            (from.normal_texture().is_some(), "normal map"),
            (from.occlusion_texture().is_some(), "occlusion map"),
            (
                rough.is_some(),
                "changes of metalness and roughness (their means are used)",
            ),
        ];
        let left_out = left_out.iter().filter(|(is_there, _)| *is_there);
        let left_out: Vec<&str> = left_out.map(|(_, what)| *what).collect();
        if !left_out.is_empty() {
            say(&format!("{} not drawn", left_out.join(", ")));
        }
        let [_, green, blue] = rough
            .as_ref()
            .map_or([1.0; 3], |laid| laid.mean(srgb_encode));
        let metallic = pbr.metallic_factor() * blue;
        let roughness = pbr.roughness_factor() * green;
        let [r, g, b, alpha] = pbr.base_color_factor();
        let colour = [r, g, b];
        let mean = base.as_ref().map_or([1.0; 3], |laid| laid.mean(|x| x));
        let strength = from.emissive_strength().unwrap_or(1.0);
        let opacity = base.as_ref().and_then(|laid| opacity(from, laid, alpha));
        let dissolve = dissolve(from, alpha, opacity.is_some());
        // What is unlit shines as it is coloured, and in no other light.
        if from.unlit() {
            return Material {
                kd: [0.0; 3],
                ks: [0.0; 3],
                ke: colour,
                dissolve,
                map_d: opacity,
                map_ke: base.map(Laid::colours),
                name,
                ..Material::default()
            };
        }
        Material {
            kd: colour.map(|c| c * (1.0 - metallic)),
            ks: [0, 1, 2].map(|k| DIELECTRIC * (1.0 - metallic) + colour[k] * mean[k] * metallic),
            ns: exponent(roughness),
            ke: from.emissive_factor().map(|x| x * strength),
            dissolve,
            map_kd: base.map(Laid::colours),
            map_d: opacity,
            map_ke: emission.map(Laid::colours),
            name,
            ..Material::default()
        }
    }

    /// Returns a texture with its picture; `None` if that cannot be read.
    fn laid(&mut self, info: &Info<'_>, say: &mut dyn FnMut(&str)) -> Option<Laid> {
        let texture = info.texture();
        let image = texture.source().index();
        if !self.pictures.contains_key(&image) {
            let read = self.source.picture(image);
            let picture = read
                .map_err(|e| say(&format!("texture left out: {e}")))
                .ok();
            self.pictures.insert(image, picture.and_then(Loaded::of));
        }
        let picture = self.pictures.get(&image)?.clone()?;
        let sampler = texture.sampler();
        let wraps = [sampler.wrap_s(), sampler.wrap_t()];
        if wraps.contains(&WrappingMode::MirroredRepeat) {
            say("a mirrored texture repeats unmirrored");
        }
        let mut mapping = Mapping {
            clamp: wraps == [WrappingMode::ClampToEdge; 2],
            ..Mapping::default()
        };
        if let Some(transform) = info.texture_transform() {
            let ([x, y], [u, v]) = (transform.scale(), transform.offset());
            // Their v runs down.
            mapping.scale = [x, y];
            mapping.offset = [u, 1.0 - y - v];
            if transform.rotation() != 0.0 {
                say("a turned texture is drawn unturned");
            }
        }
        if info.tex_coord() != 0 {
            say("a texture on a second set of coordinates is laid on the first");
        }
        Some(Laid { picture, mapping })
    }
}

impl Laid {
    /// Returns the mean of values made of the texture's linear light; what is not light is kept as sRGB here.
    fn mean(&self, value: impl Fn(f32) -> f32) -> [f32; 3] {
        let rgb = &self.picture.picture.rgb;
        let count = (rgb.len() / 3).max(1) as f64;
        [0, 1, 2].map(|c| {
            let channel = rgb.index_axis(Axis(2), c);
            let sum: f64 = channel.iter().map(|x| f64::from(value(*x))).sum();
            (sum / count) as f32
        })
    }

    fn colours(self) -> TextureMap {
        TextureMap {
            texture: self.picture.texture,
            mapping: self.mapping,
        }
    }
}

fn cutoff(from: &gltf::Material<'_>) -> f32 {
    from.alpha_cutoff().unwrap_or(0.5)
}

/// Returns the opacity of a material beside that in its texture, if it `has_map`.
fn dissolve(from: &gltf::Material<'_>, alpha: f32, has_map: bool) -> f32 {
    match from.alpha_mode() {
        AlphaMode::Opaque => 1.0,
        AlphaMode::Blend => alpha,
        // The map has the cut.
        AlphaMode::Mask if has_map => 1.0,
        AlphaMode::Mask => f32::from(alpha >= cutoff(from)),
    }
}

/// Returns the opacity in the base colour's picture, which is all or nothing where the material has a cutoff.
fn opacity(from: &gltf::Material<'_>, laid: &Laid, factor: f32) -> Option<OpacityMap> {
    let alpha = laid.picture.alpha.as_ref()?;
    let cut = |alpha: &Array2<f32>| Arc::new(alpha.mapv(|a| f32::from(a * factor >= cutoff(from))));
    let values = match from.alpha_mode() {
        AlphaMode::Opaque => return None,
        AlphaMode::Blend => alpha.clone(),
        AlphaMode::Mask => cut(alpha),
    };
    Some(OpacityMap {
        values,
        mapping: laid.mapping,
    })
}

/// Returns the Phong exponent of a roughness: microfacets of α = roughness² are as wide for
/// `α² = 2 / (Ns + 2)`.
fn exponent(roughness: f32) -> f32 {
    let alpha = (roughness * roughness).clamp(1e-3, 1.0);
    2.0 / (alpha * alpha) - 2.0
}
