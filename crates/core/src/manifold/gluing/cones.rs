//! Points at which a glued space would have a cone: those that an element of its group turns about.
//!
//! In: the faces under check. Out: a complaint about a face and a place. A map may fix points by itself, or the maps
//! round an edge turn about it together, so that cells close round it with a part of the full angle. Reflections fix
//! the points of their faces, and the edges between these: corners, where nothing is missing.

use super::{
    DeckTransformation, Gluing,
    domain_points::is_regular,
    gluing_checks::{FARTHEST_OUT, GluingChecks, is_identity_to},
};
use crate::{error::Result, manifold::probe::point, random::Stream};
use glam::{DMat3, DVec2, DVec3};

/// Rounds of Newton's method for fixed points, and for edges.
const ROUNDS: usize = 40;

/// Points of faces from which edges are looked for: some for each edge of a domain of a dozen faces.
const BORDERS: usize = 200;

/// Places looked at round an edge, and their distance from it as a share of the domain's size.
const PLACES_ROUND: usize = 64;
const BESIDE: f64 = 1e-3;

/// How far apart, as a share of the domain's size, two images of one point of an edge may be.
const SAME: f64 = 1e-6;

/// How far, as a share of the domain's size in the metric, a point is moved that counts as fixed.
const STAYING: f64 = 1e-4;

const HINT: &str =
    "space would have a cone there; only reflections may fix points, those of their own face";

impl GluingChecks<'_> {
    /// Checks that no map fixes a point of the domain, but a reflection those of its face.
    pub(super) fn fixed_points(&self) -> Result<()> {
        for (k, face) in self.gluing.faces.iter().enumerate() {
            let Some(deck) = face.deck().filter(|_| !face.is_portal()) else {
                continue;
            };
            for &start in self.points {
                let Some(u) = fixed_point(deck, start, self.gluing.size) else {
                    continue;
                };
                let values = self.gluing.values.at(&u.to_array());
                let least = self.gluing.faces.iter().zip(values);
                let least = least
                    .filter(|(face, _)| !face.is_portal())
                    .map(|(face, value)| value / (face.slope * self.gluing.size))
                    .fold(f64::INFINITY, f64::min);
                let margin = if is_reflection(deck, u) { 1e-4 } else { -1e-6 };
                if least > margin && is_regular(self.manifold, u) && self.stays(deck, u) {
                    let message = format!(
                        "its map fixes a point of the domain: {}",
                        point(self.manifold, u)
                    );
                    let complaint = self.complain(k, message);
                    return Err(complaint.with_hint(HINT).into());
                }
            }
        }
        Ok(())
    }

    /// Tells whether a map moves `u` by next to nothing in the metric: infinitely far out points stay in the chart alone.
    fn stays(&self, deck: &DeckTransformation, u: DVec3) -> bool {
        let length = |u: DVec3, w: DVec3| (self.manifold.standard_frame(u).inverse() * w).length();
        let size = DVec3::splat(self.gluing.size);
        // What is less than the rounding of coordinates nobody knows.
        let off = (deck.point(u) - u).abs() + u.abs() * f64::EPSILON;
        length(u, off) <= STAYING * length(self.gluing.inside, size)
    }

    /// Checks that round every edge space closes with the full angle, or is a corner between reflections.
    pub(super) fn edge_cones(&self, borders: &[(usize, DVec3)]) -> Result<()> {
        let mut random = Stream::new(&[0x636f_6e65]);
        let middle = self.gluing.inside;
        for (_, border) in borders.iter().take(BORDERS) {
            let u = middle + (*border - middle) * random.between(1.001, FARTHEST_OUT);
            let beyond = self.beyond(u);
            let [a, b, ..] = beyond[..] else { continue };
            let Some(edge) = self.edge_near(u, [a, b]) else {
                continue;
            };
            let cells = self.cells_round(edge, [a, b]);
            let Some(order) = order_of_turns(&cells, SAME * self.gluing.size) else {
                continue;
            };
            let message = format!(
                "space closes after {:.1} degrees round its edge with {}, at {}",
                360.0 / order as f64,
                Gluing::name(b),
                point(self.manifold, edge)
            );
            return Err(self.complain(a, message).with_hint(HINT).into());
        }
        Ok(())
    }

    /// Finds the point of the edge between two faces that is nearest to `u`, if they have one there that is on no
    /// third face.
    fn edge_near(&self, u: DVec3, pair: [usize; 2]) -> Option<DVec3> {
        let gluing = self.gluing;
        let mut at = u;
        for _ in 0..ROUNDS {
            let values = gluing.values.at(&at.to_array());
            let off = DVec2::from(pair.map(|k| values[k]));
            let [a, b] = pair.map(|k| gluing.gradient(k, at));
            // The shortest step that both faces ask for.
            let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
            let determinant = aa * bb - ab * ab;
            let x = (bb * off.x - ab * off.y) / determinant;
            let y = (aa * off.y - ab * off.x) / determinant;
            let step = a * x + b * y;
            if !(step.length() < 10.0 * gluing.size) {
                return None;
            }
            at -= step;
            if step.length() < 1e-13 * gluing.size {
                break;
            }
        }
        let values = gluing.values.at(&at.to_array());
        let clear = gluing.faces.iter().enumerate().all(|(k, face)| {
            let depth = values[k] / (face.slope * gluing.size);
            match pair.contains(&k) {
                true => depth.abs() < 1e-9,
                false => face.is_portal() || depth > 4.0 * BESIDE,
            }
        });
        (clear && is_regular(self.manifold, at)).then_some(at)
    }

    /// Brings a point of an edge into the domain from each cell round it: its images, and the differentials.
    fn cells_round(&self, edge: DVec3, pair: [usize; 2]) -> Vec<(DVec3, DMat3)> {
        let gluing = self.gluing;
        let [a, b] = pair.map(|k| gluing.gradient(k, edge));
        let first = a.normalize_or_zero();
        let second = b.reject_from_normalized(first).normalize_or_zero();
        let mut cells: Vec<(Vec<usize>, (DVec3, DMat3))> = Vec::new();
        for i in 0..PLACES_ROUND {
            let angle = std::f64::consts::TAU * (i as f64 + 0.5) / PLACES_ROUND as f64;
            let aside = first * angle.cos() + second * angle.sin();
            let Some((_, word)) = gluing.locate(edge + aside * (BESIDE * gluing.size)) else {
                continue;
            };
            if cells.iter().all(|(known, _)| *known != word) {
                cells.extend(gluing.way_in(&word).map(|deck| (word, deck.apply(edge))));
            }
        }
        cells.into_iter().map(|(_, image)| image).collect()
    }
}

/// By how much the trace of a reflection's differential may be off: a turn by a hundredth beside it changes it by that.
const OFF_TRACE: f64 = 1e-4;

/// Tells whether a map that fixes `u` is a reflection there, in a whole surface. A map that turns right into left has the
/// eigenvalues e^iα, e^−iα and −1 at a fixed point; a reflection has α = 0.
fn is_reflection(deck: &DeckTransformation, u: DVec3) -> bool {
    let (_, d) = deck.apply(u);
    let trace = d.x_axis.x + d.y_axis.y + d.z_axis.z;
    deck.reverses() && (trace - 1.0).abs() < OFF_TRACE
}

/// Counts the cells round an edge by which its point comes to lie at the same place, where that is more than one
/// and they are turned against each other, none reflected.
fn order_of_turns(cells: &[(DVec3, DMat3)], same: f64) -> Option<usize> {
    let (place, first) = cells.first()?;
    let here = cells.iter().filter(|(u, _)| (*u - *place).length() < same);
    let mut turns: Vec<DMat3> = Vec::new();
    for (_, d) in here {
        let turn = first.inverse() * *d;
        let known = |known: &DMat3| is_identity_to(known.inverse() * turn, 1e-4);
        if !turns.iter().any(known) {
            turns.push(turn);
        }
    }
    let reflected = turns.iter().any(|turn| turn.determinant() < 0.0);
    (turns.len() > 1 && !reflected).then_some(turns.len())
}

/// Finds a fixed point near `start` by Newton's method, with the least steps where fixed points form lines.
fn fixed_point(deck: &DeckTransformation, start: DVec3, size: f64) -> Option<DVec3> {
    let mut u = start;
    for _ in 0..ROUNDS {
        let (image, d) = deck.apply(u);
        let off = image - u;
        if off.length() <= 1e-12 * size {
            return Some(u);
        }
        let a = d - DMat3::IDENTITY;
        let normal = a.transpose() * a;
        let scale = normal.x_axis.x + normal.y_axis.y + normal.z_axis.z;
        let damped = normal + DMat3::from_diagonal(DVec3::splat(1e-9 * scale));
        let step = damped.inverse() * (a.transpose() * off);
        if !step.is_finite() || step.length() > 100.0 * size {
            return None;
        }
        u -= step;
    }
    let off = deck.point(u) - u;
    (off.length() <= 1e-7 * size).then_some(u)
}
