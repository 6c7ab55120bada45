//! The offline side of geofan: what to bake, where and until when.
//!
//! In: a manifold file and a promise. Out: a bundle with its certificate. A bake is a fixed list of
//! chunks, each a pure function of manifold, [`plan`] and chunk number ([`refine`]); finished chunks
//! are immutable files ([`chunk_files`]) joined in order. Resuming, shards and equal bytes
//! for any number of threads follow from that.

mod attempts;
mod certify;
pub mod chunk_files;
pub mod chunks;
mod directions;
mod merge;
pub mod plan;
mod ray_errors;
pub mod refine;

pub use attempts::{BakeOptions, BakeResult, Share, SizeSoFar, USUAL_PROMISE, bake};
pub use certify::{RandomRays, certify};
pub use geofan_bundle::PROMISES;
pub use merge::{Merged, merge};
pub use ray_errors::{RayErrors, is_beyond_exit};
