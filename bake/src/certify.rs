//! The certificate: errors of a table against exact paths on fresh random rays.
//!
//! In: a [`Table`], a number of [`RandomRays`] and a seed. Out: a [`Certificate`], equal for any number of
//! threads. Cameras are uniform over the region's parameters and moved by a random element of the symmetry;
//! directions are uniform over the sphere; each ray is compared at one arc length, uniform up to the end of
//! its exact path.

use crate::ray_errors::RayErrors;
use geofan_bundle::{
    Certificate, Checked, FAR, MOST, Outlier, Table,
    measure::{Probed, probe, settings, with_end},
    rays::{Axis, RaySpace, Reduction},
};
use geofan_core::{
    Error, Result,
    geodesic::{End, Ray, Settings, UnfinishedPaths, check_start, ends_alone},
    manifold::{CameraRegion, Manifold},
    quantiles::Quantiles,
    random::Stream,
};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Keeps the certificate's random numbers apart from those of a bake with the same seed.
const KEY: u64 = 0x6365_7274_6966_7921;

/// Cameras whose exact rays are followed together: those of one alone leave most lanes idle.
const CAMERAS: usize = 16;

/// Errors found on the rays of one camera, in mrad.
#[derive(Default)]
pub(crate) struct CertificateErrors {
    mrad: Vec<f64>,
    screen: Vec<f64>,
    sky: Vec<f64>,
    rotation: Vec<f64>,
    flagged: usize,
    far: Vec<Outlier>,
    /// Rays (chart point, direction) that ended by their length, and how many ended where the metric does.
    by_length: Vec<(DVec3, DVec3)>,
    singular: usize,
}

/// Compares `table` with exact paths of `rays` random rays. `progress` is told how many more are
/// done, from any thread; an error from it ends the work.
///
/// # Errors
/// No camera lies in the domain, the table is damaged, or `progress` says so.
pub fn certify(
    table: &Table,
    rays: usize,
    seed: u64,
    tolerance: f64,
    promise: f64,
    progress: impl Fn(u64) -> Result<()> + Sync,
) -> Result<Checked> {
    let chunks = (0..table.chunks.len()).into_par_iter();
    chunks.try_for_each(|chunk| {
        progress(0)?;
        table.whole_tree(chunk)?;
        Ok::<(), Error>(())
    })?;
    let rays = CertificateRays {
        rays,
        seed,
        tolerance,
        promise,
        length: table.length,
    };
    let cameras: Vec<usize> = (0..rays.cameras()).collect();
    let errors = rays.compared(table, &cameras, progress)?;
    Ok(rays.checked(table, errors))
}

/// The rays of a certificate, and what they are held to.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CertificateRays {
    pub rays: usize,
    pub seed: u64,
    /// Local tolerance of the exact tracer.
    pub tolerance: f64,
    /// mrad.
    pub promise: f64,
    /// Length of the table's paths.
    pub length: f64,
}

impl CertificateRays {
    /// Counts the cameras.
    pub fn cameras(&self) -> usize {
        self.rays.div_ceil(DIRECTIONS)
    }

    /// Draws the rays of one camera of `space`.
    ///
    /// # Errors
    /// As of [`RandomRays::all`].
    pub fn of(&self, space: &RaySpace, camera: usize) -> Result<RandomRays> {
        RandomRays::of(space, (self.rays, self.length), [KEY, self.seed], camera)
    }

    /// Compares `table` with exact paths of the rays of these `cameras`; one result for each, in order.
    ///
    /// # Errors
    /// As of [`certify`].
    pub fn compared(
        &self,
        table: &Table,
        cameras: &[usize],
        progress: impl Fn(u64) -> Result<()> + Sync,
    ) -> Result<Vec<CertificateErrors>> {
        let groups = cameras.par_chunks(CAMERAS).map(|group| {
            let drawn = group.iter().map(|camera| self.of(&table.space, *camera));
            let drawn: Vec<RandomRays> = drawn.collect::<Result<_>>()?;
            let errors = self.at_cameras(table, &drawn, &progress)?;
            let count: usize = drawn.iter().map(|camera| camera.directions.len()).sum();
            progress(count as u64)?;
            Ok(errors)
        });
        let groups: Result<Vec<_>> = groups.collect();
        Ok(groups?.into_iter().flatten().collect())
    }

    /// Compares the rays of some cameras, all followed together; asks `progress` before each, which may take a second.
    fn at_cameras(
        &self,
        table: &Table,
        cameras: &[RandomRays],
        progress: impl Fn(u64) -> Result<()>,
    ) -> Result<Vec<CertificateErrors>> {
        let manifold = table.space.manifold();
        let rays = cameras
            .iter()
            .flat_map(|camera| camera.directions.iter().map(|d| (camera.u, *d)));
        let rays: Vec<(DVec3, DVec3)> = rays.collect();
        let shares: Vec<f64> = cameras.iter().flat_map(|c| &c.shares).copied().collect();
        let lengths = |ray: usize, end: f64| with_end(shares[ray], end);
        let settings = settings(self.tolerance);
        let probed = probe(manifold, settings, table.length, &rays, lengths);
        let mut probed = probed.into_iter();
        let errors = cameras.iter().map(|camera| {
            let exact = probed.by_ref().take(camera.directions.len());
            progress(0)?;
            let mut errors = CertificateErrors::default();
            errors.add(table, camera, exact, self.promise)?;
            Ok(errors)
        });
        errors.collect()
    }

    /// Puts the errors at all cameras, in order, together to what is published of `table`, whose chunks are not
    /// looked at.
    pub fn checked(
        &self,
        table: &Table,
        cameras: impl IntoIterator<Item = CertificateErrors>,
    ) -> Checked {
        let mut all = CertificateErrors::default();
        cameras.into_iter().for_each(|errors| all.append(errors));
        let rays = self.rays;
        // The worst rays, and the quantiles of all.
        let far = all.far.len();
        all.far
            .sort_by(|a, b| b.screen_mrad.total_cmp(&a.screen_mrad));
        all.far.truncate(MOST);
        let certificate = Certificate {
            mrad: Quantiles::of(&mut all.mrad),
            screen_mrad: Quantiles::of(&mut all.screen),
            sky_mrad: (!all.sky.is_empty()).then(|| Quantiles::of(&mut all.sky)),
            rotation_mrad: (!all.rotation.is_empty()).then(|| Quantiles::of(&mut all.rotation)),
            flagged: all.flagged as f64 / rays.max(1) as f64,
            rays: rays as u64,
            seed: self.seed,
            tolerance: self.tolerance,
            exact_rays_baked: 0,
        };
        Checked {
            certificate,
            far,
            unfinished: all.unfinished(table, rays, self.tolerance),
            worst: all.far,
        }
    }
}

impl CertificateErrors {
    /// Adds those at another camera.
    fn append(&mut self, mut other: Self) {
        self.mrad.append(&mut other.mrad);
        self.screen.append(&mut other.screen);
        self.sky.append(&mut other.sky);
        self.rotation.append(&mut other.rotation);
        self.flagged += other.flagged;
        self.far.append(&mut other.far);
        self.by_length.append(&mut other.by_length);
        self.singular += other.singular;
    }

    /// Adds the errors on the rays of `camera`, whose exact paths are `exact`.
    fn add(
        &mut self,
        table: &Table,
        camera: &RandomRays,
        exact: impl Iterator<Item = Probed>,
        promise: f64,
    ) -> Result<()> {
        let fan = table.fan(camera.u)?;
        for (d, exact) in camera.directions.iter().zip(exact) {
            match exact.end {
                End::Length => self.by_length.push((camera.u, *d)),
                End::Singular => self.singular += 1,
                End::Exit(_) => {}
            }
            let errors = RayErrors::of_table(table, &fan.path(*d), &exact);
            self.sky.extend(errors.sky_mrad);
            self.rotation.extend(errors.rotation_mrad);
            self.flagged += usize::from(errors.flagged);
            let Some(found) = errors.deviation else {
                continue;
            };
            self.mrad.push(found.mrad);
            self.screen.push(found.screen_mrad);
            if let Some(probe) = exact.probes.first()
                && !(found.screen_mrad <= FAR * promise)
            {
                let (place, s) = (&fan.place, (probe.s, exact.length));
                let outlier = table.outlier(place, *d, s, found, probe.magnification());
                self.far.push(outlier?);
            }
        }
        Ok(())
    }

    /// Tells what share of `rays` rays ended by their length or where the metric does, and which length would
    /// do where the space has exits of its own.
    fn unfinished(&self, table: &Table, rays: usize, tolerance: f64) -> UnfinishedPaths {
        let found = UnfinishedPaths::counted(self.by_length.len(), self.singular, rays);
        let manifold = table.space.manifold();
        if !manifold.domain.has_exits() {
            return found;
        }
        found.followed(table.length, |length| {
            let ray = |(u, d): (DVec3, DVec3)| Ray::new(manifold, u, d, length);
            let rays = UnfinishedPaths::sample(&self.by_length)
                .into_iter()
                .map(ray);
            let rays: Vec<Ray> = rays.collect();
            let settings = Settings::bare(tolerance.max(FARTHER_TOLERANCE)).with_events();
            let ends = rays.par_chunks(FARTHER_BLOCK);
            let ends = ends.flat_map_iter(|rays| ends_alone(manifold, settings, rays));
            ends.map(|(end, s)| matches!(end, End::Exit(_)).then_some(s))
                .collect()
        })
    }
}

/// Local tolerance of the paths that are followed farther, and how many one thread follows at a time: where
/// they end is told to two digits.
const FARTHER_TOLERANCE: f64 = 1e-8;
const FARTHER_BLOCK: usize = 64;

/// Random rays from one camera.
#[derive(Debug, Clone)]
pub struct RandomRays {
    /// The camera.
    pub u: DVec3,
    /// Directions in the standard frame, unit.
    pub directions: Vec<DVec3>,
    /// Share of the path of each at which it is compared, in (0, 1].
    pub shares: Vec<f64>,
}

/// Rays from each camera: fixing a camera of the table costs about as much as so many exact rays.
const DIRECTIONS: usize = 16;

/// Random cameras tried for one that lies in the domain, for each [`Spread`].
const ATTEMPTS: usize = 1000;

impl RandomRays {
    /// Draws `rays` rays of `space`, for paths of this `length`, those of each camera together; another `key` gives others.
    ///
    /// # Errors
    /// There is no region, or none of many cameras lies in the domain.
    pub fn all(
        space: &RaySpace,
        (rays, length): (usize, f64),
        key: [u64; 2],
    ) -> impl IndexedParallelIterator<Item = Result<Self>> {
        let cameras = (0..rays.div_ceil(DIRECTIONS)).into_par_iter();
        cameras.map(move |camera| Self::of(space, (rays, length), key, camera))
    }

    /// Draws those from the camera with this number.
    fn of(
        space: &RaySpace,
        (rays, length): (usize, f64),
        key: [u64; 2],
        camera: usize,
    ) -> Result<Self> {
        let count = DIRECTIONS.min(rays - camera * DIRECTIONS);
        let mut stream = Stream::new(&[key[0], key[1], camera as u64]);
        Ok(Self {
            u: random_camera(space, length, &mut stream)?,
            directions: (0..count).map(|_| stream.direction()).collect(),
            shares: (0..count).map(|_| 1.0 - stream.uniform()).collect(),
        })
    }
}

/// Draws a camera of the region, moved by the symmetry, where rays of this length can start.
fn random_camera(space: &RaySpace, length: f64, stream: &mut Stream) -> Result<DVec3> {
    let manifold = space.manifold();
    let region = manifold.cameras.as_ref();
    let region = region.ok_or_else(|| Error::input(&manifold.source.name, "no camera region"))?;
    let found = Spread::all(manifold, region, length)
        .flat_map(|spread| std::iter::repeat_n(spread, ATTEMPTS))
        .map(|spread| moved(space.reduction(), manifold, (region, spread), stream))
        .find(|u| check_start(manifold, "camera", *u).is_ok());
    found.ok_or_else(|| {
        let message =
            format!("none of {ATTEMPTS} random cameras lies in the domain, this side of its exits: see `at` and `parameters` of [cameras]");
        Error::input(&manifold.source.name, message)
    })
}

/// Lengths of paths, at most, by which a symmetry moves cameras, and the inverse of the least.
const FARTHEST: f64 = 1e3;

/// How far a symmetry moves cameras along coordinates without limits, in the chart.
#[derive(Debug, Clone, Copy)]
enum Spread {
    /// To anywhere at most so far from the origin.
    Origin(f64),
    /// As far from where they are.
    Near(f64),
}

impl Spread {
    /// Lists all in `manifold` for paths of this length: about the origin, and where space is elsewhere or ends sooner, ever
    /// less about the region itself.
    fn all(
        manifold: &Manifold,
        region: &CameraRegion,
        length: f64,
    ) -> impl Iterator<Item = Self> + use<> {
        // By 1, unless paths are so long or short in the chart that this shows nothing, or rounding alone.
        let frame = manifold.standard_frame(region.at(&region.lerp(&[0.5; 3])));
        let path = length * frame.determinant().abs().cbrt();
        let unit = match path > 0.0 && path.is_finite() {
            true => 1.0_f64.clamp(path / FARTHEST, path * FARTHEST),
            false => 1.0,
        };
        let near = (0..10).map(move |digits| Self::Near(unit * 10.0_f64.powi(-digits)));
        std::iter::once(Self::Origin(unit)).chain(near)
    }

    /// Returns the interval about `x`.
    fn around(self, x: f64) -> [f64; 2] {
        match self {
            Self::Origin(distance) => [-distance, distance],
            Self::Near(distance) => [x - distance, x + distance],
        }
    }
}

/// Draws a point of the region and moves it by a random element of the symmetry.
fn moved(
    reduction: Reduction,
    manifold: &Manifold,
    (region, spread): (&CameraRegion, Spread),
    stream: &mut Stream,
) -> DVec3 {
    let t: Vec<f64> = (0..region.dimension()).map(|_| stream.uniform()).collect();
    let mut u = region.at(&region.lerp(&t));
    let here = u;
    let mut anywhere = |k: usize| {
        let [low, high] = manifold.domain.limits[k].unwrap_or(spread.around(here[k]));
        stream.between(low, high)
    };
    match reduction {
        Reduction::Whole => {}
        Reduction::Rotation => u = stream.rotation() * u,
        Reduction::Axis => {
            let axis = manifold.symmetry.axis.unwrap_or(2);
            if manifold.symmetry.translation[axis] {
                u[axis] = anywhere(axis);
            }
            u = Axis(axis).rotation(stream.between(-PI, PI)) * u;
        }
        Reduction::Translation => {
            for k in (0..3).filter(|k| manifold.symmetry.translation[*k]) {
                u[k] = anywhere(k);
            }
        }
        // The group acts simply transitively: the identity goes to any point.
        Reduction::Group => u = DVec3::from_array([0, 1, 2].map(anywhere)),
    }
    u
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_bundle::{
        Chunk, DecodeBudget, Division, MappedChebyshev, Polynomial, StepSize, Train, Tree,
        Variables,
    };
    use geofan_core::diagnostic::SourceText;
    use ndarray::{ArrayD, IxDyn};
    use std::sync::Arc;

    const FLAT: &str = r#"
name = "flat"
coordinates = ["x", "y", "z"]
metric = { conformal = "1" }
[symmetry]
translation = ["x", "y", "z"]
[cameras]
at = ["0", "0", "0"]
length = 5.0
"#;

    /// Makes a flat table whose slope along y and z is `wrong` everywhere; face 0 is flagged.
    fn table(wrong: f64) -> Table {
        let manifold = Manifold::from_source(SourceText::new("flat", FLAT), &[]).unwrap();
        let space = RaySpace::new(Arc::new(manifold)).unwrap();
        let slopes = vec![0.0, wrong, wrong];
        let samples = ArrayD::from_shape_vec(IxDyn(&[1, 1, 1, 3]), slopes).unwrap();
        let polynomial = Polynomial {
            coefficients: samples,
            variables: Variables::of_face(0, MappedChebyshev::NONE),
        };
        let tensor = Train::plain(&polynomial).rounded(StepSize::near(1e-8));
        let leaf = Tree::Leaf(Arc::new(tensor.unwrap()));
        let mut chunks = vec![leaf; 6];
        chunks[0] = Tree::Flagged;
        let shape = Table::tensor_shape(&space, MappedChebyshev::NONE);
        let budget = Arc::new(DecodeBudget::for_bytes(0));
        let chunks = chunks.iter();
        let chunks = chunks.map(|tree| Chunk::new(tree.encode(), shape, budget.clone()));
        Table {
            space: space.into(),
            division: Division::new(Vec::new(), 6, &[]).into(),
            length: 5.0,
            frames: true,
            chunks: chunks.collect(),
        }
    }

    #[test]
    fn a_perfect_table_has_no_error_and_its_flagged_face_is_counted() {
        let found = certify(&table(0.0), 3000, 7, 1e-10, 1.0, |_| Ok(()));
        let found = found.unwrap().certificate;
        assert!(found.screen_mrad.max < 1e-6, "{found:?}");
        assert!(found.rotation_mrad.unwrap().max < 1e-3);
        assert!((found.flagged - 1.0 / 6.0).abs() < 0.03, "{found:?}");
    }

    #[test]
    fn a_wrong_table_is_wrong_by_what_was_put_in() {
        let found = certify(&table(1e-3), 1001, 7, 1e-10, 0.01, |_| Ok(())).unwrap();
        assert!(found.far > 500 && found.worst.len() == MOST);
        assert_eq!(found.worst[0].patch.intervals.len(), 3);
        let found = found.certificate;
        // Displacement is per arc length: √2 mrad, less its part along the ray.
        assert!(found.screen_mrad.max <= 2_f64.sqrt() + 1e-6);
        assert!(found.screen_mrad.max > 1.4 && found.screen_mrad.p50 > 0.8);
        // In flat space a tangent that is off by as much looks the same, and frames do not turn.
        let sky = found.sky_mrad.unwrap();
        assert!((sky.max - found.screen_mrad.max).abs() < 1e-3);
        assert!(found.rotation_mrad.unwrap().max < 1e-3);
        assert_eq!(found.rays, 1001);
    }

    #[test]
    fn one_thread_and_many_find_the_same() {
        let table = table(1e-3);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let work = || certify(&table, 333, 9, 1e-9, 0.01, |_| Ok(())).unwrap();
            pool.build().unwrap().install(work)
        };
        assert_eq!(with(1), with(5));
    }

    #[test]
    fn progress_can_stop_the_work() {
        let stop = |_| Err(Error::input("test", "stop"));
        assert!(certify(&table(0.0), 100, 1, 1e-9, 1.0, stop).is_err());
        // It is asked before each of the six chunks and of the seven cameras, and behind all rays of those.
        let asked = std::sync::atomic::AtomicU64::new(0);
        let ask = |_| {
            asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Ok(())
        };
        certify(&table(0.0), 100, 1, 1e-9, 1.0, ask).unwrap();
        assert_eq!(asked.into_inner(), 6 + 7 + 1);
    }
}
