//! Copies of a glued domain in the covering chart: those nearest to it, and the one that a path has come to.
//!
//! In: the faces and their maps. Out: [`NearestCopies`], with the distance up to which they are all there are. Cells
//! that meet a ball hang together by faces; so those found by going on from the nearest again and again are all
//! that meet it, once every other that is known of lies beyond.
//!
//! In: the points of a path in the covering chart, in order. Out: the deck transformation that brings the path
//! back into the domain there, and the faces that it has crossed ([`Development`]).

use super::{DeckTransformation, Gluing, KnownPlaces, MOST_MAPS};
use geofan_expr::{Registers, Tape};
use glam::{DMat3, DVec3};
use std::{cmp::Reverse, collections::BinaryHeap, sync::Arc};

/// Most copies that are looked for, nearest first.
const MOST: usize = 2000;

/// Share of the domain's size to which distances are rounded, down.
const UNIT: f64 = 1e-6;

/// Factor by which the domain is taken for wider than the directions in which its ends are looked for show.
const WIDER: f64 = 1.3;

/// How far out the end of a domain is looked for, in its sizes.
const FARTHEST_FACE: f64 = 1e3;

/// Halvings by which an end is found.
const HALVINGS: usize = 20;

/// A copy of the domain.
#[derive(Debug, Clone)]
pub struct NearCopy {
    /// From the domain to the copy.
    pub deck: DeckTransformation,
    /// From the copy to the domain.
    pub back: DeckTransformation,
    /// All that is nearer to the middle lies in the copies before this one; in units of [`UNIT`].
    before: i64,
}

/// The nearest copies of a glued domain, first the domain itself.
#[derive(Debug, Clone)]
pub struct NearestCopies {
    copies: Vec<NearCopy>,
    /// The middle of the domain in the chart.
    middle: DVec3,
    /// The distance from it up to which these are all; infinite for a finite group.
    reach: f64,
    unit: f64,
}

impl NearestCopies {
    /// Returns the first so many copies, and the distance from the middle up to which they are all there are.
    pub fn first(&self, most: usize) -> (&[NearCopy], f64) {
        match self.copies.get(most) {
            Some(next) => (&self.copies[..most], next.before as f64 * self.unit),
            None => (&self.copies, self.reach),
        }
    }

    /// Returns the middle of the domain in the chart.
    pub fn middle(&self) -> DVec3 {
        self.middle
    }

    /// Looks for the copies of a domain.
    fn of(gluing: &Gluing) -> Self {
        let (middle, radius) = gluing.extent();
        let unit = UNIT * gluing.size;
        let mut nearest = Self {
            copies: Vec::new(),
            middle,
            reach: f64::INFINITY,
            unit,
        };
        if !radius.is_finite() {
            nearest.reach = 0.0;
            return nearest;
        }
        let identity = gluing.identity();
        let mut known = KnownPlaces::about(gluing);
        known.add(gluing.inside);
        let mut found = vec![(identity.clone(), identity)];
        // By the least distance that a point of the copy may have.
        let mut open = BinaryHeap::from([Reverse((i64::MIN, 0))]);
        while let Some(Reverse((before, number))) = open.pop() {
            if nearest.copies.len() == MOST {
                nearest.reach = before as f64 * unit;
                break;
            }
            let (deck, back): (DeckTransformation, DeckTransformation) = found[number].clone();
            for (next, back) in gluing.neighbours(&deck, &back) {
                let place = next.point(gluing.inside);
                if place.is_finite() && known.add(place) {
                    let (there, d) = next.apply(middle);
                    let distance = (there - middle).length() - next.stretch(d) * radius;
                    open.push(Reverse(((distance / unit).floor() as i64, found.len())));
                    found.push((next, back));
                }
            }
            nearest.copies.push(NearCopy { deck, back, before });
        }
        nearest
    }
}

impl Gluing {
    /// Returns the copies of the domain that are nearest to it in the chart.
    pub fn nearest_copies(&self) -> &NearestCopies {
        self.nearest
            .get_or_init(|| Arc::new(NearestCopies::of(self)))
    }

    /// Lists the copies behind the faces of a copy, each with the way from it and back.
    fn neighbours(
        &self,
        deck: &DeckTransformation,
        back: &DeckTransformation,
    ) -> Vec<(DeckTransformation, DeckTransformation)> {
        let bounding = self.faces.iter().filter(|face| !face.is_portal());
        let neighbour = |face: &super::GluedFace| {
            let undo = self.faces[face.partner?].deck()?;
            Some((face.deck()?.then(deck), back.then(undo)))
        };
        bounding.filter_map(neighbour).collect()
    }

    /// Returns the middle of the domain and about how far it reaches from there: infinite where faces do not bound
    /// it.
    fn extent(&self) -> (DVec3, f64) {
        let ends: Vec<DVec3> = (0..27)
            .map(|code| [code % 3, code / 3 % 3, code / 9].map(|k| f64::from(k) - 1.0))
            .map(DVec3::from_array)
            .filter(|direction| *direction != DVec3::ZERO)
            .map(|direction| self.end_along(direction.normalize()))
            .collect();
        let (low, high) = ends.iter().fold((self.inside, self.inside), |(a, b), end| {
            (a.min(*end), b.max(*end))
        });
        let middle = 0.5 * (low + high);
        let far = ends.iter().map(|end| (*end - middle).length());
        (middle, WIDER * far.fold(0.0, f64::max))
    }

    /// Finds where the domain ends in a direction from its point inside; infinitely far if nowhere.
    fn end_along(&self, direction: DVec3) -> DVec3 {
        let at = |t: f64| self.inside + direction * (t * self.size);
        let (mut low, mut high) = (0.0, 1.0);
        while self.violated(at(high)).is_none() {
            (low, high) = (high, 2.0 * high);
            if high > FARTHEST_FACE {
                return DVec3::INFINITY;
            }
        }
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            (low, high) = match self.violated(at(middle)) {
                Some(_) => (low, middle),
                None => (middle, high),
            };
        }
        at(high)
    }
}

/// Follows a path of the covering chart through the copies of the domain.
#[derive(Debug, Clone)]
pub struct Development<'g> {
    gluing: &'g Gluing,
    deck: DeckTransformation,
    crossed: Vec<usize>,
    /// Of the tapes of the faces' values and of their gradients, where these are needed.
    values: Option<Registers<f64, 1>>,
    gradients: Option<Registers<f64, 1>>,
}

impl<'g> Development<'g> {
    /// Begins in the domain itself.
    pub fn new(gluing: &'g Gluing) -> Self {
        Self {
            gluing,
            deck: gluing.identity(),
            crossed: Vec::new(),
            values: None,
            gradients: None,
        }
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
                let values = run(&gluing.values, &mut self.values, u);
                gluing.deepest(|k| values.output(k)[0])
            }
        }
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
        self.compare(u, |deck, value, gradient| {
            if value < reach(gradient) {
                show(deck);
            }
        });
    }

    /// Finds the map of the bounding face that `u` lies farthest beyond, as multiples of what `reach` says of its gradient
    /// there; `None` where that is less than once.
    pub fn beyond(
        &mut self,
        u: DVec3,
        reach: impl Fn(DVec3) -> f64,
    ) -> Option<&'g DeckTransformation> {
        let mut farthest = (-1.0, None);
        self.compare(u, |deck, value, gradient| {
            let depth = value / reach(gradient);
            if depth < farthest.0 {
                farthest = (depth, Some(deck));
            }
        });
        farthest.1
    }

    /// Shows the maps of the bounding faces that have one, with the faces' values and gradients at `u`.
    #[inline]
    fn compare(&mut self, u: DVec3, mut show: impl FnMut(&'g DeckTransformation, f64, DVec3)) {
        let gluing = self.gluing;
        let mut show = |k: usize, value: f64, gradient: DVec3| {
            let face = &gluing.faces[k];
            if !face.is_portal()
                && let Some(deck) = face.deck()
            {
                show(deck, value, gradient);
            }
        };
        let faces = 0..gluing.faces.len();
        match &gluing.spheres {
            Some(spheres) => {
                faces.for_each(|k| show(k, spheres.value(k, u), spheres.gradient(k, u)));
            }
            None => {
                let values = run(&gluing.values, &mut self.values, u);
                let gradients = run(&gluing.gradients, &mut self.gradients, u);
                let gradient = |k: usize| [0, 1, 2].map(|i| gradients.output(3 * k + i)[0]);
                faces.for_each(|k| show(k, values.output(k)[0], gradient(k).into()));
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

/// Runs a tape at a point, in registers that are made when they are first needed.
fn run<'r>(
    tape: &Tape,
    registers: &'r mut Option<Registers<f64, 1>>,
    u: DVec3,
) -> &'r Registers<f64, 1> {
    let registers = registers.get_or_insert_with(|| tape.registers());
    tape.run_at(registers, &u.to_array());
    registers
}
