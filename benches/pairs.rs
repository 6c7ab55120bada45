//! Evaluations of the acceleration that two pairs of integrators take for the same error: Dormand and Prince's 5(4),
//! which the tracer uses, and their 8(5,3). Both from `ode_solvers`, so that neither is favoured by how it is written.
//!
//! `cargo bench --bench pairs` prints a table: for each space and error, evaluations a ray. Errors are the 99th
//! percentile of the end point's distance from a much tighter run, over the length, in the chart. A path is more than
//! its end: a quintic through the ends of steps is as exact as steps of 5(4), while steps of 8(5,3) are so long that
//! they need three more evaluations for a curve of order 7 (*whole paths*). The table's last columns hold steps below
//! a sixteenth of the path, as the tracer must, lest it leap over what is small. Without `--bench` one space is tried.

use geofan_core::{
    geodesic::Ray,
    manifold::{Carried, Manifold},
    quantiles::Quantiles,
    random::Stream,
};
use geofan_expr::{Registers, Tape};
use glam::DVec3;
use ode_solvers::{
    Dop853, Dopri5, OutputType, SVector, System,
    dop_shared::{IntegrationError, Stats},
};
use std::cell::RefCell;

type State = SVector<f64, 6>;

/// Spaces, with the boxes that rays start in and their lengths; rays that do not come to their end are left out.
const SPACES: [(&str, [f64; 3], [f64; 3], f64); 6] = [
    ("gaussian-bump", [-2.0; 3], [2.0; 3], 9.0),
    ("three-bumps", [-2.0; 3], [2.0; 3], 9.5),
    ("nil", [-1.0; 3], [1.0; 3], 5.0),
    ("ellis-wormhole", [3.0, -1.0, -1.0], [6.0, 1.0, 1.0], 24.0),
    ("schwarzschild", [6.0, -1.0, -1.0], [12.0, 1.0, 1.0], 30.0),
    ("kerr", [6.0, -1.0, -1.0], [12.0, 1.0, 1.0], 30.0),
];

const RAYS: usize = 200;

/// Tolerances of runs, between which errors are interpolated.
const TOLERANCES: [f64; 11] = [
    1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13,
];

/// Errors at which pairs are compared.
const ERRORS: [f64; 4] = [1e-4, 1e-6, 1e-8, 1e-10];

#[derive(Clone, Copy)]
enum Pair {
    FiveFour,
    EightFiveThree,
}

fn main() {
    let measuring = std::env::args().any(|a| a == "--bench");
    let (rays, spaces) = if measuring {
        (RAYS, SPACES.len())
    } else {
        (8, 1)
    };
    println!(
        "evaluations a ray: 5(4) | 8(5,3) | its whole paths || the same with steps below 1/16"
    );
    for (name, least, most, length) in &SPACES[..spaces] {
        let manifold = load(name);
        let space = Space::new(&manifold, *length);
        let rays = space.rays([*least, *most], rays);
        for error in ERRORS {
            let mut row = format!("{name:16} {error:.0e}");
            for share in [1.0, 1.0 / 16.0] {
                let step = share * length;
                for (pair, more) in [
                    (Pair::FiveFour, 0.0),
                    (Pair::EightFiveThree, 0.0),
                    (Pair::EightFiveThree, 3.0),
                ] {
                    let runs = TOLERANCES.map(|t| space.run(&rays, pair, t, step, more));
                    row += &format!("{:8.0}", evaluations_at(error, &runs));
                }
            }
            println!("{row}");
        }
    }
}

fn load(name: &str) -> Manifold {
    let path = format!(
        "{}/assets/manifolds/{name}.toml",
        env!("CARGO_MANIFEST_DIR")
    );
    Manifold::load(path.as_ref(), &[]).unwrap_or_else(|e| panic!("{}", e.report(false)))
}

/// A ray's start and where it ends.
struct Traced {
    start: State,
    end: State,
}

/// The flow of a manifold over paths of one length.
struct Space<'m> {
    manifold: &'m Manifold,
    flow: &'m Tape,
    registers: RefCell<Registers<f64, 1>>,
    length: f64,
}

impl System<f64, State> for &Space<'_> {
    fn system(&self, _: f64, y: &State, rates: &mut State) {
        let mut registers = self.registers.borrow_mut();
        self.flow.run_at(&mut registers, y.as_slice());
        for c in 0..3 {
            rates[c] = y[3 + c];
            rates[3 + c] = registers.output(c)[0];
        }
    }
}

impl<'m> Space<'m> {
    fn new(manifold: &'m Manifold, length: f64) -> Self {
        let flow = manifold.flow(Carried::default());
        Self {
            manifold,
            flow,
            registers: RefCell::new(flow.registers()),
            length,
        }
    }

    /// Random rays that come to their end, followed as closely as numbers allow.
    fn rays(&self, [least, most]: [[f64; 3]; 2], count: usize) -> Vec<Traced> {
        let mut random = Stream::new(&[4]);
        let mut rays = Vec::new();
        while rays.len() < count {
            let u = std::array::from_fn(|c| random.between(least[c], most[c]));
            let u = DVec3::from_array(u);
            let ray = Ray::new(self.manifold, u, random.direction(), self.length);
            let start = State::from_iterator([ray.u, ray.v].iter().flat_map(|x| x.to_array()));
            let tight = self.follow(&start, Pair::EightFiveThree, 1e-14, self.length);
            if let Ok((end, _)) = tight
                && end.iter().all(|x| x.is_finite())
                && self.is_well_conditioned(&start, &end)
            {
                rays.push(Traced { start, end });
            }
        }
        rays
    }

    /// Returns whether a ray's end can be told at all: two tight runs agree, which they do not where a ray falls
    /// into a singularity.
    fn is_well_conditioned(&self, start: &State, end: &State) -> bool {
        let other = self.follow(start, Pair::FiveFour, 1e-13, self.length / 16.0);
        other.is_ok_and(|(other, _)| (other - end).norm() < 1e-9 * self.length)
    }

    fn follow(
        &self,
        start: &State,
        pair: Pair,
        tolerance: f64,
        longest: f64,
    ) -> Result<(State, Stats), IntegrationError> {
        let (s, t) = (self.length, tolerance);
        // The solvers' own defaults, apart from the longest step, and with patience for many.
        macro_rules! followed {
            ($solver:ident, $beta:literal, $least:literal, $most:literal) => {{
                let mut solver = $solver::from_param(
                    self,
                    0.0,
                    s,
                    s,
                    *start,
                    t,
                    t,
                    0.9,
                    $beta,
                    $least,
                    $most,
                    longest,
                    0.0,
                    20_000,
                    30_000,
                    OutputType::Sparse,
                );
                let stats = solver.integrate()?;
                Ok((last(solver.y_out()), stats))
            }};
        }
        match pair {
            Pair::FiveFour => followed!(Dopri5, 0.04, 0.2, 10.0),
            Pair::EightFiveThree => followed!(Dop853, 0.0, 0.333, 6.0),
        }
    }

    /// The error (99th percentile) and the evaluations a ray, with `more` of them for each step taken.
    fn run(
        &self,
        rays: &[Traced],
        pair: Pair,
        tolerance: f64,
        longest: f64,
        more: f64,
    ) -> [f64; 2] {
        let (mut errors, mut evaluations) = (Vec::new(), 0.0);
        for ray in rays {
            let Ok((end, stats)) = self.follow(&ray.start, pair, tolerance, longest) else {
                errors.push(f64::INFINITY);
                continue;
            };
            let off = end.fixed_rows::<3>(0) - ray.end.fixed_rows::<3>(0);
            errors.push(off.norm() / self.length);
            evaluations += f64::from(stats.num_eval) + more * f64::from(stats.accepted_steps);
        }
        [
            Quantiles::of(&mut errors).p99,
            evaluations / rays.len() as f64,
        ]
    }
}

fn last(states: &[State]) -> State {
    states.last().copied().unwrap_or_else(State::zeros)
}

/// Evaluations for an error, between the runs beside it on logarithmic scales; NaN where none is as exact. A run as
/// exact as asked for without a looser one beside it counts as it is.
fn evaluations_at(error: f64, runs: &[[f64; 2]]) -> f64 {
    let Some(k) = runs.iter().position(|[e, _]| *e <= error) else {
        return f64::NAN;
    };
    let [tight, many] = runs[k];
    let Some([loose, few]) = k.checked_sub(1).map(|k| runs[k]) else {
        return many;
    };
    let share = (loose / error).ln() / (loose / tight).ln();
    if !share.is_finite() {
        return many;
    }
    (few.ln() + share * (many / few).ln()).exp()
}
