//! Surfaces across which the metric is not smooth, or jumps: steps end there, and the ray crosses them apart.
//!
//! In: the trial steps of all lanes, and the states of the rays at their starts. Out: the [`Meeting`]
//! with the first surface on a step, and the state behind a surface at its start
//! ([`SwitchingSurfaces::cross`]).
//!
//! At a surface `φ(u) = 0` across which the acceleration jumps from `a⁻` to `a⁺`, a neighbour that
//! arrives `−∇φ·δu / ∇φ·v` later bends later by as much: `δv` jumps by
//! `(a⁺ − a⁻) ∇φ·δu / ∇φ·v` (the saltation of a piecewise smooth flow: M. di Bernardo et al.,
//! *Piecewise-smooth Dynamical Systems* (2008), ch. 2.5). Position, tangent and frame stay continuous.
//! Where the metric itself jumps, the ray is refracted or reflected: see [`super::refraction`].

use super::{
    LANES, NIL, Row, Settings, Step, crossing,
    refraction::{EdgeCrossing, EdgeSide, SurfaceMeeting, deflect, turn},
    state::{MOST_ROWS, StateLayout, rates_at, set_vector, turn_by, vector_in},
};
use crate::manifold::Manifold;
use geofan_expr::{Registers, Tape, Wide};
use glam::DVec3;
use std::num::NonZeroU32;

/// Distance before a surface at which a step ends, and beyond it to which a ray is moved, as a share of the arc length and
/// of the distance from the chart's origin. Rounding in `φ` moves the crossing by 1e-16 to 1e-15 of them, and both ends
/// of the move must not lie on one side; it is an error of the position.
pub(super) const ASIDE: f64 = 2e-14;

/// A path that meets a surface at a smaller angle than this runs along it, and rounding decides on
/// which side; nothing can be said about a jump then, and no step ends there. Where the metric itself
/// jumps, the path ends; of frames carried over it, rounding would turn by 1e-16 over the square of the angle.
pub(super) const GRAZING: f64 = 1e-4;

/// A function that changes by more than this multiple of what its derivatives predict has a jump.
const JUMP: f64 = 16.0;

/// More than the numbers of edges of any one metric, for those of two at the same place.
const EDGES: u32 = 4096;

/// Finds the surfaces on the steps of the rays in all lanes.
pub(super) struct SwitchingSurfaces<'m> {
    manifold: &'m Manifold,
    tape: &'m Tape,
    lanes: Registers<f64, LANES>,
    single: Registers<f64, 1>,
    layout: StateLayout,
    flow: &'m Tape,
    rates: Registers<f64, 1>,
    /// The functions' values, and their rates along the path, at the last place looked at.
    before: Vec<[Row; 2]>,
    /// 1 where a function changes its sign on the trial step, or may do so twice, else 0.
    crossed: Row,
    /// The steps to go on with behind the surfaces that rays are about to meet.
    behind: [Option<f64>; LANES],
    /// The edges that rays have met since their last step, as [`Step::edge`] numbers them.
    edges: [Option<NonZeroU32>; LANES],
}

/// A surface met by a trial step.
#[derive(Debug, Clone, Copy)]
pub(super) enum Meeting {
    /// The step would end just before the surface with this length instead; see [`approach`].
    Ahead(f64),
    /// The surface is at the start of the step.
    Here(Crossing),
    /// The ray runs along an edge, and rounding decides on which side.
    Grazing,
}

/// A crossing of a surface at the start of a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crossing {
    /// Distance to move along the tangent.
    distance: f64,
    /// The switching function that vanishes there.
    function: usize,
    surface: Surface,
}

impl Crossing {
    /// Numbers the edge that a ray with tangent `v` meets, as [`Step::edge`] says; `before` is another that it
    /// has met at the same place.
    fn edge(&self, v: DVec3, reflected: bool, before: Option<NonZeroU32>) -> NonZeroU32 {
        let rises = self.surface.gradient.dot(v) > 0.0;
        let own = 4 * self.function as u32 + 2 * u32::from(reflected) + u32::from(rises) + 1;
        let before = before.map_or(0, NonZeroU32::get);
        NonZeroU32::new(before.wrapping_mul(EDGES).wrapping_add(own)).unwrap_or(NonZeroU32::MIN)
    }
}

/// A surface `φ = 0` near a point.
#[derive(Debug, Clone, Copy)]
struct Surface {
    value: f64,
    gradient: DVec3,
}

impl Surface {
    /// Computes what `δv` of a neighbour at `du` gains where the acceleration of a ray with tangent `v` jumps by
    /// `bend`; nothing for a ray along the surface.
    fn gain(&self, v: DVec3, bend: DVec3, du: DVec3) -> DVec3 {
        let late = self.gradient.dot(du) / self.gradient.dot(v);
        if late.is_finite() {
            bend * late
        } else {
            DVec3::ZERO
        }
    }
}

/// The step to take towards a kink at a distance of `length`, where steps of length `usual` are taken
/// otherwise: a little less than all of it, because stages of a step are less exact than its end, by
/// the cube of its length, and none of them may lie behind the kink. Without the margin every second
/// approach to a fish-eye's edge failed; the margin costs one more step.
fn approach(length: f64, usual: f64) -> f64 {
    let share = (length / usual).min(1.0);
    length * (1.0 - 0.1 * share * share)
}

impl<'m> SwitchingSurfaces<'m> {
    /// `None` for a smooth metric.
    pub fn new(manifold: &'m Manifold, settings: Settings) -> Option<Self> {
        let tape = manifold.switching_functions()?;
        let flow = manifold.flow(settings.carried);
        Some(Self {
            manifold,
            tape,
            lanes: tape.registers(),
            single: tape.registers(),
            layout: StateLayout::of(settings),
            flow,
            rates: flow.registers(),
            before: vec![[NIL; 2]; tape.outputs() / 4],
            crossed: NIL,
            behind: [None; LANES],
            edges: [None; LANES],
        })
    }

    /// Begins a ray in `lane`.
    pub fn start(&mut self, lane: usize) {
        self.behind[lane] = None;
        self.edges[lane] = None;
    }

    /// Returns the edge behind which the accepted step in `lane` begins, and forgets it.
    pub fn take_edge(&mut self, lane: usize) -> Option<NonZeroU32> {
        self.edges[lane].take()
    }

    /// Remembers again the edge taken with a step in `lane` that is tried once more.
    pub fn keep_edge(&mut self, lane: usize, edge: Option<NonZeroU32>) {
        self.edges[lane] = edge;
    }

    /// Looks at the trial steps of all lanes at these points with these tangents: at their starts, inside, at
    /// their ends. Besides changes of sign it notes functions that come towards zero at one place and go away
    /// from it at the next: a thin layer may lie between.
    #[inline(always)]
    pub fn look(&mut self, places: [([&Row; 3], [&Row; 3]); 3]) {
        self.crossed = NIL;
        for (place, (point, tangent)) in places.into_iter().enumerate() {
            for (c, row) in point.into_iter().enumerate() {
                *self.lanes.input(c) = **row;
            }
            self.tape.run(&mut self.lanes);
            for (k, [before, rate_before]) in self.before.iter_mut().enumerate() {
                let [now, x, y, z] = [0, 1, 2, 3].map(|c| self.lanes.output(4 * k + c));
                for l in 0..LANES {
                    let rate = x[l] * tangent[0][l] + y[l] * tangent[1][l] + z[l] * tangent[2][l];
                    let (side, side_now) = (before[l] > 0.0, now[l] > 0.0);
                    let changes = side != side_now;
                    let turns = ((rate_before[l] > 0.0) != side) & ((rate > 0.0) == side);
                    let seen = (place > 0) & (changes | turns);
                    self.crossed[l] = if seen { 1.0 } else { self.crossed[l] };
                    (before[l], rate_before[l]) = (now[l], rate);
                }
            }
        }
    }

    /// Returns whether the trial step in `lane` may meet a surface.
    pub fn is_crossed(&self, lane: usize) -> bool {
        self.crossed[lane] > 0.0
    }

    /// Returns the step to try instead of the trial of length `h` in `lane`, which has met a surface.
    pub fn instead(&mut self, lane: usize, meeting: Meeting, h: f64) -> f64 {
        let behind = &mut self.behind[lane];
        match meeting {
            Meeting::Ahead(length) => approach(length, *behind.get_or_insert(h)),
            Meeting::Here(_) | Meeting::Grazing => behind.take().unwrap_or(h),
        }
    }

    /// Returns the step to go on with in `lane` after an accepted one, if that has approached a surface: neither
    /// before nor behind it the error tells anything about the next step.
    pub fn go_on_with(&mut self, lane: usize) -> Option<f64> {
        self.behind[lane].take()
    }

    /// Moves the state `y` and the rates of the ray in `lane` across a surface, or back from an edge that
    /// reflects it; `s` is the arc length there.
    pub fn cross(
        &mut self,
        lane: usize,
        s: f64,
        crossing: Crossing,
        (y, rates): (&mut [Row], &mut [Row]),
    ) {
        let mut there = [Wide([0.0]); MOST_ROWS];
        for (there, y) in there.iter_mut().zip(&*y) {
            there[0] = y[lane];
        }
        let (u, v, before) = (
            vector_in(y, lane, 0),
            vector_in(y, lane, 3),
            vector_in(rates, lane, 3),
        );
        let beyond = u + v * crossing.distance;
        let [near, far] = [u, beyond].map(|u| EdgeSide::at(self.manifold, u));
        let behind = match near.differs(&far) && self.parts(crossing, u, beyond) {
            true => {
                let sides = [near, far];
                let (behind, reflected) =
                    self.deflect(s, crossing, sides, [u, v, before], &mut there);
                self.edges[lane] = Some(crossing.edge(v, reflected, self.edges[lane]));
                behind
            }
            false => self.go_through(crossing, [v, before], &mut there),
        };
        for (row, (y, rates)) in y.iter_mut().zip(rates).enumerate() {
            y[lane] = there[row][0];
            rates[lane] = behind[row][0];
        }
    }

    /// Returns whether the surface of `crossing` lies between two points.
    fn parts(&mut self, crossing: Crossing, a: DVec3, b: DVec3) -> bool {
        let [a, b] = [a, b].map(|u| self.surface(crossing.function, u).value > 0.0);
        a != b
    }

    /// Moves the state `there` through a surface where the metric is continuous, and returns its rates there.
    fn go_through(
        &mut self,
        crossing: Crossing,
        [v, before]: [DVec3; 2],
        there: &mut [Wide<f64, 1>; MOST_ROWS],
    ) -> [Wide<f64, 1>; MOST_ROWS] {
        for c in 0..3 {
            there[c][0] += crossing.distance * v[c];
        }
        let behind = self.rates(there);
        let Some(at) = self.layout.deviation else {
            return behind;
        };
        let bend = vector_in(&behind, 0, 3) - before;
        for column in [at, at + 6] {
            let gain = crossing.surface.gain(v, bend, vector_in(there, 0, column));
            for c in 0..3 {
                there[column + 3 + c][0] += gain[c];
            }
        }
        self.rates(there)
    }

    /// Refracts or reflects the state `there` at an edge, and returns its rates behind it and whether it is
    /// reflected.
    fn deflect(
        &mut self,
        s: f64,
        crossing: Crossing,
        [near, far]: [EdgeSide; 2],
        [u, v, a]: [DVec3; 3],
        there: &mut [Wide<f64, 1>; MOST_ROWS],
    ) -> ([Wide<f64, 1>; MOST_ROWS], bool) {
        let gradient = crossing.surface.gradient;
        let (deflected, reflected) = deflect(&near, &far, gradient, v);
        let (distance, side) = match reflected {
            true => (0.0, &near),
            false => (crossing.distance, &far),
        };
        // Position, tangent and frame.
        set_vector(there, 0, u + v * distance);
        set_vector(there, 3, deflected);
        if let Some(at) = self.layout.turn {
            let turned = turn((&near, v), (side, deflected));
            turn_by(there, at, |carried| turned * carried);
        }
        let behind = self.rates(there);
        let Some(at) = self.layout.deviation else {
            return (behind, reflected);
        };
        // Neighbours.
        let edge = EdgeCrossing {
            manifold: self.manifold,
            u: u + v * (0.5 * crossing.distance),
            aside: crossing.distance.abs() * v.length(),
            reflected,
        };
        let meeting = SurfaceMeeting {
            gradient,
            before: [v, a],
            behind: [deflected, vector_in(&behind, 0, 3)],
            extent: s * v.length() + u.length(),
        };
        for column in [at, at + 6] {
            let deviation = [0, 3].map(|c| vector_in(there, 0, column + c));
            let [du, dv] = meeting.deviation(deviation, |place, change| {
                edge.deflected(&meeting, [place, change], |u| {
                    let surface = self.surface(crossing.function, u);
                    (surface.value, surface.gradient)
                })
            });
            set_vector(there, column, du);
            set_vector(there, column + 3, dv);
        }
        (self.rates(there), reflected)
    }

    fn rates(&mut self, y: &[Wide<f64, 1>]) -> [Wide<f64, 1>; MOST_ROWS] {
        let mut rates = [Wide([0.0]); MOST_ROWS];
        rates_at(self.flow, &mut self.rates, self.layout, y, &mut rates);
        rates
    }

    /// Finds the first surface on the trial `step`, if there is one. Of a step that looks `straight` the control of the error has
    /// seen nothing between two crossings of a surface.
    pub fn meeting(&mut self, step: &Step, straight: bool) -> Option<Meeting> {
        let (u, v) = (step.position(step.start), step.tangent(step.start));
        let aside = aside(step, u, v);
        let ((at, grazing), k) = self.first_crossed(step, aside, straight)?;
        let before = at - step.start - aside;
        // On an axis of textbook coordinates their cuts meet, and a little beside it rounding spoils all rates.
        if !(before > aside) && self.manifold.is_on_axis(u) {
            return None;
        }
        Some(match before > aside {
            true => Meeting::Ahead(before),
            false if grazing => Meeting::Grazing,
            false => Meeting::Here(self.over(k, u, v, before + 2.0 * aside)),
        })
    }

    /// Finds the function that is first crossed on `step`, where, and whether it is an edge that the path grazes. Of several
    /// within `aside` of each other it is one that vanishes there: a function of what jumps jumps where that does, and says
    /// nothing about the surface.
    fn first_crossed(
        &mut self,
        step: &Step,
        aside: f64,
        straight: bool,
    ) -> Option<((f64, bool), usize)> {
        let functions = self.tape.outputs() / 4;
        let mut crossed: Vec<_> = (0..functions)
            .filter_map(|k| Some((self.crossed(k, step, straight)?, k)))
            .collect();
        crossed.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
        let first = *crossed.first()?;
        crossed.retain(|((at, _), _)| *at <= first.0.0 + aside);
        if crossed.len() == 1 {
            return Some(first);
        }
        let mut crossed = crossed.into_iter();
        let vanishing =
            crossed.find(|((at, _), k)| !self.jumps(*k, step, [at - aside, at + aside]));
        Some(vanishing.unwrap_or(first))
    }

    /// Returns whether function `k` changes between two arc lengths by far more than its rates there tell.
    fn jumps(&mut self, k: usize, step: &Step, ends: [f64; 2]) -> bool {
        let [a, b] = ends.map(|s| {
            let surface = self.surface(k, step.position(s));
            (surface.value, surface.gradient.dot(step.tangent(s)))
        });
        (b.0 - a.0).abs() > JUMP * (a.1.abs() + b.1.abs()) * (ends[1] - ends[0])
    }

    /// Returns the crossing that moves at least `least` along the tangent: farther for a surface that is met at a small angle,
    /// where rounding in `φ` moves the crossing farther.
    fn over(&mut self, k: usize, u: DVec3, v: DVec3, least: f64) -> Crossing {
        let surface = self.surface(k, u);
        let side = |surface: Surface| surface.value > 0.0;
        let mut distance = least;
        // Up to where the angle is GRAZING.
        while distance < least / GRAZING && side(self.surface(k, u + v * distance)) == side(surface)
        {
            distance *= 2.0;
        }
        Crossing {
            distance,
            function: k,
            surface,
        }
    }

    /// Finds where surface `k` is first crossed on `step`, and whether it is an edge that the path grazes.
    fn crossed(&mut self, k: usize, step: &Step, straight: bool) -> Option<(f64, bool)> {
        let middle = 0.5 * (step.start + step.end);
        let first = self.crossed_between(k, step, [step.start, middle], straight);
        first.or_else(|| self.crossed_between(k, step, [middle, step.end], straight))
    }

    /// Finds the first crossing within half a step. A surface that is met at a small angle, or crossed twice,
    /// is left to the control of the error unless it is an edge, or the step looks `straight`, or it is an exit's.
    fn crossed_between(
        &mut self,
        k: usize,
        step: &Step,
        [low, high]: [f64; 2],
        straight: bool,
    ) -> Option<(f64, bool)> {
        let [start, end] = [low, high].map(|s| step.position(s));
        let (before, after) = (self.surface(k, start), self.surface(k, end));
        if !(before.value.is_finite() && after.value.is_finite()) {
            return None;
        }
        let sign = if before.value > 0.0 { -1.0 } else { 1.0 };
        let value = |this: &mut Self, s: f64| sign * this.surface(k, step.position(s)).value;
        if (before.value > 0.0) == (after.value > 0.0) {
            let nearest = self.nearest(k, step, sign, [low, high])?;
            if !(value(self, nearest) > 0.0) {
                return None;
            }
            let at = crossing(low, nearest, |s| value(self, s));
            let edge = self.edge_at(k, step, at);
            // The control of the error sees nothing of exits.
            let unseen = straight || k >= self.manifold.metric_switches();
            let clear = unseen && self.slope(k, step, at) >= GRAZING;
            return edge.or(clear.then_some((at, false)));
        }
        let at = crossing(low, high, |s| value(self, s));
        let steepest = after.gradient.length().max(before.gradient.length());
        let reach = (end - start).length() * steepest;
        let small = before.value.abs().max(after.value.abs()) < GRAZING * reach;
        if small || self.slope(k, step, at) < GRAZING {
            let edge = self.edge_at(k, step, at);
            return edge.or((!small).then_some((at, false)));
        }
        Some((at, false))
    }

    /// Finds the place between `low` and `high` where a function that comes towards zero there turns back;
    /// `None` if it does not. `sign` makes the function negative at both ends.
    fn nearest(&mut self, k: usize, step: &Step, sign: f64, [low, high]: [f64; 2]) -> Option<f64> {
        let mut falls = |s: f64| {
            let rate = self
                .surface(k, step.position(s))
                .gradient
                .dot(step.tangent(s));
            -sign * rate
        };
        (falls(low) < 0.0 && falls(high) > 0.0).then(|| crossing(low, high, falls))
    }

    /// Returns the crossing at `at` if surface `k` is an edge there, and whether the path grazes it.
    fn edge_at(&mut self, k: usize, step: &Step, at: f64) -> Option<(f64, bool)> {
        let (u, v) = (step.position(at), step.tangent(at));
        let gradient = self.surface(k, u).gradient;
        let normal = gradient.normalize() * (2.0 * aside(step, u, v) * v.length());
        let [a, b] = [u - normal, u + normal].map(|u| EdgeSide::at(self.manifold, u));
        a.differs(&b)
            .then(|| (at, self.slope(k, step, at) < GRAZING))
    }

    /// Computes the sine of the angle (in the chart) at which the path meets surface `k` at `at`.
    fn slope(&mut self, k: usize, step: &Step, at: f64) -> f64 {
        let (gradient, v) = (
            self.surface(k, step.position(at)).gradient,
            step.tangent(at),
        );
        gradient.dot(v).abs() / (gradient.length() * v.length())
    }

    fn surface(&mut self, k: usize, u: DVec3) -> Surface {
        for c in 0..3 {
            *self.single.input(c) = [u[c]];
        }
        self.tape.run(&mut self.single);
        let output = |c: usize| self.single.output(4 * k + c)[0];
        Surface {
            value: output(0),
            gradient: DVec3::new(output(1), output(2), output(3)),
        }
    }
}

/// Returns the arc length beside a surface at which a path through `u` with the tangent `v` is clear of it.
fn aside(step: &Step, u: DVec3, v: DVec3) -> f64 {
    ASIDE * (step.end + u.length() / v.length())
}
