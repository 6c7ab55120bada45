//! Faces of a glued domain on the way of rays: steps end there, and the ray goes on where the face's map leads.
//!
//! In: the trial steps of all lanes, and the states of the rays at their starts. Out: the first face that a step
//! crosses, the step to try instead so that it ends there, and the state behind the face.
//!
//! An isometry `φ` takes the point to `φ(u)`, the tangent to `dφ v`, the frame `S(u) R` to `dφ S(u) R`, and a
//! deviation to `(dφ δu, dφ δv + d²φ(v, δu))`: a neighbour is carried by the differential at its own place.
//! Where `φ` turns right into left, the frame is kept as a rotation times a mirroring of its first axis.
//! At a wall that is a mirror the tangent is reflected in the metric, and neighbours meet it at other places
//! with other normals.

use super::{
    LANES, NIL, Row, Settings, Sink, Step, crossing,
    domain_events::PLACES,
    refraction::{EdgeSide, SurfaceMeeting, reflect},
    state::{MOST_ROWS, StateLayout, rates_at, set_vector, turn_by, vector_in},
    step::Curves,
};
use crate::manifold::{Gluing, Manifold};
use geofan_expr::{Registers, Tape, Wide};
use glam::{DMat3, DQuat, DVec3};

/// A face this near, as a share of the arc length and of the distance from the chart's origin, is crossed at
/// once: no step is as short.
const HERE: f64 = 1e-13;

/// Halvings by which a place inside is looked for on a step that starts on a face.
const HALVINGS: i32 = 40;

/// The mirroring of a frame's first axis.
const MIRRORING: DMat3 = DMat3::from_cols_array(&[-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);

/// A face that a lane's step is to end at.
#[derive(Debug, Clone, Copy)]
struct Aim {
    face: usize,
    s: f64,
    /// The step to go on with behind it.
    usual: f64,
}

/// Tells what becomes of a trial step.
#[derive(Debug, Clone, Copy)]
pub(super) enum Leaving {
    /// It is to be tried with this length, and then ends at a face.
    Ahead(f64),
    /// It starts on a face and is to be tried from behind it.
    Here(usize),
    /// It ends at a face; this is the step to go on with.
    Behind(f64),
}

/// Finds and crosses faces on the steps of the rays in all lanes.
pub(super) struct FaceCrossings<'m> {
    manifold: &'m Manifold,
    gluing: &'m Gluing,
    layout: StateLayout,
    flow: &'m Tape,
    rates: Registers<f64, 1>,
    lanes: Registers<f64, LANES>,
    single: Registers<f64, 1>,
    /// The values of all faces, one after the other, at the start of a step and at [`PLACES`] on it.
    along: Vec<f64>,
    /// 1 where a trial may leave, else 0.
    outside: Row,
    /// Set where the next step is looked at whatever it seems.
    doubtful: [bool; LANES],
    aims: [Option<Aim>; LANES],
    due: [Option<usize>; LANES],
    /// Crossings, and whether they have turned right into left.
    crossings: [u32; LANES],
    reversed: [bool; LANES],
}

impl<'m> FaceCrossings<'m> {
    /// `None` for a space that is not glued.
    pub fn new(manifold: &'m Manifold, settings: Settings) -> Option<Self> {
        let gluing = manifold.gluing()?;
        let flow = manifold.flow(settings.carried);
        Some(Self {
            manifold,
            gluing,
            layout: StateLayout::of(settings),
            flow,
            rates: flow.registers(),
            lanes: gluing.values().registers(),
            single: gluing.values().registers(),
            along: Vec::new(),
            outside: NIL,
            doubtful: [false; LANES],
            aims: [None; LANES],
            due: [None; LANES],
            crossings: [0; LANES],
            reversed: [false; LANES],
        })
    }

    /// Begins a ray in `lane`.
    pub fn start(&mut self, lane: usize) {
        self.doubtful[lane] = true;
        (self.aims[lane], self.due[lane]) = (None, None);
        (self.crossings[lane], self.reversed[lane]) = (0, false);
    }

    /// Marks a step of `lane` with what the ray has crossed.
    pub fn mark(&self, lane: usize, step: &mut Step) {
        (step.crossings, step.reversed) = (self.crossings[lane], self.reversed[lane]);
    }

    /// Looks where the trial steps of all lanes leave the domain.
    #[inline(always)]
    pub fn look(&mut self, curves: &Curves) {
        self.outside = NIL;
        for place in PLACES {
            for c in 0..3 {
                *self.lanes.input(c) = *curves.point(c, place);
            }
            self.gluing.values().run(&mut self.lanes);
            for k in 0..self.gluing.faces().len() {
                let (values, guard) = (self.lanes.output(k), -self.gluing.guard(k));
                for (outside, value) in self.outside.iter_mut().zip(values) {
                    *outside = if *value < guard { 1.0 } else { *outside };
                }
            }
        }
    }

    /// Returns whether the trial step in `lane` may leave.
    pub fn may_leave(&self, lane: usize) -> bool {
        self.outside[lane] > 0.0 || self.doubtful[lane] || self.aims[lane].is_some()
    }

    /// Says what becomes of the accepted trial `step` in `lane`; `None` if it stays inside.
    pub fn leaving(&mut self, lane: usize, step: &Step) -> Option<Leaving> {
        let here = self.here(step);
        let found = self.first(step);
        let aim = self.aims[lane].take();
        if let Some(aim) = aim
            && (step.end - aim.s).abs() <= here
            && found.is_none_or(|(s, _)| s >= step.end - here)
        {
            self.due[lane] = Some(aim.face);
            return Some(Leaving::Behind(aim.usual));
        }
        let Some((s, face)) = found else {
            self.doubtful[lane] = false;
            return None;
        };
        if s - step.start <= here {
            return Some(Leaving::Here(face));
        }
        let usual = aim.map_or(step.end - step.start, |aim| aim.usual);
        self.aims[lane] = Some(Aim { face, s, usual });
        Some(Leaving::Ahead(s - step.start))
    }

    /// Returns the arc length within which a face is where the step is.
    fn here(&self, step: &Step) -> f64 {
        let (u, v) = (step.position(step.start), step.tangent(step.start));
        HERE * (step.end + u.length() / v.length())
    }

    /// Finds where `step` first crosses a face, and which: of several at one place that which it lies farthest beyond.
    fn first(&mut self, step: &Step) -> Option<(f64, usize)> {
        self.look_along(step);
        let mut first: Option<(f64, f64, usize)> = None;
        for k in 0..self.gluing.faces().len() {
            let Some(s) = self.crossed(k, step) else {
                continue;
            };
            let depth = self.value(k, step, step.end) / self.gluing.guard(k);
            let here = self.here(step);
            let earlier = first.is_none_or(|(other, deepest, _)| {
                s < other - here || (s < other + here && depth < deepest)
            });
            if earlier {
                first = Some((s, depth, k));
            }
        }
        first.map(|(s, _, k)| (s, k))
    }

    /// Computes the values of all faces at the start of `step` and at [`PLACES`] on it.
    fn look_along(&mut self, step: &Step) {
        self.along.clear();
        let places = PLACES.map(|place| step.place(place));
        for s in [step.start].into_iter().chain(places) {
            self.run_at(step.position(s));
            let faces = 0..self.gluing.faces().len();
            self.along.extend(faces.map(|k| self.single.output(k)[0]));
        }
    }

    /// Finds where `step`, along which the values are known, first crosses face `k` from inside.
    fn crossed(&mut self, k: usize, step: &Step) -> Option<f64> {
        let face = &self.gluing.faces()[k];
        let (bounds, guard) = (!face.is_portal(), self.gluing.guard(k));
        // What comes out of a portal is not inside its other side, in front of which it is by rounding.
        let least = if bounds { 0.0 } else { guard };
        let faces = self.gluing.faces().len();
        let mut before = (step.start, self.along[k]);
        if bounds && before.1 < -guard {
            return Some(step.start);
        }
        for (place, row) in PLACES.iter().zip(1..) {
            let s = step.place(*place);
            let now = (s, self.along[row * faces + k]);
            if now.1 < -guard {
                let inside = match before.1 > least {
                    true => Some(before.0),
                    false if before.1 >= -guard => {
                        self.inside_between((k, least), step, before.0, s)
                    }
                    false => None,
                };
                let at = match inside {
                    Some(inside) => crossing(inside, s, |s| -self.value(k, step, s)),
                    None if bounds => before.0,
                    None => return None,
                };
                if bounds || self.gluing.is_open(k, step.position(at)) {
                    return Some(at);
                }
            }
            before = now;
        }
        None
    }

    /// Finds a place where the value of face `k` is more than `least`, on a step that is on it at `low` and beyond it at
    /// `high`.
    fn inside_between(
        &mut self,
        (k, least): (usize, f64),
        step: &Step,
        low: f64,
        high: f64,
    ) -> Option<f64> {
        let place = |i: i32| low + (high - low) * 0.5_f64.powi(i);
        (1..HALVINGS)
            .map(place)
            .find(|s| self.value(k, step, *s) > least)
    }

    fn value(&mut self, k: usize, step: &Step, s: f64) -> f64 {
        self.run_at(step.position(s));
        self.single.output(k)[0]
    }

    /// Computes the values of all faces at `u`.
    fn run_at(&mut self, u: DVec3) {
        self.gluing.values().run_at(&mut self.single, &u.to_array());
    }

    /// Takes the face that the ray in `lane` stands on and is to cross.
    pub fn due(&mut self, lane: usize) -> Option<usize> {
        self.due[lane].take()
    }

    /// Moves the state `y` of the ray in `lane` and its rates across face `k`, and tells `sink`.
    pub fn cross(
        &mut self,
        (lane, ray): (usize, usize),
        k: usize,
        (y, rates): (&mut [Row], &mut [Row]),
        sink: &mut impl Sink,
    ) {
        let mut there = [Wide([0.0]); MOST_ROWS];
        for (there, y) in there.iter_mut().zip(&*y) {
            there[0] = y[lane];
        }
        match self.gluing.faces()[k].is_mirror() {
            true => self.reflect(k, vector_in(rates, lane, 3), &mut there),
            false => self.carry(k, &mut there),
        }
        let mut behind = [Wide([0.0]); MOST_ROWS];
        rates_at(self.flow, &mut self.rates, self.layout, &there, &mut behind);
        for (row, (y, rates)) in y.iter_mut().zip(rates).enumerate() {
            y[lane] = there[row][0];
            rates[lane] = behind[row][0];
        }
        self.crossings[lane] += 1;
        self.reversed[lane] ^= self.gluing.faces()[k].reverses();
        self.doubtful[lane] = true;
        self.aims[lane] = None;
        sink.crossed(ray, k);
    }

    /// Carries a state by the map of face `k`.
    fn carry(&self, k: usize, there: &mut [Wide<f64, 1>; MOST_ROWS]) {
        let face = &self.gluing.faces()[k];
        let (u, v) = (vector_in(there, 0, 0), vector_in(there, 0, 3));
        let Some((image, d)) = face.carry(u) else {
            return;
        };
        set_vector(there, 0, image);
        set_vector(there, 3, d * v);
        if let Some(at) = self.layout.turn {
            let [from, to] = [u, image].map(|u| self.manifold.standard_frame(u));
            turn(there, at, to.inverse() * d * from, face.reverses());
        }
        if let Some(at) = self.layout.deviation {
            for column in [at, at + 6] {
                let (du, dv) = (vector_in(there, 0, column), vector_in(there, 0, column + 3));
                set_vector(there, column, d * du);
                set_vector(there, column + 3, d * dv + face.bend(u, v, du));
            }
        }
    }

    /// Reflects a state with the acceleration `a` at the mirror `k`.
    fn reflect(&mut self, k: usize, a: DVec3, there: &mut [Wide<f64, 1>; MOST_ROWS]) {
        let (u, v) = (vector_in(there, 0, 0), vector_in(there, 0, 3));
        let gradient = self.gluing.gradient(k, u);
        let side = EdgeSide::at(self.manifold, u);
        let after = reflect(&side, gradient, v);
        if let Some(at) = self.layout.turn {
            // The reflection that takes the one direction of sight to the other.
            let [from, to] = [v, after].map(|v| side.direction(v));
            let n = (from - to).normalize_or_zero();
            let outer = DMat3::from_cols(n * n.x, n * n.y, n * n.z);
            turn(there, at, DMat3::IDENTITY - outer * 2.0, true);
        }
        set_vector(there, 3, after);
        let Some(at) = self.layout.deviation else {
            return;
        };
        let mut behind = [Wide([0.0]); MOST_ROWS];
        rates_at(self.flow, &mut self.rates, self.layout, there, &mut behind);
        let meeting = SurfaceMeeting {
            gradient,
            before: [v, a],
            behind: [after, vector_in(&behind, 0, 3)],
            extent: self.gluing.size(),
        };
        for column in [at, at + 6] {
            let deviation = [0, 3].map(|c| vector_in(there, 0, column + c));
            let [du, dv] = meeting.deviation(deviation, |place, change| {
                Some(self.reflected(k, u + place, v + change))
            });
            set_vector(there, column, du);
            set_vector(there, column + 3, dv);
        }
    }

    /// Reflects the tangent `v` of a neighbour at the place of mirror `k` next to `u`.
    fn reflected(&self, k: usize, mut u: DVec3, v: DVec3) -> DVec3 {
        let mut gradient = self.gluing.gradient(k, u);
        // Newton's method, back to the wall.
        for _ in 0..3 {
            let value = self.gluing.values().at(&u.to_array())[k];
            u -= gradient * (value / gradient.length_squared());
            gradient = self.gluing.gradient(k, u);
        }
        reflect(&EdgeSide::at(self.manifold, u), gradient, v)
    }
}

/// Turns the quaternion that begins at row `at` by an orthogonal matrix, which may be a mirroring.
fn turn(there: &mut [Wide<f64, 1>; MOST_ROWS], at: usize, by: DMat3, reverses: bool) {
    turn_by(there, at, |carried| {
        let matrix = by * DMat3::from_quat(carried);
        let matrix = if reverses { matrix * MIRRORING } else { matrix };
        DQuat::from_mat3(&matrix).normalize()
    });
}

/// Returns the frame whose rotation is `turn`, mirrored if its path has been `reversed`.
pub(super) fn carried_frame(turn: DQuat, reversed: bool) -> DMat3 {
    let rotation = DMat3::from_quat(turn);
    if reversed {
        rotation * MIRRORING
    } else {
        rotation
    }
}
