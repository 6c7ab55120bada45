//! Samples from images: of VTK (`.vti`), and slices of constant z in OpenEXR files.
//!
//! An image of VTK is one piece, point data of one component; plain text, base64 or raw bytes, as they are
//! or compressed by zlib. Format: *VTK File Formats*, "XML file formats", `ImageData`. Only what stands before the appended
//! data is XML.
//!
//! Of a slice columns are x, rows y, the first row the first y.

use super::{NumberType, SampleReading, choose, total};
use crate::field::{SampleFault, Samples};
use base64::{
    Engine,
    alphabet::STANDARD,
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig},
};
use exr::prelude::{MetaData, ReadChannels, ReadLayers, read};
use flate2::read::ZlibDecoder;
use std::io::{Cursor, Read};

fn not_vti(what: impl std::fmt::Display) -> SampleFault {
    SampleFault::new(
        "file",
        format!("is not an image of VTK that can be read: {what}"),
    )
}

/// A tag of the XML part.
struct Tag<'f> {
    name: &'f str,
    attributes: &'f str,
    /// Where the text behind it begins.
    end: usize,
}

impl<'f> Tag<'f> {
    fn get(&self, key: &str) -> Option<&'f str> {
        let mut rest = self.attributes;
        loop {
            let (before, after) = rest.split_once('=')?;
            let after = after.trim_start();
            let quote = after.chars().next().filter(|c| ['"', '\''].contains(c))?;
            let (value, after) = after[1..].split_once(quote)?;
            if before.trim() == key {
                return Some(value);
            }
            rest = after;
        }
    }

    fn numbers<T: std::str::FromStr, const N: usize>(&self, key: &str) -> SampleReading<[T; N]> {
        let text = self.get(key).unwrap_or_default();
        let numbers = text
            .split_whitespace()
            .map(str::parse)
            .collect::<Result<Vec<T>, _>>();
        let numbers = numbers.ok().and_then(|numbers| numbers.try_into().ok());
        numbers.ok_or_else(|| not_vti(format!("`{key}` of {} has not {N} numbers", self.name)))
    }
}

/// All tags up to the appended data.
fn tags(bytes: &[u8]) -> Vec<Tag<'_>> {
    let mut found = Vec::new();
    let mut at = 0;
    while let Some(start) = bytes[at..].iter().position(|b| *b == b'<') {
        let start = at + start + 1;
        let Some(length) = bytes[start..].iter().position(|b| *b == b'>') else {
            break;
        };
        let end = start + length + 1;
        at = end;
        let Ok(text) = str::from_utf8(&bytes[start..end - 1]) else {
            continue;
        };
        let text = text.trim_end_matches('/');
        let (name, attributes) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
        found.push(Tag {
            name,
            attributes,
            end,
        });
        if name == "AppendedData" {
            break;
        }
    }
    found
}

/// The way in which a file keeps its numbers.
struct Storage<'f> {
    bytes: &'f [u8],
    big_endian: bool,
    /// Bytes of a length.
    length: usize,
    compressed: bool,
    appended: Option<(usize, bool)>,
}

/// Reads the array `asked`, and where the image is.
pub fn vti(bytes: &[u8], asked: Option<&str>) -> SampleReading<Samples> {
    let tags = tags(bytes);
    let tag = |name: &str| {
        let found = tags.iter().find(|tag| tag.name == name);
        found.ok_or_else(|| not_vti(format!("it has no {name}")))
    };
    let (file, image) = (tag("VTKFile")?, tag("ImageData")?);
    // The grid.
    let extent = image.numbers::<i64, 6>("WholeExtent")?;
    check_piece(&tags, extent)?;
    let span = |k: usize| extent[2 * k + 1].saturating_sub(extent[2 * k]);
    let shape = [0, 1, 2].map(|k| usize::try_from(span(k).saturating_add(1)).unwrap_or(0));
    let count = total("file", shape)?;
    let limits = limits(image, extent)?;
    // The array.
    let position = |name: &str| tags.iter().position(|tag| tag.name == name);
    let first = position("PointData").ok_or_else(|| not_vti("it has no point data"))?;
    let last = position("/PointData").unwrap_or(tags.len()).max(first);
    let arrays: Vec<&Tag<'_>> = tags[first..last]
        .iter()
        .filter(|t| t.name == "DataArray")
        .collect();
    let name = |tag: &&Tag<'_>| tag.get("Name").unwrap_or_default().to_string();
    let names: Vec<String> = arrays.iter().map(name).collect();
    let chosen = choose(asked, &names, "arrays of points")?;
    let array = arrays.iter().zip(&names).find(|(_, name)| *name == chosen);
    let array = array
        .map(|(tag, _)| *tag)
        .ok_or_else(|| not_vti("its arrays"))?;
    let components = array.get("NumberOfComponents").unwrap_or("1");
    if components.trim() != "1" {
        let message = format!("array `{chosen}` has {components} components, a field has 1");
        return Err(SampleFault::new("array", message));
    }
    let storage = Storage::of(bytes, file, &tags)?;
    let values = storage.values(array, count)?;
    Ok(Samples {
        limits: Some(limits),
        ..Samples::from_x_fastest(shape, &values)
    })
}

/// Checks that the image is one piece.
fn check_piece(tags: &[Tag<'_>], extent: [i64; 6]) -> SampleReading<()> {
    let pieces: Vec<&Tag<'_>> = tags.iter().filter(|tag| tag.name == "Piece").collect();
    let piece = match pieces[..] {
        [piece] => piece,
        [] => return Err(not_vti("it has no Piece")),
        _ => return Err(not_vti("it has several pieces")),
    };
    let own: [i64; 6] = piece.numbers("Extent")?;
    match own == extent {
        true => Ok(()),
        false => Err(not_vti(format!(
            "its piece has the extent {own:?}, a part of the whole extent {extent:?}"
        ))),
    }
}

/// Places of the first and the last samples.
fn limits(image: &Tag<'_>, extent: [i64; 6]) -> SampleReading<[[f64; 2]; 3]> {
    if let Some(direction) = image.get("Direction") {
        let entries: Vec<f64> = direction
            .split_whitespace()
            .filter_map(|x| x.parse().ok())
            .collect();
        if entries != [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0] {
            return Err(not_vti("its `Direction` is not along the axes"));
        }
    }
    let or = |key: &str, default: [f64; 3]| match image.get(key) {
        Some(_) => image.numbers::<f64, 3>(key),
        None => Ok(default),
    };
    let (origin, spacing) = (or("Origin", [0.0; 3])?, or("Spacing", [1.0; 3])?);
    Ok([0, 1, 2]
        .map(|k| [extent[2 * k], extent[2 * k + 1]].map(|i| origin[k] + spacing[k] * i as f64)))
}

impl<'f> Storage<'f> {
    fn of(bytes: &'f [u8], file: &Tag<'_>, tags: &[Tag<'_>]) -> SampleReading<Self> {
        let compressed = match file.get("compressor") {
            None | Some("") => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => {
                let fault = not_vti(format!("it is compressed by {other}"));
                return Err(fault.hint("save it with zlib, or without compression"));
            }
        };
        let appended = tags
            .iter()
            .find(|tag| tag.name == "AppendedData")
            .and_then(|tag| {
                let start = bytes[tag.end..].iter().position(|b| *b == b'_')?;
                Some((tag.end + start + 1, tag.get("encoding") == Some("base64")))
            });
        Ok(Self {
            bytes,
            big_endian: file.get("byte_order") == Some("BigEndian"),
            length: if file.get("header_type") == Some("UInt64") {
                8
            } else {
                4
            },
            compressed,
            appended,
        })
    }

    fn values(&self, array: &Tag<'_>, count: usize) -> SampleReading<Vec<f64>> {
        let number = match array.get("type").unwrap_or_default() {
            "Float32" => NumberType::F32,
            "Float64" => NumberType::F64,
            "Int8" => NumberType::I8,
            "UInt8" => NumberType::U8,
            "Int16" => NumberType::I16,
            "UInt16" => NumberType::U16,
            "Int32" => NumberType::I32,
            "UInt32" => NumberType::U32,
            other => return Err(not_vti(format!("its numbers are of type {other}"))),
        };
        let inline = || {
            let rest = &self.bytes[array.end..];
            let end = rest.iter().position(|b| *b == b'<').unwrap_or(rest.len());
            &rest[..end]
        };
        let most = count * number.width();
        let data = match (array.get("format").unwrap_or("ascii"), self.appended) {
            ("ascii", _) => return ascii(inline(), count),
            ("binary", _) => self.unwrapped(&from_base64(inline())?, most)?,
            ("appended", Some((start, base64))) => {
                let [offset] = array.numbers::<usize, 1>("offset")?;
                let rest = start
                    .checked_add(offset)
                    .and_then(|at| self.bytes.get(at..));
                let rest = rest.ok_or_else(|| not_vti("its data are cut off"))?;
                match base64 {
                    false => self.unwrapped(rest, most)?,
                    true => {
                        let end = rest
                            .iter()
                            .position(|b| !is_base64(*b))
                            .unwrap_or(rest.len());
                        self.unwrapped(&from_base64(&rest[..end])?, most)?
                    }
                }
            }
            (other, _) => return Err(not_vti(format!("its data are in the format {other}"))),
        };
        match data.len() == most {
            true => Ok(number.numbers(&data, self.big_endian)),
            false => Err(not_vti(format!(
                "{} bytes of numbers in place of {most}",
                data.len()
            ))),
        }
    }

    /// Numbers behind their lengths.
    fn unwrapped(&self, data: &[u8], most: usize) -> SampleReading<Vec<u8>> {
        let cut = || not_vti("its data are cut off");
        let length = |k: usize| {
            let bytes = data
                .get(k * self.length..(k + 1) * self.length)
                .ok_or_else(cut)?;
            let byte = |sum: usize, b: &u8| sum << 8 | usize::from(*b);
            Ok(match self.big_endian {
                true => bytes.iter().fold(0, byte),
                false => bytes.iter().rev().fold(0, byte),
            })
        };
        if !self.compressed {
            let count = length(0)?.min(most + 1);
            let data = data.get(self.length..self.length + count).ok_or_else(cut)?;
            return Ok(data.to_vec());
        }
        let blocks = length(0)?;
        if blocks > data.len() / self.length {
            return Err(cut());
        }
        let mut at = (3 + blocks) * self.length;
        let mut out = Vec::new();
        for block in 0..blocks {
            let size = length(3 + block)?;
            let end = at.checked_add(size).ok_or_else(cut)?;
            let stream = data.get(at..end).ok_or_else(cut)?;
            let room = (most + 1).saturating_sub(out.len()) as u64;
            ZlibDecoder::new(stream)
                .take(room)
                .read_to_end(&mut out)
                .map_err(not_vti)?;
            at = end;
        }
        Ok(out)
    }
}

fn ascii(text: &[u8], count: usize) -> SampleReading<Vec<f64>> {
    let text = str::from_utf8(text).map_err(not_vti)?;
    let numbers = text.split_whitespace().map(|word| {
        let number = word.parse::<f64>();
        number.map_err(|_| not_vti(format!("`{word}` is not a number")))
    });
    let numbers: Vec<f64> = numbers.collect::<SampleReading<_>>()?;
    match numbers.len() == count {
        true => Ok(numbers),
        false => Err(not_vti(format!(
            "{} numbers in place of {count}",
            numbers.len()
        ))),
    }
}

fn is_base64(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || b"+/= \n\r\t".contains(&byte)
}

/// Decodes base64 in which paddings stand wherever a part ended: lengths are encoded apart from what follows.
fn from_base64(text: &[u8]) -> SampleReading<Vec<u8>> {
    let config =
        GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
    let engine = GeneralPurpose::new(&STANDARD, config);
    let text: Vec<u8> = text
        .iter()
        .copied()
        .filter(|b| !b.is_ascii_whitespace())
        .collect();
    let mut out = Vec::new();
    let (quads, rest) = text.as_chunks::<4>();
    if !rest.is_empty() {
        return Err(not_vti("its base64 is cut off"));
    }
    for quad in quads {
        out.extend(engine.decode(quad).map_err(not_vti)?);
    }
    Ok(out)
}

/// One slice: width, height, and its numbers row by row.
pub type Slice = ([usize; 2], Vec<f64>);

fn not_slices(what: impl std::fmt::Display) -> SampleFault {
    SampleFault::new("file", format!("is not an OpenEXR file of slices: {what}"))
}

/// Reads the channel `asked` of every layer, in the order of the file.
pub fn layers(bytes: &[u8], asked: Option<&str>) -> SampleReading<Vec<Slice>> {
    let heads = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(not_slices)?;
    for head in &heads.headers {
        let (width, height) = (head.layer_size.width(), head.layer_size.height());
        total("file", [width, height, heads.headers.len()])?;
        total("file", [width, height, head.channels.list.len().max(1)])?;
    }
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(not_slices)?;
    let mut slices = Vec::new();
    for layer in image.layer_data {
        let channels = layer.channel_data.list;
        let names: Vec<String> = channels.iter().map(|c| c.name.to_string()).collect();
        let chosen = choose(asked, &names, "channels")?;
        let channel = channels
            .iter()
            .zip(&names)
            .find(|(_, name)| *name == chosen);
        let Some((channel, _)) = channel else {
            continue;
        };
        let values: Vec<f64> = channel.sample_data.values_as_f32().map(f64::from).collect();
        let size = [layer.size.width(), layer.size.height()];
        if values.len() != size[0] * size[1] {
            let message = format!("channel `{chosen}` is subsampled");
            return Err(SampleFault::new("array", message));
        }
        slices.push((size, values));
    }
    Ok(slices)
}

/// Puts slices of one size on each other.
pub fn stack(slices: Vec<Slice>) -> SampleReading<Samples> {
    let Some(([width, height], _)) = slices.first() else {
        return Err(SampleFault::new("file", "there are no slices"));
    };
    let shape = [*width, *height, slices.len()];
    for (k, (size, _)) in slices.iter().enumerate() {
        if *size != [*width, *height] {
            let message = format!(
                "slice {} has {} x {} samples, the first has {width} x {height}",
                k + 1,
                size[0],
                size[1]
            );
            return Err(SampleFault::new("file", message));
        }
    }
    total("file", shape)?;
    let values: Vec<f64> = slices.into_iter().flat_map(|(_, values)| values).collect();
    Ok(Samples::from_x_fastest(shape, &values))
}
