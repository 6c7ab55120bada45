//! What one thread works with on tile after tile: made once, as memory for paths is dear to get.
//!
//! In: a manifold and knots. Out: [`Scratch`]s, one for each thread ([`ScratchPool`]).

use super::{endings::EventLocator, lone::SinglePaths, strands::PathBatch};
use geofan_core::manifold::Manifold;
use std::sync::{Arc, Mutex, PoisonError};

/// What one thread works with.
pub struct Scratch<'m> {
    /// Finds how paths end.
    pub endings: EventLocator<'m>,
    /// Paths of a lattice.
    pub strands: PathBatch,
    /// Single paths.
    pub singles: PathBatch,
    /// What single paths meet.
    pub(super) lone: SinglePaths,
}

impl<'m> Scratch<'m> {
    /// For paths in `manifold` with these knots.
    pub fn new(manifold: &'m Manifold, knots: &Arc<[f64]>) -> Self {
        Self {
            endings: EventLocator::new(manifold),
            strands: PathBatch::new(knots.clone()),
            singles: PathBatch::new(knots.clone()),
            lone: SinglePaths::default(),
        }
    }
}

/// As many desks as threads work at once.
pub struct ScratchPool<'m> {
    manifold: &'m Manifold,
    knots: Arc<[f64]>,
    /// Those at which nobody works.
    free: Mutex<Vec<Scratch<'m>>>,
}

impl<'m> ScratchPool<'m> {
    /// For paths in `manifold` with these knots; none is made yet.
    pub fn new(manifold: &'m Manifold, knots: &Arc<[f64]>) -> Self {
        Self {
            manifold,
            knots: knots.clone(),
            free: Mutex::default(),
        }
    }

    /// Does `work` at a desk.
    pub fn with<T>(&self, work: impl FnOnce(&mut Scratch<'m>) -> T) -> T {
        // A desk whose work panicked has not been put back, so those that are free are whole.
        let free = || self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = free().pop();
        let mut desk = taken.unwrap_or_else(|| Scratch::new(self.manifold, &self.knots));
        let done = work(&mut desk);
        free().push(desk);
        done
    }
}
