//! The camera's way as key poses.
//!
//! In: cameras at times. Out: the text of a camera path, as `geofan render --camera-path` takes it.

use crate::protocol::Pose;
use geofan_core::manifold::{DeckTransformation, Manifold};
use geofan_render::Camera;
use glam::DVec3;
use std::fmt::Write;

/// Seconds between key poses: between them the way is a geodesic and the turn is even, which follows a hand
/// closely.
const INTERVAL: f64 = 0.25;

/// Most key poses: an hour.
const MOST: usize = 14_400;

/// A recording of the camera's way.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recording {
    poses: Vec<(f64, Pose)>,
    began: f64,
    /// The faces of a glued domain that the camera has gone through.
    word: Vec<usize>,
}

impl Recording {
    /// Begins at the time `now`.
    pub fn begin(now: f64) -> Self {
        Self {
            began: now,
            ..Self::default()
        }
    }

    /// Takes note of the camera, if it is time for that or the recording is at its `end`.
    pub fn note(
        &mut self,
        manifold: &Manifold,
        now: f64,
        (camera, fov): (&Camera, f64),
        end: bool,
    ) {
        let time = now - self.began;
        let last = self.poses.last();
        let due = last.is_none_or(|(before, _)| time >= before + INTERVAL);
        let later = last.is_none_or(|(before, _)| time > *before);
        if self.poses.len() >= MOST || !(due || end && later) {
            return;
        }
        let before = last.map(|(_, before)| DVec3::from(before.at));
        // Where the camera has gone through faces, the way goes on in the cover, so that it does not lead back across the
        // chart; so does a glued coordinate past its limit.
        let camera = self.in_cover(manifold, camera, before);
        let mut pose = Pose::of(&camera, fov);
        if let Some(before) = before {
            for k in 0..3 {
                if let Some(period) = manifold.domain.period(k) {
                    pose.at[k] += period * ((before[k] - pose.at[k]) / period).round();
                }
            }
        }
        self.poses.push((time, pose));
    }

    /// Returns the camera where the way through the cover has led it: through the faces so far, and those behind which it is
    /// nearer to the pose `before`; near an edge of the domain that may be two.
    fn in_cover(&mut self, manifold: &Manifold, camera: &Camera, before: Option<DVec3>) -> Camera {
        let gluing = manifold.gluing().filter(|gluing| gluing.follows_cover());
        let Some((gluing, before)) = gluing.zip(before) else {
            return *camera;
        };
        let Some(mut deck) = gluing.way_back(&self.word) else {
            return *camera;
        };
        let distance = |deck: &DeckTransformation| (deck.point(camera.u) - before).length();
        for _ in 0..2 {
            let mut nearest = distance(&deck);
            let mut found = None;
            for k in 0..gluing.faces().len() {
                let through = gluing.way_back(&[k]).map(|undone| undone.then(&deck));
                // A camera cannot be mirrored.
                if let Some(through) = through.filter(|through| !through.reverses())
                    && distance(&through) < nearest
                {
                    nearest = distance(&through);
                    found = Some((k, through));
                }
            }
            let Some((k, through)) = found else { break };
            self.word.push(k);
            deck = through;
        }
        camera.carried_by(manifold, &deck)
    }

    /// Returns the seconds from its first pose to its last.
    pub fn seconds(&self) -> f64 {
        self.poses.last().map_or(0.0, |(time, _)| *time)
    }

    /// Returns the text; empty if it has fewer than the two poses that a way needs.
    pub fn text(&self) -> String {
        let mut text = String::new();
        if self.poses.len() < 2 {
            return text;
        }
        for (time, pose) in &self.poses {
            let Pose { at, look, up, fov } = pose;
            // Writing to a string does not fail.
            let _ = writeln!(
                text,
                "[[pose]]\ntime = {time:?}\nat = {at:?}\nlook = {look:?}\nup = {up:?}\nfov = {fov:?}\n"
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::tests::manifold;
    use geofan_core::diagnostic::SourceText;
    use geofan_render::{Journey, scene::PoseFile};
    use glam::DVec3;

    #[test]
    fn a_recording_is_a_camera_path_that_goes_where_the_camera_went() {
        let flat =
            manifold("metric = { conformal = '1' }\n[domain]\nx = [-1, 1]\nperiodic = ['x']");
        let mut recording = Recording::begin(10.0);
        let at = |t: f64| {
            let u = flat.domain.wrap(DVec3::new(0.8 + 0.3 * t, 0.1 * t, 0.0));
            Camera::looking(u, DVec3::new(1.0, 0.2 * t, 0.0).normalize(), DVec3::Z)
        };
        for k in 0..=100 {
            let t = f64::from(k) * 0.02;
            recording.note(&flat, 10.0 + t, (&at(t), 80.0), k == 100);
        }
        let text = recording.text();
        let file = PoseFile::parse(SourceText::new("path.toml", text), 80.0).unwrap();
        let journey = Journey::new(&flat, &file).unwrap();
        assert_eq!(journey.interval(), [0.0, recording.seconds()]);
        let (middle, _) = journey.pose(1.0);
        assert!(
            (flat.domain.wrap(middle.u) - at(1.0).u).length() < 1e-3,
            "{}",
            middle.u
        );
    }

    #[test]
    fn a_recording_goes_on_through_the_faces_of_a_glued_domain() {
        // Through the ceiling half a turn about z.
        let room = manifold(
            "metric = { conformal = '1' }\n[[glue]]\nface = '1 - z'\nmap = ['-x', '-y', 'z - 2']\n[[glue]]\nface = '1 + z'\nmap = ['-x', '-y', 'z + 2']",
        );
        let at = |t: f64| {
            let u = DVec3::new(0.6, 0.3 + 0.01 * t, 0.2 + 0.5 * t);
            Camera::looking(u, DVec3::new(1.0, 0.1 * t, 0.3).normalize(), DVec3::Z)
        };
        let mut recording = Recording::begin(0.0);
        for k in 0..=400 {
            let t = f64::from(k) * 0.02;
            recording.note(&room, t, (&at(t).brought_in(&room), 80.0), k == 400);
        }
        let text = recording.text();
        let file = PoseFile::parse(SourceText::new("path.toml", text), 80.0).unwrap();
        let journey = Journey::new(&room, &file).unwrap();
        for k in 10..70 {
            let t = 0.1 * f64::from(k) + 0.013;
            let (replayed, flown) = (journey.pose_in_cover(t).0, at(t));
            assert!(
                (replayed.u - flown.u).length() < 2e-2,
                "{t}: {}",
                replayed.u
            );
            assert!(
                replayed.rotation.angle_between(flown.rotation) < 1e-2,
                "{t}"
            );
        }
    }

    #[test]
    fn one_pose_is_no_way() {
        let flat = manifold("metric = { conformal = '1' }");
        let mut recording = Recording::begin(0.0);
        let camera = Camera::looking(DVec3::ZERO, DVec3::X, DVec3::Z);
        recording.note(&flat, 0.0, (&camera, 90.0), true);
        assert_eq!(recording.text(), "");
    }
}
