//! What is left of the table when the camera is fixed.
//!
//! In: the chunks of a table around one camera position. Out: a [`Fan`], all paths from there, and
//! from it single [`FanPath`]s: position, tangent and transported rotation at any arc length.

use super::{
    arc::{self, Sums},
    contracted::{Contracted, EMPTY_ROW},
    table::Table,
    tree::Tree,
};
use crate::{
    expr::{Tape, real::Real, vectorised},
    fan::{Image, Lift, Located, Place, Start},
    geodesic::{End, first_event, transport},
    manifold::Isometry,
};
use glam::{DMat3, DQuat, DVec3};
use std::{ops::Range, sync::Arc};

/// A tree at one camera: only direction (axes 0, 1) and arc length (axis 2) are left.
#[derive(Debug, Clone)]
pub(super) enum FanNode {
    Split {
        axis: usize,
        halves: Box<[FanNode; 2]>,
    },
    Leaf(Contracted),
    Flagged,
}

/// The local coordinate in the half that holds `x`, and which half it is.
pub fn half(x: f64) -> (usize, f64) {
    if x < 0.0 {
        (0, 2.0 * x + 1.0)
    } else {
        (1, 2.0 * x - 1.0)
    }
}

impl FanNode {
    pub(super) fn contract(tree: &Tree, camera: &[f64]) -> Self {
        match tree {
            Tree::Flagged => Self::Flagged,
            Tree::Leaf(tensor) => Self::Leaf(tensor.contract(camera)),
            Tree::Split { axis, halves } if *axis < camera.len() => {
                let mut camera = camera.to_vec();
                let (side, inner) = half(camera[*axis]);
                camera[*axis] = inner;
                Self::contract(&halves[side], &camera)
            }
            Tree::Split { axis, halves } => Self::Split {
                axis: axis - camera.len(),
                halves: Box::new(halves.each_ref().map(|half| Self::contract(half, camera))),
            },
        }
    }
}

/// All paths from one camera position.
#[derive(Debug, Clone)]
pub struct Fan<'t> {
    table: &'t Table,
    /// The camera position.
    pub place: Place,
    faces: Vec<Facet>,
}

/// The directions of one face: where they are stored, and the mirror that carries them there.
#[derive(Debug, Clone)]
pub(super) struct Facet {
    pub(super) node: Arc<FanNode>,
    pub(super) image: Option<Image>,
}

impl<'t> Fan<'t> {
    /// The paths from `place`, where the chunks of its cell are contracted to `faces`.
    pub(super) fn new(table: &'t Table, place: Place, faces: Vec<Facet>) -> Self {
        Self {
            table,
            place,
            faces,
        }
    }

    /// The path in the direction `d` (standard frame, unit).
    pub fn path(&self, d: DVec3) -> FanPath<'_, 't> {
        let located = self.table.space.locate(&self.place, d);
        let facet = &self.faces[located.face];
        let located = located.carried(facet.image.as_ref());
        let lift = self.table.space.lift();
        let mut path = FanPath {
            fan: self,
            start: lift.start(located.u, located.v),
            pieces: Vec::new(),
            coefficients: Vec::new(),
            located,
        };
        let mut direction = [0.0; 2];
        direction[..path.located.direction.len()].copy_from_slice(&path.located.direction);
        path.collect(&facet.node, direction, [0.0, self.table.length]);
        path
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

/// One path of a fan.
#[derive(Debug, Clone)]
pub struct FanPath<'f, 't> {
    fan: &'f Fan<'t>,
    start: Start,
    located: Located,
    /// In order of arc length; `None` where the patch is flagged.
    pieces: Vec<([f64; 2], Option<Piece>)>,
    /// Rows as [`arc::unfold`] makes them.
    coefficients: Vec<f64>,
}

impl FanPath<'_, '_> {
    fn collect(&mut self, node: &FanNode, direction: [f64; 2], interval: [f64; 2]) {
        match node {
            FanNode::Flagged => self.pieces.push((interval, None)),
            FanNode::Split { axis, halves } if *axis == self.arc_axis() => {
                let middle = 0.5 * (interval[0] + interval[1]);
                self.collect(&halves[0], direction, [interval[0], middle]);
                self.collect(&halves[1], direction, [middle, interval[1]]);
            }
            FanNode::Split { axis, halves } => {
                let mut direction = direction;
                let (side, inner) = half(direction[*axis]);
                direction[*axis] = inner;
                self.collect(&halves[side], direction, interval);
            }
            FanNode::Leaf(table) => {
                let mut row = EMPTY_ROW;
                let stored = table.direction(direction[0], direction[1], &mut row);
                let (start, channels) = (self.coefficients.len(), table.channels());
                let degrees = arc::unfold(stored, channels, interval, &mut self.coefficients);
                let rows = (start, 2 * channels * degrees);
                self.pieces.push((interval, Some(Piece { interval, rows })));
            }
        }
    }

    fn arc_axis(&self) -> usize {
        self.fan.table.space.directions()
    }

    /// The first arc length at which the table gives up; infinite if it never does.
    pub fn flagged_from(&self) -> f64 {
        let first = self.pieces.iter().find(|(_, piece)| piece.is_none());
        first.map_or(f64::INFINITY, |(interval, _)| interval[0])
    }

    fn piece(&self, s: f64) -> Option<&Piece> {
        let after = self.pieces.partition_point(|(interval, _)| interval[1] < s);
        let (_, piece) = self.pieces.get(after.min(self.pieces.len() - 1))?;
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
        for (interval, piece) in &self.pieces {
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
            let sums = self.sums(piece, &lengths);
            let state = self.state(&sums, &lengths);
            for (row, lanes) in rows.chunks_exact_mut(s.len()).zip(state.as_flattened()) {
                row[start..start + count].copy_from_slice(&lanes[..count]);
            }
        }
    }

    /// Departures and slopes at `W` arc lengths of one piece.
    fn sums<const W: usize>(&self, piece: &Piece, s: &[f64; W]) -> Sums<W> {
        let (start, count) = piece.rows;
        let rows = &self.coefficients[start..start + count];
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
        let (from, along) = (self.located.u, self.located.v);
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
        let (x, rate) = (self.start.x, self.start.slope);
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
            let (u, v) = arc::state(space, &self.start, sums, l, s[l]);
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
            || carried(&self.located.isometry, self.stored_state(sums, s)),
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
        let carried = transport(manifold, self.curve(), [0.0, s], TRANSPORT_TOLERANCE);
        Some(carried.ok()?.rotation)
    }
}
