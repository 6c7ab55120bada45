//! Deck transformations: the isometries of a chart by which paths are brought back into a glued domain; and faces that
//! are planes or spheres of the chart, which in the same coordinates are linear functions.
//!
//! In: a map of the chart as a tape, or a matrix in a linear model. Out: a [`DeckTransformation`], which can be
//! applied with its differential and composed with others. Where all maps of a gluing are affine, or Möbius
//! transformations (every isometry of S³, H³ and E³ in a conformal chart is one: a matrix that acts on (u, |u|², 1)),
//! or linear in a model that the file names, a product of however many is one matrix; otherwise it is the chain of
//! their tapes.
//!
//! In: the tape of all faces. Out: [`Spheres`] where every value is linear in (u, |u|², 1), as those of most spaces
//! are, or is so for its share of the metric's scale, as those of Dirichlet's domains are in conformal charts: their
//! values without a tape. Points are brought back into a domain many times for every pixel; so each time costs a tenth.

use geofan_expr::Tape;
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// A matrix that acts on (u, |u|², 1) up to scale.
type Lorentz = [[f64; 5]; 5];

/// Relative difference up to which a map is taken for an affine or a Möbius one: some roundings of its expressions.
const SAME_MAP: f64 = 1e-11;

/// A model in which isometries are linear.
#[derive(Debug)]
pub(in crate::manifold) struct LinearModel {
    /// Dimension N.
    pub dimension: usize,
    /// u -> X (N), ∂X/∂u_k (3 × N).
    pub lift: Tape,
    /// X -> u (3), ∂u/∂X_j (N × 3).
    pub drop: Tape,
}

/// The form in which products of maps are kept.
#[derive(Debug, Clone)]
enum Rule {
    /// `u -> A u + t`.
    Affine(DMat3, DVec3),
    /// Linear on (u, |u|², 1), up to scale.
    Moebius(Lorentz),
    /// A matrix (by rows) in a model.
    Linear(Vec<f64>, Arc<LinearModel>),
    /// Tapes u -> φ(u) (3), ∂φ (9, by rows), first to last.
    Tapes(Vec<Arc<Tape>>),
}

/// An isometry of the covering chart.
#[derive(Debug, Clone)]
pub struct DeckTransformation {
    rule: Rule,
    /// Set if it turns right into left.
    reverses: bool,
}

impl DeckTransformation {
    /// Takes the matrix (by rows) of a map in a model.
    pub(in crate::manifold) fn linear(matrix: Vec<f64>, model: Arc<LinearModel>) -> Self {
        Self {
            rule: Rule::Linear(matrix, model),
            reverses: false,
        }
    }

    /// Takes a map given by a tape.
    pub(super) fn chain(tape: Arc<Tape>) -> Self {
        Self {
            rule: Rule::Tapes(vec![tape]),
            reverses: false,
        }
    }

    /// Finds the form, affine or Möbius, that the maps given by tapes all have at `points`; `None` if neither is.
    pub(super) fn recognised(tapes: &[Arc<Tape>], points: &[DVec3]) -> Option<Vec<Self>> {
        let each = |form: fn(&Tape, &[DVec3]) -> Option<Rule>| -> Option<Vec<Rule>> {
            tapes.iter().map(|tape| form(tape, points)).collect()
        };
        let rules = each(affine).or_else(|| each(moebius))?;
        let transformation = |rule| Self {
            rule,
            reverses: false,
        };
        Some(rules.into_iter().map(transformation).collect())
    }

    /// Tells which way round it turns things.
    pub(super) fn reversing(mut self, reverses: bool) -> Self {
        self.reverses = reverses;
        self
    }

    /// Returns whether it turns right into left.
    pub fn reverses(&self) -> bool {
        self.reverses
    }

    /// Makes the one transformation of a space whose faces have no maps: it moves nothing.
    pub(super) fn alone() -> Self {
        Self {
            rule: Rule::Tapes(Vec::new()),
            reverses: false,
        }
    }

    /// Returns the transformation of the same kind that moves nothing.
    pub fn identity(&self) -> Self {
        let rule = match &self.rule {
            Rule::Affine(..) => Rule::Affine(DMat3::IDENTITY, DVec3::ZERO),
            Rule::Moebius(_) => Rule::Moebius(std::array::from_fn(|i| {
                std::array::from_fn(|j| f64::from(u8::from(i == j)))
            })),
            Rule::Linear(_, model) => {
                let n = model.dimension;
                let unit = (0..n * n).map(|k| f64::from(u8::from(k / n == k % n)));
                Rule::Linear(unit.collect(), model.clone())
            }
            Rule::Tapes(_) => Rule::Tapes(Vec::new()),
        };
        Self {
            rule,
            reverses: false,
        }
    }

    /// Returns `next` after this one; both must be of one gluing.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        let rule = match (&self.rule, &next.rule) {
            (Rule::Affine(a, s), Rule::Affine(b, t)) => Rule::Affine(*b * *a, *b * *s + *t),
            (Rule::Moebius(a), Rule::Moebius(b)) => Rule::Moebius(std::array::from_fn(|i| {
                std::array::from_fn(|j| (0..5).map(|k| b[i][k] * a[k][j]).sum())
            })),
            (Rule::Linear(a, model), Rule::Linear(b, _)) => {
                Rule::Linear(product(b, a, model.dimension), model.clone())
            }
            (Rule::Tapes(a), Rule::Tapes(b)) => Rule::Tapes([a.as_slice(), b].concat()),
            // Maps of one gluing are of one kind.
            _ => unreachable!("deck transformations of different gluings"),
        };
        Self {
            rule,
            reverses: self.reverses != next.reverses,
        }
    }

    /// Returns the image of `u` and the differential there, chart components to chart components.
    pub fn apply(&self, u: DVec3) -> (DVec3, DMat3) {
        match &self.rule {
            Rule::Affine(a, t) => (*a * u + *t, *a),
            Rule::Moebius(m) => apply_moebius(m, u),
            Rule::Linear(matrix, model) => model.apply(matrix, u),
            Rule::Tapes(tapes) => {
                let start = (u, DMat3::IDENTITY);
                tapes.iter().fold(start, |(u, d), tape| {
                    let (u, next) = at_tape(tape, u);
                    (u, next * d)
                })
            }
        }
    }

    /// Returns the image of `u`.
    pub fn point(&self, u: DVec3) -> DVec3 {
        match &self.rule {
            Rule::Affine(a, t) => *a * u + *t,
            Rule::Moebius(m) => {
                let y = times(m, on_cone(u));
                DVec3::new(y[0], y[1], y[2]) * (1.0 / y[4])
            }
            Rule::Linear(..) | Rule::Tapes(_) => self.apply(u).0,
        }
    }
}

impl DeckTransformation {
    /// Carries the points and tangents of `W` lanes, chart components by rows.
    #[inline(always)]
    pub fn carry_lanes<const W: usize>(&self, u: &mut [[f64; W]; 3], v: &mut [[f64; W]; 3]) {
        if let Rule::Moebius(m) = &self.rule {
            return carry_by_moebius(m, u, v);
        }
        for l in 0..W {
            let [at, along] = [&*u, &*v].map(|x| DVec3::new(x[0][l], x[1][l], x[2][l]));
            let (image, d) = self.apply(at);
            let along = d * along;
            for c in 0..3 {
                (u[c][l], v[c][l]) = (image[c], along[c]);
            }
        }
    }

    /// Bounds from above by how much its differential `d` somewhere stretches, in the chart: `σ² <= ‖dᵀd‖∞`, which is
    /// equal for rotations and for stretches along axes.
    pub fn stretch(&self, d: DMat3) -> f64 {
        // Möbius transformations stretch alike in all directions.
        if matches!(self.rule, Rule::Moebius(_)) {
            return d.x_axis.length();
        }
        let square = d.transpose() * d;
        let sums = square.x_axis.abs() + square.y_axis.abs() + square.z_axis.abs();
        sums.max_element().sqrt()
    }
}

/// Does [`DeckTransformation::carry_lanes`] for a Möbius transformation.
#[inline(always)]
fn carry_by_moebius<const W: usize>(m: &Lorentz, u: &mut [[f64; W]; 3], v: &mut [[f64; W]; 3]) {
    let (mut cone, mut rate) = ([[1.0; W]; 5], [[0.0; W]; 5]);
    (cone[3], rate[3]) = ([0.0; W], [0.0; W]);
    for c in 0..3 {
        (cone[c], rate[c]) = (u[c], v[c]);
        for l in 0..W {
            cone[3][l] += u[c][l] * u[c][l];
            rate[3][l] += 2.0 * u[c][l] * v[c][l];
        }
    }
    let (mut y, mut dy) = ([[0.0; W]; 5], [[0.0; W]; 5]);
    for row in [0, 1, 2, 4] {
        for k in 0..5 {
            let entry = m[row][k];
            for l in 0..W {
                y[row][l] += entry * cone[k][l];
                dy[row][l] += entry * rate[k][l];
            }
        }
    }
    for l in 0..W {
        let share = 1.0 / y[4][l];
        for c in 0..3 {
            u[c][l] = y[c][l] * share;
            v[c][l] = (dy[c][l] - u[c][l] * dy[4][l]) * share;
        }
    }
}

/// Computes the image and the differential that the tape of a map gives.
pub(super) fn at_tape(tape: &Tape, u: DVec3) -> (DVec3, DMat3) {
    let o = tape.at(&u.to_array());
    let rows = DMat3::from_cols_slice(&o[3..12]);
    (DVec3::from_slice(&o[..3]), rows.transpose())
}

/// Multiplies two square matrices, by rows.
pub(in crate::manifold) fn product(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    let entry = |k: usize| (0..n).map(|j| a[k / n * n + j] * b[j * n + k % n]).sum();
    (0..n * n).map(entry).collect()
}

impl LinearModel {
    /// Applies the matrix (by rows) to the chart point `u`.
    fn apply(&self, matrix: &[f64], u: DVec3) -> (DVec3, DMat3) {
        let n = self.dimension;
        let lifted = self.lift.at(&u.to_array());
        // X, then ∂X/∂u_k.
        let mut moved = Vec::with_capacity(4 * n);
        for column in lifted.chunks_exact(n) {
            let entry = |row: &[f64]| row.iter().zip(column).map(|(a, b)| a * b).sum::<f64>();
            moved.extend(matrix.chunks_exact(n).map(entry));
        }
        let dropped = self.drop.at(&moved[..n]);
        let columns = [1, 2, 3].map(|k| {
            let rates = &moved[k * n..(k + 1) * n];
            let parts = rates.iter().zip(dropped[3..].chunks_exact(3));
            parts.fold(DVec3::ZERO, |sum, (rate, part)| {
                sum + DVec3::from_slice(part) * *rate
            })
        });
        let d = DMat3::from_cols(columns[0], columns[1], columns[2]);
        (DVec3::from_slice(&dropped[..3]), d)
    }
}

/// Returns `(u, |u|², 1)`.
#[inline(always)]
fn on_cone(u: DVec3) -> [f64; 5] {
    [u.x, u.y, u.z, u.length_squared(), 1.0]
}

/// Multiplies a matrix and a column.
#[inline(always)]
fn times(m: &Lorentz, x: [f64; 5]) -> [f64; 5] {
    let mut y = [0.0; 5];
    for (y, row) in y.iter_mut().zip(m) {
        for k in 0..5 {
            *y += row[k] * x[k];
        }
    }
    y
}

fn apply_moebius(m: &Lorentz, u: DVec3) -> (DVec3, DMat3) {
    let y = times(m, on_cone(u));
    let share = 1.0 / y[4];
    let image = DVec3::new(y[0], y[1], y[2]) * share;
    let columns = [0, 1, 2].map(|k| {
        let e = DVec3::AXES[k];
        let rate = times(m, [e.x, e.y, e.z, 2.0 * u[k], 0.0]);
        (DVec3::new(rate[0], rate[1], rate[2]) - image * rate[4]) * share
    });
    (image, DMat3::from_cols(columns[0], columns[1], columns[2]))
}

/// Returns whether `map` and the tape take points to the same images, but for rounding.
fn agree(map: impl Fn(DVec3) -> DVec3, tape: &Tape, points: &[DVec3]) -> bool {
    let images: Vec<DVec3> = points.iter().map(|u| at_tape(tape, *u).0).collect();
    let spread = |all: &[DVec3]| {
        all.iter()
            .map(|u| (*u - all[0]).length())
            .fold(0.0, f64::max)
    };
    let size = spread(points).max(spread(&images));
    let mut pairs = points.iter().zip(&images);
    size.is_finite()
        && pairs.all(|(u, image)| (map(*u) - image).length() <= SAME_MAP * (size + image.length()))
}

/// Finds the affine map that the tape agrees with at `points`, if it does.
fn affine(tape: &Tape, points: &[DVec3]) -> Option<Rule> {
    let (image, a) = at_tape(tape, *points.first()?);
    let t = image - a * points[0];
    agree(|u| a * u + t, tape, points).then_some(Rule::Affine(a, t))
}

/// Finds the Möbius transformation that the tape agrees with at `points`, if it does. Its conformal factor κ is one over
/// a linear function of (u, |u|², 1), and κ⁻¹ (φ, |φ|², 1) is linear as well: five points decide.
fn moebius(tape: &Tape, points: &[DVec3]) -> Option<Rule> {
    let stride = points.len() / 5;
    let chosen: Vec<DVec3> = (0..5)
        .map(|i| points.get(i * stride).copied())
        .collect::<Option<_>>()?;
    let mut rows = [[0.0; 10]; 5];
    for (row, u) in rows.iter_mut().zip(&chosen) {
        let (image, d) = at_tape(tape, *u);
        let inverse = 1.0 / d.determinant().abs().cbrt();
        row[..5].copy_from_slice(&on_cone(*u));
        for (value, x) in row[5..].iter_mut().zip(on_cone(image)) {
            *value = x * inverse;
        }
    }
    let solved = solve(rows)?;
    let matrix: Lorentz = std::array::from_fn(|i| std::array::from_fn(|j| solved[j][i]));
    let agrees = agree(|u| apply_moebius(&matrix, u).0, tape, points);
    agrees.then_some(Rule::Moebius(matrix))
}

/// Solves `A X = B` for the rows `(A | B)` by Gauss's elimination with pivots; `None` for a singular `A`.
fn solve(mut rows: [[f64; 10]; 5]) -> Option<[[f64; 5]; 5]> {
    for k in 0..5 {
        let pivot = (k..5).max_by(|a, b| rows[*a][k].abs().total_cmp(&rows[*b][k].abs()))?;
        rows.swap(k, pivot);
        let scale = 1.0 / rows[k][k];
        if !scale.is_finite() {
            return None;
        }
        rows[k] = rows[k].map(|x| x * scale);
        let pivot = rows[k];
        for (i, row) in rows.iter_mut().enumerate() {
            let factor = row[k];
            if i != k {
                for (x, p) in row.iter_mut().zip(pivot) {
                    *x -= factor * p;
                }
            }
        }
    }
    Some(rows.map(|row| std::array::from_fn(|j| row[5 + j])))
}

/// Share of its terms by which a value may differ from the tape's.
const SAME_VALUE: f64 = 1e-11;

/// How far from their middle points are pushed to look at faces outside the domain, as multiples of their distance.
const OUTSIDE: [f64; 4] = [1.0, 1.7, 4.0, 30.0];

/// The faces as linear functions of (u, |u|², 1).
#[derive(Debug, Clone)]
pub(super) struct Spheres(Vec<[f64; 5]>);

impl Spheres {
    /// Finds the functions that `values`, of as many faces, agrees with at `points` in general position and farther out,
    /// wherever it has values, if it does.
    pub fn of(
        values: &dyn Fn(DVec3) -> Option<Vec<f64>>,
        faces: usize,
        points: &[DVec3],
    ) -> Option<Self> {
        let stride = points.len() / 5;
        let chosen: Vec<DVec3> = (0..5)
            .map(|i| points.get(i * stride).copied())
            .collect::<Option<_>>()?;
        let at: Vec<Vec<f64>> = chosen.iter().map(|u| values(*u)).collect::<Option<_>>()?;
        let mut rows = Vec::with_capacity(faces);
        for first in (0..faces).step_by(5) {
            let mut system = [[0.0; 10]; 5];
            for (row, (u, values)) in system.iter_mut().zip(chosen.iter().zip(&at)) {
                row[..5].copy_from_slice(&on_cone(*u));
                for (to, value) in row[5..].iter_mut().zip(&values[first..faces]) {
                    *to = *value;
                }
            }
            let solved = solve(system)?;
            let count = 5.min(faces - first);
            rows.extend((0..count).map(|k| std::array::from_fn(|j| solved[j][k])));
        }
        let spheres = Self(rows);
        let middle = points.iter().sum::<DVec3>() / points.len() as f64;
        let mut places = points.iter().flat_map(|u| {
            let pushed = |factor: &f64| middle + (*u - middle) * *factor;
            OUTSIDE.iter().map(pushed).collect::<Vec<_>>()
        });
        let agrees = |u: DVec3| {
            values(u).is_none_or(|values| {
                (0..faces)
                    .all(|k| (spheres.value(k, u) - values[k]).abs() <= spheres.rounding(k, u))
            })
        };
        places.all(agrees).then_some(spheres)
    }

    /// Computes the value of face `k` at `u`.
    #[inline(always)]
    pub fn value(&self, k: usize, u: DVec3) -> f64 {
        let [a, b, c, d, e] = self.0[k];
        a * u.x + b * u.y + c * u.z + d * u.length_squared() + e
    }

    /// Computes the gradient of face `k` at `u`.
    #[inline(always)]
    pub fn gradient(&self, k: usize, u: DVec3) -> DVec3 {
        let [a, b, c, d, _] = self.0[k];
        DVec3::new(a, b, c) + u * (2.0 * d)
    }

    /// Returns by how much the value of face `k` at `u` may be off.
    fn rounding(&self, k: usize, u: DVec3) -> f64 {
        let terms = self.0[k].iter().zip(on_cone(u));
        SAME_VALUE * terms.map(|(a, x)| (a * x).abs()).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_expr::{
        Direction, Graph,
        parse::{Binding, Scope, parse},
    };

    fn tape(texts: [&str; 3]) -> Arc<Tape> {
        let (mut graph, mut scope) = (Graph::new(), Scope::default());
        for (k, name) in ["x", "y", "z"].into_iter().enumerate() {
            scope.bind(name, Binding::fixed(graph.input(k as u32)));
        }
        let mut nodes = texts
            .map(|text| parse(text, &scope, &mut graph).unwrap().node)
            .to_vec();
        for row in 0..3 {
            for k in 0..3 {
                let mut axis = Direction::of_input(&mut graph, k);
                nodes.push(graph.derivative(nodes[row], &mut axis));
            }
        }
        Arc::new(Tape::compile(&graph, &nodes, 3).unwrap())
    }

    /// Points in general position.
    fn points() -> Vec<DVec3> {
        let point = |i: i32| {
            let t = f64::from(i);
            DVec3::new((1.3 * t).sin(), (2.1 * t).cos(), (0.7 * t + 1.0).sin()) * 0.4
        };
        (0..20).map(point).collect()
    }

    /// The composition of two maps is that of their tapes, with its differential.
    fn check_composition(texts: [[&str; 3]; 2], is_right_form: fn(&Rule) -> bool) {
        let tapes = texts.map(tape);
        let recognised = DeckTransformation::recognised(&tapes, &points());
        let chains = || {
            tapes
                .iter()
                .cloned()
                .map(DeckTransformation::chain)
                .collect()
        };
        let maps: Vec<DeckTransformation> = recognised.unwrap_or_else(chains);
        assert!(maps.iter().all(|m| is_right_form(&m.rule)));
        let both = maps[0].then(&maps[1]).then(&maps[1].identity());
        for u in points() {
            let (a, da) = at_tape(&tapes[0], u);
            let (b, db) = at_tape(&tapes[1], a);
            let (image, d) = both.apply(u);
            assert!((image - b).length() < 1e-12 * (1.0 + b.length()));
            let off = (d - db * da).to_cols_array();
            assert!(off.iter().all(|x| x.abs() < 1e-11 * (1.0 + b.length())));
            let along = DVec3::new(0.3, -0.4, 0.7);
            let lanes = |x: DVec3| x.to_array().map(|x| [x, x]);
            let (mut at, mut tangent) = (lanes(u), lanes(along));
            both.carry_lanes(&mut at, &mut tangent);
            let [at, tangent] = [at, tangent].map(|x| DVec3::from(x.map(|x| x[1])));
            assert!((at - image).length() < 1e-12 * (1.0 + b.length()));
            assert!((tangent - d * along).length() < 1e-11 * (1.0 + b.length()));
            assert!((d * along).length() < 1.0001 * both.stretch(d) * along.length());
        }
    }

    #[test]
    fn affine_maps_compose_as_matrices() {
        check_composition(
            [["x + 1", "y + 2*z", "z - x"], ["2*y", "z", "x - 3"]],
            |rule| matches!(rule, Rule::Affine(..)),
        );
    }

    #[test]
    fn inversions_and_similarities_compose_as_moebius_transformations() {
        let d = "((x - 2)^2 + (y - 1)^2 + z^2)";
        let inversion = ["2 + 3*(x - 2)/D", "1 + 3*(y - 1)/D", "3*z/D"].map(|t| t.replace('D', d));
        check_composition(
            [
                inversion.each_ref().map(String::as_str),
                ["-y", "x + 0.1", "z"],
            ],
            |rule| matches!(rule, Rule::Moebius(_)),
        );
    }

    #[test]
    fn other_maps_compose_as_chains() {
        check_composition([["x + y*z", "y", "z"], ["x", "exp(y)", "z"]], |rule| {
            matches!(rule, Rule::Tapes(_))
        });
    }
}
