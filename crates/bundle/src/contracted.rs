//! A patch at a fixed camera: polynomials in the direction and the arc length.
//!
//! In: coefficients over (direction…, arc length, channel), each direction parameter p, q in
//! [−1, 1]: of a face, or the azimuth and the polar angle of the whole sphere. Out: for one direction,
//! the coefficients in the arc length. With one direction parameter the second axis has length 1.

use crate::{
    chebyshev,
    matrix::{product, widened},
    polynomial::Variables,
    spherical,
    train_core::{MOST_DEGREES, MOST_TERMS},
};
use geofan_expr::{real::Real, vectorised};
use std::{
    f64::consts::PI,
    sync::{Arc, OnceLock},
};

/// A patch at one camera, in single precision: its rounding, 6e-8 of the largest coefficient, is far
/// below any promise that a table can make, and half the bytes take half the time.
#[derive(Debug, Clone)]
pub struct Contracted {
    /// Coefficients, axes (p, q, row): a row holds (arc length, channel), the last running fastest, or
    /// how much of each of `rows` it is, and zeros up to a whole number of [`BLOCK`]s.
    table: Vec<f32>,
    /// Rows that all others are sums of; none if the table has those others themselves.
    rows: Option<Arc<[f32]>>,
    degrees: [usize; 2],
    lengths: usize,
    channels: usize,
    /// The variables of the direction parameters; `None` in a local expansion, whose variables are its own.
    variables: Option<Variables>,
    /// Expansions for paths close together; `None` if the whole is cheap enough.
    local: Option<LocalExpansion>,
}

/// Numbers summed at once: one of the widest registers.
const BLOCK: usize = 16;

impl Contracted {
    /// Takes coefficients with axes `shape` = (direction…, arc length, channel), the last running fastest; with
    /// `rows`, the coefficients are weights: each vector over the last two axes is a sum of rows times them.
    pub fn new(
        shape: &[usize],
        coefficients: &[f32],
        rows: Option<Arc<[f32]>>,
        variables: Variables,
    ) -> Self {
        // Lengths of the axes, counted from the end.
        let axis = |from_end: usize| shape.len().checked_sub(from_end).map_or(1, |i| shape[i]);
        let (channels, lengths) = (axis(1), axis(2));
        // Rows padded to whole vectors.
        let row = (channels * lengths).max(1);
        let padded_row = row.next_multiple_of(BLOCK);
        let width = rows.as_ref().map_or(row, |rows| rows.len() / padded_row);
        let degrees = match shape.len() {
            4.. => [axis(4), axis(3)],
            _ => [axis(3), 1],
        };
        Self {
            table: padded(coefficients, width),
            rows,
            degrees,
            lengths,
            channels,
            variables: Some(variables),
            local: LocalExpansion::new(degrees, variables.sphere),
        }
    }

    /// Copies the patch with another table, of `degrees` coefficients in the direction parameters.
    pub(crate) fn with_table(&self, table: Vec<f32>, degrees: [usize; 2]) -> Self {
        Self {
            table,
            rows: self.rows.clone(),
            degrees,
            lengths: self.lengths,
            channels: self.channels,
            variables: None,
            local: None,
        }
    }

    /// Returns the number of coefficients along both direction parameters.
    pub(crate) fn degrees(&self) -> [usize; 2] {
        self.degrees
    }

    /// Returns the coefficients, axes (p, q, row).
    pub(crate) fn table(&self) -> &[f32] {
        &self.table
    }

    /// Returns the length of a row of the table.
    pub(crate) fn width(&self) -> usize {
        self.table.len() / (self.degrees[0] * self.degrees[1]).max(1)
    }

    /// Returns the length of a row over (arc length, channel).
    pub(crate) fn row(&self) -> usize {
        (self.lengths * self.channels).next_multiple_of(BLOCK)
    }

    /// Returns the norms of the rows that a row of the table tells the shares of; 1 for each of its numbers if
    /// it is those themselves.
    pub(crate) fn scales(&self) -> Vec<f32> {
        let length = |row: &[f32]| row.iter().map(|x| x * x).sum::<f32>().sqrt();
        match &self.rows {
            Some(rows) => rows.chunks_exact(self.row()).map(length).collect(),
            None => vec![1.0; self.width()],
        }
    }

    /// Returns the number of channels.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Writes the coefficients in the arc length at direction parameters (p, q), rows of channels, to the front
    /// of `row`, and returns them; numbers behind them there are undefined.
    pub fn direction<'r>(&self, p: f64, q: f64, row: &'r mut CoefficientRow) -> &'r [f64] {
        self.sum(self.variables_at([p, q]), row)
    }

    /// Returns the variables of the polynomials at direction parameters; on the sphere, those parameters.
    fn variables_at(&self, parameters: [f64; 2]) -> [f64; 2] {
        match self.variables {
            Some(variables) if !variables.sphere => {
                parameters.map(|x| variables.mapping.variable(x))
            }
            _ => parameters,
        }
    }

    /// Tells whether the directions are the whole sphere.
    pub(crate) fn is_sphere(&self) -> bool {
        self.variables.is_some_and(|variables| variables.sphere)
    }

    /// Evaluates [`Contracted::direction`] at variables of the polynomials.
    fn sum<'r>(&self, [p, q]: [f64; 2], row: &'r mut CoefficientRow) -> &'r [f64] {
        let [np, nq] = self.degrees;
        let mut tp = [0.0; MOST_TERMS];
        let mut tq = [[0.0; MOST_TERMS]; 2];
        if self.is_sphere() {
            spherical::azimuth_values(p, &mut tp[..np]);
            spherical::polar_values(q, false, &mut tq[0][..nq]);
            spherical::polar_values(q, true, &mut tq[1][..nq]);
        } else {
            chebyshev::values(p, &mut tp[..np]);
            chebyshev::values(q, &mut tq[0][..nq]);
        }
        let second = usize::from(self.is_sphere());
        let tq = [&tq[0][..nq], &tq[second][..nq]];
        let sum = weighed(&self.table, &tp[..np], tq, &mut row[..self.width()]);
        if let Some(rows) = &self.rows {
            // The shares of the rows are the weights of a polynomial in nothing else.
            let mut shares = EMPTY_ROW;
            let shares = &mut shares[..rows.len() / self.row()];
            shares.copy_from_slice(&sum[..shares.len()]);
            weighed(rows, &[1.0], [shares; 2], &mut row[..self.row()]);
        }
        &row[..self.lengths * self.channels]
    }

    /// Evaluates like [`Contracted::direction`] for one of many directions close together: by the local
    /// expansion around it, without the coefficients that do not count there.
    pub fn nearby<'r>(&self, p: f64, q: f64, row: &'r mut CoefficientRow) -> &'r [f64] {
        let variables = self.variables_at([p, q]);
        let local = self.local.as_ref();
        match local.and_then(|local| local.at(self, variables)) {
            Some((expansion, inner)) => expansion.sum(inner, row),
            None => self.sum(variables, row),
        }
    }
}

/// Pads rows of `row` numbers that all others are sums of, as [`Contracted::new`] takes them: they are the same
/// for all cameras.
pub(crate) fn rows(values: &[f32], row: usize) -> Arc<[f32]> {
    padded(values, row).into()
}

/// Pads rows of `row` numbers with zeros up to a whole number of [`BLOCK`]s.
fn padded(values: &[f32], row: usize) -> Vec<f32> {
    widened(values, row, row.next_multiple_of(BLOCK))
}

/// Room for the coefficients of one path in any patch: every degree and the start, four channels, whole
/// [`BLOCK`]s.
pub type CoefficientRow = [f64; (4 * (MOST_DEGREES + 1)).next_multiple_of(BLOCK)];

/// An empty one.
pub const EMPTY_ROW: CoefficientRow = [0.0; (4 * (MOST_DEGREES + 1)).next_multiple_of(BLOCK)];

/// Sums by [`weigh`] in vector instructions, and returns the sums.
fn weighed<'s>(table: &[f32], p: &[f64], q: [&[f64]; 2], sum: &'s mut [f64]) -> &'s [f64] {
    vectorised(
        #[inline(always)]
        || weigh(table, p, q, sum),
    );
    sum
}

/// Computes `sum = Σ p_i q_j line_ij` over the lines of `table`, each as long as `sum`; `q` for the terms of
/// even multiples of an azimuth, and of odd ones.
#[inline(always)]
fn weigh(table: &[f32], p: &[f64], q: [&[f64]; 2], sum: &mut [f64]) {
    let row = sum.len();
    let mut block = 0;
    while block < row {
        // Four sums at once hide the latency of one.
        let done = match row - block {
            left if left >= 4 * BLOCK => part::<{ 4 * BLOCK }>(table, p, q, (row, block), sum),
            left if left >= 2 * BLOCK => part::<{ 2 * BLOCK }>(table, p, q, (row, block), sum),
            _ => part::<BLOCK>(table, p, q, (row, block), sum),
        };
        block += done;
    }
}

/// Computes the `N` sums from `block` on, and returns `N`.
#[inline(always)]
fn part<const N: usize>(
    table: &[f32],
    p: &[f64],
    q: [&[f64]; 2],
    (row, block): (usize, usize),
    sum: &mut [f64],
) -> usize {
    let mut sums = [0.0_f32; N];
    // One line of the table for each pair of terms.
    let mut start = block;
    for (i, wp) in p.iter().enumerate() {
        for wq in q[usize::from(spherical::is_odd(i))] {
            let w = (wp * wq) as f32;
            if let Some(line) = table[start..].first_chunk::<N>() {
                for l in 0..N {
                    sums[l] += w * line[l];
                }
            }
            start += row;
        }
    }
    // The sums leave the registers.
    for (to, from) in sum[block..block + N].iter_mut().zip(sums) {
        *to = f64::from(from);
    }
    N
}

/// Nodes along each side of a cell. With 8, a third of the paths of a frame among three bumps found
/// that their cell would leave out too much, and took the whole patch; with 10 none does.
const NODES: usize = 10;

/// Patches with fewer coefficients in the direction are evaluated whole: expansions have some 40.
const FEWEST: usize = 128;

/// Coefficients of the whole patch for each cell along an axis: a polynomial of that degree swings once
/// in a cell, so that its coefficients there fall fast before the last of [`NODES`].
const PER_CELL: usize = 2;

/// Largest sum of the coefficients that are left out, as a share of the largest: a few dozen roundings of
/// single precision, far below any promise that a table can make. Expansions that would leave out more are
/// not used.
const LEFT_OUT: f32 = 4e-6;

/// Expansions of a patch about the cells of a grid of directions, each made when it is first asked for: the
/// same polynomials in the cell's own parameters, without the coefficients that do not count there. A patch
/// with many coefficients in both direction parameters is dear to evaluate for one path. The cells' edges are
/// `−cos(πi/n)`, so that a Chebyshev polynomial swings as often in each; on the whole sphere they are evenly
/// spaced.
#[derive(Debug, Clone)]
pub(crate) struct LocalExpansion {
    edges: [Vec<f64>; 2],
    /// The patch on the cells of each interval of the second parameter, whole in the first. A picture
    /// sees most azimuths if a pole is in it, but rarely all polar angles.
    bands: Box<[OnceLock<Vec<f32>>]>,
    /// `None` where a cell would leave out too much.
    cells: Box<[OnceLock<Option<Box<Contracted>>>]>,
}

impl LocalExpansion {
    /// Sets up the grid for `degrees` coefficients in both parameters; `None` if they would hardly be fewer in
    /// a cell.
    pub(crate) fn new(degrees: [usize; 2], sphere: bool) -> Option<Self> {
        if degrees[0] * degrees[1] < FEWEST {
            return None;
        }
        let edges = degrees.map(|n| edges(n.div_ceil(PER_CELL), sphere));
        let count = edges.each_ref().map(|edges| edges.len() - 1);
        Some(Self {
            edges,
            bands: (0..count[1]).map(|_| OnceLock::new()).collect(),
            cells: (0..count[0] * count[1]).map(|_| OnceLock::new()).collect(),
        })
    }

    /// Finds the expansion of `patch` around (p, q), and the parameters in its cell.
    pub(crate) fn at(
        &self,
        patch: &Contracted,
        place: [f64; 2],
    ) -> Option<(&Contracted, [f64; 2])> {
        let [i, j] = [0, 1].map(|k| number(&self.edges[k], place[k]));
        let sides = [(0, i), (1, j)].map(|(k, i)| [self.edges[k][i], self.edges[k][i + 1]]);
        let cell = &self.cells[i * (self.edges[1].len() - 1) + j];
        let band = || self.bands[j].get_or_init(|| band(patch, sides[1]));
        let cell = cell.get_or_init(|| restricted(patch, band(), sides[0]).map(Box::new));
        let inner = [0, 1].map(|k| {
            let [low, high] = sides[k];
            2.0 * (place[k] - low) / (high - low) - 1.0
        });
        Some((cell.as_deref()?, inner))
    }
}

fn edges(cells: usize, even: bool) -> Vec<f64> {
    let edge = |i: usize| match even {
        true => 2.0 * i as f64 / cells as f64 - 1.0,
        false => -Real::cos(PI * i as f64 / cells as f64),
    };
    (0..=cells).map(edge).collect()
}

/// Finds the interval between `edges` that holds `x`.
fn number(edges: &[f64], x: f64) -> usize {
    edges[1..edges.len() - 1].partition_point(|edge| *edge <= x)
}

/// Computes the coefficients of `patch` on an interval of its second parameter, axes (p, q, row).
fn band(patch: &Contracted, side: [f64; 2]) -> Vec<f32> {
    let nq = patch.degrees()[1];
    // The matrix of the second parameter; on the sphere for even and odd multiples of the azimuth.
    let matrices = match patch.is_sphere() {
        false => vec![restriction(nq, side, chebyshev::values)],
        true => [false, true]
            .map(|odd| {
                restriction(nq, side, |b, values| {
                    spherical::polar_values(b, odd, values)
                })
            })
            .into(),
    };
    // Applied for each coefficient of the first.
    let planes = patch.table().chunks_exact(nq * patch.width());
    let restricted = planes.enumerate().flat_map(|(i, plane)| {
        let odd = patch.is_sphere() && spherical::is_odd(i);
        product(&matrices[usize::from(odd)], nq, plane)
    });
    restricted.collect()
}

/// Expands `patch` on a box of its parameters, from its `band` there; `None` if that leaves out too much.
fn restricted(patch: &Contracted, band: &[f32], side: [f64; 2]) -> Option<Contracted> {
    let np = patch.degrees()[0];
    let matrix = match patch.is_sphere() {
        false => restriction(np, side, chebyshev::values),
        true => restriction(np, side, spherical::azimuth_values),
    };
    // All coefficients on the box, and their sizes, each row by its norm.
    let table = product(&matrix, np, band);
    let (row, scales) = (patch.width(), patch.scales());
    let sizes: Vec<f32> = table
        .chunks_exact(row)
        .map(|line| {
            let numbers = line.iter().zip(&scales);
            numbers
                .map(|(c, scale)| (c * scale).powi(2))
                .sum::<f32>()
                .sqrt()
        })
        .collect();
    // The first coefficients along both axes that leave out no more than is allowed.
    let allowed = LEFT_OUT * sizes.iter().fold(0.0, |most: f32, size| size.max(most));
    let degrees = [
        significant(|i| (0..NODES).map(|j| sizes[i * NODES + j]).sum(), allowed)?,
        significant(|j| (0..NODES).map(|i| sizes[i * NODES + j]).sum(), allowed)?,
    ];
    // The table of these alone.
    let lines = |i: usize| &table[i * NODES * row..][..degrees[1] * row];
    let table = (0..degrees[0])
        .flat_map(|i| lines(i).iter().copied())
        .collect();
    Some(patch.with_table(table, degrees))
}

/// Returns the matrix that takes the coefficients of `n` terms to [`NODES`] of the polynomial through their sum
/// at as many nodes of a part of [−1, 1]; `terms` writes the values of the terms.
fn restriction(n: usize, [low, high]: [f64; 2], terms: impl Fn(f64, &mut [f64])) -> Vec<f32> {
    let transform = chebyshev::transform(NODES);
    let mut values = vec![0.0; NODES * n];
    for (x, values) in chebyshev::nodes(NODES)
        .iter()
        .zip(values.chunks_exact_mut(n))
    {
        terms(low + 0.5 * (x + 1.0) * (high - low), values);
    }
    product(&transform.into_raw_vec_and_offset().0, NODES, &values)
        .into_iter()
        .map(|x: f64| x as f32)
        .collect()
}

/// Counts the coefficients along an axis that must stay so that the rest, of sums `size`, is `allowed`;
/// `None` if all must: then more are missing.
fn significant(size: impl Fn(usize) -> f32, allowed: f32) -> Option<usize> {
    let mut left = 0.0;
    let mut count = NODES;
    while count > 1 {
        left += size(count - 1);
        if !(left <= allowed) {
            break;
        }
        count -= 1;
    }
    (count < NODES).then_some(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        chebyshev::MappedChebyshev, polynomial::Polynomial, tensor::Tensor, train::Train,
        train_core::StepSize,
    };
    use ndarray::{ArrayD, IxDyn};

    const FACE: Variables = Variables::of_face(0, MappedChebyshev::NONE);

    #[test]
    fn expansions_leave_out_coefficients_that_do_not_count() {
        let shape = [24, 18, 6, 3];
        let count = shape.iter().product();
        // Coefficients fall as those of a table do.
        let coefficient = |i: usize| {
            let (p, q) = (i / (18 * 18), i / 18 % 18);
            (i as f32 * 0.7).sin() * (-0.5 * (p + q) as f32).exp()
        };
        let table: Vec<f32> = (0..count).map(coefficient).collect();
        let patch = Contracted::new(&shape, &table, None, FACE);
        let (mut used, mut worst) = (0, 0.0_f64);
        for i in 0..400 {
            let [p, q] = [0.618, 0.755].map(|step| (f64::from(i) * step).fract() * 2.0 - 1.0);
            let (mut whole, mut near) = (EMPTY_ROW, EMPTY_ROW);
            let whole = patch.direction(p, q, &mut whole);
            let near = patch.nearby(p, q, &mut near);
            let local = patch.local.as_ref();
            let cell = local.and_then(|l| l.at(&patch, [p, q]));
            used += usize::from(cell.is_some_and(|(cell, _)| cell.table.len() < table.len() / 4));
            let errors = whole.iter().zip(near).map(|(a, b)| (a - b).abs());
            worst = errors.fold(worst, f64::max);
        }
        assert!(used > 300, "{used}");
        // Twice what may be left out along each axis, of coefficients up to about 1.
        assert!(worst < 2e-5, "{worst}");
    }

    /// A tensor over one camera parameter and the whole sphere, of coefficients that fall as those of a
    /// table do.
    fn sphere() -> Tensor {
        let shape = [3, 33, 17, 8, 2];
        let coefficient = |i: IxDyn| {
            let sum = (0..4).map(|a| i[a] as f64).sum::<f64>();
            let wave = (0..5).map(|a| (a + 2) as f64 * i[a] as f64).sum::<f64>();
            wave.sin() * (-0.25 * sum).exp()
        };
        let polynomial = Polynomial {
            coefficients: ArrayD::from_shape_fn(IxDyn(&shape), coefficient),
            variables: Variables {
                cameras: 1,
                mapping: MappedChebyshev::new(0.5),
                sphere: true,
            },
        };
        Train::plain(&polynomial)
            .rounded(StepSize::near(1e-7))
            .unwrap()
    }

    #[test]
    fn the_whole_sphere_and_its_expansions_agree_with_the_tensor() {
        let tensor = sphere();
        let patch = tensor.contract(&[0.3]);
        let (mut used, mut worst) = (0, [0.0_f64; 2]);
        for i in 0..400 {
            // Poles and the seam of the azimuth among them.
            let step = |step: f64| (f64::from(i) * step).fract() * 2.0 - 1.0;
            let [a, b] = match i {
                0..4 => [[-1.0, 1.0][i as usize % 2], [-1.0, 1.0][i as usize / 2]],
                _ => [step(0.618), step(0.755)],
            };
            let (mut whole, mut near) = (EMPTY_ROW, EMPTY_ROW);
            let whole = patch.direction(a, b, &mut whole);
            let near = patch.nearby(a, b, &mut near);
            let local = patch.local.as_ref();
            let cell = local.and_then(|l| l.at(&patch, [a, b]));
            used += usize::from(cell.is_some());
            for (k, exact) in tensor.at(&[0.3, a, b]).iter().enumerate() {
                worst[0] = worst[0].max((whole[k] - exact).abs());
                worst[1] = worst[1].max((near[k] - exact).abs());
            }
        }
        assert!(used > 300, "{used}");
        // Sums of thousands of coefficients in single precision, and what cells leave out.
        assert!(worst[0] < 1e-5 && worst[1] < 1e-4, "{worst:?}");
    }

    #[test]
    fn rows_of_any_length_are_summed_like_one_by_one() {
        for (np, nq, lengths, channels) in [(3, 4, 17, 3), (5, 1, 2, 2), (1, 1, 32, 1)] {
            let count = np * nq * lengths * channels;
            let table: Vec<f32> = (0..count).map(|i| (i as f32 * 0.7).sin()).collect();
            let contracted = Contracted::new(&[np, nq, lengths, channels], &table, None, FACE);
            let (p, q) = (0.3, -0.8);
            let mut found = EMPTY_ROW;
            let found = contracted.direction(p, q, &mut found);
            let row = lengths * channels;
            for at in 0..row {
                let mut expected = 0.0;
                for i in 0..np {
                    for j in 0..nq {
                        let (a, b) = ((i as f64) * p.acos(), (j as f64) * q.acos());
                        expected += a.cos() * b.cos() * f64::from(table[(i * nq + j) * row + at]);
                    }
                }
                assert!((found[at] - expected).abs() < 1e-5);
            }
        }
    }
}
