//! What one thread works with on tile after tile: made once, as memory for paths is dear to get.
//!
//! In: a manifold and knots. Out: [`Desk`]s, one for each thread ([`Desks`]).

use super::{endings::EndingFinder, lone::Lone, strands::Strands};
use geofan_core::manifold::Manifold;
use std::sync::{Arc, Mutex, PoisonError};

/// What one thread works with.
pub struct Desk<'m> {
    /// Finds how paths end.
    pub endings: EndingFinder<'m>,
    /// Paths of a lattice.
    pub strands: Strands,
    /// Single paths.
    pub singles: Strands,
    /// What single paths meet.
    pub(super) lone: Lone,
}

impl<'m> Desk<'m> {
    /// For paths in `manifold` with these knots.
    pub fn new(manifold: &'m Manifold, knots: &Arc<[f64]>) -> Self {
        Self {
            endings: EndingFinder::new(manifold),
            strands: Strands::new(knots.clone()),
            singles: Strands::new(knots.clone()),
            lone: Lone::default(),
        }
    }
}

/// As many desks as threads work at once.
pub struct Desks<'m> {
    manifold: &'m Manifold,
    knots: Arc<[f64]>,
    /// Those at which nobody works.
    free: Mutex<Vec<Desk<'m>>>,
}

impl<'m> Desks<'m> {
    /// For paths in `manifold` with these knots; none is made yet.
    pub fn new(manifold: &'m Manifold, knots: &Arc<[f64]>) -> Self {
        Self {
            manifold,
            knots: knots.clone(),
            free: Mutex::default(),
        }
    }

    /// Does `work` at a desk.
    pub fn with<T>(&self, work: impl FnOnce(&mut Desk<'m>) -> T) -> T {
        // A desk whose work panicked has not been put back, so those that are free are whole.
        let free = || self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let taken = free().pop();
        let mut desk = taken.unwrap_or_else(|| Desk::new(self.manifold, &self.knots));
        let done = work(&mut desk);
        free().push(desk);
        done
    }
}
