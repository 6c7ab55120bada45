//! What a ray finds: the meeting point of all tracers, and the input of shading.

use super::{
    curve::{Curve, Ending},
    intersect::{Hit, first_hit},
    world::World,
};
use glam::Vec3;

/// What a ray finds at last. Kept small, because a frame writes and reads one for every sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Seen {
    /// A triangle.
    Surface(Hit),
    /// A sky, by exit, in a direction.
    Sky {
        /// Index in [`crate::manifold::Manifold::exits`].
        exit: u32,
        /// Arc length at the exit.
        s: f64,
        /// Unit vector.
        direction: Vec3,
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
            exit: exit as u32,
            s,
            direction: sky.as_vec3(),
        },
        Ending::Nowhere => Seen::Nothing,
    }
}
