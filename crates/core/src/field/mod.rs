//! Sampled fields: functions of three arguments that a file of numbers gives.
//!
//! In: [`Samples`] on a regular grid, their places, and how they are to be used ([`FieldPlan`]). Out: a [`Field`]
//! with its spline, and the hash by which a manifold knows it: of the samples and their use, not of the
//! file that they came from. [`read`] reads files, [`Samples::pack`] writes samples in few bytes.

pub mod read;
mod samples;
mod smooth;

pub use samples::{MOST_SAMPLES, SampleFault, Samples, UnpackError};

use geofan_expr::spline::{SampledAxis, Spline};
use std::sync::Arc;

/// The use of a field beyond its samples.
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
        let smoothed = smooth::smoothed(&used, &axes, plan.smooth)?;
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

#[cfg(test)]
mod tests;
