#![deny(unsafe_code)]
#![warn(missing_docs)]
//! The offline side of geofan: what to bake, where and until when.
//!
//! In: a manifold file and a promise. Out: a bundle with its certificate. A bake is a fixed list of
//! chunks, each a pure function of manifold, [`plan`] and chunk number ([`refine`]); finished chunks
//! are immutable files ([`parts`]) joined in order ([`job`], [`shard`], [`finish`]). Resuming,
//! shards and equal bytes for any number of threads follow from that.

pub mod args;
pub mod demo;
pub mod finish;
mod focus;
pub mod job;
mod lift;
mod mirrors;
pub mod parts;
pub mod plan;
pub mod refine;
pub mod run;
pub mod shard;
mod sphere;
pub mod sweep;
mod tolerance;
