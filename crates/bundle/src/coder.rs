//! Integers of many tensors, coded together in as many bits as they are unexpected.
//!
//! In: tensors of rounded coefficients. Out: words of a range coder (the crate `constriction`), and back.
//! Coefficients fall off along every axis, so the integers around one ([`crate::context`]) tell its class
//! and something of its sign. Of an integer of magnitude about `m` the last `k` bits are as good as random;
//! the number of times that `2^k ≈ m/3` goes into it is told by a row of yes and no, one for each time, and
//! the probability of yes at each is learnt for each class while coding (J. Rissanen, G. G. Langdon,
//! *Arithmetic coding*, IBM J. Res. Dev. 23 (1979)). Signs come with a probability of their own. All tensors
//! of a chunk share what is learnt. Probabilities are integers: every machine reads what any other wrote.

use crate::{
    context::{CLASSES, Context, MagnitudeModel, SignModel},
    decode::{ByteReader, DecodeError, put_bytes},
    householder::Pivots,
};
use constriction::{
    UnwrapInfallible,
    stream::{
        Decode, Encode,
        model::{DecoderModel, EncoderModel, EntropyModel, UniformModel},
        queue::{DefaultRangeDecoder, DefaultRangeEncoder},
    },
};
use std::{borrow::Borrow, num::NonZeroU32};

/// The most integers of a chunk: far above any that a bake makes, and small enough that a hostile
/// file cannot exhaust the memory.
const MOST_INTEGERS: usize = 1 << 26;

/// Bits of a probability.
const PRECISION: usize = 16;
const ONE: u32 = 1 << PRECISION;

/// The most adaptive bits of an integer; what is beyond is told by its number of bits.
const ADAPTIVE_BITS: usize = 15;

/// Probabilities stay this far from 0 and 1.
const LEAST: u32 = 64;

/// Number of bits that the first guess of a probability counts for, and number after which it no longer
/// matters how many there were: later ones then count more. From 3 to 12, and from 120 to 600, bytes
/// are the same to 0.1 %.
const GUESSED: u8 = 6;
const FORGETS: u8 = 200;

/// The most bits that are coded at once, each as likely as not.
const RAW: u32 = 16;

const DAMAGE: DecodeError = DecodeError("coefficients");

/// A yes or no whose probability is learnt.
#[derive(Debug, Clone, Copy)]
struct AdaptiveBit {
    /// The probability of yes in units of 1/[`ONE`].
    yes: u32,
    seen: u8,
}

/// Adaptive bits of each class.
type Contexts = Vec<[AdaptiveBit; ADAPTIVE_BITS]>;

impl AdaptiveBit {
    /// Expects integers of mean magnitude `numerator / denominator` in units of what is asked for.
    fn expected(numerator: u64, denominator: u64) -> Self {
        let yes = u64::from(ONE) * numerator / (numerator + denominator);
        Self {
            yes: (yes as u32).clamp(LEAST, ONE - LEAST),
            seen: GUESSED,
        }
    }

    /// Takes over a probability that is learnt elsewhere.
    fn known(likely: f64) -> Self {
        let yes = (likely * f64::from(ONE)) as u32;
        Self {
            yes: yes.clamp(LEAST, ONE - LEAST),
            seen: FORGETS,
        }
    }

    fn learn(&mut self, yes: bool) {
        let target = if yes { ONE } else { 0 };
        let change = (target as i32 - self.yes as i32) / (i32::from(self.seen) + 2);
        self.yes = self
            .yes
            .saturating_add_signed(change)
            .clamp(LEAST, ONE - LEAST);
        self.seen = (self.seen + 1).min(FORGETS);
    }

    /// Returns where the share of an answer begins, and how large it is.
    fn share(self, yes: bool) -> (u32, NonZeroU32) {
        let (first, share) = if yes {
            (0, self.yes)
        } else {
            (self.yes, ONE - self.yes)
        };
        (first, NonZeroU32::new(share).unwrap_or(NonZeroU32::MIN))
    }
}

impl EntropyModel<PRECISION> for AdaptiveBit {
    type Symbol = bool;
    type Probability = u32;
}

impl EncoderModel<PRECISION> for AdaptiveBit {
    fn left_cumulative_and_probability(&self, yes: impl Borrow<bool>) -> Option<(u32, NonZeroU32)> {
        Some(self.share(*yes.borrow()))
    }
}

impl DecoderModel<PRECISION> for AdaptiveBit {
    fn quantile_function(&self, quantile: u32) -> (bool, u32, NonZeroU32) {
        let yes = quantile < self.yes;
        let (first, share) = self.share(yes);
        (yes, first, share)
    }
}

/// Returns the model of `bits` bits, from 1 to [`RAW`], each as likely as not.
fn raw_bits(bits: u32) -> UniformModel<u32, PRECISION> {
    UniformModel::new(1 << bits)
}

/// Returns the number of bits of an integer of `class` that are not worth learning about: what is left is
/// 2.4 to 4.5 on average.
fn raw_bits_of(class: usize) -> u32 {
    (class.saturating_sub(16) / 4) as u32
}

/// Sets up the adaptive bits before anything is learnt.
fn contexts() -> Contexts {
    let rows = (0..CLASSES).map(|class| {
        let bit = match class.checked_sub(2) {
            None => AdaptiveBit::expected(1, 20),
            // The middle of the class, 0.2 · 2^((class − 1.5)/4), in units of 2^(raw bits).
            Some(quarters) => {
                let middle = [218, 259, 308, 367][quarters % 4] << (quarters / 4);
                AdaptiveBit::expected(middle, 1000 << raw_bits_of(class))
            }
        };
        [bit; ADAPTIVE_BITS]
    });
    rows.collect()
}

/// Codes the integers of tensors.
#[derive(Debug)]
pub struct IntegerEncoder {
    words: DefaultRangeEncoder,
    contexts: Contexts,
    magnitudes: MagnitudeModel,
    signs: SignModel,
    count: u32,
}

impl IntegerEncoder {
    /// Begins with nothing coded or learnt.
    pub fn new() -> Self {
        Self {
            words: DefaultRangeEncoder::new(),
            contexts: contexts(),
            magnitudes: MagnitudeModel::default(),
            signs: SignModel::default(),
            count: 0,
        }
    }

    /// Adds the integers of a tensor in storage order: [reduced](crate::householder::reduced) vectors of
    /// this `length`.
    pub fn put(&mut self, shape: &[usize], length: usize, values: &[i32]) {
        let mut context = Context::new(shape);
        let mut pivots = Pivots::none(length);
        for (number, vector) in values.chunks_exact(length.max(1)).enumerate() {
            for (place, value) in vector.iter().enumerate() {
                let before = &values[..number * length + place];
                context.advance(before);
                if !pivots.contains(place) {
                    context.look(before);
                    self.put_integer(&context, *value);
                }
            }
            pivots.add(vector);
        }
        self.count += values.len() as u32;
    }

    /// Adds the integer at the present place.
    fn put_integer(&mut self, context: &Context, value: i32) {
        let magnitude = value.unsigned_abs();
        let class = self.magnitudes.class(context);
        self.put_magnitude(class, magnitude);
        self.magnitudes.learn(context, magnitude);
        if value != 0 {
            let plus = self.signs.plus(context, magnitude);
            self.put_bit(plus, value > 0);
            self.signs.learn(context, value > 0);
        }
    }

    /// Adds a magnitude of this class.
    fn put_magnitude(&mut self, class: usize, magnitude: u32) {
        let low = raw_bits_of(class);
        let times = magnitude >> low;
        for (told, bit) in (0..).zip(&mut self.contexts[class]) {
            let yes = times > told;
            // The coder cannot fail: its words are kept in memory, and every answer is possible.
            let _ = self.words.encode_symbol(yes, *bit);
            bit.learn(yes);
            if !yes {
                break;
            }
        }
        if let Some(beyond) = times.checked_sub(ADAPTIVE_BITS as u32) {
            self.put_elias(beyond + 1);
        }
        self.put_raw(low, magnitude);
    }

    /// Adds a yes or no, where yes has the probability `likely`.
    fn put_bit(&mut self, likely: f64, yes: bool) {
        let _ = self.words.encode_symbol(yes, AdaptiveBit::known(likely));
    }

    /// Adds a number from 1 up: its number of bits, and those (P. Elias, *Universal codeword sets and
    /// representations of the integers*, IEEE Trans. Inf. Theory 21 (1975)).
    fn put_elias(&mut self, number: u32) {
        let bits = number.ilog2();
        self.put_raw(5, bits);
        self.put_raw(bits, number);
    }

    /// Adds the last `bits` bits of `value`.
    fn put_raw(&mut self, bits: u32, value: u32) {
        let mut left = bits;
        while left > 0 {
            let some = left.min(RAW);
            left -= some;
            let part = (value >> left) & ((1 << some) - 1);
            let _ = self.words.encode_symbol(part as usize, raw_bits(some));
        }
    }

    /// Counts the bytes so far.
    pub fn bytes(&self) -> usize {
        4 * self.words.num_words()
    }

    /// Writes the number of integers, and the words that they are coded in.
    pub fn finish(self, out: &mut Vec<u8>) {
        let words = self.words.into_compressed().unwrap_infallible();
        let words: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        out.extend(self.count.to_le_bytes());
        put_bytes(out, &words);
    }
}

/// Reads what an [`IntegerEncoder`] wrote.
#[derive(Debug)]
pub struct IntegerDecoder {
    /// None where zeros are read instead.
    words: Option<DefaultRangeDecoder>,
    contexts: Contexts,
    magnitudes: MagnitudeModel,
    signs: SignModel,
    left: usize,
}

impl IntegerDecoder {
    /// Begins to read what [`IntegerEncoder::finish`] wrote.
    ///
    /// # Errors
    /// It is damaged.
    pub fn new(input: &mut ByteReader<'_>) -> Result<Self, DecodeError> {
        let left = input.u32()? as usize;
        if left > MOST_INTEGERS {
            return Err(DecodeError("number of coefficients"));
        }
        let (words, rest) = input.bytes()?.as_chunks::<4>();
        if !rest.is_empty() {
            return Err(DecodeError("words of coefficients"));
        }
        let words: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
        Ok(Self {
            words: Some(DefaultRangeDecoder::from_compressed(words).unwrap_infallible()),
            contexts: contexts(),
            magnitudes: MagnitudeModel::default(),
            signs: SignModel::default(),
            left,
        })
    }

    /// Begins to read as many zeros instead: the structure of a chunk is then known some fifteen times
    /// sooner.
    ///
    /// # Errors
    /// It is damaged.
    pub fn zeros(input: &mut ByteReader<'_>) -> Result<Self, DecodeError> {
        let decoder = Self::new(input)?;
        Ok(Self {
            words: None,
            ..decoder
        })
    }

    /// Takes the integers of the next tensor out, vectors of this `length`.
    ///
    /// # Errors
    /// There are fewer integers.
    pub fn take(&mut self, shape: &[usize], length: usize) -> Result<Vec<i32>, DecodeError> {
        let count = shape.iter().product();
        let left = self.left.checked_sub(count);
        self.left = left.ok_or(DecodeError("number of coefficients"))?;
        if self.words.is_none() {
            return Ok(vec![0; count]);
        }
        let mut values = Vec::with_capacity(count);
        let mut context = Context::new(shape);
        let mut pivots = Pivots::none(length);
        for first in (0..count).step_by(length.max(1)) {
            for place in 0..length {
                context.advance(&values);
                values.push(match pivots.contains(place) {
                    true => 0,
                    false => {
                        context.look(&values);
                        self.take_integer(&context)?
                    }
                });
            }
            pivots.add(&values[first..]);
        }
        Ok(values)
    }

    /// Takes the integer at the present place.
    fn take_integer(&mut self, context: &Context) -> Result<i32, DecodeError> {
        let class = self.magnitudes.class(context);
        let value = self.take_magnitude(class)?;
        let magnitude = value.unsigned_abs();
        self.magnitudes.learn(context, magnitude);
        if value == 0 {
            return Ok(0);
        }
        let plus = self.signs.plus(context, magnitude);
        let positive = self.take_symbol(AdaptiveBit::known(plus))?;
        self.signs.learn(context, positive);
        Ok(if positive { value } else { -value })
    }

    /// Takes a magnitude of this class.
    fn take_magnitude(&mut self, class: usize) -> Result<i32, DecodeError> {
        let mut times = 0;
        for told in 0..ADAPTIVE_BITS {
            let yes = self.take_symbol(self.contexts[class][told])?;
            self.contexts[class][told].learn(yes);
            if !yes {
                break;
            }
            times += 1;
        }
        if times == ADAPTIVE_BITS as u32 {
            times = times.checked_add(self.take_elias()? - 1).ok_or(DAMAGE)?;
        }
        let low = raw_bits_of(class);
        let high = times.checked_mul(1 << low).ok_or(DAMAGE)?;
        let magnitude = high | self.take_raw(low)?;
        i32::try_from(magnitude).map_err(|_| DAMAGE)
    }

    fn take_elias(&mut self) -> Result<u32, DecodeError> {
        let bits = self.take_raw(5)?;
        Ok((1 << bits) | self.take_raw(bits)?)
    }

    fn take_raw(&mut self, bits: u32) -> Result<u32, DecodeError> {
        let (mut left, mut value) = (bits, 0);
        while left > 0 {
            let some = left.min(RAW);
            left -= some;
            let part = self.take_symbol(raw_bits(some))?;
            value = (value << some) | part as u32;
        }
        Ok(value)
    }

    fn take_symbol<M>(&mut self, model: M) -> Result<M::Symbol, DecodeError>
    where
        M: DecoderModel<PRECISION, Probability = u32>,
    {
        let words = self.words.as_mut().ok_or(DAMAGE)?;
        words.decode_symbol(model).map_err(|_| DAMAGE)
    }

    /// Checks that nothing is left.
    ///
    /// # Errors
    /// Something is.
    pub fn finish(&self) -> Result<(), DecodeError> {
        let done = self
            .words
            .as_ref()
            .is_none_or(Decode::<PRECISION>::maybe_exhausted);
        match self.left == 0 && done {
            true => Ok(()),
            false => Err(DecodeError("end")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::random::Stream;

    fn decoder(encoder: IntegerEncoder) -> IntegerDecoder {
        let mut out = Vec::new();
        encoder.finish(&mut out);
        IntegerDecoder::new(&mut ByteReader(&out)).unwrap()
    }

    #[test]
    fn every_magnitude_comes_back_in_every_class() {
        let extremes = [0, 1, 2, 14, 15, 16, 17, 1000, 1 << 20, 1 << 30, i32::MAX];
        let mut encoder = IntegerEncoder::new();
        for class in 0..CLASSES {
            for magnitude in extremes {
                encoder.put_magnitude(class, magnitude as u32);
                encoder.put_bit(0.1, magnitude % 2 == 0);
            }
        }
        let mut decoder = decoder(encoder);
        for class in 0..CLASSES {
            for magnitude in extremes {
                let found = decoder.take_magnitude(class);
                assert_eq!(found, Ok(magnitude), "class {class}");
                let bit = decoder.take_symbol(AdaptiveBit::known(0.1));
                assert_eq!(bit, Ok(magnitude % 2 == 0));
            }
        }
        assert_eq!(decoder.finish(), Ok(()));
    }

    /// Magnitudes of a geometric distribution take hardly more than their entropy.
    #[test]
    fn expected_magnitudes_take_their_entropy() {
        for (size, yes) in [(1_i32, 0.05_f64), (6, 0.5), (10, 0.8), (24, 0.998)] {
            let class = 2 + 2 * (size - 2).max(0) as usize;
            let mut stream = Stream::new(&[class as u64]);
            let mut encoder = IntegerEncoder::new();
            let count = 20_000;
            for _ in 0..count {
                let magnitude = (stream.uniform().ln() / yes.ln()) as i32;
                encoder.put_magnitude(class, magnitude as u32);
            }
            let binary = -(yes * yes.log2() + (1.0 - yes) * (1.0 - yes).log2()) / (1.0 - yes);
            let entropy = f64::from(count) * binary / 8.0;
            let bytes = encoder.bytes() as f64;
            assert!(
                bytes < 1.04 * entropy + 50.0,
                "class {class}: {bytes} of {entropy}"
            );
        }
    }

    #[test]
    fn noise_is_refused_or_read_as_something() {
        let mut stream = Stream::new(&[9]);
        let mut noise = 10_000_u32.to_le_bytes().to_vec();
        put_bytes(
            &mut noise,
            &(0..400).map(|_| stream.bits() as u8).collect::<Vec<u8>>(),
        );
        let mut decoder = IntegerDecoder::new(&mut ByteReader(&noise)).unwrap();
        for k in 0..10_000 {
            let _ = decoder.take_magnitude(k % CLASSES);
        }
        let mut odd = 1_u32.to_le_bytes().to_vec();
        put_bytes(&mut odd, &[0; 5]);
        assert!(IntegerDecoder::new(&mut ByteReader(&odd)).is_err());
    }

    fn falling(shape: [usize; 3], seed: u64) -> Vec<i32> {
        let mut stream = Stream::new(&[seed]);
        let mut values = Vec::new();
        for i in 0..shape[0] {
            for j in 0..shape[1] {
                for k in 0..shape[2] {
                    let size = 3e5 * (-0.7 * (i + j) as f64 - 0.4 * k as f64).exp();
                    values.push((size * stream.between(-1.0, 1.0)).round() as i32);
                }
            }
        }
        values
    }

    #[test]
    fn tensors_come_back_in_order() {
        let shapes = [[9, 7, 12], [1, 1, 1], [3, 20, 2], [12, 12, 12]];
        let tensors: Vec<Vec<i32>> = (0..).zip(shapes).map(|(i, s)| falling(s, i)).collect();
        let mut encoder = IntegerEncoder::new();
        for (shape, tensor) in shapes.iter().zip(&tensors) {
            encoder.put(shape, tensor.len(), tensor);
        }
        let mut decoder = decoder(encoder);
        for (shape, tensor) in shapes.iter().zip(&tensors) {
            assert!(decoder.finish().is_err());
            assert_eq!(&decoder.take(shape, tensor.len()).unwrap(), tensor);
        }
        assert_eq!(decoder.finish(), Ok(()));
        assert!(decoder.take(&[1], 1).is_err());
    }

    #[test]
    fn neighbours_tell_how_large_coefficients_are() {
        let shape = [12, 12, 40];
        let tensor = falling(shape, 7);
        let mut ordered = IntegerEncoder::new();
        ordered.put(&shape, tensor.len(), &tensor);
        let mut shuffled = IntegerEncoder::new();
        let mut stream = Stream::new(&[3]);
        let mut order: Vec<(u64, i32)> = tensor.iter().map(|x| (stream.bits(), *x)).collect();
        order.sort_unstable();
        let order: Vec<i32> = order.iter().map(|(_, x)| *x).collect();
        shuffled.put(&shape, order.len(), &order);
        assert!(2 * ordered.bytes() < shuffled.bytes());
    }

    #[test]
    fn a_shorter_file_is_refused() {
        let shape = [9, 7, 12];
        let mut encoder = IntegerEncoder::new();
        encoder.put(&shape, 9 * 7 * 12, &falling(shape, 3));
        let mut out = Vec::new();
        encoder.finish(&mut out);
        for cut in 0..out.len() {
            assert!(IntegerDecoder::new(&mut ByteReader(&out[..cut])).is_err());
        }
    }
}
