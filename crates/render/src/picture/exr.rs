//! OpenEXR files: one flat layer of channels `R G B A` and the picture's layers, ZIP-compressed.
//!
//! In: a picture, its notes, and how precise the colours are to be. Out: a file that OpenEXR
//! readers understand, equal byte for byte for equal pictures and notes. Layers are 32-bit floats
//! or 32-bit whole numbers and come back exactly; notes are string attributes `geofan.KEY`. Reading knows
//! what other programs write, too: windows, chromaticities, luminance and chroma, CIE XYZ.

mod subsampled;

use super::{
    Frame, Layer, LayerValues, MAX_PIXELS, Metadata, Picture, bad_input, check_writable,
    colour_space::{Primaries, colours},
    read_bytes,
};
use ::exr::{
    meta::{attribute::IntegerBounds, header::Header},
    prelude::{
        AnyChannel, AnyChannels, AttributeValue, Blocks, Compression, Encoding, FlatImage,
        FlatSamples, Image, Layer as ExrLayer, LayerAttributes, LineOrder, MetaData, ReadChannels,
        ReadLayers, Text, Vec2, WritableImage, f16,
    },
};
use geofan_core::{error::Result, files::write_atomically};
use glam::DVec2;
use ndarray::{Array, Array2, ArrayView, ArrayView2, Axis, Dimension, Slice};
use std::{
    io::{Cursor, Write},
    path::Path,
};

/// Number format of the colours.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Precision {
    /// 16 bits: 11 bits of precision up to 65504; larger finite values are stored as that.
    #[default]
    Half,
    /// 32 bits, exact.
    Float,
}

impl Precision {
    /// Chooses half floats, unless light is brighter than they go.
    pub fn of(picture: &Picture) -> Self {
        let largest = f16::MAX.to_f32();
        match picture
            .rgb
            .iter()
            .any(|value| value.is_finite() && value.abs() > largest)
        {
            true => Self::Float,
            false => Self::Half,
        }
    }
}

/// Before the keys of notes, so that no key can be one of OpenEXR's own attribute names.
const NOTE_PREFIX: &str = "geofan.";

/// Writes colours, layers and notes; of several notes with one key the last is kept.
pub fn write_exr(
    path: &Path,
    picture: &Picture,
    metadata: &Metadata,
    precision: Precision,
) -> Result<()> {
    check_writable(path, picture)?;
    let bytes = encode(picture, metadata, precision).map_err(|e| bad_input(path, e))?;
    write_atomically(path, |out| out.write_all(&bytes))
}

/// Reads the colours, the further channels, and the notes. The picture is the display window: what the
/// data window has beyond it is left out, and what it lacks is black. Colours may be `R G B` of any
/// chromaticities, `Y` alone or with `RY BY`, or `X Y Z`; channels of parts after the first are called
/// `part.channel`; alpha is dropped.
pub fn read_exr(path: &Path) -> Result<(Picture, Metadata)> {
    decode(&read_bytes(path)?).map_err(|e| bad_input(path, e))
}

/// Tells if a file begins as EXR files do.
pub(super) fn is_exr(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01])
}

/// The bytes of an EXR file.
fn encode(picture: &Picture, notes: &Metadata, precision: Precision) -> Result<Vec<u8>, String> {
    let mut attributes = LayerAttributes::default();
    for (key, text) in &notes.notes {
        let value = AttributeValue::Text(Text::from_slice_unchecked(text.as_bytes()));
        attributes.other.insert(note_name(key)?, value);
    }
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let channels = AnyChannels::sort(channels(picture, precision)?.into_iter().collect());
    let size = (picture.width(), picture.height());
    if let Some(width) = notes.screen_width {
        attributes.screen_window_width = width;
    }
    let frame = notes.frame.unwrap_or(Frame {
        size,
        corner: (0, 0),
    });
    attributes.layer_position = Vec2(frame.corner.0 as i32, frame.corner.1 as i32);
    let mut image = Image::from_layer(ExrLayer::new(size, attributes, encoding, channels));
    let window = Vec2(frame.size.0, frame.size.1);
    image.attributes.display_window = IntegerBounds::new(Vec2(0, 0), window);
    let mut bytes = Cursor::new(Vec::new());
    let written = image.write().to_buffered(&mut bytes);
    written.map_err(|e| e.to_string())?;
    let mut bytes = bytes.into_inner();
    sort_attributes(&mut bytes);
    Ok(bytes)
}

/// The attribute name of a note.
fn note_name(key: &str) -> Result<Text, String> {
    if key.is_empty() || !key.bytes().all(|byte| byte.is_ascii_graphic()) {
        return Err(format!(
            "a note's key is plain ASCII without spaces, not {key:?}"
        ));
    }
    Ok(Text::new_or_panic(format!("{NOTE_PREFIX}{key}")))
}

/// All channels of the file; alpha is 1.
fn channels(
    picture: &Picture,
    precision: Precision,
) -> Result<Vec<AnyChannel<FlatSamples>>, String> {
    let colours = ["R", "G", "B"]
        .into_iter()
        .zip(picture.rgb.axis_iter(Axis(2)));
    let mut channels: Vec<_> = colours
        .map(|(name, plane)| AnyChannel::new(name, colour_samples(plane, precision)))
        .collect();
    let opaque = Array2::ones((picture.height(), picture.width()));
    channels.push(AnyChannel::new(
        "A",
        colour_samples(opaque.view(), precision),
    ));
    for Layer { name, values } in &picture.layers {
        let name = match Text::new_or_none(name) {
            Some(text) if !name.is_empty() && !name.contains('\0') => text,
            _ => return Err(format!("a channel cannot be called {name:?}")),
        };
        if channels.iter().any(|channel| channel.name == name) {
            return Err(format!("two channels are called {name}"));
        }
        let samples = match values {
            LayerValues::Float(values) => FlatSamples::F32(values.iter().copied().collect()),
            LayerValues::Index(values) => FlatSamples::U32(values.iter().copied().collect()),
        };
        channels.push(AnyChannel::new(name, samples));
    }
    Ok(channels)
}

/// One colour plane in the wanted precision.
fn colour_samples(plane: ArrayView2<f32>, precision: Precision) -> FlatSamples {
    match precision {
        Precision::Float => FlatSamples::F32(plane.iter().copied().collect()),
        Precision::Half => FlatSamples::F16(plane.iter().map(|&value| to_half(value)).collect()),
    }
}

/// The nearest half float; finite values stay finite.
fn to_half(value: f32) -> f16 {
    let largest = f16::MAX.to_f32();
    if value.is_finite() {
        f16::from_f32(value.clamp(-largest, largest))
    } else {
        f16::from_f32(value)
    }
}

/// Sorts the header's attributes by name, as the OpenEXR library does. The `exr` crate keeps notes
/// in a hash map, whose order differs from run to run. The header's length stays, and so do the
/// file positions that follow it.
fn sort_attributes(file: &mut [u8]) {
    const HEADER_START: usize = 8; // after the magic number and the version
    let mut attributes = Vec::new();
    let mut at = HEADER_START;
    while let Some(attribute) = first_attribute(&file[at..]) {
        at += attribute.len();
        attributes.push(attribute.to_vec());
    }
    attributes.sort_unstable();
    file[HEADER_START..at].copy_from_slice(&attributes.concat());
}

/// The bytes of the attribute that starts here: name, 0, kind, 0, 4 bytes of size, value. An empty
/// name ends the header.
fn first_attribute(bytes: &[u8]) -> Option<&[u8]> {
    let name_length = bytes.iter().position(|&byte| byte == 0)?;
    if name_length == 0 {
        return None;
    }
    let kind = &bytes[name_length + 1..];
    let size_at = name_length + 1 + kind.iter().position(|&byte| byte == 0)? + 1;
    let size = bytes.get(size_at..size_at + 4)?.try_into().ok()?;
    bytes.get(..size_at + 4 + u32::from_le_bytes(size) as usize)
}

/// The picture and the notes in the bytes of an EXR file, or what is wrong with them. The picture is the
/// file's display window, black where there is no data.
pub(super) fn decode(bytes: &[u8]) -> Result<(Picture, Metadata), String> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false);
    let meta = meta.map_err(|e| e.to_string())?;
    check_size(&meta)?;
    let first = meta.headers.first().ok_or("has no parts")?;
    let window = first.shared_attributes.display_window;
    let primaries = primaries(first);
    let notes = notes(&meta);
    let mut planes = match subsampled::is_subsampled(&meta) {
        true => subsampled::read(bytes)?,
        false => planes(read(bytes)?),
    };
    let corner = first.own_attributes.layer_position;
    let rgb = framed(colours(&mut planes, primaries)?.view(), corner, window);
    let layers = planes.into_iter().filter(|plane| plane.name != "A");
    let layers = layers
        .filter_map(|plane| plane.into_layer(window))
        .collect();
    Ok((Picture { rgb, layers }, notes))
}

/// Reads a file in which every channel has a value for each pixel of its data window.
fn read(bytes: &[u8]) -> Result<FlatImage, String> {
    ::exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(|e| e.to_string())
}

/// One channel of a file.
pub(super) struct Plane {
    pub(super) name: String,
    /// Pixels for each sample, across and down.
    pub(super) sampling: Vec2<usize>,
    /// The upper left corner of its data window.
    corner: Vec2<i32>,
    pub(super) values: LayerValues,
}

impl Plane {
    /// Turns it into a layer over the display window; none if it is subsampled and thus has fewer values than
    /// pixels.
    fn into_layer(self, window: IntegerBounds) -> Option<Layer> {
        let whole = self.sampling == Vec2(1, 1);
        let framed = |values: LayerValues| match values {
            LayerValues::Float(x) => LayerValues::Float(framed(x.view(), self.corner, window)),
            LayerValues::Index(x) => LayerValues::Index(framed(x.view(), self.corner, window)),
        };
        whole.then(|| Layer {
            name: self.name,
            values: framed(self.values),
        })
    }
}

/// Cuts `values` (row, column, …), whose upper left corner is at `corner`, to the display window; zeros
/// fill the rest of it.
fn framed<T: Copy + Default, D: Dimension>(
    values: ArrayView<'_, T, D>,
    corner: Vec2<i32>,
    window: IntegerBounds,
) -> Array<T, D> {
    let mut size = values.raw_dim();
    (size[0], size[1]) = (window.size.height(), window.size.width());
    let mut framed = Array::from_elem(size, T::default());
    let (mut from, mut to) = (values, framed.view_mut());
    for (axis, corner, start) in [
        (Axis(0), corner.y(), window.position.y()),
        (Axis(1), corner.x(), window.position.x()),
    ] {
        let shift = i64::from(corner) - i64::from(start);
        let (skipped, left) = (shift.min(0).unsigned_abs(), shift.max(0) as u64);
        let [have, room] = [from.len_of(axis), to.len_of(axis)].map(|n| n as u64);
        let count = have.saturating_sub(skipped).min(room.saturating_sub(left));
        let part = |first: u64, length: usize| {
            let first = (first as usize).min(length);
            Slice::from(first..first + (count as usize).min(length - first))
        };
        let (have, room) = (from.len_of(axis), to.len_of(axis));
        from.slice_axis_inplace(axis, part(skipped, have));
        to.slice_axis_inplace(axis, part(left, room));
    }
    to.assign(&from);
    framed
}

/// Takes the chromaticities that a header states, or those of Rec.709.
fn primaries(header: &Header) -> Primaries {
    let pair = |Vec2(x, y): Vec2<f32>| DVec2::new(x.into(), y.into());
    let stated = header.shared_attributes.chromaticities;
    stated.map_or(Primaries::REC709, |stated| Primaries {
        red: pair(stated.red),
        green: pair(stated.green),
        blue: pair(stated.blue),
        white: pair(stated.white),
    })
}

/// Refuses what would not fit into memory, before any pixel is read.
fn check_size(meta: &MetaData) -> Result<(), String> {
    let mut samples = 0_usize;
    for header in &meta.headers {
        let window = header.shared_attributes.display_window.size;
        for size in [header.layer_size, window] {
            let (width, height) = (size.width(), size.height());
            let pixels = width.saturating_mul(height);
            samples = samples.saturating_add(pixels.saturating_mul(header.channels.list.len()));
            if pixels > MAX_PIXELS || samples > 8 * MAX_PIXELS {
                return Err(format!(
                    "{width}x{height} pixels in these channels are too many"
                ));
            }
            if pixels == 0 {
                return Err("has no pixels".into());
            }
        }
    }
    Ok(())
}

/// The notes of all parts, sorted by key.
fn notes(meta: &MetaData) -> Metadata {
    let own = meta.headers.iter().flat_map(|header| {
        let shared = &header.shared_attributes.other;
        header.own_attributes.other.iter().chain(shared)
    });
    let mut notes: Vec<_> = own
        .filter_map(|(name, value)| {
            let key = name.to_string().strip_prefix(NOTE_PREFIX)?.to_string();
            let text = String::from_utf8_lossy(value.to_text().ok()?.bytes()).into_owned();
            Some((key, text))
        })
        .collect();
    notes.sort();
    notes.dedup();
    Metadata {
        notes,
        ..Metadata::default()
    }
}

/// All channels of all parts.
fn planes(image: FlatImage) -> Vec<Plane> {
    let mut planes = Vec::new();
    for (number, part) in image.layer_data.into_iter().enumerate() {
        let shape = (part.size.height(), part.size.width());
        for channel in part.channel_data.list {
            let part_name = part.attributes.layer_name.as_ref();
            let name = plane_name(number, part_name, &channel.name);
            if let Some(values) = layer_values(shape, channel.sample_data) {
                planes.push(Plane {
                    name,
                    sampling: channel.sampling,
                    corner: part.attributes.layer_position,
                    values,
                });
            }
        }
    }
    planes
}

/// The name of a channel of part `number`: with the part's name, except in the first part.
fn plane_name(number: usize, part: Option<&Text>, channel: &Text) -> String {
    match part {
        Some(part) if number > 0 => format!("{part}.{channel}"),
        _ => channel.to_string(),
    }
}

/// One channel as an array; none if it has another number of values.
fn layer_values(shape: (usize, usize), samples: FlatSamples) -> Option<LayerValues> {
    Some(match samples {
        FlatSamples::F16(values) => {
            let values = values.into_iter().map(f16::to_f32).collect();
            LayerValues::Float(Array2::from_shape_vec(shape, values).ok()?)
        }
        FlatSamples::F32(values) => LayerValues::Float(Array2::from_shape_vec(shape, values).ok()?),
        FlatSamples::U32(values) => LayerValues::Index(Array2::from_shape_vec(shape, values).ok()?),
    })
}

#[cfg(test)]
mod tests {
    use super::{super::tests::sample, *};

    fn note() -> Metadata {
        let command = "geofan render \u{3b1}.toml -o a.exr";
        Metadata::default()
            .with("command", command)
            .with("manifold", "")
            .with("version", "0.1.0")
    }

    #[test]
    fn full_floats_layers_and_notes_come_back_exactly() {
        let picture = sample(37, 21);
        let bytes = encode(&picture, &note(), Precision::Float).unwrap();
        let (back, notes) = decode(&bytes).unwrap();
        assert_eq!(back, picture);
        assert_eq!(notes, note());
    }

    #[test]
    fn half_floats_keep_eleven_bits_and_stay_finite() {
        let mut picture = sample(37, 21);
        picture.rgb[(0, 0, 0)] = 1e9;
        picture.rgb[(0, 0, 1)] = f32::NAN;
        let bytes = encode(&picture, &note(), Precision::Half).unwrap();
        let (back, _) = decode(&bytes).unwrap();
        assert_eq!(back.rgb[(0, 0, 0)], 65504.0);
        assert!(back.rgb[(0, 0, 1)].is_nan());
        assert_eq!(back.layers, picture.layers);
        for (a, b) in back.rgb.iter().zip(&picture.rgb).skip(2) {
            approx::assert_relative_eq!(a, b, max_relative = 1.0 / 2048.0, epsilon = 1e-7);
        }
    }

    #[test]
    fn equal_pictures_and_notes_give_equal_bytes() {
        let encode = || encode(&sample(64, 50), &note(), Precision::Half).unwrap();
        let first = encode();
        assert!((0..8).all(|_| encode() == first));
    }

    #[test]
    fn channels_have_the_names_that_readers_expect() {
        let ones = Array2::ones((5, 6));
        let names = ["Z", "P.X", "P.Y", "P.Z", "N.X", "area"];
        let mut picture = Picture::filled(6, 5, [0.5; 3]);
        for name in names {
            picture = picture.with_float(name, ones.clone());
        }
        let bytes = encode(&picture, &note(), Precision::Half).unwrap();
        let header = MetaData::read_from_buffered(Cursor::new(&bytes), true).unwrap();
        let written = header.headers[0].channels.list.iter();
        let mut written: Vec<_> = written.map(|channel| channel.name.to_string()).collect();
        let mut expected = [&names[..], &["R", "G", "B", "A"]].concat();
        written.sort();
        expected.sort();
        assert_eq!(written, expected);
    }

    #[test]
    fn impossible_names_are_refused() {
        let named = |name: &str| {
            let picture = sample(4, 4).with_float(name, Array2::zeros((4, 4)));
            encode(&picture, &Metadata::default(), Precision::Half)
        };
        for name in ["", "R", "Z", "\u{3b1}", "a\0b"] {
            assert!(named(name).is_err(), "{name:?}");
        }
        let spaced = Metadata::default().with("a b", "c");
        assert!(encode(&sample(4, 4), &spaced, Precision::Half).is_err());
    }

    #[test]
    fn a_grey_file_is_read_and_one_without_colours_is_refused() {
        let only = |name: &str| {
            let channel = AnyChannel::new(name, FlatSamples::F32(vec![0.5; 12]));
            let channels = AnyChannels::sort([channel].into_iter().collect());
            let mut bytes = Cursor::new(Vec::new());
            let image = Image::from_channels((4, 3), channels);
            image.write().to_buffered(&mut bytes).unwrap();
            decode(&bytes.into_inner())
        };
        let (grey, _) = only("Y").unwrap();
        assert_eq!(grey, Picture::filled(4, 3, [0.5; 3]));
        assert!(only("Z").unwrap_err().contains("channels: Z"));
    }

    #[test]
    fn a_part_of_a_picture_lies_where_it_belongs_in_the_whole() {
        let frame = Frame {
            size: (9, 7),
            corner: (4, 2),
        };
        let mut notes = note();
        (notes.frame, notes.screen_width) = (Some(frame), Some(1.5));
        let part = sample(3, 2);
        let bytes = encode(&part, &notes, Precision::Float).unwrap();
        let header = MetaData::read_from_buffered(Cursor::new(&bytes), true).unwrap();
        let header = &header.headers[0];
        assert_eq!(header.own_attributes.screen_window_width, 1.5);
        assert_eq!(header.own_attributes.layer_position, Vec2(4, 2));
        assert_eq!(header.layer_size, Vec2(3, 2));
        assert_eq!(header.shared_attributes.display_window.size, Vec2(9, 7));
        let (whole, _) = decode(&bytes).unwrap();
        assert_eq!((whole.width(), whole.height()), (9, 7));
        for (x, y) in (0..9).flat_map(|x| (0..7).map(move |y| (x, y))) {
            let inside = (4..7).contains(&x) && (2..4).contains(&y);
            let expected = match inside {
                true => part.pixel(x - 4, y - 2),
                false => [0.0; 3],
            };
            assert_eq!(whole.pixel(x, y), expected);
        }
    }
}
