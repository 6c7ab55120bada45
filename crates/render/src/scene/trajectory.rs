//! The `path` of an object in a scene file: where it is and how it is turned as time goes.
//!
//! In: three expressions of the time t with the interval `during` which they hold, or the name of a file of key
//! poses; perhaps a `turning`. Out: a [`Trajectory`], checked as far as the text allows.
//!
//! ```toml
//! path = ["0.5*cos(t)", "0.5*sin(t)", "0"]           # or path = "poses.toml"
//! during = [0, 6.283185]                             # of expressions: before and after, the object stands still
//! turning = { axis = [0, 0, 1], degrees = "90*t" }   # optional, in the axes that are carried along
//! ```

use super::{
    camera::USUAL_FOV,
    motion::Formulas,
    poses::PoseFile,
    table::{NamedTable, NamedValue, Span},
};
use geofan_core::{error::Result, reading};
use glam::DVec3;
use std::{path::Path, sync::Arc};

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
