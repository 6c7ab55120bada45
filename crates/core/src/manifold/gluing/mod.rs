//! Glued spaces: faces of a domain of the chart, each with the isometry by which paths that leave there come back.
//!
//! In: faces, maps, openings and mirrors of a manifold file, or a group of matrices ([`quotient`]). Out: a
//! [`Gluing`]: which face a path crosses, where it goes on ([`GluedFace`]), which point of the domain a point of
//! the covering chart stands for ([`Gluing::locate`]), and the copy that a path through the cover has come to
//! ([`Development`]).
//!
//! The domain is where all faces are positive. Faces with an opening are there only where the opening is positive;
//! they bound nothing. Walls that are mirrors have no map: light is reflected there in the metric.

mod cones;
mod cover;
mod deck;
mod domain_points;
mod gluing_checks;
mod invariant_form;
mod portals;
pub(super) mod quotient;

pub use cover::{Development, NearCopy, NearestCopies};
pub use deck::DeckTransformation;
pub(super) use deck::LinearModel;

use super::{Manifold, description::digests};
use deck::{Spheres, at_tape};
use geofan_expr::{Digest, Direction, Graph, NodeId, Tape, TapeTooLarge};
use glam::{DMat3, DVec3};
use std::{
    borrow::Cow,
    cmp::Reverse,
    collections::{BinaryHeap, HashMap},
    ops::Range,
    sync::{Arc, OnceLock},
};

/// Share of the domain's size that a point must lie beyond a face to have left through it: rounding must not
/// throw a path back and forth between two faces.
const GUARD: f64 = 1e-8;

/// The most maps that bring a point back. Far points need about as many as faces lie on the way.
const MOST_MAPS: usize = 4000;

/// A face as a file gives it, as nodes of the manifold's graph.
pub(super) struct FaceNodes {
    /// Positive inside.
    pub value: NodeId,
    /// `None` for a mirror.
    pub map: Option<[NodeId; 3]>,
    pub opening: Option<NodeId>,
    /// The matrix of the map, where a model makes it linear.
    pub matrix: Option<(Vec<f64>, Arc<LinearModel>)>,
    /// Its place in the file.
    pub span: Range<usize>,
}

/// The map of a face.
#[derive(Debug, Clone)]
struct FaceMap {
    /// u -> φ(u) (3), ∂φ (9, by rows).
    tape: Arc<Tape>,
    /// u, a, b -> d²φ(a, b) (3).
    bend: Tape,
    deck: DeckTransformation,
    /// Set if it is a matrix of a group that the file gives.
    is_of_group: bool,
}

/// A face of a glued domain.
#[derive(Debug, Clone)]
pub struct GluedFace {
    /// `None` for a mirror.
    map: Option<FaceMap>,
    /// The output of the openings' tape that must be positive where this face is.
    opening: Option<usize>,
    /// The face that brings paths back which left through this one.
    partner: Option<usize>,
    /// The usual length of its gradient in the domain.
    slope: f64,
    span: Range<usize>,
}

/// The faces of a glued domain.
#[derive(Debug, Clone)]
pub struct Gluing {
    faces: Vec<GluedFace>,
    /// u -> the value of each face.
    values: Tape,
    /// The same where all faces are planes and spheres.
    spheres: Option<Spheres>,
    /// u -> the gradient of each face (3).
    gradients: Tape,
    /// u -> the value of each opening.
    openings: Tape,
    /// The size of the domain in the chart.
    size: f64,
    /// A point inside.
    inside: DVec3,
    /// Points of faces: those that are farthest in some direction of the chart, and the middles.
    outline: Vec<DVec3>,
    nearest: OnceLock<Arc<NearestCopies>>,
}

impl GluedFace {
    /// Returns the isometry by which paths go on; `None` for a mirror.
    pub fn deck(&self) -> Option<&DeckTransformation> {
        self.map.as_ref().map(|map| &map.deck)
    }

    /// Returns whether paths are reflected here.
    pub fn is_mirror(&self) -> bool {
        self.map.is_none()
    }

    /// Returns whether it is there only where its opening is.
    pub fn is_portal(&self) -> bool {
        self.opening.is_some()
    }

    /// Returns the face that takes paths back.
    pub fn partner(&self) -> Option<usize> {
        self.partner
    }

    /// Returns whether paths are turned from right-handed to left-handed here.
    pub fn reverses(&self) -> bool {
        self.deck().is_none_or(DeckTransformation::reverses)
    }

    /// Returns the image of `u` and the differential there; `None` for a mirror.
    pub fn carry(&self, u: DVec3) -> Option<(DVec3, DMat3)> {
        self.map.as_ref().map(|map| at_tape(&map.tape, u))
    }

    /// Computes the second differential `d²φ(a, b)` of the map at `u`.
    pub fn bend(&self, u: DVec3, a: DVec3, b: DVec3) -> DVec3 {
        let Some(map) = &self.map else {
            return DVec3::ZERO;
        };
        let [u, a, b] = [u, a, b].map(|x| x.to_array());
        let inputs = [u, a, b].concat();
        DVec3::from_slice(&map.bend.at(&inputs))
    }
}

impl Gluing {
    /// Compiles faces; nothing numerical is known of them yet.
    pub(super) fn compile(graph: &mut Graph, faces: Vec<FaceNodes>) -> Result<Self, TapeTooLarge> {
        let values: Vec<NodeId> = faces.iter().map(|face| face.value).collect();
        let mut axes = [0, 1, 2].map(|k| Direction::of_input(graph, k));
        let mut gradients = Vec::new();
        for value in &values {
            gradients.extend(axes.each_mut().map(|axis| graph.derivative(*value, axis)));
        }
        let openings: Vec<NodeId> = faces.iter().filter_map(|face| face.opening).collect();
        let mut gluing = Self {
            faces: Vec::new(),
            values: Tape::compile(graph, &values, 3)?,
            spheres: None,
            gradients: Tape::compile(graph, &gradients, 3)?,
            openings: Tape::compile(graph, &openings, 3)?,
            size: 1.0,
            inside: DVec3::ZERO,
            outline: Vec::new(),
            nearest: OnceLock::new(),
        };
        let mut portals = 0;
        for face in faces {
            let map = face
                .map
                .map(|map| FaceMap::compile(graph, map, face.matrix));
            let opening = face.opening.map(|_| portals);
            portals += usize::from(opening.is_some());
            gluing.faces.push(GluedFace {
                map: map.transpose()?,
                opening,
                partner: None,
                slope: 1.0,
                span: face.span,
            });
        }
        Ok(gluing)
    }

    /// The faces, in the order of the file.
    pub fn faces(&self) -> &[GluedFace] {
        &self.faces
    }

    /// The tape u -> the value of each face, positive inside.
    pub fn values(&self) -> &Tape {
        &self.values
    }

    /// Returns how far beyond face `k` its value is still taken for rounding.
    pub fn guard(&self, k: usize) -> f64 {
        GUARD * self.size * self.faces[k].slope
    }

    /// Returns the size of the domain in the chart.
    pub fn size(&self) -> f64 {
        self.size
    }

    /// Returns a point inside the domain.
    pub fn inside(&self) -> DVec3 {
        self.inside
    }

    /// Returns points of bounding faces: those that were found farthest out in some direction of the chart, and the middle of
    /// each.
    pub fn outline(&self) -> &[DVec3] {
        &self.outline
    }

    /// Computes the gradient of face `k` at `u`.
    pub fn gradient(&self, k: usize, u: DVec3) -> DVec3 {
        DVec3::from_slice(&self.gradients.at(&u.to_array())[3 * k..])
    }

    /// Returns whether face `k` is there at `u`.
    pub fn is_open(&self, k: usize, u: DVec3) -> bool {
        let opening = self.faces[k].opening;
        opening.is_none_or(|k| self.openings.at(&u.to_array())[k] > 0.0)
    }

    /// Tells whether paths of the covering chart tell how all paths go on: not where a face is a portal or a mirror.
    pub fn follows_cover(&self) -> bool {
        !self
            .faces
            .iter()
            .any(|face| face.is_portal() || face.is_mirror())
    }

    /// Returns the deck transformation that moves nothing.
    pub fn identity(&self) -> DeckTransformation {
        let deck = self.faces.iter().find_map(GluedFace::deck);
        deck.map_or_else(DeckTransformation::alone, DeckTransformation::identity)
    }

    /// Makes the transformations from the domain to its copies, going on from the one of the highest `rank` (of equals the
    /// first) to those behind its faces; at most so many. The rank is that of a transformation and the image of the point
    /// inside, and `None` of what is out of reach.
    pub fn copies(
        &self,
        rank: impl Fn(&DeckTransformation, DVec3) -> Option<f64>,
        most: usize,
    ) -> Vec<DeckTransformation> {
        let mut known = KnownPlaces::about(self);
        known.add(self.inside);
        let mut copies = vec![self.identity()];
        let mut open = BinaryHeap::from([(Key(f64::INFINITY), Reverse(0))]);
        while let Some((_, Reverse(next))) = open.pop() {
            if copies.len() >= most {
                break;
            }
            for face in self.faces.iter().filter(|face| !face.is_portal()) {
                let Some(deck) = face.deck() else { continue };
                let copy = deck.then(&copies[next]);
                let place = copy.point(self.inside);
                if place.is_finite()
                    && known.add(place)
                    && let Some(rank) = rank(&copy, place)
                {
                    open.push((Key(rank), Reverse(copies.len())));
                    copies.push(copy);
                }
            }
        }
        copies
    }

    /// Finds the bounding face that `u` lies farthest beyond, by more than rounding. Portals bound nothing.
    pub fn violated(&self, u: DVec3) -> Option<usize> {
        match &self.spheres {
            Some(spheres) => self.deepest(|k| spheres.value(k, u)),
            None => {
                let values = self.values.at(&u.to_array());
                self.deepest(|k| values[k])
            }
        }
    }

    /// Finds the bounding face with the least `value` for its slope, if that is beyond it by more than rounding.
    #[inline(always)]
    fn deepest(&self, value: impl Fn(usize) -> f64) -> Option<usize> {
        let mut deepest = (GUARD * self.size, None);
        for (k, face) in self.faces.iter().enumerate() {
            let depth = -value(k) / face.slope;
            if depth > deepest.0 && !face.is_portal() {
                deepest = (depth, Some(k));
            }
        }
        deepest.1
    }

    /// Finds the mirror that `u` lies behind.
    pub fn behind_mirror(&self, u: DVec3) -> Option<usize> {
        let values = self.values.at(&u.to_array());
        let behind = |k: &usize| {
            let face = &self.faces[*k];
            face.is_mirror() && !face.is_portal() && values[*k] < -self.guard(*k)
        };
        (0..self.faces.len()).find(behind)
    }

    /// Finds the copy of the domain that `u` of the covering chart is in: what brings the domain there.
    pub fn copy_of(&self, u: DVec3) -> Option<DeckTransformation> {
        let (_, word) = self.locate(u)?;
        self.way_back(&word)
    }

    /// Returns the maps of the faces of `word` after each other.
    pub fn way_in(&self, word: &[usize]) -> Option<DeckTransformation> {
        let mut deck = self.identity();
        for k in word {
            deck = deck.then(self.faces[*k].deck()?);
        }
        Some(deck)
    }

    /// Returns the transformation that undoes the maps of the faces of `word`.
    pub fn way_back(&self, word: &[usize]) -> Option<DeckTransformation> {
        let mut deck = self.identity();
        for k in word.iter().rev() {
            deck = deck.then(self.faces[self.faces[*k].partner?].deck()?);
        }
        Some(deck)
    }

    /// Brings `u` into the domain, by the map of the face that it lies farthest beyond, again and again. Returns
    /// its image and the faces, first to last; `None` where that does not end, or ends behind a mirror.
    pub fn locate(&self, mut u: DVec3) -> Option<(DVec3, Vec<usize>)> {
        let mut word = Vec::new();
        while let Some(k) = self.violated(u) {
            let (image, _) = self.faces[k].carry(u)?;
            if !image.is_finite() || word.len() == MOST_MAPS {
                return None;
            }
            u = image;
            word.push(k);
        }
        Some((u, word))
    }

    /// Carries vectors (the columns of a matrix, chart components) at `u` through the faces of `word`.
    pub fn carried(&self, word: &[usize], u: DVec3, vectors: DMat3) -> DMat3 {
        let start = (u, vectors);
        let carry = |(u, vectors): (DVec3, DMat3), k: &usize| match self.faces[*k].carry(u) {
            Some((image, d)) => (image, d * vectors),
            None => (u, vectors),
        };
        word.iter().fold(start, carry).1
    }

    /// Returns whether the faces of `word` turn right into left.
    pub fn reverses(&self, word: &[usize]) -> bool {
        let reversals = word.iter().filter(|k| self.faces[**k].reverses());
        reversals.count() % 2 == 1
    }

    /// Hashes faces, openings and maps.
    pub(super) fn digest(&self) -> Digest {
        let (values, openings) = (digests(&self.values), digests(&self.openings));
        let mut hasher = blake3::Hasher::new();
        for (face, value) in self.faces.iter().zip(values) {
            hasher.update(&value);
            match face.opening {
                Some(k) => hasher.update(b"opening").update(&openings[k]),
                None => hasher.update(b"bounding"),
            };
            match &face.map {
                Some(map) => hasher.update(&digests(&map.tape)[..3].concat()),
                None => hasher.update(b"mirror"),
            };
        }
        *hasher.finalize().as_bytes()
    }

    /// Returns the number of face `k` as people count, for messages.
    fn name(k: usize) -> String {
        format!("face {}", k + 1)
    }
}

/// A number to sort by.
#[derive(PartialEq, PartialOrd)]
struct Key(f64);

impl Eq for Key {}

#[allow(clippy::derive_ord_xor_partial_ord)]
impl Ord for Key {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

/// Places of the chart, by their distance from the point inside.
struct KnownPlaces<'g> {
    gluing: &'g Gluing,
    bins: HashMap<i64, Vec<DVec3>>,
}

impl<'g> KnownPlaces<'g> {
    /// Relative difference up to which places are the same.
    const SAME: f64 = 1e-7;

    /// Bins to a doubling of the distance, much wider than [`Self::SAME`].
    const BINS: f64 = 1e5;

    fn about(gluing: &'g Gluing) -> Self {
        let bins = HashMap::new();
        Self { gluing, bins }
    }

    /// Adds a place; `false` if it is known.
    fn add(&mut self, place: DVec3) -> bool {
        let size = self.gluing.size;
        let scale = Self::SAME * (size + place.length());
        let distance = (place - self.gluing.inside).length();
        let bin = (Self::BINS * (distance / size).asinh()).floor() as i64;
        let near = (bin - 1..=bin + 1).filter_map(|bin| self.bins.get(&bin));
        if near.flatten().any(|p| (*p - place).length() <= scale) {
            return false;
        }
        self.bins.entry(bin).or_default().push(place);
        true
    }
}

impl FaceMap {
    fn compile(
        graph: &mut Graph,
        map: [NodeId; 3],
        matrix: Option<(Vec<f64>, Arc<LinearModel>)>,
    ) -> Result<Self, TapeTooLarge> {
        let mut axes = [0, 1, 2].map(|k| Direction::of_input(graph, k));
        let mut outputs = map.to_vec();
        for node in map {
            outputs.extend(axes.each_mut().map(|axis| graph.derivative(node, axis)));
        }
        let tape = Arc::new(Tape::compile(graph, &outputs, 3)?);
        let mut seeds = |first: u32| {
            let seeds = [0, 1, 2].map(|k| (graph.input(k), graph.input(first + k)));
            Direction::new(seeds)
        };
        let (mut along, mut across) = (seeds(3), seeds(6));
        let bend = map.map(|node| {
            let rate = graph.derivative(node, &mut along);
            graph.derivative(rate, &mut across)
        });
        let is_of_group = matrix.is_some();
        let deck = match matrix {
            Some((matrix, model)) => DeckTransformation::linear(matrix, model),
            None => DeckTransformation::chain(tape.clone()),
        };
        Ok(Self {
            is_of_group,
            bend: Tape::compile(graph, &bend, 9)?,
            tape,
            deck,
        })
    }
}

impl Manifold {
    /// Returns the gluing of its domain; `None` for a space that is all of its chart.
    pub fn gluing(&self) -> Option<&Gluing> {
        self.gluing.as_deref().filter(|_| !self.unfolded)
    }

    /// Returns the gluing that the file gives, of the space or of what this is the cover of.
    pub fn gluing_below(&self) -> Option<&Gluing> {
        self.gluing.as_deref()
    }

    /// Returns the space that covers this one: the chart without its gluing.
    pub fn cover(&self) -> Cow<'_, Self> {
        self.folded(false)
    }

    /// Tells whether paths of the cover tell how all paths go on: in every space without portals and mirrors.
    pub fn follows_cover(&self) -> bool {
        self.gluing().is_none_or(Gluing::follows_cover)
    }

    /// Tells whether pictures must be of paths that are integrated one by one: which way they go on at portals and mirrors, and
    /// where they leave a glued space, paths of the cover do not tell.
    pub fn needs_exact_paths(&self) -> bool {
        self.gluing().is_some() && (self.domain.has_exits() || !self.follows_cover())
    }

    /// Returns the chart on which paths go on without faces: the cover, but where a face is a portal or a mirror, which
    /// the cover knows nothing of, the space itself.
    pub fn developed(&self) -> Cow<'_, Self> {
        match self.follows_cover() {
            true => self.cover(),
            false => Cow::Borrowed(self),
        }
    }

    /// Returns the space of the file, of which this may be the cover.
    pub fn glued(&self) -> Cow<'_, Self> {
        self.folded(true)
    }

    fn folded(&self, folded: bool) -> Cow<'_, Self> {
        match self.gluing.is_some() && folded == self.unfolded {
            false => Cow::Borrowed(self),
            true => Cow::Owned(Self {
                unfolded: !folded,
                ..self.clone()
            }),
        }
    }

    /// Returns the state that the point `u` and the tangent `v` of the covering chart stand for, and the faces
    /// between; `None` where there is none.
    pub fn brought_in(&self, u: DVec3, v: DVec3) -> Option<(DVec3, DVec3, Vec<usize>)> {
        let Some(gluing) = self.gluing() else {
            return Some((u, v, Vec::new()));
        };
        let (_, word) = gluing.locate(u)?;
        let (u, v) = self.carried_through(&word, (u, v))?;
        Some((u, v, word))
    }

    /// Carries a point and a tangent through the faces of `word`.
    pub fn carried_through(&self, word: &[usize], start: (DVec3, DVec3)) -> Option<(DVec3, DVec3)> {
        let faces = self.gluing().map_or(&[][..], Gluing::faces);
        word.iter().try_fold(start, |(u, v), k| {
            let (image, d) = faces[*k].carry(u)?;
            Some((image, d * v))
        })
    }

    /// Returns the point of the glued domain, and inside the limits of glued coordinates, that `u` stands for;
    /// `u` itself where there is none.
    pub fn located(&self, u: DVec3) -> DVec3 {
        let u = self.domain.wrap(u);
        let found = self.gluing().and_then(|gluing| gluing.locate(u));
        found.map_or(u, |(u, _)| u)
    }

    /// Completes and checks the gluing of a manifold as read.
    pub(super) fn with_checked_gluing(mut self) -> crate::error::Result<Self> {
        if let Some(gluing) = &self.gluing {
            let gluing = gluing_checks::checked(&self, gluing)?;
            self.gluing = Some(Arc::new(gluing));
        }
        Ok(self)
    }
}
