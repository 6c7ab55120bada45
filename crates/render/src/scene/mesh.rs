//! Meshes: triangles with normals, texture coordinates and materials.
//!
//! In: a file of a known format ([`Format`]) and the files that it names. Out: [`Mesh`] in the mesh's
//! own units, or an error that names the file and the place; what could be mended is listed in
//! [`Mesh::warnings`].

#[cfg(feature = "gltf")]
use super::gltf_mesh;
use super::{
    formats::Format,
    material::Material,
    obj_mesh, ply_mesh,
    smoothing::{CREASE, Share, fill_normals},
    text::decoded,
};
use geofan_core::{
    error::{Error, Result},
    reading::{MOST_OF_A_FILE, read_file},
};
use glam::DVec3;
use std::path::Path;

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
        let folder = path.parent().unwrap_or(Path::new(""));
        let name = path.display().to_string();
        match Format::of(path, &bytes)? {
            #[cfg(feature = "gltf")]
            Format::Gltf => gltf_mesh::read(&name, &bytes, folder)?.finished(&name, crease),
            Format::Ply => ply_mesh::read(&name, &bytes, folder)?.finished(&name, crease),
            Format::Obj => Self::parse_creased(&name, &decoded(&bytes), folder, crease),
        }
    }

    /// Reads the OBJ text that the user calls `name`; other files are relative to `folder`.
    pub fn parse(name: &str, text: &str, folder: &Path) -> Result<Self> {
        Self::parse_creased(name, text, folder, CREASE)
    }

    /// Reads it as [`Mesh::parse`] does, but edges are sharp that turn by more than `crease` degrees.
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

/// A mesh as a file has it: normals may be missing (zero) and triangles have no area.
#[derive(Default)]
pub(super) struct Draft {
    /// The mesh.
    pub mesh: Mesh,
    /// For each triangle, the normals it shares.
    pub shares: Vec<Share>,
}

impl Draft {
    /// Returns the finished mesh, without triangles that have no area and with all normals.
    pub(super) fn finished(mut self, name: &str, crease: f64) -> Result<Mesh> {
        let mesh = &mut self.mesh;
        if mesh.positions.iter().any(|p| !p.is_finite()) {
            return Err(Error::input(name, "has a vertex that is not finite"));
        }
        if u32::try_from(3 * mesh.triangles.len() + mesh.positions.len()).is_err() {
            return Err(Error::input(name, "has more than 4294967295 corners"));
        }
        let keep: Vec<bool> = mesh
            .triangles
            .iter()
            .map(|t| mesh.doubled_area(*t) != DVec3::ZERO)
            .collect();
        let degenerate = keep.iter().filter(|keep| !**keep).count();
        if degenerate > 0 {
            retain(&mut mesh.triangles, &keep);
            retain(&mut mesh.material_of, &keep);
            retain(&mut self.shares, &keep);
            let note = format!("{name}: {degenerate} triangles without area left out");
            mesh.warnings.push(note);
        }
        if mesh.triangles.is_empty() {
            return Err(Error::input(name, "holds no triangle with an area"));
        }
        fill_normals(mesh, &self.shares, crease);
        Ok(self.mesh)
    }
}

/// Returns the unit vector along a normal; zero, for none, if it has no direction.
pub(super) fn unit_or_none(normal: DVec3) -> DVec3 {
    match normal.is_finite() {
        true => normal.normalize_or_zero(),
        false => DVec3::ZERO,
    }
}

/// Keeps what is to be kept.
fn retain<T>(of: &mut Vec<T>, keep: &[bool]) {
    let mut next = keep.iter();
    of.retain(|_| next.next().copied().unwrap_or(true));
}

#[cfg(test)]
#[path = "mesh_tests.rs"]
mod tests;
