//! Little-endian writing and checked reading of the payloads of blocks.

/// What in a payload does not make sense.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("damaged {0}")]
pub struct DecodeError(pub &'static str);

/// Appends little-endian numbers.
#[derive(Debug, Default)]
pub struct Writer(pub Vec<u8>);

impl Writer {
    /// One byte.
    pub fn u8(&mut self, x: u8) {
        self.0.push(x);
    }

    /// A 16-bit integer.
    pub fn i16(&mut self, x: i16) {
        self.0.extend(x.to_le_bytes());
    }

    /// A 32-bit integer.
    pub fn u32(&mut self, x: u32) {
        self.0.extend(x.to_le_bytes());
    }

    /// A length and the bytes.
    pub fn bytes(&mut self, x: &[u8]) {
        self.u32(x.len() as u32);
        self.0.extend(x);
    }
}

/// Reads what [`Writer`] wrote; every read is checked.
#[derive(Debug)]
pub struct Reader<'a>(pub &'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], DecodeError> {
        let (head, tail) = self.0.split_at_checked(n).ok_or(DecodeError("length"))?;
        self.0 = tail;
        Ok(head)
    }

    /// One byte.
    pub fn u8(&mut self) -> Result<u8, DecodeError> {
        Ok(self.take(1)?[0])
    }

    /// A 16-bit integer.
    pub fn i16(&mut self) -> Result<i16, DecodeError> {
        let bytes = self.take(2)?;
        Ok(i16::from_le_bytes(
            bytes.try_into().map_err(|_| DecodeError("number"))?,
        ))
    }

    /// A 32-bit integer.
    pub fn u32(&mut self) -> Result<u32, DecodeError> {
        let bytes = self.take(4)?;
        Ok(u32::from_le_bytes(
            bytes.try_into().map_err(|_| DecodeError("number"))?,
        ))
    }

    /// A length and the bytes.
    pub fn bytes(&mut self) -> Result<&'a [u8], DecodeError> {
        let length = self.u32()?;
        self.take(length as usize)
    }

    /// That nothing is left.
    pub fn finish(&self) -> Result<(), DecodeError> {
        match self.0.is_empty() {
            true => Ok(()),
            false => Err(DecodeError("end")),
        }
    }
}
