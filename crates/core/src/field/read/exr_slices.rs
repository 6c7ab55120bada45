//! Slices of constant z in OpenEXR files: columns are x, rows y, the first row the first y.

use super::{SampleReading, choose, total};
use crate::field::{SampleFault, Samples};
use ::exr::prelude::{MetaData, ReadChannels, ReadLayers, read};
use std::io::Cursor;

/// One slice: width, height, and its numbers row by row.
pub type Slice = ([usize; 2], Vec<f64>);

fn damaged(what: impl std::fmt::Display) -> SampleFault {
    SampleFault::new("file", format!("is not an OpenEXR file of slices: {what}"))
}

/// Reads the channel `asked` of every layer, in the order of the file.
pub fn layers(bytes: &[u8], asked: Option<&str>) -> SampleReading<Vec<Slice>> {
    let heads = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(damaged)?;
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
        .map_err(damaged)?;
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
