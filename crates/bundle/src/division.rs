//! How a table is divided into chunks, and which of them are stored.
//!
//! In: cells along each camera parameter, blocks of directions (each face, or all of them together), and
//! mirrors that carry some of them into others. Out: the chunks, one for each class of cells and blocks
//! that mirrors carry into each other, and for any cell and block the chunk that holds it
//! ([`Division::stored`]).

use crate::rays::Mirror;

/// How a table is divided into chunks.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    /// Cells along each stored camera parameter.
    pub cells: Vec<usize>,
    /// Blocks of directions: the faces, or one.
    pub blocks: usize,
    /// Where each cell and block is stored; blocks run fastest, then the first parameter's cells.
    stored: Vec<Stored>,
    /// The cell and block of each chunk, in the same numbering.
    chunks: Vec<usize>,
}

/// Where a cell and block is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stored {
    /// The chunk.
    pub chunk: usize,
    /// The mirror that carries the cell and block to those of the chunk; `None` if they are its own.
    pub mirror: Option<usize>,
}

impl Division {
    /// With `cells` along each camera parameter. A cell and block that one of the `mirrors` carries to
    /// an earlier one is not stored.
    pub fn new(cells: Vec<usize>, blocks: usize, mirrors: &[Mirror]) -> Self {
        let all = cells.iter().product::<usize>() * blocks;
        let mut division = Self {
            cells,
            blocks,
            stored: Vec::with_capacity(all),
            chunks: Vec::new(),
        };
        for place in 0..all {
            let earlier = (0..mirrors.len()).find_map(|i| division.image(place, i, &mirrors[i]));
            let stored = earlier.unwrap_or(Stored {
                chunk: division.chunks.len(),
                mirror: None,
            });
            if stored.mirror.is_none() {
                division.chunks.push(place);
            }
            division.stored.push(stored);
        }
        division
    }

    /// Where `place` is stored if mirror number `i` carries it to a chunk.
    fn image(&self, place: usize, i: usize, mirror: &Mirror) -> Option<Stored> {
        let (cell, block) = self.split(place);
        let cell = mirror.cell(&cell, &self.cells)?;
        let block = match self.blocks {
            1 => 0,
            _ => mirror.face(block),
        };
        let image = self.place(&cell, block);
        let chunk = self.chunks.binary_search(&image).ok()?;
        Some(Stored {
            chunk,
            mirror: Some(i),
        })
    }

    /// The number of chunks.
    pub fn chunks(&self) -> usize {
        self.chunks.len()
    }

    /// The cell (along each parameter) and the block of a chunk.
    pub fn of(&self, chunk: usize) -> (Vec<usize>, usize) {
        self.split(self.chunks[chunk])
    }

    /// Where `block` of `cell` is stored.
    pub fn stored(&self, cell: &[usize], block: usize) -> Stored {
        self.stored[self.place(cell, block)]
    }

    fn split(&self, place: usize) -> (Vec<usize>, usize) {
        let mut rest = place / self.blocks;
        let cell = self.cells.iter().map(|n| {
            let c = rest % n;
            rest /= n;
            c
        });
        (cell.collect(), place % self.blocks)
    }

    fn place(&self, cell: &[usize], block: usize) -> usize {
        let cells = cell.iter().zip(&self.cells).rev();
        cells.fold(0, |sum, (c, n)| sum * n + c) * self.blocks + block
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_mirrors_all_cells_and_faces_are_chunks() {
        let division = Division::new(vec![2, 3], 6, &[]);
        assert_eq!(division.chunks(), 36);
        for chunk in 0..36 {
            let (cell, face) = division.of(chunk);
            let stored = division.stored(&cell, face);
            assert_eq!((stored.chunk, stored.mirror), (chunk, None));
        }
        assert_eq!(division.of(7), (vec![1, 0], 1));
    }
}
