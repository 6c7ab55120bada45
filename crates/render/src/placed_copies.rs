//! The copies of a scene near the domain of a glued space, placed in the covering chart.
//!
//! In: the parts of a scene, and the deck transformations to the nearest copies of the domain. Out:
//! [`PlacedCopies`], a tree of boxes around the images of those parts: what is beside all of them is ruled out as
//! quickly as where nothing is glued, without knowing which copy of the domain it is in.

use super::{
    accel::{Accelerator, BoxTree},
    copies::Bounds,
    lanes::{BoxPacket, LANES, Mask, more},
};
use geofan_core::manifold::{DeckTransformation, Gluing};
use glam::DVec3;
use std::collections::HashSet;

/// Most copies that are placed: of a space of infinitely many the nearest.
const MOST_COPIES: usize = 4000;

/// About how many boxes are made, and the most for one copy. Frames of Poincaré's space take as long with four times as
/// many, which take ten milliseconds to make.
const BOXES: usize = 16_000;
const MOST_PARTS: usize = 16;

/// Share of the domain's size within which two images of one point are the same. Where rounding takes them for two, a
/// copy is looked at twice.
const SAME_PLACE: f64 = 1e-6;

/// Share of an image's extent by which a box's image may depart from that of the differential at its middle: it is
/// divided beyond, so often at most.
const BENT: f64 = 0.25;
const DIVISIONS: usize = 2;

/// The nearest copies of a scene.
#[derive(Clone)]
pub struct PlacedCopies {
    /// From the covering chart to the scene, one for each copy.
    decks: Vec<DeckTransformation>,
    /// Parts of the scene, each with the number of the copy that it is in.
    tree: BoxTree<(u32, Bounds)>,
    /// The copies of which a part reaches through the chart's infinity.
    endless: Vec<u32>,
    /// All copies are placed of which anything is this near to the domain's middle.
    middle: DVec3,
    reach: f64,
}

impl PlacedCopies {
    /// Places the scene's parts, which lie in `cells`: copies of the domain, each by the ways there and back. `None`
    /// where nothing is certain to be all there is.
    pub fn of(
        gluing: &Gluing,
        cells: &[[DeckTransformation; 2]],
        scene: &Accelerator,
    ) -> Option<Self> {
        let nearest = gluing.nearest_copies();
        let (copies, reach) = nearest.first(MOST_COPIES / cells.len());
        if !(reach > 0.0) {
            return None;
        }
        let same = SAME_PLACE * gluing.size();
        let mut ways: Vec<(DeckTransformation, DeckTransformation)> = Vec::new();
        let mut places: HashSet<[i64; 3]> = HashSet::new();
        for (cell, copy) in cells
            .iter()
            .flat_map(|cell| copies.iter().map(move |copy| (cell, copy)))
        {
            // What lies in the cell, as it is in the copy, and the way from there.
            let [into, out] = cell;
            let there = out.then(&copy.deck);
            let place = there.point(gluing.inside()) / same;
            if cells.len() == 1 || places.insert(place.to_array().map(|x| x.round() as i64)) {
                ways.push((there, copy.back.then(into)));
            }
        }
        let parts = scene.parts((BOXES / ways.len()).clamp(1, MOST_PARTS));
        let (mut placed, mut endless) = (Vec::new(), Vec::new());
        for (copy, (there, _)) in (0..).zip(&ways) {
            let image = |part: &Bounds| image_of_box(there, *part, DIVISIONS);
            let images: Option<Vec<Bounds>> = parts.iter().map(image).collect();
            match images {
                Some(images) => placed.extend(images.into_iter().map(|part| (copy, part))),
                None => endless.push(copy),
            }
        }
        Some(Self {
            decks: ways.into_iter().map(|(_, back)| back).collect(),
            tree: BoxTree::build(&placed, |(_, part)| *part),
            endless,
            middle: nearest.middle(),
            reach,
        })
    }

    /// Returns the number of copies.
    pub fn count(&self) -> usize {
        self.decks.len()
    }

    /// Returns the transformation from a copy to the scene.
    pub fn deck(&self, copy: u32) -> &DeckTransformation {
        &self.decks[copy as usize]
    }

    /// Tells whether everything in a box is known.
    pub fn knows(&self, (low, high): Bounds) -> bool {
        let far = (low - self.middle).abs().max((high - self.middle).abs());
        far.length() <= self.reach
    }

    /// Tells whether a box may meet anything, or not everything in it is known.
    pub fn may_meet(&self, (low, high): Bounds) -> bool {
        !self.endless.is_empty() || !self.knows((low, high)) || self.tree.touches(low, high)
    }

    /// Puts into `copies`, emptied first, the copies that the box may meet, ascending.
    pub fn near(&self, (low, high): Bounds, copies: &mut Vec<u32>) {
        copies.clear();
        copies.extend(&self.endless);
        self.tree.visit(low, high, |(copy, part)| {
            let meets = part.0.cmple(high).all() && low.cmple(part.1).all();
            if meets && !copies.contains(copy) {
                copies.push(*copy);
            }
        });
        copies.sort_unstable();
    }

    /// Marks which of sixteen boxes may meet anything; those of which not everything is known are marked.
    #[inline(always)]
    pub fn touched(&self, boxes: &BoxPacket) -> Mask {
        if !self.endless.is_empty() {
            return [true; LANES];
        }
        let mut touched = self.tree.touched(boxes);
        if self.reach < f64::INFINITY {
            let far = self.squared_distances(boxes);
            let reach = (self.reach * self.reach) as f32;
            for l in 0..LANES {
                touched[l] |= !(far[l] < reach);
            }
        }
        touched
    }

    /// Returns the squares of the largest distances of points of boxes from the domain's middle.
    #[inline(always)]
    fn squared_distances(&self, boxes: &BoxPacket) -> [f32; LANES] {
        let mut squared = [0.0; LANES];
        for c in 0..3 {
            let middle = self.middle[c] as f32;
            for l in 0..LANES {
                let far = more(boxes.high[c][l] - middle, middle - boxes.low[c][l]);
                squared[l] += far * far;
            }
        }
        squared
    }
}

/// Returns a box around the image of a box; `None` where that reaches through the chart's infinity.
fn image_of_box(
    deck: &DeckTransformation,
    (low, high): Bounds,
    divisions: usize,
) -> Option<Bounds> {
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    let (centre, d) = deck.apply(middle);
    let (mut bounds, mut bent) = ((centre, centre), 0.0_f64);
    // Corners and the middles of faces.
    for code in 0..27 {
        let t = [code % 3, code / 3 % 3, code / 9].map(|k| f64::from(k) - 1.0);
        let step = DVec3::from_array(t) * half;
        if t.iter().filter(|x| **x == 0.0).count() % 2 == 1 {
            continue;
        }
        let image = deck.point(middle + step);
        bounds = (bounds.0.min(image), bounds.1.max(image));
        let off = (image - centre - d * step).abs().max_element();
        bent = bent.max(if image.is_finite() {
            off
        } else {
            f64::INFINITY
        });
    }
    let extent = (bounds.1 - bounds.0).max_element();
    if bent <= BENT * extent {
        // Between places that are looked at the image leaves their box by less than at them.
        let margin = DVec3::splat(0.5 * bent);
        return Some((bounds.0 - margin, bounds.1 + margin));
    }
    let divisions = divisions.checked_sub(1)?;
    let mut around: Option<Bounds> = None;
    for octant in 0..8 {
        let upper = [1, 2, 4].map(|bit| f64::from(u8::from(octant & bit != 0)));
        let from = low + half * DVec3::from_array(upper);
        let (a, b) = image_of_box(deck, (from, from + half), divisions)?;
        around = Some(around.map_or((a, b), |(low, high)| (low.min(a), high.max(b))));
    }
    around
}
