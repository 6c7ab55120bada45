//! The copy of the domain that a path through the covering chart has come to.
//!
//! In: the points of a path in the covering chart, in order. Out: the deck transformation that brings the path
//! back into the domain there, and the faces that it has crossed.

use super::{DeckTransformation, GUARD, Gluing, MOST_MAPS};
use geofan_expr::Registers;
use glam::{DMat3, DVec3};

/// Follows a path of the covering chart through the copies of the domain.
#[derive(Debug, Clone)]
pub struct Development<'g> {
    gluing: &'g Gluing,
    deck: DeckTransformation,
    crossed: Vec<usize>,
    registers: Registers<f64, 1>,
}

impl<'g> Development<'g> {
    /// Begins in the domain itself; `None` where all faces are mirrors.
    pub fn new(gluing: &'g Gluing) -> Option<Self> {
        Some(Self {
            gluing,
            deck: gluing.identity()?,
            crossed: Vec::new(),
            registers: gluing.values.registers(),
        })
    }

    /// Moves on to the point `u` of the covering chart. Returns its image in the domain and the differential there;
    /// `None` where the path cannot be brought back.
    pub fn advance(&mut self, u: DVec3) -> Option<(DVec3, DMat3)> {
        for _ in 0..MOST_MAPS {
            let (image, d) = self.deck.apply(u);
            let Some(k) = self.violated(image) else {
                return image.is_finite().then_some((image, d));
            };
            self.deck = self.deck.then(self.gluing.faces[k].deck()?);
            self.crossed.push(k);
        }
        None
    }

    /// Does [`Gluing::violated`] in registers of its own.
    fn violated(&mut self, u: DVec3) -> Option<usize> {
        self.gluing
            .values
            .run_at(&mut self.registers, &u.to_array());
        let mut deepest = (GUARD * self.gluing.size, None);
        for (k, face) in self.gluing.faces.iter().enumerate() {
            let depth = -self.registers.output(k)[0] / face.slope;
            if !face.is_portal() && depth > deepest.0 {
                deepest = (depth, Some(k));
            }
        }
        deepest.1
    }

    /// Lists the bounding faces with maps that are within `reach` of the point `u` of the domain, in the chart.
    pub fn within(&mut self, u: DVec3, reach: f64) -> Vec<usize> {
        self.gluing
            .values
            .run_at(&mut self.registers, &u.to_array());
        let near = |k: &usize| {
            let face = &self.gluing.faces[*k];
            let bounds = !face.is_portal() && !face.is_mirror();
            bounds && self.registers.output(*k)[0] < reach * face.slope
        };
        (0..self.gluing.faces.len()).filter(near).collect()
    }

    /// Returns the gluing.
    pub fn gluing(&self) -> &'g Gluing {
        self.gluing
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
