//! The header of a bundle: what was baked, how, and how well.
//!
//! In: a [`Header`]. Out: its bytes in bincode's legacy wire format (fixed-width little-endian
//! integers, lengths of 8 bytes), and back. This is the only module that uses bincode; the format
//! is also that of bincode 1.3 and of wincode, so files outlive the crate.

use crate::{
    Certificate, MappedChebyshev,
    rays::{ChartMap, Mirror, RaySpace, Reduction, ReferenceSphere, Sphere},
};
use bincode::config::{Configuration, Fixint, Limit, LittleEndian, legacy};
use glam::DMat3;
use serde::{Deserialize, Serialize};

/// The most bytes of a header: a manifold file is text, far smaller. Without a limit a hostile
/// length aborts the process.
const MOST_BYTES: usize = 16 << 20;

/// Everything about a bundle except its chunks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// The version of geofan that baked it.
    pub generator: String,
    /// The manifold.
    pub manifold: ManifoldRecord,
    /// The symmetry taken out.
    pub reduction: Reduction,
    /// Intervals of the stored camera parameters.
    pub cameras: Vec<[f64; 2]>,
    /// Faces of directions.
    pub faces: u32,
    /// What every chunk depends on, besides the manifold.
    pub plan: PlanRecord,
    /// Rays that the certificate takes; 0 for none.
    pub certify_rays: u64,
    /// How well the table keeps its promise; none in a shard.
    pub certificate: Option<Certificate>,
    /// Set in a file that holds a share of the chunks only.
    pub shard: Option<ShardRecord>,
}

/// A manifold as a bundle embeds it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ManifoldRecord {
    /// Its name.
    pub name: String,
    /// The name of its file, without folders.
    pub source: String,
    /// The text of its file.
    pub text: String,
    /// Its parameters, after `--set`.
    pub parameters: Vec<(String, f64)>,
}

/// The plan of a bake.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanRecord {
    /// The promise: 99th percentile of the screen error, mrad.
    pub max_error: f64,
    /// How far paths go (arc length).
    pub length: f64,
    /// Whether tangents keep the promise too, and with them transported frames.
    pub frames: bool,
    /// Local tolerance of the exact tracer.
    pub tolerance: f64,
    /// The most nodes along each axis: camera…, direction…, arc length.
    pub nodes: Vec<u32>,
    /// The most rays that one patch is fitted to.
    pub most_rays: u32,
    /// How chart points are stored.
    pub lift: ChartMap,
    /// The version of the refinement: chunks of another version are not those of this plan.
    pub refinement: u32,
    /// Smallest box that is divided further, as a share of its chunk.
    pub least_volume: f64,
    /// How often the arc length may be halved.
    pub most_arc_halvings: u32,
    /// Cells along each stored camera parameter.
    pub cells: Vec<u32>,
    /// Of the variables of cameras and directions.
    pub stretch: MappedChebyshev,
    /// How far away directions aim: the columns of the parallax of [`ReferenceSphere`].
    pub focus: [[f64; 3]; 3],
    /// Axes of the sphere whose directions have one chunk together, if they can ([`Sphere`], columns);
    /// `None` if each face has one.
    pub sphere: Option<[[f64; 3]; 3]>,
    /// Discrete symmetries: of the chunks that they carry into each other one is stored.
    pub mirrors: Vec<Mirror>,
    /// Seed of the held-out rays and of the certificate.
    pub seed: u64,
}

/// Which share of the chunks a file holds: those with number ≡ `index` − 1 modulo `of`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ShardRecord {
    /// From 1.
    pub index: u32,
    /// The number of shards.
    pub of: u32,
    /// Rays integrated for its chunks.
    pub exact_rays: u64,
}

/// What is wrong with the bytes of a record.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// They do not decode.
    #[error("{0}")]
    Decode(#[from] bincode::error::DecodeError),
    /// They do not encode.
    #[error("{0}")]
    Encode(#[from] bincode::error::EncodeError),
    /// Something follows the record.
    #[error("{0} bytes too many")]
    Left(usize),
}

fn format() -> Configuration<LittleEndian, Fixint, Limit<MOST_BYTES>> {
    legacy().with_limit::<MOST_BYTES>()
}

fn encode(record: &impl Serialize) -> Result<Vec<u8>, RecordError> {
    Ok(bincode::serde::encode_to_vec(record, format())?)
}

impl Header {
    /// The bytes of the header.
    ///
    /// # Errors
    /// It is longer than a reader would accept.
    pub fn encode(&self) -> Result<Vec<u8>, RecordError> {
        encode(self)
    }

    /// Reads what [`Header::encode`] wrote.
    ///
    /// # Errors
    /// The bytes are not exactly a header.
    pub fn decode(bytes: &[u8]) -> Result<Self, RecordError> {
        let (header, consumed) = bincode::serde::decode_from_slice(bytes, format())?;
        match bytes.len() - consumed {
            0 => Ok(header),
            left => Err(RecordError::Left(left)),
        }
    }
}

impl PlanRecord {
    /// The rays of `space` as a table of this plan knows them.
    pub fn applied(&self, space: RaySpace) -> RaySpace {
        let cells = self.cells.iter().map(|n| *n as usize).collect();
        let space = space.lifted(self.lift).mirrored(self.mirrors.clone());
        let space = space.on_sphere(self.sphere());
        space.focused(ReferenceSphere::new(
            DMat3::from_cols_array_2d(&self.focus),
            cells,
        ))
    }

    /// The sphere whose directions are held together.
    pub fn sphere(&self) -> Option<Sphere> {
        let axes = self.sphere.as_ref().map(DMat3::from_cols_array_2d);
        axes.map(Sphere::new)
    }

    /// The bytes that stand for the plan in the bundle's id.
    ///
    /// # Errors
    /// As [`Header::encode`].
    pub fn encode(&self) -> Result<Vec<u8>, RecordError> {
        encode(self)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use geofan_core::quantiles::Quantiles;

    pub fn header() -> Header {
        Header {
            generator: "0.1.0".into(),
            manifold: ManifoldRecord {
                name: "Flat space".into(),
                source: "flat.toml".into(),
                text: "name = \"Flat space\"\n# ∂".into(),
                parameters: vec![("a".into(), 1.5), ("b".into(), -0.0)],
            },
            reduction: Reduction::Translation,
            cameras: vec![[-1.0, 1.0], [0.0, 1e300]],
            faces: 6,
            plan: PlanRecord {
                max_error: 0.5,
                length: 24.0,
                frames: true,
                tolerance: 5e-7,
                nodes: vec![8, 8, 20],
                most_rays: 1,
                lift: crate::rays::ChartMap::None,
                refinement: 1,
                least_volume: 0.25,
                most_arc_halvings: 4,
                cells: vec![2, 3],
                stretch: MappedChebyshev::new(0.75),
                focus: [[0.25, 0.0, 0.0], [0.0; 3], [0.0, -1.0, 0.0]],
                sphere: Some([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
                mirrors: Vec::new(),
                seed: u64::MAX,
            },
            certify_rays: 20_000,
            certificate: Some(Certificate {
                mrad: quantiles(0.1),
                screen_mrad: quantiles(0.2),
                sky_mrad: None,
                rotation_mrad: None,
                flagged: 0.01,
                rays: 20_000,
                seed: 1,
                tolerance: 1e-9,
                exact_rays_baked: 123_456,
            }),
            shard: None,
        }
    }

    fn quantiles(x: f64) -> Quantiles {
        Quantiles {
            p50: x,
            p95: 2.0 * x,
            p99: 3.0 * x,
            max: 4.0 * x,
        }
    }

    #[test]
    fn a_header_comes_back_as_it_was() {
        let header = header();
        let bytes = header.encode().unwrap();
        assert_eq!(Header::decode(&bytes).unwrap(), header);
    }

    #[test]
    fn a_header_with_a_tail_or_cut_short_is_refused() {
        let mut bytes = header().encode().unwrap();
        for cut in 0..bytes.len() {
            assert!(Header::decode(&bytes[..cut]).is_err());
        }
        bytes.push(0);
        assert!(matches!(Header::decode(&bytes), Err(RecordError::Left(1))));
    }

    #[test]
    fn a_hostile_length_is_refused_before_memory_is_taken() {
        let bytes = u64::MAX.to_le_bytes();
        assert!(Header::decode(&bytes).is_err());
        let bytes = (1_u64 << 40).to_le_bytes();
        assert!(Header::decode(&bytes).is_err());
    }

    /// wincode has no serde: a structure is its fields one after the other, as a tuple is.
    #[test]
    fn wincode_reads_and_writes_the_same_bytes() {
        let Header { manifold, plan, .. } = header();
        type Manifold = (String, String, String, Vec<(String, f64)>);
        // An enumeration is its number, as 32 bits.
        type Fitting = (u32, u32, u32);
        type Last = (f64, [[f64; 3]; 3], Option<[[f64; 3]; 3]>, Vec<u8>, u64);
        type Sizes = (Vec<u32>, Fitting, f64, u32, Vec<u32>, Last);
        let by_bincode = encode(&manifold).unwrap();
        let mirror: Manifold = (
            manifold.name,
            manifold.source,
            manifold.text,
            manifold.parameters,
        );
        assert_eq!(wincode::serialize(&mirror).unwrap(), by_bincode);
        assert_eq!(
            wincode::deserialize::<Manifold>(&by_bincode).unwrap(),
            mirror
        );
        let by_bincode = plan.encode().unwrap();
        let start = (plan.max_error, plan.length, plan.frames, plan.tolerance);
        let sizes = (
            plan.nodes,
            (plan.most_rays, 0, plan.refinement),
            plan.least_volume,
            plan.most_arc_halvings,
            plan.cells,
            (0.75, plan.focus, plan.sphere, Vec::new(), plan.seed),
        );
        let mirror: ((f64, f64, bool, f64), Sizes) = (start, sizes);
        assert_eq!(wincode::serialize(&mirror).unwrap(), by_bincode);
        let options = (
            Some((1_u32, 2_u32, 3_u64)),
            None::<u8>,
            vec![[0.5_f64, -1.0]],
        );
        let by_bincode = encode(&options).unwrap();
        assert_eq!(wincode::serialize(&options).unwrap(), by_bincode);
    }
}
