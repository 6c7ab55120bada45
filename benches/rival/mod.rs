//! What a careful programmer would write for one manifold: geodesics of the graph of
//! `H exp(−|u|²/2)` by scalar code, with the metric derived by hand.
//!
//! In: starts. Out: chart points and tangents at the path's end. The method is the tracer's own
//! pair (Dormand–Prince 5(4), the last stage reused), with its error norm and its controller, so
//! that the ratio of times is that of the machinery alone. It may follow the tracer's rules for the
//! longest step, or be spared what the tracer must do for manifolds that nobody has seen
//! ([`Limits::None`]): then it takes fewer steps, because its author knows that nothing small hides
//! in flat space.
//!
//! `f = H exp(−|u|²/2)`, `∇f = −f u`, `f''(v,v) = f ((u·v)² − |v|²)`, `G = 1 + ∇f ∇fᵀ`, hence
//! `a = −∇f f''(v,v) / (1 + |∇f|²)`.

/// Position and tangent, or their rates.
type State = [f64; 6];

/// What limits the length of steps besides the error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Limits {
    /// Nothing.
    None,
    /// The tracer's rule: a sixteenth of the path, and one more look inside steps above half of that.
    Tracers,
}

/// The bump, and how it is followed.
pub struct Bump {
    /// H
    pub height: f64,
    /// The rule for long steps.
    pub limits: Limits,
}

impl Bump {
    /// The rates of `y`, and the slope `∇f` there.
    #[inline(always)]
    fn rates(&self, y: &State) -> (State, [f64; 3]) {
        let [x0, x1, x2, v0, v1, v2] = *y;
        let f = self.height * (-0.5 * (x0 * x0 + x1 * x1 + x2 * x2)).exp();
        let slope = [-f * x0, -f * x1, -f * x2];
        let along = x0 * v0 + x1 * v1 + x2 * v2;
        let bend = f * (along * along - (v0 * v0 + v1 * v1 + v2 * v2));
        let steep = slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2];
        let scale = -bend / (1.0 + steep);
        let rates = [
            v0,
            v1,
            v2,
            scale * slope[0],
            scale * slope[1],
            scale * slope[2],
        ];
        (rates, slope)
    }

    /// The end of the path of `length` from `start`, and how many steps were tried.
    pub fn follow(&self, start: State, length: f64, tolerance: f64) -> (State, usize) {
        let (mut y, mut s) = (start, 0.0);
        let (mut k1, _) = self.rates(&y);
        let bend = norm2(&k1[3..], [0.0; 3]).sqrt() / norm2(&y[3..], [0.0; 3]).sqrt();
        let mut h = (0.5 * tolerance.powf(0.2) / bend.max(1.0 / length)).min(self.longest(length));
        let mut steps = 0;
        while s < length {
            steps += 1;
            let (mut trial, mut k7, slope, error) = self.attempt(&y, &k1, h);
            let place = h / (s + h);
            let point = norm2(&error[..3], slope) * place * place;
            let worst = point.max(norm2(&error[3..], slope) * h * h).sqrt() / tolerance;
            let factor = (0.9 * worst.max(1e-10).powf(-0.2)).clamp(0.2, 5.0);
            let missed = self.limits == Limits::Tracers
                && h > 0.5 * self.longest(length)
                && self.surprise(&y, &k1, &trial, &k7, h, slope)
                    > tolerance.max(100.0 * worst * tolerance);
            if worst <= 1.0 && !missed {
                let scale = 1.0 / norm2(&trial[3..], slope).sqrt();
                for c in 0..3 {
                    trial[3 + c] *= scale;
                    k7[c] *= scale;
                    k7[3 + c] *= scale * scale;
                }
                (y, k1) = (trial, k7);
                s += h;
                h = (factor * h).min(self.longest(length)).min(length - s);
                if length - s < 1e-15 * length {
                    break;
                }
            } else {
                h *= factor.min(if missed { 0.5 } else { 0.9 });
            }
        }
        (y, steps)
    }

    fn longest(&self, length: f64) -> f64 {
        match self.limits {
            Limits::None => length,
            Limits::Tracers => length / 16.0,
        }
    }

    /// By how much the acceleration inside a step bends the tangent beside what the quintic through
    /// the step's ends does.
    fn surprise(
        &self,
        y: &State,
        k1: &State,
        end: &State,
        k7: &State,
        h: f64,
        slope: [f64; 3],
    ) -> f64 {
        let t = 0.55;
        let (mut inside, mut bend) = ([0.0; 6], [0.0; 3]);
        for c in 0..3 {
            let (p1, p2) = (y[3 + c] * h, k1[3 + c] * (0.5 * h * h));
            let rise = end[c] - y[c] - p1 - p2;
            let slope = end[3 + c] * h - p1 - p2 * 2.0;
            let last = k7[3 + c] * (0.5 * h * h) - p2;
            let p3 = rise * 10.0 - slope * 4.0 + last;
            let p4 = rise * -15.0 + slope * 7.0 - last * 2.0;
            let p5 = rise * 6.0 - slope * 3.0 + last;
            inside[c] = y[c] + (p1 + (p2 + (p3 + (p4 + p5 * t) * t) * t) * t) * t;
            inside[3 + c] =
                (p1 + (p2 * 2.0 + (p3 * 3.0 + (p4 * 4.0 + p5 * (5.0 * t)) * t) * t) * t) / h;
            bend[c] = (p2 * 2.0 + (p3 * 6.0 + (p4 * 12.0 + p5 * (20.0 * t)) * t) * t) / (h * h);
        }
        let (rates, _) = self.rates(&inside);
        let off = [0, 1, 2].map(|c| (rates[3 + c] - bend[c]) * h);
        norm2(&off, slope).sqrt()
    }

    /// One trial step: the new state, its rates, the slope there, and the error over `h`.
    #[inline(always)]
    fn attempt(&self, y: &State, k1: &State, h: f64) -> (State, State, [f64; 3], State) {
        let at = |weights: &[(f64, &State)]| -> State {
            std::array::from_fn(|c| y[c] + h * weights.iter().map(|(w, k)| w * k[c]).sum::<f64>())
        };
        let (k2, _) = self.rates(&at(&[(1.0 / 5.0, k1)]));
        let (k3, _) = self.rates(&at(&[(3.0 / 40.0, k1), (9.0 / 40.0, &k2)]));
        let (k4, _) = self.rates(&at(&[
            (44.0 / 45.0, k1),
            (-56.0 / 15.0, &k2),
            (32.0 / 9.0, &k3),
        ]));
        let (k5, _) = self.rates(&at(&[
            (19372.0 / 6561.0, k1),
            (-25360.0 / 2187.0, &k2),
            (64448.0 / 6561.0, &k3),
            (-212.0 / 729.0, &k4),
        ]));
        let (k6, _) = self.rates(&at(&[
            (9017.0 / 3168.0, k1),
            (-355.0 / 33.0, &k2),
            (46732.0 / 5247.0, &k3),
            (49.0 / 176.0, &k4),
            (-5103.0 / 18656.0, &k5),
        ]));
        let trial = at(&[
            (35.0 / 384.0, k1),
            (500.0 / 1113.0, &k3),
            (125.0 / 192.0, &k4),
            (-2187.0 / 6784.0, &k5),
            (11.0 / 84.0, &k6),
        ]);
        let (k7, slope) = self.rates(&trial);
        let error = std::array::from_fn(|c| {
            71.0 / 57600.0 * k1[c] - 71.0 / 16695.0 * k3[c] + 71.0 / 1920.0 * k4[c]
                - 17253.0 / 339200.0 * k5[c]
                + 22.0 / 525.0 * k6[c]
                - 1.0 / 40.0 * k7[c]
        });
        (trial, k7, slope, error)
    }
}

/// `xᵀ(1 + slope slopeᵀ)x`
#[inline(always)]
fn norm2(x: &[f64], slope: [f64; 3]) -> f64 {
    let rise = x[0] * slope[0] + x[1] * slope[1] + x[2] * slope[2];
    x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + rise * rise
}
