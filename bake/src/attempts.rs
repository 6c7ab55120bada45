//! A bake of one manifold: options, attempts until the promise is met and the size fits, and the files that it makes.
//!
//! In: a manifold and [`BakeOptions`]. Out: a bundle with its certificate ([`finish`]) or a shard, a file of some
//! chunks that knows which share it is ([`write_shard`]); or why there is none. How shards are joined is in `merge`.

use crate::{
    certify::certify,
    chunk_files::{BakedChunk, ChunkFiles},
    chunks::ChunkBaker,
    plan::{plan, plan_in_cells, unmirrored, usual_tangents},
};
use geofan_bundle::{
    Bundle, Contents, PROMISES, PlanRecord, ShardRecord, TangentPromise, container::Id, identity,
    rays::RaySpace,
};
use geofan_core::{
    Error, Observer, Progress, Result,
    files::{check_output, write_atomically},
    geodesic::UnfinishedPaths,
    manifold::Manifold,
};
use glam::{DMat3, DVec3};
use std::{
    io::Write,
    ops::ControlFlow,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
};

/// The promise when none is asked for, mrad: half a pixel of a 1920-wide view of 90°.
pub const USUAL_PROMISE: f64 = 0.5;

/// Factor by which the promise is loosened at a time when the table is too large. Less bakes more
/// often, more gives away accuracy that would have fitted.
const LOOSENING: f64 = 1.5;

/// Says what to bake of a manifold, and how well.
#[derive(Debug, Clone, PartialEq)]
pub struct BakeOptions {
    /// The promise: 99th percentile of the screen error, in mrad. `None` takes [`USUAL_PROMISE`], and
    /// lets a size limit loosen it.
    pub max_error: Option<f64>,
    /// Largest file in bytes.
    pub max_size: Option<u64>,
    /// Arc length of paths; `None` takes the manifold file's.
    pub length: Option<f64>,
    /// Set if tangents are promised, and with them transported frames.
    pub frames: bool,
    /// The promise of tangents: 99th percentile of the sky error, in mrad. `None` takes [`usual_tangents`].
    pub max_sky_error: Option<f64>,
    /// Set to leave out chunks that reflections or exchanges of coordinates carry into others.
    pub mirrors: bool,
    /// Cells along each camera parameter, each with chunks of its own; `None` takes the usual number.
    pub cells: Option<u32>,
    /// The share of the chunks to bake; all of them if `None`.
    pub share: Option<Share>,
    /// Set to use chunks that an interrupted bake left behind.
    pub resume: bool,
    /// Set to wait while another process bakes into the same file, instead of giving up.
    pub wait: bool,
    /// The share of a chunk (cameras, directions and arc lengths together) that may be flagged instead of halving boxes
    /// further; `None` takes the usual one, for spaces where edges divide paths.
    pub flagged: Option<f64>,
    /// Number of fresh random rays of the certificate.
    pub certify_rays: u64,
}

impl Default for BakeOptions {
    fn default() -> Self {
        Self {
            max_error: None,
            max_size: None,
            length: None,
            frames: true,
            max_sky_error: None,
            mirrors: true,
            cells: None,
            share: None,
            resume: false,
            wait: false,
            flagged: None,
            certify_rays: 20_000,
        }
    }
}

/// One share of the chunks: those whose number leaves `index` − 1 when divided by `of`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    /// From 1 to `of`.
    pub index: u32,
    /// The number of shares.
    pub of: u32,
}

impl Share {
    /// Tells whether `chunk` belongs to it.
    pub fn has(self, chunk: u32) -> bool {
        chunk % self.of == self.index - 1
    }
}

/// The bytes that a share of a table takes at least.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SizeSoFar {
    /// Bytes.
    pub bytes: u64,
    /// Share of the volume that is done, 1 of a whole table.
    pub share: f64,
}

impl SizeSoFar {
    /// Writes it for a note in a file.
    pub fn to_bytes(self) -> Vec<u8> {
        [self.bytes.to_le_bytes(), self.share.to_le_bytes()].concat()
    }

    /// Reads it again; `None` of anything else.
    pub fn from_bytes(note: &[u8]) -> Option<Self> {
        let (bytes, share) = note.split_first_chunk()?;
        Some(Self {
            bytes: u64::from_le_bytes(*bytes),
            share: f64::from_le_bytes(share.try_into().ok()?),
        })
    }
}

/// Says how a bake ended.
#[derive(Debug)]
pub enum BakeResult {
    /// With a bundle, which has been written.
    Bundle {
        /// The bundle with its certificate.
        bundle: Box<Bundle>,
        /// Size of its file.
        bytes: u64,
        /// The paths of the certificate's rays that end by their length or where the metric ends.
        unfinished: UnfinishedPaths,
    },
    /// With a shard of one, which has been written.
    Shard {
        /// Share of the chunks that it holds.
        share: Share,
        /// Size of its file.
        bytes: u64,
        /// Its number of chunks.
        chunks: usize,
    },
    /// Without a file, as promise and size limit exclude each other.
    TooLarge {
        /// Why, in words.
        reason: String,
        /// What to do.
        advice: &'static str,
    },
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
    let first = options.max_error.unwrap_or(USUAL_PROMISE);
    refuse_unresolved(&manifold, length, 1e-3 * first)?;
    let space = RaySpace::new(manifold)?;
    let bake = Bake {
        options,
        output,
        observer,
        space,
        length,
        files: open_files(output, options, observer)?,
    };
    let ended = bake.attempts(first);
    let keeps = matches!(
        ended,
        Ok(BakeResult::Bundle { .. } | BakeResult::Shard { .. }) | Err(Error::Interrupted { .. })
    );
    if !keeps && let Err(error) = bake.files.remove_unused() {
        // Why the bake failed is what matters.
        tracing::warn!("{error}");
    }
    ended
}

/// The least step of a table's numbers, and one over the largest of these: what a bundle holds has exponents of two of at
/// most 100, a few of which are taken by what is shared among cores.
const LEAST: f64 = 1e-27;

/// Refuses units in which a bundle cannot hold the numbers of paths, and steps of them as small as the `promise` (radians).
fn refuse_units(manifold: &Manifold, frame: DMat3, promise: f64) -> Result<()> {
    let lengths = [frame.x_axis, frame.y_axis, frame.z_axis].map(DVec3::length);
    let speed = lengths.into_iter().fold(0.0, f64::max);
    if speed * promise > LEAST && speed < 1.0 / LEAST {
        return Ok(());
    }
    let message = format!(
        "a length of 1 is {speed:.1e} in the chart at the cameras: tables hold from {:.0e} to {:.0e} at this promise; write the metric in other units",
        LEAST / promise,
        1.0 / LEAST
    );
    Err(Error::input(manifold.source.name.clone(), message))
}

/// Roundings of a camera's coordinates by which the end of a path may be off.
const ROUNDINGS: f64 = 20.0;

/// Refuses what no subdivision helps: units that no bundle holds, and paths so short that the rounding of coordinates
/// alone, seen from the camera, is more than the `promise` (radians).
fn refuse_unresolved(manifold: &Manifold, length: f64, promise: f64) -> Result<()> {
    let Some(region) = &manifold.cameras else {
        return Ok(());
    };
    let u = region.at(&region.lerp(&[0.5; 3]));
    let frame = manifold.standard_frame(u);
    refuse_units(manifold, frame, promise)?;
    let rounding = frame.inverse() * (u * f64::EPSILON);
    let shortest = ROUNDINGS * rounding.length() / promise;
    if !(length < shortest) {
        return Ok(());
    }
    let message = format!(
        "paths of length {length:e} are lost in the rounding of the coordinates at the cameras, where {shortest:.1e} is the shortest that can keep the promise; give a longer --length, or put the origin of the coordinates there"
    );
    Err(Error::input(manifold.source.name.clone(), message))
}

/// Opens the folder of finished chunks beside `output`, empty unless the bake is to be resumed.
fn open_files(output: &Path, options: &BakeOptions, observer: &dyn Observer) -> Result<ChunkFiles> {
    check_output(output)?;
    let files = match options.wait {
        true => ChunkFiles::open_when_free(output, observer)?,
        false => ChunkFiles::open(output)?,
    };
    if !options.resume {
        match files.discard()? {
            0 => {}
            n => tracing::info!(
                "discarded {n} chunks, finished or begun, of an earlier bake; --resume would use them"
            ),
        }
    }
    Ok(files)
}

/// How the bake ends, or why it goes on with a looser promise if it may.
type Attempt = ControlFlow<BakeResult, String>;

/// A bake of one manifold into one file, at any promise.
struct Bake<'a> {
    options: &'a BakeOptions,
    output: &'a Path,
    observer: &'a dyn Observer,
    space: RaySpace,
    length: f64,
    files: ChunkFiles,
}

impl Bake<'_> {
    /// Bakes at the promise `first`, and at looser ones where it may and must.
    fn attempts(&self, first: f64) -> Result<BakeResult> {
        let mut promise = first;
        loop {
            // What a first attempt finds is of an earlier bake.
            let reason = match self.attempt(promise, promise == first)? {
                Attempt::Continue(reason) => reason,
                Attempt::Break(ended) => return Ok(ended),
            };
            let next = promise * LOOSENING;
            if self.options.max_error.is_some() || next > *PROMISES.end() {
                let advice = "loosen --max-error or raise --max-size";
                return Ok(BakeResult::TooLarge { reason, advice });
            }
            tracing::info!("{reason}; going on with {next:.4} mrad");
            promise = next;
        }
    }

    /// Bakes at one promise, the `first` of this bake or a looser one.
    fn attempt(&self, promise: f64, first: bool) -> Result<Attempt> {
        // The plan, and the id that it gives the bundle.
        let (space, tangents) = (self.space.clone(), self.tangents(promise));
        let (length, observer) = (self.length, self.observer);
        let (space, plan) = match self.options.cells {
            None => plan(space, length, promise, tangents, observer)?,
            Some(cells) => plan_in_cells(space, (length, promise), tangents, cells, observer)?,
        };
        let (space, plan) = match self.options.mirrors {
            true => (space, plan),
            false => unmirrored(space, plan),
        };
        let manifold = space.manifold();
        let id =
            identity(manifold, &plan).map_err(|e| e.about(Path::new(&manifold.source.name)))?;
        // The same at every promise; with fields it takes a while.
        if let Some(limit) = self.options.max_size.filter(|_| first)
            && let Some(reason) = hopeless(limit, &space, &plan)?
        {
            let advice = "raise --max-size";
            return Ok(Attempt::Break(BakeResult::TooLarge { reason, advice }));
        }
        // An earlier attempt may have found it too large.
        if let (Some(size), Some(limit)) = (self.files.noted_size(id), self.options.max_size)
            && size.bytes > limit
        {
            return Ok(Attempt::Continue(too_large(promise, limit, size)));
        }
        self.files.begin(id, self.options.resume && first)?;
        let baker = ChunkBaker::new(&space, &plan, id, self.options);
        let Some(chunks) = baker.run(&self.files, self.observer)? else {
            return self.stopped(&baker, promise);
        };
        self.join(space, plan, chunks)
    }

    /// Returns what is promised of tangents where `promise` is that of points.
    fn tangents(&self, promise: f64) -> TangentPromise {
        match (self.options.frames, self.options.max_sky_error) {
            (false, _) => TangentPromise::None,
            (true, Some(own)) => TangentPromise::Own(own),
            (true, None) => usual_tangents(&self.space, promise),
        }
    }

    /// Says why not all chunks were baked.
    fn stopped(&self, baker: &ChunkBaker<'_>, promise: f64) -> Result<Attempt> {
        match self.options.max_size.zip(baker.excess()) {
            Some((limit, size)) => {
                self.files.note_size(baker.id, size)?;
                Ok(Attempt::Continue(too_large(promise, limit, size)))
            }
            None => Err(Error::Interrupted {
                resume: self.resume(),
            }),
        }
    }

    /// Writes the shard, or the bundle if it fits.
    fn join(
        &self,
        space: RaySpace,
        plan: PlanRecord,
        chunks: Vec<(u32, BakedChunk)>,
    ) -> Result<Attempt> {
        let output = self.output;
        let rays = chunks.iter().map(|(_, baked)| baked.rays).sum();
        let chunks = chunks.into_iter().map(|(chunk, baked)| (chunk, baked.tree));
        let contents = Contents::new(space, plan, self.options.certify_rays, chunks.collect())
            .map_err(|e| e.about(output))?;
        // A share of the chunks is a shard.
        if let Some(share) = self.options.share {
            let chunks = contents.chunks.len();
            let bytes = write_shard(contents, share, rays, output)?;
            self.files.remove()?;
            return Ok(Attempt::Break(BakeResult::Shard {
                share,
                bytes,
                chunks,
            }));
        }
        // All of them are a bundle.
        self.whole(contents, rays)
    }

    /// Writes the bundle if it fits. Without its certificate it may be too large already, and need none.
    fn whole(&self, contents: Contents, rays: u64) -> Result<Attempt> {
        let (output, id) = (self.output, contents.id);
        let max_error = contents.header.plan.max_error;
        let bare = contents.encode().map_err(|e| e.about(output))?;
        if let Some(reason) = self.exceeds(id, max_error, bare.len())? {
            return Ok(Attempt::Continue(reason));
        }
        let (bundle, unfinished) = finish(contents, rays, output, &self.resume(), self.observer)?;
        let file = bundle.contents().encode().map_err(|e| e.about(output))?;
        if let Some(reason) = self.exceeds(id, max_error, file.len())? {
            return Ok(Attempt::Continue(reason));
        }
        write_atomically(output, |out| out.write_all(&file))?;
        self.files.remove()?;
        Ok(Attempt::Break(BakeResult::Bundle {
            bundle: Box::new(bundle),
            bytes: file.len() as u64,
            unfinished,
        }))
    }

    /// Says why a whole table of so many `bytes` is too large, and notes it, if it is.
    fn exceeds(&self, id: Id, promise: f64, bytes: usize) -> Result<Option<String>> {
        let size = SizeSoFar {
            bytes: bytes as u64,
            share: 1.0,
        };
        let Some(limit) = self.options.max_size.filter(|limit| size.bytes > *limit) else {
            return Ok(None);
        };
        self.files.note_size(id, size)?;
        Ok(Some(too_large(promise, limit, size)))
    }

    /// Says where the work so far is.
    fn resume(&self) -> String {
        format!("what is finished is in {}", self.files.folder().display())
    }
}

/// Says that a table is too large.
fn too_large(promise: f64, limit: u64, SizeSoFar { bytes, share }: SizeSoFar) -> String {
    let percent = 100.0 * share;
    format!(
        "{promise:.4} mrad takes more than {limit} bytes ({bytes} for {percent:.0} % of the table)"
    )
}

/// Says why no promise makes a table short enough, if its file is longer than `limit` without any chunk.
///
/// # Errors
/// The manifold's text is too long for a header.
fn hopeless(limit: u64, space: &RaySpace, plan: &PlanRecord) -> Result<Option<String>> {
    let empty = Contents::new(space.clone(), plan.clone(), 0, Vec::new());
    let bytes = empty.and_then(|contents| contents.encode());
    let name = Path::new(&space.manifold().source.name);
    let least = bytes.map_err(|e| e.about(name))?.len() as u64;
    let reason = || {
        format!("a file of this manifold takes {least} bytes without any paths, more than {limit}")
    };
    Ok((least > limit).then(reason))
}

/// Measures the table of `contents`, which is to be the file `path`; returns the bundle with its certificate, and how the
/// paths of the certificate's rays end.
///
/// # Errors
/// Interrupted (`resume` says how to go on).
fn finish(
    contents: Contents,
    exact_rays: u64,
    path: &Path,
    resume: &str,
    observer: &dyn Observer,
) -> Result<(Bundle, UnfinishedPaths)> {
    let bundle = Bundle::from_contents(contents).map_err(|e| e.about(path))?;
    let (plan, rays) = (&bundle.header.plan, bundle.header.certify_rays);
    let certified = AtomicU64::new(0);
    let tell = |count| tell_certified(observer, (&certified, count, rays), resume);
    let checked = certify(
        &bundle.table,
        rays as usize,
        plan.seed,
        plan.tolerance,
        plan.max_error,
        tell,
    )?;
    let mut certificate = checked.certificate;
    certificate.exact_rays_baked = exact_rays;
    Ok((bundle.certified(certificate), checked.unfinished))
}

/// Writes the chunks of `share`; returns the size of the file.
///
/// # Errors
/// The place cannot be written.
fn write_shard(mut contents: Contents, share: Share, exact_rays: u64, path: &Path) -> Result<u64> {
    let Share { index, of } = share;
    contents.header.shard = Some(ShardRecord {
        index,
        of,
        exact_rays,
    });
    contents.write(path)
}

/// Tells the observer that `count` more of `rays` rays are compared.
///
/// # Errors
/// It ends the work; `resume` says how to go on.
pub(crate) fn tell_certified(
    observer: &dyn Observer,
    (certified, count, rays): (&AtomicU64, u64, u64),
    resume: &str,
) -> Result<()> {
    observer.progress(Progress {
        work: "certifying",
        done: certified.fetch_add(count, Relaxed) + count,
        total: rays,
        detail: "",
    });
    match observer.cancelled() {
        true => Err(Error::Interrupted {
            resume: resume.into(),
        }),
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_is_noted_with_the_share_that_it_is_of() {
        let size = SizeSoFar {
            bytes: 1 << 33,
            share: 0.41,
        };
        assert_eq!(SizeSoFar::from_bytes(&size.to_bytes()), Some(size));
        assert_eq!(SizeSoFar::from_bytes(&[0; 8]), None);
        let text = too_large(0.5, 9, size);
        assert!(text.contains("8589934592 for 41 %"), "{text}");
    }

    #[test]
    fn a_share_has_every_so_manieth_chunk() {
        let chunks = (0..7).filter(|c| Share { index: 2, of: 3 }.has(*c));
        assert_eq!(chunks.collect::<Vec<_>>(), [1, 4]);
    }
}
