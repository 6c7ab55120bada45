//! Points of faces that are there only where they are open.
//!
//! In: the faces under check. Out: points where each is open, at which its map is checked like those of others; and the size
//! of a space that no other face bounds.

use super::{
    Gluing,
    domain_points::is_regular,
    gluing_checks::{GluingChecks, WORST_IMAGE},
};
use crate::random::Stream;
use glam::DVec3;

/// Starts of the search for a portal, and the steps of one.
const STARTS: usize = 48;
const STEPS: usize = 40;

/// Points between two of those found that are looked at.
const BETWEEN: usize = 96;

/// Sizes of the boxes in which searches start, as shares of the domain's.
const START_SIZES: [f64; 4] = [1.0, 0.1, 10.0, 100.0];

/// Share of the domain's size by which values of an opening are compared for its slope.
const STEP: f64 = 1e-5;

impl Gluing {
    /// Takes the size from `openings`, points of them with their faces, where no face bounds the domain: the largest opening's.
    pub(super) fn measure_openings(&mut self, openings: &[(usize, DVec3)]) {
        if openings.is_empty() || self.faces.iter().any(|face| !face.is_portal()) {
            return;
        }
        let size = |k: usize| {
            let own = || openings.iter().filter(|(j, _)| *j == k).map(|(_, u)| *u);
            let first = own().next()?;
            Some(own().map(|u| (u - first).length()).fold(0.0, f64::max))
        };
        let sizes = (0..self.faces.len()).filter_map(size);
        let largest = sizes.fold(0.0, f64::max);
        if largest > 0.0 {
            self.size = self.size.min(largest);
        }
    }
}

impl GluingChecks<'_> {
    /// Finds points of the faces with openings where these are open, each with its face; none of an opening that no search
    /// comes to.
    pub(super) fn portal_points(&self) -> Vec<(usize, DVec3)> {
        let faces = self.gluing.faces.iter().enumerate();
        let portals = faces.filter(|(_, face)| face.is_portal());
        portals
            .flat_map(|(k, _)| self.open_points(k).into_iter().map(move |u| (k, u)))
            .collect()
    }

    /// Finds points where face `k` is open: where searches from around the domain come to, and between two of these.
    fn open_points(&self, k: usize) -> Vec<DVec3> {
        let mut random = Stream::new(&[0x706f_7274_616c]);
        let mut found: Vec<DVec3> = Vec::new();
        for size in START_SIZES.map(|size| size * self.gluing.size) {
            let from = |_| self.gluing.inside + random.direction() * (size * random.uniform());
            let starts: Vec<DVec3> = (0..STARTS).map(from).collect();
            found.extend(starts.into_iter().filter_map(|u| self.reach_opening(k, u)));
        }
        if found.is_empty() {
            return found;
        }
        let mut any = || found[(random.uniform() * found.len() as f64) as usize];
        let pairs: Vec<[DVec3; 2]> = (0..BETWEEN).map(|_| [any(), any()]).collect();
        let between = pairs.into_iter().map(|[a, b]| a.lerp(b, random.uniform()));
        let between: Vec<DVec3> = between.collect();
        found.extend(between.into_iter().filter_map(|u| self.reach_opening(k, u)));
        found
    }

    /// Looks from `u` for a point of face `k` where it is open, by Newton's steps for both functions by turns.
    fn reach_opening(&self, k: usize, mut u: DVec3) -> Option<DVec3> {
        let gluing = self.gluing;
        let opening = gluing.faces[k].opening?;
        let open = |u: DVec3| gluing.openings.at(&u.to_array())[opening];
        let value = |u: DVec3| gluing.values.at(&u.to_array())[k];
        for _ in 0..STEPS {
            let slope = gluing.gradient(k, u);
            u -= slope * (value(u) / slope.length_squared());
            let here = open(u);
            if !here.is_finite() {
                return None;
            }
            if here > 0.0 {
                let on_face = value(u).abs() <= WORST_IMAGE * gluing.faces[k].slope * gluing.size;
                if on_face {
                    return is_regular(self.manifold, u).then_some(u);
                }
                continue;
            }
            let step = STEP * gluing.size;
            let rates = DVec3::AXES
                .map(|axis| (open(u + axis * step) - open(u - axis * step)) / (2.0 * step));
            let rates = DVec3::from_array(rates);
            // A little farther than to its edge.
            u -= rates * (1.1 * here / rates.length_squared());
        }
        None
    }
}
