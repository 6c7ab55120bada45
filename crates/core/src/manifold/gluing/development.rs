//! The copy of the domain that a path through the covering chart has come to.
//!
//! In: the points of a path in the covering chart, in order. Out: the deck transformation that brings the path
//! back into the domain there, and the faces that it has crossed.

use super::{DeckTransformation, Gluing, MOST_MAPS};
use geofan_expr::Registers;
use glam::{DMat3, DVec3};

/// Follows a path of the covering chart through the copies of the domain.
#[derive(Debug, Clone)]
pub struct Development<'g> {
    gluing: &'g Gluing,
    deck: DeckTransformation,
    crossed: Vec<usize>,
    /// Of the faces' tape, where it is needed.
    registers: Option<Registers<f64, 1>>,
}

impl<'g> Development<'g> {
    /// Begins in the domain itself; `None` where all faces are mirrors.
    pub fn new(gluing: &'g Gluing) -> Option<Self> {
        Some(Self {
            gluing,
            deck: gluing.identity()?,
            crossed: Vec::new(),
            registers: None,
        })
    }

    /// Moves on to the point `u` of the covering chart. Returns its image in the domain and the differential there;
    /// `None` where the path cannot be brought back.
    pub fn advance(&mut self, u: DVec3) -> Option<(DVec3, DMat3)> {
        for _ in 0..MOST_MAPS {
            let image = self.deck.point(u);
            let Some(k) = self.violated(image) else {
                return image.is_finite().then(|| self.deck.apply(u));
            };
            self.deck = self.deck.then(self.gluing.faces[k].deck()?);
            self.crossed.push(k);
        }
        None
    }

    /// Does [`Gluing::violated`] in registers of its own.
    fn violated(&mut self, u: DVec3) -> Option<usize> {
        let gluing = self.gluing;
        match &gluing.spheres {
            Some(spheres) => gluing.deepest(|k| spheres.value(k, u)),
            None => {
                let values = self.values(u);
                gluing.deepest(|k| values.output(k)[0])
            }
        }
    }

    /// Runs the tape of the faces.
    fn values(&mut self, u: DVec3) -> &Registers<f64, 1> {
        let values = &self.gluing.values;
        let registers = self.registers.get_or_insert_with(|| values.registers());
        values.run_at(registers, &u.to_array());
        registers
    }

    /// Shows the bounding faces with maps whose value at the point `u` of the domain is less than what `reach` says of
    /// their gradient there.
    #[inline]
    pub fn within(
        &mut self,
        u: DVec3,
        reach: impl Fn(DVec3) -> f64,
        mut show: impl FnMut(&'g DeckTransformation),
    ) {
        let gluing = self.gluing;
        let mut compare = |k: usize, value: f64, gradient: DVec3| {
            let face = &gluing.faces[k];
            if value < reach(gradient)
                && !face.is_portal()
                && let Some(deck) = face.deck()
            {
                show(deck);
            }
        };
        let faces = 0..gluing.faces.len();
        match &gluing.spheres {
            Some(spheres) => {
                faces.for_each(|k| compare(k, spheres.value(k, u), spheres.gradient(k, u)));
            }
            None => {
                let values = self.values(u);
                faces.for_each(|k| compare(k, values.output(k)[0], gluing.gradient(k, u)));
            }
        }
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
