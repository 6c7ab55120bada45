//! glTF files as meshes with their materials.
//!
//! In: a [`Source`]. Out: a [`Draft`] of all meshes of its scene where the nodes put them, in the
//! file's own units and axes (metres, y upwards). Cameras, lights, skins and animations are left out.
//! The format: *glTF 2.0 Specification*, Khronos Group, 2021.
//!
//! In: a material of metallic-roughness. Out: a [`Material`]: what is not metal is matt in its base
//! colour with a reflectance of 0.04, metal reflects in its base colour, and the exponent is that of
//! the same roughness. Metalness and roughness do not change over a surface here: where a texture says
//! so, its means count.

use super::{
    gltf_source::{Numbers, Source},
    material::{Mapping, Material, OpacityMap, TextureMap, Wrap},
    mesh::{Mesh, unit_or_none},
    mtl::Loaded,
    smoothing::{Draft, FLAT, SmoothingKey},
};
use crate::picture::srgb_encode;
use geofan_core::error::{Error, Result};
use glam::{DMat3, DMat4, DVec3};
use gltf::{
    Node, Primitive, Semantic,
    material::AlphaMode,
    mesh::Mode,
    texture::{Info, MagFilter, WrappingMode},
};
use ndarray::Axis;
use std::{
    collections::{HashMap, HashSet},
    path::Path,
    sync::Arc,
};

/// Reads the file that the user calls `name`; what it names is in `folder`.
pub(super) fn read(name: &str, bytes: &[u8], folder: &Path) -> Result<Draft> {
    let source = Source::read(name, bytes, folder)?;
    let mut builder = GltfMeshBuilder {
        source: &source,
        materials: GltfMaterials::new(&source),
        numbers: HashMap::new(),
        draft: Draft::default(),
        left_out: [0, 0, 0, 0, source.document.animations().count()],
        visited: HashSet::new(),
    };
    let scenes = &source.document;
    let scene = scenes.default_scene().or_else(|| scenes.scenes().next());
    let placed = match scene {
        Some(scene) => scene
            .nodes()
            .try_for_each(|n| builder.node(&n, DMat4::IDENTITY)),
        None => roots(&source)
            .into_iter()
            .try_for_each(|n| builder.node(&n, DMat4::IDENTITY)),
    };
    placed.map_err(|message| Error::input(name, message))?;
    Ok(builder.finish())
}

/// Returns the nodes that are no children.
fn roots(source: &Source) -> Vec<Node<'_>> {
    let children = source.document.nodes().flat_map(|n| n.children());
    let children: HashSet<usize> = children.map(|n| n.index()).collect();
    let nodes = source.document.nodes();
    nodes.filter(|n| !children.contains(&n.index())).collect()
}

/// Most nodes: each may stand below the other, and each takes its room on the stack.
const MOST_NODES: usize = 4096;

/// Most vertices, and most triangles, of all nodes together: each node may show a large mesh again.
const MOST_ITEMS: usize = 1 << 26;

/// A mesh being made.
struct GltfMeshBuilder<'s> {
    source: &'s Source,
    materials: GltfMaterials<'s>,
    /// Numbers of materials that are in use.
    numbers: HashMap<Option<usize>, u32>,
    draft: Draft,
    /// Counts of primitives that are no triangles, of skins, of shapes to be blended, of colours of vertices on what is partly
    /// metal, and of animations.
    left_out: [usize; 5],
    visited: HashSet<usize>,
}

impl GltfMeshBuilder<'_> {
    /// Adds the meshes of a node, which `above` puts in its place, and of its children.
    fn node(&mut self, node: &Node<'_>, above: DMat4) -> Result<(), String> {
        if !self.visited.insert(node.index()) || self.visited.len() > MOST_NODES {
            return Err(format!(
                "node {}: its nodes are no tree, or too many",
                node.index()
            ));
        }
        let own = DMat4::from_cols_array_2d(&node.transform().matrix().map(|c| c.map(f64::from)));
        let placed = above * own;
        if let Some(mesh) = node.mesh() {
            self.left_out[1] += usize::from(node.skin().is_some());
            for primitive in mesh.primitives() {
                let added = self.primitive(&primitive, placed);
                added.map_err(|e| format!("mesh {}: {e}", mesh.index()))?;
            }
        }
        let mut children = node.children();
        children.try_for_each(|child| self.node(&child, placed))
    }

    fn primitive(&mut self, primitive: &Primitive<'_>, placed: DMat4) -> Result<(), String> {
        self.left_out[2] += usize::from(primitive.morph_targets().next().is_some());
        let Some(positions) = primitive.get(&Semantic::Positions) else {
            self.left_out[0] += 1;
            return Ok(());
        };
        let positions = self.source.numbers(&positions)?;
        let count = positions.values.len() / positions.width;
        let indices: Vec<usize> = match primitive.indices() {
            Some(accessor) => {
                let all = self.source.numbers(&accessor)?.values;
                all.into_iter().map(|x| x as usize).collect()
            }
            None => (0..count).collect(),
        };
        if let Some(wrong) = indices.iter().find(|i| **i >= count) {
            return Err(format!("vertex {wrong}, but there are {count} (from 0)"));
        }
        let Some(triangles) = triangles(primitive.mode(), &indices) else {
            self.left_out[0] += 1;
            return Ok(());
        };
        let mesh = &self.draft.mesh;
        let full = |have: usize, more: usize| have + more > MOST_ITEMS;
        if full(mesh.positions.len(), count) || full(mesh.triangles.len(), triangles.len()) {
            return Err(format!(
                "its nodes show more than {MOST_ITEMS} vertices or triangles"
            ));
        }
        let base = mesh.positions.len() as u32;
        let flat = self.vertices(primitive, &positions, placed)?;
        let material = self.material(primitive);
        // A mirrored node turns faces round.
        let mirrored = DMat3::from_mat4(placed).determinant() < 0.0;
        for [a, b, c] in triangles {
            let mesh = &mut self.draft.mesh;
            let [b, c] = if mirrored { [c, b] } else { [b, c] };
            let key = SmoothingKey {
                face: mesh.triangles.len() as u32,
                // Without normals faces are flat, by the specification.
                group: flat.then_some(FLAT),
            };
            mesh.triangles.push([a, b, c].map(|i| base + i as u32));
            mesh.material_of.push(material);
            self.draft.smoothing.push(key);
        }
        Ok(())
    }

    /// Adds the vertices of a primitive; whether they lack normals.
    fn vertices(
        &mut self,
        primitive: &Primitive<'_>,
        positions: &Numbers,
        placed: DMat4,
    ) -> Result<bool, String> {
        if positions.width != 3 {
            return Err(String::from("positions need three numbers"));
        }
        let count = positions.values.len() / 3;
        let normals = self.attribute(primitive, Semantic::Normals, 3, count)?;
        let uvs = self.attribute(primitive, Semantic::TexCoords(0), 2, count)?;
        let colours = self.attribute(primitive, Semantic::Colors(0), 3, count)?;
        let across = DMat3::from_mat4(placed).inverse().transpose();
        let material = primitive.material();
        // What is no metal is coloured by its matt part, and metal by what it reflects.
        let metal = material.pbr_metallic_roughness().metallic_factor();
        let lost = !material.unlit() && metal > 0.0 && metal < 1.0;
        self.left_out[3] += usize::from(colours.is_some() && lost);
        let mesh = &mut self.draft.mesh;
        for i in 0..count {
            mesh.positions
                .push(placed.transform_point3(positions.three(i)));
            let normal = normals
                .as_ref()
                .map_or(DVec3::ZERO, |n| across * n.three(i));
            mesh.normals.push(unit_or_none(normal));
            let uv = uvs
                .as_ref()
                .map_or([0.0; 2], |uv| [uv.item(i)[0], 1.0 - uv.item(i)[1]]);
            mesh.uvs
                .push(uv.map(|x| if x.is_finite() { x as f32 } else { 0.0 }));
        }
        if let Some(colours) = &colours {
            mesh.colours.resize(mesh.positions.len() - count, [1.0; 4]);
            mesh.colours.extend((0..count).map(|i| {
                let [r, g, b] = colours.three(i).to_array();
                let alpha = colours.item(i).get(3).copied().unwrap_or(1.0);
                let [r, g, b, alpha] = [r, g, b, alpha].map(|x| x.clamp(0.0, 1.0) as f32);
                [r, g, b, vertex_opacity(&material, alpha)]
            }));
        } else if !mesh.colours.is_empty() {
            mesh.colours.resize(mesh.positions.len(), [1.0; 4]);
        }
        Ok(normals.is_none())
    }

    /// Returns an attribute of so many vertices, if the primitive has it; of at least `width` numbers each.
    fn attribute(
        &self,
        primitive: &Primitive<'_>,
        semantic: Semantic,
        width: usize,
        count: usize,
    ) -> Result<Option<Numbers>, String> {
        let Some(accessor) = primitive.get(&semantic) else {
            return Ok(None);
        };
        let found = self.source.numbers(&accessor)?;
        match found.width >= width && found.values.len() >= count * found.width {
            true => Ok(Some(found)),
            false => Err(format!("{semantic:?} does not fit its positions")),
        }
    }

    fn material(&mut self, primitive: &Primitive<'_>) -> u32 {
        let material = primitive.material();
        if let Some(number) = self.numbers.get(&material.index()) {
            return *number;
        }
        let mesh: &mut Mesh = &mut self.draft.mesh;
        let made = self.materials.material(&material, &mut mesh.warnings);
        mesh.materials.push(made);
        let number = (mesh.materials.len() - 1) as u32;
        self.numbers.insert(material.index(), number);
        number
    }

    fn finish(self) -> Draft {
        let mut draft = self.draft;
        let name = &self.source.name;
        let kinds = [
            "points and lines",
            "skins (the pose of rest is drawn)",
            "shapes to be blended",
            "colours of vertices on what is partly metal (its matt part is coloured)",
            "animations",
        ];
        if !self.source.ignored.is_empty() {
            let ignored = self.source.ignored.join(", ");
            draft
                .mesh
                .warnings
                .push(format!("{name}: extensions left out: {ignored}"));
        }
        for (count, what) in self.left_out.into_iter().zip(kinds) {
            if count > 0 {
                draft
                    .mesh
                    .warnings
                    .push(format!("{name}: {count} {what} left out"));
            }
        }
        draft
    }
}

/// Returns the triangles of a list, strip or fan; `None` of points and lines.
fn triangles(mode: Mode, indices: &[usize]) -> Option<Vec<[usize; 3]>> {
    Some(match mode {
        Mode::Triangles => indices
            .chunks_exact(3)
            .map(|t| [t[0], t[1], t[2]])
            .collect(),
        Mode::TriangleStrip => {
            let threes = indices.windows(3).enumerate();
            let turned = |(i, t): (usize, &[usize])| {
                if i % 2 == 0 {
                    [t[0], t[1], t[2]]
                } else {
                    [t[1], t[0], t[2]]
                }
            };
            threes.map(turned).collect()
        }
        Mode::TriangleFan => {
            let sides = indices.get(1..).unwrap_or_default().windows(2);
            sides.map(|side| [side[0], side[1], indices[0]]).collect()
        }
        _ => return None,
    })
}

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
        let [_, green, blue] = rough
            .as_ref()
            .map_or([1.0; 3], |laid| laid.mean(srgb_encode));
        let metallic = pbr.metallic_factor() * blue;
        let roughness = pbr.roughness_factor() * green;
        let left_out = [
            (from.normal_texture().is_some(), "normal map"),
            (from.occlusion_texture().is_some(), "occlusion map"),
            (
                rough.is_some(),
                "changes of metalness and roughness (their means are used)",
            ),
            (
                base.is_some() && metallic == 1.0 && !from.unlit(),
                "changes of colour over metal (their mean is used)",
            ),
        ];
        let left_out = left_out.iter().filter(|(is_there, _)| *is_there);
        let left_out: Vec<&str> = left_out.map(|(_, what)| *what).collect();
        if !left_out.is_empty() {
            say(&format!("{} not drawn", left_out.join(", ")));
        }
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
            let loaded = picture.and_then(|picture| Loaded::of(picture, true));
            self.pictures.insert(image, loaded);
        }
        let picture = self.pictures.get(&image)?.clone()?;
        let sampler = texture.sampler();
        let mut mapping = Mapping {
            wrap: [sampler.wrap_s(), sampler.wrap_t()].map(wrap),
            nearest: sampler.mag_filter() == Some(MagFilter::Nearest),
            ..Mapping::default()
        };
        if let Some(transform) = info.texture_transform() {
            let ([x, y], [u, v]) = (transform.scale(), transform.offset());
            let (sin, cos) = transform.rotation().sin_cos();
            // Their v runs down, and the turn is anticlockwise as seen.
            mapping.scale = [x * cos, y * cos];
            mapping.cross = [-y * sin, x * sin];
            mapping.offset = [u + y * sin, 1.0 - y * cos - v];
        }
        let own = info.texture_transform().and_then(|t| t.tex_coord());
        if own.unwrap_or(info.tex_coord()) != 0 {
            say("a texture on a second set of coordinates is laid on the first");
        }
        Some(Laid { picture, mapping })
    }
}

/// Returns what a sampler puts beside a picture along a side.
fn wrap(mode: WrappingMode) -> Wrap {
    match mode {
        WrappingMode::Repeat => Wrap::Repeat,
        WrappingMode::ClampToEdge => Wrap::Clamp,
        WrappingMode::MirroredRepeat => Wrap::Mirror,
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

/// Returns all or nothing, as the cutoff of a material says of an opacity.
fn cut(from: &gltf::Material<'_>, alpha: f32) -> f32 {
    f32::from(alpha >= from.alpha_cutoff().unwrap_or(0.5))
}

/// Returns what a vertex's opacity makes of a material.
fn vertex_opacity(from: &gltf::Material<'_>, alpha: f32) -> f32 {
    let factor = from.pbr_metallic_roughness().base_color_factor()[3];
    match from.alpha_mode() {
        AlphaMode::Opaque => 1.0,
        AlphaMode::Blend => alpha,
        AlphaMode::Mask => cut(from, alpha * factor),
    }
}

/// Returns the opacity of a material beside that in its texture, if it `has_map`.
fn dissolve(from: &gltf::Material<'_>, alpha: f32, has_map: bool) -> f32 {
    match from.alpha_mode() {
        AlphaMode::Opaque => 1.0,
        AlphaMode::Blend => alpha,
        // The map has the cut.
        AlphaMode::Mask if has_map => 1.0,
        AlphaMode::Mask => cut(from, alpha),
    }
}

/// Returns the opacity in the base colour's picture, which is all or nothing where the material has a cutoff.
fn opacity(from: &gltf::Material<'_>, laid: &Laid, factor: f32) -> Option<OpacityMap> {
    let alpha = laid.picture.alpha.as_ref()?;
    let values = match from.alpha_mode() {
        AlphaMode::Opaque => return None,
        AlphaMode::Blend => alpha.clone(),
        AlphaMode::Mask => Arc::new(alpha.mapv(|a| cut(from, a * factor))),
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
