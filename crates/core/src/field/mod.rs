//! Sampled fields: functions of three arguments that a file of numbers gives.
//!
//! In: [`Samples`] on a regular grid, their places, and how they are to be used ([`FieldPlan`]). Out: a [`Field`]
//! with its spline, and the hash by which a manifold knows it: of the samples and their use, not of the
//! file that they came from. [`read`] reads files, [`Samples::pack`] writes samples in few bytes.
//!
//! Measured samples may be smoothed: each axis is convolved with a Gaussian. Beyond an end that is not periodic,
//! samples are continued by their point reflection at the end, which keeps linear functions as they are.

pub mod read;
mod samples;

pub use samples::{MOST_SAMPLES, NamedSamples, SampleFault, Samples, UnpackError};

use geofan_expr::spline::{SampledAxis, Spline};
use std::sync::Arc;

/// How a field is continued outside its grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Outside {
    /// As at the nearest point of the grid.
    #[default]
    Clamp,
    /// As one period before or after.
    Periodic,
    /// Not at all: paths leave through the exit called as the field.
    Exit,
}

impl Outside {
    /// Returns its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Clamp => "clamp",
            Self::Periodic => "periodic",
            Self::Exit => "exit",
        }
    }
}

/// How samples become a function.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldPlan {
    /// Places of the first and the last sample along each axis.
    pub limits: [[f64; 2]; 3],
    /// Degree of the spline.
    pub degree: usize,
    /// The use beyond the samples, along each axis.
    pub outside: [Outside; 3],
    /// Standard deviation, in steps of the grid, of the Gaussian by which samples are smoothed; 0 for none.
    pub smooth: f64,
}

/// A function of three arguments given by samples.
#[derive(Debug, Clone)]
pub struct Field {
    /// Its name in expressions.
    pub name: String,
    /// The files that it was read from, as the manifold names them.
    pub files: Vec<String>,
    /// The samples as they were read.
    pub samples: Arc<Samples>,
    /// Their use.
    pub plan: FieldPlan,
    /// The function.
    pub spline: Arc<Spline>,
}

impl Field {
    /// Makes the function of `samples`.
    ///
    /// # Errors
    /// Samples and plan do not fit: the key at fault and why.
    pub fn new(
        name: String,
        files: Vec<String>,
        samples: Arc<Samples>,
        plan: FieldPlan,
    ) -> Result<Self, SampleFault> {
        samples.check_finite(&name)?;
        let used = samples.without_repetition(plan.outside.map(|o| o == Outside::Periodic));
        let axes = axes_of(&samples, &used, &plan);
        let smoothed = smoothed(&used, &axes, plan.smooth)?;
        let identity = identity(&samples, &plan);
        let spline = Spline::through(&smoothed, axes, plan.degree, identity).map_err(|few| {
            let axis = ["x", "y", "z"][few.axis - 1];
            let message = format!(
                "`{name}` has {} samples along {axis}; degree {} needs {} (or 1, where nothing depends on {axis})",
                few.found, few.degree, few.needed
            );
            SampleFault::new("degree", message).hint("take a lower degree, or more samples")
        })?;
        if !spline.is_finite() {
            let message = format!("the samples of `{name}` are too large to be interpolated");
            return Err(SampleFault::new("file", message).hint("scale them"));
        }
        Ok(Self {
            name,
            files,
            samples,
            plan,
            spline: Arc::new(spline),
        })
    }

    /// Describes it in words.
    pub fn line(&self) -> String {
        let [x, y, z] = self.samples.shape;
        let axis = |k: usize| {
            let [low, high] = self.plan.limits[k];
            let beyond = match (self.samples.shape[k], self.plan.outside[k]) {
                (1, _) => return format!("{} constant", ["x", "y", "z"][k]),
                (_, Outside::Clamp) => "clamped",
                (_, Outside::Periodic) => "periodic",
                (_, Outside::Exit) => "an exit beyond",
            };
            format!("{} in [{low}, {high}] {beyond}", ["x", "y", "z"][k])
        };
        let [least, most] = self.samples.range();
        let smooth = match self.plan.smooth {
            0.0 => String::new(),
            sigma => format!(", smoothed by {sigma} steps"),
        };
        format!(
            "{}: {x} x {y} x {z} samples of {}, from {least:.6} to {most:.6}; {}, {}, {}; degree {}{smooth}",
            self.name,
            self.files.join(", "),
            axis(0),
            axis(1),
            axis(2),
            self.plan.degree,
        )
    }
}

/// The grid that a spline goes through.
fn axes_of(read: &Samples, used: &Samples, plan: &FieldPlan) -> [SampledAxis; 3] {
    [0, 1, 2].map(|k| {
        let [low, high] = plan.limits[k];
        let steps = (read.shape[k] - 1).max(1) as f64;
        let last = low + (high - low) * (used.shape[k] - 1) as f64 / steps;
        SampledAxis {
            samples: used.shape[k],
            limits: if used.shape[k] == read.shape[k] {
                [low, high]
            } else {
                [low, last]
            },
            periodic: plan.outside[k] == Outside::Periodic,
        }
    })
}

/// Hashes samples and their use.
fn identity(samples: &Samples, plan: &FieldPlan) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    for count in samples.shape {
        hasher.update(&(count as u64).to_le_bytes());
    }
    for value in &samples.values {
        hasher.update(&value.to_bits().to_le_bytes());
    }
    for limit in plan.limits.as_flattened() {
        hasher.update(&limit.to_bits().to_le_bytes());
    }
    let outside = plan.outside.map(|o| o as u8);
    hasher.update(&outside);
    hasher.update(&[plan.degree as u8]);
    hasher.update(&plan.smooth.to_bits().to_le_bytes());
    *hasher.finalize().as_bytes()
}

/// Standard deviations after which the Gaussian is cut: what is left out is 2e-9 of it.
const REACH: f64 = 6.0;

/// The samples smoothed by a Gaussian of standard deviation `sigma`, in steps of the grid.
fn smoothed(
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

#[cfg(test)]
mod tests;
