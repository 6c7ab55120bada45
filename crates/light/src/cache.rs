//! The file in which a lightmap is kept beside a bundle.
//!
//! In: a world with lamps. Out: its light, from the file if that is whole and of this very world,
//! else computed and written there. Layout, little-endian: the magic, a fingerprint (32 bytes) of
//! everything that the light depends on, the numbers of facets divided and of points (8 bytes each),
//! the facets divided (u32), six f32 a point, the directions that light comes from ([`DirectedLights`]), and a checksum (XXH3,
//! 8 bytes) of all that comes before.

use crate::{Lamps, bake_light, even_points};
use geofan_core::{
    files::write_atomically,
    reading::{MOST_OF_A_FILE, read_file},
};
use geofan_render::{
    World,
    lightmap::{CONTRAST, DirectedLights, FacetLayout, Light, Lightmap},
    shade::{is_glossy, is_glossy_triangle},
};
use std::{
    io::Write,
    path::{Path, PathBuf},
};
use xxhash_rust::xxh3::xxh3_64;

/// Begins every version of the file; [`MAGIC`] begins this version.
const NAME: &[u8; 13] = b"geofan light ";
const MAGIC: &[u8; 16] = b"geofan light 5\r\n";
const HEAD: usize = 16 + 32 + 8 + 8;

/// Says where a lightmap came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LightmapSource {
    /// The file had it.
    File,
    /// There was no file.
    Computed,
    /// The file was of another world or settings, or of another version.
    Outdated,
    /// The file was damaged.
    Damaged,
    /// It was computed and is kept nowhere: the file is of another kind, or cannot be written.
    NotKept,
}

/// Local tolerance of the light's geodesics: shadows and brightness are then right to a part in a
/// hundred thousand, far below what a picture shows.
const LIGHT_TOLERANCE: f64 = 1e-6;

/// Puts the light of the point lights of `world`, followed over `length`, on its surfaces, and keeps it in a
/// file beside `bundle` if there is one; `done` is told how many more points are lit, and of how many. Returns
/// the file and where the light came from; `None` if there is nothing to light.
pub fn light_up(
    world: &mut World,
    bundle: Option<&Path>,
    length: f64,
    done: impl Fn(usize, usize) + Sync,
) -> Option<(Option<PathBuf>, LightmapSource)> {
    if world.lights.is_empty() || world.faces.is_empty() {
        return None;
    }
    let path = bundle.map(light_file);
    let (found, source) = light(world, length, LIGHT_TOLERANCE, path.as_deref(), done);
    world.light = Some(found);
    Some((path, source))
}

/// Returns the name of the file with the light beside a bundle.
fn light_file(bundle: &Path) -> PathBuf {
    let mut name = bundle.as_os_str().to_owned();
    name.push(".light");
    name.into()
}

/// Returns the light of `world`, followed over `length` at a local tolerance: from the file at `path`
/// if that fits; else computed, and kept there if a path is given. A file that is damaged or of another world is replaced,
/// one of another kind is not.
pub fn light(
    world: &World,
    length: f64,
    tolerance: f64,
    path: Option<&Path>,
    done: impl Fn(usize, usize) + Sync,
) -> (Lightmap, LightmapSource) {
    let layout = FacetLayout::new(world, even_points(world));
    let fingerprint = fingerprint(world, length, tolerance);
    let stored = path.and_then(|path| read_file(path, NAME, MOST_OF_A_FILE).ok());
    let is_foreign = |bytes: &Vec<u8>| !bytes.is_empty() && !bytes.starts_with(NAME);
    let is_kept = !stored.as_ref().is_some_and(is_foreign);
    let source = match stored.as_deref().map(|bytes| decode(bytes, &fingerprint)) {
        Some(Ok((divided, values, directed))) => {
            let lightmap = Lightmap::from_values(layout.clone(), &divided, values);
            if let Some(lightmap) = lightmap.and_then(|light| light.with_directions(directed)) {
                return (lightmap, LightmapSource::File);
            }
            LightmapSource::Damaged
        }
        Some(Err(source)) => source,
        None => LightmapSource::Computed,
    };
    let lamps = Lamps::new(world, length, tolerance);
    let lightmap = bake_light(&lamps, layout, done);
    let Some(path) = path else {
        return (lightmap, source);
    };
    let bytes = encode(&lightmap, &fingerprint);
    match is_kept && write_atomically(path, |out| out.write_all(&bytes)).is_ok() {
        true => (lightmap, source),
        false => (lightmap, LightmapSource::NotKept),
    }
}

/// Hashes everything that the light depends on.
fn fingerprint(world: &World, length: f64, tolerance: f64) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&world.manifold.meaning_digest());
    let mut numbers = |numbers: &[f64]| {
        numbers.iter().for_each(|x| {
            hasher.update(&x.to_le_bytes());
        });
    };
    let even = even_points(world);
    let layout = [even, world.light_points - even].map(|points| points as f64);
    numbers(&[length, tolerance]);
    numbers(&layout);
    numbers(&[f64::from(CONTRAST)]);
    for light in &world.lights {
        numbers(&light.u.to_array());
        numbers(&light.intensity.map(f64::from));
    }
    hasher.update(&world.geometry_fingerprint());
    // Of these, directions are kept.
    if world.materials.iter().any(is_glossy) {
        let triangles = 0..world.faces.len() as u32;
        let glossy = triangles.map(|i| u8::from(is_glossy_triangle(world, i)));
        hasher.update(&glossy.collect::<Vec<u8>>());
    }
    if let Some(told) = world.said_of_frequencies() {
        hasher.update(told.as_bytes());
        // Lapse and drift, which are no part of what paths depend on.
        hasher.update(&world.manifold.fingerprint());
    }
    *hasher.finalize().as_bytes()
}

/// Writes a lightmap as the bytes of its file.
fn encode(lightmap: &Lightmap, fingerprint: &[u8; 32]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend_from_slice(fingerprint);
    bytes.extend((lightmap.divided().len() as u64).to_le_bytes());
    bytes.extend((lightmap.values.len() as u64).to_le_bytes());
    bytes.extend(lightmap.divided().iter().flat_map(|x| x.to_le_bytes()));
    let numbers = lightmap.values.iter().flatten();
    bytes.extend(numbers.flat_map(|x| x.to_le_bytes()));
    bytes.extend(lightmap.directed().to_bytes());
    bytes.extend(xxh3_64(&bytes).to_le_bytes());
    bytes
}

/// The facets divided, the values, and where light comes from.
type Stored = (Vec<u32>, Vec<Light>, DirectedLights);

/// Reads what is stored in `bytes`, undoing [`encode`]; else says why not.
fn decode(bytes: &[u8], fingerprint: &[u8; 32]) -> Result<Stored, LightmapSource> {
    let (body, sum) = bytes
        .split_last_chunk::<8>()
        .ok_or(LightmapSource::Damaged)?;
    if u64::from_le_bytes(*sum) != xxh3_64(body) || body.len() < HEAD || !body.starts_with(NAME) {
        return Err(LightmapSource::Damaged);
    }
    let (head, rest) = body.split_at(HEAD);
    if !head.starts_with(MAGIC) || head[16..48] != fingerprint[..] {
        return Err(LightmapSource::Outdated);
    }
    let (counts, []) = head[48..].as_chunks::<8>() else {
        return Err(LightmapSource::Damaged);
    };
    let [divided, points] = [counts[0], counts[1]].map(u64::from_le_bytes);
    // Both are at most as many as bytes follow, so the sum does not overflow once that is known.
    let most = rest.len() as u64;
    if divided > most || points > most || 4 * divided + 24 * points > most {
        return Err(LightmapSource::Damaged);
    }
    let (divided, rest) = rest.split_at(4 * divided as usize);
    let (numbers, rest) = rest.split_at(24 * points as usize);
    let directed = DirectedLights::from_bytes(rest, points as usize);
    let directed = directed.ok_or(LightmapSource::Damaged)?;
    let word = |b: &[u8]| [b[0], b[1], b[2], b[3]];
    let point = |b: &[u8]| std::array::from_fn(|k| f32::from_le_bytes(word(&b[4 * k..])));
    let divided = divided.chunks_exact(4).map(|b| u32::from_le_bytes(word(b)));
    Ok((
        divided.collect(),
        numbers.chunks_exact(24).map(point).collect(),
        directed,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_flipped_bit_is_noticed_and_another_world_too() {
        let values = vec![[0.5, 1.0, 2.0, 0.0, -0.0, 1e-9], [3.0; 6]];
        let divided = vec![5, 0, 7];
        let sealed = |magic: &[u8; 16], counts: [u64; 2]| {
            let mut bytes = magic.to_vec();
            bytes.extend([7; 32]);
            bytes.extend(counts.iter().flat_map(|n| n.to_le_bytes()));
            bytes.extend(divided.iter().flat_map(|x: &u32| x.to_le_bytes()));
            bytes.extend(values.iter().flatten().flat_map(|x: &f32| x.to_le_bytes()));
            bytes.extend(xxh3_64(&bytes).to_le_bytes());
            bytes
        };
        let bytes = sealed(MAGIC, [3, 2]);
        let known = (divided.clone(), values.clone(), DirectedLights::default());
        assert_eq!(decode(&bytes, &[7; 32]), Ok(known));
        assert_eq!(decode(&bytes, &[8; 32]), Err(LightmapSource::Outdated));
        let older = sealed(b"geofan light 1\r\n", [3, 2]);
        assert_eq!(decode(&older, &[7; 32]), Err(LightmapSource::Outdated));
        for counts in [[3, 3], [4, 2], [u64::MAX, 2], [3, u64::MAX / 24]] {
            let wrong = decode(&sealed(MAGIC, counts), &[7; 32]);
            assert_eq!(wrong, Err(LightmapSource::Damaged), "{counts:?}");
        }
        for i in 0..bytes.len() * 8 {
            let mut damaged = bytes.clone();
            damaged[i / 8] ^= 1 << (i % 8);
            assert_eq!(decode(&damaged, &[7; 32]), Err(LightmapSource::Damaged));
        }
        for length in 0..bytes.len() {
            assert!(decode(&bytes[..length], &[7; 32]).is_err());
        }
    }
}
