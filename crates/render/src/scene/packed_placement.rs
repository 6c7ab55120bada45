//! How meshes were placed, packed for pages: how each was cut, and where its vertices are.
//!
//! In: the cuts that placing objects made, and the chart points and normal covectors of their vertices; or the bytes of
//! a page. Out: bytes; or cuts, points and covectors again. To find out how to cut takes geodesics to the middles of
//! all edges, most of the time that placing takes, and points take one to each vertex. Each component of a point comes
//! back within 2⁻²⁵ of the extent of its object (of covectors, which shade and place nothing, 2⁻¹⁸), which no picture
//! shows.
//!
//! Bytes of cuts, little-endian, for each object: 0 where nothing is known; else 1, the radius beyond which the mesh
//! was clipped (f64; infinite where it was not), the number of rounds (u32), and for each its number of edges (u32) and
//! their two columns of vertices ([`super::packed_numbers`]).
//!
//! Bytes of points, little-endian, for each object: the number of its vertices (u32; 0 where nothing is known), then
//! points and covectors, each as the least component along every axis (three f64), the length that whole numbers are
//! over (f64), and three columns of whole numbers.

use super::{
    Points,
    packed_numbers::{self as numbers, take_chunk},
};
use glam::DVec3;

/// How a mesh was cut.
#[derive(Debug, Clone, PartialEq)]
pub struct Cuts {
    /// Distance in the metric beyond which it was clipped; infinite where it was not.
    pub within: f64,
    /// The edges that were split in each round, by the numbers of their vertices; each middle became a new vertex.
    pub rounds: Vec<Vec<[u32; 2]>>,
}

/// Writes the cuts of objects.
pub fn pack_cuts(all: &[Option<Cuts>]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for cuts in all {
        bytes.push(cuts.is_some().into());
        let Some(cuts) = cuts else { continue };
        bytes.extend(cuts.within.to_le_bytes());
        bytes.extend((cuts.rounds.len() as u32).to_le_bytes());
        for edges in &cuts.rounds {
            bytes.extend((edges.len() as u32).to_le_bytes());
            for k in 0..2 {
                let column: Vec<i64> = edges.iter().map(|edge| edge[k].into()).collect();
                numbers::put_whole(&mut bytes, &column);
            }
        }
    }
    bytes
}

/// Reads what [`pack_cuts`] wrote for so many objects; `None` if it is something else.
pub fn read_cuts(mut bytes: &[u8], objects: usize) -> Option<Vec<Option<Cuts>>> {
    let all = (0..objects)
        .map(|_| match bytes.split_off_first()? {
            0 => Some(None),
            1 => Some(Some(take_cuts(&mut bytes)?)),
            _ => None,
        })
        .collect::<Option<Vec<_>>>()?;
    bytes.is_empty().then_some(all)
}

fn take_cuts(bytes: &mut &[u8]) -> Option<Cuts> {
    let within = f64::from_le_bytes(take_chunk(bytes)?);
    let rounds = take_count(bytes)?;
    let edges = |bytes: &mut &[u8]| {
        let count = take_count(bytes)?;
        let [a, b] = [
            numbers::take_whole(bytes, count)?,
            numbers::take_whole(bytes, count)?,
        ];
        let edge = |(a, b): (i64, i64)| Some([u32::try_from(a).ok()?, u32::try_from(b).ok()?]);
        a.into_iter().zip(b).map(edge).collect::<Option<Vec<_>>>()
    };
    Some(Cuts {
        within,
        rounds: (0..rounds)
            .map(|_| edges(bytes))
            .collect::<Option<Vec<_>>>()?,
    })
}

fn take_count(bytes: &mut &[u8]) -> Option<usize> {
    Some(u32::from_le_bytes(take_chunk(bytes)?) as usize)
}

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
            put_vectors(&mut bytes, &places, STEPS);
            put_vectors(&mut bytes, &covectors, COVECTOR_STEPS);
        }
    }
    bytes
}

/// Reads what [`pack_points`] wrote for so many objects; `None` if it is something else.
pub fn read_points(mut bytes: &[u8], objects: usize) -> Option<Vec<Option<Points>>> {
    let bytes = &mut bytes;
    let object = |_| {
        let count = take_count(bytes)?;
        if count == 0 {
            return Some(None);
        }
        let (points, covectors) = (take_vectors(bytes, count)?, take_vectors(bytes, count)?);
        Some(Some(points.into_iter().zip(covectors).collect()))
    };
    let all = (0..objects).map(object).collect::<Option<_>>()?;
    bytes.is_empty().then_some(all)
}

fn put_vectors(bytes: &mut Vec<u8>, vectors: &[DVec3], steps: f64) {
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

fn take_vectors(bytes: &mut &[u8], count: usize) -> Option<Vec<DVec3>> {
    let mut number = || Some(f64::from_le_bytes(take_chunk(bytes)?));
    let low = DVec3::new(number()?, number()?, number()?);
    let step = number()?;
    let mut column = || numbers::take_whole(bytes, count);
    let [x, y, z] = [column()?, column()?, column()?];
    let at = |i: usize| low + step * DVec3::new(x[i] as f64, y[i] as f64, z[i] as f64);
    Some((0..count).map(at).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cuts_come_back_and_other_bytes_are_refused() {
        let known = Cuts {
            within: f64::INFINITY,
            rounds: vec![vec![[0, 1], [3, 70_000]], vec![], vec![[5, 2]]],
        };
        let all = vec![None, Some(known), None];
        let bytes = pack_cuts(&all);
        assert_eq!(read_cuts(&bytes, 3), Some(all));
        assert_eq!(read_cuts(&bytes, 2), None);
        assert_eq!(read_cuts(&bytes, 4), None);
        for length in 0..bytes.len() {
            assert_eq!(read_cuts(&bytes[..length], 3), None);
        }
    }

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
