//! Motion and heat in scene files: how cameras and objects move, how hot objects are.
//!
//! In: `rest` or `velocity` of a camera, `velocity` and `temperature` of an object. Out: a
//! [`CameraMotion`], and [`Formulas`] of the chart point, numbers or expressions, that are read where the
//! manifold is known.
//!
//! In: the `path` of an object: three expressions of the time t with the interval `during` which they hold, or the name
//! of a file of key poses; perhaps a `turning`. Out: a [`Trajectory`], checked as far as the text allows.
//!
//! ```toml
//! path = ["0.5*cos(t)", "0.5*sin(t)", "0"]           # or path = "poses.toml"
//! during = [0, 6.283185]                             # of expressions: before and after, the object stands still
//! turning = { axis = [0, 0, 1], degrees = "90*t" }   # optional, in the axes that are carried along
//! ```
//!
//! In: the text of a TOML file of `[[pose]]` tables, the key poses of an animation, each with `time` (seconds,
//! ascending) and what a scene's `[camera]` has: `at` or `parameters`, `look`, `up`, `fov`, `rest` or `velocity`; how
//! the camera draws is the scene's, and so is the `fov` of poses without one. Out: [`PoseFile`].
//!
//! ```toml
//! [[pose]]
//! time = 0.0
//! parameters = { c = 4.0 }
//! look = [-1.0, 0.0, 0.0]
//! up = [0.0, 0.0, 1.0]
//!
//! [[pose]]
//! time = 5.0
//! at = [0.8, 0.1, 0.0]
//! look = [-1.0, 0.2, 0.0]
//! up = [0.0, 0.0, 1.0]
//! fov = 70.0
//! ```

use super::{
    file::{CameraEntry, each},
    lens::{USUAL_FOV, camera_entry},
    named_table::{NamedTable, NamedValue, Span, parse},
};
use geofan_core::{
    diagnostic::{Diagnostic, SourceText},
    document::place_in_string,
    error::Result,
    manifold::{ChartCurve, Manifold, PointFunctions, known_names},
    reading::{self, read_text},
};
use geofan_expr::parse::ExpressionError;
use glam::DVec3;
use std::{path::Path, sync::Arc};

/// Tells how a camera moves.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum CameraMotion {
    /// As the normal observer at its point, whose directions tables hold.
    #[default]
    Normal,
    /// At rest in the chart.
    Static,
    /// Past the normal observer, with a velocity in the standard frame; light has 1.
    Velocity(DVec3),
}

impl CameraMotion {
    /// Reads `rest` or `velocity`, of which a camera may have one.
    pub(super) fn read(table: &NamedTable) -> Result<(Self, Span)> {
        match (table.optional("rest"), table.optional("velocity")) {
            (None, None) => Ok((Self::Normal, table.span())),
            (Some(rest), None) => {
                let choices = [("normal", Self::Normal), ("static", Self::Static)];
                Ok((rest.choice(&choices)?, rest.span()))
            }
            (None, Some(velocity)) => {
                let v = velocity.vector()?;
                if v.length() < 1.0 {
                    return Ok((Self::Velocity(v), velocity.span()));
                }
                Err(velocity
                    .complain(String::from("`velocity` must be shorter than 1"))
                    .with_label("as fast as light, or faster")
                    .with_hint("it is past the normal observer, in the standard frame; light has 1")
                    .into())
            }
            (Some(_), Some(velocity)) => Err(velocity
                .complain(String::from("a camera has both `rest` and `velocity`"))
                .with_label("its motion is given twice")
                .with_hint("give either `rest = \"static\"` or `velocity = [0.1, 0.0, 0.0]`")
                .into()),
        }
    }

    /// Returns the velocity past the normal observer at `u`, standard frame; `None` if nothing can move
    /// like that there.
    pub fn velocity(self, manifold: &Manifold, u: DVec3) -> Option<DVec3> {
        let velocity = match self {
            Self::Normal => DVec3::ZERO,
            Self::Static => manifold.rest_velocity(u),
            Self::Velocity(velocity) => velocity,
        };
        (velocity.length() < 1.0).then_some(velocity)
    }
}

/// Holds formulas of the chart point as a scene file states them.
#[derive(Debug, Clone, PartialEq)]
pub struct Formulas {
    texts: Vec<String>,
    spans: Vec<Span>,
    /// The place of all.
    pub span: Span,
}

impl Formulas {
    /// Reads one formula.
    pub(super) fn one(value: &NamedValue) -> Result<Self> {
        let (text, span) = formula(value)?;
        Ok(Self {
            texts: vec![text],
            spans: vec![span],
            span: value.span(),
        })
    }

    /// Reads three formulas.
    pub(super) fn three(value: &NamedValue) -> Result<Self> {
        let expected = "three numbers or expressions such as [\"-y*w\", \"x*w\", 0]";
        let items = value.array(expected)?;
        if items.len() != 3 {
            return Err(value.wrong_type(expected).into());
        }
        let read = items.iter().map(formula).collect::<Result<Vec<_>>>()?;
        let (texts, spans) = read.into_iter().unzip();
        Ok(Self {
            texts,
            spans,
            span: value.span(),
        })
    }

    /// Compiles them as functions of the points of `manifold`.
    ///
    /// # Errors
    /// An expression that means nothing, at its place in `source`.
    pub fn compile(&self, manifold: &Manifold, source: &Arc<SourceText>) -> Result<PointFunctions> {
        let texts: Vec<&str> = self.texts.iter().map(String::as_str).collect();
        PointFunctions::parse(manifold, &texts)
            .map_err(|(i, error)| self.complain(source, i, (error, "coordinates")).into())
    }

    /// Compiles them as functions of the time t, up to three; others are 0.
    ///
    /// # Errors
    /// As [`Formulas::compile`].
    pub fn curve(&self, manifold: &Manifold, source: &Arc<SourceText>) -> Result<ChartCurve> {
        let texts = [0, 1, 2].map(|k| self.texts.get(k).map_or("0", String::as_str));
        ChartCurve::parse(manifold, "t", texts)
            .map_err(|(i, error)| self.complain(source, i, (error, "`t`")).into())
    }

    /// The complaint about the formula with number `i`, which may use `names` besides parameters.
    fn complain(
        &self,
        source: &Arc<SourceText>,
        i: usize,
        (error, names): (ExpressionError, &str),
    ) -> Diagnostic {
        let advice = error.advice(&known_names(names));
        let place = place_in_string(source, &self.spans[i], &self.texts[i], error.span);
        let diagnostic = Diagnostic::new(source, place, error.message);
        match advice {
            Some(hint) => diagnostic.with_hint(hint),
            None => diagnostic,
        }
    }
}

/// Reads a number or an expression, with its place.
fn formula(value: &NamedValue) -> Result<(String, Span)> {
    let text = match value.is_string() {
        true => value.string()?.to_owned(),
        false => format!("({:?})", value.number()?),
    };
    Ok((text, value.span()))
}

/// Where an object is.
#[derive(Debug, Clone)]
pub enum Course {
    /// On a curve of the chart: its frame is carried along in parallel.
    Curve(Formulas),
    /// As a camera would go through key poses, with the axes of that camera.
    Poses(Arc<PoseFile>),
}

/// How an object moves in time.
#[derive(Debug, Clone)]
pub struct Trajectory {
    /// Where it is.
    pub course: Course,
    /// First and last time.
    pub during: [f64; 2],
    /// An axis of the object's own, and the angle turned about it, degrees.
    pub turning: Option<(DVec3, Formulas)>,
    /// Where the path is given.
    pub span: Span,
}

impl Trajectory {
    /// Writes down all that decides where the object is, to be hashed.
    pub fn told(&self) -> String {
        let course = match &self.course {
            Course::Curve(formulas) => format!("{:?}", formulas.texts),
            Course::Poses(file) => {
                let pose = |pose: &KeyPose| {
                    let camera = &pose.camera;
                    format!(
                        "{:?}",
                        (pose.time, &camera.position, camera.look, camera.up)
                    )
                };
                let poses: Vec<String> = file.poses.iter().map(pose).collect();
                poses.join(" ")
            }
        };
        let turning = self.turning.as_ref();
        let turning = turning.map(|(axis, angle)| (axis, &angle.texts));
        format!("{course} {:?} {turning:?}", self.during)
    }
}

/// Reads the keys of an object's path, if it has one; files are relative to `folder`.
pub(super) fn trajectory(table: &NamedTable, folder: &Path) -> Result<Option<Trajectory>> {
    let [path, during, turning] = ["path", "during", "turning"].map(|key| table.optional(key));
    let Some(path) = path else {
        return match during.or(turning) {
            None => Ok(None),
            Some(other) => Err(other
                .complain(String::from("an object without `path` stands still"))
                .with_label("says how something moves")
                .with_hint("add path = [\"x(t)\", \"y(t)\", \"z(t)\"], or take this away")
                .into()),
        };
    };
    let turning = turning.map(|value| read_turning(&value)).transpose()?;
    let (course, during) = match path.is_string() {
        true => read_poses(&path, during.as_ref(), folder)?,
        false => {
            let formulas = Formulas::three(&path)?;
            let Some(during) = during else {
                return Err(path
                    .complain(String::from("a path of expressions needs `during`"))
                    .with_label("holds for an interval of t")
                    .with_hint("write during = [0, 10]")
                    .into());
            };
            (Course::Curve(formulas), read_interval(&during)?)
        }
    };
    Ok(Some(Trajectory {
        course,
        during,
        turning,
        span: path.span(),
    }))
}

fn read_poses(
    path: &NamedValue,
    during: Option<&NamedValue>,
    folder: &Path,
) -> Result<(Course, [f64; 2])> {
    if let Some(during) = during {
        return Err(during
            .complain(String::from("a file of poses has times of its own"))
            .with_label("given twice")
            .with_hint("take `during` away")
            .into());
    }
    let file = folder.join(path.string()?);
    if !reading::exists(&file) {
        return Err(path
            .complain(format!("{}: no such file or folder", file.display()))
            .with_hint("paths are relative to the scene file")
            .into());
    }
    let poses = PoseFile::load(&file, USUAL_FOV)?;
    let times = [poses.poses.first(), poses.poses.last()];
    let during = times.map(|pose| pose.map_or(0.0, |pose| pose.time));
    Ok((Course::Poses(Arc::new(poses)), during))
}

fn read_interval(value: &NamedValue) -> Result<[f64; 2]> {
    let expected = "two times, the earlier first, such as [0, 10]";
    let items = value.array(expected)?;
    match items.as_slice() {
        [from, to] => {
            let interval = [from.number()?, to.number()?];
            match interval[0] < interval[1] {
                true => Ok(interval),
                false => Err(value
                    .complain(String::from("`during` needs its earlier time first"))
                    .with_label("an empty interval")
                    .into()),
            }
        }
        _ => Err(value.wrong_type(expected).into()),
    }
}

fn read_turning(value: &NamedValue) -> Result<(DVec3, Formulas)> {
    let expected = "a table such as { axis = [0, 0, 1], degrees = \"90*t\" }";
    let table = value.table(String::from("turning"), expected)?;
    table.allow_only(&["axis", "degrees"])?;
    let axis = table.required("axis", "axis = [0, 0, 1]")?.direction()?;
    let degrees = table.required("degrees", "degrees = \"90*t\"")?;
    Ok((axis, Formulas::one(&degrees)?))
}

const POSE_KEYS: &[&str] = &[
    "time",
    "at",
    "parameters",
    "look",
    "up",
    "fov",
    "rest",
    "velocity",
];

/// The key poses of an animation.
#[derive(Debug, Clone)]
pub struct PoseFile {
    /// The text, for complaints.
    pub source: Arc<SourceText>,
    /// At least two, times ascending.
    pub poses: Vec<KeyPose>,
}

/// Where the camera is to be at a time.
#[derive(Debug, Clone)]
pub struct KeyPose {
    /// Seconds.
    pub time: f64,
    /// The camera.
    pub camera: CameraEntry,
    /// Where the pose begins in the text.
    pub span: Span,
}

impl PoseFile {
    /// Reads the file at `path`; poses without `fov` have this one, degrees.
    ///
    /// # Errors
    /// A file that cannot be read, fewer than two poses, times that do not ascend, or whatever is
    /// wrong with a camera.
    pub fn load(path: &Path, usual_fov: f64) -> Result<Self> {
        Self::parse(read_text(path)?, usual_fov)
    }

    /// Reads the text of such a file.
    ///
    /// # Errors
    /// As [`PoseFile::load`], but for reading.
    pub fn parse(source: Arc<SourceText>, usual_fov: f64) -> Result<Self> {
        let poses = {
            let document = parse(&source)?;
            let root = NamedTable::root("the file of poses", &source, &document);
            root.allow_only(&["pose"])?;
            let poses = each(&root, "pose", |table| pose(&table, usual_fov))?;
            if poses.len() < 2 {
                return Err(root
                    .complain("an animation needs at least two `[[pose]]` tables".into())
                    .into());
            }
            poses
        };
        Self::ascending(source, poses)
    }

    fn ascending(source: Arc<SourceText>, poses: Vec<(KeyPose, Span)>) -> Result<Self> {
        for pair in poses.windows(2) {
            if !(pair[1].0.time > pair[0].0.time) {
                let message = "the time of a pose must be later than that of the pose before";
                let place = pair[1].1.clone();
                return Err(
                    geofan_core::diagnostic::Diagnostic::new(&source, place, message).into(),
                );
            }
        }
        let poses = poses.into_iter().map(|(pose, _)| pose).collect();
        Ok(Self { source, poses })
    }
}

/// A pose and where its time stands.
fn pose(table: &NamedTable<'_>, usual_fov: f64) -> Result<(KeyPose, Span)> {
    table.allow_only(POSE_KEYS)?;
    let time = table.required("time", "time = 0.0")?;
    let mut camera = camera_entry(table)?;
    if table.optional("fov").is_none() {
        camera.fov_degrees = usual_fov;
    }
    let pose = KeyPose {
        time: time.number()?,
        camera,
        span: table.span(),
    };
    Ok((pose, time.span()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<PoseFile> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.toml");
        std::fs::write(&path, text).unwrap();
        PoseFile::load(&path, 90.0)
    }

    fn pose(time: f64) -> String {
        format!("[[pose]]\ntime = {time}\nat = [1, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n")
    }

    #[test]
    fn poses_are_read_in_order() {
        let file = load(&(pose(0.0) + &pose(2.5))).unwrap();
        let times: Vec<f64> = file.poses.iter().map(|p| p.time).collect();
        assert_eq!(times, [0.0, 2.5]);
    }

    #[test]
    fn one_pose_or_times_that_do_not_ascend_are_refused() {
        assert!(load(&pose(0.0)).is_err());
        let message = load(&(pose(1.0) + &pose(1.0))).unwrap_err().to_string();
        assert!(message.contains("later"), "{message}");
        assert!(load("pose = 3").is_err());
    }
}
