//! What one thread works with on tile after tile: made once, as memory for paths is dear to get.
//!
//! In: a manifold and knots. Out: [`Desk`].

use super::{endings::EndingFinder, lone::Lone, strands::Strands};
use crate::manifold::Manifold;
use std::sync::Arc;

/// What one thread works with.
pub struct Desk<'m> {
    /// Finds how paths end.
    pub endings: EndingFinder<'m>,
    /// Paths of a lattice.
    pub strands: Strands,
    /// Single paths.
    pub(super) singles: Strands,
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
