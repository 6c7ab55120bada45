//! Numbers of cells that suit a space.
//!
//! In: a coarse sampled grid. Out: how many cells each axis should have beside the others. Straight
//! interpolation errs by an eighth of the second difference, so a given number of nodes serves best
//! where the second differences along all axes are equal. A grid with as many cells along every axis
//! would be a weaker rival than a table deserves.

use crate::sweep::grid::samples::Samples;

/// The most by which the cells of an axis may differ from the even number, either way: beyond, the
/// coarse grid that they are read from says too little.
const MOST: f64 = 3.0;

/// The share of second differences below the one that is taken as typical of an axis.
const TYPICAL: f64 = 0.9;

/// The relative numbers of cells along (camera…, direction…, arc length); their product is 1.
pub fn balanced(samples: &Samples) -> Vec<f64> {
    let axes = &samples.axes;
    let mut shape = axes.ray_shape();
    shape.extend([axes.lengths.len(), samples.channels.len()]);
    let face = axes.cameras.len();
    let own = (0..shape.len() - 1).filter(|axis| *axis != face);
    let bends: Vec<f64> = own
        .map(|axis| {
            let cells = (shape[axis] - 1) as f64;
            cells * second_difference(samples, &shape, axis).sqrt()
        })
        .collect();
    let logarithms: Vec<f64> = bends.iter().map(|b| b.max(1e-12).ln()).collect();
    let mean = logarithms.iter().sum::<f64>() / logarithms.len().max(1) as f64;
    let within = logarithms
        .iter()
        .map(|l| (l - mean).clamp(-MOST.ln(), MOST.ln()));
    let within: Vec<f64> = within.collect();
    let mean = within.iter().sum::<f64>() / within.len().max(1) as f64;
    within.iter().map(|l| (l - mean).exp()).collect()
}

/// The typical size of second differences along `axis`.
fn second_difference(samples: &Samples, shape: &[usize], axis: usize) -> f64 {
    let stride: usize = shape[axis + 1..].iter().product();
    let n = shape[axis];
    let inner = |i: &usize| (1..n - 1).contains(&(i / stride % n));
    let values = &samples.values;
    let mut found: Vec<f32> = (0..values.len())
        .filter(inner)
        .map(|i| (values[i - stride] - 2.0 * values[i] + values[i + stride]).abs())
        .collect();
    let rank = (found.len() as f64 * TYPICAL) as usize;
    if rank >= found.len() {
        return 0.0;
    }
    f64::from(*found.select_nth_unstable_by(rank, f32::total_cmp).1)
}

/// `even` cells along every axis, shared out by the relative numbers of [`balanced`]; at least
/// `fewest`.
pub fn cells(even: f64, relative: &[f64], fewest: usize) -> Vec<usize> {
    let along = |r: &f64| ((even * r).round() as usize).max(fewest);
    relative.iter().map(along).collect()
}

/// The geometric mean of numbers of cells: the reciprocal of the mean spacing.
pub fn mean(cells: &[usize]) -> f64 {
    let logarithms: f64 = cells.iter().map(|n| (*n as f64).ln()).sum();
    (logarithms / cells.len().max(1) as f64).exp()
}
