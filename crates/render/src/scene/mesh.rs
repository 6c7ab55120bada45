//! Meshes: triangles with normals, texture coordinates and materials; and in few bytes, for pages, which bring no
//! readers of other formats along.
//!
//! In: a file of a known format ([`MeshFormat`]) and the files that it names. Out: [`Mesh`] in the mesh's
//! own units, or an error that names the file and the place; what could be mended is listed in
//! [`Mesh::warnings`].
//!
//! In: a mesh as it was read by creases of several objects. Out: a file that stands in the place of the mesh's own,
//! and from it the mesh: all positions, texture coordinates, colours and triangles as they were; normals too, where
//! the file gave them with at most six decimals, else turned by less than 1e-7.
//!
//! Layout, little-endian: [`MAGIC`], then for each crease its degrees (f64), the length of what follows for it
//! (u32), and: the numbers of vertices, of colours, of triangles and of materials (u32); positions, normals (after
//! the power of ten that they are over, u8, or [`FINE`]), texture coordinates, colours
//! ([`super::packed_numbers`]); the corners of triangles, as how far they are below the first number that is not
//! used yet; the numbers of materials; the materials.
//!
//! Layout of a material: its name (length u32, UTF-8), `Kd`, `Ks`, `Ke`, `Ns`, `d`, `Ni` (f32), the illumination
//! model (u8), and three maps (`map_Kd`, `map_d`, `map_Ke`), each a u8 (0: none) and then: scale, offset, range (f32),
//! what is beside it along rows and columns (u8 each: 0 it again, 1 its edge, 2 its mirror image), whether its pixels are
//! squares (u8), and the packed pixels ([`crate::picture::Pixels`], length u32).

#[cfg(feature = "gltf")]
use super::gltf_mesh;
use super::{
    Mapping, Material, OpacityMap, Texture, TextureMap, Wrap,
    packed_numbers::{self as numbers, take_chunk},
};
#[cfg(feature = "formats")]
use super::{
    formats::{MeshFormat, decoded},
    obj_mesh, ply_mesh,
};
#[cfg(feature = "formats")]
use crate::kept;
use crate::picture::Pixels;
use geofan_bundle::put_bytes;
use geofan_core::{
    error::{Error, Result},
    reading::{MOST_OF_A_FILE, read_file},
};
use glam::DVec3;
use ndarray::{Array2, Array3};
use std::{path::Path, sync::Arc};

/// The angle (degrees) above which an edge is sharp unless something else is asked for: what
/// modelling programs take. Round things of 12 sides and more are smooth.
pub const CREASE: f64 = 30.0;

/// A triangle mesh; `positions`, `normals` and `uvs` run in parallel.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    /// Vertices, in the mesh's units.
    pub positions: Vec<DVec3>,
    /// Unit normals, one a vertex; from the file, else means of the faces around that it is smooth to.
    pub normals: Vec<DVec3>,
    /// Texture coordinates, one a vertex; zero where the file gives none.
    pub uvs: Vec<[f32; 2]>,
    /// Linear red, green, blue and opacity that multiply those of the material, one a vertex; empty
    /// where the file gives none.
    pub colours: Vec<[f32; 4]>,
    /// Corners as indices of vertices; counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Index into `materials`, one a triangle.
    pub material_of: Vec<u32>,
    /// The materials in use; never empty.
    pub materials: Vec<Material>,
    /// Mended and left-out parts, one line each.
    pub warnings: Vec<String>,
}

impl Mesh {
    /// Reads the file at `path` with its materials and textures. Where it gives no normals and no
    /// smoothing groups, edges that turn by more than 30° are sharp.
    pub fn load(path: &Path) -> Result<Self> {
        Self::load_creased(path, CREASE)
    }

    /// Reads it as [`Mesh::load`] does, but edges are sharp that turn by more than `crease` degrees.
    pub fn load_creased(path: &Path, crease: f64) -> Result<Self> {
        let bytes = read_file(path, &[], MOST_OF_A_FILE)?;
        match bytes.strip_prefix(MAGIC) {
            Some(packed) => read(&path.display().to_string(), packed, crease),
            None => Self::read_format(path, &bytes, crease),
        }
    }

    /// Reads a file of a format that other programs write.
    #[cfg(not(feature = "formats"))]
    fn read_format(path: &Path, _: &[u8], _: f64) -> Result<Self> {
        let message = "is no packed mesh, and this build reads no others";
        Err(Error::input(path.display().to_string(), message))
    }

    /// Reads a file of a format that other programs write, or takes what was kept of it.
    #[cfg(feature = "formats")]
    fn read_format(path: &Path, bytes: &[u8], crease: f64) -> Result<Self> {
        kept::mesh(path, bytes, crease, || {
            Self::parse_format(path, bytes, crease)
        })
    }

    /// Reads a file of a format that other programs write.
    #[cfg(feature = "formats")]
    fn parse_format(path: &Path, bytes: &[u8], crease: f64) -> Result<Self> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let name = path.display().to_string();
        match MeshFormat::of(path, bytes)? {
            #[cfg(feature = "gltf")]
            MeshFormat::Gltf => gltf_mesh::read(&name, bytes, folder)?.finished(&name, crease),
            MeshFormat::Ply => ply_mesh::read(&name, bytes, folder)?.finished(&name, crease),
            MeshFormat::Obj => Self::parse_creased(&name, &decoded(bytes), folder, crease),
        }
    }

    /// Reads the OBJ text that the user calls `name`; other files are relative to `folder`.
    #[cfg(feature = "formats")]
    pub fn parse(name: &str, text: &str, folder: &Path) -> Result<Self> {
        Self::parse_creased(name, text, folder, CREASE)
    }

    /// Reads it as [`Mesh::parse`] does, but edges are sharp that turn by more than `crease` degrees.
    #[cfg(feature = "formats")]
    pub fn parse_creased(name: &str, text: &str, folder: &Path, crease: f64) -> Result<Self> {
        obj_mesh::read(name, text, folder)?.finished(name, crease)
    }

    /// Returns the normal of a triangle, twice its area long.
    pub(super) fn doubled_area(&self, triangle: [u32; 3]) -> DVec3 {
        let [a, b, c] = triangle.map(|i| self.positions[i as usize]);
        (b - a).cross(c - a)
    }

    /// Adds a vertex like `vertex`; returns its number.
    pub(super) fn copy_vertex(&mut self, vertex: u32) -> u32 {
        let from = vertex as usize;
        self.positions.push(self.positions[from]);
        self.normals.push(self.normals[from]);
        self.uvs.push(self.uvs[from]);
        if !self.colours.is_empty() {
            self.colours.push(self.colours[from]);
        }
        (self.positions.len() - 1) as u32
    }
}

/// Returns the unit vector along a normal; zero, for none, if it has no direction.
pub(super) fn unit_or_none(normal: DVec3) -> DVec3 {
    match normal.is_finite() {
        true => normal.normalize_or_zero(),
        false => DVec3::ZERO,
    }
}

/// Begins a file of packed meshes.
pub(super) const MAGIC: &[u8; 16] = b"geofan meshes 3\n";

/// Most decimals of normals that are tried.
const MOST_DECIMALS: u8 = 6;

/// Normals are over this where they have no decimals: each component is off by at most 3e-8.
const FINE: (u8, f64) = (0x80, (1_u32 << 24) as f64);

/// Packs meshes of one file with the creases (degrees) that they were read with.
pub fn pack(meshes: &[(f64, &Mesh)]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    for (crease, mesh) in meshes {
        let body = body(mesh);
        bytes.extend(crease.to_le_bytes());
        bytes.extend((body.len() as u32).to_le_bytes());
        bytes.extend(body);
    }
    bytes
}

/// Reads the mesh of `crease` from the file `name` that [`pack`] wrote, without its first bytes.
pub(super) fn read(name: &str, mut bytes: &[u8], crease: f64) -> Result<Mesh> {
    let damaged = || Error::input(name, "is a damaged packed mesh");
    while !bytes.is_empty() {
        let known = numbers::take_chunk(&mut bytes).ok_or_else(damaged)?;
        let length = numbers::take_chunk(&mut bytes).ok_or_else(damaged)?;
        let length = u32::from_le_bytes(length) as usize;
        let body = bytes.split_off(..length).ok_or_else(damaged)?;
        if f64::from_le_bytes(known) == crease {
            return mesh(body).ok_or_else(damaged);
        }
    }
    Err(Error::input(
        name,
        format!("has no mesh of crease {crease}"),
    ))
}

fn body(mesh: &Mesh) -> Vec<u8> {
    let counts = [
        mesh.positions.len(),
        mesh.colours.len(),
        mesh.triangles.len(),
        mesh.materials.len(),
    ];
    let mut bytes: Vec<u8> = counts
        .into_iter()
        .flat_map(|n| (n as u32).to_le_bytes())
        .collect();
    numbers::put(&mut bytes, &columns(&mesh.positions, |p| p.to_array()));
    put_normals(&mut bytes, &mesh.normals);
    numbers::put(&mut bytes, &columns(&mesh.uvs, |t| t.map(f64::from)));
    numbers::put(&mut bytes, &columns(&mesh.colours, |c| c.map(f64::from)));
    numbers::put_whole(&mut bytes, &below_unused(&mesh.triangles));
    let materials: Vec<i64> = mesh.material_of.iter().map(|m| i64::from(*m)).collect();
    numbers::put_whole(&mut bytes, &materials);
    put_materials(&mut bytes, &mesh.materials);
    bytes
}

fn mesh(mut bytes: &[u8]) -> Option<Mesh> {
    let bytes = &mut bytes;
    let mut count = || Some(u32::from_le_bytes(numbers::take_chunk(bytes)?) as usize);
    let [vertices, colours, triangles, materials] = [count()?, count()?, count()?, count()?];
    let positions = rows(&numbers::take(bytes, 3, vertices)?, DVec3::from_array);
    let normals = take_normals(bytes, vertices)?;
    let single = |x: f64| x as f32;
    let uvs = rows(&numbers::take(bytes, 2, vertices)?, |t: [f64; 2]| {
        t.map(single)
    });
    let colours = rows(&numbers::take(bytes, 4, colours)?, |c: [f64; 4]| {
        c.map(single)
    });
    let triangles = above(
        &numbers::take_whole(bytes, triangles.checked_mul(3)?)?,
        vertices,
    )?;
    let of = numbers::take_whole(bytes, triangles.len())?;
    let material = |m: &i64| u32::try_from(*m).ok().filter(|m| (*m as usize) < materials);
    let mesh = Mesh {
        positions,
        normals,
        uvs,
        colours,
        triangles,
        material_of: of.iter().map(material).collect::<Option<_>>()?,
        materials: take_materials(bytes, materials)?,
        warnings: Vec::new(),
    };
    let fits = mesh.colours.is_empty() || mesh.colours.len() == vertices;
    (fits && bytes.is_empty() && !mesh.triangles.is_empty()).then_some(mesh)
}

/// Turns rows into columns.
fn columns<T, const N: usize>(rows: &[T], row: impl Fn(&T) -> [f64; N]) -> Vec<Vec<f64>> {
    (0..N)
        .map(|k| rows.iter().map(|of| row(of)[k]).collect())
        .collect()
}

/// Turns columns into rows.
fn rows<T, const N: usize>(columns: &[Vec<f64>], row: impl Fn([f64; N]) -> T) -> Vec<T> {
    let count = columns.first().map_or(0, Vec::len);
    (0..count)
        .map(|i| row(std::array::from_fn(|k| columns[k][i])))
        .collect()
}

/// Finds whole numbers whose direction, over ten to the power of `decimals`, is exactly that of a unit normal.
fn before_normalising(normal: DVec3, decimals: u8) -> Option<[i64; 3]> {
    let power = 10_f64.powi(decimals.into());
    let near = normal.to_array().map(|x| (x * power).round() as i64);
    // The file's vector was not quite of length one: each number may have been the next one.
    let shifts = (0..27).map(|k| [k % 3, k / 3 % 3, k / 9].map(|s| [0, 1, -1][s as usize]));
    let shifted = shifts.map(|shift: [i64; 3]| [0, 1, 2].map(|k: usize| near[k] + shift[k]));
    shifted
        .into_iter()
        .find(|whole| over(*whole, power) == normal)
}

/// Returns the unit vector along whole numbers over `power`.
fn over(whole: [i64; 3], power: f64) -> DVec3 {
    unit_or_none(DVec3::from_array(whole.map(|n| n as f64 / power)))
}

fn put_normals(bytes: &mut Vec<u8>, normals: &[DVec3]) {
    let of = |d: u8| normals.iter().map(move |n| before_normalising(*n, d));
    let exact = (0..=MOST_DECIMALS).find_map(|d| Some((d, of(d).collect::<Option<Vec<_>>>()?)));
    let fine = |n: &DVec3| n.to_array().map(|x| (x * FINE.1).round() as i64);
    let (kind, whole) = exact.unwrap_or_else(|| (FINE.0, normals.iter().map(fine).collect()));
    bytes.push(kind);
    for k in 0..3 {
        let column: Vec<i64> = whole.iter().map(|n| n[k]).collect();
        numbers::put_whole(bytes, &column);
    }
}

fn take_normals(bytes: &mut &[u8], count: usize) -> Option<Vec<DVec3>> {
    let power = match *bytes.split_off_first()? {
        kind if kind == FINE.0 => FINE.1,
        decimals if decimals <= MOST_DECIMALS => 10_f64.powi(decimals.into()),
        _ => return None,
    };
    let mut column = || numbers::take_whole(bytes, count);
    let [x, y, z] = [column()?, column()?, column()?];
    let normal = |i: usize| over([x[i], y[i], z[i]], power);
    Some((0..count).map(normal).collect())
}

/// Tells of each corner how far it is below the first vertex that no triangle has used yet.
fn below_unused(triangles: &[[u32; 3]]) -> Vec<i64> {
    let mut unused = 0;
    let mut below = |corner: &u32| {
        let corner = i64::from(*corner);
        let told = unused - corner;
        unused = unused.max(corner + 1);
        told
    };
    triangles.iter().flatten().map(&mut below).collect()
}

/// Undoes [`below_unused`] for triangles of so many vertices.
fn above(below: &[i64], vertices: usize) -> Option<Vec<[u32; 3]>> {
    let mut unused = 0_i64;
    let mut corner = |told: i64| {
        let corner = unused.checked_sub(told)?;
        unused = unused.max(corner.checked_add(1)?);
        let corner = u32::try_from(corner).ok()?;
        ((corner as usize) < vertices).then_some(corner)
    };
    let (triangles, []) = below.as_chunks::<3>() else {
        return None;
    };
    let three = |[a, b, c]: &[i64; 3]| Some([corner(*a)?, corner(*b)?, corner(*c)?]);
    triangles.iter().map(three).collect()
}

/// Writes materials.
pub(crate) fn put_materials(bytes: &mut Vec<u8>, materials: &[Material]) {
    for material in materials {
        put_material(bytes, material);
    }
}

/// Tells whether materials come back exactly.
#[cfg(feature = "formats")]
pub(crate) fn materials_are_exact(materials: &[Material]) -> bool {
    materials.iter().all(|material| {
        let colours = [&material.map_kd, &material.map_ke].into_iter().flatten();
        let opacity = material.map_d.as_ref().map(opacity);
        let mut all = colours.map(colours_of).chain(opacity);
        all.all(|(_, pixels)| pixels.is_coded())
    })
}

/// Returns the pixels of a map of colours.
fn colours_of(map: &TextureMap) -> (Mapping, Pixels) {
    (map.mapping, map.texture.pixels())
}

/// Returns the pixels of a map of opacities.
fn opacity(map: &OpacityMap) -> (Mapping, Pixels) {
    let (height, width) = map.values.dim();
    let values = map.values.iter().copied().collect();
    let shape = (height, width, 1);
    (map.mapping, Pixels { shape, values })
}

fn put_material(bytes: &mut Vec<u8>, material: &Material) {
    put_bytes(bytes, material.name.as_bytes());
    let colours = [material.kd, material.ks, material.ke];
    let numbers = [material.ns, material.dissolve, material.ni];
    put_numbers(bytes, colours.as_flattened());
    put_numbers(bytes, &numbers);
    bytes.push(material.illumination);
    put_map(bytes, material.map_kd.as_ref().map(colours_of));
    put_map(bytes, material.map_d.as_ref().map(opacity));
    put_map(bytes, material.map_ke.as_ref().map(colours_of));
}

fn put_numbers(bytes: &mut Vec<u8>, numbers: &[f32]) {
    bytes.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
}

fn put_map(bytes: &mut Vec<u8>, map: Option<(Mapping, Pixels)>) {
    bytes.push(map.is_some().into());
    if let Some((mapping, pixels)) = map {
        let numbers = [mapping.scale, mapping.cross, mapping.offset, mapping.range];
        put_numbers(bytes, numbers.as_flattened());
        bytes.extend(mapping.wrap.map(|wrap| wrap as u8));
        bytes.push(mapping.nearest.into());
        put_bytes(bytes, &pixels.pack());
    }
}

/// Reads so many materials.
pub(crate) fn take_materials(bytes: &mut &[u8], count: usize) -> Option<Vec<Material>> {
    (0..count).map(|_| take_material(bytes)).collect()
}

fn take_material(bytes: &mut &[u8]) -> Option<Material> {
    let name = take_part(bytes)?;
    let name = str::from_utf8(name).ok()?.to_owned();
    let [kd, ks, ke, [ns, dissolve, ni]] = [
        take_numbers(bytes)?,
        take_numbers(bytes)?,
        take_numbers(bytes)?,
        take_numbers(bytes)?,
    ];
    let illumination = *bytes.split_off_first()?;
    let [map_kd, map_d, map_ke] = [take_map(bytes)?, take_map(bytes)?, take_map(bytes)?];
    let colours = |map: Option<(Mapping, Pixels)>| {
        let Some((mapping, pixels)) = map else {
            return Some(None);
        };
        let pixels = Array3::from_shape_vec(pixels.shape, pixels.values).ok()?;
        let texture = Arc::new(Texture::new(pixels)?);
        Some(Some(TextureMap { texture, mapping }))
    };
    let opacity = |(mapping, pixels): (Mapping, Pixels)| {
        let (height, width, channels) = pixels.shape;
        let shape = (channels == 1 && height * width > 0).then_some((height, width))?;
        let values = Arc::new(Array2::from_shape_vec(shape, pixels.values).ok()?);
        Some(OpacityMap { values, mapping })
    };
    let map_d = match map_d {
        None => None,
        Some(map) => Some(opacity(map)?),
    };
    Some(Material {
        name,
        kd,
        ks,
        ns,
        ke,
        dissolve,
        ni,
        illumination,
        map_kd: colours(map_kd)?,
        map_d,
        map_ke: colours(map_ke)?,
    })
}

/// Reads bytes with their length before them.
fn take_part<'b>(bytes: &mut &'b [u8]) -> Option<&'b [u8]> {
    let length = u32::from_le_bytes(take_chunk(bytes)?);
    bytes.split_off(..length as usize)
}

fn take_numbers<const N: usize>(bytes: &mut &[u8]) -> Option<[f32; N]> {
    let (words, _) = bytes.split_off(..4 * N)?.as_chunks::<4>();
    Some(std::array::from_fn(|k| f32::from_le_bytes(words[k])))
}

fn take_wrap(bytes: &mut &[u8]) -> Option<Wrap> {
    match *bytes.split_off_first()? {
        0 => Some(Wrap::Repeat),
        1 => Some(Wrap::Clamp),
        2 => Some(Wrap::Mirror),
        _ => None,
    }
}

fn take_map(bytes: &mut &[u8]) -> Option<Option<(Mapping, Pixels)>> {
    if *bytes.split_off_first()? == 0 {
        return Some(None);
    }
    let mapping = Mapping {
        scale: take_numbers(bytes)?,
        cross: take_numbers(bytes)?,
        offset: take_numbers(bytes)?,
        range: take_numbers(bytes)?,
        wrap: [take_wrap(bytes)?, take_wrap(bytes)?],
        nearest: *bytes.split_off_first()? != 0,
    };
    let pixels = Pixels::unpack(take_part(bytes)?)?;
    Some(Some((mapping, pixels)))
}

#[cfg(test)]
#[path = "packed_mesh_tests.rs"]
mod packed_tests;
#[cfg(all(test, feature = "formats"))]
#[path = "mesh_tests.rs"]
mod tests;
