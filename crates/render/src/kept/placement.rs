//! Where the vertices of meshes are that are placed along geodesics, and how the meshes are cut for that.

use super::{
    joined, part, put, put_texts, put_triangles, put_vectors, take, take_texts, vector,
    vector_bytes,
};
use crate::scene::{Cuts, Mesh, ObjectEntry, Points, pack_cuts, read_cuts};
use geofan_core::{
    keeping::{Keeping, ResultKey, kept},
    manifold::Manifold,
};

/// Fewest triangles of a mesh that is worth looking for: geodesics to fewer take a few milliseconds.
const FEWEST: usize = 1_000;

/// How a mesh is cut, its vertices, and warnings about its placement.
pub(crate) type PlacedPoints = (Cuts, Points, Vec<String>);

/// Returns what `place` returns for `object` with its `mesh` in `manifold`, or what it returned before; `None` if it
/// cannot be placed.
pub(crate) fn placed(
    (manifold, object, mesh): (&Manifold, &ObjectEntry, &Mesh),
    place: impl FnOnce() -> Option<PlacedPoints>,
) -> Option<PlacedPoints> {
    if mesh.triangles.len() < FEWEST {
        return place();
    }
    let keeping = Keeping {
        key: || key(manifold, object, mesh),
        read: decode,
        write: |placed: &PlacedPoints| Some(encode(placed)),
    };
    kept(keeping, || place().ok_or(())).ok()
}

fn key(manifold: &Manifold, object: &ObjectEntry, mesh: &Mesh) -> ResultKey {
    let mut bytes = b"placement".to_vec();
    bytes.extend(manifold.meaning_digest());
    // Warnings name it.
    put_texts(&mut bytes, &[object.mesh.display().to_string()]);
    put_vectors(&mut bytes, &[object.at]);
    let turn = object.rotation.to_array().into_iter().chain([object.scale]);
    bytes.extend(turn.flat_map(f64::to_le_bytes));
    put_vectors(&mut bytes, &mesh.positions);
    put_vectors(&mut bytes, &mesh.normals);
    put_triangles(&mut bytes, &mesh.triangles);
    *blake3::hash(&bytes).as_bytes()
}

fn encode((cuts, points, warnings): &PlacedPoints) -> Vec<u8> {
    let mut bytes = Vec::new();
    let cuts = pack_cuts(&[Some(cuts.clone())]);
    put(&mut bytes, cuts.iter().map(|byte| [*byte]));
    let both = |(u, n): &(_, _)| joined([vector_bytes(*u), vector_bytes(*n)]);
    put::<48>(&mut bytes, points.iter().map(both));
    put_texts(&mut bytes, warnings);
    bytes
}

/// Reads what [`encode`] wrote.
fn decode(mut bytes: &[u8]) -> Option<PlacedPoints> {
    let bytes = &mut bytes;
    let cuts = read_cuts(take::<1>(bytes)?.as_flattened(), 1)?.pop()??;
    let both = |word: &[u8; 48]| (vector(&part(word, 0)), vector(&part(word, 1)));
    let points = take(bytes)?.iter().map(both).collect();
    let warnings = take_texts(bytes)?;
    bytes.is_empty().then_some((cuts, points, warnings))
}
