//! The exact tracer against an integrator that shares no code with it: metrics written by hand, their
//! Christoffel symbols through the dual numbers of `num-dual`, integrated by the DOP853 of
//! `ode_solvers`. Random rays of every manifold of the catalogue; end points, tangents and transported
//! frames are compared in the metric at the end.

mod support;

use geofan_core::{
    geodesic::{Ray, paths},
    manifold::Manifold,
    random::Stream,
};
use glam::{DMat3, DVec3};
use num_dual::{Dual64, DualNum, HyperDual64};
use ode_solvers::{Dop853, OutputType, SVector, System, dop_shared::IntegrationError};
use support::{asset, catalogue, random_point, settings, worse};

/// What positions (over arc length), tangents and frames must agree to.
const AGREEMENT: f64 = 1e-8;

/// Rays of each manifold.
const RAYS: usize = 12;

/// The most that are drawn for each of them.
const TRIES: usize = 20;

/// A manifold by formulas of this file.
#[derive(Clone, Copy)]
enum Space {
    /// g_xx, g_yy, g_zz, g_xy, g_xz, g_yz.
    Metric(fn([Dual64; 3]) -> [Dual64; 6]),
    Embedding(fn([HyperDual64; 3]) -> [HyperDual64; 4]),
}

fn space(name: &str) -> Space {
    use Space::{Embedding, Metric};
    match name {
        "cone" => Metric(|u| radial(u, |_| Dual64::from(0.64))),
        "ellis-wormhole" => Metric(|u| {
            let rho2 = r2(u);
            conformal(rho2.recip() / 4.0 + 1.0)
        }),
        "flamm-paraboloid" => Metric(|u| conformal(((r2(u).sqrt() * 4.0).recip() + 1.0).powi(2))),
        "flat" | "flat-torus" | "half-turn" | "portal" => Metric(|_| conformal(Dual64::from(1.0))),
        "gaussian-bump" => Metric(|u| {
            let h = (r2(u) * -0.5).exp();
            graph(u.map(|x| -x * h))
        }),
        "gaussian-lens" => Metric(|u| conformal(((r2(u) * -0.5).exp() * 0.5).exp())),
        "glass-ball" => Metric(|u| {
            let index = if r2(u).re < 1.0 { 1.5 } else { 1.0 };
            conformal(Dual64::from(index))
        }),
        "grin-rod" => Metric(|[x, y, _]| conformal((-(x * x + y * y) + 1.0).sqrt() * 1.5)),
        "h2xr" => Metric(|[_, y, _]| diagonal((y * -2.0).exp(), y * 0.0 + 1.0, y * 0.0 + 1.0)),
        "h3-ball" | "figure-eight" | "seifert-weber" | "mirrored-dodecahedron" => {
            Metric(|u| conformal((-r2(u) + 1.0).recip() * 2.0))
        }
        "h3-half-space" => Metric(|u| conformal(u[2].recip())),
        "interstellar-wormhole" => Metric(interstellar),
        "luneburg" => Metric(|u| {
            let r2 = r2(u);
            let inside = (-r2 + 2.0).sqrt();
            conformal(if r2.re < 1.0 {
                inside
            } else {
                Dual64::from(1.0)
            })
        }),
        "maxwell-fish-eye" => Metric(|u| {
            let r2 = r2(u);
            let inside = (r2 + 1.0).recip() * 2.0;
            conformal(if r2.re < 1.0 {
                inside
            } else {
                Dual64::from(1.0)
            })
        }),
        "nil" | "nil-torus" => {
            Metric(|[x, y, _]| fibred([y * 0.5, x * -0.5], [y * 0.0 + 1.0, y * 0.0 + 1.0]))
        }
        "reissner-nordstrom" => Metric(|u| {
            let rho = r2(u).sqrt();
            let areal = rho + 1.0 + (rho * 4.0).recip() * 0.36;
            conformal(areal * areal / (r2(u) - 0.09))
        }),
        "rolled-sheet" => Embedding(|[x, y, z]| [x.sin(), -x.cos() + 1.0, y, z]),
        "s2xr" => Metric(|u| conformal(r2(u).sqrt().recip())),
        "s3" | "poincare" | "lens-space" => Metric(|u| conformal((r2(u) + 1.0).recip() * 2.0)),
        "s3-graph" => Embedding(|u| {
            let w = (-(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]) + 1.0).sqrt();
            [u[0], u[1], u[2], w]
        }),
        "schwarzschild-polar" => Metric(|u| {
            // (1 - 2/r)⁻² (dr² + (1 - 2/r) r² dΩ²)
            let fall = -(r2(u).sqrt().recip() * 2.0) + 1.0;
            radial(u, |_| fall).map(|entry| entry / (fall * fall))
        }),
        "schwarzschild" => Metric(|u| {
            let q = (r2(u).sqrt() * 2.0).recip();
            conformal((q + 1.0).powi(3) / (-q + 1.0))
        }),
        "sl2r" => Metric(|[_, y, _]| {
            let shrink = (-y).exp();
            fibred([shrink, y * 0.0], [shrink * shrink, y * 0.0 + 1.0])
        }),
        "sol" | "sol-cat" => {
            Metric(|[_, _, z]| diagonal((z * 2.0).exp(), (z * -2.0).exp(), z * 0.0 + 1.0))
        }
        "three-bumps" => Embedding(three_bumps),
        "torus-s1xs2" => Embedding(torus),
        other => panic!("no formula for {other}: add one"),
    }
}

fn r2(u: [Dual64; 3]) -> Dual64 {
    u[0] * u[0] + u[1] * u[1] + u[2] * u[2]
}

fn diagonal(a: Dual64, b: Dual64, c: Dual64) -> [Dual64; 6] {
    let zero = Dual64::from(0.0);
    [a, b, c, zero, zero, zero]
}

fn conformal(n: Dual64) -> [Dual64; 6] {
    diagonal(n * n, n * n, n * n)
}

/// `a dx² + b dy² + (dz + p dx + q dy)²`
fn fibred([p, q]: [Dual64; 2], [a, b]: [Dual64; 2]) -> [Dual64; 6] {
    [a + p * p, b + q * q, Dual64::from(1.0), p * q, p, q]
}

/// `δ + ∇h ∇h`
fn graph([a, b, c]: [Dual64; 3]) -> [Dual64; 6] {
    [a * a + 1.0, b * b + 1.0, c * c + 1.0, a * b, a * c, b * c]
}

/// `dρ² + k(ρ²) ρ² dΩ²` in Cartesian coordinates.
fn radial(u: [Dual64; 3], k: impl Fn(Dual64) -> Dual64) -> [Dual64; 6] {
    let k = k(r2(u));
    let entry = |i: usize, j: usize| {
        let rest = u[i] * u[j] * (-k + 1.0) / r2(u);
        if i == j { rest + k } else { rest }
    };
    [
        entry(0, 0),
        entry(1, 1),
        entry(2, 2),
        entry(0, 1),
        entry(0, 2),
        entry(1, 2),
    ]
}

/// `(dl/dρ)² dρ² + r(l)² dΩ²` with `l = ρ − 1/(4ρ)`.
fn interstellar(u: [Dual64; 3]) -> [Dual64; 6] {
    let rho = r2(u).sqrt();
    let l = rho - (rho * 4.0).recip();
    let stretch = (r2(u) * 4.0).recip() + 1.0;
    let m = 0.05 / 1.42953;
    let past = (if l.re < 0.0 { -l } else { l }) - 0.005;
    let x = past * (2.0 / (std::f64::consts::PI * m));
    let opened = (x * x.atan() - (x * x + 1.0).ln() * 0.5) * m + 1.0;
    let r = if past.re < 0.0 {
        Dual64::from(1.0)
    } else {
        opened
    };
    let tangential = r * r / r2(u) / (stretch * stretch);
    radial(u, |_| tangential).map(|entry| entry * stretch * stretch)
}

fn three_bumps(u: [HyperDual64; 3]) -> [HyperDual64; 4] {
    let bump = |height: f64, width: f64, centre: [f64; 3]| {
        let [a, b, c] = [0, 1, 2].map(|k| u[k] - centre[k]);
        ((a * a + b * b + c * c) * (-0.5 / (width * width))).exp() * height
    };
    let h = bump(1.5, 0.9, [1.1, 0.3, -0.4])
        + bump(1.3, 0.8, [-0.8, 0.9, 0.5])
        + bump(1.6, 1.0, [-0.2, -1.0, 0.1]);
    [u[0], u[1], u[2], h]
}

fn torus([x, y, z]: [HyperDual64; 3]) -> [HyperDual64; 4] {
    let s = y * y + z * z;
    let b = (x.cos() * 0.6 + 3.0) / (s + 1.0);
    [b * y * 2.0, b * z * 2.0, b * (-s + 1.0), x.sin() * 0.6]
}

/// Where the entry (i, j) stands among six.
const PLACE: [[usize; 3]; 3] = [[0, 3, 4], [3, 1, 5], [4, 5, 2]];

type Rank3 = [[[f64; 3]; 3]; 3];

impl Space {
    /// `g_ij`, and `Γ_lij` with its first index down.
    fn connection(self, u: [f64; 3]) -> ([[f64; 3]; 3], Rank3) {
        match self {
            Self::Metric(metric) => by_metric(metric, u),
            Self::Embedding(f) => embedded(f, u),
        }
    }
}

fn by_metric(metric: fn([Dual64; 3]) -> [Dual64; 6], u: [f64; 3]) -> ([[f64; 3]; 3], Rank3) {
    let along = [0, 1, 2]
        .map(|k| metric([0, 1, 2].map(|i| Dual64::new(u[i], if i == k { 1.0 } else { 0.0 }))));
    let g = PLACE.map(|row| row.map(|p| along[0][p].re));
    let d = |k: usize, i: usize, j: usize| along[k][PLACE[i][j]].eps;
    let mut lower = Rank3::default();
    for (l, i, j) in indices() {
        lower[l][i][j] = 0.5 * (d(i, l, j) + d(j, l, i) - d(l, i, j));
    }
    (g, lower)
}

/// `g_ij = f_i · f_j`, `Γ_lij = f_l · f_ij`.
fn embedded(f: fn([HyperDual64; 3]) -> [HyperDual64; 4], u: [f64; 3]) -> ([[f64; 3]; 3], Rank3) {
    let one = |yes: bool| if yes { 1.0 } else { 0.0 };
    let second = |i: usize, j: usize| {
        f([0, 1, 2].map(|k| HyperDual64::new(u[k], one(k == i), one(k == j), 0.0)))
    };
    let bends = [0, 1, 2].map(|i| [0, 1, 2].map(|j| second(i, j)));
    let dot = |a: [f64; 4], b: [f64; 4]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let first = [0, 1, 2].map(|i| bends[i][0].map(|x| x.eps1));
    let mut lower = Rank3::default();
    for (l, i, j) in indices() {
        lower[l][i][j] = dot(first[l], bends[i][j].map(|x| x.eps1eps2));
    }
    (
        [0, 1, 2].map(|i| [0, 1, 2].map(|j| dot(first[i], first[j]))),
        lower,
    )
}

fn indices() -> impl Iterator<Item = (usize, usize, usize)> {
    (0..27).map(|i| (i / 9, i / 3 % 3, i % 3))
}

/// u, v and three transported vectors.
type State = SVector<f64, 15>;

impl System<f64, State> for Space {
    fn system(&self, _: f64, y: &State, dy: &mut State) {
        let (g, lower) = self.connection([y[0], y[1], y[2]]);
        let inverse = DMat3::from_cols_array_2d(&g).inverse();
        for c in 0..3 {
            dy[c] = y[3 + c];
        }
        for carried in 1..5 {
            let force = DVec3::from_array([0, 1, 2].map(|l| {
                let terms = (0..9).map(|i| (i / 3, i % 3));
                terms
                    .map(|(i, j)| lower[l][i][j] * y[3 + i] * y[3 * carried + j])
                    .sum()
            }));
            let rate = inverse * force;
            for c in 0..3 {
                dy[3 * carried + c] = -rate[c];
            }
        }
    }
}

/// Gram–Schmidt in coordinate order, on the hand-written metric.
fn frame(space: Space, u: DVec3) -> DMat3 {
    let (g, _) = space.connection(u.to_array());
    let g = DMat3::from_cols_array_2d(&g);
    let mut frame = DMat3::IDENTITY;
    for k in 0..3 {
        let mut w = frame.col(k);
        for j in 0..k {
            w -= frame.col(j) * frame.col(j).dot(g * w);
        }
        *frame.col_mut(k) = w / w.dot(g * w).sqrt();
    }
    frame
}

/// The state after `length`.
fn integrate(space: Space, u: DVec3, d: DVec3, length: f64) -> Result<State, IntegrationError> {
    let s = frame(space, u);
    let start = [u, s * d, s.x_axis, s.y_axis, s.z_axis];
    let start = State::from_iterator(start.iter().flat_map(|v| v.to_array()));
    let (tight, none) = (1e-13, 0.0);
    let mut solver = Dop853::from_param(
        space,
        0.0,
        length,
        length,
        start,
        tight,
        tight,
        0.9,
        none,
        0.333,
        6.0,
        length,
        none,
        1_000_000,
        1_000_000_000,
        OutputType::Sparse,
    );
    solver.integrate()?;
    Ok(*solver.y_out().last().unwrap())
}

/// A ray of `manifold` that ends before any exit and meets no sharp edge (`crates/core/tests/refraction.rs` has those),
/// and the path's end, tangent and frame.
fn ours(manifold: &Manifold, stream: &mut Stream) -> Option<(DVec3, DVec3, f64, [DVec3; 5])> {
    let (u, d) = (random_point(manifold, stream), stream.direction());
    let most = manifold.length.unwrap_or(6.0).min(12.0);
    let length = most * stream.between(0.3, 1.0);
    let follow = |length| {
        paths(
            manifold,
            settings(1e-12, true),
            [Ray::new(manifold, u, d, length)],
        )
        .remove(0)
    };
    // Not to the very edge of the chart, where the metric may be infinite.
    let length = follow(length).length * 0.98;
    let path = follow(length);
    if path.edges().next().is_some() {
        return None;
    }
    let step = path.steps.last()?;
    let (point, turn) = (step.position(length), step.rotation(length)?);
    let frame = manifold.standard_frame(point) * DMat3::from_quat(turn);
    let end = [
        point,
        step.tangent(length),
        frame.x_axis,
        frame.y_axis,
        frame.z_axis,
    ];
    Some((u, d, length, end))
}

#[test]
fn every_manifold_agrees_with_another_integrator_and_another_derivative() {
    let (mut report, mut wrong) = (String::new(), 0);
    for (i, name) in catalogue().iter().enumerate() {
        let manifold = asset(name).cover().into_owned();
        // Light in a wind has an integrator of its own, in `wind_independent.rs`.
        if manifold.has_wind() {
            continue;
        }
        // Samples have no formula; `sampled_fields.rs` samples one.
        if !manifold.fields.is_empty() {
            continue;
        }
        let space = space(name);
        let mut stream = Stream::new(&[77, i as u64]);
        let (mut position, mut turned) = (0.0, 0.0);
        for ray in 0..RAYS {
            let found = (0..TRIES).find_map(|_| ours(&manifold, &mut stream));
            let (u, d, length, end) = found.unwrap_or_else(|| panic!("{name}: no ray {ray}"));
            let other = match integrate(space, u, d, length) {
                Ok(state) => state,
                Err(e) => panic!("{name}: {e}"),
            };
            let vector = |k: usize| DVec3::from_slice(&other.as_slice()[3 * k..]);
            let inverse = frame(space, vector(0)).inverse();
            let off = |k: usize| (inverse * (end[k] - vector(k))).length();
            position = worse(position, off(0) / length);
            turned = (1..5).map(off).fold(turned, worse);
        }
        let fine = worse(position, turned) <= AGREEMENT;
        wrong += usize::from(!fine);
        let mark = if fine { "" } else { "  <- wrong" };
        report += &format!("{name:22} position {position:.1e}  vectors {turned:.1e}{mark}\n");
    }
    println!("{report}");
    assert_eq!(wrong, 0, "\n{report}");
}
