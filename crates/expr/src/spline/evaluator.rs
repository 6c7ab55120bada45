//! All derivatives of a spline that an expression needs, at many points.
//!
//! In: a [`Spline`] and the orders wanted, then points. Out: one number for each. A point needs (d + 1)³
//! coefficients whatever is asked for, so that derivatives together cost little more than the value: rows along
//! the last axis are summed over the second axis and then over the first, a vector of coefficients at a time.

use super::{Cells, MOST_TAPS, Spline};
use crate::real::Real;
use fearless_simd::{Level, Simd, SimdBase, dispatch};
use std::sync::Arc;

/// The highest order of derivatives that are computed together.
const MOST_TOGETHER: usize = 3;

/// The number of derivatives up to that order.
const TOGETHER: usize = 20;

/// Evaluates derivatives of one spline.
#[derive(Debug, Clone)]
pub struct SplineEvaluator {
    spline: Arc<Spline>,
    orders: Vec<[u8; 3]>,
    /// The highest sum of orders.
    highest: usize,
}

impl SplineEvaluator {
    /// Sets up the derivatives of these orders along the three axes.
    pub fn new(spline: Arc<Spline>, orders: Vec<[u8; 3]>) -> Self {
        let highest = orders.iter().map(|o| total(*o)).max().unwrap_or(0);
        Self {
            spline,
            orders,
            highest,
        }
    }

    /// Returns the spline.
    pub fn spline(&self) -> &Arc<Spline> {
        &self.spline
    }

    /// Returns the orders of what it computes.
    pub fn orders(&self) -> &[[u8; 3]] {
        &self.orders
    }

    /// Counts the multiplications and additions at one point.
    pub fn arithmetic(&self) -> usize {
        let (taps, orders) = (self.spline.degree + 1, self.highest + 1);
        let pairs = orders * (orders + 1) / 2;
        let triples = orders * (orders + 1) * (orders + 2) / 6;
        2 * taps * (taps * taps * orders + taps * pairs + triples)
    }

    /// Computes the derivatives at points of the arguments `at`: `results[lane][k]` is that of the k-th orders.
    pub fn evaluate<R: Real, const W: usize>(
        &self,
        at: [&[R; W]; 3],
        mut take: impl FnMut(usize, [R; W]),
    ) {
        let point = |lane: usize| at.map(|x| x[lane]);
        if self.highest > MOST_TOGETHER {
            for (k, orders) in self.orders.iter().enumerate() {
                let value = |lane| self.spline.derivative(*orders, point(lane));
                take(k, std::array::from_fn(value));
            }
            return;
        }
        let mut points = [[R::ZERO; 3]; W];
        for lane in 0..W {
            points[lane] = point(lane);
        }
        let mut found = [[R::ZERO; TOGETHER]; W];
        together(&self.spline, self.highest, &points, &mut found);
        for (k, orders) in self.orders.iter().enumerate() {
            let place = place(*orders, total(*orders));
            let mut lanes = [R::ZERO; W];
            for lane in 0..W {
                lanes[lane] = found[lane][place];
            }
            take(k, lanes);
        }
    }
}

/// The order of a derivative.
fn total(orders: [u8; 3]) -> usize {
    orders.iter().map(|n| usize::from(*n)).sum()
}

/// The place of a derivative among all: by its order, then by the orders along the second and third axes.
const fn place([_, y, z]: [u8; 3], order: usize) -> usize {
    let lower = order * (order + 1) * (order + 2) / 6;
    let across = y as usize + z as usize;
    lower + across * (across + 1) / 2 + z as usize
}

/// Computes all derivatives up to the order `highest` at points.
fn together<R: Real>(
    spline: &Spline,
    highest: usize,
    points: &[[R; 3]],
    found: &mut [[R; TOGETHER]],
) {
    match spline.degree {
        1 => by_degree::<R, 1>(spline, highest, points, found),
        3 => by_degree::<R, 3>(spline, highest, points, found),
        _ => by_degree::<R, 5>(spline, highest, points, found),
    }
}

fn by_degree<R: Real, const D: usize>(
    spline: &Spline,
    highest: usize,
    points: &[[R; 3]],
    found: &mut [[R; TOGETHER]],
) {
    match highest {
        0 => by_order::<R, D, 0>(spline, points, found),
        1 => by_order::<R, D, 1>(spline, points, found),
        2 => by_order::<R, D, 2>(spline, points, found),
        _ => by_order::<R, D, 3>(spline, points, found),
    }
}

// Not inlined, as the interpreter of tapes is not: one copy for each kind of number, degree and order.
#[inline(never)]
fn by_order<R: Real, const D: usize, const M: usize>(
    spline: &Spline,
    points: &[[R; 3]],
    found: &mut [[R; TOGETHER]],
) {
    let coefficients = spline.coefficients::<R>();
    dispatch!(Level::new(), simd => simd.vectorize(
        #[inline(always)]
        || {
            for (point, found) in points.iter().zip(found) {
                derivatives::<_, R, D, M>(simd, &spline.cells, coefficients, *point, found);
            }
        },
    ));
}

/// One more than the highest order.
const ORDERS: usize = MOST_TOGETHER + 1;

/// Lanes of the widest vector of numbers.
const LANES: usize = 16;

/// The weights of degree `D` as polynomials on a cell.
struct Basis<const D: usize>;

impl<const D: usize> Basis<D> {
    /// `[n][k][m]`: the factor of `t^k` in the n-th derivative of the m-th weight.
    const ROWS: [[[f64; LANES]; MOST_TAPS]; ORDERS] = basis(D);
}

/// Computes [`Basis::ROWS`] by the recursion for weights.
const fn basis(degree: usize) -> [[[f64; LANES]; MOST_TAPS]; ORDERS] {
    let mut rows = [[[0.0; LANES]; MOST_TAPS]; ORDERS];
    rows[0][0][0] = 1.0;
    let mut d = 1;
    while d <= degree {
        let old = rows[0];
        let mut k = 0;
        while k <= d {
            let mut m = 0;
            while m <= d {
                let (mut sum, by) = (0.0, d as f64);
                if m > 0 {
                    sum += (d - m) as f64 * old[k][m - 1];
                    if k > 0 {
                        sum += old[k - 1][m - 1];
                    }
                }
                sum += (1 + m) as f64 * old[k][m];
                if k > 0 {
                    sum -= old[k - 1][m];
                }
                rows[0][k][m] = sum / by;
                m += 1;
            }
            k += 1;
        }
        d += 1;
    }
    let mut order = 1;
    while order < ORDERS {
        let mut k = 0;
        while k + 1 < MOST_TAPS {
            let mut m = 0;
            while m < LANES {
                rows[order][k][m] = rows[order - 1][k + 1][m] * (k + 1) as f64;
                m += 1;
            }
            k += 1;
        }
        order += 1;
    }
    rows
}

/// All derivatives up to order `M` of a spline of degree `D`.
#[inline(always)]
fn derivatives<S: Simd, R: Real, const D: usize, const M: usize>(
    simd: S,
    cells: &[Cells; 3],
    coefficients: &[R],
    point: [R; 3],
    found: &mut [R; TOGETHER],
) {
    let zero = R::Vector::splat(simd, R::ZERO);
    let mut places = [0; 3];
    let mut weights = [[zero; ORDERS]; 3];
    for k in 0..3 {
        let (cell, t) = cells[k].locate(point[k]);
        places[k] = cell;
        weights[k] = weights_of::<S, R, D, M>(simd, t, R::from_f64(cells[k].scale));
    }
    let [wx, wy, wz] = &weights;
    let (rows, columns) = (cells[1].coefficients, cells[2].coefficients);
    let lanes = R::Vector::<S>::LEN;
    // Sums over the first two axes, by their orders. What lies beside the row in a vector is not used.
    let mut planes = [[zero; ORDERS]; ORDERS];
    for x in 0..=D {
        let mut lines = [zero; ORDERS];
        for y in 0..=D {
            let start = ((places[0] + x) * rows + places[1] + y) * columns + places[2];
            let taps = R::Vector::from_slice(simd, &coefficients[start..start + lanes]);
            for j in 0..=M {
                lines[j] = taps * R::Vector::splat(simd, wy[j].as_slice()[y]) + lines[j];
            }
        }
        for i in 0..=M {
            let weight = R::Vector::splat(simd, wx[i].as_slice()[x]);
            for j in 0..=M - i {
                planes[i][j] = lines[j] * weight + planes[i][j];
            }
        }
    }
    for i in 0..=M {
        for j in 0..=M - i {
            for k in 0..=M - i - j {
                // The weights beyond the last are zero.
                let products = planes[i][j] * wz[k];
                let mut sum = R::ZERO;
                for z in 0..=D {
                    sum += products.as_slice()[z];
                }
                found[place([i as u8, j as u8, k as u8], i + j + k)] = sum;
            }
        }
    }
}

/// The weights of the value and of the derivatives up to order `M` at `t` of a cell, `scale` cells a unit.
#[inline(always)]
fn weights_of<S: Simd, R: Real, const D: usize, const M: usize>(
    simd: S,
    t: R,
    scale: R,
) -> [R::Vector<S>; ORDERS] {
    let mut weights = [R::Vector::splat(simd, R::ZERO); ORDERS];
    let at = R::Vector::splat(simd, t);
    let mut factor = R::ONE;
    for order in 0..=M.min(D) {
        let mut sum = R::Vector::splat(simd, R::ZERO);
        for k in (0..=D - order).rev() {
            let row = Basis::<D>::ROWS[order][k].map(
                #[inline(always)]
                |x| R::from_f64(x),
            );
            let row = R::Vector::from_slice(simd, &row[..R::Vector::<S>::LEN]);
            sum = sum * at + row;
        }
        weights[order] = sum * R::Vector::splat(simd, factor);
        factor *= scale;
    }
    weights
}
