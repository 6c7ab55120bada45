//! Light in a stationary spacetime: what it sees of the metric, its path and the turning of its frame, as graph nodes.
//!
//! # Spacetime -> metric, wind, drift and lapse
//!
//! In: the entries of `ds² = g_tt dt² + 2 g_ti dt dx^i + g_ij dx^i dx^j`, none of which depends on t
//! ([`Entries`]). Out: what its light sees, in two forms.
//!
//! Observers at rest on the slices t = const ([`normal`], after Zermelo):
//! `β_i = g_ti`, `β^i = γ^ij β_j`, `N² = β_i β^i − g_tt`, `G = γ/N²`, `W = −β`. `G` is positive definite
//! wherever the slices are spacelike, inside horizons too.
//!
//! Observers at rest in the coordinates ([`fixed`], after Randers): `V² = −g_tt`,
//! `G_ij = g_ij/V² + g_ti g_tj/V⁴`, `b_i = g_ti/V²`. They end at the ergosphere, where `V² = 0`.
//!
//! # Its path
//!
//! In: a metric `G` with a wind `W` (a vector) and a drift `b` (a covector), the parts of
//! `ĝ = −(dt − b)² + G(dx − W (dt − b))²`. Out: the acceleration of `v = ẋ` and the rate `ω` at which the
//! transported rotation turns. The parameter is `τ` with `dτ = dt − b`: without drift, the time itself.
//!
//! Light keeps `|v − W| = 1`; `n = v − W` is the direction in which the normal observer sees it move.
//! With `q = G n`, `c = 1 + q·W` and derivatives `∂` in which vectors with a bar stay as they are,
//!
//! ```text
//! G ṅ = ½ ∂(n̄ᵀG n̄) − ∂(q̄·W) − (v·∂)G n + c db(·, v) + κ q,     v̇ = ṅ + (v·∂)W
//! κ   = ½ nᵀ((v·∂)G)n − n·(½ ∂(n̄ᵀG n̄) − ∂(q̄·W)) − c db(n, v)
//! ```
//!
//! which is the conformal form of the 3+1 equation of F. Vincent, E. Gourgoulhon and J. Novak, Class.
//! Quantum Grav. 29 (2012) 245005. Frames keep `n` and turn about it as polarised light does:
//! `De = Ω × e` along `v`, with
//!
//! ```text
//! Ω = ½ curl W − n × θn + c (v (n·C) − c C) − ½ n ((1 + 2 W·n + W·W) n·C − c W·C)
//! ```
//!
//! where `θ` is the symmetric part of `∇W` and `C = curl b`. Light that is followed into the past has
//! `−W` and `−b` for `W` and `b`.

use super::geometry::{
    Bare, Geometry, PAIRS, POINT, TANGENT, factor, finish, half_difference, in_frame, solve,
    symmetric,
};
use geofan_expr::{Direction, Graph, NodeId, Unary};

/// The entries of a metric of spacetime.
#[derive(Debug, Clone, Copy)]
pub(super) struct Entries {
    pub tt: NodeId,
    /// `g_ti`
    pub t: [NodeId; 3],
    /// `g_ij`: xx, yy, zz, xy, xz, yz.
    pub space: [NodeId; 6],
}

/// Metric and medium for the observers whose world lines are normal to the slices t = const.
pub(super) fn normal(graph: &mut Graph, entries: &Entries) -> ([NodeId; 6], Medium) {
    let factors = factor(graph, entries.space);
    let shift = solve(graph, &factors, entries.t);
    let square = graph.dot(&entries.t, &shift);
    let square = graph.sub(square, entries.tt);
    let lapse = graph.unary(Unary::Sqrt, square);
    let (metric, wind) = sliced(graph, entries.space, shift, square);
    let medium = Medium {
        wind: Some(wind),
        drift: None,
        lapse: Some(lapse),
    };
    (metric, medium)
}

/// `γ/N²` and `−β` of slices with metric γ, shift β and the square N² of the lapse.
pub(super) fn sliced(
    graph: &mut Graph,
    space: [NodeId; 6],
    shift: [NodeId; 3],
    square: NodeId,
) -> ([NodeId; 6], [NodeId; 3]) {
    let metric = space.map(|g| graph.div(g, square));
    (metric, shift.map(|b| graph.neg(b)))
}

/// Metric and medium for the observers at rest in the coordinates, and `V²`, positive where there are
/// any.
pub(super) fn fixed(graph: &mut Graph, entries: &Entries) -> ([NodeId; 6], Medium, NodeId) {
    let square = graph.neg(entries.tt);
    let drift = entries.t.map(|g| graph.div(g, square));
    let mut metric = entries.space;
    for (g, (i, j)) in metric.iter_mut().zip(PAIRS) {
        let own = graph.div(*g, square);
        *g = graph.mul_add(drift[i], drift[j], own);
    }
    let lapse = graph.unary(Unary::Sqrt, square);
    let medium = Medium {
        wind: None,
        drift: Some(drift),
        lapse: Some(lapse),
    };
    (metric, medium, square)
}

/// Three components.
type Vector = [NodeId; 3];

/// The pairs of indices of an antisymmetric matrix, in the order of storage.
const PLANES: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// The parts of a stationary spacetime beside the metric.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Medium {
    /// `W`, chart components.
    pub wind: Option<Vector>,
    /// `b`, chart components of a covector.
    pub drift: Option<Vector>,
    /// N, by which frequencies of normal observers are divided.
    pub lapse: Option<NodeId>,
}

impl Medium {
    /// Returns whether paths of light differ from geodesics of the metric.
    pub fn moves(&self) -> bool {
        self.wind.is_some() || self.drift.is_some()
    }

    /// Returns whether it has anything at all.
    pub fn is_some(&self) -> bool {
        self.moves() || self.lapse.is_some()
    }

    /// As met by light that is followed into the past.
    pub fn reversed(self, graph: &mut Graph) -> Self {
        let mut negated = |vector: Vector| vector.map(|x| graph.neg(x));
        Self {
            wind: self.wind.map(&mut negated),
            drift: self.drift.map(&mut negated),
            lapse: self.lapse,
        }
    }

    /// The expressions on which paths depend.
    pub fn nodes(&self) -> impl Iterator<Item = NodeId> {
        self.wind.into_iter().chain(self.drift).flatten()
    }
}

/// `∂_k b_j − ∂_j b_k` for the planes (k, j).
pub(super) fn exterior(graph: &mut Graph, b: Vector) -> Vector {
    let mut axes = [0, 1, 2].map(|k| Direction::of_input(graph, k));
    PLANES.map(|(k, j)| {
        let forth = graph.derivative(b[j], &mut axes[k]);
        let back = graph.derivative(b[k], &mut axes[j]);
        graph.sub(forth, back)
    })
}

/// The geometry of light in `medium`, where the metric is `g`.
pub(super) fn build(
    graph: &mut Graph,
    g: [NodeId; 6],
    medium: &Medium,
    along: &mut Direction,
    jacobian: Option<Vec<Vector>>,
) -> Geometry {
    let factors = factor(graph, g);
    let state = State::new(graph, g, medium);
    let (force, along_n) = state.force(graph, along);
    let turned = solve(graph, &factors, force);
    let acceleration = [0, 1, 2].map(|i| {
        let n_rate = graph.mul_add(along_n, state.n[i], turned[i]);
        let change = graph.derivative(state.w[i], along);
        graph.add(n_rate, change)
    });
    let twist = PLANES.map(|(k, j)| {
        let forth = state.bend(graph, state.v, j, k);
        let back = state.bend(graph, state.v, k, j);
        half_difference(graph, forth, back)
    });
    let bare = Bare {
        metric: g,
        factors,
        acceleration,
        twist,
    };
    let mut geometry = finish(graph, bare, along, jacobian);
    let spin = state.spin(graph, geometry.frame);
    geometry.turning = sum(graph, geometry.turning, spin);
    geometry.wind = Some(state.w);
    geometry
}

/// Everything at one point of a path that its rates are made of.
struct State {
    g: [NodeId; 6],
    /// `∂_k G` and `∂_k W`.
    slopes: [[NodeId; 6]; 3],
    wind_slopes: [Vector; 3],
    /// `db` for the planes (k, j).
    drift: Option<Vector>,
    v: Vector,
    w: Vector,
    n: Vector,
    /// `G n` and `G W`.
    q: Vector,
    p: Vector,
}

impl State {
    fn new(graph: &mut Graph, g: [NodeId; 6], medium: &Medium) -> Self {
        let mut axes = [0, 1, 2].map(|k| Direction::of_input(graph, k));
        let v = [0, 1, 2].map(|k| graph.input((TANGENT + k) as u32));
        let w = medium.wind.unwrap_or_else(|| [graph.constant(0.0); 3]);
        let n = [0, 1, 2].map(|k| graph.sub(v[k], w[k]));
        Self {
            g,
            slopes: axes
                .each_mut()
                .map(|axis| g.map(|g| graph.derivative(g, axis))),
            wind_slopes: axes
                .each_mut()
                .map(|axis| w.map(|w| graph.derivative(w, axis))),
            drift: medium.drift.map(|b| exterior(graph, b)),
            v,
            w,
            n,
            q: apply(graph, g, n),
            p: apply(graph, g, w),
        }
    }

    /// `(∂_k G x)_i`
    fn bend(&self, graph: &mut Graph, x: Vector, k: usize, i: usize) -> NodeId {
        let row = [0, 1, 2].map(|j| self.slopes[k][symmetric(i, j)]);
        graph.dot(&row, &x)
    }

    /// `((x·∂)W)_i`
    fn wind_change(&self, graph: &mut Graph, x: Vector, i: usize) -> NodeId {
        let column = self.wind_slopes.map(|slope| slope[i]);
        graph.dot(&column, &x)
    }

    /// `∂(q̄·W)`
    fn drag(&self, graph: &mut Graph) -> Vector {
        self.wind_slopes.map(|slope| graph.dot(&self.q, &slope))
    }

    /// `1 + q·W`
    fn share(&self, graph: &mut Graph) -> NodeId {
        let one = graph.constant(1.0);
        let along = graph.dot(&self.q, &self.w);
        graph.add(one, along)
    }

    /// `G ṅ` without `κ q`, and `κ`; `along` is the direction of the tangent.
    fn force(&self, graph: &mut Graph, along: &mut Direction) -> (Vector, NodeId) {
        let half = graph.constant(0.5);
        let pull = self.pull(graph);
        let rates = self.g.map(|g| graph.derivative(g, along));
        let change = apply(graph, rates, self.n);
        let mut force = difference(graph, pull, change);
        let (bent, pulled) = (graph.dot(&self.n, &change), graph.dot(&self.n, &pull));
        let bent = graph.mul(half, bent);
        let mut along_n = graph.sub(bent, pulled);
        if let Some(push) = self.push(graph) {
            force = sum(graph, force, push);
            let part = graph.dot(&self.n, &push);
            along_n = graph.sub(along_n, part);
        }
        (force, along_n)
    }

    /// `½ ∂(n̄ᵀG n̄) − ∂(q̄·W)`
    fn pull(&self, graph: &mut Graph) -> Vector {
        let half = graph.constant(0.5);
        let squares = PAIRS.map(|(i, j)| {
            let product = graph.mul(self.n[i], self.n[j]);
            match i == j {
                true => graph.mul(half, product),
                false => product,
            }
        });
        let drags = self.q.map(|q| graph.neg(q));
        let roots = self.g.into_iter().chain(self.w);
        let weighted: Vec<_> = roots.zip(squares.into_iter().chain(drags)).collect();
        let inputs = [0, 1, 2].map(|k| graph.input((POINT + k) as u32));
        let gradient = graph.gradient(&weighted, &inputs);
        [gradient[0], gradient[1], gradient[2]]
    }

    /// `c db(·, v)`; `None` without drift.
    fn push(&self, graph: &mut Graph) -> Option<Vector> {
        let [b12, b13, b23] = self.drift?;
        let [x, y, z] = self.v;
        let share = self.share(graph);
        let first = graph.dot(&[b12, b13], &[y, z]);
        let (ahead, behind) = (graph.mul(b23, z), graph.mul(b12, x));
        let second = graph.sub(ahead, behind);
        let third = graph.dot(&[b13, b23], &[x, y]);
        let third = graph.neg(third);
        Some([first, second, third].map(|x| graph.mul(share, x)))
    }

    /// `Ω` in the standard frame.
    fn spin(&self, graph: &mut Graph, frame: [NodeId; 6]) -> Vector {
        let half = graph.constant(0.5);
        let vortex = self.vortex(graph);
        let curl = curl(graph, frame, vortex);
        let curl = scaled(graph, half, curl);
        let n = raised(graph, frame, self.q);
        let strained = self.strained(graph);
        let strained = raised(graph, frame, strained);
        let tilt = graph.cross(n, strained);
        let spin = difference(graph, curl, tilt);
        match self.drift {
            None => spin,
            Some(drift) => {
                let w = raised(graph, frame, self.p);
                let vortices = self::curl(graph, frame, drift);
                let own = self.drift_spin(graph, n, w, vortices);
                sum(graph, spin, own)
            }
        }
    }

    /// The part of `Ω` that comes from `C = curl b`; vectors in the standard frame.
    fn drift_spin(&self, graph: &mut Graph, n: Vector, w: Vector, curl: Vector) -> Vector {
        let (share, half) = (self.share(graph), graph.constant(0.5));
        let (n_curl, w_curl) = (graph.dot(&n, &curl), graph.dot(&w, &curl));
        let v = sum(graph, n, w);
        let forth = scaled(graph, n_curl, v);
        let back = scaled(graph, share, curl);
        let across = difference(graph, forth, back);
        let across = scaled(graph, share, across);
        // 1 + 2 W·n + W·W = c + (c − 1) + W·W
        let one = graph.constant(1.0);
        let speed = graph.dot(&w, &w);
        let twice = graph.add(share, share);
        let size = graph.add(twice, speed);
        let size = graph.sub(size, one);
        let (first, second) = (graph.mul(size, n_curl), graph.mul(share, w_curl));
        let about = graph.sub(first, second);
        let about = graph.mul(half, about);
        let about = scaled(graph, about, n);
        difference(graph, across, about)
    }

    /// `∂_k p_j − ∂_j p_k` of `p = G W` for the planes (k, j).
    fn vortex(&self, graph: &mut Graph) -> Vector {
        let mut rate = |k: usize, j: usize| {
            let bent = self.bend(graph, self.w, k, j);
            let row = [0, 1, 2].map(|i| self.g[symmetric(j, i)]);
            let moved = graph.dot(&row, &self.wind_slopes[k]);
            graph.add(bent, moved)
        };
        let rates = PLANES.map(|(k, j)| (rate(k, j), rate(j, k)));
        rates.map(|(forth, back)| graph.sub(forth, back))
    }

    /// `G θ n`, half the Lie derivative of the metric along the wind.
    fn strained(&self, graph: &mut Graph) -> Vector {
        let half = graph.constant(0.5);
        let change = [0, 1, 2].map(|i| self.wind_change(graph, self.n, i));
        let pushed = apply(graph, self.g, change);
        let drag = self.drag(graph);
        [0, 1, 2].map(|i| {
            let bends = [0, 1, 2].map(|k| self.bend(graph, self.n, k, i));
            let carried = graph.dot(&self.w, &bends);
            let both = graph.add(drag[i], pushed[i]);
            let all = graph.add(carried, both);
            graph.mul(half, all)
        })
    }
}

/// `G x`
pub(super) fn apply(graph: &mut Graph, g: [NodeId; 6], x: Vector) -> Vector {
    [0, 1, 2].map(|i| {
        let row = [0, 1, 2].map(|j| g[symmetric(i, j)]);
        graph.dot(&row, &x)
    })
}

/// The components in the standard frame of the vector whose covector is `q`: `Sᵀ q`.
fn raised(graph: &mut Graph, frame: [NodeId; 6], q: Vector) -> Vector {
    let [s11, s22, s33, s12, s13, s23] = frame;
    [
        graph.mul(s11, q[0]),
        graph.dot(&[s12, s22], &q[..2]),
        graph.dot(&[s13, s23, s33], &q),
    ]
}

/// The curl, in the standard frame, of a covector with this exterior derivative.
fn curl(graph: &mut Graph, frame: [NodeId; 6], exterior: Vector) -> Vector {
    let [d12, d13, d23] = in_frame(graph, frame, exterior);
    [d23, graph.neg(d13), d12]
}

fn sum(graph: &mut Graph, a: Vector, b: Vector) -> Vector {
    [0, 1, 2].map(|k| graph.add(a[k], b[k]))
}

fn difference(graph: &mut Graph, a: Vector, b: Vector) -> Vector {
    [0, 1, 2].map(|k| graph.sub(a[k], b[k]))
}

fn scaled(graph: &mut Graph, factor: NodeId, a: Vector) -> Vector {
    a.map(|x| graph.mul(factor, x))
}
