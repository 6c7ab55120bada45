//! A bundle as a file.
//!
//! In: a [`Table`] with its plan and certificate. Out: one file (see [`super::container`]), and
//! back: the manifold is rebuilt from the text that the file embeds. Patches stay coded until they
//! are used, so opening costs two hashes over the file.

#[cfg(feature = "files")]
use crate::container::{MAGIC, MOST_BYTES};
use crate::{
    Certificate, Table,
    container::{self, Container, ContainerError, Id},
    header::{Header, ManifoldRecord, PlanRecord, RecordError, ShardRecord},
    rays::{ChartMap, RaySpace},
    table::{Chunk, Division},
};
use geofan_core::{
    diagnostic::SourceText,
    error::{Error, Result},
    manifold::Manifold,
};
#[cfg(feature = "files")]
use geofan_core::{files::write_atomically, reading::read_file};
#[cfg(feature = "files")]
use std::{fs, io::Write};
use std::{path::Path, sync::Arc};

/// The most chunks of a bundle: far above any plan's.
const MOST_CHUNKS: u64 = 1 << 20;

/// What can be wrong with a bundle.
#[derive(Debug, thiserror::Error)]
pub enum BundleError {
    /// The file around it.
    #[error("{0}")]
    Container(#[from] ContainerError),
    /// Too large to be read whole.
    #[error("has {0} bytes; bundles have at most {max}", max = container::MOST_BYTES)]
    TooLarge(u64),
    /// The header does not decode.
    #[error("is not a valid bundle: its header: {0}")]
    Record(#[from] RecordError),
    /// Parts that do not fit each other.
    #[error("is not a valid bundle: {0}")]
    Disagrees(&'static str),
    /// The embedded manifold is refused.
    #[error("{0}")]
    Manifold(#[from] Error),
    /// A share of a bundle.
    #[error("is shard {index} of {of}: join the shards with `geofan-bake merge`")]
    Shard {
        /// From 1.
        index: u32,
        /// The number of shards.
        of: u32,
    },
}

impl BundleError {
    /// The error to show: about the file `path`, or about a place in the embedded manifold.
    pub fn about(self, path: &Path) -> Error {
        match self {
            Self::Manifold(error) => error,
            other => Error::input(path.display().to_string(), other.to_string()),
        }
    }
}

/// A baked table with everything that it was made from.
#[derive(Debug, Clone)]
pub struct Bundle {
    /// What was baked, how, and how well.
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

/// The id of the bundle of `manifold` by `plan`.
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

impl PlanRecord {
    /// How the table over `space` is divided into chunks.
    pub fn division(&self, space: &RaySpace) -> Division {
        let cells = self.cells.iter().map(|n| *n as usize).collect();
        Division::new(cells, space.blocks(), space.mirrors())
    }
}

impl Header {
    /// The header of a bake of the rays of `space`, without a certificate.
    pub fn new(space: &RaySpace, plan: PlanRecord, certify_rays: u64) -> Self {
        let manifold = space.manifold();
        let source = Path::new(&manifold.source.name).file_name();
        Self {
            generator: env!("CARGO_PKG_VERSION").into(),
            manifold: ManifoldRecord {
                name: manifold.name.clone(),
                source: source.unwrap_or_default().to_string_lossy().into_owned(),
                text: manifold.source.text.clone(),
                parameters: manifold.parameters.clone(),
            },
            reduction: space.reduction(),
            cameras: space.cameras().to_vec(),
            faces: space.faces() as u32,
            plan,
            certify_rays,
            certificate: None,
            shard: None,
        }
    }

    /// The manifold rebuilt from the embedded text; `file` is named in complaints about it.
    fn manifold(&self, file: &str) -> Result<Arc<Manifold>> {
        let name = format!("{file}: manifold text");
        let source = SourceText::new(name, self.manifold.text.clone());
        Ok(Arc::new(Manifold::from_source(
            source,
            &self.manifold.parameters,
        )?))
    }

    /// Whether the number of cells and faces makes sense.
    fn is_divided_sensibly(&self) -> bool {
        let cells = self.plan.cells.iter();
        let product = cells.fold(u64::from(self.faces), |n, c| n.saturating_mul((*c).into()));
        (1..=MOST_CHUNKS).contains(&product)
    }

    /// That plan and cameras are those of `space`.
    fn agrees(&self, space: &RaySpace) -> Result<(), BundleError> {
        let wrong = |what| Err(BundleError::Disagrees(what));
        let axes = space.cameras().len() + space.directions() + 1;
        let plan = &self.plan;
        let positive = |x: f64| x.is_finite() && x > 0.0;
        if self.reduction != space.reduction() || self.faces as usize != space.faces() {
            return wrong("its symmetry is not the manifold's");
        }
        if !same_intervals(&self.cameras, space.cameras()) {
            return wrong("its cameras are not the manifold's");
        }
        if plan.cells.len() != space.cameras().len() || plan.nodes.len() != axes {
            return wrong("its plan has another number of axes");
        }
        if !plan.mirrors.iter().all(|mirror| mirror.fits(space)) {
            return wrong("its mirrors are not the manifold's");
        }
        if !plan.stretch.is_valid() || !plan.focus.iter().flatten().all(|x| x.is_finite()) {
            return wrong("its stretch or its focus is out of range");
        }
        let sphere = plan.sphere();
        if sphere.is_some_and(|sphere| space.planar() || !sphere.is_valid()) {
            return wrong("its axes of directions are out of range");
        }
        if let ChartMap::Sphere { radius } = plan.lift
            && !positive(radius)
        {
            return wrong("its plan's lift has no positive radius");
        }
        if ![plan.length, plan.max_error, plan.tolerance]
            .map(positive)
            .iter()
            .all(|p| *p)
        {
            return wrong("its plan has a number that is not positive");
        }
        Ok(())
    }
}

/// How far apart two computations of the same interval may be, as a share of its ends: elementary
/// functions differ by a few last bits between machines.
const ROUNDING: f64 = 1e-12;

fn same_intervals(a: &[[f64; 2]], b: &[[f64; 2]]) -> bool {
    let near = |(x, y): (&f64, &f64)| (x - y).abs() <= ROUNDING * x.abs().max(y.abs());
    let same = |(a, b): (&[f64; 2], &[f64; 2])| a.iter().zip(b).all(near);
    a.len() == b.len() && a.iter().zip(b).all(same)
}

impl Contents {
    /// Freshly baked chunks of a table over `space`, without a certificate.
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

    /// Reads a bundle or a shard.
    ///
    /// # Errors
    /// The file cannot be read, or is not one.
    #[cfg(feature = "files")]
    pub fn read(path: &Path) -> Result<Self> {
        let size = fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
        if size > MOST_BYTES {
            return Err(BundleError::TooLarge(size).about(path));
        }
        let bytes = read_file(path, MAGIC, MOST_BYTES)?;
        Self::decode(&path.display().to_string(), &bytes).map_err(|e| e.about(path))
    }

    /// Reads a bundle or a shard from the bytes of the file called `name`.
    ///
    /// # Errors
    /// The bytes are not one.
    pub fn decode(name: &str, bytes: &[u8]) -> Result<Self, BundleError> {
        let container = Container::decode(bytes)?;
        let header = Header::decode(&container.header)?;
        if !header.is_divided_sensibly() {
            return Err(BundleError::Disagrees("its number of chunks"));
        }
        let manifold = header.manifold(name)?;
        let space = RaySpace::new(manifold.clone())?;
        header.agrees(&space)?;
        let space = header.plan.applied(space);
        let total = header.plan.division(&space).chunks() as u64;
        if identity(&manifold, &header.plan)? != container.id {
            return Err(BundleError::Disagrees("its id is not that of its plan"));
        }
        let expected = expected_chunks(total, header.shard)?;
        if !container.chunks.iter().map(|c| u64::from(c.0)).eq(expected) {
            return Err(BundleError::Disagrees("chunks are missing"));
        }
        Ok(Self {
            header,
            id: container.id,
            space,
            chunks: container.chunks,
        })
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// The place cannot be written.
    #[cfg(feature = "files")]
    pub fn write(&self, path: &Path) -> Result<u64> {
        let bytes = self.encode().map_err(|e| e.about(path))?;
        write_atomically(path, |out| out.write_all(&bytes))?;
        Ok(bytes.len() as u64)
    }

    /// The bytes of the file.
    ///
    /// # Errors
    /// The manifold's text is too long for a header.
    pub fn encode(&self) -> Result<Vec<u8>, BundleError> {
        let container = Container {
            id: self.id,
            header: self.header.encode()?,
            chunks: self.chunks.clone(),
        };
        Ok(container.encode())
    }
}

/// The numbers of the chunks that a file must hold.
fn expected_chunks(
    total: u64,
    shard: Option<ShardRecord>,
) -> Result<impl Iterator<Item = u64>, BundleError> {
    let (first, step) = match shard {
        None => (0, 1),
        Some(s) if 0 < s.index && s.index <= s.of => (s.index - 1, s.of),
        Some(_) => return Err(BundleError::Disagrees("its shard number")),
    };
    Ok((u64::from(first)..total).step_by(step as usize))
}

impl Bundle {
    /// Reads a whole bundle.
    ///
    /// # Errors
    /// The file cannot be read, or is not a whole bundle.
    #[cfg(feature = "files")]
    pub fn read(path: &Path) -> Result<Self> {
        Self::from_contents(Contents::read(path)?).map_err(|e| e.about(path))
    }

    /// The bundle in the contents of a whole file. Chunks are decoded when they are used.
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
        if let Some(ShardRecord { index, of, .. }) = header.shard {
            return Err(BundleError::Shard { index, of });
        }
        let shape = Table::shape(&space, header.plan.stretch);
        let chunks = chunks
            .into_iter()
            .map(|(_, bytes)| Chunk::new(bytes, shape));
        let manifold = space.manifold().clone();
        Ok(Self {
            table: Table {
                division: header.plan.division(&space),
                length: header.plan.length,
                frames: header.plan.frames,
                space,
                chunks: chunks.collect(),
            },
            header,
            id,
            manifold,
        })
    }

    /// The same with its certificate.
    pub fn certified(mut self, certificate: Certificate) -> Self {
        self.header.certificate = Some(certificate);
        self
    }

    /// What the file holds.
    pub fn contents(&self) -> Contents {
        let chunks = self.table.chunks.iter().map(|chunk| chunk.bytes().to_vec());
        Contents {
            header: self.header.clone(),
            id: self.id,
            space: self.table.space.clone(),
            chunks: (0..).zip(chunks).collect(),
        }
    }

    /// Writes the file, whole or not at all; its size.
    ///
    /// # Errors
    /// The place cannot be written.
    #[cfg(feature = "files")]
    pub fn write(&self, path: &Path) -> Result<u64> {
        self.contents().write(path)
    }
}

#[cfg(test)]
#[path = "bundle_tests.rs"]
mod tests;
