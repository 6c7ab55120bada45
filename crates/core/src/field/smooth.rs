//! Smoothing of measured samples.
//!
//! Each axis is convolved with a Gaussian. Beyond an end that is not periodic, samples are continued by their
//! point reflection at the end, which keeps linear functions as they are.

use super::{SampleFault, Samples};
use geofan_expr::spline::SampledAxis;

/// Standard deviations after which the Gaussian is cut: what is left out is 2e-9 of it.
const REACH: f64 = 6.0;

/// The samples smoothed by a Gaussian of standard deviation `sigma`, in steps of the grid.
pub fn smoothed(
    samples: &Samples,
    axes: &[SampledAxis; 3],
    sigma: f64,
) -> Result<Vec<f64>, SampleFault> {
    let mut values = samples.values.clone();
    if sigma == 0.0 {
        return Ok(values);
    }
    // An axis with one sample has nothing to smooth.
    let Some((k, count)) = (0..3)
        .map(|k| (k, samples.shape[k]))
        .filter(|(_, count)| *count > 1)
        .min_by_key(|(_, count)| *count)
    else {
        return Ok(values);
    };
    let reach = (REACH * sigma).ceil();
    if reach >= count as f64 {
        let message = format!(
            "a deviation of {sigma} steps reaches over {reach} samples, and there are {count} along {}",
            ["x", "y", "z"][k]
        );
        return Err(SampleFault::new("smooth", message).hint("smooth less"));
    }
    let reach = reach as usize;
    let weights: Vec<f64> = (0..=reach)
        .map(|k| geofan_expr::real::Real::exp(-0.5 * (k as f64 / sigma).powi(2)))
        .collect();
    let sum: f64 = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    let weights: Vec<f64> = weights.iter().map(|w| w / sum).collect();
    for k in 0..3 {
        let count = samples.shape[k];
        if count == 1 {
            continue;
        }
        let inner: usize = samples.shape[k + 1..].iter().product();
        let mut line = vec![0.0; count];
        for first in 0..values.len() / (count * inner) {
            for last in 0..inner {
                let place = |i: usize| (first * count + i) * inner + last;
                (0..count).for_each(|i| line[i] = values[place(i)]);
                for i in 0..count {
                    values[place(i)] = around(&line, i, &weights, axes[k].periodic);
                }
            }
        }
    }
    Ok(values)
}

/// The mean of a line around its sample `i`; `weights` are those of the sample and of each distance.
fn around(line: &[f64], i: usize, weights: &[f64], periodic: bool) -> f64 {
    let count = line.len();
    let end = count - 1;
    let before = |k: usize| match (periodic, i.checked_sub(k)) {
        (_, Some(at)) => line[at],
        (true, None) => line[(i + k * count - k) % count],
        (false, None) => 2.0 * line[0] - line[k - i],
    };
    let after = |k: usize| match (periodic, i + k) {
        (_, at) if at <= end => line[at],
        (true, at) => line[at % count],
        (false, at) => 2.0 * line[end] - line[2 * end - at],
    };
    let sides = (1..weights.len()).map(|k| weights[k] * (before(k) + after(k)));
    weights[0] * line[i] + sides.sum::<f64>()
}
