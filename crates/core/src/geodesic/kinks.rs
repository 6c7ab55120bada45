//! Where the metric has a kink: steps end there, the ray hops over it, and its deviation jumps.
//!
//! In: the trial steps of all lanes, and the states of the rays at their starts. Out: the [`Meeting`]
//! with the first kink on a step, and the state behind a kink at its start ([`Kinks::hop`]).
//!
//! At a surface `φ(u) = 0` across which the acceleration jumps from `a⁻` to `a⁺`, a neighbour that
//! arrives `−∇φ·δu / ∇φ·v` later bends later by as much: `δv` jumps by
//! `(a⁺ − a⁻) ∇φ·δu / ∇φ·v` (the saltation of a piecewise smooth flow: M. di Bernardo et al.,
//! *Piecewise-smooth Dynamical Systems* (2008), ch. 2.5). Position, tangent and frame stay continuous.

use super::{
    LANES, NIL, Row, Settings, Step, crossing,
    state::{Layout, MOST_ROWS, rates_at},
};
use crate::manifold::Manifold;
use geofan_expr::{Registers, Tape, Wide};
use glam::DVec3;

/// How near a kink a step ends, and a hop beyond it, as a share of the arc length and of the distance
/// from the chart's origin. Rounding in `φ` moves the crossing by 1e-16 to 1e-15 of them, and both ends
/// of a hop must not lie on one side; the hop is an error of the position.
const ASIDE: f64 = 2e-14;

/// A path that meets a surface at a smaller angle than this runs along it, and rounding decides on
/// which side; nothing can be said about a jump then, and no step ends there.
const GRAZING: f64 = 1e-4;

/// Finds kinks on the steps of the rays in all lanes.
pub(super) struct Kinks<'m> {
    tape: &'m Tape,
    lanes: Registers<f64, LANES>,
    single: Registers<f64, 1>,
    layout: Layout,
    flow: &'m Tape,
    rates: Registers<f64, 1>,
    /// The functions' values at the last place looked at.
    before: Vec<Row>,
    /// 1 where a function changes its sign on the trial step, else 0.
    crossed: Row,
    /// The steps to go on with behind the kinks that rays are about to meet.
    behind: [Option<f64>; LANES],
}

/// How a trial step meets a kink.
#[derive(Debug, Clone, Copy)]
pub(super) enum Meeting {
    /// It would end just before the kink with this length instead; see [`approach`].
    Ahead(f64),
    /// The kink is at the start of the step.
    Here(Hop),
}

/// How to get over a kink.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hop {
    /// How far to move along the tangent.
    way: f64,
    surface: Surface,
}

/// A surface `φ = 0` near a point.
#[derive(Debug, Clone, Copy)]
struct Surface {
    value: f64,
    gradient: DVec3,
}

impl Surface {
    /// What `δv` of a neighbour at `du` gains where the acceleration of a ray with tangent `v` jumps by
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

impl<'m> Kinks<'m> {
    /// `None` for a smooth metric.
    pub fn new(manifold: &'m Manifold, settings: Settings) -> Option<Self> {
        let tape = manifold.kinks()?;
        let flow = manifold.flow(settings.carried);
        Some(Self {
            tape,
            lanes: tape.registers(),
            single: tape.registers(),
            layout: Layout::of(settings),
            flow,
            rates: flow.registers(),
            before: vec![NIL; tape.outputs() / 4],
            crossed: NIL,
            behind: [None; LANES],
        })
    }

    /// Begins a ray in `lane`.
    pub fn start(&mut self, lane: usize) {
        self.behind[lane] = None;
    }

    /// Looks at the trial steps of all lanes at these points: at their starts, inside, at their ends.
    #[inline(always)]
    pub fn look(&mut self, places: [[&Row; 3]; 3]) {
        self.crossed = NIL;
        for (place, point) in places.into_iter().enumerate() {
            for (c, row) in point.into_iter().enumerate() {
                *self.lanes.input(c) = **row;
            }
            self.tape.run(&mut self.lanes);
            for (k, before) in self.before.iter_mut().enumerate() {
                let now = self.lanes.output(4 * k);
                for l in 0..LANES {
                    let changes = (place > 0) & ((before[l] > 0.0) != (now[l] > 0.0));
                    self.crossed[l] = if changes { 1.0 } else { self.crossed[l] };
                    before[l] = now[l];
                }
            }
        }
    }

    /// Whether the trial step in `lane` may meet a kink.
    pub fn is_crossed(&self, lane: usize) -> bool {
        self.crossed[lane] > 0.0
    }

    /// The step to try instead of the trial of length `h` in `lane`, which has met a kink.
    pub fn instead(&mut self, lane: usize, meeting: Meeting, h: f64) -> f64 {
        let behind = &mut self.behind[lane];
        match meeting {
            Meeting::Ahead(length) => approach(length, *behind.get_or_insert(h)),
            Meeting::Here(_) => behind.take().unwrap_or(h),
        }
    }

    /// The step to go on with in `lane` after an accepted one, if that has approached a kink: neither
    /// before nor behind it the error tells anything about the next step.
    pub fn go_on_with(&mut self, lane: usize) -> Option<f64> {
        self.behind[lane].take()
    }

    /// Moves the state `y` and the rates of the ray in `lane` over a kink.
    pub fn hop(&mut self, lane: usize, hop: Hop, y: &mut [Row], rates: &mut [Row]) {
        let mut there = [Wide([0.0]); MOST_ROWS];
        for (there, y) in there.iter_mut().zip(&*y) {
            there[0] = y[lane];
        }
        let (v, before) = (vector(y, lane, 3), vector(rates, lane, 3));
        for c in 0..3 {
            there[c][0] += hop.way * v[c];
        }
        let mut behind = self.rates(&there);
        if let Some(at) = self.layout.deviation {
            let bend = vector(&behind, 0, 3) - before;
            for column in [at, at + 6] {
                let gain = hop.surface.gain(v, bend, vector(&there, 0, column));
                for c in 0..3 {
                    there[column + 3 + c][0] += gain[c];
                }
            }
            behind = self.rates(&there);
        }
        for (row, (y, rates)) in y.iter_mut().zip(rates).enumerate() {
            y[lane] = there[row][0];
            rates[lane] = behind[row][0];
        }
    }

    fn rates(&mut self, y: &[Wide<f64, 1>]) -> [Wide<f64, 1>; MOST_ROWS] {
        let mut rates = [Wide([0.0]); MOST_ROWS];
        rates_at(self.flow, &mut self.rates, self.layout, y, &mut rates);
        rates
    }

    /// The first kink on the trial `step`, if there is one.
    pub fn meeting(&mut self, step: &Step) -> Option<Meeting> {
        let functions = self.tape.outputs() / 4;
        let crossed = (0..functions).filter_map(|k| Some((self.crossed(k, step)?, k)));
        let (at, k) = crossed.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let (u, v) = (step.position(step.start), step.tangent(step.start));
        let aside = ASIDE * (step.end + u.length() / v.length());
        let before = at - step.start - aside;
        Some(match before > aside {
            true => Meeting::Ahead(before),
            false => Meeting::Here(self.over(k, u, v, before + 2.0 * aside)),
        })
    }

    /// Moves at least `least` along the tangent: farther for a surface that is met at a small angle,
    /// where rounding in `φ` moves the crossing farther.
    fn over(&mut self, k: usize, u: DVec3, v: DVec3, least: f64) -> Hop {
        let surface = self.surface(k, u);
        let side = |surface: Surface| surface.value > 0.0;
        let mut way = least;
        // Up to where the angle is GRAZING.
        while way < least / GRAZING && side(self.surface(k, u + v * way)) == side(surface) {
            way *= 2.0;
        }
        Hop { way, surface }
    }

    /// Where surface `k` is first crossed on `step`; one that is crossed twice within half a step is
    /// left to the control of the error.
    fn crossed(&mut self, k: usize, step: &Step) -> Option<f64> {
        let middle = 0.5 * (step.start + step.end);
        let first = self.crossed_between(k, step, [step.start, middle]);
        first.or_else(|| self.crossed_between(k, step, [middle, step.end]))
    }

    fn crossed_between(&mut self, k: usize, step: &Step, [low, high]: [f64; 2]) -> Option<f64> {
        let [start, end] = [low, high].map(|s| step.position(s));
        let (before, after) = (self.surface(k, start), self.surface(k, end));
        let seen = before.value.is_finite() && after.value.is_finite();
        if !seen || (before.value > 0.0) == (after.value > 0.0) {
            return None;
        }
        let steepest = after.gradient.length().max(before.gradient.length());
        let reach = (end - start).length() * steepest;
        if before.value.abs().max(after.value.abs()) < GRAZING * reach {
            return None;
        }
        let sign = if after.value > 0.0 { 1.0 } else { -1.0 };
        Some(crossing(low, high, |s| {
            sign * self.surface(k, step.position(s)).value
        }))
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

/// The vector that begins at row `at`, in `lane`.
fn vector<const W: usize>(rows: &[Wide<f64, W>], lane: usize, at: usize) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|c| rows[at + c][lane]))
}
