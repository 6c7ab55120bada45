//! Bakes until the promise is met and the size fits.

use crate::{
    finish::{Finished, finish},
    job::{Ended, Job},
    options::{BakeOptions, PROMISES, USUAL_PROMISE},
    parts::{Baked, Parts},
    plan::{plan, unmirrored},
    shard::{self, WrittenShard},
};
use geofan_bundle::{Contents, PlanRecord, identity, rays::RaySpace};
use geofan_core::{Error, Observer, Result, manifold::Manifold};
use std::{path::Path, sync::Arc};

/// By how much the promise is loosened at a time when the table is too large. Less bakes more
/// often, more gives away accuracy that would have fitted.
const LOOSENING: f64 = 1.5;

/// Bytes kept free for the certificate when sizes are compared before it exists.
const CERTIFICATE_ROOM: u64 = 256;

/// Says how a bake ended.
#[derive(Debug)]
pub enum BakeResult {
    /// With a bundle.
    Bundle(Box<Finished>),
    /// With a shard of one.
    Shard(WrittenShard),
    /// Without a file, as promise and size limit exclude each other: why, in words.
    TooLarge(String),
}

/// A bake of one manifold into one file, at whatever promise.
struct Bake<'a> {
    options: &'a BakeOptions,
    output: &'a Path,
    observer: &'a dyn Observer,
    space: RaySpace,
    length: f64,
    parts: Parts,
}

/// Bakes `manifold` into the file `output`.
///
/// # Errors
/// Bad input, a place that cannot be written, or an interruption.
pub fn bake(
    manifold: Arc<Manifold>,
    output: &Path,
    options: &BakeOptions,
    observer: &dyn Observer,
) -> Result<BakeResult> {
    let length = manifold.length_or(options.length)?;
    let space = RaySpace::new(manifold)?;
    let bake = Bake {
        options,
        output,
        observer,
        space,
        length,
        parts: open_parts(output, options.resume)?,
    };
    let mut promise = options.max_error.unwrap_or(USUAL_PROMISE);
    loop {
        let reason = match bake.attempt(promise)? {
            BakeResult::TooLarge(reason) => reason,
            ended => return Ok(ended),
        };
        let next = promise * LOOSENING;
        if options.max_error.is_some() || next > *PROMISES.end() {
            return Ok(BakeResult::TooLarge(reason));
        }
        tracing::info!("{reason}; going on with {next:.4} mrad");
        promise = next;
    }
}

fn open_parts(output: &Path, resume: bool) -> Result<Parts> {
    if output.is_dir() || output.file_name().is_none() {
        let name = output.display().to_string();
        return Err(Error::input(name, "is not the name of a file"));
    }
    let folder = output.parent().filter(|f| !f.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|f| !f.is_dir()) {
        let message = format!("the folder {} does not exist", folder.display());
        return Err(Error::input(output.display().to_string(), message));
    }
    let parts = Parts::open(output)?;
    if !resume {
        match parts.discard()? {
            0 => {}
            n => tracing::info!("discarded {n} chunks of an earlier bake; --resume would use them"),
        }
    }
    Ok(parts)
}

impl Bake<'_> {
    fn attempt(&self, promise: f64) -> Result<BakeResult> {
        let (space, frames) = (self.space.clone(), self.options.frames);
        let (space, plan) = plan(space, self.length, promise, frames);
        let (space, plan) = match self.options.mirrors {
            true => (space, plan),
            false => unmirrored(space, plan),
        };
        let manifold = space.manifold();
        let id =
            identity(manifold, &plan).map_err(|e| e.about(Path::new(&manifold.source.name)))?;
        let job = Job {
            space: &space,
            plan: &plan,
            id,
            share: self.options.share,
            most_bytes: self.options.max_size,
        };
        if let (Some(size), Some(limit)) = (self.parts.noted_size(id), self.options.max_size)
            && size > limit
        {
            return Ok(too_large(promise, limit, size, 1.0));
        }
        match job.run(&self.parts, self.observer)? {
            Ended::Interrupted => Err(Error::Interrupted {
                resume: self.resume(),
            }),
            Ended::TooLarge { bytes, share } => {
                self.parts.note_size(id, bytes)?;
                let limit = self.options.max_size.unwrap_or(bytes);
                Ok(too_large(promise, limit, bytes, share))
            }
            Ended::Done(chunks) => self.join(space, plan, chunks),
        }
    }

    /// Writes the shard, or the bundle if it fits.
    fn join(
        &self,
        space: RaySpace,
        plan: PlanRecord,
        chunks: Vec<(u32, Baked)>,
    ) -> Result<BakeResult> {
        let output = self.output;
        let rays = chunks.iter().map(|(_, baked)| baked.rays).sum();
        let chunks = chunks.into_iter().map(|(chunk, baked)| (chunk, baked.tree));
        let max_error = plan.max_error;
        let contents = Contents::new(space, plan, self.options.certify_rays, chunks.collect())
            .map_err(|e| e.about(output))?;
        if let Some(share) = self.options.share {
            let written = shard::write(contents, share, rays, output)?;
            self.parts.remove()?;
            return Ok(BakeResult::Shard(written));
        }
        let size = contents.encode().map_err(|e| e.about(output))?.len() as u64;
        if let Some(limit) = self.options.max_size
            && size + CERTIFICATE_ROOM > limit
        {
            self.parts.note_size(contents.id, size + CERTIFICATE_ROOM)?;
            return Ok(too_large(max_error, limit, size, 1.0));
        }
        let finished = finish(contents, rays, output, &self.resume(), self.observer)?;
        self.parts.remove()?;
        Ok(BakeResult::Bundle(Box::new(finished)))
    }

    fn resume(&self) -> String {
        format!("finished chunks are in {}", self.parts.folder().display())
    }
}

fn too_large(promise: f64, limit: u64, bytes: u64, share: f64) -> BakeResult {
    let percent = 100.0 * share;
    BakeResult::TooLarge(format!(
        "{promise:.4} mrad takes more than {limit} bytes ({bytes} for {percent:.0} % of the table)"
    ))
}
