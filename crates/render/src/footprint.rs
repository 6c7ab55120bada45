//! What a sample stands for: a small parallelogram of a sky or of a texture.
//!
//! In: how a direction (or texture coordinates) changes to the next sample on the right and the next
//! below. Out: the axes of the ellipse through them, and footprints along its longer axis, round or not
//! too long, that cover it. Without branches, so that a loop over samples takes vector instructions.

use super::sky::nearest;
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

/// Most footprints that stand for a long one: at eight round ones a footprint of one to eight is covered,
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
    #[inline(always)]
    pub fn scaled(self, factor: f32) -> Self {
        let [right, down] = self.across;
        Self {
            across: [right * factor, down * factor],
        }
    }

    /// The footprints that cover this, each round or no longer than `longest`.
    #[inline(always)]
    pub fn taps(&self, longest: f32) -> Taps {
        let (major, short) = self.axes();
        let long = major.length();
        let each = short.max(longest).max(1e-12);
        let count = nearest((long / each).clamp(1.0, MOST_TAPS));
        let step = major * (1.0 / count);
        let length = long / count;
        // Their number is rounded, so they may be half as long again; beyond that there are not enough.
        let round = length > 1.5 * longest;
        Taps {
            first: step * (0.5 - 0.5 * count),
            step,
            count,
            width: if round { short.max(length) } else { short }.min(WIDEST),
        }
    }

    /// The longer axis of the ellipse that the unit circle becomes, and the length of the shorter.
    #[inline(always)]
    fn axes(&self) -> (Vec3, f32) {
        let (a, b) = (shortened(self.across[0]), shortened(self.across[1]));
        let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
        let (mean, half) = (0.5 * (aa + bb), 0.5 * (aa - bb));
        let spread = (half * half + ab * ab).sqrt();
        let short = (mean - spread).max(0.0).sqrt();
        // The angle of the axis is half of that of (half, ab); its smaller side follows from the
        // larger, as a difference would lose digits. A circle has no axis: any will do.
        let larger = (0.5 * (1.0 + half.abs() / spread)).sqrt();
        let smaller = 0.5 * ab.abs() / (spread * larger);
        let (cosine, sine) = if half > 0.0 {
            (larger, smaller)
        } else {
            (smaller, larger)
        };
        let long = spread > 1e-3 * mean;
        let cosine = if long { cosine } else { 1.0 };
        let sine = if long { sine.copysign(ab) } else { 0.0 };
        (a * cosine + b * sine, short)
    }
}

/// Footprints evenly along a line, each as long as they are apart.
#[derive(Debug, Clone, Copy)]
pub struct Taps {
    /// Displacement of the first.
    pub first: Vec3,
    /// From each to the next.
    pub step: Vec3,
    /// How many: a whole number from 1 to 8.
    pub count: f32,
    /// How wide each is across the line.
    pub width: f32,
}

impl Taps {
    /// The displacement of number `i`.
    #[inline(always)]
    pub fn at(&self, i: f32) -> Vec3 {
        self.first + self.step * i
    }

    /// All displacements.
    #[inline]
    pub fn places(&self) -> impl Iterator<Item = Vec3> {
        (0..self.count as u32).map(|i| self.at(i as f32))
    }
}

/// No longer than the widest footprint.
#[inline(always)]
fn shortened(x: Vec3) -> Vec3 {
    x * (WIDEST / x.length()).min(1.0)
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
        let taps = footprint.taps(0.0);
        let places: Vec<f32> = taps.places().map(|t| t.x).collect();
        assert_eq!(places.len(), 4);
        assert!((taps.width - 0.01).abs() < 1e-7 && (places[0] + 0.015).abs() < 1e-7);
        assert_eq!(Footprint::POINT.taps(0.0).places().count(), 1);
        // Two that may be long are enough, and are as narrow as the whole.
        let taps = footprint.taps(0.02);
        assert_eq!(taps.places().count(), 2);
        assert!((taps.width - 0.01).abs() < 1e-7 && (taps.step.length() - 0.02).abs() < 1e-7);
    }
}
