//! Loops over many pieces of work: by all threads with the feature `parallel`, else one after the other.
//!
//! Without the feature the names of `rayon` stand for plain iterators, so that loops are written once.

#[cfg(feature = "parallel")]
pub use rayon::{join, prelude::*};

#[cfg(not(feature = "parallel"))]
pub use sequential::*;

#[cfg(not(feature = "parallel"))]
mod sequential {
    use std::slice::{Chunks, ChunksExactMut, ChunksMut, Iter, IterMut};

    /// Does `a`, then `b`.
    pub fn join<A, B>(a: impl FnOnce() -> A, b: impl FnOnce() -> B) -> (A, B) {
        (a(), b())
    }

    /// Gives `into_par_iter` to everything that can be iterated over.
    pub trait IntoParallelIterator: IntoIterator + Sized {
        /// Iterates in order.
        fn into_par_iter(self) -> Self::IntoIter {
            self.into_iter()
        }
    }

    impl<I: IntoIterator> IntoParallelIterator for I {}

    /// Gives `flat_map_iter` to iterators.
    pub trait ParallelIterator: Iterator + Sized {
        /// Iterates over all that `f` makes of each item.
        fn flat_map_iter<U: IntoIterator>(
            self,
            f: impl FnMut(Self::Item) -> U,
        ) -> impl Iterator<Item = U::Item> {
            self.flat_map(f)
        }
    }

    impl<I: Iterator> ParallelIterator for I {}

    /// Iterates over slices and their chunks.
    pub trait ParallelSlice<T> {
        /// Iterates over the elements.
        fn par_iter(&self) -> Iter<'_, T>;
        /// Iterates over the elements, which may be changed.
        fn par_iter_mut(&mut self) -> IterMut<'_, T>;
        /// Iterates over chunks of `size`, the last perhaps shorter.
        fn par_chunks(&self, size: usize) -> Chunks<'_, T>;
        /// Iterates over chunks of `size`, the last perhaps shorter, which may be changed.
        fn par_chunks_mut(&mut self, size: usize) -> ChunksMut<'_, T>;
        /// Iterates over whole chunks of `size`, which may be changed.
        fn par_chunks_exact_mut(&mut self, size: usize) -> ChunksExactMut<'_, T>;
    }

    impl<T> ParallelSlice<T> for [T] {
        fn par_iter(&self) -> Iter<'_, T> {
            self.iter()
        }
        fn par_iter_mut(&mut self) -> IterMut<'_, T> {
            self.iter_mut()
        }
        fn par_chunks(&self, size: usize) -> Chunks<'_, T> {
            self.chunks(size)
        }
        fn par_chunks_mut(&mut self, size: usize) -> ChunksMut<'_, T> {
            self.chunks_mut(size)
        }
        fn par_chunks_exact_mut(&mut self, size: usize) -> ChunksExactMut<'_, T> {
            self.chunks_exact_mut(size)
        }
    }
}
