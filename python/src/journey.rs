//! Cameras on their way through key poses.

use crate::{
    camera::PyCamera,
    errors::{About, refuse},
    manifold::PyManifold,
    work,
};
use geofan_core::diagnostic::SourceText;
use geofan_render::{Journey, scene::PoseFile};
use pyo3::prelude::*;

/// The most frames of an animation.
const MOST_FRAMES: usize = 1_000_000;

/// Returns the cameras of so many frames, evenly in time, of the text of a file of key poses; `like` says how they
/// draw.
#[pyfunction]
pub fn journey(
    py: Python<'_>,
    manifold: &PyManifold,
    text: (String, String),
    frames: usize,
    like: Option<&PyCamera>,
) -> PyResult<Vec<PyCamera>> {
    if !(2..=MOST_FRAMES).contains(&frames) {
        let message = format!("{frames} is not between 2 and {MOST_FRAMES}");
        return Err(refuse(py, "frames", message));
    }
    let (name, text) = text;
    work::watch(py, About::Scene, None, |_| {
        let poses = PoseFile::parse(SourceText::new(name, text))?;
        let journey = Journey::new(&manifold.space, &poses)?;
        let [from, to] = journey.interval();
        let camera = |number: usize| {
            let share = number as f64 / (frames - 1) as f64;
            let time = from + (to - from) * share;
            let (placed, fov) = journey.pose(time);
            PyCamera::on_the_way(&manifold.space, (placed, fov), journey.velocity(time), like)
        };
        Ok((0..frames).map(camera).collect())
    })
}
