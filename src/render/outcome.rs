//! What a ray finds: the meeting point of all tracers, and the input of shading.

use super::{
    curve::{Curve, Ending},
    intersect::{Hit, first_hit},
    world::World,
};
use glam::DVec3;

/// What a ray finds at last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Seen {
    /// A triangle.
    Surface(Hit),
    /// A sky, by exit, in a direction.
    Sky {
        /// Index in [`crate::manifold::Manifold::exits`].
        exit: usize,
        /// Arc length at the exit.
        s: f64,
        /// Unit vector.
        direction: DVec3,
    },
    /// Nothing: the path ended before anything.
    Nothing,
}

/// What one sample of the picture finds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// What is there.
    pub seen: Seen,
    /// Whether a table gave up on the ray.
    pub flagged: bool,
}

/// Intersects a curve with the world.
pub fn outcome(world: &World, curve: &Curve) -> Outcome {
    let limit = curve.ending.limit();
    let mut hits = curve
        .pieces()
        .filter_map(|piece| first_hit(&world.accelerator, &world.manifold.domain, &piece, limit));
    let seen = match hits.next() {
        Some(hit) => Seen::Surface(hit),
        None => beyond(&curve.ending),
    };
    Outcome {
        seen,
        flagged: curve.flagged,
    }
}

/// What is seen where no surface is in the way.
pub fn beyond(ending: &Ending) -> Seen {
    match *ending {
        Ending::Exit { exit, s, sky } => Seen::Sky {
            exit,
            s,
            direction: sky,
        },
        Ending::Nowhere => Seen::Nothing,
    }
}
