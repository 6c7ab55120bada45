//! The differential geometry of a manifold, built as graph nodes from its defining expressions; and textbook coordinates, in
//! which these may be written.
//!
//! In: an embedding `f(u)` or a metric `g_ij(u)` as nodes. Out: nodes for the metric `G`, the
//! standard frame `S`, the geodesic acceleration `a(u, v)`, the rate `ω(u, v)` at which the
//! transported rotation turns, and the rates of geodesic deviation.
//!
//! Indices run over the three coordinates; symmetric matrices are stored as xx, yy, zz, xy, xz,
//! yz. `G = L D Lᵀ` with unit lower `L` (no square roots, zero entries stay zero), and the
//! Gram–Schmidt frame is `S = L⁻ᵀ D^(−1/2)`, upper triangular.
//!
//! In: textbook coordinates r, θ, φ as functions of the chart, with their Jacobian `J^a_k = ∂r^a/∂u^k`. Out:
//! metrics (`JᵀgJ`), vectors (`J⁻¹w`) and covectors (`Jᵀb`) of the chart ([`Pullback`]).
//!
//! On the axis formulas give no values, though the space is as smooth there as anywhere: numbers that are smooth
//! functions of the point around it are what they tend to there, from points on both sides ([`around`]).

use super::wind::{self, Medium};
use geofan_expr::{Direction, Graph, NodeId, Unary};
use glam::DVec3;

/// The way in which the manifold was given.
#[derive(Debug, Clone)]
pub(super) enum Definition {
    /// `f(u)`, N ≥ 3 components.
    Embedding(Vec<NodeId>),
    /// `g_xx, g_yy, g_zz, g_xy, g_xz, g_yz`.
    Metric([NodeId; 6]),
}

impl Definition {
    /// The expressions of the file.
    pub fn nodes(&self) -> &[NodeId] {
        match self {
            Self::Embedding(f) => f,
            Self::Metric(g) => g,
        }
    }

    /// Dimension N of the ambient space, for an embedding.
    pub fn ambient(&self) -> Option<usize> {
        match self {
            Self::Embedding(f) => Some(f.len()),
            Self::Metric(_) => None,
        }
    }
}

/// Input numbers of the tapes: chart point, tangent, then the deviation columns (δu, δv) each.
pub(super) const POINT: usize = 0;
pub(super) const TANGENT: usize = 3;
pub(super) const DEVIATION: usize = 6;

/// The entries of a symmetric matrix in the order of storage.
pub(super) const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

/// Storage position of the entry (i, j) of a symmetric matrix.
pub(super) fn symmetric(i: usize, j: usize) -> usize {
    match (i.min(j), i.max(j)) {
        (0, 0) => 0,
        (1, 1) => 1,
        (2, 2) => 2,
        (0, 1) => 3,
        (0, 2) => 4,
        _ => 5,
    }
}

/// The nodes that everything else is compiled from.
#[derive(Debug, Clone)]
pub(super) struct Geometry {
    /// `G`, six entries.
    pub metric: [NodeId; 6],
    /// `S`: s11, s22, s33, s12, s13, s23.
    pub frame: [NodeId; 6],
    /// `a^k = −Γ^k_ij v^i v^j`, and what a wind adds to it.
    pub acceleration: [NodeId; 3],
    /// `ω` with `Ṙ = [ω]× R`, in the standard frame: `[ω]× = −Ω`.
    pub turning: [NodeId; 3],
    /// `J = ∂f/∂u`, N rows of 3, for an embedding.
    pub jacobian: Option<Vec<[NodeId; 3]>>,
    /// `W`, where light has unit speed against a wind: `|v − W| = 1`.
    pub wind: Option<[NodeId; 3]>,
}

/// The factors of `G = L D Lᵀ`.
pub(super) struct Factors {
    /// Lower entries l21, l31, l32.
    lower: [NodeId; 3],
    /// 1/d1, 1/d2, 1/d3.
    inverse_diagonal: [NodeId; 3],
}

/// Builds the geometry of `definition`, through which light moves in `medium`.
pub(super) fn build(graph: &mut Graph, definition: &Definition, medium: &Medium) -> Geometry {
    let mut axes = [0, 1, 2].map(|k| Direction::of_input(graph, k));
    let mut along = along_tangent(graph);
    let v = [3, 4, 5].map(|k| graph.input(k));
    match definition {
        Definition::Embedding(f) => {
            let jacobian: Vec<[NodeId; 3]> = f
                .iter()
                .map(|&f| [0, 1, 2].map(|k| graph.derivative(f, &mut axes[k])))
                .collect();
            match medium.moves() {
                true => {
                    let g = induced(graph, &jacobian);
                    wind::build(graph, g, medium, &mut along, Some(jacobian))
                }
                false => embedded(graph, f, jacobian, &mut along),
            }
        }
        Definition::Metric(g) if medium.moves() => wind::build(graph, *g, medium, &mut along, None),
        Definition::Metric(g) => by_metric(graph, *g, v, &mut axes, &mut along),
    }
}

/// `G = JᵀJ`
fn induced(graph: &mut Graph, jacobian: &[[NodeId; 3]]) -> [NodeId; 6] {
    let columns = [0, 1, 2].map(|k| jacobian.iter().map(|row| row[k]).collect::<Vec<_>>());
    PAIRS.map(|(i, j)| graph.dot(&columns[i], &columns[j]))
}

/// The direction of the tangent: each coordinate changes at its component's rate.
fn along_tangent(graph: &mut Graph) -> Direction {
    Direction::new([0, 1, 2].map(|k| {
        (
            graph.input((POINT + k) as u32),
            graph.input((TANGENT + k) as u32),
        )
    }))
}

/// `G = JᵀJ`, `a = −G⁻¹ Jᵀ f''(v,v)`, and the antisymmetric part of `Γ_kj = r_k · D_v r_j`.
fn embedded(
    graph: &mut Graph,
    f: &[NodeId],
    jacobian: Vec<[NodeId; 3]>,
    along: &mut Direction,
) -> Geometry {
    let columns = [0, 1, 2].map(|k| jacobian.iter().map(|row| row[k]).collect::<Vec<_>>());
    let metric = induced(graph, &jacobian);
    let bending: Vec<NodeId> = f
        .iter()
        .map(|&f| {
            let first = graph.derivative(f, along);
            graph.derivative(first, along)
        })
        .collect();
    let factors = factor(graph, metric);
    let acceleration = match f {
        [x, y, z, _] if [*x, *y, *z] == [0, 1, 2].map(|k| graph.input(k)) => {
            over_the_chart(graph, jacobian[3], bending[3])
        }
        _ => {
            let force = [0, 1, 2].map(|k| {
                let along_column = graph.dot(&columns[k], &bending);
                graph.neg(along_column)
            });
            solve(graph, &factors, force)
        }
    };
    let rates = [0, 1, 2].map(|j| {
        columns[j]
            .iter()
            .map(|&r| graph.derivative(r, along))
            .collect::<Vec<_>>()
    });
    let twist = [(0, 1), (0, 2), (1, 2)].map(|(k, j)| {
        let (forth, back) = (
            graph.dot(&columns[k], &rates[j]),
            graph.dot(&columns[j], &rates[k]),
        );
        half_difference(graph, forth, back)
    });
    let bare = Bare {
        metric,
        factors,
        acceleration,
        twist,
    };
    finish(graph, bare, along, Some(jacobian))
}

/// The acceleration where `f(u) = (u, h(u))`, from `∇h` and `h''(v,v)`: there `G = 1 + ∇h ∇hᵀ`, and by
/// the formula of Sherman and Morrison `a = −∇h h''(v,v) / (1 + |∇h|²)`, half as many operations.
fn over_the_chart(graph: &mut Graph, slope: [NodeId; 3], bending: NodeId) -> [NodeId; 3] {
    let one = graph.constant(1.0);
    let steep = graph.dot(&slope, &slope);
    let steep = graph.add(one, steep);
    let share = graph.recip(steep);
    let share = graph.mul(bending, share);
    let share = graph.neg(share);
    slope.map(|h| graph.mul(share, h))
}

/// `G a = ½ ∇(vᵀGv) − Ġ v`, and the antisymmetric part ½(∂_j p_k − ∂_k p_j) with `p = G v`.
fn by_metric(
    graph: &mut Graph,
    g: [NodeId; 6],
    v: [NodeId; 3],
    axes: &mut [Direction; 3],
    along: &mut Direction,
) -> Geometry {
    let momentum = [0, 1, 2].map(|k| {
        let row = [0, 1, 2].map(|j| g[symmetric(k, j)]);
        graph.dot(&row, &v)
    });
    let speed = graph.dot(&momentum, &v);
    let half = graph.constant(0.5);
    let force = [0, 1, 2].map(|k| {
        let slope = graph.derivative(speed, &mut axes[k]);
        let slope = graph.mul(half, slope);
        // The derivative along the motion is of G alone: `v` is an input of its own.
        let change = graph.derivative(momentum[k], along);
        graph.sub(slope, change)
    });
    let twist = [(0, 1), (0, 2), (1, 2)].map(|(k, j)| {
        let forth = graph.derivative(momentum[k], &mut axes[j]);
        let back = graph.derivative(momentum[j], &mut axes[k]);
        half_difference(graph, forth, back)
    });
    let factors = factor(graph, g);
    let acceleration = match is_conformal(graph, g) {
        true => conformal(graph, g[0], v, axes),
        false => solve(graph, &factors, force),
    };
    let bare = Bare {
        metric: g,
        factors,
        acceleration,
        twist,
    };
    finish(graph, bare, along, None)
}

/// Tells whether the metric with these entries is a factor times the unit matrix.
pub(super) fn is_conformal(graph: &mut Graph, [xx, yy, zz, off @ ..]: [NodeId; 6]) -> bool {
    let zero = graph.constant(0.0);
    xx == yy && xx == zz && off == [zero; 3]
}

/// The acceleration where `G = g 1`: `a = |v|² q − 2 (q·v) v` with `q = ∇g / 2g`, half as many
/// operations.
fn conformal(
    graph: &mut Graph,
    g: NodeId,
    v: [NodeId; 3],
    axes: &mut [Direction; 3],
) -> [NodeId; 3] {
    let half = graph.constant(0.5);
    let inverse = graph.recip(g);
    let share = graph.mul(half, inverse);
    let q = [0, 1, 2].map(|k| {
        let slope = graph.derivative(g, &mut axes[k]);
        graph.mul(share, slope)
    });
    let (size, along) = (graph.dot(&v, &v), graph.dot(&q, &v));
    let twice = graph.add(along, along);
    [0, 1, 2].map(|k| {
        let (turn, slow) = (graph.mul(size, q[k]), graph.mul(twice, v[k]));
        graph.sub(turn, slow)
    })
}

pub(super) fn half_difference(graph: &mut Graph, a: NodeId, b: NodeId) -> NodeId {
    let half = graph.constant(0.5);
    let difference = graph.sub(a, b);
    graph.mul(half, difference)
}

/// The quantities from which the standard frame and its turning follow.
pub(super) struct Bare {
    pub metric: [NodeId; 6],
    pub factors: Factors,
    pub acceleration: [NodeId; 3],
    /// The antisymmetric part of `Γ_kj`.
    pub twist: [NodeId; 3],
}

pub(super) fn finish(
    graph: &mut Graph,
    bare: Bare,
    along: &mut Direction,
    jacobian: Option<Vec<[NodeId; 3]>>,
) -> Geometry {
    let frame = standard_frame(graph, &bare.factors);
    let turning = turning(graph, &bare.factors, frame, bare.twist, along);
    Geometry {
        metric: bare.metric,
        frame,
        acceleration: bare.acceleration,
        turning,
        jacobian,
        wind: None,
    }
}

pub(super) fn factor(graph: &mut Graph, [xx, yy, zz, xy, xz, yz]: [NodeId; 6]) -> Factors {
    let i1 = graph.recip(xx);
    let l21 = graph.mul(xy, i1);
    let l31 = graph.mul(xz, i1);
    let part = graph.mul(l21, xy);
    let d2 = graph.sub(yy, part);
    let i2 = graph.recip(d2);
    let part = graph.mul(l31, xy);
    let m32 = graph.sub(yz, part);
    let l32 = graph.mul(m32, i2);
    let (part1, part2) = (graph.mul(l31, xz), graph.mul(l32, m32));
    let d3 = graph.sub(zz, part1);
    let d3 = graph.sub(d3, part2);
    Factors {
        lower: [l21, l31, l32],
        inverse_diagonal: [i1, i2, graph.recip(d3)],
    }
}

/// `G⁻¹ b` by substitution.
pub(super) fn solve(graph: &mut Graph, factors: &Factors, b: [NodeId; 3]) -> [NodeId; 3] {
    let [l21, l31, l32] = factors.lower;
    let part = graph.mul(l21, b[0]);
    let y2 = graph.sub(b[1], part);
    let (part1, part2) = (graph.mul(l31, b[0]), graph.mul(l32, y2));
    let y3 = graph.sub(b[2], part1);
    let y3 = graph.sub(y3, part2);
    let [i1, i2, i3] = factors.inverse_diagonal;
    let (z1, z2, x3) = (graph.mul(b[0], i1), graph.mul(y2, i2), graph.mul(y3, i3));
    let part = graph.mul(l32, x3);
    let x2 = graph.sub(z2, part);
    let (part1, part2) = (graph.mul(l21, x2), graph.mul(l31, x3));
    let x1 = graph.sub(z1, part1);
    let x1 = graph.sub(x1, part2);
    [x1, x2, x3]
}

/// `S = L⁻ᵀ D^(−1/2)`: s11, s22, s33, s12, s13, s23.
fn standard_frame(graph: &mut Graph, factors: &Factors) -> [NodeId; 6] {
    let [l21, l31, l32] = factors.lower;
    let [e1, e2, e3] = factors
        .inverse_diagonal
        .map(|d| graph.unary(Unary::Sqrt, d));
    let s12 = graph.mul(l21, e2);
    let s12 = graph.neg(s12);
    let s23 = graph.mul(l32, e3);
    let s23 = graph.neg(s23);
    let m13 = graph.mul(l21, l32);
    let m13 = graph.sub(m13, l31);
    let s13 = graph.mul(m13, e3);
    [e1, e2, e3, s12, s13, s23]
}

/// `ω` from `Ω = antisym(S⁻¹ D_v S) + Sᵀ C S` with `C` the antisymmetric part of `Γ_kj`
/// (`S⁻¹ D_v S` is upper triangular): `ω = (Ω₂₃, −Ω₁₃, Ω₁₂)`.
fn turning(
    graph: &mut Graph,
    factors: &Factors,
    frame: [NodeId; 6],
    twist: [NodeId; 3],
    along: &mut Direction,
) -> [NodeId; 3] {
    let [s11, s22, ..] = frame;
    let [l21, l31, l32] = factors.lower;
    let rate = frame.map(|s| graph.derivative(s, along));
    let [_, r22, r33, r12, r13, r23] = rate;
    // ½ (S⁻¹ Ṡ) above the diagonal, with S⁻¹ = D^(1/2) Lᵀ and D^(1/2) = 1/diag(S).
    let half = graph.constant(0.5);
    let x12 = graph.mul_add(l21, r22, r12);
    let x13 = graph.dot(&[l21, l31], &[r23, r33]);
    let x13 = graph.add(x13, r13);
    let x23 = graph.mul_add(l32, r33, r23);
    let [u12, u13, u23] = [(x12, s11), (x13, s11), (x23, s22)].map(|(sum, scale)| {
        let quotient = graph.div(sum, scale);
        graph.mul(half, quotient)
    });
    let [t12, t13, t23] = in_frame(graph, frame, twist);
    let (o12, o13, o23) = (
        graph.add(u12, t12),
        graph.add(u13, t13),
        graph.add(u23, t23),
    );
    [o23, graph.neg(o13), o12]
}

/// `SᵀCS` of an antisymmetric `C`: entries 12, 13, 23.
pub(super) fn in_frame(
    graph: &mut Graph,
    [s11, s22, s33, s12, s13, s23]: [NodeId; 6],
    [c12, c13, c23]: [NodeId; 3],
) -> [NodeId; 3] {
    // (SᵀCS)₁₂ = s11 s22 c12, (SᵀCS)₁₃ = s11 (s23 c12 + s33 c13),
    // (SᵀCS)₂₃ = s12 (s23 c12 + s33 c13) − s13 s22 c12 + s22 s33 c23.
    let plane = graph.dot(&[s23, s33], &[c12, c13]);
    let t12 = graph.mul(s11, s22);
    let t12 = graph.mul(t12, c12);
    let t13 = graph.mul(s11, plane);
    let (first, second) = (graph.mul(s12, plane), graph.mul(s13, c12));
    let third = graph.mul(s33, c23);
    let inner = graph.sub(third, second);
    let second = graph.mul(s22, inner);
    [t12, t13, graph.add(first, second)]
}

/// The second derivative of each deviation column: the acceleration's derivative along
/// (δu, δv), for columns 0 and 1.
pub(super) fn deviation_rates(graph: &mut Graph, acceleration: [NodeId; 3]) -> [[NodeId; 3]; 2] {
    [0, 1].map(|column| {
        let seeds = (0..6).map(|k| {
            let rate = graph.input((DEVIATION + 6 * column + k) as u32);
            (graph.input(k as u32), rate)
        });
        let mut direction = Direction::new(seeds.collect::<Vec<_>>());
        acceleration.map(|a| graph.derivative(a, &mut direction))
    })
}

/// The differential of the textbook coordinates by the chart's.
#[derive(Debug, Clone)]
pub(super) struct Pullback {
    /// Rows: one for each textbook coordinate.
    rows: [[NodeId; 3]; 3],
    /// The columns of `J⁻¹ det J`, and `det J`.
    cofactors: [[NodeId; 3]; 3],
    pub determinant: NodeId,
}

impl Pullback {
    /// Prepares for these textbook coordinates.
    pub fn new(graph: &mut Graph, coordinates: [NodeId; 3]) -> Self {
        let mut axes = [0, 1, 2].map(|k| Direction::of_input(graph, k));
        let rows = coordinates.map(|r| axes.each_mut().map(|axis| graph.derivative(r, axis)));
        let cofactors = [(1, 2), (2, 0), (0, 1)].map(|(a, b)| graph.cross(rows[a], rows[b]));
        let determinant = graph.dot(&rows[0], &cofactors[0]);
        Self {
            rows,
            cofactors,
            determinant,
        }
    }

    /// `J` by rows, and its determinant.
    pub fn nodes(&self) -> Vec<NodeId> {
        let rows = self.rows.iter().flatten().copied();
        rows.chain([self.determinant]).collect()
    }

    /// `JᵀgJ`
    pub fn metric(&self, graph: &mut Graph, g: [NodeId; 6]) -> [NodeId; 6] {
        let lowered = [0, 1, 2].map(|a| {
            let row = [0, 1, 2].map(|b| g[symmetric(a, b)]);
            self.covector(graph, row)
        });
        PAIRS.map(|(k, l)| {
            let [left, right] = [
                self.rows.map(|row| row[k]),
                lowered.map(|covector| covector[l]),
            ];
            graph.dot(&left, &right)
        })
    }

    /// `J⁻¹w`
    pub fn vector(&self, graph: &mut Graph, w: [NodeId; 3]) -> [NodeId; 3] {
        [0, 1, 2].map(|k| {
            let sum = graph.dot(&w, &self.cofactors.map(|column| column[k]));
            graph.div(sum, self.determinant)
        })
    }

    /// `Jᵀb`
    pub fn covector(&self, graph: &mut Graph, b: [NodeId; 3]) -> [NodeId; 3] {
        [0, 1, 2].map(|k| graph.dot(&b, &self.rows.map(|row| row[k])))
    }
}

/// How far the nearest points are from the one asked for, as shares of its distance from the chart's
/// origin (in chart units at the origin itself). Near by, rounding spoils what is made of angles about
/// the axis; far away, the space is another. What differs least between two orders is taken.
const NEAREST: [f64; 6] = [3e-2, 1e-2, 3e-3, 1e-3, 1e-4, 1e-6];

/// From the point asked for to others: beside all coordinate axes and planes through it.
const BESIDE: DVec3 = DVec3::new(0.48, 0.6, 0.64);

/// Extrapolates what `values` tends to at `u`; not numbers if it is none around it.
pub(crate) fn around(u: DVec3, mut values: impl FnMut(DVec3) -> Vec<f64>) -> Vec<f64> {
    let scale = match u.length() {
        length if length > 0.0 => length,
        _ => 1.0,
    };
    let mut best: Option<(f64, Vec<f64>)> = None;
    for nearest in NEAREST {
        let (found, doubt) = extrapolated(u, BESIDE * (nearest * scale), &mut values);
        if best
            .as_ref()
            .is_none_or(|(least, _)| doubt < *least || least.is_nan())
        {
            best = Some((doubt, found));
        }
    }
    best.map(|(_, found)| found).unwrap_or_default()
}

/// Extrapolates the means of both sides at one, two and three times `by` to the point itself; and tells how far
/// that is, at most, from what the first two alone say.
fn extrapolated(
    u: DVec3,
    by: DVec3,
    values: &mut impl FnMut(DVec3) -> Vec<f64>,
) -> (Vec<f64>, f64) {
    let [one, two, three] = [1.0, 2.0, 3.0].map(|k| {
        let (a, b) = (values(u + by * k), values(u - by * k));
        a.iter()
            .zip(b)
            .map(|(a, b)| 0.5 * (a + b))
            .collect::<Vec<_>>()
    });
    let mut doubt = 0.0;
    let mut found = Vec::with_capacity(one.len());
    for ((a, b), c) in one.iter().zip(two).zip(three) {
        // Even functions of the distance: terms of the second and of the fourth power fall out.
        let all = (15.0 * a - 6.0 * b + c) / 10.0;
        let off = (all - (4.0 * a - b) / 3.0).abs();
        doubt = if off <= doubt { doubt } else { off };
        found.push(all);
    }
    (found, doubt)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_values_are_found_whatever_the_size_of_the_space() {
        for size in [1e-3, 1.0, 1e4] {
            let u = DVec3::new(0.0, 0.0, 2.0 * size);
            let values = |u: DVec3| {
                let (x, y) = (u.x / size, u.y / size);
                let rho2 = x * x + y * y;
                // sin ρ/ρ in disguise, with an odd function beside it.
                vec![rho2.sqrt().sin() / rho2.sqrt() + x, (u.z / size).cos()]
            };
            assert!(!values(u)[0].is_finite());
            let found = around(u, values);
            assert!((found[0] - 1.0).abs() < 1e-11, "{}", found[0]);
            assert!((found[1] - 2.0_f64.cos()).abs() < 1e-11, "{}", found[1]);
        }
    }
}
