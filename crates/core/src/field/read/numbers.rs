//! Numbers as files keep them.

/// The type of the numbers of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum NumberType {
    F32,
    F64,
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
}

/// All types with their names.
const NAMES: [(NumberType, &str); 8] = [
    (NumberType::F32, "f32"),
    (NumberType::F64, "f64"),
    (NumberType::I8, "i8"),
    (NumberType::U8, "u8"),
    (NumberType::I16, "i16"),
    (NumberType::U16, "u16"),
    (NumberType::I32, "i32"),
    (NumberType::U32, "u32"),
];

impl NumberType {
    /// Finds the type called `name`.
    pub fn named(name: &str) -> Option<Self> {
        NAMES.iter().find(|(_, n)| *n == name).map(|(t, _)| *t)
    }

    /// Returns its name.
    pub fn name(self) -> &'static str {
        NAMES
            .iter()
            .find(|(t, _)| *t == self)
            .map_or("", |(_, n)| *n)
    }

    /// Lists the names of all types.
    pub fn names() -> Vec<&'static str> {
        NAMES.iter().map(|(_, name)| *name).collect()
    }

    /// Returns the bytes that a number takes.
    pub fn width(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::F32 | Self::I32 | Self::U32 => 4,
            Self::F64 => 8,
        }
    }

    /// Reads numbers; bytes that do not make up a whole one are left out.
    pub fn numbers(self, bytes: &[u8], big_endian: bool) -> Vec<f64> {
        match self {
            Self::F32 => read(bytes, big_endian, |b| f64::from(f32::from_le_bytes(b))),
            Self::F64 => read(bytes, big_endian, f64::from_le_bytes),
            Self::I8 => read(bytes, big_endian, |b| f64::from(i8::from_le_bytes(b))),
            Self::U8 => read(bytes, big_endian, |b| f64::from(u8::from_le_bytes(b))),
            Self::I16 => read(bytes, big_endian, |b| f64::from(i16::from_le_bytes(b))),
            Self::U16 => read(bytes, big_endian, |b| f64::from(u16::from_le_bytes(b))),
            Self::I32 => read(bytes, big_endian, |b| f64::from(i32::from_le_bytes(b))),
            Self::U32 => read(bytes, big_endian, |b| f64::from(u32::from_le_bytes(b))),
        }
    }
}

/// Numbers of `N` bytes each.
fn read<const N: usize>(
    bytes: &[u8],
    big_endian: bool,
    number: impl Fn([u8; N]) -> f64,
) -> Vec<f64> {
    let (whole, _) = bytes.as_chunks::<N>();
    let one = |bytes: &[u8; N]| {
        let mut bytes = *bytes;
        if big_endian {
            bytes.reverse();
        }
        number(bytes)
    };
    whole.iter().map(one).collect()
}
