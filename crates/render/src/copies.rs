//! The copies of a scene that paths through a glued space meet.
//!
//! In: a box around a part of a path, in the covering chart or in the domain. Out: [`SceneCopy`]s, the deck
//! transformations that bring that part to where the scene's triangles are. A path of the cover is brought back
//! into the domain; where it may cross a face, into all cells that it may come to; and where parts of objects
//! stick out of the domain, on to where these are. Near the domain, where all copies are placed beforehand
//! ([`PlacedCopies`]), none of that is needed.

use super::{
    accel::Accelerator,
    curve::Cubic,
    lanes::{BoxPacket, LANES, Mask},
    path_patch::{Offsets, Vertex},
    placed_copies::PlacedCopies,
};
use geofan_core::manifold::{DeckTransformation, Development, Gluing, Manifold};
use geofan_expr::vectorised;
use glam::{DMat3, DVec3};
use std::{borrow::Cow, ops::ControlFlow, sync::Arc};

/// Most cells that one box is brought to: more means that it is as large as the space.
const MOST_CELLS: usize = 256;

/// Most transformations for what sticks out of the domain.
const MOST_BESIDE: usize = 512;

/// Most maps that bring a box from behind a face into a cell that it may be in.
const MOST_WAYS: usize = 64;

/// Factor by which images of boxes are widened for the bend of their maps.
const BEND: f64 = 1.3;

/// Share of the domain's size up to which a cubic is carried whole: beyond, it is cut. Boxes beyond are taken to meet
/// something: to look through all cells that they may be in takes longer than to look at the path.
const WHOLE: f64 = 0.5;

/// Most parts of a cubic.
const MOST_PARTS: f64 = 64.0;

/// Share of the domain's size within which two images of one point are the same.
const SAME_PLACE: f64 = 1e-6;

/// Places along each edge of a triangle that tell which cells it is in.
const EDGE_PLACES: usize = 4;

/// Knows the copies of a scene.
#[derive(Clone)]
pub struct SceneCopies {
    manifold: Arc<Manifold>,
    /// Those near the domain; `None` where it is not known which these are.
    placed: Option<PlacedCopies>,
    /// From the domain to the cells in which parts of the scene lie, first to the domain itself.
    cells: Vec<SceneCell>,
}

/// A copy of the domain in which a part of the scene lies.
#[derive(Debug, Clone)]
struct SceneCell {
    deck: DeckTransformation,
    /// Brings what lies there into the domain.
    into: DeckTransformation,
    /// The image of the domain's point inside.
    place: DVec3,
    /// The box around the triangles that reach into it, and one around where these would be in the domain.
    bounds: Bounds,
    home: Bounds,
}

/// Finds the copies of a scene along a path, quickest for places next to each other.
#[derive(Clone)]
pub struct CopySearch<'w> {
    copies: &'w SceneCopies,
    way: Development<'w>,
    /// Brings pieces of a path into the domain.
    home: Development<'w>,
    /// The cells that the last box may be in, and the images of its middle in them, which tell them apart.
    cells: Vec<SceneCopy<'static>>,
    places: Vec<DVec3>,
    /// The maps of the faces of a cell that the box may reach beyond.
    behind: Vec<&'w DeckTransformation>,
    /// The placed copies that it may meet.
    near: Vec<u32>,
}

/// A transformation that brings a part of a path to the scene.
#[derive(Debug, Clone)]
pub struct SceneCopy<'c> {
    deck: Cow<'c, DeckTransformation>,
    /// The image of the part's middle, and the differential there.
    point: DVec3,
    differential: DMat3,
}

/// The lowest and the highest corner of a box.
pub(super) type Bounds = (DVec3, DVec3);

/// The box around nothing.
const NOWHERE: Bounds = (DVec3::INFINITY, DVec3::NEG_INFINITY);

impl SceneCopies {
    /// Prepares the copies of all triangles; `None` if nothing is glued.
    pub fn of(manifold: &Arc<Manifold>, accelerator: &Accelerator) -> Option<Self> {
        let gluing = manifold.gluing()?;
        let identity = gluing.identity();
        let mut ways = vec![[identity.clone(), identity]];
        let mut all = true;
        let mut cells = vec![SceneCell {
            deck: gluing.identity(),
            into: gluing.identity(),
            place: gluing.inside(),
            bounds: NOWHERE,
            home: NOWHERE,
        }];
        for triangle in accelerator.outlines() {
            let places = places(&triangle);
            let words = places.iter().filter_map(|u| gluing.locate(*u));
            let mut words: Vec<Vec<usize>> = words.map(|(_, word)| word).collect();
            words.sort();
            words.dedup();
            for word in words {
                let (Some(back), Some(into)) = (gluing.way_back(&word), gluing.way_in(&word))
                else {
                    continue;
                };
                let place = back.point(gluing.inside());
                let known = cells
                    .iter()
                    .position(|cell| near(gluing, cell.place, place));
                let number = known.unwrap_or(cells.len());
                all &= number < MOST_BESIDE;
                if known.is_none() && cells.len() < MOST_BESIDE {
                    ways.push([back.clone(), into.clone()]);
                    cells.push(SceneCell {
                        deck: back,
                        into: into.clone(),
                        place,
                        bounds: NOWHERE,
                        home: NOWHERE,
                    });
                }
                if let Some(cell) = cells.get_mut(number) {
                    cell.bounds = triangle.iter().fold(cell.bounds, with);
                    let images = places.iter().map(|u| into.point(*u));
                    cell.home = images.fold(cell.home, |bounds, u| with(bounds, &u));
                }
            }
        }
        let placed = || PlacedCopies::of(gluing, &ways, accelerator);
        let placed = all.then(placed).flatten();
        Some(Self {
            manifold: manifold.clone(),
            placed,
            cells,
        })
    }

    /// Returns the transformations that bring parts of the scene from where they lie to the domain and its neighbours.
    pub(super) fn beside_domain(&self) -> Vec<DeckTransformation> {
        let Some(gluing) = self.manifold.gluing() else {
            return Vec::new();
        };
        let neighbours = gluing.copies(|_, _| Some(0.0), gluing.faces().len() + 1);
        let mut found: Vec<(DVec3, DeckTransformation)> = Vec::new();
        for cell in self.cells.iter().filter(|cell| cell.bounds != NOWHERE) {
            for neighbour in &neighbours {
                let deck = cell.into.then(neighbour);
                let place = deck.point(gluing.inside());
                if !found.iter().any(|(known, _)| near(gluing, *known, place)) {
                    found.push((place, deck));
                }
            }
        }
        found.into_iter().map(|(_, deck)| deck).collect()
    }

    /// Begins a search in the domain itself; `None` if nothing is glued.
    pub fn search(&self) -> Option<CopySearch<'_>> {
        let gluing = self.manifold.gluing()?;
        Some(CopySearch {
            copies: self,
            way: Development::new(gluing),
            home: Development::new(gluing),
            cells: Vec::new(),
            places: Vec::new(),
            behind: Vec::new(),
            near: Vec::new(),
        })
    }

    /// Tells whether what is in a box may meet anything: `false` is certain.
    pub fn may_meet(&self, bounds: Bounds) -> bool {
        let placed = self.placed.as_ref();
        placed.is_none_or(|placed| placed.may_meet(bounds))
    }

    /// Marks which of sixteen boxes may meet anything: of those that are not marked it is certain that they do not.
    #[inline(always)]
    pub fn touched(&self, boxes: &BoxPacket) -> Mask {
        match &self.placed {
            Some(placed) => placed.touched(boxes),
            None => [true; LANES],
        }
    }
}

impl<'w> CopySearch<'w> {
    /// Returns a point inside the domain.
    pub fn inside(&self) -> DVec3 {
        self.way.gluing().inside()
    }

    /// Shows the transformations that bring what is in the box about `u` that reaches so far along each axis to
    /// parts of the scene.
    pub fn around(&mut self, u: DVec3, half: DVec3, mut show: impl FnMut(&SceneCopy<'_>)) {
        if let Some(placed) = self.placed_near(u, half) {
            for copy in &self.near {
                show(&SceneCopy::at(placed.deck(*copy), u));
            }
        } else if self.locate(u, half).is_some() {
            let _ = self.visit(half, |copy| {
                show(copy);
                ControlFlow::Continue(())
            });
        }
    }

    /// Tells whether what is in the box about `u` that reaches so far along each axis may meet anything, where
    /// `touches` tells that of a box at the scene. Of a box as large as the space that is not known.
    pub fn may_meet(&mut self, (u, half): Bounds, touches: impl Fn(DVec3, DVec3) -> bool) -> bool {
        let size = self.way.gluing().size();
        if let Some(placed) = self.placed_near(u, half) {
            return self.near.iter().any(|copy| {
                let copy = SceneCopy::at(placed.deck(*copy), u);
                let (low, high) = copy.image_of_box(half);
                copy.extent(half) > size || touches(low, high)
            });
        }
        let Some(extent) = self.locate(u, half) else {
            return false;
        };
        if extent > WHOLE * size {
            return true;
        }
        let met = self.visit(half, |copy| {
            let (low, high) = copy.image_of_box(half);
            match touches(low, high) {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            }
        });
        met.is_break()
    }

    /// Tells whether more copies may be in the box about `u` that reaches so far along each axis than are looked at:
    /// then [`CopySearch::around`] does not show all.
    pub fn is_wide(&mut self, (u, half): Bounds) -> bool {
        let bounds = (u - half, u + half);
        if let Some(placed) = self.copies.placed.as_ref().filter(|p| p.knows(bounds)) {
            // Of few copies not even all are too many.
            return placed.count() > MOST_CELLS
                && self.placed_near(u, half).is_some()
                && self.near.len() > MOST_CELLS;
        }
        let extent = self.locate(u, half);
        extent.is_none_or(|extent| extent > self.way.gluing().size())
    }

    /// Brings a cubic to the scene: its parts, in order, each as often as it may meet something, until `show` has
    /// seen enough.
    pub fn show_cubics(&mut self, piece: &Cubic, mut show: impl FnMut(Cubic) -> ControlFlow<()>) {
        let piece = &self.brought_in(piece);
        let (low, high) = piece.bounds();
        let half = 0.5 * (high - low);
        let whole = 0.5 * WHOLE * self.way.gluing().size();
        if let Some(placed) = self.placed_near(0.5 * (low + high), half) {
            let decks = || self.near.iter().map(|copy| placed.deck(*copy));
            let extents = decks().map(|deck| SceneCopy::at(deck, piece.middle()).extent(half));
            let extent = extents.fold(0.0, f64::max);
            let _ = parts(piece, extent / whole).try_for_each(|part| {
                decks().try_for_each(|deck| show(image_of_cubic(deck, &part)))
            });
            return;
        }
        let Some(extent) = self.locate(piece.middle(), half) else {
            return;
        };
        for part in parts(piece, extent / whole) {
            let (low, high) = part.bounds();
            let middle = part.middle();
            let half = (high - middle).max(middle - low);
            if self.locate(middle, half).is_some()
                && self
                    .visit(half, |copy| show(image_of_cubic(&copy.deck, &part)))
                    .is_break()
            {
                return;
            }
        }
    }

    /// Brings a cubic to where its start is in the domain: far out in the chart, as about its missing point, a cubic between
    /// the same ends is none of the path.
    fn brought_in(&mut self, piece: &Cubic) -> Cubic {
        match self.home.advance(piece.u[0]) {
            Some(_) => image_of_cubic(self.home.deck(), piece),
            None => *piece,
        }
    }

    /// Finds the placed copies that the box about `u` that reaches so far may meet; `None` where not all are placed.
    fn placed_near(&mut self, u: DVec3, half: DVec3) -> Option<&'w PlacedCopies> {
        let bounds = (u - half, u + half);
        let placed = self.copies.placed.as_ref().filter(|p| p.knows(bounds))?;
        placed.near(bounds, &mut self.near);
        Some(placed)
    }

    /// Goes to the cell of `u`; returns how far the image of the box about it reaches that reaches so far along each axis.
    fn locate(&mut self, u: DVec3, half: DVec3) -> Option<f64> {
        self.cells.clear();
        self.places.clear();
        let (point, differential) = self.way.advance(u)?;
        let cell = SceneCopy {
            deck: Cow::Owned(self.way.deck().clone()),
            point,
            differential,
        };
        let extent = cell.extent(half);
        self.cells.push(cell);
        self.places.push(point);
        Some(extent)
    }

    /// Does [`CopySearch::around`] for the point that was located last, until `show` has seen enough.
    fn visit(
        &mut self,
        half: DVec3,
        mut show: impl FnMut(&SceneCopy<'_>) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let mut next = 0;
        while next < self.cells.len() {
            let path = self.cells[next].clone();
            let at_home = path.image_of_box(half);
            for (k, cell) in self.copies.cells.iter().enumerate() {
                if !meet(at_home, cell.home) {
                    continue;
                }
                if k == 0 {
                    show(&path)?;
                    continue;
                }
                let copy = path.then(&cell.deck);
                if meet(copy.image_of_box(half), cell.bounds) {
                    show(&copy)?;
                }
            }
            self.spread(&path, half);
            next += 1;
        }
        ControlFlow::Continue(())
    }

    /// Adds the neighbours of a cell that what is in the box may be in.
    fn spread(&mut self, cell: &SceneCopy<'_>, half: DVec3) {
        let mut behind = std::mem::take(&mut self.behind);
        behind.clear();
        let reach = |g| cell.reach(g, half);
        self.way.within(cell.point, reach, |deck| behind.push(deck));
        for deck in &behind {
            if self.is_new(deck.point(cell.point))
                && let Some(next) = self.settled(cell.then(deck), half)
                && self.is_new(next.point)
            {
                self.places.push(next.point);
                self.cells.push(next);
            }
        }
        self.behind = behind;
    }

    /// Goes on from a cell that all of the box lies beyond to one that it may be in: where a domain is no Dirichlet
    /// domain, what is behind one face may lie far beyond others.
    fn settled(&mut self, mut cell: SceneCopy<'static>, half: DVec3) -> Option<SceneCopy<'static>> {
        for _ in 0..MOST_WAYS {
            match self.way.beyond(cell.point, |g| cell.reach(g, half)) {
                Some(deck) => cell = cell.then(deck),
                None => return Some(cell),
            }
        }
        None
    }

    /// Tells whether another cell may be listed in which the middle comes to lie at `point`.
    fn is_new(&self, point: DVec3) -> bool {
        let same = SAME_PLACE * self.way.gluing().size();
        let known = |other: &DVec3| (*other - point).length_squared() <= same * same;
        point.is_finite() && self.cells.len() < MOST_CELLS && !self.places.iter().any(known)
    }
}

impl<'c> SceneCopy<'c> {
    /// Takes the transformation to the scene at the middle `u` of a part of a path.
    fn at(deck: &'c DeckTransformation, u: DVec3) -> Self {
        let (point, differential) = deck.apply(u);
        Self {
            deck: Cow::Borrowed(deck),
            point,
            differential,
        }
    }

    /// Returns the place that the point `u` of the domain is brought to: it tells transformations apart.
    pub fn place_of(&self, u: DVec3) -> DVec3 {
        self.deck.point(u)
    }

    /// Returns the image of a vertex of sixteen paths.
    pub fn vertex(&self, vertex: &Vertex) -> Vertex {
        let [mut u, mut v] = [&vertex.point, &vertex.tangent].map(Offsets::points);
        vectorised(
            #[inline(always)]
            || self.deck.carry_lanes(&mut u, &mut v),
        );
        Vertex {
            s: vertex.s,
            point: Offsets::of(&u),
            tangent: Offsets::of(&v),
        }
    }

    /// Returns a box around the image of the box around the middle that reaches so far along each axis.
    pub fn image_of_box(&self, half: DVec3) -> Bounds {
        let reach = self.half_of_image(half) * BEND;
        (self.point - reach, self.point + reach)
    }

    /// Returns how far the image of that box reaches from the middle's along each axis, if the map does not bend.
    fn half_of_image(&self, half: DVec3) -> DVec3 {
        let d = &self.differential;
        d.x_axis.abs() * half.x + d.y_axis.abs() * half.y + d.z_axis.abs() * half.z
    }

    /// Returns how far the image of that box reaches from the middle's: at most as far as the box's half diagonal
    /// stretched, and as the half diagonal of the box around the image. The latter is by far the smaller where one axis
    /// is stretched and another pressed.
    fn extent(&self, half: DVec3) -> f64 {
        let stretched = half.length() * self.deck.stretch(self.differential);
        stretched.min(self.half_of_image(half).length())
    }

    /// Returns by how much a function with the gradient `g` at the middle's image changes in the image of the box that
    /// reaches so far along each axis.
    fn reach(&self, g: DVec3, half: DVec3) -> f64 {
        let along = self.differential.transpose() * g;
        BEND * along.abs().dot(half)
    }

    /// Returns `next` after this one.
    fn then(&self, next: &DeckTransformation) -> SceneCopy<'static> {
        let (point, d) = next.apply(self.point);
        SceneCopy {
            deck: Cow::Owned(self.deck.then(next)),
            point,
            differential: d * self.differential,
        }
    }
}

/// Cuts a cubic into as many equal parts as it is `sizes` long, in order.
fn parts(piece: &Cubic, sizes: f64) -> impl Iterator<Item = Cubic> {
    let count = sizes.ceil().clamp(1.0, MOST_PARTS);
    (0..count as usize).map(move |i| match count > 1.0 {
        true => piece.between([i as f64 / count, (i + 1) as f64 / count]),
        false => *piece,
    })
}

/// Returns the image of a cubic, by its ends.
fn image_of_cubic(deck: &DeckTransformation, piece: &Cubic) -> Cubic {
    let [a, b] = [0, 1].map(|end| {
        let (u, d) = deck.apply(piece.u[end]);
        (u, d * piece.v[end])
    });
    Cubic {
        s: piece.s,
        u: [a.0, b.0],
        v: [a.1, b.1],
    }
}

/// Widens a box to hold a point.
fn with((low, high): Bounds, u: &DVec3) -> Bounds {
    (low.min(*u), high.max(*u))
}

fn meet(a: Bounds, b: Bounds) -> bool {
    a.0.cmple(b.1).all() && b.0.cmple(a.1).all()
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
    (a - b).length() <= SAME_PLACE * gluing.size()
}
