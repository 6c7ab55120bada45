//! Meshes: triangles with normals, texture coordinates and materials.
//!
//! In: an OBJ file and the MTL files it names. Out: [`Mesh`] in the mesh's own units, or an error
//! that names the file and the line; what could be mended is listed in [`Mesh::warnings`].
//!
//! `tobj` parses, but lets NaN through, drops or repeats normals where only some corners have
//! them, and gives no line with its errors. So the text is surveyed first ([`Survey`]), the reader
//! that feeds `tobj` counts lines, and what comes out is checked again.

use super::{
    material::{Material, TextureShelf, mend_mtl},
    smoothing::{FLAT, Lacking, group_of, mend_obj, unshared},
    survey::Survey,
};
use geofan_core::{
    error::{Error, Result},
    reading::{MOST_OF_A_FILE, read_file},
};
use glam::DVec3;
use std::{
    cell::{Cell, RefCell},
    io::{self, BufRead, Read},
    path::Path,
};

/// A triangle mesh; `positions`, `normals` and `uvs` run in parallel.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    /// Vertices, in the mesh's units.
    pub positions: Vec<DVec3>,
    /// Unit normals, one a vertex; from the file, else area-weighted means of the faces around
    /// that share a smoothing group.
    pub normals: Vec<DVec3>,
    /// Texture coordinates, one a vertex; zero where the file gives none.
    pub uvs: Vec<[f32; 2]>,
    /// Corners as indices of vertices; counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Index into `materials`, one a triangle.
    pub material_of: Vec<u32>,
    /// The materials in use; never empty.
    pub materials: Vec<Material>,
    /// What was mended or left out, one line each.
    pub warnings: Vec<String>,
}

impl Mesh {
    /// Reads the OBJ file at `path` with its materials and textures.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = read_file(path, &[], MOST_OF_A_FILE)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::parse(
            &path.display().to_string(),
            &String::from_utf8_lossy(&bytes),
            folder,
        )
    }

    /// Reads the OBJ text that the user calls `name`; other files are relative to `folder`.
    pub fn parse(name: &str, text: &str, folder: &Path) -> Result<Self> {
        let mended = mend_obj(text);
        let survey = Survey::of(name, &mended)?;
        let mut mesh = Self::default();
        let (models, materials) = parse_obj(name, &mended, folder, &mut mesh.warnings)?;
        mesh.warnings.extend(survey.warnings(name, &materials));
        let mut shelf = TextureShelf::new(folder);
        for material in &materials {
            let material = shelf.material(material, &mut mesh.warnings);
            mesh.materials.push(material);
        }
        let mut lacking = Lacking::default();
        let mut degenerate = 0;
        for model in models {
            lacking.group = group_of(&model.name);
            let part = match lacking.group {
                Some(FLAT) => unshared(model.mesh),
                _ => model.mesh,
            };
            degenerate += mesh.append(name, &part, &mut lacking)?;
        }
        if degenerate > 0 {
            let note = format!("{name}: {degenerate} triangles without area left out");
            mesh.warnings.push(note);
        }
        if mesh.triangles.is_empty() {
            return Err(Error::input(name, "holds no triangle with an area"));
        }
        lacking.fill(&mut mesh);
        Ok(mesh)
    }

    /// Appends one of `tobj`'s models; notes vertices that lack a normal and returns how many
    /// triangles were degenerate.
    fn append(&mut self, name: &str, from: &tobj::Mesh, lacking: &mut Lacking) -> Result<usize> {
        if from.indices.is_empty() {
            return Ok(0);
        }
        let base = self.positions.len();
        let count = from.positions.len() / 3;
        if u32::try_from(base + count).is_err() {
            return Err(Error::input(name, "has more than 4294967295 vertices"));
        }
        let vector = |v: &[f32]| DVec3::new(v[0].into(), v[1].into(), v[2].into());
        self.positions
            .extend(from.positions.chunks_exact(3).map(vector));
        if self.positions[base..].iter().any(|p| !p.is_finite()) {
            return Err(Error::input(name, "has a vertex that is not finite"));
        }
        // Of another length than the positions, they belong to unknown corners: worthless.
        if from.normals.len() == from.positions.len() {
            let unit = |v: &[f32]| vector(v).normalize_or_zero();
            self.normals.extend(from.normals.chunks_exact(3).map(unit));
        } else {
            self.normals.resize(base + count, DVec3::ZERO);
        }
        if from.texcoords.len() == 2 * count {
            let pairs = from.texcoords.chunks_exact(2).map(|t| [t[0], t[1]]);
            self.uvs
                .extend(pairs.map(|t| t.map(|x| if x.is_finite() { x } else { 0.0 })));
        } else {
            self.uvs.resize(base + count, [0.0; 2]);
        }
        let bad = |i: &usize| self.normals[*i] == DVec3::ZERO;
        lacking.note((base..base + count).filter(bad).map(|i| i as u32));
        let material = self.material_index(from.material_id);
        let degenerate = self.append_triangles(base as u32, &from.indices, material);
        lacking.note_triangles(self.triangles.len());
        Ok(degenerate)
    }

    fn append_triangles(&mut self, base: u32, indices: &[u32], material: u32) -> usize {
        let mut degenerate = 0;
        for corner in indices.chunks_exact(3) {
            let triangle = [base + corner[0], base + corner[1], base + corner[2]];
            if self.doubled_area(triangle) == DVec3::ZERO {
                degenerate += 1;
            } else {
                self.triangles.push(triangle);
                self.material_of.push(material);
            }
        }
        degenerate
    }

    /// Normal of a triangle, twice its area long.
    pub(super) fn doubled_area(&self, triangle: [u32; 3]) -> DVec3 {
        let [a, b, c] = triangle.map(|i| self.positions[i as usize]);
        (b - a).cross(c - a)
    }

    /// The material's index, adding the default grey for triangles that have none.
    fn material_index(&mut self, id: Option<usize>) -> u32 {
        let grey = Material::default();
        let index = id.filter(|i| *i < self.materials.len()).unwrap_or_else(|| {
            let known = self.materials.iter().position(|m| m.name == grey.name);
            known.unwrap_or_else(|| {
                self.materials.push(grey);
                self.materials.len() - 1
            })
        });
        index as u32
    }
}

/// Runs `tobj` over the text; puts the line into its errors and reads the MTL files it asks for.
fn parse_obj(
    name: &str,
    text: &str,
    folder: &Path,
    warnings: &mut Vec<String>,
) -> Result<(Vec<tobj::Model>, Vec<tobj::Material>)> {
    let lines = Cell::new(0);
    let mut reader = LineCounter {
        rest: text.as_bytes(),
        lines: &lines,
    };
    let notes = RefCell::new(Vec::new());
    let load_mtl = |mtl: &Path| load_mtl(&folder.join(mtl), &mut notes.borrow_mut());
    let result = tobj::load_obj_buf(&mut reader, &tobj::GPU_LOAD_OPTIONS, load_mtl);
    warnings.append(&mut notes.borrow_mut());
    let (models, materials) =
        result.map_err(|e| Error::input(format!("{name}:{}", lines.get()), e.to_string()))?;
    // A missing MTL is in `warnings` already, from `load_mtl`.
    Ok((models, materials.unwrap_or_default()))
}

fn load_mtl(path: &Path, warnings: &mut Vec<String>) -> tobj::MTLLoadResult {
    let name = path.display().to_string();
    let bytes = read_file(path, &[], MOST_OF_A_FILE).map_err(|e| {
        warnings.push(format!("materials left out: {e}"));
        tobj::LoadError::OpenFileFailed
    })?;
    let mended = mend_mtl(&name, &String::from_utf8_lossy(&bytes), warnings);
    tobj::load_mtl_buf(&mut mended.as_bytes()).inspect_err(|e| {
        warnings.push(format!("materials left out: {name}: {e}"));
    })
}

/// Hands out a text line by line and counts how many have been taken.
struct LineCounter<'a> {
    rest: &'a [u8],
    lines: &'a Cell<usize>,
}

impl BufRead for LineCounter<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        let line_end = self.rest.iter().position(|b| *b == b'\n');
        Ok(&self.rest[..line_end.map_or(self.rest.len(), |i| i + 1)])
    }

    fn consume(&mut self, amount: usize) {
        self.rest = &self.rest[amount..];
        self.lines.set(self.lines.get() + usize::from(amount > 0));
    }
}

impl Read for LineCounter<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let line = self.fill_buf()?;
        let amount = line.len().min(buffer.len());
        buffer[..amount].copy_from_slice(&line[..amount]);
        self.consume(amount);
        Ok(amount)
    }
}

#[cfg(test)]
#[path = "mesh_tests.rs"]
mod tests;
