//! Files of samples.
//!
//! In: paths and what the manifold says about them. Out: [`Samples`], or the key of the field's section that
//! is at fault. The kind of a file is told by the end of its name:
//!
//! | end | samples |
//! |---|---|
//! | `.npy`, `.npz` | an array of numpy (`numpy.lib.format`, versions 1 to 3) with axes x, y, z; in an archive that called `array` |
//! | `.vti` | an image of VTK: point data called `array`; places come from the file unless a box is given |
//! | `.exr` | slices of constant z, one a file or one a layer; columns are x, rows y; the channel `array` |
//! | other | numbers of one type ([`NumberType`]) without a head, in the `shape` and `order` given |

#[cfg(feature = "samples")]
mod images;
#[cfg(test)]
mod tests;

use super::{SampleFault, Samples, samples::checked_total};
use crate::{
    error::Error,
    reading::{MOST_OF_A_FILE, read_file},
};
use std::path::{Path, PathBuf};

/// Which file holds samples, and what is said about it.
#[derive(Debug, Clone, Default)]
pub struct SampleSource {
    /// The file, or the slices in the order of z.
    pub files: Vec<PathBuf>,
    /// The array in it.
    pub array: Option<String>,
    /// Numbers of samples along x, y, z, of a file without a head.
    pub shape: Option<[usize; 3]>,
    /// Their type.
    pub number: Option<NumberType>,
    /// Whether x runs fastest, or z, in a file without a head; `None` if nothing is said, which means z.
    pub x_fastest: Option<bool>,
    /// Whether the numbers' first bytes are the highest, in a file without a head; `None` if nothing is said, which means no.
    pub big_endian: Option<bool>,
}

type SampleReading<T> = Result<T, SampleFault>;

impl SampleSource {
    /// Reads the samples.
    ///
    /// # Errors
    /// The key that is at fault, and why.
    pub fn read(&self) -> SampleReading<Samples> {
        if let Some(placed) = self.files.first().and_then(|file| packed(file)) {
            return placed;
        }
        let [file] = self.files.as_slice() else {
            return self.read_slices();
        };
        let format = FieldFormat::of(file);
        if format != FieldFormat::Raw
            && let Some(key) = self.raw_key()
        {
            return Err(
                SampleFault::new(key, format!("`{key}` is for files without a head"))
                    .hint("take it away: this kind of file tells it"),
            );
        }
        match format {
            FieldFormat::Npy => {
                self.refuse_array("a .npy file holds one array")?;
                npy_array(&bytes(file)?)
            }
            FieldFormat::Raw => {
                self.refuse_array("a file without a head holds one array")?;
                self.raw(&bytes(file)?)
            }
            #[cfg(feature = "samples")]
            FieldFormat::Npz => npz_array(bytes(file)?, self.array.as_deref()),
            #[cfg(feature = "samples")]
            FieldFormat::Vti => images::vti(&bytes(file)?, self.array.as_deref()),
            #[cfg(feature = "samples")]
            FieldFormat::Exr => self.read_slices(),
            #[cfg(not(feature = "samples"))]
            FieldFormat::Npz | FieldFormat::Vti | FieldFormat::Exr => Err(SampleFault::new(
                "file",
                "this build of geofan reads samples from .npy files and files without a head only",
            )),
        }
    }

    #[cfg(feature = "samples")]
    fn read_slices(&self) -> SampleReading<Samples> {
        if let Some(other) = self
            .files
            .iter()
            .find(|file| FieldFormat::of(file) != FieldFormat::Exr)
        {
            return Err(
                SampleFault::new("file", format!("{} is no slice", other.display()))
                    .hint("a list names .exr files, one for each z"),
            );
        }
        let mut slices = Vec::new();
        for file in &self.files {
            slices.extend(
                images::layers(&bytes(file)?, self.array.as_deref()).map_err(|fault| {
                    SampleFault {
                        message: format!("{}: {}", file.display(), fault.message),
                        ..fault
                    }
                })?,
            );
        }
        images::stack(slices)
    }

    #[cfg(not(feature = "samples"))]
    fn read_slices(&self) -> SampleReading<Samples> {
        Err(SampleFault::new(
            "file",
            "this build of geofan reads no slices",
        ))
    }

    /// The first key that only files without a head need, if one is given.
    fn raw_key(&self) -> Option<&'static str> {
        let given = [
            ("shape", self.shape.is_some()),
            ("type", self.number.is_some()),
            ("order", self.x_fastest.is_some()),
            ("endian", self.big_endian.is_some()),
        ];
        given
            .into_iter()
            .find(|(_, given)| *given)
            .map(|(key, _)| key)
    }

    fn refuse_array(&self, why: &str) -> SampleReading<()> {
        match &self.array {
            None => Ok(()),
            Some(_) => Err(SampleFault::new("array", why).hint("take `array` away")),
        }
    }

    /// Numbers without a head.
    fn raw(&self, bytes: &[u8]) -> SampleReading<Samples> {
        let Some(shape) = self.shape else {
            let message =
                "a file without a head needs `shape`, the numbers of samples along x, y, z";
            return Err(SampleFault::new("file", message)
                .hint("files that tell it end in .npy, .npz, .vti or .exr"));
        };
        let number = self.number.unwrap_or(NumberType::F32);
        let total = total("shape", shape)?;
        let needed = total * number.width();
        if bytes.len() != needed {
            let [x, y, z] = shape;
            let message = format!(
                "{x} x {y} x {z} numbers of type {} take {needed} bytes, the file has {}",
                number.name(),
                bytes.len()
            );
            return Err(SampleFault::new("shape", message));
        }
        let values = number.numbers(bytes, self.big_endian.unwrap_or(false));
        Ok(match self.x_fastest.unwrap_or(false) {
            true => Samples::from_x_fastest(shape, &values),
            false => Samples::new(shape, values),
        })
    }
}

/// Begins a file of packed samples.
const PACKED: &[u8; 16] = b"geofan samples2\n";

/// Packs samples as [`SampleSource::read`] reads them in place of any file: the magic and [`Samples::pack`].
pub fn pack(samples: &Samples) -> Vec<u8> {
    [&PACKED[..], &samples.pack()].concat()
}

/// Reads packed samples; `None` if the file holds something else.
fn packed(file: &Path) -> Option<SampleReading<Samples>> {
    let bytes = read_file(file, PACKED, MOST_OF_A_FILE).ok()?;
    let samples = Samples::unpack(bytes.strip_prefix(PACKED)?);
    Some(samples.map_err(|e| SampleFault::new("file", e.to_string())))
}

/// The formats of files of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FieldFormat {
    Npy,
    Npz,
    Vti,
    Exr,
    Raw,
}

impl FieldFormat {
    /// Tells the format of a file by its name.
    fn of(file: &Path) -> Self {
        let end = file.extension().unwrap_or_default().to_string_lossy();
        match end.to_ascii_lowercase().as_str() {
            "npy" => Self::Npy,
            "npz" => Self::Npz,
            "vti" => Self::Vti,
            "exr" => Self::Exr,
            _ => Self::Raw,
        }
    }
}

/// The bytes of a file.
fn bytes(file: &Path) -> SampleReading<Vec<u8>> {
    read_file(file, &[], MOST_OF_A_FILE).map_err(|error| {
        let fault = SampleFault::new("file", format!("the samples cannot be read: {error}"));
        match error {
            Error::Input { .. } => fault.hint("paths are relative to the manifold's file"),
            _ => fault,
        }
    })
}

/// The number of samples in a grid of this `shape`.
fn total(key: &'static str, shape: [usize; 3]) -> SampleReading<usize> {
    checked_total(shape).ok_or_else(|| {
        let [x, y, z] = shape;
        let most = super::MOST_SAMPLES;
        SampleFault::new(
            key,
            format!("{x} x {y} x {z} samples; from 1 to {most} can be used"),
        )
    })
}

/// The complaint about an array that is not there, or not named.
#[cfg(feature = "samples")]
fn choose<'n>(asked: Option<&str>, names: &'n [String], things: &str) -> SampleReading<&'n String> {
    let all = names.join(", ");
    match (asked, names) {
        (_, []) => Err(SampleFault::new(
            "file",
            format!("the file has no {things}"),
        )),
        (None, [only]) => Ok(only),
        (None, _) => Err(
            SampleFault::new("file", format!("the file has several {things}: {all}"))
                .hint("name one: array = \"…\""),
        ),
        (Some(asked), names) => names.iter().find(|name| *name == asked).ok_or_else(|| {
            let fault = SampleFault::new(
                "array",
                format!("the file has no {things} called `{asked}`"),
            );
            fault.hint(format!("it has {all}"))
        }),
    }
}

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

/// Complains about a file that is no array of numpy.
fn not_npy(what: &str) -> SampleFault {
    SampleFault::new("file", format!("the file is no array of numpy: {what}"))
        .hint("write it by numpy.save or numpy.savez")
}

/// What the head of a `.npy` file says.
struct NpyHead {
    shape: [usize; 3],
    number: NumberType,
    big_endian: bool,
    x_fastest: bool,
    /// Bytes of all numbers.
    bytes: usize,
}

impl NpyHead {
    /// Reads the head, and returns what follows it.
    fn read(bytes: &[u8]) -> SampleReading<(Self, &[u8])> {
        let (head, data) = npy_parts(bytes)?;
        let value = |key: &str| npy_value(head, key).ok_or_else(|| not_npy(&format!("no `{key}`")));
        let shape = npy_shape(value("shape")?)?;
        let (number, big_endian) = npy_number_type(value("descr")?)?;
        let read = Self {
            shape,
            number,
            big_endian,
            x_fastest: value("fortran_order")?.starts_with("True"),
            bytes: total("file", shape)? * number.width(),
        };
        Ok((read, data))
    }
}

/// Reads a `.npy` file.
fn npy_array(bytes: &[u8]) -> SampleReading<Samples> {
    let (head, data) = NpyHead::read(bytes)?;
    if head.bytes != data.len() {
        return Err(not_npy("it has another length than its head says"));
    }
    let values = head.number.numbers(data, head.big_endian);
    Ok(match head.x_fastest {
        true => Samples::from_x_fastest(head.shape, &values),
        false => Samples::new(head.shape, values),
    })
}

/// The text of the head and the data.
fn npy_parts(bytes: &[u8]) -> SampleReading<(&str, &[u8])> {
    let rest = bytes
        .strip_prefix(b"\x93NUMPY")
        .ok_or_else(|| not_npy("its first bytes are others"))?;
    let (length, rest) = match rest {
        [1, _, a, b, rest @ ..] => (usize::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, rest),
        _ => return Err(not_npy("its version is unknown")),
    };
    let (head, data) = rest
        .split_at_checked(length)
        .ok_or_else(|| not_npy("it is cut off"))?;
    let head = str::from_utf8(head).map_err(|_| not_npy("its head is no text"))?;
    Ok((head, data))
}

/// The text of the value under `key` in the head, a literal of Python, to the head's end.
fn npy_value<'h>(head: &'h str, key: &str) -> Option<&'h str> {
    let quoted = ['\'', '"'].map(|q| format!("{q}{key}{q}"));
    let found = quoted
        .iter()
        .find_map(|quoted| head.split_once(quoted.as_str()))?;
    found.1.trim_start().strip_prefix(':').map(str::trim_start)
}

/// Reads the numbers of samples from the head.
fn npy_shape(text: &str) -> SampleReading<[usize; 3]> {
    let list = text.strip_prefix('(').and_then(|text| text.split_once(')'));
    let list = list.ok_or_else(|| not_npy("its shape is no tuple"))?.0;
    let numbers: Result<Vec<usize>, _> = list
        .split(',')
        .map(str::trim)
        .filter(|number| !number.is_empty())
        .map(str::parse)
        .collect();
    let numbers = numbers.map_err(|_| not_npy("its shape has no numbers"))?;
    let count = numbers.len();
    numbers.try_into().map_err(|numbers: Vec<usize>| {
        let message = format!("the array has {count} axes ({numbers:?}), a field has 3: x, y, z");
        SampleFault::new("file", message).hint("an axis on which nothing depends has 1 sample")
    })
}

/// Reads the type of the numbers, and whether their first bytes are the highest.
fn npy_number_type(descr: &str) -> SampleReading<(NumberType, bool)> {
    let name = descr.trim_start_matches(['\'', '"']);
    let name = name.split(['\'', '"']).next().unwrap_or_default();
    let (order, name) = name.split_at_checked(1).unwrap_or_default();
    let number = match name {
        "f4" => NumberType::F32,
        "f8" => NumberType::F64,
        "i1" => NumberType::I8,
        "u1" | "b1" => NumberType::U8,
        "i2" => NumberType::I16,
        "u2" => NumberType::U16,
        "i4" => NumberType::I32,
        "u4" => NumberType::U32,
        _ => {
            let message = format!("the array's numbers are of type `{order}{name}`");
            return Err(SampleFault::new("file", message).hint("save it as float32 or float64"));
        }
    };
    Ok((number, order == ">"))
}

/// Bytes in which the head of an array ends.
#[cfg(feature = "samples")]
const MOST_OF_A_HEAD: u64 = 1 << 16;

/// Reads an array of a `.npz` file.
#[cfg(feature = "samples")]
fn npz_array(bytes: Vec<u8>, asked: Option<&str>) -> SampleReading<Samples> {
    use std::io::{Cursor, Read};
    let damaged = |e: String| SampleFault::new("file", format!("is not an archive of numpy: {e}"));
    let archive = zip::ZipArchive::new(Cursor::new(bytes));
    let mut archive = archive.map_err(|e| damaged(e.to_string()))?;
    let name = |file: &str| file.strip_suffix(".npy").map(String::from);
    let names: Vec<String> = archive.file_names().filter_map(name).collect();
    let chosen = choose(asked, &names, "arrays")?;
    let file = archive.by_name(&format!("{chosen}.npy"));
    let mut file = file.map_err(|e| damaged(e.to_string()))?;
    let of_array = |fault: SampleFault| SampleFault {
        message: format!("array `{chosen}`: {}", fault.message),
        ..fault
    };
    let mut data = Vec::new();
    let mut more = |most: u64, data: &mut Vec<u8>| {
        let read = (&mut file).take(most).read_to_end(data);
        read.map_err(|e| damaged(e.to_string()))
    };
    more(MOST_OF_A_HEAD, &mut data)?;
    // No more is unpacked than the head asks for: zeros compress a thousandfold.
    let (head, begun) = NpyHead::read(&data).map_err(of_array)?;
    let rest = (head.bytes + 1).saturating_sub(begun.len());
    more(rest as u64, &mut data)?;
    npy_array(&data).map_err(of_array)
}
