//! The Dormand–Prince pair of orders 5 and 4: its coefficients, the control of its steps, its dense output, and
//! quintic Hermite interpolation.
//!
//! In: the error of a trial step against the tolerance, and its length. Out: whether it is accepted, how long
//! the next one is, and polynomials over it.
//!
//! Coefficients: J. R. Dormand and P. J. Prince, J. Comput. Appl. Math. 6 (1980) 19–26; dense
//! output: E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, II.6
//! (the program `dopri5`).

use super::{LANES, NIL, Row, each};
use geofan_expr::real::Real;
use glam::DVec3;

/// Stages; the last is the first of the next step.
pub(super) const STAGES: usize = 7;

/// Row `i` gives stage `i + 1` from the stages before it; the last row is the new point.
pub(super) const A: [[f64; 6]; 6] = [
    [1.0 / 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0, 0.0],
    [44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0, 0.0],
    [
        19372.0 / 6561.0,
        -25360.0 / 2187.0,
        64448.0 / 6561.0,
        -212.0 / 729.0,
        0.0,
        0.0,
    ],
    [
        9017.0 / 3168.0,
        -355.0 / 33.0,
        46732.0 / 5247.0,
        49.0 / 176.0,
        -5103.0 / 18656.0,
        0.0,
    ],
    [
        35.0 / 384.0,
        0.0,
        500.0 / 1113.0,
        125.0 / 192.0,
        -2187.0 / 6784.0,
        11.0 / 84.0,
    ],
];

/// Fifth-order minus fourth-order weights.
pub(super) const ERROR: [f64; STAGES] = [
    71.0 / 57600.0,
    0.0,
    -71.0 / 16695.0,
    71.0 / 1920.0,
    -17253.0 / 339200.0,
    22.0 / 525.0,
    -1.0 / 40.0,
];

/// Weights of the fourth-order dense output's last term.
pub(super) const DENSE: [f64; STAGES] = [
    -12715105075.0 / 11282082432.0,
    0.0,
    87487479700.0 / 32700410799.0,
    -10690763975.0 / 1880347072.0,
    701980252875.0 / 199316789632.0,
    -1453857185.0 / 822651844.0,
    69997945.0 / 29380423.0,
];

/// Fourth-order dense output of `N` components over one step: the terms of each are its start, its
/// rise, and three bends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Dense<const N: usize>(pub(super) [[f64; 5]; N]);

impl<const N: usize> Dense<N> {
    /// Makes a step that keeps these components all over.
    pub fn still(y: [f64; N]) -> Self {
        Self(y.map(|a| [a, 0.0, 0.0, 0.0, 0.0]))
    }

    /// The components at the fraction `t` of the step.
    pub fn at(&self, t: f64) -> [f64; N] {
        self.0
            .map(|[a, b, c, d, e]| a + t * (b + (1.0 - t) * (c + t * (d + (1.0 - t) * e))))
    }
}

/// A curve over one step that matches position, velocity and acceleration at both ends: error of
/// order h⁶ in the position, h⁵ in the velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quintic {
    /// The polynomial's coefficients in `t` in [0, 1].
    pub(super) coefficients: [DVec3; 6],
    /// The step's length.
    pub(super) h: f64,
}

impl Quintic {
    /// The straight line through `p` with velocity `v`, over a step of 1.
    pub fn straight(p: DVec3, v: DVec3) -> Self {
        let nil = DVec3::ZERO;
        Self {
            coefficients: [p, v, nil, nil, nil, nil],
            h: 1.0,
        }
    }

    /// The position at the fraction `t` of the step.
    pub fn position(&self, t: f64) -> DVec3 {
        let c = &self.coefficients;
        c[0] + (c[1] + (c[2] + (c[3] + (c[4] + c[5] * t) * t) * t) * t) * t
    }

    /// Corners of a box around all positions: every term beyond the first lies between zero and its
    /// coefficient.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let [first, terms @ ..] = self.coefficients;
        let sum = |part: fn(DVec3, DVec3) -> DVec3| {
            let mut sum = first;
            for term in terms {
                sum += part(term, DVec3::ZERO);
            }
            sum
        };
        (sum(DVec3::min), sum(DVec3::max))
    }

    /// The velocity (per unit of `h`'s unit) at the fraction `t` of the step.
    pub fn velocity(&self, t: f64) -> DVec3 {
        let c = &self.coefficients;
        (c[1] + (c[2] * 2.0 + (c[3] * 3.0 + (c[4] * 4.0 + c[5] * (5.0 * t)) * t) * t) * t) / self.h
    }
}

/// Most steps of one ray; more than any honest path needs at the tightest tolerance.
pub const MOST_STEPS: usize = 200_000;

/// A ray that comes on by less than this share of its arc length in so many trials, of which this share is refused, is caught
/// in rounding noise of the metric, as where coordinates lose their digits beside a surface: shorter steps see more of the
/// noise. Its tolerance is ten times as large then, again and again up to the loosest, at which it ends; until it has come on
/// by the larger share, which is beyond the noise if a step came over it.
const COMING_ON: f64 = 1e-3;
const TRIALS: f64 = 400.0;
const REFUSED: f64 = 0.2;
const LOOSEST: f64 = 1e-6;
const BEYOND_NOISE: f64 = 0.03;

/// A step below this share of the arc length already followed cannot advance in double precision.
const SHORTEST_STEP: f64 = 1e-13;

/// No step is longer than this share of the ray (of the way to its exit, where that was found to be much shorter), and
/// a step longer than half of it is looked at once more between its stages, where they leave the widest gap.
///
/// Where space is exactly flat (around a lens, far from a bump) the estimate of the error is zero,
/// and steps that only grow leap over what lies ahead without a stage inside it: without a limit,
/// rays missed the whole of a Luneburg lens. With it, no gap between two evaluations is wider than
/// 1/64 of the ray. The same gap without the look between needs steps of 1/32, and nearly twice the
/// evaluations of a lone bump at a tolerance of 1e-6.
const LONGEST_STEP: f64 = 1.0 / 16.0;

/// A step whose error is below this share of the tolerance, or no more than rounding, looks straight: its stages have seen
/// nothing that bends it.
const STRAIGHT: f64 = 1e-6;
const ROUNDED: f64 = 1e-14;

/// A step that looks straight and meets an exit is tried again where the ray is longer than the way to the exit by more than
/// this factor: its stages lay far beyond the exit, and then no step may be longer than a share of that way.
pub(super) const FAR_BEYOND: f64 = 4.0;

/// Where the first stage behind the start is, as a share of a step.
const FIRST_STAGE: f64 = 0.2;

/// Where a long step is looked at: the middle of the gap between the stages at 0.3 and 0.8.
pub(super) const LOOK: f64 = 0.55;

/// A look that finds an acceleration which bends the tangent over the step by more than the tolerance
/// *and* this many times the step's error estimate has found what the stages missed. Both fall with
/// the fifth power of the step; over the catalogue their ratio is 7 in the middle, 71 at the 99th
/// percentile and 103 at the 99.9th. A tenth of this would repeat many honest steps; ten times as much
/// would overlook weak lenses where the space around is not flat.
const SURPRISE: f64 = 100.0;

/// A step that changes `vᵀGv` by more than this, or this many times the tolerance, has met a change of the metric that its
/// stages have not seen: a layer between two of them, or a jump that no switching function names. Over the scenes of the
/// gallery honest steps change it by 6 times the tolerance at most, over the knots of a sampled field by 240; an index of
/// refraction may jump by half a ten-thousandth unseen. Far out in a chart in which lengths grow without end, rounding of the
/// place moves the metric by more: by some of its units times the distance from the chart's origin and the bend of the path.
const LEAP: f64 = 1e-4;
const LEAP_BY_TOLERANCE: f64 = 100.0;
const LEAP_BY_ROUNDING: f64 = 32.0 * f64::EPSILON;

/// A step that cannot be made shorter is taken all the same if its error is below this: that is a
/// kink of the metric, over which the tangent bends by a bounded rate times the step. Where the
/// metric ends, the error is of order one.
const KINK: f64 = 1e-9;

/// Most growth from one step to the next: more than the error estimate can be trusted for.
const MOST_GROWTH: f64 = 5.0;

/// Step-size control of all lanes: the arc lengths reached and the decisions on trial steps.
pub(super) struct Control {
    tolerance: f64,
    /// Arc length to follow, arc length followed, and the step to try.
    pub length: Row,
    pub s: Row,
    pub h: Row,
    /// The arc length of which no step is longer than a share: that of the ray, or of the way to where it ends, if that
    /// is known.
    reach: Row,
    /// The arc length in which the ray would meet an exit if it were straight, where that is much shorter and no step has
    /// been held against it yet; else infinite.
    straight_end: Row,
    /// The squared error of the trial (radians), and vᵀGv at its end.
    pub error2: Row,
    pub speed2: Row,
    /// The square of the distance from the chart's origin times the acceleration there, by its metric.
    pub moved2: Row,
    /// The squared bend (radians) that a look at a long step found beside what the step knows.
    pub unforeseen2: Row,
    /// Steps tried.
    pub steps: Row,
    /// The arc length from which on the ray is to come on, and the trials made and refused since.
    mark: Row,
    tried: Row,
    refused: Row,
    /// By how much less than it is the squared error counts.
    ease: Row,
    /// Most growth of the next step.
    growth: Row,
    /// 1 where the trial is accepted, else 0.
    pub accepted: Row,
    /// 1 where the path is complete, else 0.
    pub complete: Row,
    /// 1 where no further step is possible, else 0.
    pub stuck: Row,
    /// Arc length and step after the trial.
    next_s: Row,
    next_h: Row,
}

impl Control {
    pub fn new(tolerance: f64) -> Self {
        Self {
            tolerance,
            length: NIL,
            s: NIL,
            h: NIL,
            reach: NIL,
            straight_end: each(|_| f64::INFINITY),
            error2: NIL,
            speed2: NIL,
            moved2: NIL,
            unforeseen2: NIL,
            steps: NIL,
            mark: NIL,
            tried: NIL,
            refused: NIL,
            ease: NIL,
            growth: NIL,
            accepted: NIL,
            complete: NIL,
            stuck: NIL,
            next_s: NIL,
            next_h: NIL,
        }
    }

    /// Begins a ray in `lane` that is followed to an arc length, and would meet an exit in another if it were straight.
    pub fn start(&mut self, lane: usize, [length, straight_end]: [f64; 2], step: f64) {
        self.length[lane] = length;
        self.reach[lane] = length;
        self.straight_end[lane] = straight_end;
        self.s[lane] = 0.0;
        self.h[lane] = step.min(LONGEST_STEP * length);
        self.steps[lane] = 0.0;
        self.mark[lane] = 0.0;
        self.tried[lane] = 0.0;
        self.refused[lane] = 0.0;
        self.ease[lane] = 1.0;
        self.growth[lane] = MOST_GROWTH;
    }

    /// Nobody follows a ray in `lane` any more.
    pub fn stop(&mut self, lane: usize) {
        self.accepted[lane] = 0.0;
        self.length[lane] = 0.0;
        self.next_h[lane] = 0.0;
    }

    /// Returns whether the ray in `lane` may be given another step.
    pub fn may_go_on(&self, lane: usize) -> bool {
        self.steps[lane] < MOST_STEPS as f64
    }

    /// Replaces the judgement of the trial in `lane`: it is not accepted, and `h` is tried instead.
    pub fn try_instead(&mut self, lane: usize, h: f64) {
        self.accepted[lane] = 0.0;
        self.complete[lane] = 0.0;
        self.stuck[lane] = 0.0;
        self.next_s[lane] = self.s[lane];
        self.next_h[lane] = h.min(self.length[lane] - self.s[lane]);
    }

    /// Returns whether the trial in `lane` looks straight.
    pub fn looks_straight(&self, lane: usize) -> bool {
        self.error2[lane] <= (STRAIGHT * self.tolerance).max(ROUNDED).powi(2)
    }

    /// Replaces the judgement of the trial in `lane`, which meets an exit at the arc length `end`, where it looks straight and
    /// its stages lie far beyond: a shorter one is tried. Returns whether it did.
    pub fn try_nearer(&mut self, lane: usize, end: f64) -> bool {
        let far = self.looks_straight(lane) && self.reach[lane] > FAR_BEYOND * end;
        let shorter = LONGEST_STEP * end;
        if !far || !(self.h[lane] > shorter) {
            return false;
        }
        self.reach[lane] = end;
        self.try_instead(lane, shorter);
        true
    }

    /// Replaces the judgement of a trial in `lane` that is long beside the way to the exit straight ahead, and looks straight
    /// or has all of its stages behind the exit: what is as small as that way asks for could lie between them, so a shorter
    /// one is tried. Returns whether it did.
    pub fn try_before_exit(&mut self, lane: usize) -> bool {
        let (h, way) = (self.h[lane], self.straight_end[lane]);
        let leaps = FIRST_STAGE * h > way || self.looks_straight(lane);
        if !(h > LONGEST_STEP * way && leaps) {
            return false;
        }
        self.reach[lane] = way;
        self.straight_end[lane] = f64::INFINITY;
        self.try_instead(lane, LONGEST_STEP * way);
        true
    }

    /// Replaces the judgement of the trial in `lane`: no further step is possible.
    pub fn end_here(&mut self, lane: usize) {
        self.accepted[lane] = 0.0;
        self.complete[lane] = 0.0;
        self.stuck[lane] = 1.0;
    }

    /// Replaces the step after the accepted trial in `lane`.
    pub fn go_on_with(&mut self, lane: usize, h: f64) {
        self.stuck[lane] = 0.0;
        self.next_h[lane] = h.min(self.length[lane] - self.next_s[lane]);
    }

    /// Returns whether the step of `lane` is so long that it needs more than its stages.
    #[inline(always)]
    pub fn is_long(&self, lane: usize) -> bool {
        self.h[lane] > 0.5 * LONGEST_STEP * self.reach[lane]
    }

    /// Returns whether any step is so long.
    #[inline(always)]
    pub fn any_is_long(&self) -> bool {
        let mut longs = 0;
        for l in 0..LANES {
            longs += i64::from(self.is_long(l));
        }
        longs > 0
    }

    /// Judges all trials.
    #[inline(always)]
    pub fn judge(&mut self) {
        let scale = 1.0 / (self.tolerance * self.tolerance);
        let kink2 = KINK * KINK;
        let least_ease = Real::min(1.0, (self.tolerance / LOOSEST).powi(2));
        let leap = Real::max(LEAP, LEAP_BY_TOLERANCE * self.tolerance);
        for l in 0..LANES {
            let (s, h, length) = (self.s[l], self.h[l], self.length[l]);
            let error2 = self.error2[l] * scale * self.ease[l];
            let kink = (h <= 8.0 * SHORTEST_STEP * s) & (self.error2[l] <= kink2);
            let unforeseen2 = self.unforeseen2[l];
            // A NaN counts as a surprise.
            let surprised = self.is_long(l)
                & !((unforeseen2 * scale <= 1.0)
                    | (unforeseen2 <= SURPRISE * SURPRISE * self.error2[l]));
            let good = (error2 <= 1.0) | kink;
            let rounded = LEAP_BY_ROUNDING * Real::sqrt(self.moved2[l]);
            let leaps = !(Real::abs(self.speed2[l] - 1.0) <= Real::max(leap, rounded));
            let surprised = surprised | (good & leaps);
            let accepted = good & !surprised;
            // A NaN asks for the shortest.
            let wanted = Real::max(0.9 * inverse_tenth_root(error2), 0.2);
            let factor = Real::min(wanted, self.growth[l]);
            let shrunk = Real::min(factor, f64::select(surprised, 0.5, 0.9));
            let factor = f64::select(kink, MOST_GROWTH, factor);
            let next = h * f64::select(accepted, factor, shrunk);
            let next_s = f64::select(accepted, s + h, s);
            let steps = self.steps[l] + 1.0;
            let complete = accepted & (next_s >= length * (1.0 - 1e-15));
            let eased = self.ease[l] < 1.0;
            let share = f64::select(eased, BEYOND_NOISE, COMING_ON);
            let comes_on = next_s > self.mark[l] * (1.0 + share);
            let tried = self.tried[l] + 1.0;
            let refused = self.refused[l] + f64::select(accepted, 0.0, 1.0);
            let caught = !comes_on & (tried >= TRIALS) & (refused >= REFUSED * tried);
            // Rounding may leave it somewhat above.
            let loosest = self.ease[l] <= 2.0 * least_ease;
            // What is left may be shorter than the shortest step, and is no sign of trouble.
            let stuck = (next <= SHORTEST_STEP * next_s)
                | (caught & loosest)
                | !(next >= f64::MIN_POSITIVE)
                | (steps >= MOST_STEPS as f64);
            self.steps[l] = steps;
            self.mark[l] = f64::select(comes_on, next_s, self.mark[l]);
            self.tried[l] = f64::select(comes_on | caught, 0.0, tried);
            self.refused[l] = f64::select(comes_on | caught, 0.0, refused);
            let ease = Real::max(self.ease[l] * f64::select(caught, 0.01, 1.0), least_ease);
            self.ease[l] = f64::select(comes_on, 1.0, ease);
            self.growth[l] = f64::select(accepted, MOST_GROWTH, 1.0);
            self.accepted[l] = f64::select(accepted, 1.0, 0.0);
            self.complete[l] = f64::select(complete, 1.0, 0.0);
            self.stuck[l] = f64::select(stuck, 1.0, 0.0);
            self.next_s[l] = next_s;
            self.next_h[l] = Real::min(
                // Behind where the exit was thought to be, the way so far says as much.
                Real::min(next, LONGEST_STEP * Real::max(self.reach[l], next_s)),
                length - next_s,
            );
        }
    }

    /// Moves on to the next step.
    #[inline(always)]
    pub fn commit(&mut self) {
        self.s = self.next_s;
        self.h = self.next_h;
    }
}

/// `x^(−1/10)` to single precision: the error of a step falls with the fifth power of its length,
/// and `x` is its square. Below 1e-20 the number is that of 1e-20; a NaN gives NaN.
#[inline(always)]
fn inverse_tenth_root(x: f64) -> f64 {
    // In this order a NaN stays one.
    let x = Real::max(1e-20, x as f32);
    f64::from(Real::exp(-0.1 * Real::ln(x)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_consistent() {
        let nodes = [0.2, 0.3, 0.8, 8.0 / 9.0, 1.0, 1.0];
        for (row, c) in A.iter().zip(nodes) {
            assert!((row.iter().sum::<f64>() - c).abs() < 1e-14);
        }
        assert!(ERROR.iter().sum::<f64>().abs() < 1e-15);
        assert!(DENSE.iter().sum::<f64>().abs() < 1e-12);
    }

    #[test]
    fn the_tenth_root_of_no_number_is_none() {
        assert!((inverse_tenth_root(1024.0) - 0.5).abs() < 1e-6);
        assert!((inverse_tenth_root(0.0) - 100.0).abs() < 1e-3);
        assert!(inverse_tenth_root(f64::NAN).is_nan());
    }
}
