//! The copy of the domain that a path through the covering chart has come to.
//!
//! In: the points of a path in the covering chart, in order. Out: the deck transformation that brings the path
//! back into the domain there, and the faces that it has crossed.

use super::{DeckTransformation, Gluing, MOST_MAPS};
use glam::{DMat3, DVec3};

/// Follows a path of the covering chart through the copies of the domain.
#[derive(Debug, Clone)]
pub struct Development<'g> {
    gluing: &'g Gluing,
    deck: DeckTransformation,
    crossed: Vec<usize>,
}

impl<'g> Development<'g> {
    /// Begins in the domain itself; `None` where all faces are mirrors.
    pub fn new(gluing: &'g Gluing) -> Option<Self> {
        Some(Self {
            gluing,
            deck: gluing.identity()?,
            crossed: Vec::new(),
        })
    }

    /// Moves on to the point `u` of the covering chart. Returns its image in the domain and the differential there;
    /// `None` where the path cannot be brought back.
    pub fn advance(&mut self, u: DVec3) -> Option<(DVec3, DMat3)> {
        for _ in 0..MOST_MAPS {
            let (image, d) = self.deck.apply(u);
            let Some(k) = self.gluing.violated(image) else {
                return image.is_finite().then_some((image, d));
            };
            self.deck = self.deck.then(self.gluing.faces[k].deck()?);
            self.crossed.push(k);
        }
        None
    }

    /// Returns the transformation from the covering chart to the domain.
    pub fn deck(&self) -> &DeckTransformation {
        &self.deck
    }

    /// Returns the faces crossed, first to last.
    pub fn crossed(&self) -> &[usize] {
        &self.crossed
    }
}
