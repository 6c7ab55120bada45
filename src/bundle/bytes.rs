//! Little-endian writing and checked reading of the payloads of blocks.

/// What in a payload does not make sense.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("damaged {0}")]
pub struct Damage(pub &'static str);

/// Appends little-endian numbers.
#[derive(Debug, Default)]
pub struct Writer(pub Vec<u8>);

impl Writer {
    /// One byte.
    pub fn u8(&mut self, x: u8) {
        self.0.push(x);
    }

    /// A 64-bit float.
    pub fn f64(&mut self, x: f64) {
        self.0.extend(x.to_le_bytes());
    }

    /// A length and the bytes.
    pub fn bytes(&mut self, x: &[u8]) {
        self.0.extend((x.len() as u32).to_le_bytes());
        self.0.extend(x);
    }
}

/// Reads what [`Writer`] wrote; every read is checked.
#[derive(Debug)]
pub struct Reader<'a>(pub &'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], Damage> {
        let (head, tail) = self.0.split_at_checked(n).ok_or(Damage("length"))?;
        self.0 = tail;
        Ok(head)
    }

    /// One byte.
    pub fn u8(&mut self) -> Result<u8, Damage> {
        Ok(self.take(1)?[0])
    }

    /// A 64-bit float.
    pub fn f64(&mut self) -> Result<f64, Damage> {
        let bytes = self.take(8)?;
        Ok(f64::from_le_bytes(
            bytes.try_into().map_err(|_| Damage("number"))?,
        ))
    }

    /// A length and the bytes.
    pub fn bytes(&mut self) -> Result<&'a [u8], Damage> {
        let length = self.take(4)?;
        let length = u32::from_le_bytes(length.try_into().map_err(|_| Damage("length"))?);
        self.take(length as usize)
    }

    /// That nothing is left.
    pub fn finish(&self) -> Result<(), Damage> {
        match self.0.is_empty() {
            true => Ok(()),
            false => Err(Damage("end")),
        }
    }
}
