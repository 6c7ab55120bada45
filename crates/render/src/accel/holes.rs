//! Holes in triangles: where the opacity of their material is zero.
//!
//! In: triangles with opacity maps. Out: whether a point of one is open. What is open is not met by
//! anything: not by paths of any tracer, and not by light on its way to a surface.

use crate::scene::OpacityMap;

/// Opacities below this are none: half a step of a file with eight bits.
pub const OPEN: f32 = 0.5 / 255.0;

/// A triangle with an opacity map.
#[derive(Debug, Clone)]
pub struct HoledTriangle {
    /// The triangle's number.
    pub triangle: u32,
    /// Texture coordinates at its corners.
    pub uvs: [[f32; 2]; 3],
    /// Its opacity.
    pub map: OpacityMap,
}

impl HoledTriangle {
    /// Returns the opacity where the second and third corner have these weights.
    pub fn opacity(&self, [b, c]: [f32; 2]) -> f32 {
        let [p, q, r] = self.uvs;
        self.map
            .at([0, 1].map(|k| p[k] * (1.0 - b - c) + q[k] * b + r[k] * c))
    }
}

/// All triangles of a set that have opacity maps, by number.
#[derive(Debug, Clone, Default)]
pub struct Holes(Vec<HoledTriangle>);

impl Holes {
    /// Sorts them.
    pub fn new(mut all: Vec<HoledTriangle>) -> Self {
        all.sort_by_key(|holed| holed.triangle);
        Self(all)
    }

    /// Returns the opacity map of a triangle, if it has one.
    pub fn of(&self, triangle: u32) -> Option<&HoledTriangle> {
        let found = self.0.binary_search_by_key(&triangle, |h| h.triangle);
        found.ok().map(|i| &self.0[i])
    }

    /// Tells whether a triangle is open where its second and third corner have these weights.
    #[cold]
    pub fn is_open(&self, triangle: u32, weights: [f32; 2]) -> bool {
        let holed = self.of(triangle);
        holed.is_some_and(|holed| holed.opacity(weights) < OPEN)
    }
}
