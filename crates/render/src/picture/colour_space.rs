//! Colours of other primaries.
//!
//! In: the chromaticities of a file's primaries and white. Out: the weights of its channels in the
//! luminance, and the matrix that takes its colours to linear light with Rec.709 primaries and a D65
//! white, as all pictures have here.

use glam::{DMat3, DVec2, DVec3};

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
