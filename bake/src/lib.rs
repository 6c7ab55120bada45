//! The offline side of geofan: what to bake, where and until when.
//!
//! In: a manifold file and a promise. Out: a bundle with its certificate. A bake is a fixed list of
//! chunks, each a pure function of manifold, [`plan`] and chunk number ([`refine`]); finished chunks
//! are immutable files ([`parts`]) joined in order ([`job`], [`shard`], [`finish`]). Resuming,
//! shards and equal bytes for any number of threads follow from that.

mod certificate;
pub mod finish;
mod focus;
pub mod job;
mod lift;
mod mirrors;
mod options;
pub mod parts;
pub mod plan;
mod random_rays;
pub mod refine;
mod run;
pub mod shard;
mod sphere;
mod tolerance;

pub use certificate::certify;
pub use finish::Finished;
pub use options::{BakeOptions, PROMISES, Share, USUAL_PROMISE};
pub use random_rays::RandomRays;
pub use run::{BakeResult, bake};
pub use shard::{WrittenShard, merge};
