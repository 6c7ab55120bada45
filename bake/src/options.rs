//! Options of a bake.

use std::ops::RangeInclusive;

/// Says what to bake of a manifold, and how well.
#[derive(Debug, Clone, PartialEq)]
pub struct BakeOptions {
    /// The promise: 99th percentile of the screen error, in mrad. `None` takes [`USUAL_PROMISE`], and
    /// lets a size limit loosen it.
    pub max_error: Option<f64>,
    /// Largest file in bytes.
    pub max_size: Option<u64>,
    /// Arc length of paths; `None` takes the manifold file's.
    pub length: Option<f64>,
    /// Whether tangents are promised, and with them transported frames.
    pub frames: bool,
    /// Whether chunks that reflections or exchanges of coordinates carry into others are left out.
    pub mirrors: bool,
    /// The share of the chunks to bake; all of them if `None`.
    pub share: Option<Share>,
    /// Whether to use chunks that an interrupted bake left behind.
    pub resume: bool,
    /// Number of fresh random rays of the certificate.
    pub certify_rays: u64,
}

impl Default for BakeOptions {
    fn default() -> Self {
        Self {
            max_error: None,
            max_size: None,
            length: None,
            frames: true,
            mirrors: true,
            share: None,
            resume: false,
            certify_rays: 20_000,
        }
    }
}

/// The promise when none is asked for, mrad: half a pixel of a 1920-wide view of 90°.
pub const USUAL_PROMISE: f64 = 0.5;

/// The tightest and the loosest promise, mrad: below the first the exact tracer itself is not
/// exact enough; above the second a picture shows nothing.
pub const PROMISES: RangeInclusive<f64> = 1e-5..=1e3;

/// One share of the chunks: those whose number leaves `index` − 1 when divided by `of`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    /// From 1 to `of`.
    pub index: u32,
    /// The number of shares.
    pub of: u32,
}

impl Share {
    /// Whether `chunk` belongs to it.
    pub fn has(self, chunk: u32) -> bool {
        chunk % self.of == self.index - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_has_every_so_manieth_chunk() {
        let chunks = (0..7).filter(|c| Share { index: 2, of: 3 }.has(*c));
        assert_eq!(chunks.collect::<Vec<_>>(), [1, 4]);
    }
}
