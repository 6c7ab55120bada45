//! Integers of many tensors, coded together.
//!
//! In: tensors of rounded coefficients. Out: bytes, and back. Coefficients fall off along every
//! axis, so what stands around an integer ([`super::walk`]) tells how large it will be ([`super::sizes`]);
//! integers of one class are coded alike ([`super::adaptive`]). It tells something of their signs, too
//! ([`super::signs`]). All tensors of a chunk share what is learnt.
//!
//! Integers of a known class, coded in as many bits as they are unexpected.
//!
//! In: integers, each with its class. Out: words of a range coder (the crate `constriction`), and
//! back. Of an integer of size about `m` the last `k` bits are as good as random; how
//! often `2^k ≈ m/3` goes into it is told by a row of yes and no, one for each time it does, and how
//! likely yes is at each is learnt for each class while coding (J. Rissanen, G. G. Langdon,
//! *Arithmetic coding*, IBM J. Res. Dev. 23 (1979)). Signs come with a probability of their own
//! ([`super::signs`]). All arithmetic here is that of integers: every machine reads what any other wrote.

use crate::{
    context::{Signs, Sizes, Walk},
    decode::{DecodeError, Reader, Writer},
    householder::Taken,
};
use constriction::{
    UnwrapInfallible,
    stream::{
        Decode, Encode,
        model::{DecoderModel, EncoderModel, EntropyModel},
        queue::{DefaultRangeDecoder, DefaultRangeEncoder},
    },
};
use std::{borrow::Borrow, num::NonZeroU32};

/// The most integers of a chunk: far above any that a bake makes, and small enough that a hostile
/// file cannot exhaust the memory.
const MOST_INTEGERS: usize = 1 << 26;

/// Integers on their way into a chunk.
#[derive(Debug)]
pub struct Integers {
    coder: Coder,
    sizes: Sizes,
    signs: Signs,
    count: u32,
}

impl Integers {
    /// None yet.
    pub fn new() -> Self {
        Self {
            coder: Coder::new(),
            sizes: Sizes::default(),
            signs: Signs::default(),
            count: 0,
        }
    }

    /// Adds the numbers of a tensor in storage order: [reduced](super::reflections::reduced) vectors of
    /// this `length`.
    pub fn put(&mut self, shape: &[usize], length: usize, values: &[i32]) {
        let mut walk = Walk::new(shape);
        let mut taken = Taken::none(length);
        for (number, vector) in values.chunks_exact(length.max(1)).enumerate() {
            for (place, value) in vector.iter().enumerate() {
                let before = &values[..number * length + place];
                walk.on(before);
                if !taken.holds(place) {
                    walk.look(before);
                    self.put_one(&walk, *value);
                }
            }
            taken.behind(vector);
        }
        self.count += values.len() as u32;
    }

    /// Adds the integer at the present place.
    fn put_one(&mut self, walk: &Walk, value: i32) {
        let size = value.unsigned_abs();
        self.coder.put(self.sizes.class(walk), size);
        self.sizes.learn(walk, size);
        if value != 0 {
            self.coder
                .put_likely(self.signs.plus(walk, size), value > 0);
            self.signs.learn(walk, value > 0);
        }
    }

    /// How many bytes they take.
    pub fn bytes(&self) -> usize {
        self.coder.bytes()
    }

    /// Writes them.
    pub fn encode(self, out: &mut Writer) {
        out.u32(self.count);
        out.bytes(&self.coder.finish());
    }
}

/// Integers on their way out of a chunk.
#[derive(Debug)]
pub struct Coded {
    /// None where zeros are read instead.
    decoder: Option<Decoder>,
    sizes: Sizes,
    signs: Signs,
    left: usize,
}

impl Coded {
    /// Begins to read what [`Integers::encode`] wrote.
    ///
    /// # Errors
    /// It is damaged.
    pub fn decode(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let left = input.u32()? as usize;
        if left > MOST_INTEGERS {
            return Err(DecodeError("number of coefficients"));
        }
        Ok(Self {
            decoder: Some(Decoder::new(input.bytes()?)?),
            sizes: Sizes::default(),
            signs: Signs::default(),
            left,
        })
    }

    /// The same, but as many zeros are read: what they belong to is then known, some fifteen times sooner.
    ///
    /// # Errors
    /// It is damaged.
    pub fn zeros(input: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let coded = Self::decode(input)?;
        Ok(Self {
            decoder: None,
            ..coded
        })
    }

    /// Takes the numbers of the next tensor out, vectors of this `length`.
    ///
    /// # Errors
    /// There are fewer integers.
    pub fn take(&mut self, shape: &[usize], length: usize) -> Result<Vec<i32>, DecodeError> {
        let count = shape.iter().product();
        let left = self.left.checked_sub(count);
        self.left = left.ok_or(DecodeError("number of coefficients"))?;
        let Some(decoder) = &mut self.decoder else {
            return Ok(vec![0; count]);
        };
        let mut values = Vec::with_capacity(count);
        let mut walk = Walk::new(shape);
        let mut taken = Taken::none(length);
        for first in (0..count).step_by(length.max(1)) {
            for place in 0..length {
                walk.on(&values);
                values.push(match taken.holds(place) {
                    true => 0,
                    false => {
                        walk.look(&values);
                        take_one(decoder, (&mut self.sizes, &mut self.signs), &walk)?
                    }
                });
            }
            taken.behind(&values[first..]);
        }
        Ok(values)
    }

    /// That nothing is left.
    ///
    /// # Errors
    /// Something is.
    pub fn finish(&self) -> Result<(), DecodeError> {
        match self.left == 0 && self.decoder.as_ref().is_none_or(Decoder::is_done) {
            true => Ok(()),
            false => Err(DecodeError("end")),
        }
    }
}

/// The integer at the present place.
fn take_one(
    decoder: &mut Decoder,
    (sizes, signs): (&mut Sizes, &mut Signs),
    walk: &Walk,
) -> Result<i32, DecodeError> {
    let value = decoder.take(sizes.class(walk))?;
    let size = value.unsigned_abs();
    sizes.learn(walk, size);
    if value == 0 {
        return Ok(0);
    }
    let positive = decoder.take_likely(signs.plus(walk, size))?;
    signs.learn(walk, positive);
    Ok(if positive { value } else { -value })
}

/// Classes by the expected size: of integers with nothing around them, with zeros around them, and four for
/// each doubling from 1/5 up.
pub const CLASSES: usize = 130;

/// Bits of a probability.
const PRECISION: usize = 16;
const ONE: u32 = 1 << PRECISION;

/// The most answers that are learnt one by one; what is beyond is told by its number of bits.
const ANSWERS: usize = 15;

/// Probabilities stay this far from 0 and 1.
const LEAST: u32 = 64;

/// How many answers the first guess of a probability counts for, and after how many more it no longer
/// matters how many there were: later ones then count more. From 3 to 12, and from 120 to 600, bytes
/// are the same to 0.1 %.
const GUESSED: u8 = 6;
const FORGETS: u8 = 200;

/// The most bits that are coded at once, each as likely as not.
const RAW: u32 = 16;

/// How many bits of an integer of `class` are not worth learning about: what is left is 2.4 to 4.5 on
/// average.
fn dropped(class: usize) -> u32 {
    (class.saturating_sub(16) / 4) as u32
}

/// Whether the answer is yes.
#[derive(Debug, Clone, Copy)]
struct Answer {
    /// The probability of yes in units of 1/[`ONE`].
    yes: u32,
    seen: u8,
}

impl Answer {
    /// For integers of mean size `numerator / denominator` in units of what is asked for.
    fn expected(numerator: u64, denominator: u64) -> Self {
        let yes = u64::from(ONE) * numerator / (numerator + denominator);
        Self {
            yes: (yes as u32).clamp(LEAST, ONE - LEAST),
            seen: GUESSED,
        }
    }

    /// Of a probability that others learn.
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

    fn parts(self, yes: bool) -> (u32, NonZeroU32) {
        let (first, share) = if yes {
            (0, self.yes)
        } else {
            (self.yes, ONE - self.yes)
        };
        (first, NonZeroU32::new(share).unwrap_or(NonZeroU32::MIN))
    }
}

impl EntropyModel<PRECISION> for Answer {
    type Symbol = bool;
    type Probability = u32;
}

impl EncoderModel<PRECISION> for Answer {
    fn left_cumulative_and_probability(&self, yes: impl Borrow<bool>) -> Option<(u32, NonZeroU32)> {
        Some(self.parts(*yes.borrow()))
    }
}

impl DecoderModel<PRECISION> for Answer {
    fn quantile_function(&self, quantile: u32) -> (bool, u32, NonZeroU32) {
        let yes = quantile < self.yes;
        let (first, share) = self.parts(yes);
        (yes, first, share)
    }
}

/// So many bits, at most [`RAW`], all equally likely.
#[derive(Debug, Clone, Copy)]
struct Bits(u32);

impl Bits {
    fn share(self) -> NonZeroU32 {
        NonZeroU32::new(ONE >> self.0).unwrap_or(NonZeroU32::MIN)
    }
}

impl EntropyModel<PRECISION> for Bits {
    type Symbol = u32;
    type Probability = u32;
}

impl EncoderModel<PRECISION> for Bits {
    fn left_cumulative_and_probability(&self, bits: impl Borrow<u32>) -> Option<(u32, NonZeroU32)> {
        Some((*bits.borrow() * self.share().get(), self.share()))
    }
}

impl DecoderModel<PRECISION> for Bits {
    fn quantile_function(&self, quantile: u32) -> (u32, u32, NonZeroU32) {
        let bits = quantile / self.share();
        (bits, bits * self.share().get(), self.share())
    }
}

/// What is known of each class.
#[derive(Debug, Clone)]
struct Learnt(Vec<[Answer; ANSWERS]>);

impl Learnt {
    fn new() -> Self {
        let rows = (0..CLASSES).map(|class| {
            let answer = match class.checked_sub(2) {
                None => Answer::expected(1, 20),
                // The middle of the class, 0.2 · 2^((class − 1.5)/4), in units of 2^dropped.
                Some(quarters) => {
                    let middle = [218, 259, 308, 367][quarters % 4] << (quarters / 4);
                    Answer::expected(middle, 1000 << dropped(class))
                }
            };
            [answer; ANSWERS]
        });
        Self(rows.collect())
    }
}

/// Codes integers.
#[derive(Debug)]
pub struct Coder {
    words: DefaultRangeEncoder,
    learnt: Learnt,
}

impl Coder {
    /// Nothing yet.
    pub fn new() -> Self {
        Self {
            words: DefaultRangeEncoder::new(),
            learnt: Learnt::new(),
        }
    }

    /// Adds an integer of this `size` and `class`, but for its sign.
    pub fn put(&mut self, class: usize, size: u32) {
        let low = dropped(class);
        let times = size >> low;
        for (told, answer) in (0..).zip(&mut self.learnt.0[class]) {
            let yes = times > told;
            // The coder cannot fail: its words are kept in memory, and every answer is possible.
            let _ = self.words.encode_symbol(yes, *answer);
            answer.learn(yes);
            if !yes {
                break;
            }
        }
        if let Some(beyond) = times.checked_sub(ANSWERS as u32) {
            self.put_beyond(beyond + 1);
        }
        self.put_raw(low, size);
    }

    /// Adds a yes or no, where yes has the probability `likely`.
    pub fn put_likely(&mut self, likely: f64, yes: bool) {
        let _ = self.words.encode_symbol(yes, Answer::known(likely));
    }

    /// A number from 1 up: how many bits it has, and those (P. Elias, *Universal codeword sets and
    /// representations of the integers*, IEEE Trans. Inf. Theory 21 (1975)).
    fn put_beyond(&mut self, number: u32) {
        let bits = number.ilog2();
        self.put_raw(5, bits);
        self.put_raw(bits, number);
    }

    /// The last so many bits of `value`.
    fn put_raw(&mut self, bits: u32, value: u32) {
        let mut left = bits;
        while left > 0 {
            let some = left.min(RAW);
            left -= some;
            let part = (value >> left) & ((1 << some) - 1);
            let _ = self.words.encode_symbol(part, Bits(some));
        }
    }

    /// How many bytes there are so far.
    pub fn bytes(&self) -> usize {
        4 * self.words.num_words()
    }

    /// The words.
    pub fn finish(self) -> Vec<u8> {
        let words = self.words.into_compressed().unwrap_infallible();
        words.iter().flat_map(|word| word.to_le_bytes()).collect()
    }
}

/// Reads what a [`Coder`] wrote.
#[derive(Debug)]
pub struct Decoder {
    words: DefaultRangeDecoder,
    learnt: Learnt,
}

impl Decoder {
    /// From the bytes of [`Coder::finish`].
    ///
    /// # Errors
    /// They are not whole words.
    pub fn new(bytes: &[u8]) -> Result<Self, DecodeError> {
        let (words, rest) = bytes.as_chunks::<4>();
        if !rest.is_empty() {
            return Err(DecodeError("words of coefficients"));
        }
        let words: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
        Ok(Self {
            words: DefaultRangeDecoder::from_compressed(words).unwrap_infallible(),
            learnt: Learnt::new(),
        })
    }

    /// The size of the next integer, of `class`.
    ///
    /// # Errors
    /// No coder wrote this.
    pub fn take(&mut self, class: usize) -> Result<i32, DecodeError> {
        let mut times = 0;
        for answer in &mut self.learnt.0[class] {
            let yes = self.words.decode_symbol(*answer).map_err(|_| DAMAGE)?;
            answer.learn(yes);
            if !yes {
                break;
            }
            times += 1;
        }
        if times == ANSWERS as u32 {
            times = times.checked_add(self.take_beyond()? - 1).ok_or(DAMAGE)?;
        }
        let low = dropped(class);
        let high = times.checked_mul(1 << low).ok_or(DAMAGE)?;
        let size = high | self.take_raw(low)?;
        i32::try_from(size).map_err(|_| DAMAGE)
    }

    /// A yes or no, where yes has the probability `likely`.
    ///
    /// # Errors
    /// No coder wrote this.
    pub fn take_likely(&mut self, likely: f64) -> Result<bool, DecodeError> {
        let answer = Answer::known(likely);
        self.words.decode_symbol(answer).map_err(|_| DAMAGE)
    }

    fn take_beyond(&mut self) -> Result<u32, DecodeError> {
        let bits = self.take_raw(5)?;
        Ok((1 << bits) | self.take_raw(bits)?)
    }

    fn take_raw(&mut self, bits: u32) -> Result<u32, DecodeError> {
        let (mut left, mut value) = (bits, 0);
        while left > 0 {
            let some = left.min(RAW);
            left -= some;
            let part = self.words.decode_symbol(Bits(some)).map_err(|_| DAMAGE)?;
            value = (value << some) | part;
        }
        Ok(value)
    }

    /// Whether everything may have been read.
    pub fn is_done(&self) -> bool {
        self.words.maybe_exhausted()
    }
}

const DAMAGE: DecodeError = DecodeError("coefficients");

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::random::Stream;

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
        let mut integers = Integers::new();
        for (shape, tensor) in shapes.iter().zip(&tensors) {
            integers.put(shape, tensor.len(), tensor);
        }
        let mut out = Writer::default();
        integers.encode(&mut out);
        let mut coded = Coded::decode(&mut Reader(&out.0)).unwrap();
        for (shape, tensor) in shapes.iter().zip(&tensors) {
            assert!(coded.finish().is_err());
            assert_eq!(&coded.take(shape, tensor.len()).unwrap(), tensor);
        }
        assert_eq!(coded.finish(), Ok(()));
        assert!(coded.take(&[1], 1).is_err());
    }

    #[test]
    fn neighbours_tell_how_large_coefficients_are() {
        let shape = [12, 12, 40];
        let tensor = falling(shape, 7);
        let mut integers = Integers::new();
        integers.put(&shape, tensor.len(), &tensor);
        let mut shuffled = Integers::new();
        let mut stream = Stream::new(&[3]);
        let mut order: Vec<(u64, i32)> = tensor.iter().map(|x| (stream.bits(), *x)).collect();
        order.sort_unstable();
        let order: Vec<i32> = order.iter().map(|(_, x)| *x).collect();
        shuffled.put(&shape, order.len(), &order);
        assert!(2 * integers.bytes() < shuffled.bytes());
    }

    #[test]
    fn a_shorter_file_is_refused() {
        let shape = [9, 7, 12];
        let mut integers = Integers::new();
        integers.put(&shape, 9 * 7 * 12, &falling(shape, 3));
        let mut out = Writer::default();
        integers.encode(&mut out);
        for cut in 0..out.0.len() {
            assert!(Coded::decode(&mut Reader(&out.0[..cut])).is_err());
        }
    }
}

#[cfg(test)]
mod adaptive_tests {
    use super::*;
    use geofan_core::random::Stream;

    #[test]
    fn every_integer_comes_back_in_every_class() {
        let extremes = [0, 1, 2, 14, 15, 16, 17, 1000, 1 << 20, 1 << 30, i32::MAX];
        let mut coder = Coder::new();
        for class in 0..CLASSES {
            for size in extremes {
                coder.put(class, size as u32);
                coder.put_likely(0.1, size % 2 == 0);
            }
        }
        let mut decoder = Decoder::new(&coder.finish()).unwrap();
        for class in 0..CLASSES {
            for size in extremes {
                assert_eq!(decoder.take(class), Ok(size), "class {class}");
                assert_eq!(decoder.take_likely(0.1), Ok(size % 2 == 0));
            }
        }
        assert!(decoder.is_done());
    }

    /// Sizes of a geometric distribution take hardly more than their entropy.
    #[test]
    fn expected_integers_take_their_entropy() {
        for (size, yes) in [(1_i32, 0.05_f64), (6, 0.5), (10, 0.8), (24, 0.998)] {
            let class = 2 + 2 * (size - 2).max(0) as usize;
            let mut stream = Stream::new(&[class as u64]);
            let mut coder = Coder::new();
            let count = 20_000;
            for _ in 0..count {
                let size = (stream.uniform().ln() / yes.ln()) as i32;
                coder.put(class, size as u32);
            }
            let binary = -(yes * yes.log2() + (1.0 - yes) * (1.0 - yes).log2()) / (1.0 - yes);
            let entropy = f64::from(count) * binary / 8.0;
            let bytes = coder.bytes() as f64;
            assert!(
                bytes < 1.04 * entropy + 50.0,
                "class {class}: {bytes} of {entropy}"
            );
        }
    }

    #[test]
    fn noise_is_refused_or_read_as_something() {
        let mut stream = Stream::new(&[9]);
        let noise: Vec<u8> = (0..400).map(|_| stream.bits() as u8).collect();
        let mut decoder = Decoder::new(&noise).unwrap();
        for k in 0..10_000 {
            let _ = decoder.take(k % CLASSES);
        }
        assert!(Decoder::new(&noise[..5]).is_err());
    }
}
