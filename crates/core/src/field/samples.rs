//! Numbers on a regular grid, and how they are kept in few bytes.
//!
//! Packed samples begin with the width of a number (1 byte: 4 if all are single-precision numbers, else 8; 128 more if
//! their places are known) and the numbers of samples along the axes (3 × u32, little-endian); where they are known the
//! first and the last place along each axis follow (6 × f64). Then a zlib stream: each number as a whole
//! number of the same order (its bits, all of them inverted if it is negative, else the first), less what its seven
//! neighbours before it predict (P. Lindstrom, M. Isenburg, *Fast and Efficient Compression of
//! Floating-Point Data* (2006)), with the sign in the lowest bit; all first bytes, then all second
//! bytes, and so on.

use flate2::{Compression, read::ZlibDecoder, write::ZlibEncoder};
use std::{
    io::{Read, Write},
    sync::Arc,
};

/// The most samples of a field.
pub const MOST_SAMPLES: usize = 1 << 27;

/// Numbers on a regular grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// Samples along x, y and z.
    pub shape: [usize; 3],
    /// The numbers, z fastest.
    pub values: Vec<f64>,
    /// Places of the first and the last sample along each axis, where the file that they come from tells them.
    pub limits: Option<[[f64; 2]; 3]>,
}

/// Samples that do not fit the file that names them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SampleFault {
    /// The key of the field's section that is at fault.
    pub key: &'static str,
    /// The fault.
    pub message: String,
    /// Advice to the user.
    pub hint: Option<String>,
}

impl SampleFault {
    /// Makes a fault of the value under `key`.
    pub fn new(key: &'static str, message: impl Into<String>) -> Self {
        Self {
            key,
            message: message.into(),
            hint: None,
        }
    }

    /// Adds advice.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }
}

/// Samples of fields, by the fields' names.
pub type NamedSamples = [(String, Arc<Samples>)];

/// The bytes are no packed samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("damaged samples")]
pub struct UnpackError;

/// Added to the width of a number in packed samples whose places are known.
const WITH_PLACES: u8 = 128;

/// Bytes of the places of packed samples.
const PLACES: usize = 48;

impl Samples {
    /// Takes numbers in an order in which z runs fastest, of which nothing tells the places.
    pub fn new(shape: [usize; 3], values: Vec<f64>) -> Self {
        Self {
            shape,
            values,
            limits: None,
        }
    }

    /// Takes numbers in an order in which x runs fastest.
    pub fn from_x_fastest(shape: [usize; 3], values: &[f64]) -> Self {
        let [nx, ny, nz] = shape;
        let mut turned = Vec::with_capacity(values.len());
        for x in 0..nx {
            for y in 0..ny {
                turned.extend((0..nz).map(|z| values[(z * ny + y) * nx + x]));
            }
        }
        Self::new(shape, turned)
    }

    /// The least and the greatest number.
    pub fn range(&self) -> [f64; 2] {
        let all = self.values.iter();
        all.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| {
            [a.min(*x), b.max(*x)]
        })
    }

    /// Refuses numbers that are not finite.
    pub(super) fn check_finite(&self, name: &str) -> Result<(), SampleFault> {
        let Some(at) = self.values.iter().position(|x| !x.is_finite()) else {
            return Ok(());
        };
        let [_, ny, nz] = self.shape;
        let count = self.values.iter().filter(|x| !x.is_finite()).count();
        let place = format!("[{}, {}, {}]", at / (ny * nz), at / nz % ny, at % nz);
        let others = match count {
            1 => String::new(),
            n => format!(", and {} others are not finite", n - 1),
        };
        let message = format!("sample {place} of `{name}` is {}{others}", self.values[at]);
        Err(SampleFault::new("file", message)
            .hint("fill gaps before; an index counts from 0 along x, y, z"))
    }

    /// Leaves out the last samples along a periodic axis if they are the first ones again, as they are where
    /// the limits of the samples are those of the period.
    pub(super) fn without_repetition(&self, periodic: [bool; 3]) -> Self {
        let mut samples = self.clone();
        for k in (0..3).filter(|k| periodic[*k] && self.shape[*k] > 1) {
            if samples.repeats(k) {
                samples = samples.without_last(k);
            }
        }
        samples
    }

    /// Whether the last samples along an axis are the first ones, to single precision.
    fn repeats(&self, k: usize) -> bool {
        let [least, most] = self.range();
        let near = (most - least) * f64::from(f32::EPSILON);
        let inner: usize = self.shape[k + 1..].iter().product();
        let block = self.shape[k] * inner;
        let mut blocks = self.values.chunks_exact(block);
        blocks.all(|block| {
            let last = &block[block.len() - inner..];
            block[..inner]
                .iter()
                .zip(last)
                .all(|(a, b)| (a - b).abs() <= near)
        })
    }

    fn without_last(&self, k: usize) -> Self {
        let inner: usize = self.shape[k + 1..].iter().product();
        let block = self.shape[k] * inner;
        let kept = self
            .values
            .chunks_exact(block)
            .flat_map(|b| &b[..block - inner]);
        let mut shape = self.shape;
        shape[k] -= 1;
        Self::new(shape, kept.copied().collect())
    }

    /// Packs the samples, without loss.
    pub fn pack(&self) -> Vec<u8> {
        let single = self
            .values
            .iter()
            .all(|x| f64::from(*x as f32).to_bits() == x.to_bits());
        let width = if single { 4 } else { 8 };
        let ordered: Vec<u64> = match single {
            true => self
                .values
                .iter()
                .map(|x| u64::from(order_32((*x as f32).to_bits())))
                .collect(),
            false => self.values.iter().map(|x| order_64(x.to_bits())).collect(),
        };
        let mut residuals = Vec::with_capacity(ordered.len());
        for at in 0..ordered.len() {
            let difference = ordered[at].wrapping_sub(self.predicted(&ordered, at));
            residuals.push(sign_last(difference, width));
        }
        let places = if self.limits.is_some() {
            WITH_PLACES
        } else {
            0
        };
        let mut out = vec![width as u8 | places];
        for count in self.shape {
            out.extend((count as u32).to_le_bytes());
        }
        let limits = self.limits.as_slice().as_flattened().as_flattened();
        out.extend(limits.iter().flat_map(|place| place.to_le_bytes()));
        let mut encoder = ZlibEncoder::new(out, Compression::default());
        for byte in (0..width).rev() {
            let plane: Vec<u8> = residuals.iter().map(|r| (r >> (8 * byte)) as u8).collect();
            encoder.write_all(&plane).expect("memory takes all bytes");
        }
        encoder.finish().expect("memory takes all bytes")
    }

    /// Reads what [`Samples::pack`] wrote.
    ///
    /// # Errors
    /// The bytes are something else.
    pub fn unpack(bytes: &[u8]) -> Result<Self, UnpackError> {
        let (head, stream) = bytes.split_first_chunk().ok_or(UnpackError)?;
        let (limits, stream) = match head[0] & WITH_PLACES {
            0 => (None, stream),
            _ => {
                let (places, stream) = stream.split_at_checked(PLACES).ok_or(UnpackError)?;
                (Some(unpacked_places(places)), stream)
            }
        };
        let width = match head[0] & !WITH_PLACES {
            width @ (4 | 8) => usize::from(width),
            _ => return Err(UnpackError),
        };
        let shape = packed_shape(head);
        let total = checked_total(shape).ok_or(UnpackError)?;
        let mut planes = Vec::new();
        let most = (total * width) as u64;
        let mut decoder = ZlibDecoder::new(stream).take(most + 1);
        decoder.read_to_end(&mut planes).map_err(|_| UnpackError)?;
        if planes.len() as u64 != most {
            return Err(UnpackError);
        }
        let mut samples = Self {
            shape,
            values: Vec::new(),
            limits,
        };
        let mut ordered = vec![0; total];
        for at in 0..total {
            let byte = |sum: u64, k: usize| sum << 8 | u64::from(planes[k * total + at]);
            let residual = (0..width).fold(0, byte);
            let difference = sign_first(residual);
            let value = samples.predicted(&ordered, at).wrapping_add(difference);
            ordered[at] = if width == 4 {
                value & u64::from(u32::MAX)
            } else {
                value
            };
        }
        samples.values = match width {
            4 => ordered
                .into_iter()
                .map(|x| f64::from(f32::from_bits(disorder_32(x as u32))))
                .collect(),
            _ => ordered
                .into_iter()
                .map(|x| f64::from_bits(disorder_64(x)))
                .collect(),
        };
        Ok(samples)
    }

    /// Returns how many numbers [`Samples::pack`] wrote into `bytes`, if they are a grid that may be.
    pub fn packed_count(bytes: &[u8]) -> Option<usize> {
        checked_total(packed_shape(bytes.first_chunk()?))
    }

    /// The prediction of a number from its neighbours before it, exact for `f(x, y) + g(y, z) + h(z, x)`.
    fn predicted(&self, ordered: &[u64], at: usize) -> u64 {
        let [_, ny, nz] = self.shape;
        let place = [at / (ny * nz), at / nz % ny, at % nz];
        let steps = [ny * nz, nz, 1];
        let mut sum = 0_u64;
        for corner in 1..8_usize {
            let on = |k: usize| corner >> k & 1 == 1;
            if (0..3).any(|k| on(k) && place[k] == 0) {
                continue;
            }
            let back: usize = (0..3).filter(|k| on(*k)).map(|k| steps[k]).sum();
            let value = ordered[at - back];
            sum = match corner.count_ones() {
                2 => sum.wrapping_sub(value),
                _ => sum.wrapping_add(value),
            };
        }
        sum
    }
}

/// The numbers of samples along the axes, in the bytes before packed samples: the width of a number, then these.
fn packed_shape(head: &[u8; 13]) -> [usize; 3] {
    [1, 5, 9].map(|at| {
        let bytes = [head[at], head[at + 1], head[at + 2], head[at + 3]];
        u32::from_le_bytes(bytes) as usize
    })
}

/// The first and the last place along each axis.
fn unpacked_places(bytes: &[u8]) -> [[f64; 2]; 3] {
    let (places, _) = bytes.as_chunks();
    [0, 1, 2].map(|k| [0, 1].map(|end| f64::from_le_bytes(places[2 * k + end])))
}

/// The number of samples of a grid, if it is one that may be.
pub(super) fn checked_total(shape: [usize; 3]) -> Option<usize> {
    let total = shape
        .iter()
        .try_fold(1_usize, |n, count| n.checked_mul(*count))?;
    (1..=MOST_SAMPLES).contains(&total).then_some(total)
}

/// A whole number of the same order as the number with these bits.
fn order_32(bits: u32) -> u32 {
    if bits >> 31 == 1 {
        !bits
    } else {
        bits | 1 << 31
    }
}

fn disorder_32(ordered: u32) -> u32 {
    if ordered >> 31 == 1 {
        ordered & !(1 << 31)
    } else {
        !ordered
    }
}

fn order_64(bits: u64) -> u64 {
    if bits >> 63 == 1 {
        !bits
    } else {
        bits | 1 << 63
    }
}

fn disorder_64(ordered: u64) -> u64 {
    if ordered >> 63 == 1 {
        ordered & !(1 << 63)
    } else {
        !ordered
    }
}

/// A difference of `width` bytes with its sign in the lowest bit.
fn sign_last(difference: u64, width: usize) -> u64 {
    let free = 64 - 8 * width as u32;
    let signed = (difference << free) as i64 >> free;
    let folded = (signed << 1 ^ signed >> 63) as u64;
    folded << free >> free
}

fn sign_first(folded: u64) -> u64 {
    folded >> 1 ^ (folded & 1).wrapping_neg()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    #[test]
    fn samples_come_back_as_they_were() {
        let mut stream = Stream::new(&[3]);
        for shape in [[1, 1, 1], [4, 3, 5], [7, 1, 2]] {
            let count = shape.iter().product();
            let wild = (0..count).map(|_| f64::from_bits(stream.bits()));
            let mut wild: Vec<f64> = wild.collect();
            wild[0] = -0.0;
            let single = wild.iter().map(|x| f64::from(*x as f32)).collect();
            for values in [wild, single] {
                let mut samples = Samples::new(shape, values);
                samples.limits = (count > 1).then_some([[0.5, 2.0], [-1.0, 1.0], [0.0, 1e9]]);
                let back = Samples::unpack(&samples.pack()).unwrap();
                let bits = |s: &Samples| s.values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                assert_eq!((bits(&back), back.shape), (bits(&samples), shape));
                assert_eq!(back.limits, samples.limits);
            }
        }
    }

    #[test]
    fn smooth_samples_take_fewer_bytes() {
        let value = |i: i32| {
            let place = [i / 1089, i / 33 % 33, i % 33].map(|k| f64::from(k - 16) / 4.0);
            let r2: f64 = place.iter().map(|x| x * x).sum();
            f64::from((0.5 * (-r2 / 2.0).exp()) as f32)
        };
        let samples = Samples::new([33; 3], (0..33 * 33 * 33).map(value).collect());
        let (plain, packed) = (4 * samples.values.len(), samples.pack().len());
        assert!(packed < plain * 7 / 10, "{packed} of {plain}");
    }

    #[test]
    fn damaged_bytes_are_refused() {
        let mut samples = Samples::new([2, 3, 4], (0..24).map(f64::from).collect());
        samples.limits = Some([[0.0, 1.0]; 3]);
        let bytes = samples.pack();
        for length in 0..bytes.len() {
            assert!(Samples::unpack(&bytes[..length]).is_err(), "{length}");
        }
        let mut hostile = bytes.clone();
        hostile[1..13].fill(255);
        assert!(Samples::unpack(&hostile).is_err());
        let mut longer = bytes;
        longer[1] = 1;
        assert!(Samples::unpack(&longer).is_err());
    }
}
