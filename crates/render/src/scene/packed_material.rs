//! Materials of packed meshes.
//!
//! In: materials with their textures. Out: bytes, and the materials again. Layout of each, little-endian: its name
//! (length u32, UTF-8), `Kd`, `Ks`, `Ke`, `Ns`, `d`, `Ni` (f32), the illumination model (u8), and three maps
//! (`map_Kd`, `map_d`, `map_Ke`), each a u8 (0: none) and then: scale, offset, range (f32), clamped (u8), and the
//! packed pixels ([`crate::picture::packed`], length u32).

use super::{Mapping, Material, OpacityMap, Texture, TextureMap, packed_numbers::take_chunk};
use crate::picture::packed::Pixels;
use geofan_bundle::put_bytes;
use ndarray::{Array2, Array3};
use std::sync::Arc;

/// Writes materials.
pub(crate) fn put(bytes: &mut Vec<u8>, materials: &[Material]) {
    for material in materials {
        put_one(bytes, material);
    }
}

/// Tells whether materials come back exactly.
#[cfg(feature = "formats")]
pub(crate) fn are_exact(materials: &[Material]) -> bool {
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

fn put_one(bytes: &mut Vec<u8>, material: &Material) {
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
        let numbers = [mapping.scale, mapping.offset, mapping.range];
        put_numbers(bytes, numbers.as_flattened());
        bytes.push(mapping.clamp.into());
        put_bytes(bytes, &pixels.pack());
    }
}

/// Reads so many materials.
pub(crate) fn take(bytes: &mut &[u8], count: usize) -> Option<Vec<Material>> {
    (0..count).map(|_| take_one(bytes)).collect()
}

fn take_one(bytes: &mut &[u8]) -> Option<Material> {
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

fn take_map(bytes: &mut &[u8]) -> Option<Option<(Mapping, Pixels)>> {
    if *bytes.split_off_first()? == 0 {
        return Some(None);
    }
    let mapping = Mapping {
        scale: take_numbers(bytes)?,
        offset: take_numbers(bytes)?,
        range: take_numbers(bytes)?,
        clamp: *bytes.split_off_first()? != 0,
    };
    let pixels = Pixels::unpack(take_part(bytes)?)?;
    Some(Some((mapping, pixels)))
}
