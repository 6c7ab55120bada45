//! Where the vertices of placed objects are, for pages, which then need not follow a geodesic to each.
//!
//! In: chart points and normal covectors of objects, or the bytes of a page. Out: bytes, or points and covectors again:
//! each component within 2⁻²⁵ of the extent of its object (of covectors, which shade and place nothing, 2⁻¹⁸), which no
//! picture shows.
//!
//! Bytes, little-endian, for each object: the number of its vertices (u32; 0 where nothing is known), then points and
//! covectors, each as the least component along every axis (three f64), the length that whole numbers are over (f64),
//! and three columns of whole numbers ([`super::packed_numbers`]).

use super::{Points, packed_numbers as numbers};
use glam::DVec3;

/// Steps along the extent of an object, and of its covectors: a step of these turns a normal by less than a shade.
const STEPS: f64 = (1_u32 << 24) as f64;
const COVECTOR_STEPS: f64 = (1_u32 << 17) as f64;

/// Writes the vertices of objects.
pub fn pack_points(all: &[Option<Points>]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for points in all {
        let finite = |points: &&Points| points.iter().all(|(u, n)| u.is_finite() && n.is_finite());
        let points: &[_] = points.as_ref().filter(finite).map_or(&[], |points| points);
        bytes.extend((points.len() as u32).to_le_bytes());
        if !points.is_empty() {
            let (places, covectors): (Vec<_>, Vec<_>) = points.iter().copied().unzip();
            put(&mut bytes, &places, STEPS);
            put(&mut bytes, &covectors, COVECTOR_STEPS);
        }
    }
    bytes
}

/// Reads what [`pack_points`] wrote for so many objects; `None` if it is something else.
pub fn read_points(mut bytes: &[u8], objects: usize) -> Option<Vec<Option<Points>>> {
    let bytes = &mut bytes;
    let object = |_| {
        let count = u32::from_le_bytes(take_chunk(bytes)?) as usize;
        if count == 0 {
            return Some(None);
        }
        let (points, covectors) = (take(bytes, count)?, take(bytes, count)?);
        Some(Some(points.into_iter().zip(covectors).collect()))
    };
    let all = (0..objects).map(object).collect::<Option<_>>()?;
    bytes.is_empty().then_some(all)
}

fn put(bytes: &mut Vec<u8>, vectors: &[DVec3], steps: f64) {
    let low = vectors
        .iter()
        .copied()
        .reduce(DVec3::min)
        .unwrap_or_default();
    let high = vectors
        .iter()
        .copied()
        .reduce(DVec3::max)
        .unwrap_or_default();
    let step = (high - low).max_element() / steps;
    let step = if step > 0.0 { step } else { 1.0 };
    bytes.extend(
        low.to_array()
            .into_iter()
            .chain([step])
            .flat_map(f64::to_le_bytes),
    );
    for k in 0..3 {
        let whole = vectors
            .iter()
            .map(|v| ((v[k] - low[k]) / step).round() as i64);
        numbers::put_whole(bytes, &whole.collect::<Vec<_>>());
    }
}

fn take(bytes: &mut &[u8], count: usize) -> Option<Vec<DVec3>> {
    let mut number = || Some(f64::from_le_bytes(take_chunk(bytes)?));
    let low = DVec3::new(number()?, number()?, number()?);
    let step = number()?;
    let mut column = || numbers::take_whole(bytes, count);
    let [x, y, z] = [column()?, column()?, column()?];
    let at = |i: usize| low + step * DVec3::new(x[i] as f64, y[i] as f64, z[i] as f64);
    Some((0..count).map(at).collect())
}

fn take_chunk<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (chunk, rest) = bytes.split_first_chunk::<N>()?;
    *bytes = rest;
    Some(*chunk)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_come_back_almost_as_they_were_and_other_bytes_are_refused() {
        let point = |i: usize| {
            let t = i as f64 * 0.37;
            (
                DVec3::new(t.sin(), 1e-3 * t, -4.0),
                DVec3::new(9.0, t.cos(), 1.0),
            )
        };
        let known: Points = (0..50).map(point).collect();
        let all = vec![None, Some(known.clone()), Some(vec![point(7)])];
        let bytes = pack_points(&all);
        let back = read_points(&bytes, 3).unwrap();
        assert!(back[0].is_none());
        assert_eq!(back[2], Some(vec![point(7)]));
        for ((u, n), (v, m)) in known.iter().zip(back[1].as_ref().unwrap()) {
            assert!((*u - *v).abs().max_element() <= 2.0 / (2.0 * STEPS));
            assert!((*n - *m).abs().max_element() <= 2.0 / (2.0 * COVECTOR_STEPS));
        }
        for length in 0..bytes.len() {
            assert!(read_points(&bytes[..length], 3).is_none());
        }
        assert!(read_points(&bytes, 2).is_none() && read_points(&bytes, 4).is_none());
    }
}
