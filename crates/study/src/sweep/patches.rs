//! A bundle as a point of the sweep.
//!
//! In: the rays of a space, a promise, limits. Out: the bundle that `geofan-bake` makes for it, or
//! which limit it met.

use crate::sweep::clock::{Clock, Spent};
use geofan_bake::{chunk_files::ChunkFiles, chunks::ChunkBaker, plan::plan};
use geofan_bundle::{Bundle, Contents, PlanRecord, Tree, identity, rays::RaySpace};
use geofan_core::{Error, Muted, Observer, Progress, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// How patches are refined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Refinement {
    /// As bundles are: boxes halved until held-out rays meet the promise.
    Adaptive,
    /// Boxes are not halved; what one polynomial cannot hold is flagged. It shows what halving is
    /// worth.
    Undivided,
}

impl Refinement {
    fn apply(self, plan: &mut PlanRecord) {
        if self == Self::Undivided {
            plan.least_volume = 1.0;
            plan.most_arc_halvings = 0;
        }
    }
}

/// What a bake may take.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// Processor seconds for a bundle, all threads together.
    pub seconds: f64,
    /// Bytes of a grid in single precision.
    pub grid_bytes: u64,
}

/// How a bake ended.
#[derive(Debug)]
pub enum Attempt {
    /// With a bundle.
    Baked(Box<Baked>),
    /// At a limit, in words.
    Skipped(String),
}

/// A bundle and what it took.
#[derive(Debug)]
pub struct Baked {
    /// The bundle, without a certificate.
    pub bundle: Bundle,
    /// Its file's bytes.
    pub bytes: u64,
    /// Time of the bake.
    pub spent: Spent,
    /// Rays integrated.
    pub rays: u64,
}

/// Bakes into the file `path`.
///
/// # Errors
/// Interrupted, or the place cannot be written.
pub fn bake(
    space: RaySpace,
    length: f64,
    (promise, refinement): (f64, Refinement),
    limits: Limits,
    path: &Path,
    observer: &dyn Observer,
) -> Result<Attempt> {
    let clock = Clock::start();
    let (space, mut plan) = plan(space, length, promise, true, &Muted(observer))?;
    refinement.apply(&mut plan);
    let space = plan.applied(space);
    let id = identity(space.manifold(), &plan).map_err(|e| e.about(path))?;
    let files = ChunkFiles::open(path)?;
    // Chunks of an earlier run would make this bake look quicker than it is.
    files.discard()?;
    // The bytes that are counted while a bake runs are an estimate, at times far too large.
    let most_bytes = None;
    let baker = ChunkBaker::new(&space, &plan, id, None, most_bytes);
    let limited = Limited {
        observer,
        clock: Clock::start(),
        seconds: limits.seconds,
    };
    let ended = baker.run(&files, &limited)?;
    files.remove()?;
    let chunks = match ended {
        Some(chunks) => chunks,
        None if observer.cancelled() => return Err(interrupted()),
        None => {
            let why = format!(
                "skipped: not finished after {:.0} s of processor time",
                limits.seconds
            );
            return Ok(Attempt::Skipped(why));
        }
    };
    let rays = chunks.iter().map(|(_, baked)| baked.rays).sum();
    let chunks = chunks.into_iter().map(|(chunk, baked)| (chunk, baked.tree));
    let contents = Contents::new(space, plan, 0, chunks.collect()).map_err(|e| e.about(path))?;
    let spent = clock.spent();
    let bytes = contents.write(path)?;
    let bundle = Bundle::from_contents(contents).map_err(|e| e.about(path))?;
    Ok(Attempt::Baked(Box::new(Baked {
        bundle,
        bytes,
        spent,
        rays,
    })))
}

/// What an interrupted sweep says.
pub fn interrupted() -> Error {
    Error::Interrupted {
        resume: "measured points are kept; run the same command again to go on".into(),
    }
}

/// Ends work that takes too long. A sweep shows progress of its own.
struct Limited<'a> {
    observer: &'a dyn Observer,
    clock: Clock,
    seconds: f64,
}

impl Observer for Limited<'_> {
    fn progress(&self, _: Progress<'_>) {}

    fn cancelled(&self) -> bool {
        self.observer.cancelled() || self.clock.spent().cpu_s > self.seconds
    }
}

impl Baked {
    /// Bytes when every patch is decoded: the coded chunks stay, and every integer takes 32 bits.
    ///
    /// # Errors
    /// A chunk is damaged.
    pub fn memory(&self) -> Result<u64> {
        let mut sum = 0;
        for chunk in &self.bundle.table.chunks {
            let tree = chunk.tree();
            let tree = tree.map_err(|e| Error::input("bundle", e.to_string()))?;
            sum += chunk.bytes().len() as u64 + 4 * integers(tree);
        }
        Ok(sum)
    }
}

fn integers(tree: &Tree) -> u64 {
    match tree {
        Tree::Flagged => 0,
        Tree::Split { halves, .. } => halves.iter().map(integers).sum(),
        Tree::Faces(faces) => faces.iter().map(integers).sum(),
        Tree::Leaf(tensor) => tensor.integers() as u64,
    }
}
