//! Meshes as files have them.
//!
//! In: a [`Draft`]: normals may be missing, and triangles may have no area. Out: a finished [`Mesh`].

use super::{
    Mesh,
    smoothing::{SmoothingKey, fill_normals},
};
use geofan_core::error::{Error, Result};
use glam::DVec3;

/// A mesh as a file has it: normals may be missing (zero) and triangles have no area.
#[derive(Default)]
pub(super) struct Draft {
    /// The mesh.
    pub mesh: Mesh,
    /// For each triangle, the normals it shares.
    pub smoothing: Vec<SmoothingKey>,
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
            retain(&mut self.smoothing, &keep);
            let note = format!("{name}: {degenerate} triangles without area left out");
            mesh.warnings.push(note);
        }
        if mesh.triangles.is_empty() {
            return Err(Error::input(name, "holds no triangle with an area"));
        }
        fill_normals(mesh, &self.smoothing, crease);
        Ok(self.mesh)
    }
}

/// Keeps what is to be kept.
fn retain<T>(of: &mut Vec<T>, keep: &[bool]) {
    let mut next = keep.iter();
    of.retain(|_| next.next().copied().unwrap_or(true));
}
