//! A bundle: a table with everything that it was made from, as a file or in memory.
//!
//! In: the bytes of a file, or a table with its plan and certificate. Out: a [`Bundle`] in which paths
//! can be looked up, and back. The layout of the file is that of [`crate::container`], its header that of
//! [`crate::Header`]; the manifold is rebuilt from the text that the file embeds. Patches stay coded
//! until they are used, so opening costs two hashes over the file.

#[cfg(feature = "files")]
use crate::container::{MAGIC, MOST_BYTES, too_large};
use crate::{
    Certificate,
    container::{self, Id},
    decode::{BundleError, ByteReader, DecodeBudget, LookupError, put_bytes},
    fan::Fan,
    header::{Header, PlanRecord, ShardRecord},
    rays::RaySpace,
    table::{Chunk, Table},
};
use geofan_core::{
    error::Error,
    field::{Field, MOST_SAMPLES, Samples},
    manifold::Manifold,
};
#[cfg(feature = "files")]
use geofan_core::{files::write_atomically, reading::read_file};
use glam::DVec3;
use std::{borrow::Cow, sync::Arc};
#[cfg(feature = "files")]
use std::{fs, io::Write, path::Path};

/// The most chunks of a bundle, counted before mirrors: far above any usual plan's.
pub const MOST_CHUNKS: u64 = 1 << 20;

/// A baked table with everything that it was made from. A clone shares the table.
#[derive(Debug, Clone)]
pub struct Bundle {
    /// The header: manifold, plan and certificate.
    pub header: Header,
    /// Equal for equal manifold and plan.
    pub id: Id,
    /// The table.
    pub table: Table,
    /// The manifold.
    pub manifold: Arc<Manifold>,
}

/// A file of chunks, whole or a shard, checked but its chunks not yet read.
#[derive(Debug, Clone)]
pub struct Contents {
    /// The header.
    pub header: Header,
    /// The bundle's id.
    pub id: Id,
    /// The rays.
    pub space: RaySpace,
    /// Chunk numbers and coded trees.
    pub chunks: Vec<(u32, Vec<u8>)>,
}

/// Computes the id of the bundle of `manifold` by `plan`.
///
/// # Errors
/// The plan is too long for a header.
pub fn identity(manifold: &Manifold, plan: &PlanRecord) -> Result<Id, BundleError> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&manifold.fingerprint());
    hasher.update(&plan.encode()?);
    let mut id = Id::default();
    id.copy_from_slice(&hasher.finalize().as_bytes()[..16]);
    Ok(id)
}

impl Contents {
    /// Wraps freshly baked chunks of a table over `space`, without a certificate.
    ///
    /// # Errors
    /// The plan is too long for a header.
    pub fn new(
        space: RaySpace,
        plan: PlanRecord,
        certify_rays: u64,
        chunks: Vec<(u32, Vec<u8>)>,
    ) -> Result<Self, BundleError> {
        Ok(Self {
            id: identity(space.manifold(), &plan)?,
            header: Header::new(&space, plan, certify_rays),
            space,
            chunks,
        })
    }

    /// Reads a bundle or a shard from the bytes of the file called `name`.
    ///
    /// # Errors
    /// The bytes are not one.
    pub fn decode(name: &str, bytes: &[u8]) -> Result<Self, BundleError> {
        let (header_block, field_blocks, chunk_blocks) = container::decode(bytes)?;
        let (header, space) = checked_header(
            name,
            (header_block.id, header_block.payload),
            field_blocks.iter().map(|block| block.payload),
            chunk_blocks.iter().map(|block| block.index),
        )?;
        let chunks = chunk_blocks.iter().map(|b| (b.index, b.payload.to_vec()));
        Ok(Self {
            header,
            id: header_block.id,
            space,
            chunks: chunks.collect(),
        })
    }

    /// Returns what the chunks may ask for when they are decoded.
    pub fn budget(&self) -> Arc<DecodeBudget> {
        budget_of(&self.chunks)
    }

    /// Rebuilds the manifold with these parameters in place of its own.
    ///
    /// # Errors
    /// It does not have such a parameter, or does not work with it.
    pub fn manifold_with(&self, name: &str, settings: &[(String, f64)]) -> Result<Manifold, Error> {
        let fields = self.space.manifold().fields.iter();
        let samples: Vec<_> = fields
            .map(|field| (field.name.clone(), field.samples.clone()))
            .collect();
        self.header.manifold_with(name, &samples, settings)
    }

    /// Makes the bytes of the file.
    ///
    /// # Errors
    /// The manifold's text is too long for a header.
    pub fn encode(&self) -> Result<Vec<u8>, BundleError> {
        let header = self.header.encode()?;
        let fields = field_payloads(&self.space);
        Ok(container::encode(self.id, &header, &fields, &self.chunks))
    }
}

/// Reads the header of the file called `name`, and the rays that it says the table holds; checks that they fit each
/// other, the id, and the numbers of the file's chunks.
///
/// # Errors
/// They do not.
pub(crate) fn checked_header<'a>(
    name: &str,
    (id, header): (Id, &[u8]),
    fields: impl Iterator<Item = &'a [u8]>,
    chunks: impl Iterator<Item = u32>,
) -> Result<(Header, RaySpace), BundleError> {
    // The header, and the rays that it says the table holds.
    let header = Header::decode(header)?;
    check_chunk_count(&header)?;
    let mut left = MOST_SAMPLES;
    let fields = fields.map(|payload| read_field(payload, &mut left));
    let fields = fields.collect::<Result<Vec<_>, _>>()?;
    let manifold = Arc::new(header.manifold_with(name, &fields, &[])?);
    let space = RaySpace::new(manifold.clone())?;
    header.check(&space)?;
    let space = header.plan.applied(space);
    if identity(&manifold, &header.plan)? != id {
        return Err(BundleError::Invalid("its id is not that of its plan"));
    }
    // The chunks, all that there must be.
    let total = header.plan.division(&space).chunks() as u64;
    let expected = expected_chunks(total, header.shard)?;
    match chunks.map(u64::from).eq(expected) {
        true => Ok((header, space)),
        false => Err(BundleError::Invalid("chunks are missing")),
    }
}

/// The payloads of the blocks of the fields of a manifold.
pub(crate) fn field_payloads(space: &RaySpace) -> Vec<Vec<u8>> {
    space.manifold().fields.iter().map(field_bytes).collect()
}

/// The payload of a field's block: the length of its name (u32), the name, and its samples, packed.
fn field_bytes(field: &Field) -> Vec<u8> {
    let mut bytes = Vec::new();
    put_bytes(&mut bytes, field.name.as_bytes());
    bytes.extend(field.samples.pack());
    bytes
}

/// Reads what [`field_bytes`] wrote, and takes its samples from what is `left` for all fields of the file: zeros compress
/// a thousandfold.
fn read_field(payload: &[u8], left: &mut usize) -> Result<(String, Arc<Samples>), BundleError> {
    let wrong = || BundleError::Invalid("the samples of a field");
    let mut input = ByteReader(payload);
    let name = input.bytes().map_err(|_| wrong())?;
    let name = str::from_utf8(name).map_err(|_| wrong())?;
    let count = Samples::packed_count(input.0).ok_or_else(wrong)?;
    *left = left.checked_sub(count).ok_or(BundleError::Limit {
        what: "samples of fields, or more",
        found: MOST_SAMPLES as u64 + 1,
        most: MOST_SAMPLES as u64,
    })?;
    let samples = Samples::unpack(input.0).map_err(|_| wrong())?;
    Ok((name.into(), Arc::new(samples)))
}

/// Checks that the number of cells and faces is one that a bake may have made.
fn check_chunk_count(header: &Header) -> Result<(), BundleError> {
    let cells = header.plan.cells.iter();
    let found = cells.fold(u64::from(header.faces), |n, c| {
        n.saturating_mul((*c).into())
    });
    match found {
        0 => Err(BundleError::Invalid("it has no chunks")),
        1..=MOST_CHUNKS => Ok(()),
        _ => Err(BundleError::Limit {
            what: "chunks",
            found,
            most: MOST_CHUNKS,
        }),
    }
}

/// Lists the numbers of the chunks that a file must hold.
fn expected_chunks(
    total: u64,
    shard: Option<ShardRecord>,
) -> Result<impl Iterator<Item = u64>, BundleError> {
    let (first, step) = match shard {
        None => (0, 1),
        Some(s) if 0 < s.index && s.index <= s.of => (s.index - 1, s.of),
        Some(_) => return Err(BundleError::Invalid("its shard number")),
    };
    Ok((u64::from(first)..total).step_by(step as usize))
}

/// Returns the budget of a table of these chunks.
fn budget_of(chunks: &[(u32, Vec<u8>)]) -> Arc<DecodeBudget> {
    let bytes = chunks.iter().map(|(_, bytes)| bytes.len()).sum();
    Arc::new(DecodeBudget::for_bytes(bytes))
}

/// Returns the manifold of the file, of which a table may know the cover.
fn glued(manifold: &Arc<Manifold>) -> Arc<Manifold> {
    match manifold.glued() {
        Cow::Borrowed(_) => manifold.clone(),
        Cow::Owned(glued) => Arc::new(glued),
    }
}

impl Bundle {
    /// Reads a whole bundle from the bytes of a file.
    ///
    /// # Errors
    /// They are not a bundle, one of another format, damaged, above a limit, or only a shard.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, BundleError> {
        Self::from_contents(Contents::decode("bundle", bytes)?)
    }

    /// Takes over the contents of a whole file. Chunks are decoded when they are used.
    ///
    /// # Errors
    /// It is a shard.
    pub fn from_contents(contents: Contents) -> Result<Self, BundleError> {
        let Contents {
            header,
            id,
            space,
            chunks,
        } = contents;
        // A share is not a table.
        if let Some(ShardRecord { index, of, .. }) = header.shard {
            return Err(BundleError::Shard { index, of });
        }
        // Chunks stay coded until they are used.
        let shape = Table::tensor_shape(&space, header.plan.mapping);
        let budget = budget_of(&chunks);
        let chunks = chunks
            .into_iter()
            .map(|(_, bytes)| Chunk::new(bytes, shape, budget.clone()));
        Ok(Self {
            manifold: glued(space.manifold()),
            table: header.plan.table(space, chunks.collect()),
            header,
            id,
        })
    }

    /// Returns the screen error that the bundle promises, radians.
    pub fn promise(&self) -> f64 {
        1e-3 * self.header.plan.max_error
    }

    /// Contracts the table to all paths from the camera position `u` (a chart point).
    ///
    /// # Errors
    /// `u` is not in the camera region, or a block there is damaged.
    pub fn fan(&self, u: DVec3) -> Result<Fan, LookupError> {
        self.table.fan(u)
    }

    /// Adds the certificate.
    pub fn certified(mut self, certificate: Certificate) -> Self {
        self.header.certificate = Some(certificate);
        self
    }

    /// Copies out what the file holds.
    pub fn contents(&self) -> Contents {
        let chunks = self.table.chunks.iter().map(|chunk| chunk.bytes().to_vec());
        Contents {
            header: self.header.clone(),
            id: self.id,
            space: (*self.table.space).clone(),
            chunks: (0..).zip(chunks).collect(),
        }
    }
}

#[cfg(feature = "files")]
impl Contents {
    /// Reads a bundle or a shard from a file.
    ///
    /// # Errors
    /// The file cannot be read, or is not one.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::read_sized(path).map(|(contents, _)| contents)
    }

    /// Reads a bundle or a shard from a file, and its size, which a pipe does not tell.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_sized(path: &Path) -> Result<(Self, u64), Error> {
        let size = fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
        if size > MOST_BYTES {
            return Err(too_large(size).about(path));
        }
        let bytes = read_file(path, MAGIC, MOST_BYTES)?;
        let contents = Self::decode(&path.display().to_string(), &bytes);
        Ok((contents.map_err(|e| e.about(path))?, bytes.len() as u64))
    }

    /// Writes the file, whole or not at all, and returns its size.
    ///
    /// # Errors
    /// The place cannot be written.
    pub fn write(&self, path: &Path) -> Result<u64, Error> {
        let bytes = self.encode().map_err(|e| e.about(path))?;
        write_atomically(path, |out| out.write_all(&bytes))?;
        Ok(bytes.len() as u64)
    }
}

#[cfg(feature = "files")]
impl Bundle {
    /// Reads a whole bundle from a file.
    ///
    /// # Errors
    /// The file cannot be read, or is not a whole bundle.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::from_contents(Contents::read(path)?).map_err(|e| e.about(path))
    }

    /// Writes the file, whole or not at all, and returns its size.
    ///
    /// # Errors
    /// The place cannot be written.
    pub fn write(&self, path: &Path) -> Result<u64, Error> {
        self.contents().write(path)
    }
}

#[cfg(test)]
#[path = "bundle_tests.rs"]
mod tests;
