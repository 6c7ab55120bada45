//! What is to be baked: everything that a chunk's content depends on, besides the manifold.

use crate::{focus, lift::best_lift, mirrors, sphere, tolerance};
use geofan_bundle::{
    MappedChebyshev, PlanRecord,
    rays::{ChartMap, RaySpace},
};

/// The tracer's local tolerance while the plan is made.
const FIRST_TOLERANCE: f64 = 1e-8;

/// Counts up when refinement changes: parts of another count are baked again.
pub const REFINEMENT: u32 = 14;

/// Sizes by the number of axes besides the arc length.
struct Sizes {
    /// The most nodes along a camera or direction axis. Many where few axes share them: large
    /// patches of high degree win on bytes.
    nodes: u32,
    /// The most nodes along the arc length.
    arc: u32,
    /// The most rays one patch is fitted to.
    rays: u32,
    /// The smallest box is `2^-bits` of its chunk.
    bits: i32,
    /// Cells along each camera parameter: what a camera has to decode.
    cells: u32,
}

fn sizes(cameras: usize, axes: usize) -> Sizes {
    let (nodes, arc, rays, bits, cells) = match axes {
        0 | 1 => (32, 60, 32, 11, 4),
        2 if cameras == 0 => (24, 48, 576, 11, 1),
        2 => (14, 48, 196, 11, 4),
        3 => (32, 40, 20_000, 14, 2),
        4 => (32, 32, 400_000, 14, 2),
        _ => (18, 24, 700_000, 15, 2),
    };
    Sizes {
        nodes,
        arc,
        rays,
        bits,
        cells,
    }
}

/// Boxes of few axes are halved towards what is rough in them, which then lies at their ends, where plain
/// Chebyshev polynomials have their nodes (Schwarzschild takes 4 % more bytes with α = 0.8). Those of more
/// axes are rough all over (three bumps 10 to 20 % fewer).
fn stretch(axes: usize) -> MappedChebyshev {
    match axes {
        ..3 => MappedChebyshev::NONE,
        _ => MappedChebyshev::new(0.85),
    }
}

/// The plan for the rays of `space`, and the space with its points stored as they are best.
pub fn plan(space: RaySpace, length: f64, max_error: f64, frames: bool) -> (RaySpace, PlanRecord) {
    let axes = space.cameras().len() + space.directions();
    let sizes = sizes(space.cameras().len(), axes);
    let mut nodes = vec![sizes.nodes; axes];
    nodes.push(sizes.arc);
    let mut plan = PlanRecord {
        max_error,
        length,
        frames,
        tolerance: FIRST_TOLERANCE,
        nodes,
        most_rays: sizes.rays,
        lift: ChartMap::None,
        refinement: REFINEMENT,
        least_volume: 0.5_f64.powi(sizes.bits),
        most_arc_halvings: 3,
        cells: vec![sizes.cells; space.cameras().len()],
        stretch: stretch(axes),
        focus: [[0.0; 3]; 3],
        sphere: None,
        mirrors: Vec::new(),
        seed: 1,
    };
    plan.mirrors = mirrors::of(&space, &plan);
    plan.lift = best_lift(&space, &plan);
    plan.tolerance = tolerance::needed(&space, &plan);
    plan.sphere = sphere::axes(&space, &plan);
    plan.focus = focus::best(&space, &plan);
    (plan.applied(space), plan)
}

/// The same without discrete symmetries.
pub fn unmirrored(space: RaySpace, mut plan: PlanRecord) -> (RaySpace, PlanRecord) {
    plan.mirrors = Vec::new();
    plan.sphere = sphere::axes(&space, &plan);
    (plan.applied(space), plan)
}
