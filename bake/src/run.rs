//! `geofan-bake MANIFOLD`: bakes until the promise is met and the size fits.

use crate::{
    args::{BakeArgs, loosest},
    finish::finish,
    job::{Ended, Job},
    parts::{Baked, Parts},
    plan::{plan, unmirrored},
    shard,
};
use geofan::{
    Error, Result,
    bundle::{Contents, PlanRecord, identity},
    fan::FanSpace,
    manifold::Manifold,
    terminal::{self, CommonArgs, Interrupt, Outcome},
};
use serde_json::json;
use std::{path::Path, sync::Arc, time::Instant};

/// The promise when none is asked for, mrad: half a pixel of a 1920-wide view of 90°.
const USUAL_PROMISE: f64 = 0.5;

/// By how much the promise is loosened at a time when the table is too large. Less bakes more
/// often, more gives away accuracy that would have fitted.
const LOOSENING: f64 = 1.5;

/// Bytes kept free for the certificate when sizes are compared before it exists.
const CERTIFICATE_ROOM: u64 = 256;

/// A bake of one manifold into one file, at whatever promise.
struct Bake<'a> {
    args: &'a BakeArgs,
    common: &'a CommonArgs,
    space: FanSpace,
    length: f64,
    parts: Parts,
    interrupt: Interrupt,
    started: Instant,
}

/// What came of one promise.
enum Attempt {
    Finished(Outcome),
    TooLarge(String),
}

/// Bakes.
///
/// # Errors
/// Bad input, a place that cannot be written, or an interruption.
pub fn run(args: &BakeArgs, common: &CommonArgs) -> Result<Outcome> {
    let interrupt = Interrupt::install()?;
    let manifold = Manifold::load(&args.manifold, &args.set)?;
    let length = manifold.length_or(args.length)?;
    let space = FanSpace::new(Arc::new(manifold))?;
    let bake = Bake {
        args,
        common,
        space,
        length,
        parts: open_parts(args)?,
        interrupt,
        started: Instant::now(),
    };
    let mut promise = args.max_error.unwrap_or(USUAL_PROMISE);
    loop {
        let reason = match bake.attempt(promise)? {
            Attempt::Finished(outcome) => return Ok(outcome),
            Attempt::TooLarge(reason) => reason,
        };
        let next = promise * LOOSENING;
        if args.max_error.is_some() || next > loosest() {
            return refuse(&reason, common);
        }
        tracing::info!("{reason}; going on with {next:.4} mrad");
        promise = next;
    }
}

fn open_parts(args: &BakeArgs) -> Result<Parts> {
    if args.output.is_dir() || args.output.file_name().is_none() {
        let name = args.output.display().to_string();
        return Err(Error::input(name, "is not the name of a file"));
    }
    let folder = args.output.parent().filter(|f| !f.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|f| !f.is_dir()) {
        let message = format!("the folder {} does not exist", folder.display());
        return Err(Error::input(args.output.display().to_string(), message));
    }
    let parts = Parts::open(&args.output)?;
    if !args.resume {
        match parts.discard()? {
            0 => {}
            n => tracing::info!("discarded {n} chunks of an earlier bake; --resume would use them"),
        }
    }
    Ok(parts)
}

/// The size limit and the promise exclude each other.
fn refuse(reason: &str, common: &CommonArgs) -> Result<Outcome> {
    let message = format!("{reason}; loosen --max-error or raise --max-size");
    terminal::line(&format!("error: {message}"));
    if common.json {
        terminal::print_json(&json!({ "error": { "message": message } }))?;
    }
    Ok(Outcome::CheckFailed)
}

impl Bake<'_> {
    fn attempt(&self, promise: f64) -> Result<Attempt> {
        let (space, frames) = (self.space.clone(), !self.args.no_frames);
        let (space, plan) = plan(space, self.length, promise, frames);
        let (space, plan) = match self.args.no_mirrors {
            true => unmirrored(space, plan),
            false => (space, plan),
        };
        let id = identity(space.manifold(), &plan).map_err(|e| e.about(&self.args.manifold))?;
        let job = Job {
            space: &space,
            plan: &plan,
            id,
            share: self.args.shard,
            most_bytes: self.args.max_size,
        };
        if let (Some(size), Some(limit)) = (self.parts.noted_size(id), self.args.max_size)
            && size > limit
        {
            return Ok(too_large(promise, limit, size, 1.0));
        }
        match job.run(&self.parts, &self.interrupt, self.common)? {
            Ended::Interrupted => Err(Error::Interrupted {
                resume: self.resume(),
            }),
            Ended::TooLarge { bytes, share } => {
                self.parts.note_size(id, bytes)?;
                let limit = self.args.max_size.unwrap_or(bytes);
                Ok(too_large(promise, limit, bytes, share))
            }
            Ended::Done(chunks) => self.join(space, plan, chunks),
        }
    }

    /// Writes the shard, or the bundle if it fits.
    fn join(
        &self,
        space: FanSpace,
        plan: PlanRecord,
        chunks: Vec<(u32, Baked)>,
    ) -> Result<Attempt> {
        let output: &Path = &self.args.output;
        let rays = chunks.iter().map(|(_, baked)| baked.rays).sum();
        let chunks = chunks.into_iter().map(|(chunk, baked)| (chunk, baked.tree));
        let max_error = plan.max_error;
        let contents = Contents::new(space, plan, self.args.certify_rays, chunks.collect())
            .map_err(|e| e.about(output))?;
        if let Some(share) = self.args.shard {
            let outcome = shard::write(contents, share, rays, output, self.common)?;
            self.parts.remove()?;
            return Ok(Attempt::Finished(outcome));
        }
        let size = contents.encode().map_err(|e| e.about(output))?.len() as u64;
        if let Some(limit) = self.args.max_size
            && size + CERTIFICATE_ROOM > limit
        {
            self.parts.note_size(contents.id, size + CERTIFICATE_ROOM)?;
            return Ok(too_large(max_error, limit, size, 1.0));
        }
        let resume = self.resume();
        let finished = finish(
            contents,
            rays,
            output,
            &resume,
            &self.interrupt,
            self.common,
        )?;
        self.parts.remove()?;
        let outcome = finished.report(output, self.started, self.common)?;
        Ok(Attempt::Finished(outcome))
    }

    fn resume(&self) -> String {
        let folder = self.parts.folder().display();
        let mut words: Vec<String> = std::env::args().map(|word| quoted(&word)).collect();
        if !self.args.resume {
            words.push("--resume".into());
        }
        format!(
            "finished chunks are in {folder}; go on with: {}",
            words.join(" ")
        )
    }
}

fn too_large(promise: f64, limit: u64, bytes: u64, share: f64) -> Attempt {
    let percent = 100.0 * share;
    Attempt::TooLarge(format!(
        "{promise:.4} mrad takes more than {limit} bytes ({bytes} for {percent:.0} % of the table)"
    ))
}

/// A word as a shell takes it back.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,+:@%".contains(c);
    match !word.is_empty() && word.chars().all(plain) {
        true => word.into(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_for_the_shell() {
        assert_eq!(quoted("a/b.toml"), "a/b.toml");
        assert_eq!(quoted("my file"), "'my file'");
        assert_eq!(quoted("it's"), r"'it'\''s'");
    }
}
