//! Loops over many pieces of work: by all threads with the feature `parallel`, else one after the other.
//!
//! Without the feature the names of `rayon` that this project uses stand for plain iterators, so that loops are
//! written once, and what a browser runs brings no threads along.

#[cfg(feature = "parallel")]
pub use rayon::{
    Scope as TaskScope, current_num_threads as threads, in_place_scope as scope, join, prelude::*,
};

#[cfg(not(feature = "parallel"))]
pub use sequential::*;

#[cfg(not(feature = "parallel"))]
mod sequential {
    use std::{
        marker::PhantomData,
        slice::{Chunks, ChunksExactMut, ChunksMut, Iter, IterMut},
    };

    /// Does `a`, then `b`.
    pub fn join<A, B>(a: impl FnOnce() -> A, b: impl FnOnce() -> B) -> (A, B) {
        (a(), b())
    }

    /// Does work that hands pieces of it to a [`TaskScope`], and returns when all are done.
    pub fn scope<'s, T>(work: impl FnOnce(&TaskScope<'s>) -> T) -> T {
        work(&TaskScope(PhantomData))
    }

    /// Takes pieces of work.
    pub struct TaskScope<'s>(PhantomData<&'s ()>);

    impl<'s> TaskScope<'s> {
        /// Does a piece of work.
        pub fn spawn(&self, piece: impl FnOnce(&Self) + 's) {
            piece(self);
        }
    }

    /// Returns how many threads work.
    pub fn threads() -> usize {
        1
    }

    /// Gives the methods that begin a parallel iteration to everything that can be iterated over.
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

        /// Sorts; equal items may change places.
        fn par_sort_unstable<T: Ord>(&mut self)
        where
            Self: AsMut<[T]>,
        {
            self.as_mut().sort_unstable();
        }
    }

    impl<T: ?Sized> InOrder for T {}

    /// Gives iterators the methods of parallel ones that they lack.
    pub trait OneByOne: Iterator + Sized {
        /// Leaves the iterator as it is.
        fn par_bridge(self) -> Self {
            self
        }

        /// Maps items with what `init` makes for each thread.
        fn map_init<T, R>(
            self,
            init: impl FnOnce() -> T,
            mut map: impl FnMut(&mut T, Self::Item) -> R,
        ) -> impl Iterator<Item = R> {
            let mut own = init();
            self.map(move |item| map(&mut own, item))
        }

        /// Works on items with what `init` makes for each thread.
        fn for_each_init<T>(
            self,
            init: impl FnOnce() -> T,
            mut work: impl FnMut(&mut T, Self::Item),
        ) {
            let mut own = init();
            self.for_each(|item| work(&mut own, item));
        }

        /// Maps each item to many.
        fn flat_map_iter<I: IntoIterator>(
            self,
            map: impl FnMut(Self::Item) -> I,
        ) -> impl Iterator<Item = I::Item> {
            self.flat_map(map)
        }
    }

    impl<I: Iterator> OneByOne for I {}
}
