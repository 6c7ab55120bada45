//! Meshes: triangles with normals, texture coordinates and materials.
//!
//! In: a file of a known format ([`MeshFormat`]) and the files that it names. Out: [`Mesh`] in the mesh's
//! own units, or an error that names the file and the place; what could be mended is listed in
//! [`Mesh::warnings`].

#[cfg(feature = "gltf")]
use super::gltf_mesh;
#[cfg(feature = "formats")]
use super::{formats::MeshFormat, obj_mesh, ply_mesh, text::decoded};
use super::{material::Material, packed_mesh};
#[cfg(feature = "formats")]
use crate::kept;
#[cfg(not(feature = "formats"))]
use geofan_core::error::Error;
use geofan_core::{
    error::Result,
    reading::{MOST_OF_A_FILE, read_file},
};
use glam::DVec3;
use std::path::Path;

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
        match bytes.strip_prefix(packed_mesh::MAGIC) {
            Some(packed) => packed_mesh::read(&path.display().to_string(), packed, crease),
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

#[cfg(all(test, feature = "formats"))]
#[path = "mesh_tests.rs"]
mod tests;
