//! Channels to colours.
//!
//! In: the channels of a file by their names, and the chromaticities that it states. Out: red, green and
//! blue as all pictures have them. A file has `R`, `G` and `B`; or the luminance `Y`, grey or with the
//! chroma `RY` = (R − Y)/Y and `BY` = (B − Y)/Y, mostly at half the resolution; or CIE `X`, `Y` and `Z`.

use super::Plane;
use crate::picture::{LayerValues, colour_space::Primaries};
use glam::{DMat3, DVec3};
use ndarray::{Array2, Array3, Axis, stack};

/// Weights of the samples on either side of a place in the middle between two, the nearest first: the
/// filter for which the OpenEXR library prepares chroma when it writes it (`ImfRgbaYca`). Linear
/// interpolation would blur what this restores.
const MIDDLE: [f32; 7] = [
    0.627_123, -0.186_077, 0.087_929, -0.043_159, 0.019_597, -0.007_540, 0.002_128,
];

/// Most channels that a complaint lists.
const LISTED: usize = 24;

/// Makes the colours, axes (row, column, channel), of the data window; the channels that they are made of
/// are taken out of `planes`.
pub(super) fn colours(
    planes: &mut Vec<Plane>,
    primaries: Primaries,
) -> Result<Array3<f32>, String> {
    if let Some([r, g, b]) = take(planes, ["R", "G", "B"]) {
        return in_rec709(stacked([r?, g?, b?])?, primaries);
    }
    if let Some([x, y, z]) = take(planes, ["X", "Y", "Z"]) {
        return in_rec709(stacked([x?, y?, z?])?, Primaries::XYZ);
    }
    if let Some([y, ry, by]) = take(planes, ["Y", "RY", "BY"]) {
        let weights = primaries.luminance().ok_or(ON_A_LINE)?;
        let mut rgb = stacked([y?, ry?, by?])?;
        for mut pixel in rgb.rows_mut() {
            let [y, ry, by] = [0, 1, 2].map(|k| f64::from(pixel[k]));
            let (r, b) = ((ry + 1.0) * y, (by + 1.0) * y);
            let g = match ry == 0.0 && by == 0.0 {
                true => y,
                false => (y - r * weights.x - b * weights.z) / weights.y,
            };
            pixel.assign(&ndarray::arr1(&[r, g, b].map(|x| x as f32)));
        }
        return in_rec709(rgb, primaries);
    }
    match take(planes, ["Y"]) {
        Some([grey]) => {
            let grey = grey?;
            stacked([grey.clone(), grey.clone(), grey])
        }
        None => Err(no_colours(planes)),
    }
}

const ON_A_LINE: &str = "states chromaticities of primaries that make no colours";

/// Complains that no channels fit, with those that there are.
fn no_colours(planes: &[Plane]) -> String {
    let mut names: Vec<&str> = planes.iter().map(|plane| plane.name.as_str()).collect();
    let left_out = names.len().saturating_sub(LISTED);
    names.truncate(LISTED);
    let more = match left_out {
        0 => String::new(),
        left_out => format!(" and {left_out} more"),
    };
    format!(
        "has no channels R, G and B, nor Y alone or with RY and BY, nor X, Y and Z; its channels: {}{more}",
        names.join(", ")
    )
}

/// Takes out the channels with these names, each with a value for every pixel, if all are there.
fn take<const N: usize>(
    planes: &mut Vec<Plane>,
    names: [&str; N],
) -> Option<[Result<Array2<f32>, String>; N]> {
    let place = |name: &str, planes: &[Plane]| planes.iter().position(|p| p.name == name);
    if names.iter().any(|name| place(name, planes).is_none()) {
        return None;
    }
    Some(names.map(|name| {
        let at = place(name, planes).ok_or("has no such channel")?;
        full(planes.remove(at))
    }))
}

/// Gives a channel a value for every pixel.
fn full(plane: Plane) -> Result<Array2<f32>, String> {
    let mut values = match plane.values {
        LayerValues::Float(values) => values,
        LayerValues::Index(values) => values.mapv(|value| value as f32),
    };
    for (axis, sampling) in [(Axis(1), plane.sampling.0), (Axis(0), plane.sampling.1)] {
        values = match sampling {
            1 => values,
            2 => doubled(&values, axis),
            _ => {
                return Err(format!(
                    "channel {} has a sample for every {} pixels; 1 and 2 are read",
                    plane.name, sampling
                ));
            }
        };
    }
    Ok(values)
}

/// Puts a sample between each two along `axis`; beyond the edges the last samples go on.
fn doubled(values: &Array2<f32>, axis: Axis) -> Array2<f32> {
    let count = values.len_of(axis);
    let mut size = values.raw_dim();
    size[axis.index()] = 2 * count;
    let mut fine = Array2::zeros(size);
    for (to, from) in fine.lanes_mut(axis).into_iter().zip(values.lanes(axis)) {
        let mut to = to;
        for k in 0..count {
            to[2 * k] = from[k];
            let pair = |j: usize| from[k.saturating_sub(j)] + from[(k + 1 + j).min(count - 1)];
            to[2 * k + 1] = MIDDLE.iter().enumerate().map(|(j, w)| w * pair(j)).sum();
        }
    }
    fine
}

fn stacked(planes: [Array2<f32>; 3]) -> Result<Array3<f32>, String> {
    let rgb = stack(Axis(2), &planes.each_ref().map(|plane| plane.view()));
    let rgb: Array3<f32> = rgb.map_err(|_| "has colour channels of different sizes")?;
    Ok(rgb.as_standard_layout().into_owned())
}

fn in_rec709(mut rgb: Array3<f32>, primaries: Primaries) -> Result<Array3<f32>, String> {
    let matrix = primaries.to_rec709().ok_or(ON_A_LINE)?;
    if matrix != DMat3::IDENTITY {
        for mut pixel in rgb.rows_mut() {
            let colour = DVec3::from_array([0, 1, 2].map(|k| f64::from(pixel[k])));
            let colour = (matrix * colour).as_vec3();
            pixel.assign(&ndarray::arr1(&colour.to_array()));
        }
    }
    Ok(rgb)
}
