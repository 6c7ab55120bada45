//! The Levi-Civita connection and the curvature at a point.
//!
//! In: the metric with its exact first and second derivatives. Out: [`Curvature`]: Christoffel
//! symbols, Riemann, Ricci and scalar curvature in chart components. Formulas: B. O'Neill,
//! *Semi-Riemannian Geometry* (1983), ch. 3, with the sign in which a sphere has positive curvature.
//!
//! `∂_k` is the derivative by coordinate k; repeated indices are summed over.

use super::{
    Carried, Manifold,
    geometry::{PAIRS, symmetric},
};
use crate::error::{Error, Result};
use geofan_expr::Tape;
use glam::{DMat3, DVec3};
use std::array::from_fn;

/// Three indices: `[k][i][j]`.
pub type Rank3 = [[[f64; 3]; 3]; 3];

/// Four indices: `[a][b][c][d]`.
pub type Rank4 = [[[[f64; 3]; 3]; 3]; 3];

/// The metric and its derivatives at one point, and what follows from them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curvature {
    /// `G`
    pub metric: DMat3,
    /// `G⁻¹`
    pub inverse: DMat3,
    /// `∂_k g_ij` at `[k][i][j]`.
    pub slopes: Rank3,
    /// `Γ^k_ij` at `[k][i][j]`, symmetric in i and j.
    pub christoffel: Rank3,
    /// `R_abcd = g(R(∂_c, ∂_d) ∂_b, ∂_a)` at `[a][b][c][d]`: `K (g_ac g_bd − g_ad g_bc)` where
    /// all sectional curvatures are K.
    pub riemann: Rank4,
    /// `R_bd = g^ac R_abcd`.
    pub ricci: DMat3,
    /// `g^bd R_bd`: six times K where all sectional curvatures are K.
    pub scalar: f64,
}

impl Manifold {
    /// Connection and curvature at `u`; not finite where the metric is not.
    ///
    /// # Errors
    /// The second derivatives of the metric are too large an expression to be compiled.
    pub fn curvature(&self, u: DVec3) -> Result<Curvature> {
        let tape = self.tapes.jet().map_err(|e| {
            let subject = self.source.name.clone();
            Error::input(subject, format!("the curvature cannot be computed: {e}"))
        })?;
        Ok(Curvature::from_jet(&self.at_point(tape, u)))
    }

    /// `Ω(∂_k)` for each coordinate k, in the standard frame: skew, `Ω(v)^a_b = t^a · ∇_v t_b`. A
    /// vector with components `w` in the standard frame is parallel along a curve with velocity `v`
    /// if `ẇ + Ω(v) w = 0`.
    pub fn connection(&self, u: DVec3) -> [DMat3; 3] {
        DVec3::AXES.map(|axis| {
            let w = self.turning(u, axis);
            DMat3::from_cols_array(&[0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0])
        })
    }

    /// `ω` with `Ω(v) = −[ω]×`: the rate at which a transported rotation turns, in the standard
    /// frame, along a curve through `u` with velocity `v` (chart components, any length).
    pub fn turning(&self, u: DVec3, v: DVec3) -> DVec3 {
        rate_at(&self.levi_civita().turning, u, v)
    }

    /// Computes the acceleration (chart components) of the path of light through `u` with tangent `v`.
    pub fn acceleration(&self, u: DVec3, v: DVec3) -> DVec3 {
        rate_at(&self.tapes.flows[Carried::default().index()], u, v)
    }

    /// Computes the turning of the frame that light carries along its path through `u` with tangent `v`: where
    /// there is a wind, it keeps the direction of sight, and turns about it as polarised light does.
    pub fn carrying(&self, u: DVec3, v: DVec3) -> DVec3 {
        rate_at(&self.tapes.turning, u, v)
    }

    /// Computes `−Γ^k_ij v^i w^j` at many points `u`, for two vectors `w` at each (u, v, w): the rate at which the chart
    /// components of `w`, transported along a curve with velocity `v`, change. From the acceleration of geodesics, which
    /// is that of `v = w`: `2Γ(v, w) = Γ(v + w, v + w) − Γ(v, v) − Γ(w, w)`.
    pub fn parallel_rates(&self, places: &[(DVec3, DVec3, [DVec3; 2])]) -> Vec<[DVec3; 2]> {
        // Vectors of one length: nothing cancels.
        let states = places.iter().flat_map(|(u, v, [a, b])| {
            let [v, a, b] = [v, a, b].map(|x| x.normalize_or_zero());
            [v, a, b, v + a, v + b].map(|v| [u.x, u.y, u.z, v.x, v.y, v.z])
        });
        let states: Vec<[f64; 6]> = states.collect();
        // The accelerations of all of these.
        let tape = &self.levi_civita().flows[Carried::default().index()];
        let rows = tape.at_each(states.into_iter());
        let rates: Vec<DVec3> = rows
            .chunks_exact(tape.outputs())
            .map(DVec3::from_slice)
            .collect();
        let parallel = |((_, v, w), rates): (&(DVec3, DVec3, [DVec3; 2]), &[DVec3; 5])| {
            let [v_rate, a, b, v_a, v_b] = *rates;
            let rate = |w: DVec3, w_rate: DVec3, both: DVec3| {
                (both - v_rate - w_rate) * (0.5 * v.length() * w.length())
            };
            [rate(w[0], a, v_a), rate(w[1], b, v_b)]
        };
        let (rates, _) = rates.as_chunks::<5>();
        places.iter().zip(rates).map(parallel).collect()
    }
}

/// Evaluates `tape` for the point `u` and the velocity `v`.
fn rate_at(tape: &Tape, u: DVec3, v: DVec3) -> DVec3 {
    let mut registers = tape.registers::<f64, 1>();
    for k in 0..3 {
        *registers.input(k) = [u[k]];
        *registers.input(3 + k) = [v[k]];
    }
    tape.run(&mut registers);
    DVec3::from_array([0, 1, 2].map(|k| registers.output(k)[0]))
}

impl Curvature {
    /// From G (6), ∂_k G (3 × 6), ∂_k ∂_l G (6 × 6), pairs of indices in the order of [`PAIRS`].
    fn from_jet(jet: &[f64]) -> Self {
        let entry = |at: usize, i: usize, j: usize| jet[6 * at + symmetric(i, j)];
        let metric = DMat3::from_cols_array_2d(&from_fn(|j| from_fn(|i| entry(0, i, j))));
        let inverse = metric.inverse();
        let slopes = from_fn(|k| from_fn(|i| from_fn(|j| entry(1 + k, i, j))));
        let bends = |k: usize, l: usize, i: usize, j: usize| entry(4 + symmetric(k, l), i, j);
        let christoffel = christoffel(inverse, &slopes);
        let riemann = riemann(metric, &christoffel, bends);
        let ricci = ricci(inverse, &riemann);
        let trace = |b: usize, d: usize| inverse.col(b)[d] * ricci.col(b)[d];
        Self {
            metric,
            inverse,
            slopes,
            christoffel,
            riemann,
            ricci,
            scalar: sum(|b| sum(|d| trace(b, d))),
        }
    }

    /// The sectional curvature of the plane that `a` and `b` (chart components) span.
    pub fn sectional(&self, a: DVec3, b: DVec3) -> f64 {
        let r = |i: usize, j: usize, k: usize, l: usize| {
            self.riemann[i][j][k][l] * a[i] * b[j] * a[k] * b[l]
        };
        let g = |p: DVec3, q: DVec3| p.dot(self.metric * q);
        let raised = sum(|i| sum(|j| sum(|k| sum(|l| r(i, j, k, l)))));
        raised / (g(a, a) * g(b, b) - g(a, b) * g(a, b))
    }

    /// `−Γ^k_ij v^i w^j`: the rate at which the chart components of `w`, transported along a curve
    /// with velocity `v`, change; for `w = v` the acceleration of a geodesic.
    pub fn parallel_rate(&self, v: DVec3, w: DVec3) -> DVec3 {
        DVec3::from_array(from_fn(|k| {
            -sum(|i| sum(|j| self.christoffel[k][i][j] * v[i] * w[j]))
        }))
    }
}

/// `f(0) + f(1) + f(2)`
fn sum(f: impl Fn(usize) -> f64) -> f64 {
    f(0) + f(1) + f(2)
}

/// `Γ^k_ij = ½ g^ka (∂_i g_aj + ∂_j g_ai − ∂_a g_ij)`
fn christoffel(inverse: DMat3, d: &Rank3) -> Rank3 {
    let lower = |a: usize, i: usize, j: usize| 0.5 * (d[i][a][j] + d[j][a][i] - d[a][i][j]);
    from_fn(|k| from_fn(|i| from_fn(|j| sum(|a| inverse.col(a)[k] * lower(a, i, j)))))
}

/// `R_abcd = ½ (∂_b ∂_c g_ad + ∂_a ∂_d g_bc − ∂_a ∂_c g_bd − ∂_b ∂_d g_ac)
/// + g_ef (Γ^e_bc Γ^f_ad − Γ^e_bd Γ^f_ac)`
fn riemann(g: DMat3, gamma: &Rank3, dd: impl Fn(usize, usize, usize, usize) -> f64) -> Rank4 {
    let product = |b: usize, c: usize, a: usize, d: usize| {
        sum(|e| sum(|f| g.col(e)[f] * gamma[e][b][c] * gamma[f][a][d]))
    };
    let entry = |a: usize, b: usize, c: usize, d: usize| {
        let bends = dd(b, c, a, d) + dd(a, d, b, c) - dd(a, c, b, d) - dd(b, d, a, c);
        0.5 * bends + product(b, c, a, d) - product(b, d, a, c)
    };
    from_fn(|a| from_fn(|b| from_fn(|c| from_fn(|d| entry(a, b, c, d)))))
}

/// `R_bd = g^ac R_abcd`
fn ricci(inverse: DMat3, riemann: &Rank4) -> DMat3 {
    let mut entries = DMat3::ZERO;
    for (b, d) in PAIRS {
        let value = sum(|a| sum(|c| inverse.col(a)[c] * riemann[a][b][c][d]));
        entries.col_mut(b)[d] = value;
        entries.col_mut(d)[b] = value;
    }
    entries
}
