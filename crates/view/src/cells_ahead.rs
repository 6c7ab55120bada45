//! Cells of the table that a camera will come into.
//!
//! In: the table, and places where a camera is or may soon be, the most urgent first. Out: chunks of the table to be
//! decoded, one after another, each once; and whether the paths from a place can be looked up without waiting for that.
//! A chunk that nobody has decoded takes as long as many pictures. Where it is decoded, and when that is done, is the
//! engine's matter.

use geofan_bundle::Table;
use glam::DVec3;

/// Coded bytes that are decoded while a picture waits, if a place needs no more: a microsecond each, about.
const WAITED_FOR: usize = 24 << 10;

/// Chunks that have been asked for, and those of which the engine has said that they are decoded.
#[derive(Debug, Clone, Default)]
pub struct CellsAhead {
    asked: Vec<bool>,
    decoded: Vec<bool>,
}

impl CellsAhead {
    /// Returns the next chunk to be decoded: of the first of `places` that needs one, then of the whole table.
    pub fn next(
        &mut self,
        table: &Table,
        places: impl IntoIterator<Item = DVec3>,
    ) -> Option<usize> {
        let count = table.chunks.len();
        self.asked.resize(count, false);
        let urgent = places
            .into_iter()
            .flat_map(|u| table.chunks_at(u).unwrap_or_default());
        urgent.chain(0..count).find(|&chunk| {
            let asked = std::mem::replace(&mut self.asked[chunk], true);
            !asked && !self.has(table, chunk)
        })
    }

    /// Tells whether any chunk is left to be asked for.
    pub fn is_left(&self, table: &Table) -> bool {
        let count = table.chunks.len();
        self.asked.len() < count || self.asked.contains(&false)
    }

    /// Takes note that a chunk is decoded wherever pictures are drawn.
    pub fn note(&mut self, chunk: usize) {
        if self.decoded.len() <= chunk {
            self.decoded.resize(chunk + 1, false);
        }
        self.decoded[chunk] = true;
    }

    fn has(&self, table: &Table, chunk: usize) -> bool {
        table.chunks[chunk].is_decoded() || self.decoded.get(chunk) == Some(&true)
    }

    /// Tells whether the paths from `u` can be looked up at once, or are not in the table at all.
    pub fn is_ready(&self, table: &Table, u: DVec3) -> bool {
        let needed = table.chunks_at(u).unwrap_or_default();
        let missing = needed.into_iter().filter(|chunk| !self.has(table, *chunk));
        let bytes: usize = missing.map(|chunk| table.chunks[chunk].bytes().len()).sum();
        bytes <= WAITED_FOR
    }
}
