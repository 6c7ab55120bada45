//! A function of two points of a linear model that a group of matrices keeps.
//!
//! In: points of the model, and generators. Out: a number that grows with the distance from the centre, and by how much an
//! element makes it grow, which is linear in the model. So it is for spheres and hyperboloids (a diagonal form of signs
//! that is constant on the space), and for products of these with lines.

use super::quotient::{SAME, dot};

/// A function of a point X of the model and the centre that the group keeps, and that grows with their distance:
/// `−Q(X, X(c)) + ½ Σ (X_k − X(c)_k)²`.
pub(super) struct InvariantForm {
    /// `−Q X(c)`.
    linear: Vec<f64>,
    /// The coordinates k of the sum: along lines, on which the group acts by motions.
    lines: Vec<usize>,
    /// That which is 1.
    one: usize,
    centre: Vec<f64>,
}

impl InvariantForm {
    /// Computes it for the point `x` of the model.
    pub fn of(&self, x: &[f64]) -> f64 {
        let along = self.lines.iter().map(|k| (x[*k] - self.centre[*k]).powi(2));
        dot(&self.linear, x) + 0.5 * along.sum::<f64>()
    }

    /// Tells whether the point `x` of the model is on the centre's sheet of a hyperboloid: −Q(X, X(c)) is at least
    /// q = −Q(X(c), X(c)) there, and at most −q on the other one. On a sphere, where q is negative, it is at least q everywhere.
    pub fn is_on_sheet(&self, x: &[f64]) -> bool {
        let q = dot(&self.linear, &self.centre);
        dot(&self.linear, x) > q - q.abs()
    }

    /// Returns the linear function of X by which it grows from X to `matrix` X. Squares of coordinates along lines cancel.
    pub fn growth(&self, matrix: &[f64]) -> Vec<f64> {
        let n = self.linear.len();
        let moved = |j: usize| {
            (0..n)
                .map(|i| self.linear[i] * matrix[i * n + j])
                .sum::<f64>()
        };
        let mut row: Vec<f64> = (0..n).map(|j| moved(j) - self.linear[j]).collect();
        for &k in &self.lines {
            let off = matrix[k * n + self.one] - self.centre[k];
            for &j in &self.lines {
                row[j] += off * matrix[k * n + j];
            }
            row[k] += self.centre[k];
            row[self.one] += 0.5 * (off * off - self.centre[k].powi(2));
        }
        row
    }

    /// Finds one: by a diagonal form of signs that the `steps` (by rows) keep and that is constant on the space, with a sign for
    /// each coordinate, or else with none for some that are along lines. Of the `points` of the model the first is the
    /// centre, the others are beside it.
    pub fn find(points: &[Vec<f64>], steps: &[Vec<f64>]) -> Option<Self> {
        let n = points.first()?.len();
        let signs = |choices: [f64; 3], count: usize, code: usize| -> Vec<f64> {
            let digit = |k: usize| choices[code / count.pow(k as u32) % count];
            (0..n).map(digit).collect()
        };
        let whole = (0..1_usize << n).map(|code| signs([1.0, -1.0, 0.0], 2, code));
        let parts = (0..3_usize.pow(n as u32)).map(|code| signs([1.0, -1.0, 0.0], 3, code));
        whole
            .chain(parts)
            .find_map(|q| form_of_signs(&q, points, steps))
    }
}

/// Returns the form of these signs, 0 along lines, if it is invariant and falls from the centre, the first of `points`.
fn form_of_signs(q: &[f64], points: &[Vec<f64>], steps: &[Vec<f64>]) -> Option<InvariantForm> {
    let n = q.len();
    let form = |a: &[f64], b: &[f64]| -> f64 { (0..n).map(|k| q[k] * a[k] * b[k]).sum() };
    let level = form(&points[0], &points[0]);
    // In charts of small units points are close together: it is constant if it changes by much less than it falls.
    let is_constant = |x: &Vec<f64>| {
        let change = (form(x, x) - level).abs();
        let fall = level - form(x, &points[0]);
        change <= 1e-9 * (1.0 + level.abs()) && change <= 1e-3 * fall
    };
    let falls = |x: &Vec<f64>| form(x, &points[0]) < level;
    if !points[1..].iter().all(|x| is_constant(x) && falls(x)) {
        return None;
    }
    let is_kept = |m: &Vec<f64>| {
        (0..n * n).all(|at| {
            let (i, j) = (at / n, at % n);
            let wanted = if i == j { q[i] } else { 0.0 };
            let got: f64 = (0..n).map(|k| q[k] * m[k * n + i] * m[k * n + j]).sum();
            (got - wanted).abs() <= SAME
        })
    };
    if !steps.iter().all(is_kept) {
        return None;
    }
    let (lines, one) = lines_of(q, points, steps)?;
    Some(InvariantForm {
        linear: (0..n).map(|k| -q[k] * points[0][k]).collect(),
        lines,
        one,
        centre: points[0].clone(),
    })
}

/// Finds the coordinates without a sign along which the steps are motions, and the one that is 1; `None` if there are others.
/// Where all have signs there are neither.
fn lines_of(q: &[f64], points: &[Vec<f64>], steps: &[Vec<f64>]) -> Option<(Vec<usize>, usize)> {
    let n = q.len();
    let mut lines: Vec<usize> = (0..n).filter(|k| q[*k] == 0.0).collect();
    if lines.is_empty() {
        return Some((lines, 0));
    }
    let is_one = |k: &usize| {
        let stays = |m: &Vec<f64>| {
            (0..n).all(|j| (m[k * n + j] - f64::from(u8::from(j == *k))).abs() <= SAME)
        };
        points.iter().all(|x| (x[*k] - 1.0).abs() <= 1e-12) && steps.iter().all(stays)
    };
    let one = lines.iter().copied().find(is_one)?;
    lines.retain(|k| *k != one);
    let is_motion = |m: &Vec<f64>| {
        let alone = |k: &usize| {
            let others = (0..n).filter(|j| *j != one && !lines.contains(j));
            others.fold(0.0, |most: f64, j| most.max(m[k * n + j].abs())) <= SAME
        };
        let turned = |i: &usize, j: &usize| {
            let wanted = f64::from(u8::from(i == j));
            let got: f64 = lines.iter().map(|k| m[k * n + i] * m[k * n + j]).sum();
            (got - wanted).abs() <= SAME
        };
        lines.iter().all(alone) && lines.iter().all(|i| lines.iter().all(|j| turned(i, j)))
    };
    (!lines.is_empty() && steps.iter().all(is_motion)).then_some((lines, one))
}
