//! A patch: one polynomial for all paths of a box of (camera, direction, arc length), stored as
//! quantised Chebyshev coefficients.
//!
//! In: exact samples at the tensor grid of Chebyshev nodes of the box ([`Polynomial::fit`]). Out:
//! integers coded by pco ([`Polynomial::encode`]), and for a fixed camera the small table over
//! direction and arc length that remains when the camera axes are summed out
//! ([`Tensor::contract`]). Axes: camera…, direction…, arc length, channel. Coefficients beyond the
//! last one that rounds to something are not stored.

use super::{
    bytes::{Damage, Reader, Writer},
    chebyshev,
    contracted::Contracted,
};
use ndarray::{ArrayD, ArrayViewD, Axis, IxDyn, Slice};
use std::sync::OnceLock;

/// Chebyshev coefficients of one group of channels, in standard layout.
#[derive(Debug, Clone)]
pub struct Polynomial(ArrayD<f64>);

impl Polynomial {
    /// From samples with axes (camera…, direction…, arc length, channel).
    pub fn fit(samples: ArrayViewD<'_, f64>) -> Self {
        let axes = samples.ndim() - 1;
        Self(chebyshev::coefficients(
            samples.as_standard_layout().into_owned(),
            axes,
        ))
    }

    /// The root of the sum of squares of the two highest coefficients along each axis: what
    /// splitting the axis would reduce most is largest.
    pub fn tails(&self) -> Vec<f64> {
        (0..self.0.ndim() - 1)
            .map(|axis| {
                let n = self.0.len_of(Axis(axis)) as isize;
                let tail = self
                    .0
                    .slice_axis(Axis(axis), Slice::from((n - 2).max(0)..n));
                tail.iter().map(|c| c * c).sum::<f64>().sqrt()
            })
            .collect()
    }

    /// Whether all coefficients are finite.
    pub fn is_finite(&self) -> bool {
        self.0.iter().all(|c| c.is_finite())
    }

    /// Rounded to multiples of `step`, coefficients beyond the last that is not zero left out;
    /// `None` if a coefficient is too large for the step.
    pub fn rounded(&self, step: f64) -> Option<Self> {
        let limit = f64::from(i32::MAX / 2) * step;
        if !(step > 0.0) || self.0.iter().any(|c| !(c.abs() < limit)) {
            return None;
        }
        let rounded = self.0.mapv(|c| (c / step).round());
        let mut kept = vec![1; rounded.ndim()];
        kept[rounded.ndim() - 1] = rounded.shape()[rounded.ndim() - 1];
        for (index, value) in rounded.indexed_iter() {
            if *value != 0.0 {
                for (axis, k) in kept.iter_mut().enumerate() {
                    *k = (*k).max(index[axis] + 1);
                }
            }
        }
        let trimmed = rounded.slice_each_axis(|axis| Slice::from(..kept[axis.axis.index()]));
        Some(Self(trimmed.mapv(|x| x * step)))
    }

    /// Codes a polynomial that [`Polynomial::rounded`] made with this `step`.
    pub fn encode(&self, step: f64) -> Tensor {
        let integers: Vec<i32> = self.0.iter().map(|c| (c / step).round() as i32).collect();
        let config = pco::ChunkConfig::default();
        // pco refuses only configurations, never data.
        let stream =
            pco::standalone::simple_compress(&integers, &config).expect("valid configuration");
        Tensor {
            shape: self.0.shape().to_vec(),
            step,
            stream,
            decoded: OnceLock::new(),
        }
    }

    /// The table over (direction 1, direction 2, arc length × channel) that remains at camera
    /// parameters `camera` in [−1, 1]; with one direction parameter the second axis has length 1.
    pub fn contract(&self, camera: &[f64]) -> Contracted {
        let mut shape = self.0.shape().to_vec();
        let mut flat = std::borrow::Cow::Borrowed(self.0.as_slice().unwrap_or_default());
        for &x in camera {
            let mut weights = [0.0; MOST_DEGREES];
            let n = shape.remove(0);
            chebyshev::values(x, &mut weights[..n]);
            let mut sum = vec![0.0; flat.len() / n];
            for (part, w) in flat.chunks_exact(sum.len()).zip(weights) {
                for (s, c) in sum.iter_mut().zip(part) {
                    *s += w * c;
                }
            }
            flat = sum.into();
        }
        Contracted::new(&shape, &flat)
    }
}

/// Quantised coefficients of one group of channels.
#[derive(Debug, Clone)]
pub struct Tensor {
    shape: Vec<usize>,
    step: f64,
    /// The integers, coded.
    stream: Vec<u8>,
    decoded: OnceLock<Option<Polynomial>>,
}

/// The most coefficients of a tensor: far above any that a bake makes, and small enough that a
/// hostile file cannot exhaust the memory.
const MOST_COEFFICIENTS: u64 = 1 << 24;

/// The most coefficients along one axis.
pub const MOST_DEGREES: usize = 64;

impl Tensor {
    /// The coefficients; `None` if the stream does not hold as many as declared.
    fn decoded(&self) -> Option<&Polynomial> {
        let decode = || {
            let mut integers = vec![0_i32; self.shape.iter().product()];
            let progress =
                pco::standalone::simple_decompress_into(&self.stream, &mut integers).ok()?;
            if !progress.finished || progress.n_processed != integers.len() {
                return None;
            }
            let scaled = integers.iter().map(|&i| f64::from(i) * self.step).collect();
            let array = ArrayD::from_shape_vec(IxDyn(&self.shape), scaled).ok()?;
            Some(Polynomial(array))
        };
        self.decoded.get_or_init(decode).as_ref()
    }

    /// The bytes it takes in a bundle.
    pub fn bytes(&self) -> usize {
        self.stream.len() + self.shape.len() + 13
    }

    /// [`Polynomial::contract`] of the coded polynomial.
    ///
    /// # Errors
    /// The coded integers are not what their header says.
    pub fn contract(&self, camera: &[f64]) -> Result<Contracted, Damage> {
        let polynomial = self.decoded().ok_or(Damage("coefficients"))?;
        Ok(polynomial.contract(camera))
    }

    /// Writes the tensor.
    pub fn encode(&self, out: &mut Writer) {
        out.u8(self.shape.len() as u8);
        for &n in &self.shape {
            out.u8(n as u8);
        }
        out.f64(self.step);
        out.bytes(&self.stream);
    }

    /// Reads what [`Tensor::encode`] wrote, with `axes` axes, the last of `channels`.
    pub fn decode(input: &mut Reader<'_>, axes: usize, channels: usize) -> Result<Self, Damage> {
        if usize::from(input.u8()?) != axes {
            return Err(Damage("number of axes"));
        }
        let mut shape = Vec::new();
        let mut count = 1_u64;
        for _ in 0..axes {
            let n = input.u8()?;
            count = count.saturating_mul(u64::from(n));
            shape.push(usize::from(n));
        }
        if shape.iter().any(|n| *n > MOST_DEGREES) {
            return Err(Damage("number of degrees"));
        }
        if count == 0 || count > MOST_COEFFICIENTS || shape[axes - 1] != channels {
            return Err(Damage("number of coefficients"));
        }
        let step = input.f64()?;
        if !(step > 0.0 && step.is_finite()) {
            return Err(Damage("quantisation step"));
        }
        Ok(Self {
            shape,
            step,
            stream: input.bytes()?.to_vec(),
            decoded: OnceLock::new(),
        })
    }
}

/// A leaf of the table: displacement, and rotation unless left out.
#[derive(Debug, Clone)]
pub struct Patch {
    /// Displacement channels.
    pub displacement: Tensor,
    /// Quaternion channels.
    pub rotation: Option<Tensor>,
}

impl Patch {
    /// The bytes it takes in a bundle.
    pub fn bytes(&self) -> usize {
        self.displacement.bytes() + self.rotation.as_ref().map_or(0, Tensor::bytes)
    }
}
