//! How a mesh was cut when it was placed, so that it can be placed again without finding that out.
//!
//! In: the cuts that placing an object made, or a mesh and the cuts of another time. Out: bytes of them, for pages;
//! or the mesh cut in the same way. To find out takes geodesics to the middles of all edges: most of the time that
//! placing takes.
//!
//! Bytes, little-endian, for each object: 0 where nothing is known; else 1, the radius beyond which the mesh was
//! clipped (f64; infinite where it was not), the number of rounds (u32), and for each its number of edges (u32) and their
//! two columns of vertices ([`super::packed_numbers`]).

use super::packed_numbers as numbers;

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
        .map(|_| {
            let (known, rest) = bytes.split_first()?;
            bytes = rest;
            match known {
                0 => Some(None),
                1 => Some(Some(take_cuts(&mut bytes)?)),
                _ => None,
            }
        })
        .collect::<Option<Vec<_>>>()?;
    bytes.is_empty().then_some(all)
}

fn take_cuts(bytes: &mut &[u8]) -> Option<Cuts> {
    let (within, rest) = bytes.split_first_chunk::<8>()?;
    *bytes = rest;
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
        within: f64::from_le_bytes(*within),
        rounds: (0..rounds)
            .map(|_| edges(bytes))
            .collect::<Option<Vec<_>>>()?,
    })
}

fn take_count(bytes: &mut &[u8]) -> Option<usize> {
    let (count, rest) = bytes.split_first_chunk::<4>()?;
    *bytes = rest;
    Some(u32::from_le_bytes(*count) as usize)
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
}
