//! The copies of a scene that paths through a glued space meet.
//!
//! In: a box around a part of a path, in the covering chart or in the domain. Out: [`SceneCopy`]s, the deck
//! transformations that bring that part to where the scene's triangles are. A path of the cover is brought back
//! into the domain; where it may cross a face, into all cells that it may come to; and where parts of objects
//! stick out of the domain, on to where these are.

use super::curve::Cubic;
use geofan_core::manifold::{DeckTransformation, Development, Gluing, Manifold};
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// Most cells that one box is brought to: more means that it is as large as the space.
const MOST_CELLS: usize = 256;

/// Most transformations for what sticks out of the domain.
const MOST_BESIDE: usize = 512;

/// Factor by which images of boxes are widened for the bend of their maps.
const BEND: f64 = 1.3;

/// Share of the domain's size up to which a cubic is carried whole: beyond, it is cut.
const WHOLE: f64 = 0.5;

/// Most parts of a cubic.
const MOST_PARTS: f64 = 64.0;

/// Places along each edge of a triangle that tell which cells it is in.
const EDGE_PLACES: usize = 4;

/// Finds the copies of a scene.
#[derive(Debug, Clone)]
pub struct SceneCopies {
    manifold: Arc<Manifold>,
    /// From the domain to the cells in which parts of the scene lie, first to the domain itself.
    cells: Vec<SceneCell>,
}

/// A copy of the domain in which a part of the scene lies.
#[derive(Debug, Clone)]
struct SceneCell {
    deck: DeckTransformation,
    /// The image of the domain's point inside.
    place: DVec3,
    /// The box around that part.
    bounds: (DVec3, DVec3),
}

/// A transformation that brings a part of a path to the scene.
#[derive(Debug, Clone)]
pub struct SceneCopy {
    deck: DeckTransformation,
    /// The image of the part's middle, and the differential there.
    point: DVec3,
    differential: DMat3,
}

/// The box around nothing.
const NOWHERE: (DVec3, DVec3) = (DVec3::INFINITY, DVec3::NEG_INFINITY);

impl SceneCopies {
    /// Prepares the copies of these triangles; `None` if nothing is glued.
    pub fn of(manifold: &Arc<Manifold>, triangles: &[[DVec3; 3]]) -> Option<Self> {
        let gluing = manifold.gluing()?;
        let mut cells = vec![SceneCell {
            deck: gluing.identity()?,
            place: gluing.inside(),
            bounds: NOWHERE,
        }];
        for triangle in triangles {
            let [a, b, c] = *triangle;
            for u in places(triangle) {
                let Some((_, word)) = gluing.locate(u) else {
                    continue;
                };
                let deck = match word.is_empty() {
                    true => Some(cells[0].deck.clone()),
                    false => gluing.way_back(&word),
                };
                let Some(deck) = deck else { continue };
                let place = deck.point(gluing.inside());
                let known = cells
                    .iter()
                    .position(|cell| near(gluing, cell.place, place));
                let number = known.unwrap_or(cells.len());
                if known.is_none() && cells.len() < MOST_BESIDE {
                    cells.push(SceneCell {
                        deck,
                        place,
                        bounds: NOWHERE,
                    });
                }
                if let Some(SceneCell { bounds, .. }) = cells.get_mut(number) {
                    *bounds = (bounds.0.min(a.min(b).min(c)), bounds.1.max(a.max(b).max(c)));
                }
            }
        }
        Some(Self {
            manifold: manifold.clone(),
            cells,
        })
    }

    /// Tells whether pictures must be of paths that are integrated one by one: which way they go on at portals and
    /// mirrors, and where they leave, paths of the cover do not tell.
    pub fn need_exact_paths(&self) -> bool {
        let gluing = self.manifold.gluing();
        self.manifold.domain.has_exits()
            || gluing.is_some_and(|gluing| gluing.has_portals() || gluing.has_mirrors())
    }

    /// Begins a search in the domain itself; it is quickest for places next to each other.
    pub fn search(&self) -> Option<Development<'_>> {
        self.manifold.gluing().and_then(Development::new)
    }

    /// Finds the transformations that bring what is in the box about `u` that reaches so far along each axis to parts
    /// of the scene.
    pub fn around(&self, way: &mut Development<'_>, u: DVec3, half: DVec3) -> Vec<SceneCopy> {
        let mut copies = Vec::new();
        for path in cells(way, u, half.length()) {
            for (k, cell) in self.cells.iter().enumerate() {
                let (point, d) = match k {
                    0 => (path.point, DMat3::IDENTITY),
                    _ => cell.deck.apply(path.point),
                };
                let mut copy = SceneCopy {
                    deck: path.deck.clone(),
                    point,
                    differential: d * path.differential,
                };
                let (low, high) = copy.image_of_box(half);
                if low.cmple(cell.bounds.1).all() && high.cmpge(cell.bounds.0).all() {
                    if k > 0 {
                        copy.deck = copy.deck.then(&cell.deck);
                    }
                    copies.push(copy);
                }
            }
        }
        copies
    }

    /// Tells whether what is in the box about `u` that reaches so far along each axis may meet anything, where
    /// `touches` tells that of a box at the scene. Of a box as large as the space that is not known.
    pub fn may_meet(
        &self,
        way: &mut Development<'_>,
        (u, half): (DVec3, DVec3),
        touches: impl Fn(DVec3, DVec3) -> bool,
    ) -> bool {
        let size = way.gluing().size();
        let Some((_, d)) = way.advance(u) else {
            return false;
        };
        if half.length() * stretch(d) > size {
            return true;
        }
        let touched = |copy: SceneCopy| {
            let (low, high) = copy.image_of_box(half);
            touches(low, high)
        };
        self.around(way, u, half).into_iter().any(touched)
    }

    /// Brings a cubic to the scene: its parts, in order, each as often as it may meet something.
    pub fn cubics(&self, piece: &Cubic) -> Vec<Cubic> {
        let (low, high) = piece.bounds();
        let Some(mut way) = self.search() else {
            return Vec::new();
        };
        let Some((_, d)) = way.advance(piece.middle()) else {
            return Vec::new();
        };
        let size = (high - low).length() * stretch(d) / (WHOLE * way.gluing().size());
        let count = size.ceil().clamp(1.0, MOST_PARTS);
        let mut cubics = Vec::new();
        for i in 0..count as usize {
            let part = match count > 1.0 {
                true => piece.between([i as f64 / count, (i + 1) as f64 / count]),
                false => *piece,
            };
            let (low, high) = part.bounds();
            let middle = part.middle();
            let half = (high - middle).max(middle - low);
            for copy in self.around(&mut way, middle, half) {
                cubics.push(copy.cubic(&part));
            }
        }
        cubics
    }
}

impl SceneCopy {
    /// Returns the image of a point, and the differential there.
    pub fn apply(&self, u: DVec3) -> (DVec3, DMat3) {
        self.deck.apply(u)
    }

    /// Returns a box around the image of the box around the middle that reaches so far along each axis.
    pub fn image_of_box(&self, half: DVec3) -> (DVec3, DVec3) {
        let d = &self.differential;
        let reach = d.x_axis.abs() * half.x + d.y_axis.abs() * half.y + d.z_axis.abs() * half.z;
        let reach = reach * BEND;
        (self.point - reach, self.point + reach)
    }

    /// Returns the image of a cubic, by its ends.
    fn cubic(&self, piece: &Cubic) -> Cubic {
        let [a, b] = [0, 1].map(|end| {
            let (u, d) = self.deck.apply(piece.u[end]);
            (u, d * piece.v[end])
        });
        Cubic {
            s: piece.s,
            u: [a.0, b.0],
            v: [a.1, b.1],
        }
    }
}

/// Points of a triangle that tell where it is.
fn places(triangle: &[DVec3; 3]) -> Vec<DVec3> {
    let [a, b, c] = *triangle;
    let along = |p: DVec3, q: DVec3| {
        (0..EDGE_PLACES).map(move |i| p.lerp(q, i as f64 / EDGE_PLACES as f64))
    };
    let edges = along(a, b).chain(along(b, c)).chain(along(c, a));
    edges.chain([(a + b + c) / 3.0]).collect()
}

fn near(gluing: &Gluing, a: DVec3, b: DVec3) -> bool {
    (a - b).length() <= 1e-6 * gluing.size()
}

/// Finds the cells that what is within `reach` of `u` may be in, each as the transformation into the domain.
fn cells(way: &mut Development<'_>, u: DVec3, reach: f64) -> Vec<SceneCopy> {
    let gluing = way.gluing();
    let Some((point, differential)) = way.advance(u) else {
        return Vec::new();
    };
    let mut cells = vec![SceneCopy {
        deck: way.deck().clone(),
        point,
        differential,
    }];
    let mut next = 0;
    while next < cells.len() && cells.len() < MOST_CELLS {
        let (point, differential) = (cells[next].point, cells[next].differential);
        let reach = BEND * reach * stretch(differential);
        for k in way.within(point, reach) {
            let face = &gluing.faces()[k];
            let Some((image, d)) = face.carry(point) else {
                continue;
            };
            if image.is_finite() && !cells.iter().any(|cell| near(gluing, cell.point, image)) {
                let deck = &cells[next].deck;
                cells.push(SceneCopy {
                    deck: face
                        .deck()
                        .map_or_else(|| deck.clone(), |then| deck.then(then)),
                    point: image,
                    differential: d * differential,
                });
            }
        }
        next += 1;
    }
    cells
}

/// Returns the most by which a map stretches, in the chart.
fn stretch(d: DMat3) -> f64 {
    let square = d.transpose() * d;
    let mut v = DVec3::ONE;
    for _ in 0..4 {
        v = (square * v).normalize_or(DVec3::X);
    }
    (square * v).length().sqrt()
}
