//! Manifold file -> metric, connection, frames, domain and exits, symmetry, camera region.
//!
//! In: the text of a manifold file and parameter values that replace the file's.
//! Out: a [`Manifold`], immutable and shared between threads, whose tapes evaluate everything that
//! later stages need; [`Manifold::curvature`] tells connection and curvature at a point. Chart points
//! `u` and tangents `v` are in coordinates; lengths are in the metric's unit.
//!
//! One definition of a stationary spacetime makes three manifolds, told apart by the paths that they have
//! ([`Follows`]): lines of sight (light followed into the past), light followed into the future, and geodesics of
//! the metric, along which things are carried and distances measured. Without wind and drift all are the same.

mod camera_region;
mod curvature;
mod description;
mod geometry;
mod gluing;
mod isometry;
mod load;
mod local_frame;
mod probe;
mod tapes;
mod wind;

pub(crate) use geometry::around;

pub use camera_region::CameraRegion;
pub use curvature::{Curvature, Rank3, Rank4};
pub use gluing::{DeckTransformation, Development, GluedFace, Gluing, NearCopy, NearestCopies};
pub use isometry::{GroupLaw, Isometry, Symmetry};
pub use local_frame::{Frequencies, LocalFrame, PathNeighbours};
pub use tapes::{ChartCurve, Domain, EventKind, PointFunctions, known_names};

use crate::{
    diagnostic::SourceText,
    error::{Error, Result},
    field::{Field, Samples},
    reading::read_text,
};
use geofan_expr::{Graph, NodeId, Registers, Tape, TapeTooLarge};
use geometry::{Definition, Pullback};
use glam::{DMat3, DVec3};
use std::{
    borrow::Cow,
    path::Path,
    sync::{Arc, OnceLock},
};
use tapes::Tapes;
use wind::Medium;

/// The most by which textbook coordinates change within a few roundings of a point that is not beside an axis: at a
/// distance ρ from one slopes are 1/ρ, and errors of the metric some roundings over ρ. At 1e-5 they are below what counts as
/// a jump ([`crate::geodesic`]); farther out, true edges would be overlooked.
const MOST_CHANGE: f64 = 1e-8;

/// A way out of the manifold, with its own sky.
#[derive(Debug, Clone)]
pub struct Exit {
    /// Its name in scene files and in `trace` output.
    pub name: String,
    /// (u, v) -> the direction in which its sky is looked up; `None`: the ambient direction.
    direction: Option<Tape>,
}

impl Exit {
    /// Tells whether the file says in which direction its sky is looked up.
    pub fn has_direction(&self) -> bool {
        self.direction.is_some()
    }
}

/// The way in which a file gives the space.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// As a surface in R^N.
    Embedding,
    /// The metric, and perhaps a wind or a drift.
    Metric,
    /// As a stationary spacetime, seen by observers at rest on its slices.
    Normal,
    /// As a stationary spacetime, seen by observers at rest in its coordinates.
    Static,
}

/// The rates that a geodesic tape computes, besides acceleration and metric.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Carried {
    /// The turning rate of the transported frame.
    pub frame: bool,
    /// The two columns of geodesic deviation.
    pub deviation: bool,
}

impl Carried {
    fn index(self) -> usize {
        usize::from(self.frame) + 2 * usize::from(self.deviation)
    }
}

/// A manifold, ready to be followed through.
#[derive(Debug, Clone)]
pub struct Manifold {
    /// The file it came from.
    pub source: Arc<SourceText>,
    /// Its name.
    pub name: String,
    /// The names of the coordinates.
    pub coordinates: [String; 3],
    /// The parameters, after `--set`.
    pub parameters: Vec<(String, f64)>,
    /// Coordinate limits and other conditions.
    pub domain: Domain,
    /// The exits: those of the file, then `limit` and `inside`.
    pub exits: Vec<Exit>,
    /// Symmetry claims, each checked numerically on loading.
    pub symmetry: Symmetry,
    /// Where cameras may be.
    pub cameras: Option<CameraRegion>,
    /// Arc length to which a path is followed, if the file says.
    pub length: Option<f64>,
    /// Dimension N of the ambient space, for an embedding.
    pub ambient: Option<usize>,
    /// The way in which the file gives the space.
    pub form: Form,
    /// Functions given by samples.
    pub fields: Arc<[Field]>,
    tapes: Arc<Tapes>,
    /// This space for other paths; `None` where all paths are geodesics.
    kin: Option<Arc<Kin>>,
    follows: Follows,
    /// `None` for a space that is all of its chart.
    gluing: Option<Arc<Gluing>>,
    /// Set if the gluing is left out: the covering space.
    unfolded: bool,
}

impl Manifold {
    /// Loads a manifold file; `settings` replace its parameters.
    ///
    /// # Errors
    /// A file that cannot work, with the place in it.
    pub fn load(path: &Path, settings: &[(String, f64)]) -> Result<Self> {
        Self::from_source(read_text(path)?, settings)
    }

    /// Makes a manifold from the text of its file.
    ///
    /// # Errors
    /// As [`Manifold::load`].
    pub fn from_source(source: Arc<SourceText>, settings: &[(String, f64)]) -> Result<Self> {
        Self::with_samples(source, settings, &[])
    }

    /// Makes a manifold from the text of its file and samples of its fields, by their names; those that are not
    /// given are read from the files that the text names.
    ///
    /// # Errors
    /// As [`Manifold::load`].
    pub fn with_samples(
        source: Arc<SourceText>,
        settings: &[(String, f64)],
        samples: &[(String, Arc<Samples>)],
    ) -> Result<Self> {
        let manifold = load::from_source(&source, settings, samples)?;
        probe::check(&manifold)?;
        manifold.with_checked_gluing()
    }

    /// `G(u)`.
    pub fn metric(&self, u: DVec3) -> DMat3 {
        self.metric_and_frame(u).0
    }

    /// `S(u)`: columns are the standard frame (Gram–Schmidt in coordinate order).
    pub fn standard_frame(&self, u: DVec3) -> DMat3 {
        self.metric_and_frame(u).1
    }

    /// `G(u)` and `S(u)`.
    pub fn metric_and_frame(&self, u: DVec3) -> (DMat3, DMat3) {
        let o = self.at_point(&self.tapes.metric, u);
        (metric_of(&o), frame_of(&o))
    }

    /// `S(u)` at many points: at a fraction of the cost.
    pub fn standard_frames(&self, points: &[DVec3]) -> Vec<DMat3> {
        let both = self.metrics_and_frames(points).into_iter();
        both.map(|(_, frame)| frame).collect()
    }

    /// `G(u)` and `S(u)` at many points.
    fn metrics_and_frames(&self, points: &[DVec3]) -> Vec<(DMat3, DMat3)> {
        let rows = self.at_points(&self.tapes.metric, points);
        let rows = rows.chunks_exact(self.tapes.metric.outputs());
        rows.map(|row| (metric_of(row), frame_of(row))).collect()
    }

    /// Returns whether the space is written in textbook coordinates, which may have an axis where formulas fail
    /// and the space does not.
    pub fn is_pulled_back(&self) -> bool {
        self.tapes.pullback.is_some()
    }

    /// Computes the nine slopes of textbook coordinates at `u`, row by row, and their determinant; none without such.
    fn pullback_slopes(&self, u: DVec3) -> Option<Vec<f64>> {
        let tape = self.tapes.pullback.as_ref();
        tape.map(|tape| tape.at(&u.to_array()))
    }

    /// Whether textbook coordinates are of no use at `u`: where not one of them is regular, or one depends
    /// on the others. On an axis, where only some fail, the space can be told from what is around.
    fn is_pullback_singular(&self, u: DVec3) -> bool {
        let Some(found) = self.pullback_slopes(u) else {
            return false;
        };
        let regular = |row: &[f64]| row.iter().all(|x| x.is_finite());
        found[9] == 0.0 || !found[..9].chunks_exact(3).any(regular)
    }

    /// Tells whether `u` is on an axis of textbook coordinates, where their formulas give no numbers.
    pub(crate) fn is_on_axis(&self, u: DVec3) -> bool {
        let rows = self.pullback_slopes(u);
        rows.is_some_and(|rows| rows.iter().any(|x| !x.is_finite()))
    }

    /// Tells whether textbook coordinates change by much within `reach` of `u`: there is an axis so near that rounding
    /// spoils the metric, on which all of their cuts meet.
    pub(crate) fn is_beside_axis(&self, u: DVec3, reach: f64) -> bool {
        let rows = self.pullback_slopes(u);
        let steep = |slope: &f64| !(slope.abs() * reach <= MOST_CHANGE);
        rows.is_some_and(|rows| rows[..9].iter().any(steep))
    }

    /// The outputs of a tape of the point alone; on the axis of textbook coordinates, what those around it
    /// tend to.
    fn at_point(&self, tape: &Tape, u: DVec3) -> Vec<f64> {
        let outputs = tape.at(&u.to_array());
        if !self.is_pulled_back() || outputs.iter().all(|x| x.is_finite()) {
            return outputs;
        }
        around(u, |u| tape.at(&u.to_array()))
    }

    /// [`Self::at_point`] at many points, a row for each.
    fn at_points(&self, tape: &Tape, points: &[DVec3]) -> Vec<f64> {
        let mut rows = tape.at_each(points.iter().map(DVec3::to_array));
        if self.is_pulled_back() {
            let each = rows.chunks_exact_mut(tape.outputs()).zip(points);
            for (row, u) in each.filter(|(row, _)| !row.iter().all(|x| x.is_finite())) {
                row.copy_from_slice(&self.at_point(tape, *u));
            }
        }
        rows
    }

    /// The tape u -> G (xx, yy, zz, xy, xz, yz), S (11, 22, 33, 12, 13, 23).
    pub fn metric_tape(&self) -> &Tape {
        &self.tapes.metric
    }

    /// Tells whether angles are those of the chart's coordinates: the metric is a factor times their own.
    pub fn is_conformal(&self) -> bool {
        self.tapes.conformal
    }

    /// The tape (u, v, δu₁, δv₁, δu₂, δv₂) -> acceleration (3), then the turning rate (3) if the frame
    /// is carried, then the deviation's acceleration (3 + 3) if it is, and as the rest
    /// ([`Tape::run_rest`]) the metric (6) and, where [`Manifold::has_wind`], the wind (3).
    pub fn flow(&self, carried: Carried) -> &Tape {
        &self.tapes.flows[carried.index()]
    }

    /// The tape u -> for each place where the metric is not smooth, then for each where the formula of an exit jumps, a
    /// function φ(u) that vanishes there and its gradient (4 numbers); `None` if nothing such occurs.
    pub fn switching_functions(&self) -> Option<&Tape> {
        self.tapes.switching.as_ref().map(|(tape, _)| tape)
    }

    /// Returns how many of the switching functions are the metric's.
    pub fn metric_switches(&self) -> usize {
        self.tapes.switching.as_ref().map_or(0, |(_, count)| *count)
    }

    /// Tells on which side `u` is of each place where the metric is not smooth: set where its switching function is positive.
    pub fn metric_sides(&self, u: DVec3) -> Vec<bool> {
        let Some(tape) = self.switching_functions() else {
            return Vec::new();
        };
        let rows = tape.at(&u.to_array());
        let functions = rows.chunks_exact(4).take(self.metric_switches());
        functions.map(|row| row[0] > 0.0).collect()
    }

    /// The direction by which the sky of exit `exit` is looked up, for a ray that is at `u` with
    /// tangent `v` (chart components): normalised, NaN only if the file's expressions are. Without
    /// expressions of its own, it is the direction in which the normal observer there sees the ray.
    pub fn sky_direction(&self, exit: Option<usize>, u: DVec3, v: DVec3) -> DVec3 {
        let mut registers = self.sky_registers(exit);
        self.sky_direction_in(registers.as_mut(), exit, u, v)
    }

    /// Registers for [`Manifold::sky_direction_in`] at an exit; `None` if it needs none.
    pub fn sky_registers(&self, exit: Option<usize>) -> Option<Registers<f64, 1>> {
        let tape = self.own_sky(exit).or(self.tapes.jacobian.as_ref());
        tape.or(self.wind_tape()).map(Tape::registers)
    }

    /// [`Manifold::sky_direction`] in registers made before.
    pub fn sky_direction_in(
        &self,
        registers: Option<&mut Registers<f64, 1>>,
        exit: Option<usize>,
        u: DVec3,
        v: DVec3,
    ) -> DVec3 {
        let tapes = (self.own_sky(exit), &self.tapes.jacobian, self.wind_tape());
        let direction = match (tapes, registers) {
            ((Some(tape), ..), Some(registers)) => {
                tape.run_at(registers, &[u.x, u.y, u.z, v.x, v.y, v.z]);
                DVec3::from_array([0, 1, 2].map(|i| registers.output(i)[0]))
            }
            ((None, Some(jacobian), _), Some(registers)) => {
                jacobian.run_at(registers, &u.to_array());
                let j = |k: usize| registers.output(k)[0];
                let v = self.sight(u, v);
                DVec3::from_array([0, 3, 6].map(|i| j(i) * v.x + j(i + 1) * v.y + j(i + 2) * v.z))
            }
            ((None, None, Some(wind)), Some(registers)) => {
                wind.run_at(registers, &u.to_array());
                v - DVec3::from_array([0, 1, 2].map(|i| registers.output(i)[0]))
            }
            _ => self.sight(u, v),
        };
        direction.normalize_or_zero()
    }

    /// The tape whose first three outputs are the wind, where there is one.
    fn wind_tape(&self) -> Option<&Tape> {
        self.tapes.medium.as_ref().filter(|_| self.has_wind())
    }

    /// The directions by which an exit's own sky is looked up.
    fn own_sky(&self, exit: Option<usize>) -> Option<&Tape> {
        exit.and_then(|e| self.exits[e].direction.as_ref())
    }

    /// The index of the exit called `name`.
    pub fn exit_named(&self, name: &str) -> Option<usize> {
        self.exits.iter().position(|e| e.name == name)
    }

    /// The path length to follow: `asked`, else the file's.
    ///
    /// # Errors
    /// Neither is given.
    pub fn length_or(&self, asked: Option<f64>) -> Result<f64> {
        asked.or(self.length).ok_or_else(|| {
            Error::input(
                self.source.name.clone(),
                "no path length: add `length` under [cameras] or give --length",
            )
        })
    }

    /// A hash of everything that determines the geometry: the text, the parameter values, and the samples of
    /// fields.
    pub fn fingerprint(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.source.text.as_bytes());
        for (name, value) in &self.parameters {
            hasher.update(name.as_bytes());
            hasher.update(&[0]);
            hasher.update(&value.to_bits().to_le_bytes());
        }
        for field in self.fields.iter() {
            hasher.update(field.spline.identity());
        }
        *hasher.finalize().as_bytes()
    }
}

/// The upper triangular matrix with the entries 11, 22, 33, 12, 13, 23.
fn frame_of(o: &[f64]) -> DMat3 {
    DMat3::from_cols_array(&[o[6], 0.0, 0.0, o[9], o[7], 0.0, o[10], o[11], o[8]])
}

/// The matrix of the metric from its entries xx, yy, zz, xy, xz, yz, as the tape of metric and frame begins.
fn metric_of(o: &[f64]) -> DMat3 {
    DMat3::from_cols_array(&[o[0], o[3], o[4], o[3], o[1], o[5], o[4], o[5], o[2]])
}

/// The paths that a manifold follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Follows {
    /// Light into the past, as an eye does.
    #[default]
    Sight,
    /// Light into the future, from a lamp.
    Light,
    /// Geodesics of the metric.
    Geodesics,
}

/// The sources of the tapes for other paths.
#[derive(Debug)]
struct Kin {
    graph: Graph,
    definition: Definition,
    medium: Medium,
    pullback: Option<Pullback>,
    /// The formulas of exits.
    exits: Vec<NodeId>,
    light: OnceLock<Result<Arc<Tapes>, TapeTooLarge>>,
    /// The connection of the metric, without which nothing can be said of errors.
    pub geodesics: Arc<Tapes>,
}

impl Kin {
    /// For light in a medium, with the formulas of exits behind; `None` if the medium does not move.
    pub fn new(
        graph: &Graph,
        definition: &Definition,
        medium: Medium,
        pullback: Option<&Pullback>,
        exits: &[NodeId],
    ) -> Result<Option<Arc<Self>>, TapeTooLarge> {
        if !medium.moves() {
            return Ok(None);
        }
        let alone = Medium {
            lapse: medium.lapse,
            ..Medium::default()
        };
        let geodesics = compiled(graph.clone(), definition, &alone, pullback, exits)?;
        Ok(Some(Arc::new(Self {
            graph: graph.clone(),
            definition: definition.clone(),
            medium,
            pullback: pullback.cloned(),
            exits: exits.to_vec(),
            light: OnceLock::new(),
            geodesics,
        })))
    }

    fn light(&self) -> Result<Arc<Tapes>, TapeTooLarge> {
        let compile = || {
            let pullback = self.pullback.as_ref();
            let graph = self.graph.clone();
            compiled(graph, &self.definition, &self.medium, pullback, &self.exits)
        };
        self.light.get_or_init(compile).clone()
    }
}

/// The tapes for paths of light in `medium`.
fn compiled(
    mut graph: Graph,
    definition: &Definition,
    medium: &Medium,
    pullback: Option<&Pullback>,
    exits: &[NodeId],
) -> Result<Arc<Tapes>, TapeTooLarge> {
    let geometry = geometry::build(&mut graph, definition, medium);
    Tapes::compile(graph, definition, medium, geometry, pullback, exits).map(Arc::new)
}

impl Manifold {
    /// Returns the kind of paths that it follows.
    pub fn follows(&self) -> Follows {
        self.follows
    }

    /// Returns this space with light followed into the future.
    ///
    /// # Errors
    /// Its expressions are too large to be compiled.
    pub fn forward(&self) -> Result<Cow<'_, Self>> {
        let Some(kin) = &self.kin else {
            return Ok(Cow::Borrowed(self));
        };
        let tapes = kin.light().map_err(|e| {
            let subject = self.source.name.clone();
            Error::input(subject, format!("light cannot be followed forward: {e}"))
        })?;
        Ok(Cow::Owned(self.with(Follows::Light, tapes)))
    }

    /// Returns this space without wind and drift: geodesics of the metric.
    pub fn still(&self) -> Cow<'_, Self> {
        match &self.kin {
            Some(kin) => Cow::Owned(self.with(Follows::Geodesics, kin.geodesics.clone())),
            None => Cow::Borrowed(self),
        }
    }

    fn with(&self, follows: Follows, tapes: Arc<Tapes>) -> Self {
        Self {
            follows,
            tapes,
            ..self.clone()
        }
    }

    /// The tapes of the metric's own connection.
    fn levi_civita(&self) -> &Tapes {
        match &self.kin {
            Some(kin) => &kin.geodesics,
            None => &self.tapes,
        }
    }
}
