//! Colours of other primaries and other channels than those that all pictures have here.
//!
//! In: the chromaticities of a file's primaries and white. Out: the weights of its channels in the
//! luminance, and the matrix that takes its colours to linear light with Rec.709 primaries and a D65
//! white.
//!
//! In: the channels of an OpenEXR file by their names, and the chromaticities that it states. Out: red, green and
//! blue as all pictures have them. A file has `R`, `G` and `B`; or the luminance `Y`, grey or with the
//! chroma `RY` = (R − Y)/Y and `BY` = (B − Y)/Y, mostly at half the resolution; or CIE `X`, `Y` and `Z`.

use super::{LayerValues, exr::Plane};
use glam::{DMat3, DVec2, DVec3};
use ndarray::{Array2, Array3, Axis, stack};

/// Chromaticities (x, y) of primaries and white.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Primaries {
    /// The first channel alone.
    pub red: DVec2,
    /// The second alone.
    pub green: DVec2,
    /// The third alone.
    pub blue: DVec2,
    /// All three, equal.
    pub white: DVec2,
}

/// From CIE XYZ to the cones' responses in which whites are adapted (the Bradford matrix: Lam 1985; its
/// figures as in ICC.1:2010, annex E).
const BRADFORD: DMat3 = DMat3::from_cols(
    DVec3::new(0.8951, -0.7502, 0.0389),
    DVec3::new(0.2664, 1.7135, -0.0685),
    DVec3::new(-0.1614, 0.0367, 1.0296),
);

/// Largest entry of a change of colours that is left undone: less than half of the last place of an
/// 8-bit value.
const NO_CHANGE: f64 = 1e-3;

/// Least area of the triangle of primaries (twice that, in chromaticities): those of Rec.709 have 0.22. With
/// less, files' single precision would decide the colours.
const LEAST_AREA: f64 = 1e-4;

impl Primaries {
    /// Those of Rec. ITU-R BT.709, white D65.
    pub const REC709: Self = Self {
        red: DVec2::new(0.64, 0.33),
        green: DVec2::new(0.3, 0.6),
        blue: DVec2::new(0.15, 0.06),
        white: DVec2::new(0.3127, 0.329),
    };

    /// Those with which the channels are CIE X, Y and Z.
    pub const XYZ: Self = Self {
        red: DVec2::new(1.0, 0.0),
        green: DVec2::new(0.0, 1.0),
        blue: DVec2::ZERO,
        white: DVec2::splat(1.0 / 3.0),
    };

    /// Computes the matrix from colours to CIE XYZ, white to Y = 1; `None` if the primaries lie on a line.
    fn to_xyz(self) -> Option<DMat3> {
        let columns = [self.red, self.green, self.blue].map(tristimulus);
        let primaries = DMat3::from_cols_array_2d(&columns.map(|column| column.to_array()));
        if !(primaries.determinant().abs() > LEAST_AREA) {
            return None;
        }
        let strength = primaries.inverse() * (tristimulus(self.white) / self.white.y);
        let matrix = primaries * DMat3::from_diagonal(strength);
        Some(matrix).filter(|matrix| matrix.is_finite())
    }

    /// Computes the weights of the three channels in the luminance; they sum to 1.
    pub fn luminance(self) -> Option<DVec3> {
        Some(self.to_xyz()?.row(1))
    }

    /// Computes the matrix from colours to Rec.709. White stays white; but XYZ itself has none, so its colours
    /// are kept as they are.
    pub fn to_rec709(self) -> Option<DMat3> {
        let xyz = self.to_xyz()?;
        let screen = Self::REC709.to_xyz()?.inverse();
        // Files state chromaticities in single precision.
        let is_xyz = (xyz - DMat3::IDENTITY)
            .to_cols_array()
            .iter()
            .all(|x| x.abs() < 1e-5);
        let adapted = match is_xyz {
            true => xyz,
            false => adaptation(self.white) * xyz,
        };
        let matrix = screen * adapted;
        let change = matrix - DMat3::IDENTITY;
        let same = change.to_cols_array().iter().all(|x| x.abs() < NO_CHANGE);
        Some(if same { DMat3::IDENTITY } else { matrix })
    }
}

/// X, Y and Z that sum to 1.
fn tristimulus(chromaticity: DVec2) -> DVec3 {
    chromaticity.extend(1.0 - chromaticity.x - chromaticity.y)
}

/// Computes the change of XYZ by which what looks white under `white` looks white under D65.
fn adaptation(white: DVec2) -> DMat3 {
    let cones = |white: DVec2| BRADFORD * (tristimulus(white) / white.y);
    let gain = cones(Primaries::REC709.white) / cones(white);
    BRADFORD.inverse() * DMat3::from_diagonal(gain) * BRADFORD
}

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

#[cfg(test)]
mod tests {
    use super::*;

    fn close(matrix: DMat3, expected: [[f64; 3]; 3], within: f64) {
        for (row, line) in expected.iter().enumerate() {
            for (column, value) in line.iter().enumerate() {
                let found = matrix.row(row)[column];
                assert!((found - value).abs() < within, "{matrix} {expected:?}");
            }
        }
    }

    #[test]
    fn xyz_becomes_rec709_by_the_published_matrix() {
        // IEC 61966-2-1, to seven digits as in B. Lindbloom's tables.
        let published = [
            [3.2404542, -1.5371385, -0.4985314],
            [-0.9692660, 1.8760108, 0.0415560],
            [0.0556434, -0.2040259, 1.0572252],
        ];
        close(Primaries::XYZ.to_rec709().unwrap(), published, 1e-3);
        assert_eq!(Primaries::XYZ.luminance().unwrap(), DVec3::Y);
    }

    #[test]
    fn aces_colours_become_rec709_by_the_published_matrix() {
        let aces = Primaries {
            red: DVec2::new(0.7347, 0.2653),
            green: DVec2::new(0.0, 1.0),
            blue: DVec2::new(0.0001, -0.0770),
            white: DVec2::new(0.32168, 0.33767),
        };
        // S-2014-004 of the Academy, with Bradford's adaptation.
        let published = [
            [2.52168618674388, -1.13413098823972, -0.387555198504164],
            [-0.276479914229922, 1.37271908766826, -0.096239173438334],
            [-0.0153780649660342, -0.152975335867399, 1.16835340083343],
        ];
        let matrix = aces.to_rec709().unwrap();
        close(matrix, published, 2e-3);
        assert!((matrix * DVec3::ONE - DVec3::ONE).abs().max_element() < 1e-9);
    }

    #[test]
    fn rec709_is_left_as_it_is_and_primaries_on_a_line_are_refused() {
        let matrix = Primaries::REC709.to_rec709().unwrap();
        assert_eq!(matrix, DMat3::IDENTITY);
        let weights = Primaries::REC709.luminance().unwrap();
        assert!(
            (weights - DVec3::new(0.2126, 0.7152, 0.0722))
                .abs()
                .max_element()
                < 1e-4
        );
        let flat = Primaries {
            green: DVec2::new(0.395, 0.195),
            ..Primaries::REC709
        };
        assert!(flat.to_rec709().is_none());
    }
}
