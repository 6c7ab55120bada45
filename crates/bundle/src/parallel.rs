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

    /// Gives the methods of parallel iteration that this crate uses to everything that can be iterated over.
    pub trait InOrder {
        /// Iterates over the items of a range or a list.
        fn into_par_iter(self) -> Self::IntoIter
        where
            Self: IntoIterator + Sized,
        {
            self.into_iter()
        }

        /// Iterates over the elements of a slice.
        fn par_iter<T>(&self) -> Iter<'_, T>
        where
            Self: AsRef<[T]>,
        {
            self.as_ref().iter()
        }

        /// Iterates over the elements, which may be changed.
        fn par_iter_mut<T>(&mut self) -> IterMut<'_, T>
        where
            Self: AsMut<[T]>,
        {
            self.as_mut().iter_mut()
        }

        /// Iterates over chunks of `size`, the last perhaps shorter.
        fn par_chunks<T>(&self, size: usize) -> Chunks<'_, T>
        where
            Self: AsRef<[T]>,
        {
            self.as_ref().chunks(size)
        }

        /// Iterates over chunks of `size`, the last perhaps shorter, which may be changed.
        fn par_chunks_mut<T>(&mut self, size: usize) -> ChunksMut<'_, T>
        where
            Self: AsMut<[T]>,
        {
            self.as_mut().chunks_mut(size)
        }

        /// Iterates over whole chunks of `size`, which may be changed.
        fn par_chunks_exact_mut<T>(&mut self, size: usize) -> ChunksExactMut<'_, T>
        where
            Self: AsMut<[T]>,
        {
            self.as_mut().chunks_exact_mut(size)
        }
    }

    impl<T: ?Sized> InOrder for T {}
}
