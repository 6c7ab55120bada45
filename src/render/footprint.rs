//! What a sample stands for: a small parallelogram of a sky or of a texture.
//!
//! In: how a direction (or texture coordinates) changes to the next sample on the right and the next
//! below. Out: the axes of the ellipse through them, and round footprints along its longer axis that
//! cover it.

use glam::Vec3;

/// The change to the next samples.
#[derive(Debug, Clone, Copy)]
pub struct Footprint {
    /// To the right, and down.
    pub across: [Vec3; 2],
}

/// The standard deviation of the pixel filter in pixels (see [`super::film`]): what a footprint of
/// one pixel is to be averaged over.
pub const FILTER_DEVIATION: f32 = 0.4155;

/// Most round footprints that stand for a long one: at eight a footprint of one to eight is covered,
/// beyond it is averaged too widely across, which is soft but does not shimmer.
const MOST_TAPS: f32 = 8.0;

/// Widest footprint, radians (or texture widths): beyond it neighbours are no guide.
const WIDEST: f32 = 0.5;

impl Footprint {
    /// A point.
    pub const POINT: Self = Self {
        across: [Vec3::ZERO; 2],
    };

    /// As wide in all directions across `d`.
    pub fn round(d: Vec3, width: f32) -> Self {
        let (right, down) = d.normalize_or(Vec3::X).any_orthonormal_pair();
        Self {
            across: [right * width, down * width],
        }
    }

    /// A similar one.
    pub fn scaled(self, factor: f32) -> Self {
        Self {
            across: self.across.map(|x| x * factor),
        }
    }

    /// The places, as displacements, and the width of the round footprints that cover this.
    #[inline]
    pub fn taps(&self) -> (impl Iterator<Item = Vec3> + use<>, f32) {
        let (major, short) = self.axes();
        let long = major.length();
        let count = (long / short.max(1e-12)).round().clamp(1.0, MOST_TAPS);
        let width = short.max(long / count).min(WIDEST);
        let step = major * (1.0 / count);
        let first = step * (0.5 - 0.5 * count);
        let taps = (0..count as u32).map(move |i| first + step * i as f32);
        (taps, width)
    }

    /// The longer axis of the ellipse that the unit circle becomes, and the length of the shorter.
    fn axes(&self) -> (Vec3, f32) {
        let [a, b] = self.across.map(|x| x.clamp_length_max(WIDEST));
        let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
        let (mean, half) = (0.5 * (aa + bb), 0.5 * (aa - bb));
        let spread = (half * half + ab * ab).sqrt();
        let short = (mean - spread).max(0.0).sqrt();
        if !(spread > 1e-3 * mean) {
            return (a, short);
        }
        // The angle of the axis is half of that of (half, ab).
        let cosine = (0.5 * (1.0 + half / spread)).max(0.0).sqrt();
        let sine = (0.5 * (1.0 - half / spread)).max(0.0).sqrt().copysign(ab);
        (a * cosine + b * sine, short)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axes_are_the_singular_values() {
        let footprint = Footprint {
            across: [Vec3::new(0.03, 0.01, 0.0), Vec3::new(0.02, -0.02, 0.0)],
        };
        let (major, short) = footprint.axes();
        // Determinant and sum of squares of [[.03, .02], [.01, -.02]].
        assert!((major.length() * short - 8e-4).abs() < 1e-8);
        assert!((major.length_squared() + short * short - 1.8e-3).abs() < 1e-8);
    }

    #[test]
    fn taps_lie_evenly_along_the_longer_axis() {
        let footprint = Footprint {
            across: [Vec3::X * 0.04, Vec3::Y * 0.01],
        };
        let (taps, width) = footprint.taps();
        let taps: Vec<f32> = taps.map(|t| t.x).collect();
        assert_eq!(taps.len(), 4);
        assert!((width - 0.01).abs() < 1e-7 && (taps[0] + 0.015).abs() < 1e-7);
        assert_eq!(Footprint::POINT.taps().0.count(), 1);
    }
}
