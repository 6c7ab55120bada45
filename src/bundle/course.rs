//! Single paths of a fan.
//!
//! In: a ray in stored parameters and the patches that hold it. Out: what they say of it ([`Courses`]),
//! and from that position, tangent and transported rotation at any arc length ([`FanPath`]).

use super::{
    arc::{self, Sums},
    contracted::{Contracted, EMPTY_ROW, Row},
    fan::{Fan, FanNode, half},
    table::Table,
};
use crate::{
    expr::{Tape, real::Real, vectorised},
    fan::{Lift, Located, Start},
    geodesic::{End, carry, first_event},
    manifold::Isometry,
};
use glam::{DMat3, DQuat, DVec3};
use std::{borrow::Borrow, ops::Range};

/// How the coefficients of one direction are taken from a patch.
pub(super) type Evaluate = for<'r> fn(&Contracted, f64, f64, &'r mut Row) -> &'r [f64];

/// Paths of a fan, side by side: what has been taken from its patches.
#[derive(Debug, Clone, Default)]
pub struct Courses {
    heads: Vec<Head>,
    /// In order of arc length; `None` where the patch is flagged.
    pieces: Vec<([f64; 2], Option<Piece>)>,
    /// Rows as [`arc::unfold`] makes them.
    coefficients: Vec<f64>,
}

/// What is known of a path beside its polynomials.
#[derive(Debug, Clone)]
struct Head {
    start: Start,
    /// The stored ray's start and tangent.
    u: DVec3,
    v: DVec3,
    /// Takes the stored ray to the true one.
    isometry: Isometry,
    pieces: Range<usize>,
}

impl Courses {
    /// Forgets all.
    pub fn clear(&mut self) {
        self.heads.clear();
        self.pieces.clear();
        self.coefficients.clear();
    }

    /// Takes up a ray of `table` from the patches of `node` around it; its number.
    pub(super) fn add(
        &mut self,
        table: &Table,
        node: &FanNode,
        located: Located,
        evaluate: Evaluate,
    ) -> usize {
        let first = self.pieces.len();
        let direction = match table.space.sphere() {
            Some(sphere) => sphere.parameters(located.aim()),
            None => located.direction,
        };
        let arc_axis = table.space.directions();
        let from = (&located, arc_axis);
        self.collect(node, from, direction, [0.0, table.length], evaluate);
        self.heads.push(Head {
            start: table.space.lift().start(located.u, located.v),
            u: located.u,
            v: located.v,
            isometry: located.isometry,
            pieces: first..self.pieces.len(),
        });
        self.heads.len() - 1
    }

    /// Takes the polynomials of the located ray from all patches that hold it, at parameters `direction`
    /// of what `node` covers; `arc_axis` is the number of the axis of arc length.
    fn collect(
        &mut self,
        node: &FanNode,
        (located, arc_axis): (&Located, usize),
        mut direction: [f64; 2],
        interval: [f64; 2],
        evaluate: Evaluate,
    ) {
        match node {
            FanNode::Flagged => self.pieces.push((interval, None)),
            FanNode::Faces(faces) => {
                let face = &faces[located.face];
                let from = (located, arc_axis);
                self.collect(face, from, located.direction, interval, evaluate);
            }
            FanNode::Split { axis, halves } if *axis == arc_axis => {
                let middle = 0.5 * (interval[0] + interval[1]);
                let parts = [[interval[0], middle], [middle, interval[1]]];
                for (half, part) in halves.iter().zip(parts) {
                    self.collect(half, (located, arc_axis), direction, part, evaluate);
                }
            }
            FanNode::Split { axis, halves } => {
                let (side, inner) = half(direction[*axis]);
                direction[*axis] = inner;
                let from = (located, arc_axis);
                self.collect(&halves[side], from, direction, interval, evaluate);
            }
            FanNode::Leaf(table) => {
                let mut row = EMPTY_ROW;
                let stored = evaluate(table, direction[0], direction[1], &mut row);
                let (start, channels) = (self.coefficients.len(), table.channels());
                let degrees = arc::unfold(stored, channels, interval, &mut self.coefficients);
                let rows = (start, 2 * channels * degrees);
                self.pieces.push((interval, Some(Piece { interval, rows })));
            }
        }
    }
}

/// Arc lengths summed at once.
const LANES: usize = 16;

/// Values and their slopes in the arc length, or points and tangents: three components each, at `W`
/// arc lengths.
type State<const W: usize> = [[[f64; W]; 3]; 2];

/// One lane of three components.
fn lane<const W: usize>(lanes: &[[f64; W]; 3], lane: usize) -> DVec3 {
    DVec3::new(lanes[0][lane], lanes[1][lane], lanes[2][lane])
}

/// Points and tangents carried by an isometry.
#[inline(always)]
fn carried<const W: usize>(isometry: &Isometry, state: State<W>) -> State<W> {
    match isometry {
        Isometry::Identity => state,
        Isometry::Affine(q, t) => moved((q, *t), &state),
        Isometry::Left { p, first, tape } => {
            translated(*p, tape, &moved((&first.0, first.1), &state))
        }
    }
}

/// Points and tangents carried by `u -> Q u + t`.
#[inline(always)]
fn moved<const W: usize>((q, t): (&DMat3, DVec3), state: &State<W>) -> State<W> {
    [affine(q, t, &state[0]), affine(q, DVec3::ZERO, &state[1])]
}

/// Points and tangents carried by the left translation by `p`: the tape gives the image and then
/// the rows of the differential.
#[inline(always)]
fn translated<const W: usize>(p: DVec3, tape: &Tape, state: &State<W>) -> State<W> {
    let mut registers = tape.registers::<f64, W>();
    for c in 0..3 {
        *registers.input(c) = state[0][c];
        *registers.input(3 + c) = [p[c]; W];
    }
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

/// `Q x + t` lane by lane.
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

/// A piece of a path: polynomials in the arc length.
#[derive(Debug, Clone, Copy)]
struct Piece {
    interval: [f64; 2],
    /// Where its rows start and how many they are.
    rows: (usize, usize),
}

/// The most that one step of a transport along a stored path may be off, radians: far below any
/// promise.
const TRANSPORT_TOLERANCE: f64 = 1e-7;

/// One path of a fan: its own, or one of many.
#[derive(Debug, Clone)]
pub struct FanPath<'f, 't, C = Courses> {
    fan: &'f Fan<'t>,
    courses: C,
    number: usize,
}

impl<'f, 't, C> FanPath<'f, 't, C> {
    /// The path of `fan` that has this number among `courses`.
    pub(super) fn new(fan: &'f Fan<'t>, courses: C, number: usize) -> Self {
        Self {
            fan,
            courses,
            number,
        }
    }
}

impl<C: Borrow<Courses>> FanPath<'_, '_, C> {
    fn head(&self) -> &Head {
        &self.courses.borrow().heads[self.number]
    }

    fn pieces(&self) -> &[([f64; 2], Option<Piece>)] {
        &self.courses.borrow().pieces[self.head().pieces.clone()]
    }

    /// The first arc length at which the table gives up; infinite if it never does.
    pub fn flagged_from(&self) -> f64 {
        let first = self.pieces().iter().find(|(_, piece)| piece.is_none());
        first.map_or(f64::INFINITY, |(interval, _)| interval[0])
    }

    fn piece(&self, s: f64) -> Option<&Piece> {
        let pieces = self.pieces();
        let after = pieces.partition_point(|(interval, _)| interval[1] < s);
        let (_, piece) = pieces.get(after.min(pieces.len() - 1))?;
        piece.as_ref()
    }

    /// Chart point and tangent (chart components) at arc length `s`; `None` where flagged.
    pub fn at(&self, s: f64) -> Option<(DVec3, DVec3)> {
        let state = self.state(&self.sums(self.piece(s)?, &[s]), &[s]);
        Some((lane(&state[0], 0), lane(&state[1], 0)))
    }

    /// The path as a curve s -> (chart point, tangent); not numbers where flagged.
    fn curve(&self) -> impl Fn(f64) -> (DVec3, DVec3) {
        |s| self.at(s).unwrap_or((DVec3::NAN, DVec3::NAN))
    }

    /// How and at which arc length the domain ends the path before `length` and before the table
    /// gives up; `None` if it does not.
    pub fn first_event(&self, length: f64) -> Option<(End, f64)> {
        let known = self.flagged_from().min(length);
        first_event(&self.fan.table.space.manifold().domain, known, self.curve())
    }

    /// Chart points and tangents at the ascending arc lengths `s` into `rows`: x, y, z and the
    /// tangent's three components, each as many as there are lengths. Returns how many are known:
    /// the table may give up before the last.
    pub fn sample(&self, s: &[f64], rows: &mut [f64]) -> usize {
        let mut known = 0;
        for (interval, piece) in self.pieces() {
            let last = interval[1] >= self.fan.table.length;
            let end = match last {
                true => s.len(),
                false => known + s[known..].partition_point(|s| *s <= interval[1]),
            };
            match piece {
                None if end > known => return known,
                None => {}
                Some(piece) => self.fill(piece, s, known..end, rows),
            }
            known = end;
        }
        known
    }

    /// The rows of [`FanPath::sample`] at the lengths of `range`, all in `piece`.
    fn fill(&self, piece: &Piece, s: &[f64], range: Range<usize>, rows: &mut [f64]) {
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

    /// Points and tangents at sixteen arc lengths of one piece.
    fn sixteen(&self, piece: &Piece, s: &[f64; LANES]) -> State<LANES> {
        match self.fan.table.space.channels().len() {
            1 => self.sixteen_of::<1>(piece, s),
            2 => self.sixteen_of::<2>(piece, s),
            3 => self.sixteen_of::<3>(piece, s),
            _ => self.sixteen_of::<4>(piece, s),
        }
    }

    /// The same for `K` channels: all in one, sums need not go through memory.
    fn sixteen_of<const K: usize>(&self, piece: &Piece, s: &[f64; LANES]) -> State<LANES> {
        let (start, count) = piece.rows;
        let rows = &self.courses.borrow().coefficients[start..start + count];
        vectorised(
            #[inline(always)]
            || {
                let sums = arc::sums_inline::<K, LANES>(rows, piece.interval, s);
                carried(&self.head().isometry, self.stored_state(&sums, s))
            },
        )
    }

    /// Departures and slopes at `W` arc lengths of one piece.
    fn sums<const W: usize>(&self, piece: &Piece, s: &[f64; W]) -> Sums<W> {
        let (start, count) = piece.rows;
        let rows = &self.courses.borrow().coefficients[start..start + count];
        let channels = self.fan.table.space.channels().len();
        arc::sums(rows, channels, piece.interval, s)
    }

    /// Points and tangents of the stored ray from [`FanPath::sums`].
    #[inline(always)]
    fn stored_state<const W: usize>(&self, sums: &Sums<W>, s: &[f64; W]) -> State<W> {
        let space = &self.fan.table.space;
        let stored = space.channels();
        match space.lift() {
            Lift::None => {}
            Lift::Polar => return self.polar(sums, s),
            Lift::Sphere { .. } => return self.projected(sums, s),
        }
        let (from, along) = (self.head().u, self.head().v);
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

    /// The same where points are stored in polar coordinates.
    #[inline(always)]
    fn polar<const W: usize>(&self, [departure, slope]: &Sums<W>, s: &[f64; W]) -> State<W> {
        let (x, rate) = (self.head().start.x, self.head().start.slope);
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

    /// The same where points are stored on a sphere.
    fn projected<const W: usize>(&self, sums: &Sums<W>, s: &[f64; W]) -> State<W> {
        let space = &self.fan.table.space;
        let mut state = [[[0.0; W]; 3]; 2];
        for l in 0..W {
            let (u, v) = arc::state(space, &self.head().start, sums, l, s[l]);
            for c in 0..3 {
                state[0][c][l] = u[c];
                state[1][c][l] = v[c];
            }
        }
        state
    }

    /// Chart points and tangents of the true ray from [`FanPath::sums`].
    fn state<const W: usize>(&self, sums: &Sums<W>, s: &[f64; W]) -> State<W> {
        vectorised(
            #[inline(always)]
            || carried(&self.head().isometry, self.stored_state(sums, s)),
        )
    }

    /// The transported rotation at `s` relative to the standard frames, by transport along the path;
    /// `None` where flagged, or where the table does not promise tangents.
    pub fn rotation(&self, s: f64) -> Option<DQuat> {
        let table = self.fan.table;
        if !table.frames || self.flagged_from() < s {
            return None;
        }
        let manifold = table.space.manifold();
        let carried = carry(manifold, self.curve(), [0.0, s], TRANSPORT_TOLERANCE);
        Some(carried.ok()?.rotation)
    }
}
