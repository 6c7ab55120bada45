//! Reading a camera path: key poses of an animation.
//!
//! In: the text of a TOML file of `[[pose]]` tables, each with `time` (seconds, ascending) and what
//! a scene's `[camera]` has: `at` or `parameters`, `look`, `up`, `fov`, `rest` or `velocity`; how the camera draws is the
//! scene's, and so is the `fov` of poses without one. Out: [`PoseFile`].
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
    camera::camera_entry,
    file::{CameraEntry, each},
    table::{NamedTable, Span, parse},
};
use geofan_core::{diagnostic::SourceText, error::Result, reading::read_text};
use std::{path::Path, sync::Arc};

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
            let root = NamedTable::root(&source, &document);
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
