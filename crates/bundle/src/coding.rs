//! Integers of many tensors, coded together.
//!
//! In: tensors of rounded coefficients. Out: bytes, and back. Coefficients fall off along every
//! axis, so what stands around an integer ([`super::walk`]) tells how large it will be ([`super::sizes`]);
//! integers of one class are coded alike ([`super::adaptive`]). It tells something of their signs, too
//! ([`super::signs`]). All tensors of a chunk share what is learnt.

use super::{
    adaptive::{Coder, Decoder},
    bytes::{DecodeError, Reader, Writer},
    reflections::Taken,
    signs::Signs,
    sizes::Sizes,
    walk::Walk,
};

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
