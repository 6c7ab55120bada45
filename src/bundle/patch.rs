//! A patch: one polynomial for all paths of a box of (camera, direction, arc length).

use super::tensor::Tensor;

/// A leaf of the table: displacement, and rotation unless left out.
#[derive(Debug, Clone)]
pub struct Patch {
    /// Displacement channels.
    pub displacement: Tensor,
    /// Quaternion channels.
    pub rotation: Option<Tensor>,
}

impl Patch {
    /// About how many bytes it takes in a bundle.
    pub fn bytes(&self) -> f64 {
        self.displacement.bytes() + self.rotation.as_ref().map_or(0.0, Tensor::bytes)
    }
}
