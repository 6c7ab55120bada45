//! All paths from one camera position, and one of them.
//!
//! In: the chunks of a table around a camera. Out: a [`Fan`]: the chunks contracted to polynomials in
//! direction and arc length, and from it single [`TablePath`]s: position, tangent and transported rotation at
//! any arc length. The contraction takes about a millisecond, a path about a microsecond; turning the head needs
//! no new fan. Sections of a chunk ([`CodedTree`](crate::CodedTree)) are decoded and contracted when a path there is looked up. Points come from the stored ray, in the coordinates in which the table stores them, and
//! are carried by the isometry that takes this ray to the true one.

use crate::{
    contracted::Contracted,
    contraction::ContractedTree,
    path_coefficients::{self, ArcSums, Evaluate, PathCoefficients, PathPiece, StoredRay},
    rays::{ChartMap, Image, Located, Place, RaySpace},
    sections::decode_all,
    table::Table,
};
use geofan_core::{
    geodesic::{End, carry, first_event, turn_at_edge},
    manifold::Isometry,
    parallel::*,
};
use geofan_expr::{Tape, real::Real, vectorised};
use glam::{DMat3, DQuat, DVec3};
use std::{borrow::Borrow, ops::Range, sync::Arc};

/// All paths from one camera position. It shares its table, so that it can be kept and given to
/// other threads.
#[derive(Debug, Clone)]
pub struct Fan {
    pub(crate) table: Table,
    /// The camera position.
    pub place: Place,
    faces: Vec<FaceFan>,
}

/// The paths in the directions of one face: the chunk that stores them, and the mirror that carries
/// them there.
#[derive(Debug, Clone)]
pub(crate) struct FaceFan {
    pub tree: Arc<ContractedTree>,
    pub image: Option<Image>,
}

impl Fan {
    /// Puts together the paths from `place`, where the chunks of its cell are contracted to `faces`.
    pub(crate) fn new(table: Table, place: Place, faces: Vec<FaceFan>) -> Self {
        Self {
            table,
            place,
            faces,
        }
    }

    /// Decodes and contracts what paths in these directions (standard frame, unit) are made of by all threads, where chunks have
    /// sections; others are, by the thread that needs them, when a path is looked up there.
    pub fn prepare(&self, directions: &[DVec3]) {
        let needed = self.table.sections_towards(&self.place, directions);
        let needed: Vec<_> = needed.into_iter().map(|(_, coded)| coded).collect();
        decode_all(&needed);
        let mut sections = Vec::new();
        for (i, face) in self.faces.iter().enumerate() {
            // Faces in one chunk share its tree.
            let before = &self.faces[..i];
            if !before
                .iter()
                .any(|other| Arc::ptr_eq(&other.tree, &face.tree))
            {
                sections.extend(face.tree.sections());
            }
        }
        sections.retain(|section| needed.iter().any(|coded| section.is_of(coded)));
        sections.par_iter().for_each(|section| {
            section.tree();
        });
    }

    /// Looks up the path in the direction `d` (standard frame, unit).
    pub fn path(&self, d: DVec3) -> TablePath<'_> {
        let mut coefficients = PathCoefficients::default();
        let number = self.follow(self.locate(d), &mut coefficients, Contracted::direction);
        TablePath::new(self, coefficients, number)
    }

    /// Appends the path of a located ray, one of many close together, and returns its number there. It is
    /// that of [`Fan::path`] but for what local expansions leave out (see [`Contracted::nearby`]).
    pub fn add(&self, located: Located, coefficients: &mut PathCoefficients) -> usize {
        self.follow(located, coefficients, Contracted::nearby)
    }

    /// Returns the path that [`Fan::add`] gave a number.
    pub fn among<'f>(
        &'f self,
        coefficients: &'f PathCoefficients,
        number: usize,
    ) -> TablePath<'f, &'f PathCoefficients> {
        TablePath::new(self, coefficients, number)
    }

    /// Returns the rays that the table knows.
    pub fn space(&self) -> &RaySpace {
        &self.table.space
    }

    /// Expresses the ray in the direction `d` in stored parameters.
    pub fn locate(&self, d: DVec3) -> Located {
        self.table.space.locate(&self.place, d)
    }

    /// Looks up the path at direction parameters of a face as it is stored, carried by no isometry.
    ///
    /// # Panics
    /// There are not so many faces.
    pub fn stored_path(&self, face: usize, direction: [f64; 2]) -> TablePath<'_> {
        let mut coefficients = PathCoefficients::default();
        let located = self.table.space.stored_ray(&self.place, face, direction);
        let number = self.follow(located, &mut coefficients, Contracted::direction);
        TablePath::new(self, coefficients, number)
    }

    fn follow(
        &self,
        located: Located,
        coefficients: &mut PathCoefficients,
        evaluate: Evaluate,
    ) -> usize {
        let face = &self.faces[located.face];
        let located = located.carried(face.image.as_ref());
        coefficients.add(&self.table, &face.tree, located, evaluate)
    }
}

/// Arc lengths summed at once.
const LANES: usize = 16;

/// The most that one step of a transport along a stored path may be off, radians: far below any
/// promise.
const TRANSPORT_TOLERANCE: f64 = 1e-7;

/// Distances from an edge, as shares of the arc length up to it, at which frames before it and behind it are
/// looked at: the table is off by a thousandth or less, or beside a surface that the path grazes, which is soon left, by more.
const BESIDE_EDGE: [f64; 5] = [1e-6, 1e-4, 1e-3, 4e-3, 3e-2];

/// Difference from 1 of the length of a tangent that is believed to be on its own side of an edge: where the metric
/// jumps by less, sides are alike.
const OFF_SPEED: f64 = 0.01;

/// One path of a fan, which owns its coefficients or is one of many.
#[derive(Debug, Clone)]
pub struct TablePath<'f, C = PathCoefficients> {
    fan: &'f Fan,
    coefficients: C,
    number: usize,
}

impl<'f, C> TablePath<'f, C> {
    /// Takes the path of `fan` that has this number among `coefficients`.
    pub(crate) fn new(fan: &'f Fan, coefficients: C, number: usize) -> Self {
        Self {
            fan,
            coefficients,
            number,
        }
    }
}

impl<C: Borrow<PathCoefficients>> TablePath<'_, C> {
    /// Borrows the coefficients, so that there is one copy of the loops over them.
    fn one_of_many(&self) -> TablePath<'_, &PathCoefficients> {
        TablePath::new(self.fan, self.coefficients.borrow(), self.number)
    }

    fn ray(&self) -> &StoredRay {
        self.coefficients.borrow().ray(self.number)
    }

    fn pieces(&self) -> &[PathPiece] {
        self.coefficients.borrow().pieces(self.number)
    }

    /// Returns the first arc length at which the table gives up; infinite if it never does.
    pub fn flagged_from(&self) -> f64 {
        let first = self.pieces().iter().find(|piece| piece.is_flagged());
        first.map_or(f64::INFINITY, |piece| piece.interval[0])
    }

    /// Iterates over the arc lengths at which the path meets an edge of the metric, or an exit behind which paths get rough.
    pub fn edges(&self) -> impl Iterator<Item = f64> {
        self.coefficients.borrow().edges(self.number)
    }

    /// Finds the piece that holds the arc length `s`; `None` where flagged.
    fn piece(&self, s: f64) -> Option<&PathPiece> {
        let pieces = self.pieces();
        let after = pieces.partition_point(|piece| piece.interval[1] < s);
        let piece = pieces.get(after.min(pieces.len() - 1))?;
        (!piece.is_flagged()).then_some(piece)
    }

    /// Computes chart point and tangent (chart components) at arc length `s`, from 0 to the table's length: outside
    /// of these the result means nothing. `None` where flagged.
    pub fn at(&self, s: f64) -> Option<(DVec3, DVec3)> {
        let one = self.one_of_many();
        let state = one.state(&one.sums(one.piece(s)?, &[s]), &[s]);
        Some((lane(&state[0], 0), lane(&state[1], 0)))
    }

    /// Computes chart points and tangents at the ascending arc lengths `s`, from 0 to the table's length. The list ends early
    /// where the table gives up.
    pub fn sample(&self, s: &[f64]) -> Vec<(DVec3, DVec3)> {
        let mut rows = vec![0.0; 6 * s.len()];
        let known = self.sample_into(s, &mut rows);
        let triple = |first: usize, i: usize| {
            let component = |c: usize| rows[(first + c) * s.len() + i];
            DVec3::new(component(0), component(1), component(2))
        };
        (0..known).map(|i| (triple(0, i), triple(3, i))).collect()
    }

    /// Writes chart points and tangents at the ascending arc lengths `s`, from 0 to the table's length, into `rows`: x, y, z
    /// and the tangent's three components, each as many as there are lengths (what has no place is left out). Returns how
    /// many are known: the table may give up before the last.
    pub fn sample_into(&self, s: &[f64], rows: &mut [f64]) -> usize {
        let mut known = 0;
        for piece in self.pieces() {
            let last = piece.interval[1] >= self.fan.table.length;
            let end = match last {
                true => s.len(),
                false => known + s[known..].partition_point(|s| *s <= piece.interval[1]),
            };
            match piece.is_flagged() {
                true if end > known => return known,
                true => {}
                false => self.one_of_many().fill(piece, s, known..end, rows),
            }
            known = end;
        }
        known
    }

    /// Wraps the path as a curve s -> (chart point, tangent); not numbers where flagged.
    fn curve(&self) -> impl Fn(f64) -> (DVec3, DVec3) {
        |s| self.at(s).unwrap_or((DVec3::NAN, DVec3::NAN))
    }

    /// Finds how and at which arc length the domain ends the path before `length`, before its own end and before the table
    /// gives up; `None` if it does not.
    pub fn first_event(&self, length: f64) -> Option<(End, f64)> {
        let known = self.flagged_from().min(self.fan.table.length).min(length);
        first_event(&self.fan.table.space.manifold().domain, known, self.curve())
    }

    /// Computes the transported rotation at `s`, from 0 to the table's length, relative to the standard frames, by transport
    /// along the path; `None` where flagged, or where the table does not promise tangents.
    pub fn rotation(&self, s: f64) -> Option<DQuat> {
        let table = &self.fan.table;
        if !table.frames || self.flagged_from() < s {
            return None;
        }
        let manifold = table.space.manifold();
        let carried = |interval: [f64; 2]| {
            let carried = carry(manifold, self.curve(), interval, TRANSPORT_TOLERANCE);
            Some(carried.ok()?.rotation)
        };
        // From edge to edge, and over them.
        let edges = self.edges();
        let known = self.flagged_from().min(table.length);
        let places: Vec<f64> = [0.0].into_iter().chain(edges).chain([known]).collect();
        let (mut from, mut turned) = (0.0, DQuat::IDENTITY);
        for place in places.windows(3).take_while(|place| place[1] < s) {
            let [before, at, behind] = [place[0], place[1], place[2]];
            turned = self.turn_at_edge([before, at, behind])? * carried([before, at])? * turned;
            from = at;
        }
        Some(carried([from, s])? * turned)
    }

    /// Computes the rotation of a frame over the edge at `s`, between what is `before` it and `behind` it (an edge, or an end): from
    /// the nearest points that are on the same side as ones farther off, and at which the tangent has the length that the metric
    /// asks for. The table does not know the edge exactly; and a wind may make that length right on both sides.
    fn turn_at_edge(&self, [before, s, behind]: [f64; 3]) -> Option<DQuat> {
        let manifold = self.fan.table.space.manifold();
        let nearest = |to: f64| {
            let room = 0.5 * (to - s);
            let beside = |share: &f64| self.at(s + room.clamp(-share * s, share * s));
            let states: Vec<(DVec3, DVec3)> = BESIDE_EDGE.iter().filter_map(beside).collect();
            let last = *states.last()?;
            let sides = manifold.metric_sides(last.0);
            // The nearest of the surest; where no tangent fits, the farthest.
            let doubt = |(i, (u, v)): &(usize, (DVec3, DVec3))| {
                let fits = (manifold.speed(*u, *v) - 1.0).abs() < OFF_SPEED;
                match (fits, manifold.metric_sides(*u) == sides) {
                    (true, true) => 0,
                    (true, false) => 1,
                    (false, _) => 2 + BESIDE_EDGE.len() - i,
                }
            };
            let (_, best) = states.into_iter().enumerate().min_by_key(doubt)?;
            Some(best)
        };
        Some(turn_at_edge(manifold, nearest(before)?, nearest(behind)?))
    }
}

impl TablePath<'_, &PathCoefficients> {
    /// Fills the rows of [`TablePath::sample_into`] at the lengths of `range`, all in `piece`.
    fn fill(&self, piece: &PathPiece, s: &[f64], range: Range<usize>, rows: &mut [f64]) {
        for start in range.clone().step_by(LANES) {
            let count = LANES.min(range.end - start);
            let mut lengths = [s[start]; LANES];
            lengths[..count].copy_from_slice(&s[start..start + count]);
            let state = self.sixteen(piece, &lengths);
            for (row, lanes) in rows.chunks_exact_mut(s.len()).zip(state.as_flattened()) {
                row[start..start + count].copy_from_slice(&lanes[..count]);
            }
        }
    }

    /// Computes points and tangents at sixteen arc lengths of one piece.
    fn sixteen(&self, piece: &PathPiece, s: &[f64; LANES]) -> ChartStates<LANES> {
        match self.fan.table.space.channels().len() {
            1 => self.sixteen_of::<1>(piece, s),
            2 => self.sixteen_of::<2>(piece, s),
            3 => self.sixteen_of::<3>(piece, s),
            _ => self.sixteen_of::<4>(piece, s),
        }
    }

    /// Does so for `K` channels: all in one, sums need not go through memory.
    fn sixteen_of<const K: usize>(
        &self,
        piece: &PathPiece,
        s: &[f64; LANES],
    ) -> ChartStates<LANES> {
        let rows = self.coefficients.rows(piece);
        vectorised(
            #[inline(always)]
            || {
                let sums = path_coefficients::sums_inline::<K, LANES>(rows, piece.interval, s);
                carried(&self.ray().isometry, self.stored_state(&sums, s))
            },
        )
    }

    /// Sums departures and slopes at `W` arc lengths of one piece.
    fn sums<const W: usize>(&self, piece: &PathPiece, s: &[f64; W]) -> ArcSums<W> {
        let rows = self.coefficients.rows(piece);
        let channels = self.fan.table.space.channels().len();
        path_coefficients::sums(rows, channels, piece.interval, s)
    }

    /// Computes points and tangents of the stored ray from [`TablePath::sums`].
    #[inline(always)]
    fn stored_state<const W: usize>(&self, sums: &ArcSums<W>, s: &[f64; W]) -> ChartStates<W> {
        let space = &self.fan.table.space;
        let stored = space.channels();
        match space.chart_map() {
            ChartMap::None => {}
            ChartMap::Polar => return self.polar(sums, s),
            ChartMap::Sphere { .. } => return self.projected(sums, s),
        }
        // Plain coordinates: a straight line and the departures from it.
        let (from, along) = (self.ray().u, self.ray().v);
        let mut state = [[[0.0; W]; 3]; 2];
        for c in 0..3 {
            let channel = stored.iter().position(|channel| *channel == c);
            let [values, slopes] = match channel {
                Some(k) => [sums[0][k], sums[1][k]],
                None => [[0.0; W]; 2],
            };
            for l in 0..W {
                state[0][c][l] = from[c] + along[c] * s[l] + values[l];
                state[1][c][l] = along[c] + slopes[l];
            }
        }
        state
    }

    /// Computes them where points are stored in polar coordinates.
    #[inline(always)]
    fn polar<const W: usize>(
        &self,
        [departure, slope]: &ArcSums<W>,
        s: &[f64; W],
    ) -> ChartStates<W> {
        let (x, rate) = (self.ray().start.x, self.ray().start.slope);
        let mut state = [[[0.0; W]; 3]; 2];
        for l in 0..W {
            let angle = x.x + rate.x * s[l] + departure[0][l];
            let radius = Real::exp(x.w + rate.w * s[l] + departure[1][l]);
            let (along, across) = (rate.w + slope[1][l], rate.x + slope[0][l]);
            let u = [radius * Real::cos(angle), radius * Real::sin(angle)];
            for c in 0..2 {
                state[0][c][l] = u[c];
            }
            state[1][0][l] = along * u[0] - across * u[1];
            state[1][1][l] = along * u[1] + across * u[0];
        }
        state
    }

    /// Computes them where points are stored on a sphere.
    fn projected<const W: usize>(&self, sums: &ArcSums<W>, s: &[f64; W]) -> ChartStates<W> {
        let space = &self.fan.table.space;
        let mut state = [[[0.0; W]; 3]; 2];
        for l in 0..W {
            let (u, v) = path_coefficients::state(space, &self.ray().start, sums, l, s[l]);
            for c in 0..3 {
                state[0][c][l] = u[c];
                state[1][c][l] = v[c];
            }
        }
        state
    }

    /// Computes chart points and tangents of the true ray from [`TablePath::sums`].
    fn state<const W: usize>(&self, sums: &ArcSums<W>, s: &[f64; W]) -> ChartStates<W> {
        vectorised(
            #[inline(always)]
            || carried(&self.ray().isometry, self.stored_state(sums, s)),
        )
    }
}

/// Values and their slopes in the arc length, or points and tangents: three components each, at `W`
/// arc lengths.
type ChartStates<const W: usize> = [[[f64; W]; 3]; 2];

/// Returns one lane of three components.
fn lane<const W: usize>(lanes: &[[f64; W]; 3], lane: usize) -> DVec3 {
    DVec3::new(lanes[0][lane], lanes[1][lane], lanes[2][lane])
}

/// Carries points and tangents by an isometry.
#[inline(always)]
fn carried<const W: usize>(isometry: &Isometry, state: ChartStates<W>) -> ChartStates<W> {
    match isometry {
        Isometry::Identity => state,
        Isometry::Affine(q, t) => moved((q, *t), &state),
        Isometry::Left { p, first, law } => {
            translated(*p, &law.tape, &moved((&first.0, first.1), &state))
        }
    }
}

/// Carries points and tangents by `u -> Q u + t`.
#[inline(always)]
fn moved<const W: usize>((q, t): (&DMat3, DVec3), state: &ChartStates<W>) -> ChartStates<W> {
    [affine(q, t, &state[0]), affine(q, DVec3::ZERO, &state[1])]
}

/// Carries points and tangents by the left translation by `p`: the tape gives the image and then
/// the rows of the differential.
#[inline(always)]
fn translated<const W: usize>(p: DVec3, tape: &Tape, state: &ChartStates<W>) -> ChartStates<W> {
    // The inputs: points, and the element of the group.
    let mut registers = tape.registers::<f64, W>();
    for c in 0..3 {
        *registers.input(c) = state[0][c];
        *registers.input(3 + c) = [p[c]; W];
    }
    // The outputs: the image, and the rows of the differential.
    tape.run(&mut registers);
    let mut image = [[[0.0; W]; 3]; 2];
    for c in 0..3 {
        image[0][c] = *registers.output(c);
        for j in 0..3 {
            let slope = registers.output(3 + 3 * c + j);
            for l in 0..W {
                image[1][c][l] += slope[l] * state[1][j][l];
            }
        }
    }
    image
}

/// Computes `Q x + t` lane by lane.
#[inline(always)]
fn affine<const W: usize>(q: &DMat3, t: DVec3, x: &[[f64; W]; 3]) -> [[f64; W]; 3] {
    let mut image = [[0.0; W]; 3];
    for c in 0..3 {
        let row = q.row(c);
        for l in 0..W {
            image[c][l] = row.x * x[0][l] + row.y * x[1][l] + row.z * x[2][l] + t[c];
        }
    }
    image
}
