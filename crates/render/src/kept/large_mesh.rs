//! Large meshes as they are read.
//!
//! A mesh depends on its file, and on those that its reader looks for besides: materials and textures. What these hold, or
//! that they are not there, is kept along; when any has changed the mesh is read again.

use super::{
    LARGE, joined, part, put, put_texts, put_triangles, put_vectors, take, take_texts,
    take_triangles, take_vectors,
};
use crate::scene::{Mesh, materials_are_exact, put_materials, take_chunk, take_materials};
use geofan_core::{
    Result,
    keeping::{Keeping, ResultKey, kept},
    reading::{MOST_OF_A_FILE, exists, noting, read_file},
};
use std::path::{Path, PathBuf};

/// Fewest bytes of a file that is worth looking for: smaller ones have few triangles.
const LARGE_FILE: usize = 1 << 20;

/// Returns the mesh of the file at `path` with these `bytes`, by this `crease`: what `read` reads, or what it read from the
/// same files before.
pub(crate) fn mesh(
    path: &Path,
    bytes: &[u8],
    crease: f64,
    read: impl FnOnce() -> Result<Mesh>,
) -> Result<Mesh> {
    if bytes.len() < LARGE_FILE {
        return read();
    }
    let keeping = Keeping {
        key: || key(path, bytes, crease),
        read: decode,
        write: |(mesh, files): &(Mesh, Vec<PathBuf>)| encode(mesh, files),
    };
    let made = kept(keeping, || {
        let (mesh, files) = noting(read);
        mesh.map(|mesh| (mesh, files))
    });
    made.map(|(mesh, _)| mesh)
}

fn key(path: &Path, bytes: &[u8], crease: f64) -> ResultKey {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"mesh 2");
    // Warnings name it, and its end tells its format.
    let name = path.as_os_str().as_encoded_bytes();
    hasher.update(&(name.len() as u64).to_le_bytes());
    hasher.update(name);
    hasher.update(&crease.to_le_bytes());
    hasher.update(bytes);
    *hasher.finalize().as_bytes()
}

/// Hashes what a file holds; zeros if there is none.
fn content(path: &Path) -> [u8; 32] {
    let bytes = exists(path).then(|| read_file(path, &[], MOST_OF_A_FILE));
    match bytes {
        Some(Ok(bytes)) => *blake3::hash(&bytes).as_bytes(),
        Some(Err(_)) | None => [0; 32],
    }
}

/// Writes a mesh and what is in the files that were looked for besides its own; `None` if it is small, or would not come
/// back exactly.
fn encode(mesh: &Mesh, files: &[PathBuf]) -> Option<Vec<u8>> {
    let names: Vec<String> = files
        .iter()
        .map(|path| path.to_str().map(str::to_owned))
        .collect::<Option<_>>()?;
    if mesh.triangles.len() < LARGE || !materials_are_exact(&mesh.materials) {
        return None;
    }
    let mut bytes = Vec::new();
    put_texts(&mut bytes, &names);
    put(&mut bytes, files.iter().map(|path| content(path)));
    put_texts(&mut bytes, &mesh.warnings);
    put_vectors(&mut bytes, &mesh.positions);
    put_vectors(&mut bytes, &mesh.normals);
    let uvs = mesh.uvs.iter().map(|uv| joined(uv.map(f32::to_le_bytes)));
    put::<8>(&mut bytes, uvs);
    let colours = mesh.colours.iter();
    put::<16>(&mut bytes, colours.map(|c| joined(c.map(f32::to_le_bytes))));
    put_triangles(&mut bytes, &mesh.triangles);
    put(&mut bytes, mesh.material_of.iter().map(|m| m.to_le_bytes()));
    bytes.extend((mesh.materials.len() as u32).to_le_bytes());
    put_materials(&mut bytes, &mesh.materials);
    Some(bytes)
}

/// Reads what [`encode`] wrote; `None` if it is something else, or any of the files has changed.
fn decode(mut bytes: &[u8]) -> Option<(Mesh, Vec<PathBuf>)> {
    let bytes = &mut bytes;
    let names = take_texts(bytes)?.into_iter();
    let files: Vec<PathBuf> = names.map(PathBuf::from).collect();
    let contents = take::<32>(bytes)?;
    let same = files.iter().zip(contents);
    if files.len() != contents.len() || same.into_iter().any(|(path, c)| content(path) != *c) {
        return None;
    }
    let warnings = take_texts(bytes)?;
    let (positions, normals) = (take_vectors(bytes)?, take_vectors(bytes)?);
    let vertices = positions.len();
    let single = |word: [u8; 4]| f32::from_le_bytes(word);
    let uvs: Vec<[f32; 2]> = take::<8>(bytes)?
        .iter()
        .map(|uv| [0, 1].map(|k| single(part(uv, k))))
        .collect();
    let colours: Vec<[f32; 4]> = take::<16>(bytes)?
        .iter()
        .map(|c| [0, 1, 2, 3].map(|k| single(part(c, k))))
        .collect();
    let triangles = take_triangles(bytes, vertices)?;
    let material_of: Vec<u32> = take(bytes)?
        .iter()
        .map(|m| u32::from_le_bytes(*m))
        .collect();
    let count = u32::from_le_bytes(take_chunk(bytes)?);
    let materials = take_materials(bytes, count as usize)?;
    let all = [normals.len(), uvs.len()].iter().all(|n| *n == vertices);
    let coloured = colours.is_empty() || colours.len() == vertices;
    let known = material_of.iter().all(|m| (*m as usize) < materials.len());
    let fits = all && coloured && known && material_of.len() == triangles.len();
    let mesh = Mesh {
        positions,
        normals,
        uvs,
        colours,
        triangles,
        material_of,
        materials,
        warnings,
    };
    (fits && bytes.is_empty()).then_some((mesh, files))
}
