//! All derivatives of a spline that an expression needs, at many points.
//!
//! In: a [`Spline`] and the orders wanted, then points. Out: one number for each. A point needs (d + 1)³
//! coefficients whatever is asked for, so that derivatives together cost little more than the value: rows along
//! the last axis are summed over the second axis and then over the first, a vector of weights at a time.

use super::{Cells, Spline, raised};
use crate::{real::Real, tape::vectorised};
use std::sync::Arc;

/// The highest order of derivatives that are computed together.
const MOST_TOGETHER: usize = 3;

/// The number of derivatives up to that order.
const TOGETHER: usize = 20;

/// Evaluates derivatives of one spline.
#[derive(Debug, Clone)]
pub struct Lookup {
    spline: Arc<Spline>,
    orders: Vec<[u8; 3]>,
    /// The highest sum of orders.
    highest: usize,
}

impl Lookup {
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

// Not inlined, as the interpreter of tapes is not: one copy for each kind of number, degree and order.
#[inline(never)]
fn together<R: Real>(
    spline: &Spline,
    highest: usize,
    points: &[[R; 3]],
    found: &mut [[R; TOGETHER]],
) {
    match spline.degree {
        1 => by_degree::<R, 1, 2>(spline, highest, points, found),
        3 => by_degree::<R, 3, 4>(spline, highest, points, found),
        _ => by_degree::<R, 5, 8>(spline, highest, points, found),
    }
}

fn by_degree<R: Real, const D: usize, const T: usize>(
    spline: &Spline,
    highest: usize,
    points: &[[R; 3]],
    found: &mut [[R; TOGETHER]],
) {
    match highest {
        0 => by_order::<R, D, T, 0>(spline, points, found),
        1 => by_order::<R, D, T, 1>(spline, points, found),
        2 => by_order::<R, D, T, 2>(spline, points, found),
        _ => by_order::<R, D, T, 3>(spline, points, found),
    }
}

#[inline(never)]
fn by_order<R: Real, const D: usize, const T: usize, const M: usize>(
    spline: &Spline,
    points: &[[R; 3]],
    found: &mut [[R; TOGETHER]],
) {
    let coefficients = spline.coefficients::<R>();
    vectorised(
        #[inline(always)]
        || {
            for (point, found) in points.iter().zip(found) {
                *found = derivatives::<R, D, T, M>(&spline.cells, coefficients, *point);
            }
        },
    );
}

/// All derivatives up to order `M` of a spline of degree `D`, whose weights fill `T` lanes.
#[inline(always)]
fn derivatives<R: Real, const D: usize, const T: usize, const M: usize>(
    cells: &[Cells; 3],
    coefficients: &[R],
    point: [R; 3],
) -> [R; TOGETHER] {
    const ORDERS: usize = MOST_TOGETHER + 1;
    let mut places = [0; 3];
    let mut weights = [[[R::ZERO; T]; ORDERS]; 3];
    for k in 0..3 {
        let (cell, t) = cells[k].locate(point[k]);
        places[k] = cell;
        weights[k] = weights_of::<R, D, T, M, ORDERS>(t, R::from_f64(cells[k].scale));
    }
    let [_, rows, columns] = [0, 1, 2].map(|k| cells[k].coefficients);
    let [wx, wy, wz] = &weights;
    // Sums over the first two axes, by their orders.
    let mut planes = [[[R::ZERO; T]; ORDERS]; ORDERS];
    for x in 0..=D {
        let mut lines = [[R::ZERO; T]; ORDERS];
        for y in 0..=D {
            let start = ((places[0] + x) * rows + places[1] + y) * columns + places[2];
            let Some(taps) = coefficients[start..].first_chunk::<T>() else {
                continue;
            };
            for j in 0..=M {
                for z in 0..T {
                    lines[j][z] = lines[j][z] + wy[j][y] * taps[z];
                }
            }
        }
        for i in 0..=M {
            for j in 0..=M - i {
                for z in 0..T {
                    planes[i][j][z] = planes[i][j][z] + wx[i][x] * lines[j][z];
                }
            }
        }
    }
    let mut found = [R::ZERO; TOGETHER];
    for i in 0..=M {
        for j in 0..=M - i {
            for k in 0..=M - i - j {
                let mut sum = R::ZERO;
                for z in 0..=D {
                    sum = sum + planes[i][j][z] * wz[k][z];
                }
                found[place([i as u8, j as u8, k as u8], i + j + k)] = sum;
            }
        }
    }
    found
}

/// The weights of the value and of the derivatives up to order `M` at `t` of a cell, `scale` cells a unit.
#[inline(always)]
fn weights_of<R: Real, const D: usize, const T: usize, const M: usize, const ORDERS: usize>(
    t: R,
    scale: R,
) -> [[R; T]; ORDERS] {
    let mut weights = [[R::ZERO; T]; ORDERS];
    let mut level = [R::ZERO; T];
    level[0] = R::ONE;
    // Those of degree D − n become those of the n-th derivative.
    for degree in 0..=D {
        if degree > 0 {
            let old = level;
            level[0] = raised(degree, 0, t, R::ZERO, old[0]);
            for m in 1..=degree {
                level[m] = raised(degree, m, t, old[m - 1], old[m]);
            }
        }
        let order = D - degree;
        if order <= M {
            weights[order] = level;
        }
    }
    let mut factor = R::ONE;
    for order in 1..=M {
        factor = factor * scale;
        if order > D {
            continue;
        }
        for _ in 0..order {
            for m in (1..=D).rev() {
                weights[order][m] = weights[order][m - 1] - weights[order][m];
            }
            weights[order][0] = R::ZERO - weights[order][0];
        }
        for m in 0..=D {
            weights[order][m] = weights[order][m] * factor;
        }
    }
    weights
}
