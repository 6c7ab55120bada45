//! What is to be baked: everything that a chunk's content depends on, besides the manifold.

use geofan::{
    bundle::{Division, PlanRecord},
    fan::FanSpace,
};
use serde::{Deserialize, Serialize};

/// The plan of a bake.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The promise: 99th percentile of the screen error, mrad.
    pub max_error: f64,
    /// How far paths go.
    pub length: f64,
    /// Whether the transported rotation is stored.
    pub frames: bool,
    /// Local tolerance of the exact tracer.
    pub tolerance: f64,
    /// Nodes along each axis: camera…, direction…, arc length.
    pub nodes: Vec<usize>,
    /// Smallest box that is divided further, as a share of its chunk (arc length not counted).
    pub least_volume: f64,
    /// How often the arc length may be halved.
    pub most_arc_halvings: u32,
    /// Cells along each camera parameter.
    pub cells: Vec<usize>,
    /// Seed of the held-out rays.
    pub seed: u64,
}

/// The exact tracer's local tolerance as a share of the promised error: its own error must not
/// count. 1e-3 of it leaves the certificate unchanged to three digits.
const TOLERANCE_SHARE: f64 = 1e-3;

impl Plan {
    /// The plan for the rays of `space`.
    pub fn new(space: &FanSpace, length: f64, max_error: f64, frames: bool) -> Self {
        let axes = space.cameras().len() + space.directions();
        // Many nodes where few axes share them: large patches of high degree win on bytes, but a
        // patch costs nodes^axes rays.
        let (nodes, volume_bits, arc) = match axes {
            1 => (20, 11, 40),
            2 => (12, 11, 48),
            3 => (9, 14, 24),
            4 => (8, 14, 20),
            _ => (6, 15, 16),
        };
        let mut all = vec![nodes; axes];
        all.push(arc);
        Self {
            max_error,
            length,
            frames,
            tolerance: (max_error * 1e-3 * TOLERANCE_SHARE).clamp(1e-12, 1e-6),
            nodes: all,
            least_volume: 0.5_f64.powi(volume_bits),
            most_arc_halvings: 3,
            cells: vec![if axes <= 2 { 4 } else { 2 }; space.cameras().len()],
            seed: 1,
        }
    }

    /// How the table is divided into chunks.
    pub fn division(&self, space: &FanSpace) -> Division {
        Division {
            cells: self.cells.clone(),
            faces: space.faces(),
        }
    }

    /// The plan as a bundle's header holds it.
    pub fn record(&self) -> PlanRecord {
        let narrow = |sizes: &[usize]| sizes.iter().map(|n| *n as u32).collect();
        PlanRecord {
            max_error: self.max_error,
            length: self.length,
            frames: self.frames,
            tolerance: self.tolerance,
            nodes: narrow(&self.nodes),
            least_volume: self.least_volume,
            most_arc_halvings: self.most_arc_halvings,
            cells: narrow(&self.cells),
            seed: self.seed,
        }
    }
}
