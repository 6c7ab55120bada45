//! Arrays of numpy: `.npy`, and archives of them, `.npz`.
//!
//! Format: numpy's `numpy.lib.format`, versions 1 to 3.

use super::{NumberType, SampleReading, total};
use crate::field::{SampleFault, Samples};

fn damaged(what: &str) -> SampleFault {
    SampleFault::new("file", format!("the file is no array of numpy: {what}"))
        .hint("write it by numpy.save or numpy.savez")
}

/// Reads a `.npy` file.
pub fn array(bytes: &[u8]) -> SampleReading<Samples> {
    let (head, data) = split(bytes)?;
    let value = |key: &str| value(head, key).ok_or_else(|| damaged(&format!("no `{key}`")));
    let descr = value("descr")?;
    let fortran = value("fortran_order")?.starts_with("True");
    let shape = shape(value("shape")?)?;
    let (number, big_endian) = number_type(descr)?;
    let needed = total("file", shape)?.checked_mul(number.width());
    if needed != Some(data.len()) {
        return Err(damaged("it has another length than its head says"));
    }
    let values = number.numbers(data, big_endian);
    Ok(match fortran {
        true => Samples::from_x_fastest(shape, &values),
        false => Samples { shape, values },
    })
}

/// The head and the data.
fn split(bytes: &[u8]) -> SampleReading<(&str, &[u8])> {
    let rest = bytes
        .strip_prefix(b"\x93NUMPY")
        .ok_or_else(|| damaged("its first bytes are others"))?;
    let (length, rest) = match rest {
        [1, _, a, b, rest @ ..] => (usize::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, rest),
        _ => return Err(damaged("its version is unknown")),
    };
    let (head, data) = rest
        .split_at_checked(length)
        .ok_or_else(|| damaged("it is cut off"))?;
    let head = str::from_utf8(head).map_err(|_| damaged("its head is no text"))?;
    Ok((head, data))
}

/// The text of the value under `key` in the head, a literal of Python, to the head's end.
fn value<'h>(head: &'h str, key: &str) -> Option<&'h str> {
    let quoted = ['\'', '"'].map(|q| format!("{q}{key}{q}"));
    let found = quoted
        .iter()
        .find_map(|quoted| head.split_once(quoted.as_str()))?;
    found.1.trim_start().strip_prefix(':').map(str::trim_start)
}

fn shape(text: &str) -> SampleReading<[usize; 3]> {
    let list = text.strip_prefix('(').and_then(|text| text.split_once(')'));
    let list = list.ok_or_else(|| damaged("its shape is no tuple"))?.0;
    let numbers: Result<Vec<usize>, _> = list
        .split(',')
        .map(str::trim)
        .filter(|number| !number.is_empty())
        .map(str::parse)
        .collect();
    let numbers = numbers.map_err(|_| damaged("its shape has no numbers"))?;
    let count = numbers.len();
    numbers.try_into().map_err(|numbers: Vec<usize>| {
        let message = format!("the array has {count} axes ({numbers:?}), a field has 3: x, y, z");
        SampleFault::new("file", message).hint("an axis on which nothing depends has 1 sample")
    })
}

fn number_type(descr: &str) -> SampleReading<(NumberType, bool)> {
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

/// Reads an array of a `.npz` file.
#[cfg(feature = "samples")]
pub fn archive(bytes: Vec<u8>, asked: Option<&str>) -> SampleReading<Samples> {
    use crate::reading::MOST_OF_A_FILE;
    use std::io::{Cursor, Read};
    let damaged = |e: String| SampleFault::new("file", format!("is not an archive of numpy: {e}"));
    let archive = zip::ZipArchive::new(Cursor::new(bytes));
    let mut archive = archive.map_err(|e| damaged(e.to_string()))?;
    let name = |file: &str| file.strip_suffix(".npy").map(String::from);
    let names: Vec<String> = archive.file_names().filter_map(name).collect();
    let chosen = super::choose(asked, &names, "arrays")?;
    let file = archive.by_name(&format!("{chosen}.npy"));
    let file = file.map_err(|e| damaged(e.to_string()))?;
    let mut data = Vec::new();
    let read = file.take(MOST_OF_A_FILE).read_to_end(&mut data);
    read.map_err(|e| damaged(e.to_string()))?;
    array(&data).map_err(|fault| SampleFault {
        message: format!("array `{chosen}`: {}", fault.message),
        ..fault
    })
}
