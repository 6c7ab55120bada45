//! Shards joined to a bundle, however large they are.
//!
//! In: all shards of one bake. Out: the bundle's file, byte for byte the one that an undivided bake makes. Chunks stay in
//! the shards: they are read once to see that they are whole, once for the certificate, whose cameras are taken in the
//! order of the chunks that they need, and once for the file. In memory are [`TOGETHER`] bytes of them at a time.

use crate::{
    attempts::tell_certified,
    certify::{CertificateErrors, CertificateRays},
};
use geofan_bundle::{
    Chunk, DecodeBudget, Header, StoredChunks, StoredContents, Table, Tree,
    container::{Id, MOST_BYTES},
    rays::RaySpace,
    write_chunks,
};
use geofan_core::{
    Error, Observer, Result,
    files::{check_not_read, check_output},
    geodesic::UnfinishedPaths,
};
use rayon::prelude::*;
use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicU64},
};

/// Bytes of coded chunks that are in memory together, and decoded take up to sixty times that. More of them are
/// there only if a single camera needs more.
const TOGETHER: u64 = 8 << 20;

/// What to do after an interruption.
const RESUME: &str = "the shards are untouched; run the same command again";

/// A bundle that has been written.
#[derive(Debug)]
pub struct Merged {
    /// Its header, with the certificate.
    pub header: Header,
    /// Its rays.
    pub space: RaySpace,
    /// Size of its file.
    pub bytes: u64,
    /// The paths of the certificate's rays that end by their length or where the metric ends.
    pub unfinished: UnfinishedPaths,
    /// Its patches.
    pub patches: usize,
    /// The boxes that it gives up.
    pub flagged_boxes: usize,
}

/// Joins shards into a bundle at `output`, and measures it.
///
/// # Errors
/// The shards are not all shards of one bake, or the place cannot be written or is one of them.
pub fn merge(shards: &[PathBuf], output: &Path, observer: &dyn Observer) -> Result<Merged> {
    merge_by(shards, output, observer, TOGETHER)
}

/// Joins shards; at most `together` bytes of their chunks are in memory at once.
fn merge_by(
    shards: &[PathBuf],
    output: &Path,
    observer: &dyn Observer,
    together: u64,
) -> Result<Merged> {
    check_not_read(output, shards)?;
    check_output(output)?;
    let shards = Shards::open(shards, observer)?;
    let (header, unfinished, counts) = Measuring::new(&shards, observer, together).measured()?;
    let parts = (&header, shards.id, &shards.space);
    let bytes = write_chunks(output, parts, &shards.chunks, |chunk| {
        match observer.cancelled() {
            true => Err(interrupted()),
            false => shards.read(chunk),
        }
    })?;
    if bytes > MOST_BYTES {
        tracing::warn!(
            "{} has {bytes} bytes: this version opens bundles of {MOST_BYTES} at most",
            output.display()
        );
    }
    Ok(Merged {
        header,
        space: shards.space,
        bytes,
        unfinished,
        patches: counts.0,
        flagged_boxes: counts.1,
    })
}

fn interrupted() -> Error {
    Error::Interrupted {
        resume: RESUME.into(),
    }
}

/// All shards of a bake.
struct Shards {
    /// The header of the bundle, yet without a certificate.
    header: Header,
    id: Id,
    space: RaySpace,
    exact_rays: u64,
    /// Numbers and bytes of all chunks, in ascending order.
    chunks: Vec<(u32, u64)>,
    /// The chunks of each shard, by its index.
    stored: Vec<StoredChunks>,
}

impl Shards {
    /// Opens them and checks that they are all shards of one bake: each is read through.
    fn open(paths: &[PathBuf], observer: &dyn Observer) -> Result<Self> {
        let wrong =
            |k: usize, message: String| Error::input(paths[k].display().to_string(), message);
        let mut first: Option<StoredContents> = None;
        let mut found: Vec<(u32, usize, StoredChunks)> = Vec::new();
        let mut exact_rays = 0_u64;
        for (k, path) in paths.iter().enumerate() {
            if observer.cancelled() {
                return Err(interrupted());
            }
            let shard = StoredContents::open(path)?;
            let record = shard.header.shard;
            let record = record.ok_or_else(|| wrong(k, "is a whole bundle, not a shard".into()))?;
            let same = first.as_ref().is_none_or(|first| same_bake(first, &shard));
            if !same {
                let first = paths[0].display();
                return Err(wrong(k, format!("is not of the same bake as {first}")));
            }
            if let Some((_, twin, _)) = found.iter().find(|(index, ..)| *index == record.index) {
                let twin = paths[*twin].display();
                return Err(wrong(k, format!("is the same share as {twin}")));
            }
            exact_rays = exact_rays.saturating_add(record.exact_rays);
            found.push((record.index, k, shard.chunks.clone()));
            first.get_or_insert(shard);
        }
        let Some(mut first) = first else {
            return Err(Error::input("merge", "there are no shards"));
        };
        // None is missing.
        found.sort_by_key(|(index, ..)| *index);
        let of = first.header.shard.map_or(0, |shard| shard.of);
        let indices: BTreeSet<u32> = found.iter().map(|(index, ..)| *index).collect();
        let missing = (1..=of).filter(|index| !indices.contains(index));
        let missing: Vec<String> = missing.map(|index| index.to_string()).collect();
        if !missing.is_empty() {
            let message = format!("missing of its {of} shards: {}", missing.join(", "));
            return Err(Error::input("the bake", message));
        }
        let stored: Vec<StoredChunks> = found.into_iter().map(|(_, _, chunks)| chunks).collect();
        let mut chunks: Vec<(u32, u64)> = stored.iter().flat_map(StoredChunks::list).collect();
        chunks.sort_unstable();
        first.header.shard = None;
        Ok(Self {
            header: first.header,
            id: first.id,
            space: first.space,
            exact_rays,
            chunks,
            stored,
        })
    }

    /// Reads a chunk.
    fn read(&self, chunk: u32) -> Result<Vec<u8>> {
        self.stored[chunk as usize % self.stored.len()].read(chunk)
    }

    /// Counts the bytes of these chunks.
    fn bytes(&self, chunks: impl IntoIterator<Item = usize>) -> u64 {
        chunks.into_iter().map(|chunk| self.chunks[chunk].1).sum()
    }
}

/// Tells whether two shards differ in nothing but their share.
fn same_bake(a: &StoredContents, b: &StoredContents) -> bool {
    let of = |c: &StoredContents| c.header.shard.map(|s| s.of);
    let header = |c: &StoredContents| {
        let mut header = c.header.clone();
        header.shard = None;
        header
    };
    a.id == b.id && of(a) == of(b) && header(a) == header(b)
}

/// A camera of the certificate, and the chunks that it needs.
type Need = (Vec<usize>, usize);

/// The measuring of a table whose chunks are in shards.
struct Measuring<'a> {
    shards: &'a Shards,
    observer: &'a dyn Observer,
    /// Bytes of chunks in memory at a time.
    together: u64,
    rays: CertificateRays,
    /// The table without its chunks.
    table: Table,
    /// Patches and flagged boxes of the chunks that have been decoded.
    counts: Vec<Option<(usize, usize)>>,
}

impl<'a> Measuring<'a> {
    fn new(shards: &'a Shards, observer: &'a dyn Observer, together: u64) -> Self {
        let (header, plan) = (&shards.header, &shards.header.plan);
        let rays = CertificateRays {
            rays: header.certify_rays as usize,
            seed: plan.seed,
            tolerance: plan.tolerance,
            promise: plan.max_error,
            length: plan.length,
        };
        Self {
            shards,
            observer,
            together,
            rays,
            table: plan.table(shards.space.clone(), Vec::new().into()),
            counts: vec![None; shards.chunks.len()],
        }
    }

    /// Returns the header with the certificate, how the paths of its rays end, and the numbers of patches and of
    /// flagged boxes.
    fn measured(mut self) -> Result<(Header, UnfinishedPaths, (usize, usize))> {
        let mut needs = self.needs()?;
        needs.sort_unstable();
        let certified = AtomicU64::new(0);
        let mut errors: Vec<(usize, CertificateErrors)> = Vec::with_capacity(needs.len());
        let mut rest = needs.as_slice();
        while !rest.is_empty() {
            let (count, chunks) = self.first_batch(rest);
            let (batch, others) = rest.split_at(count);
            errors.extend(self.compared(batch, &chunks, &certified)?);
            rest = others;
        }
        // Chunks that no camera of the certificate meets may be damaged as well.
        let unmet: Vec<usize> = (0..self.counts.len())
            .filter(|chunk| self.counts[*chunk].is_none())
            .collect();
        for chunk in unmet {
            self.loaded(&BTreeSet::from([chunk]))?;
        }
        errors.sort_unstable_by_key(|(camera, _)| *camera);
        let errors = errors.into_iter().map(|(_, errors)| errors);
        let checked = self.rays.checked(&self.table, errors);
        let mut header = self.shards.header.clone();
        let mut certificate = checked.certificate;
        certificate.exact_rays_baked = self.shards.exact_rays;
        header.certificate = Some(certificate);
        let counts = self.counts.iter().flatten();
        let counts = counts.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
        Ok((header, checked.unfinished, counts))
    }

    /// Finds the chunks that each camera of the certificate needs.
    fn needs(&self) -> Result<Vec<Need>> {
        let cameras = (0..self.rays.cameras()).into_par_iter();
        let need = |camera: usize| {
            let u = self.rays.of(&self.shards.space, camera)?.u;
            Ok((self.table.chunks_at(u)?, camera))
        };
        cameras.map(need).collect()
    }

    /// Returns how many of the first cameras need chunks that fit into memory together, one at least, and these
    /// chunks.
    fn first_batch(&self, needs: &[Need]) -> (usize, BTreeSet<usize>) {
        let (mut chunks, mut bytes) = (BTreeSet::new(), 0);
        for (count, (needed, _)) in needs.iter().enumerate() {
            let new = needed
                .iter()
                .copied()
                .filter(|chunk| !chunks.contains(chunk));
            let more = self.shards.bytes(new);
            if count > 0 && more > 0 && bytes + more > self.together {
                return (count, chunks);
            }
            bytes += more;
            chunks.extend(needed);
        }
        (needs.len(), chunks)
    }

    /// Compares the table at the cameras of a batch, which need these chunks.
    fn compared(
        &mut self,
        batch: &[Need],
        chunks: &BTreeSet<usize>,
        certified: &AtomicU64,
    ) -> Result<Vec<(usize, CertificateErrors)>> {
        let table = self.loaded(chunks)?;
        let mut cameras: Vec<usize> = batch.iter().map(|(_, camera)| *camera).collect();
        cameras.sort_unstable();
        let rays = self.rays.rays as u64;
        let tell = |count| tell_certified(self.observer, (certified, count, rays), RESUME);
        let errors = self.rays.compared(&table, &cameras, tell)?;
        Ok(cameras.into_iter().zip(errors).collect())
    }

    /// Makes a table of these chunks alone, decoded, and counts what is in them.
    fn loaded(&mut self, chunks: &BTreeSet<usize>) -> Result<Table> {
        if self.observer.cancelled() {
            return Err(interrupted());
        }
        let plan = &self.shards.header.plan;
        let shape = Table::tensor_shape(&self.table.space, plan.mapping);
        // What a file of all chunks may ask for.
        let all = self.shards.bytes(0..self.shards.chunks.len());
        let budget = Arc::new(DecodeBudget::for_bytes(all as usize));
        let chunk = |number: usize| {
            let bytes = match chunks.contains(&number) {
                true => self.shards.read(number as u32)?,
                false => Vec::new(),
            };
            Ok(Chunk::new(bytes, shape, budget.clone()))
        };
        let all: Result<Vec<Chunk>> = (0..self.shards.chunks.len()).map(chunk).collect();
        let table = Table {
            chunks: all?.into(),
            ..self.table.clone()
        };
        let numbers: Vec<usize> = chunks.iter().copied().collect();
        let count = |number: &usize| Ok((*number, table.whole_tree(*number).map(Tree::count)?));
        let counted: Result<Vec<_>> = numbers.par_iter().map(count).collect();
        for (number, counts) in counted? {
            self.counts[number] = Some(counts);
        }
        Ok(table)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BakeOptions, BakeResult, Share, bake};
    use geofan_core::{Unobserved, diagnostic::SourceText, manifold::Manifold};
    use std::fs;

    /// A lens seen from anywhere in a box, with all reflections and exchanges of coordinates.
    const BOX: &str = r#"
name = "box"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(0.2*exp(-(x^2 + y^2 + z^2)/2))" }
[cameras]
parameters = { a = [-1, 1] }
at = ["a", "0.1", "0.2"]
length = 1.5
"#;

    fn baked(path: &Path, share: Option<Share>, mirrors: bool) -> u64 {
        let source = SourceText::new("box.toml", BOX);
        let manifold = Arc::new(Manifold::from_source(source, &[]).unwrap());
        let options = BakeOptions {
            max_error: Some(20.0),
            max_sky_error: Some(20.0),
            certify_rays: 700,
            share,
            mirrors,
            ..BakeOptions::default()
        };
        match bake(manifold, path, &options, &Unobserved).unwrap() {
            BakeResult::Bundle { bytes, .. } | BakeResult::Shard { bytes, .. } => bytes,
            BakeResult::TooLarge { reason, .. } => panic!("{reason}"),
        }
    }

    #[test]
    fn however_few_chunks_are_held_together_the_bytes_are_those_of_an_undivided_bake() {
        for mirrors in [true, false] {
            let folder = tempfile::tempdir().unwrap();
            let path = |name: &str| folder.path().join(name);
            let size = baked(&path("whole.fan"), None, mirrors);
            let shares = [3, 1, 2].map(|index| {
                let shard = path(&format!("{index}.fan"));
                baked(&shard, Some(Share { index, of: 3 }), mirrors);
                shard
            });
            let whole = fs::read(path("whole.fan")).unwrap();
            for together in [1, size / 3, TOGETHER] {
                let merged = merge_by(&shares, &path("b.fan"), &Unobserved, together).unwrap();
                assert!(fs::read(path("b.fan")).unwrap() == whole, "{together}");
                let bundle = geofan_bundle::Bundle::read(&path("b.fan")).unwrap();
                let counts = (merged.patches, merged.flagged_boxes);
                assert_eq!(counts, bundle.table.counts().unwrap());
                assert_eq!((merged.bytes, &merged.header), (size, &bundle.header));
            }
            // The reflection of the only axis of cameras leaves one cell.
            let batches = batches(&Shards::open(&shares, &Unobserved).unwrap(), 1);
            assert_eq!(batches, if mirrors { 1 } else { 2 });
        }
    }

    /// Counts the batches in which all cameras get their chunks, each of so many bytes, or of what one camera needs.
    fn batches(shards: &Shards, together: u64) -> usize {
        let measuring = Measuring::new(shards, &Unobserved, together);
        let mut needs = measuring.needs().unwrap();
        needs.sort_unstable();
        let (mut rest, mut batches) = (needs.as_slice(), 0);
        while !rest.is_empty() {
            let (count, chunks) = measuring.first_batch(rest);
            let bytes = shards.bytes(chunks.iter().copied());
            assert!(count >= 1 && (bytes <= together || chunks.len() == rest[0].0.len()));
            let needed = rest[..count].iter().flat_map(|(chunks, _)| chunks);
            assert_eq!(chunks, needed.copied().collect());
            rest = &rest[count..];
            batches += 1;
        }
        batches
    }

    #[test]
    fn a_damaged_chunk_that_no_camera_meets_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let shards = [1, 2].map(|index| {
            let path = folder.path().join(format!("{index}.fan"));
            baked(&path, Some(Share { index, of: 2 }), false);
            change(&path, |contents| contents.header.certify_rays = 1);
            path
        });
        let opened = Shards::open(&shards, &Unobserved).unwrap();
        let needs = Measuring::new(&opened, &Unobserved, 1).needs().unwrap();
        let mut all = 0..opened.chunks.len();
        let unmet = all.find(|chunk| !needs[0].0.contains(chunk)).unwrap();
        change(&shards[unmet % 2], |contents| {
            let (_, payload) = &mut contents.chunks[unmet / 2];
            payload.truncate(payload.len() - 1);
        });
        let output = folder.path().join("b.fan");
        let error = merge(&shards, &output, &Unobserved).unwrap_err();
        assert!(error.to_string().contains("damaged"), "{error}");
        assert!(!output.exists());
    }

    /// Changes a file below its checksums.
    fn change(path: &Path, change: impl FnOnce(&mut geofan_bundle::Contents)) {
        let mut contents = geofan_bundle::Contents::read(path).unwrap();
        change(&mut contents);
        contents.write(path).unwrap();
    }
}
