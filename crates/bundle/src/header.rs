//! The header of a bundle: what was baked, how, and how well.
//!
//! In: a [`Header`]. Out: its bytes in bincode's legacy wire format (fixed-width little-endian
//! integers, lengths of 8 bytes), and back; and whether a header fits the rays of its manifold. This is
//! the only module that uses bincode; the format is also that of bincode 1.3 and of wincode, so files
//! outlive the crate.

use crate::{
    Certificate, MappedChebyshev, TangentPromise,
    decode::BundleError,
    measure::{NOTHING_SEEN, tangents_at_exits},
    rays::{ChartMap, Mirror, RaySpace, Reduction, ReferenceSphere, Sphere},
    table::{Chunk, Division, Table},
};
use bincode::config::{Configuration, Fixint, Limit, LittleEndian, legacy};
use geofan_core::{diagnostic::SourceText, error::Error, field::NamedSamples, manifold::Manifold};
use glam::DMat3;
use serde::{Deserialize, Serialize};
use std::{ops::RangeInclusive, path::Path, sync::Arc};

/// The most bytes of a header: a manifold file is text, far smaller. Without a limit a hostile
/// length aborts the process.
pub(crate) const MOST_HEADER_BYTES: usize = 16 << 20;

/// The reflections and exchanges of three axes, without the one that changes nothing.
const MOST_MIRRORS: usize = 47;

/// The most rays of a certificate: more than anybody waits for.
pub const MOST_CERTIFY_RAYS: u64 = 1_000_000_000;

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
    /// The plan: all that every chunk depends on, besides the manifold.
    pub plan: PlanRecord,
    /// Number of rays that the certificate takes; 0 for none.
    pub certify_rays: u64,
    /// The errors found on fresh rays; none in a shard.
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

/// The plan of a bake: all that its chunks depend on, besides the manifold. [`PlanRecord::new`] makes the
/// plainest; name what differs and take the rest from it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanRecord {
    /// The promise: 99th percentile of the screen error, mrad.
    pub max_error: f64,
    /// Length of the paths.
    pub length: f64,
    /// The promise of tangents, and with them of transported frames: at exits, or all along the path where the
    /// stored paths do not tell where they end ([`tangents_at_exits`]).
    pub tangents: TangentPromise,
    /// Local tolerance of the exact tracer.
    pub tolerance: f64,
    /// Largest number of nodes along each axis: camera…, direction…, arc length.
    pub nodes: Vec<u32>,
    /// Largest number of rays that one patch is fitted to.
    pub most_rays: u32,
    /// The coordinates in which chart points are stored.
    pub chart_map: ChartMap,
    /// The version of the refinement: chunks of another version are not those of this plan.
    pub refinement: u32,
    /// Smallest box that is divided further, as a share of its chunk.
    pub least_volume: f64,
    /// Largest number of halvings of the arc length.
    pub most_arc_halvings: u32,
    /// Cells along each stored camera parameter.
    pub cells: Vec<u32>,
    /// The map of the variables of cameras and directions.
    pub mapping: MappedChebyshev,
    /// The columns of the parallax of [`ReferenceSphere`]: how far away directions aim.
    pub parallax: [[f64; 3]; 3],
    /// Axes of the sphere whose directions have one chunk together, if they can ([`Sphere`], columns);
    /// `None` if each face has one.
    pub sphere: Option<[[f64; 3]; 3]>,
    /// Discrete symmetries: of the chunks that they carry into each other one is stored.
    pub mirrors: Vec<Mirror>,
    /// Seed of the held-out rays and of the certificate.
    pub seed: u64,
}

/// The share of the chunks that a file holds: those with number ≡ `index` − 1 modulo `of`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ShardRecord {
    /// From 1.
    pub index: u32,
    /// The number of shards.
    pub of: u32,
    /// Rays integrated for its chunks.
    pub exact_rays: u64,
}

fn format() -> Configuration<LittleEndian, Fixint, Limit<MOST_HEADER_BYTES>> {
    legacy().with_limit::<MOST_HEADER_BYTES>()
}

fn encode(record: &impl Serialize) -> Result<Vec<u8>, BundleError> {
    let bytes = bincode::serde::encode_to_vec(record, format());
    bytes.map_err(|e| BundleError::Header(e.to_string()))
}

impl Header {
    /// Makes the header of a bake of the rays of `space`, without a certificate.
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

    /// Writes the bytes of the header.
    ///
    /// # Errors
    /// It is longer than a reader would accept.
    pub fn encode(&self) -> Result<Vec<u8>, BundleError> {
        encode(self)
    }

    /// Reads what [`Header::encode`] wrote.
    ///
    /// # Errors
    /// The bytes are not exactly a header.
    pub fn decode(bytes: &[u8]) -> Result<Self, BundleError> {
        let (header, consumed) = bincode::serde::decode_from_slice(bytes, format())
            .map_err(|e| BundleError::Header(e.to_string()))?;
        match bytes.len() - consumed {
            0 => Ok(header),
            left => Err(BundleError::Header(format!("{left} bytes too many"))),
        }
    }

    /// Rebuilds the manifold from its text and the samples of its fields, with its parameters but for those that
    /// `settings` replace; `file` is named in complaints about it.
    ///
    /// # Errors
    /// `settings` has a parameter that the manifold does not have, or the manifold does not work with it.
    pub fn manifold_with(
        &self,
        file: &str,
        samples: &NamedSamples,
        settings: &[(String, f64)],
    ) -> Result<Manifold, Error> {
        let name = format!("{file}: manifold text");
        let source = SourceText::new(name, self.manifold.text.clone());
        let own = self.manifold.parameters.iter();
        let kept = own.filter(|(name, _)| settings.iter().all(|(set, _)| set != name));
        let all: Vec<(String, f64)> = kept.chain(settings).cloned().collect();
        Manifold::with_samples(source, &all, samples)
    }

    /// Checks that plan and cameras are those of `space`, the rays of the embedded manifold.
    pub(crate) fn check(&self, space: &RaySpace) -> Result<(), BundleError> {
        let wrong = |what| Err(BundleError::Invalid(what));
        let axes = space.cameras().len() + space.directions() + 1;
        let plan = &self.plan;
        // The rays.
        if self.reduction != space.reduction() || self.faces as usize != space.faces() {
            return wrong("its symmetry is not the manifold's");
        }
        if !same_intervals(&self.cameras, space.cameras()) {
            return wrong("its cameras are not the manifold's");
        }
        if plan.cells.len() != space.cameras().len() || plan.nodes.len() != axes {
            return wrong("its plan has another number of axes");
        }
        if plan.mirrors.len() > MOST_MIRRORS {
            return wrong("it has more mirrors than there are");
        }
        if !plan.mirrors.iter().all(|mirror| mirror.fits(space)) {
            return wrong("its mirrors are not the manifold's");
        }
        // What only describes the table, but is shown and trusted.
        if self.manifold.name != space.manifold().name {
            return wrong("its name is not the manifold's");
        }
        if self.certify_rays > MOST_CERTIFY_RAYS {
            return wrong("its certificate takes more rays than there can be");
        }
        if !self.certificate.as_ref().is_none_or(Certificate::is_valid) {
            return wrong("its certificate has numbers that are no errors");
        }
        if plan.chart_map == ChartMap::Polar && !space.planar() {
            return wrong("its chart map is one of paths in planes");
        }
        let sphere = plan.sphere();
        if sphere.is_some_and(|sphere| space.planar() || !sphere.is_valid()) {
            return wrong("its axes of directions are out of range");
        }
        plan.check_numbers()
    }
}

impl PlanRecord {
    /// Makes the plainest plan of paths of this `length` that promises `max_error` (mrad): plain
    /// coordinates and variables, each face of directions by itself, no symmetry used, no box divided.
    pub fn new(length: f64, max_error: f64, cells: Vec<u32>, nodes: Vec<u32>) -> Self {
        Self {
            max_error,
            length,
            tangents: TangentPromise::None,
            tolerance: 1e-9,
            nodes,
            most_rays: 1,
            chart_map: ChartMap::None,
            refinement: 1,
            least_volume: 1.0,
            most_arc_halvings: 0,
            cells,
            mapping: MappedChebyshev::NONE,
            parallax: [[0.0; 3]; 3],
            sphere: None,
            mirrors: Vec::new(),
            seed: 1,
        }
    }

    /// Returns the factor by which errors of tangents count more than those of points; `None` if tangents are
    /// not promised.
    pub fn tangent_weight(&self) -> Option<f64> {
        let promise = self.tangents.mrad(self.max_error)?;
        Some(self.max_error / promise)
    }

    /// Tells whether `certificate` shows what is promised of points, and of tangents where they have a promise
    /// of their own. Those that are promised as points are held to that on the rays that steered the bake.
    pub fn is_kept(&self, certificate: &Certificate) -> bool {
        let are_judged = matches!(self.tangents, TangentPromise::Own(_));
        let misses_sky = are_judged && self.is_sky_kept(certificate) == Some(false);
        certificate.keeps(self.max_error) && !misses_sky
    }

    /// Tells whether `certificate` shows what is promised of directions, as points or on their own; `None` where none are
    /// promised or none were seen.
    pub fn is_sky_kept(&self, certificate: &Certificate) -> Option<bool> {
        let promise = self.tangents.mrad(self.max_error)?;
        Some(certificate.sky_mrad?.p99 <= promise)
    }

    /// Says how far directions are off where they are farther than is promised of them. A promise as of points is tested on
    /// the rays that steered the bake: where few rays end at exits, those that do are few of these.
    pub fn sky_excess(&self, certificate: &Certificate) -> Option<String> {
        let promise = self.tangents.mrad(self.max_error)?;
        let sky = certificate.sky_mrad.filter(|sky| sky.p99 > promise)?;
        let largest = match sky.p99 >= NOTHING_SEEN {
            true => " (what a ray counts that leaves by an exit and by the table does not)",
            false => "",
        };
        Some(format!(
            "sky errors exceed {promise} mrad: p99 {:.3} mrad{largest}, among rays that end where directions are promised",
            sky.p99
        ))
    }

    /// Says what is promised for the rays of `space`.
    pub fn promises(&self, space: &RaySpace) -> String {
        let points = format!("99 % of screen errors within {} mrad", self.max_error);
        let place = match tangents_at_exits(space) {
            true => "at exits",
            false => "all along paths",
        };
        match self.tangents.mrad(self.max_error) {
            Some(tangents) => format!("{points}, of sky errors {place} within {tangents} mrad"),
            None => format!("{points}, no directions"),
        }
    }

    /// Sets up the rays of `space` as a table of this plan knows them.
    pub fn applied(&self, space: RaySpace) -> RaySpace {
        let cells = self.cells.iter().map(|n| *n as usize).collect();
        let space = space
            .with_chart_map(self.chart_map)
            .mirrored(self.mirrors.clone());
        let space = space.on_sphere(self.sphere());
        space.with_reference_sphere(ReferenceSphere::new(
            DMat3::from_cols_array_2d(&self.parallax),
            cells,
        ))
    }

    /// Returns the sphere whose directions are held together.
    pub fn sphere(&self) -> Option<Sphere> {
        let axes = self.sphere.as_ref().map(DMat3::from_cols_array_2d);
        axes.map(Sphere::new)
    }

    /// Divides the table over `space` into chunks.
    pub fn division(&self, space: &RaySpace) -> Division {
        let cells = self.cells.iter().map(|n| *n as usize).collect();
        Division::new(cells, space.blocks(), space.mirrors())
    }

    /// Makes the table of this plan over `space` of its chunks, in order.
    pub fn table(&self, space: RaySpace, chunks: Arc<[Chunk]>) -> Table {
        Table {
            division: self.division(&space).into(),
            length: self.length,
            frames: self.tangents != TangentPromise::None,
            space: space.into(),
            chunks,
        }
    }

    /// Writes the bytes that stand for the plan in the bundle's id.
    ///
    /// # Errors
    /// As [`Header::encode`].
    pub fn encode(&self) -> Result<Vec<u8>, BundleError> {
        encode(self)
    }

    /// Checks that all numbers are in their ranges.
    fn check_numbers(&self) -> Result<(), BundleError> {
        let wrong = |what| Err(BundleError::Invalid(what));
        let positive = |x: f64| x.is_finite() && x > 0.0;
        if !self.mapping.is_valid() || !self.parallax.iter().flatten().all(|x| x.is_finite()) {
            return wrong("its alpha or its parallax is out of range");
        }
        let volume = self.least_volume;
        if self.nodes.contains(&0) || self.most_rays == 0 || !(volume > 0.0 && volume <= 1.0) {
            return wrong("its plan has sizes of patches that are none");
        }
        if let ChartMap::Sphere { radius } = self.chart_map
            && !positive(radius)
        {
            return wrong("its plan's chart map has no positive radius");
        }
        let tangents = self.tangents.mrad(self.max_error).unwrap_or(self.max_error);
        let in_range = LENGTHS.contains(&self.length)
            && PROMISES.contains(&self.max_error)
            && PLAN_TOLERANCES.contains(&self.tolerance);
        match in_range && positive(tangents) {
            true => Ok(()),
            false => wrong("its plan has a number that is out of range"),
        }
    }
}

/// The tightest and the loosest promise, mrad: below the first the exact tracer itself is not exact enough; above the
/// second a picture shows nothing.
pub const PROMISES: RangeInclusive<f64> = 1e-5..=1e3;

/// The shortest and the longest arc length that can be asked for: their powers, which integration takes, are numbers.
pub const LENGTHS: RangeInclusive<f64> = 1e-100..=1e100;

/// Local tolerances of the exact paths that a table is made from: others take for ever, or show nothing.
const PLAN_TOLERANCES: RangeInclusive<f64> = 1e-14..=1e-3;

/// Largest difference of two computations of one interval, as a share of its larger end: elementary functions
/// differ by a few last bits between machines, and an end at zero is their rounding.
const INTERVAL_ROUNDING: f64 = 1e-12;

/// Compares intervals but for rounding.
fn same_intervals(a: &[[f64; 2]], b: &[[f64; 2]]) -> bool {
    let same = |(a, b): (&[f64; 2], &[f64; 2])| {
        let all = a.iter().chain(b);
        let most = all.fold(0.0_f64, |most, x| most.max(x.abs()));
        // Where one is infinite, so would be what they may differ by.
        let near =
            |(x, y): (&f64, &f64)| x.is_finite() && (x - y).abs() <= INTERVAL_ROUNDING * most;
        a.iter().zip(b).all(near)
    };
    a.len() == b.len() && a.iter().zip(b).all(same)
}

#[cfg(test)]
#[path = "header_tests.rs"]
mod tests;
