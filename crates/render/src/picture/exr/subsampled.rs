//! Channels with fewer samples than pixels, as files of luminance and chroma have them.
//!
//! In: the bytes of a file of scan lines. Out: all its channels, each at its own resolution. The `exr`
//! crate decompresses such blocks but refuses to read such files, so blocks are found and taken apart
//! here. Its decompression is told how many bytes a block has by the bytes of a pixel: for each block
//! their mean.

use super::{Plane, layer_values};
use ::exr::{
    block::chunk::{Chunk, CompressedBlock},
    io::PeekRead,
    meta::{
        MetaData, Requirements,
        attribute::{ChannelDescription, IntegerBounds, SampleType},
        header::Header,
        magic_number,
    },
    prelude::{Compression, FlatSamples, Vec2, f16},
};
use std::io::Cursor;

/// Tells if any channel of the file has fewer samples than pixels.
pub(super) fn is_subsampled(meta: &MetaData) -> bool {
    let mut channels = meta.headers.iter().flat_map(|header| &header.channels.list);
    channels.any(|channel| channel.sampling != Vec2(1, 1))
}

/// Reads all channels of all parts.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<Plane>, String> {
    let mut start = PeekRead::new(Cursor::new(bytes));
    let (meta, offsets) = open(&mut start).map_err(|e| e.to_string())?;
    let mut parts = Vec::new();
    for header in &meta.headers {
        check(header)?;
        let channels = header.channels.list.iter();
        let empty: Vec<FlatSamples> = channels
            .map(|channel| empty(channel.sample_type, resolution(header, channel).area()))
            .collect();
        parts.push(empty);
    }
    for offset in offsets.into_iter().flatten() {
        let mut at = Cursor::new(bytes);
        at.set_position(offset);
        let chunk = Chunk::read(&mut at, &meta).map_err(|e| e.to_string())?;
        let header = &meta.headers[chunk.layer_index];
        let samples = &mut parts[chunk.layer_index];
        place(header, chunk.compressed_block, samples)?;
    }
    let mut planes = Vec::new();
    for (number, (header, samples)) in meta.headers.iter().zip(parts).enumerate() {
        for (channel, samples) in header.channels.list.iter().zip(samples) {
            let size = resolution(header, channel);
            let values = layer_values((size.height(), size.width()), samples)
                .ok_or("has channels of impossible sizes")?;
            planes.push(Plane {
                name: super::plane_name(
                    number,
                    header.own_attributes.layer_name.as_ref(),
                    &channel.name,
                ),
                sampling: channel.sampling,
                corner: header.own_attributes.layer_position,
                values,
            });
        }
    }
    Ok(planes)
}

/// Reads the headers, and where each part's blocks are.
fn open(
    start: &mut PeekRead<Cursor<&[u8]>>,
) -> ::exr::error::Result<(MetaData, ::exr::meta::OffsetTables)> {
    magic_number::validate_exr(start)?;
    let requirements = Requirements::read(start)?;
    let headers = Header::read_all(start, &requirements, false)?;
    let offsets = MetaData::read_offset_tables(start, &headers)?;
    let meta = MetaData {
        requirements,
        headers,
    };
    Ok((meta, offsets))
}

/// Refuses headers by which blocks could not be taken apart.
fn check(header: &Header) -> Result<(), String> {
    if header.deep || header.blocks.has_tiles() {
        return Err("has tiles or deep data beside subsampled channels".into());
    }
    let window = header.data_window();
    for channel in &header.channels.list {
        let divides = |sampling: usize, size: usize, position: i32| {
            let step = i32::try_from(sampling).unwrap_or(0);
            step > 0 && size.is_multiple_of(sampling) && position.rem_euclid(step) == 0
        };
        let Vec2(across, down) = channel.sampling;
        let (size, position) = (window.size, window.position);
        if !divides(across, size.width(), position.x())
            || !divides(down, size.height(), position.y())
        {
            return Err(format!(
                "channel {} has a sample for every {across}x{down} pixels, which does not divide the picture",
                channel.name
            ));
        }
    }
    Ok(())
}

/// Counts a channel's samples across and down.
fn resolution(header: &Header, channel: &ChannelDescription) -> Vec2<usize> {
    channel.subsampled_resolution(header.layer_size)
}

fn empty(kind: SampleType, count: usize) -> FlatSamples {
    match kind {
        SampleType::F16 => FlatSamples::F16(vec![f16::ZERO; count]),
        SampleType::F32 => FlatSamples::F32(vec![0.0; count]),
        SampleType::U32 => FlatSamples::U32(vec![0; count]),
    }
}

/// Decompresses a block and puts its lines into the channels' samples.
fn place(
    header: &Header,
    block: CompressedBlock,
    samples: &mut [FlatSamples],
) -> Result<(), String> {
    let CompressedBlock::ScanLine(block) = block else {
        return Err("has blocks of another kind than its header says".into());
    };
    let window = header.data_window();
    let lines = header.compression.scan_lines_per_block() as i64;
    let (top, first) = (
        i64::from(block.y_coordinate),
        i64::from(window.position.y()),
    );
    let left = first + window.size.height() as i64 - top;
    if top < first || left <= 0 || (top - first) % lines != 0 {
        return Err("has a block outside its data window".into());
    }
    let size = Vec2(window.size.width(), lines.min(left) as usize);
    let section = IntegerBounds::new(Vec2(window.position.x(), block.y_coordinate), size);
    let data = decompressed(header, block.compressed_pixels_le, section)?;
    let mut rest = data.as_slice();
    for y in section.position.y()..section.end().y() {
        for (channel, samples) in header.channels.list.iter().zip(&mut *samples) {
            if has_line(channel, y) {
                let row = (i64::from(y) - first) as usize / channel.sampling.y();
                let width = size.width() / channel.sampling.x();
                rest = take_line(rest, samples, row * width..(row + 1) * width)
                    .ok_or("has a block that is too short")?;
            }
        }
    }
    Ok(())
}

/// Tells if a channel has samples on line `y`.
fn has_line(channel: &ChannelDescription, y: i32) -> bool {
    y.rem_euclid(channel.sampling.y() as i32) == 0
}

/// Decompresses the lines of a section: bytes channel by channel, in native order.
fn decompressed(
    header: &Header,
    compressed: Vec<u8>,
    section: IntegerBounds,
) -> Result<Vec<u8>, String> {
    let lines = section.position.y()..section.end().y();
    let bytes: usize = lines
        .flat_map(|y| header.channels.list.iter().filter(move |c| has_line(c, y)))
        .map(|c| section.size.width() / c.sampling.x() * c.sample_type.bytes_per_sample())
        .sum();
    if bytes == 0 {
        return Ok(Vec::new());
    }
    let area = section.size.area();
    if !bytes.is_multiple_of(area) {
        return Err("has channels subsampled in an unusual way".into());
    }
    if matches!(header.compression, Compression::B44 | Compression::B44A)
        && compressed.len() != bytes
    {
        return channel_by_channel(header, &compressed, section);
    }
    let mut header = header.clone();
    header.channels.bytes_per_pixel = bytes / area;
    let compression = header.compression;
    compression
        .decompress_image_section_from_le(&header, compressed, section, false)
        .map_err(|e| e.to_string())
}

/// Decompresses a section of B44, of which the `exr` crate takes apart full channels only: in a block they
/// follow each other, so each is decompressed as if it were alone and full.
fn channel_by_channel(
    header: &Header,
    compressed: &[u8],
    section: IntegerBounds,
) -> Result<Vec<u8>, String> {
    let mut rest = compressed;
    let mut channels = Vec::new();
    for channel in &header.channels.list {
        let size = channel.subsampled_resolution(section.size);
        let length = coded_length(channel.sample_type, size, rest);
        let (coded, others) = length
            .and_then(|length| rest.split_at_checked(length))
            .ok_or("has a block that is too short")?;
        rest = others;
        let mut alone = header.clone();
        let full = ChannelDescription {
            sampling: Vec2(1, 1),
            ..channel.clone()
        };
        alone.channels.bytes_per_pixel = full.sample_type.bytes_per_sample();
        alone.channels.list = std::iter::once(full).collect();
        let part = IntegerBounds::new(section.position, size);
        let data = alone
            .compression
            .decompress_image_section_from_le(&alone, coded.to_vec(), part, false)
            .map_err(|e| e.to_string())?;
        let line = size.width() * channel.sample_type.bytes_per_sample();
        channels.push((channel, line, data));
    }
    let mut lines = Vec::new();
    for y in section.position.y()..section.end().y() {
        for (channel, line, data) in channels.iter().filter(|(c, ..)| has_line(c, y)) {
            let row = (y - section.position.y()) as usize / channel.sampling.y();
            let from = data.get(row * line..(row + 1) * line);
            lines.extend_from_slice(from.ok_or("has a block that is too short")?);
        }
    }
    Ok(lines)
}

/// Counts the bytes of a channel in a block of B44: squares of 4 × 4 half floats take 14 bytes, or 3 if their third
/// says that all are alike; other numbers are not compressed.
fn coded_length(kind: SampleType, size: Vec2<usize>, coded: &[u8]) -> Option<usize> {
    const ALIKE: u8 = 13 << 2;
    if kind != SampleType::F16 {
        return Some(size.area() * kind.bytes_per_sample());
    }
    let mut length = 0;
    for _ in 0..size.width().div_ceil(4) * size.height().div_ceil(4) {
        length += if *coded.get(length + 2)? >= ALIKE {
            3
        } else {
            14
        };
    }
    Some(length)
}

/// Puts a line of samples in its place; returns what follows it.
fn take_line<'b>(
    bytes: &'b [u8],
    samples: &mut FlatSamples,
    place: std::ops::Range<usize>,
) -> Option<&'b [u8]> {
    let size = match samples {
        FlatSamples::F16(_) => 2,
        _ => 4,
    };
    let (line, rest) = bytes.split_at_checked(size * place.len())?;
    match samples {
        FlatSamples::F16(to) => {
            let from = line.as_chunks::<2>().0.iter();
            for (to, from) in to.get_mut(place)?.iter_mut().zip(from) {
                *to = f16::from_ne_bytes(*from);
            }
        }
        FlatSamples::F32(to) => {
            let from = line.as_chunks::<4>().0.iter();
            for (to, from) in to.get_mut(place)?.iter_mut().zip(from) {
                *to = f32::from_ne_bytes(*from);
            }
        }
        FlatSamples::U32(to) => {
            let from = line.as_chunks::<4>().0.iter();
            for (to, from) in to.get_mut(place)?.iter_mut().zip(from) {
                *to = u32::from_ne_bytes(*from);
            }
        }
    }
    Some(rest)
}
