//! `geofan render --camera-path`: numbered frames, or a video through ffmpeg.
//!
//! In: a journey and something that draws one view. Out: files named by a pattern such as
//! `frame-%04d.png`, those of the same animation that are already there left alone; or one video, when ffmpeg
//! can be run. Beside the files is `frame-%04d.png.keys`, a line for each frame: a hash of all that decides it, and, once it is
//! drawn, one of the file.

use crate::terminal::{CommonArgs, ProgressDisplay, TerminalObserver};
use geofan_core::{
    Error, Observer, Result,
    files::{containing_folder, write_atomically},
    manifold::Manifold,
    reading::read_text,
};
use geofan_render::{
    Journey, Part, PicturePanels,
    picture::Picture,
    scene::{CameraProjection, Lens},
};
use std::{
    fs::File,
    io::Write,
    path::{Path, PathBuf},
    process::{Child, ChildStdin, Command, Stdio},
};

/// Where the frames of an animation go.
pub enum AnimationTarget {
    /// One file each: their folder, and in their names what stands before the number, its digits, and after.
    Frames(PathBuf, String, usize, String),
    /// One video.
    Video(PathBuf),
}

/// Names of video files that ffmpeg is asked for.
const VIDEOS: [&str; 4] = ["mp4", "mkv", "webm", "mov"];

impl AnimationTarget {
    /// Reads a pattern or the name of a video.
    pub fn of(output: &Path) -> Result<Self> {
        let extension = output
            .extension()
            .map(|e| e.to_string_lossy().to_lowercase());
        if VIDEOS.iter().any(|v| extension.as_deref() == Some(v)) {
            return Ok(Self::Video(output.to_path_buf()));
        }
        let refuse = || {
            let message = "an animation needs a place for the number, such as frame-%04d.png, or a video (.mp4, .mkv, .webm, .mov)";
            Error::input(output.display().to_string(), message)
        };
        // Folders may have any name.
        let name = output.file_name().ok_or_else(refuse)?;
        let name = name.to_str().ok_or_else(refuse)?;
        let (before, rest) = name.split_once('%').ok_or_else(refuse)?;
        let (digits, after) = rest.split_once('d').ok_or_else(refuse)?;
        let digits = match digits {
            "" => 1,
            digits => digits.parse::<usize>().map_err(|_| refuse())?,
        };
        if digits > 9 || after.contains('%') {
            return Err(refuse());
        }
        let folder = output.with_file_name("");
        Ok(Self::Frames(folder, before.into(), digits, after.into()))
    }

    /// Returns the file of the frames' keys.
    fn keys(&self) -> Option<PathBuf> {
        match self {
            Self::Frames(folder, before, digits, after) => {
                Some(folder.join(format!("{before}%0{digits}d{after}.keys")))
            }
            Self::Video(_) => None,
        }
    }

    /// Returns the file of a frame.
    fn frame(&self, number: usize) -> Option<PathBuf> {
        match self {
            Self::Frames(folder, before, digits, after) => {
                Some(folder.join(format!("{before}{number:0digits$}{after}")))
            }
            Self::Video(_) => None,
        }
    }
}

/// An animation to be drawn.
pub struct Animation<'a> {
    /// The camera's journey.
    pub journey: &'a Journey,
    /// Number of frames, at least two
    pub frames: usize,
    /// Size of the pictures.
    pub size: (usize, usize),
    /// Part of them that is drawn.
    pub crop: Option<Part>,
    /// The space.
    pub manifold: &'a Manifold,
    /// Projection, eyes and crop.
    pub lens: Lens,
    /// The angle of view of a fisheye, degrees; others have their poses'.
    pub fisheye: f64,
    /// Set if objects move.
    pub moves: bool,
    /// A hash of all that decides the frames besides their cameras.
    pub key: [u8; 32],
}

impl Animation<'_> {
    /// The time of a frame.
    fn time(&self, number: usize) -> f64 {
        let [from, to] = self.journey.interval();
        let share = number as f64 / (self.frames - 1) as f64;
        from + (to - from) * share
    }

    /// Divides the picture of a frame.
    fn panels(&self, number: usize) -> Result<PicturePanels> {
        let time = self.time(number);
        let (camera, fov) = self.journey.pose(time);
        let fov = match self.lens.projection {
            CameraProjection::Fisheye => self.fisheye,
            _ => fov,
        };
        let panels = PicturePanels::through(
            self.manifold,
            (camera, fov),
            self.lens,
            self.size,
            self.crop.clone(),
        )?;
        Ok(panels.with_velocity(self.journey.velocity(time)))
    }

    /// Hashes all that decides each frame.
    fn keys(&self) -> Result<Vec<String>> {
        let key = |number: usize| {
            let mut hasher = blake3::Hasher::new();
            hasher.update(&self.key);
            hasher.update(format!("{:?}", self.panels(number)?).as_bytes());
            if self.moves {
                hasher.update(&self.time(number).to_le_bytes());
            }
            Ok(hasher.finalize().to_hex().to_string())
        };
        (0..self.frames).map(key).collect()
    }

    /// Refuses frames that are there and were not drawn for this animation, or are not as they were drawn, and writes a line
    /// for each frame beside them. Returns the lines.
    fn claim(&self, target: &AnimationTarget) -> Result<Vec<String>> {
        let Some(path) = target.keys() else {
            return Ok(Vec::new());
        };
        let before = match path.exists() {
            true => read_text(&path)?.text.clone(),
            false => String::new(),
        };
        let mut before = before.lines();
        let mut lines = self.keys()?;
        for (number, line) in lines.iter_mut().enumerate() {
            let before = before.next();
            if let Some(frame) = target.frame(number).filter(|frame| frame.exists()) {
                *line = kept_line(&frame, line, before.unwrap_or_default())?;
            }
        }
        write_lines(&path, &lines)?;
        Ok(lines)
    }

    /// Returns the frames for each second.
    fn rate(&self) -> f64 {
        let [from, to] = self.journey.interval();
        (self.frames - 1) as f64 / (to - from)
    }

    /// Writes one file for each frame; `draw` draws a view at its time into a file. Returns the number of frames
    /// drawn.
    pub fn write_frames(
        &self,
        target: &AnimationTarget,
        common: &CommonArgs,
        mut draw: impl FnMut((&PicturePanels, f64), &Path) -> Result<()>,
    ) -> Result<usize> {
        let mut lines = self.claim(target)?;
        let observer = TerminalObserver::new(common)?;
        let progress = ProgressDisplay::new(common, "frames", self.frames as u64);
        let mut drawn = 0;
        for (number, path) in (0..self.frames).filter_map(|n| Some((n, target.frame(n)?))) {
            if observer.cancelled() {
                let resume = "finished frames are kept; run the same command again".into();
                return Err(Error::Interrupted { resume });
            }
            // Files appear under their names only when they are whole.
            if !path.is_file() {
                draw((&self.panels(number)?, self.time(number)), &path)?;
                drawn += 1;
                if let Some(keys) = target.keys() {
                    lines[number] += &format!(" {}", hash_of_file(&path)?);
                    write_lines(&keys, &lines)?;
                }
            }
            progress.inc(1);
        }
        progress.finish();
        Ok(drawn)
    }

    /// Draws all frames by `draw`, each view at its time, as a video, which takes its name when it is whole. Returns the
    /// number of frames drawn.
    pub fn write_video(
        &self,
        output: &Path,
        common: &CommonArgs,
        draw: impl FnMut((&PicturePanels, f64)) -> Result<Picture>,
    ) -> Result<usize> {
        let failed = |source| environment(output, source);
        // ffmpeg tells the format by the ending of the name.
        let (Some(name), folder) = (output.file_name(), containing_folder(output)) else {
            return Err(Error::input(
                output.display().to_string(),
                "is not the name of a file",
            ));
        };
        let mut beside = tempfile::Builder::new();
        let beside = beside.prefix(".geofan-").tempdir_in(folder);
        let beside = beside.map_err(failed)?;
        let unfinished = beside.path().join(name);
        let (mut child, pipe) = self.ffmpeg(output, &unfinished)?;
        if let Err(fault) = self.send(pipe, output, common, draw) {
            // What it has written goes with its folder.
            let _ = child.kill();
            let _ = child.wait();
            return Err(fault);
        }
        if !child.wait().map_err(failed)?.success() {
            let message = "ffmpeg could not write the video";
            return Err(failed(std::io::Error::other(message)));
        }
        std::fs::rename(&unfinished, output).map_err(failed)?;
        Ok(self.frames)
    }

    /// Sends all frames to ffmpeg.
    fn send(
        &self,
        mut pipe: ChildStdin,
        output: &Path,
        common: &CommonArgs,
        mut draw: impl FnMut((&PicturePanels, f64)) -> Result<Picture>,
    ) -> Result<()> {
        let observer = TerminalObserver::new(common)?;
        let progress = ProgressDisplay::new(common, "frames", self.frames as u64);
        for number in 0..self.frames {
            if observer.cancelled() {
                let resume = "videos are not resumed; numbered frames are".into();
                return Err(Error::Interrupted { resume });
            }
            let picture = draw((&self.panels(number)?, self.time(number)))?;
            let sent = pipe.write_all(&picture.bytes());
            sent.map_err(|source| environment(output, source))?;
            progress.inc(1);
        }
        progress.finish();
        Ok(())
    }

    /// Starts ffmpeg, which writes the file `unfinished` of the video `output`.
    fn ffmpeg(&self, output: &Path, unfinished: &Path) -> Result<(Child, ChildStdin)> {
        let (width, height) = self.panels(0)?.size;
        let mut child = Command::new("ffmpeg")
            .args([
                "-loglevel",
                "error",
                "-y",
                "-f",
                "rawvideo",
                "-pix_fmt",
                "rgb24",
            ])
            .args([
                "-s",
                &format!("{width}x{height}"),
                "-r",
                &self.rate().to_string(),
            ])
            // Sides that are not even are refused by the usual codecs.
            .args([
                "-i",
                "-",
                "-vf",
                "pad=ceil(iw/2)*2:ceil(ih/2)*2",
                "-pix_fmt",
                "yuv420p",
            ])
            .arg(unfinished)
            .stdin(Stdio::piped())
            .spawn()
            .map_err(|e| {
                let message = format!(
                    "ffmpeg cannot be run ({e}); give a pattern such as frame-%04d.png instead"
                );
                environment(output, std::io::Error::other(message))
            })?;
        let pipe = child.stdin.take();
        pipe.map(|pipe| (child, pipe))
            .ok_or_else(|| environment(output, std::io::Error::other("no pipe to ffmpeg")))
    }
}

/// Returns the line of a `frame` that is there: that of `before`, if its first word is the frame's `key`, and its second, if there
/// is one, what the file holds.
fn kept_line(frame: &Path, key: &str, before: &str) -> Result<String> {
    let refuse = |message: &str| Err(Error::input(frame.display().to_string(), message));
    let (known, drawn) = before.split_once(' ').unwrap_or((before, ""));
    if known != key {
        return refuse(
            "is there already, and was not drawn for this: the scene, the camera path, the size, the tracer or an option was another; remove such frames, or give another pattern",
        );
    }
    // An interruption may come between a frame and its line.
    if !drawn.is_empty() && drawn != hash_of_file(frame)? {
        return refuse(
            "is not as it was drawn: it is damaged, or something else was put there; remove it to have it drawn again, or give another pattern",
        );
    }
    Ok(before.into())
}

/// Hashes a file.
fn hash_of_file(path: &Path) -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    add_file(&mut hasher, path)?;
    Ok(hasher.finalize().to_hex()[..32].into())
}

/// Hashes what is in a file, piece by piece.
pub fn add_file(hasher: &mut blake3::Hasher, path: &Path) -> Result<()> {
    let read = File::open(path).and_then(|file| hasher.update_reader(file).map(|_| ()));
    read.map_err(|e| Error::io(path, e))
}

/// Writes the file of the frames' keys.
fn write_lines(path: &Path, lines: &[String]) -> Result<()> {
    write_atomically(path, |out| {
        out.write_all((lines.join("\n") + "\n").as_bytes())
    })
}

/// Makes an error of the environment about `output`.
fn environment(output: &Path, source: std::io::Error) -> Error {
    Error::Environment {
        path: output.display().to_string(),
        source,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_number_frames_with_their_digits() {
        let target = AnimationTarget::of(Path::new("out/frame-%04d.png")).unwrap();
        assert_eq!(target.frame(17), Some(PathBuf::from("out/frame-0017.png")));
        assert!(matches!(
            AnimationTarget::of(Path::new("a.mp4")),
            Ok(AnimationTarget::Video(_))
        ));
        for wrong in ["frame.png", "a-%x.png", "a-%03d-%d.png", "a-%99d.png"] {
            assert!(AnimationTarget::of(Path::new(wrong)).is_err(), "{wrong}");
        }
    }
}
