//! In which order the axes of a box are strung on its tensor train.
//!
//! In: the coefficients of a box. Out: the [`Layout`] whose cores are smallest. How many numbers a core
//! holds depends on the ranks of the bonds beside it, and the rank of a bond on nothing but which axes
//! are on either side. Those ranks are estimated from small random parts of the matrices in question:
//! values at random nodes of the axes on one side against random nodes of those on the other. The best
//! order is then a shortest way from no axis to all.

use faer::Mat;
use geofan_bundle::{Layout, Polynomial};
use geofan_core::random::Stream;
use std::collections::HashSet;

/// Rows and columns of the part of a matrix that is looked at. Half as many cannot tell large ranks
/// apart.
const PART: usize = 160;

/// Fewest ray axes between which there is a choice worth a look: with two, either order has the same
/// bond in the middle.
const FEWEST: usize = 3;

/// Singular values below this share of the largest do not count. Promises of 0.05 to 1 mrad leave out
/// those below 1e-5 to 1e-3; the orders found are the same.
const FLOOR: f64 = 1e-4;

/// The order of the ray axes of a polynomial (axes camera…, direction…, arc length, channel).
pub fn best(polynomial: &Polynomial) -> Layout {
    let rays = polynomial.coefficients.ndim() - 2;
    if rays < FEWEST {
        let cameras = polynomial.variables.cameras;
        return Layout::paired(cameras, rays - cameras);
    }
    let values = Values::new(polynomial, rays);
    let all = (1_usize << rays) - 1;
    let ranks: Vec<f64> = (0..=all).map(|set| values.rank(set)).collect();
    // For each set of axes the smallest cores over them, and the last of them.
    let mut best = vec![(0.0, 0); all + 1];
    for set in 1..=all {
        let ending = |axis: usize| {
            let before = set & !(1 << axis);
            let core = ranks[before] * values.sizes[axis] as f64 * ranks[set];
            (best[before].0 + core, axis)
        };
        let axes = (0..rays).filter(|axis| set >> axis & 1 == 1);
        let smallest = axes.map(ending).min_by(|a, b| a.0.total_cmp(&b.0));
        best[set] = smallest.expect("a set with axes");
    }
    let (mut order, mut set) = (Vec::new(), all);
    while set != 0 {
        let last = best[set].1;
        order.push(last);
        set &= !(1 << last);
    }
    order.reverse();
    Layout::Train(order)
}

/// Values at the nodes of the ray axes, still coefficients along the arc length.
struct Values {
    /// Lengths of the ray axes.
    sizes: Vec<usize>,
    /// How many numbers there are for each ray.
    row: usize,
    values: Vec<f64>,
}

impl Values {
    fn new(polynomial: &Polynomial, rays: usize) -> Self {
        let shape = polynomial.coefficients.shape();
        let sizes = shape[..rays].to_vec();
        let row = shape[rays..].iter().product();
        let samples = polynomial.samples();
        Self {
            sizes,
            row,
            values: samples.into_raw_vec_and_offset().0,
        }
    }

    /// About the rank of the matrix whose rows are the nodes of the axes in `set`, times the bits that its
    /// singular values have.
    fn rank(&self, set: usize) -> f64 {
        let all = (1 << self.sizes.len()) - 1;
        if set == 0 {
            return 1.0;
        }
        let mut stream = Stream::new(&[set as u64]);
        let rows = distinct(|| self.place(set, &mut stream));
        let mut stream = Stream::new(&[set as u64, 1]);
        let columns = distinct(|| {
            // Every ray has few numbers that are not like their neighbours: one of them each.
            let place = self.place(all & !set, &mut stream);
            place + ((stream.uniform() * self.row as f64) as usize).min(self.row - 1)
        });
        let part = Mat::from_fn(rows.len(), columns.len(), |i, j| {
            self.values[rows[i] + columns[j]]
        });
        bits(&part)
    }

    /// Where a random node of the axes in `set` is found; those of the others count from there.
    fn place(&self, set: usize, stream: &mut Stream) -> usize {
        let (mut sum, mut stride) = (0, self.row);
        for (axis, n) in self.sizes.iter().enumerate().rev() {
            if set >> axis & 1 == 1 {
                sum += stride * ((stream.uniform() * *n as f64) as usize).min(n - 1);
            }
            stride *= n;
        }
        sum
    }
}

/// About the rank of a matrix, times the bits that its singular values have.
pub fn bits(part: &Mat<f64>) -> f64 {
    let Ok(sizes) = part.singular_values() else {
        return f64::INFINITY;
    };
    let largest = sizes.iter().copied().fold(0.0, f64::max);
    let floor = FLOOR * largest;
    sizes.iter().map(|x| (1.0 + x / floor).log2()).sum()
}

/// [`PART`] random places, each once: as many as are found.
fn distinct(mut place: impl FnMut() -> usize) -> Vec<usize> {
    let mut places: Vec<usize> = (0..2 * PART).map(|_| place()).collect();
    let mut seen = HashSet::new();
    places.retain(|place| seen.insert(*place));
    places.truncate(PART);
    places
}
