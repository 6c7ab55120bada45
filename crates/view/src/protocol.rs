//! Messages between user interface, session and drawing.
//!
//! In and out: JSON for what the user interface says and is told, little-endian binary for pixels; the layouts are told
//! in `ui/PROTOCOL.md`. Work and answers, which only this code reads again, are in bincode. Everything that comes from a user interface is checked where it is used: numbers may be
//! anything.

use crate::frame_plan::Block;
use bincode::{
    config::legacy,
    serde::{decode_from_slice, encode_to_vec},
};
use geofan_render::Camera;
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// The ways in which a picture is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PictureKind {
    /// Paths are looked up in the table.
    Table,
    /// Paths are integrated.
    Exact,
    /// Paths are straight lines of the chart: the same scene without curvature.
    Flat,
    /// The screen error of the table, pixel by pixel.
    Error,
}

/// What the skies show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SkyChoice {
    /// What the scene says.
    #[default]
    Scene,
    /// The lettered grid, beyond every exit.
    Grid,
    /// Stars, beyond every exit.
    Stars,
}

/// An event of the user interface.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ViewerEvent {
    /// The display has this many pixels.
    Resize {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Keys are held down: each number from −1 to 1, all 0 when nothing is.
    Hold {
        /// Right, up and forwards.
        go: [f64; 3],
        /// To the right and down.
        turn: [f64; 2],
        /// Clockwise about the line of sight.
        roll: f64,
        /// Faster.
        fast: bool,
    },
    /// The head turns: shares of the picture's width to the right and down.
    Look {
        /// To the right.
        right: f64,
        /// Down.
        down: f64,
    },
    /// The speed is multiplied.
    Speed {
        /// The factor.
        factor: f64,
    },
    /// The angle of view is multiplied.
    Zoom {
        /// The factor.
        factor: f64,
    },
    /// Back to the scene's camera.
    Home,
    /// To a named camera of the scene.
    View {
        /// Its name.
        name: String,
    },
    /// To any place.
    Place(Pose),
    /// Another way of drawing; with `split` the right half is made in a second way.
    Show {
        /// The way.
        kind: PictureKind,
        /// The second way.
        split: Option<PictureKind>,
    },
    /// Brightness.
    Exposure {
        /// In stops.
        stops: f64,
    },
    /// Other skies. Engines dress what they draw ([`crate::DrawSpace::dress`]).
    Sky {
        /// Which.
        sky: SkyChoice,
    },
    /// The camera may or may not leave the table's region, beyond which paths are integrated.
    Beyond {
        /// It may.
        allowed: bool,
    },
    /// Samples of a pixel when nothing moves.
    Still {
        /// Their number.
        samples: u16,
    },
    /// Moving pictures have this share of the display's sides; 0: as large as the machine draws in time.
    Resolution {
        /// The share, up to 1.
        share: f64,
    },
    /// Samples of a pixel by path tracing, once nothing moves and the picture is refined; 0 for none.
    Paths {
        /// Their number.
        passes: u32,
    },
    /// The pointer is here, in shares of the picture's width and height; outside 0 to 1 it is on nothing.
    Hover {
        /// From the left.
        x: f64,
        /// From the top.
        y: f64,
    },
    /// A click: the path to what is seen there is drawn.
    Pick {
        /// From the left.
        x: f64,
        /// From the top.
        y: f64,
    },
    /// The camera follows the picked path to its end.
    Follow,
    /// Whatever moves by itself stops, and a picture that is being saved is given up; where there is neither, the picked
    /// path is forgotten.
    Halt,
    /// A recording of the camera's way begins or ends.
    Record {
        /// It begins.
        on: bool,
    },
    /// The camera goes along a way, written as `geofan render --camera-path` reads it.
    Replay {
        /// The text of the file; empty for the last recording.
        text: String,
    },
    /// A picture of any size, sent as pixels of its own.
    Capture {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Samples of a pixel.
        samples: u16,
        /// Linear light is sent, not what a screen shows.
        #[serde(default)]
        light: bool,
    },
    /// A parameter of the manifold; engines load the space again.
    Parameter {
        /// Its name.
        name: String,
        /// Its value.
        value: f64,
    },
    /// The user interface has shown a frame; engines send a few ahead only.
    Shown {
        /// Its number.
        frame: u32,
    },
}

/// Where a camera is and how it looks, as a scene file says it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Chart coordinates.
    pub at: [f64; 3],
    /// In the standard frame.
    pub look: [f64; 3],
    /// In the standard frame.
    pub up: [f64; 3],
    /// Degrees.
    pub fov: f64,
}

impl Pose {
    /// Says where `camera` is.
    pub fn of(camera: &Camera, fov: f64) -> Self {
        Self {
            at: camera.u.to_array(),
            look: (camera.rotation * DVec3::NEG_Z).to_array(),
            up: (camera.rotation * DVec3::Y).to_array(),
            fov,
        }
    }

    /// Returns the camera; `None` if look and up leave its axes open, or a number is not finite.
    pub fn camera(&self) -> Option<Camera> {
        let [at, look, up] = [self.at, self.look, self.up].map(DVec3::from_array);
        let [look, up] = [look.try_normalize()?, up.try_normalize()?];
        let sure = at.is_finite() && look.cross(up).length() > 1e-6;
        sure.then(|| Camera::looking(at, look, up))
    }
}

/// Work that a session asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Work {
    /// A block of a picture.
    Draw(DrawRequest),
    /// One path.
    Ray(RayQuery),
}

impl Work {
    /// Writes work as bytes, for a worker with the same code.
    pub fn encode(&self) -> Vec<u8> {
        encode_to_vec(self, legacy()).unwrap_or_default()
    }

    /// Returns the answer that it could not be done, and why.
    pub fn failed(&self, message: String) -> Answer {
        let frame = match self {
            Self::Draw(request) => Some(request.frame),
            Self::Ray(_) => None,
        };
        Answer::Failed { frame, message }
    }

    /// Reads what [`Work::encode`] wrote; `None` if it is something else.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (work, length) = decode_from_slice(bytes, legacy()).ok()?;
        (length == bytes.len()).then_some(work)
    }
}

/// A block of a picture to be drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DrawRequest {
    /// Number of the frame.
    pub frame: u32,
    /// Chart point of the camera.
    pub u: [f64; 3],
    /// Its rotation: x, y, z, w.
    pub rotation: [f64; 4],
    /// Horizontal angle of view of the whole picture, degrees.
    pub fov: f64,
    /// Columns and rows of the whole picture.
    pub size: (usize, usize),
    /// The part wanted.
    pub block: Block,
    /// Pixels around it that are drawn too and then cut off, so that filters reach over its edge.
    pub margin: usize,
    /// Samples of a pixel.
    pub samples: u16,
    /// The way.
    pub kind: PictureKind,
    /// Exact paths are integrated pixel by pixel, not interpolated.
    pub each: bool,
    /// Light is followed from surface to surface at random instead: the sample of each pixel with this number.
    pub pass: Option<u64>,
}

impl DrawRequest {
    /// Returns the camera.
    pub fn camera(&self) -> Camera {
        Camera {
            u: DVec3::from_array(self.u),
            rotation: DQuat::from_array(self.rotation).normalize(),
        }
    }
}

/// A path to be followed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RayQuery {
    /// Number of the question.
    pub number: u32,
    /// The kind of the picture that is pointed at.
    pub kind: PictureKind,
    /// Chart point of the camera.
    pub u: [f64; 3],
    /// Direction in the standard frame.
    pub direction: [f64; 3],
}

/// An answer to [`Work`].
#[derive(Debug, Clone, PartialEq)]
pub enum Answer {
    /// Linear light of a block, row by row; and, of an error picture, the errors of its pixels in mrad.
    Drawn {
        /// Number of the frame.
        frame: u32,
        /// The block.
        block: Block,
        /// Three numbers a pixel.
        rgb: Vec<f32>,
        /// Errors; empty for other pictures.
        errors: Vec<f32>,
    },
    /// The end of a path.
    Ray {
        /// Number of the question.
        number: u32,
        /// The answer.
        report: RayReport,
    },
    /// The work could not be done.
    Failed {
        /// Number of the frame, if it was a block.
        frame: Option<u32>,
        /// The reason.
        message: String,
    },
}

/// The end of a path, and the way to it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RayReport {
    /// Chart points along it.
    pub points: Vec<[f64; 3]>,
    /// Numbers of the points before which it goes on elsewhere: behind a glued face or a whole period.
    pub jumps: Vec<usize>,
    /// Arc length to what it meets.
    pub length: f64,
    /// Name of the object, or of the exit, or `length`.
    pub end: String,
    /// It meets an object.
    pub object: bool,
}

/// Pixels to be shown.
#[derive(Debug, Clone, PartialEq)]
pub struct Patch {
    /// Number of the frame.
    pub frame: u32,
    /// They belong to a captured picture and not to the display.
    pub capture: bool,
    /// Columns and rows of the whole picture.
    pub size: (usize, usize),
    /// The part that they fill.
    pub block: Block,
    /// The picture is whole with them.
    pub last: bool,
    /// Red, green, blue, opacity of each pixel; or, of linear light, red, green and blue as single-precision numbers.
    pub pixels: Vec<u8>,
    /// They are linear light.
    pub light: bool,
    /// Their colours stand for classes: they are not blended where the picture is stretched.
    pub classes: bool,
}

impl Patch {
    /// Writes the message: eight numbers (u32: flags, frame, width and height of the picture, then x, y, width
    /// and height of the block), then the pixels.
    pub fn encode(&self) -> Vec<u8> {
        let flags = [self.capture, self.last, self.light, self.classes];
        let flags = (0..).zip(flags).map(|(k, set)| u32::from(set) << k).sum();
        let block = &self.block;
        let head: [u32; 8] = [
            flags,
            self.frame,
            self.size.0 as u32,
            self.size.1 as u32,
            block.x as u32,
            block.y as u32,
            block.width as u32,
            block.height as u32,
        ];
        let mut bytes = Vec::with_capacity(size_of_val(&head) + self.pixels.len());
        bytes.extend(head.iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend_from_slice(&self.pixels);
        bytes
    }
}

/// The part of an answer that is not numbers.
#[derive(Debug, Serialize, Deserialize)]
enum AnswerHead {
    Drawn {
        frame: u32,
        block: Block,
        pixels: usize,
    },
    Ray {
        number: u32,
        report: RayReport,
    },
    Failed {
        frame: Option<u32>,
        message: String,
    },
}

impl Answer {
    /// Writes an answer as bytes: the part that is not numbers, then single-precision numbers.
    pub fn encode(&self) -> Vec<u8> {
        let (head, numbers): (AnswerHead, [&[f32]; 2]) = match self {
            Self::Drawn {
                frame,
                block,
                rgb,
                errors,
            } => {
                let head = AnswerHead::Drawn {
                    frame: *frame,
                    block: *block,
                    pixels: rgb.len(),
                };
                (head, [rgb, errors])
            }
            Self::Ray { number, report } => {
                let head = AnswerHead::Ray {
                    number: *number,
                    report: report.clone(),
                };
                (head, [&[], &[]])
            }
            Self::Failed { frame, message } => {
                let head = AnswerHead::Failed {
                    frame: *frame,
                    message: message.clone(),
                };
                (head, [&[], &[]])
            }
        };
        let head = encode_to_vec(&head, legacy()).unwrap_or_default();
        let count: usize = numbers.iter().map(|list| list.len()).sum();
        // Of its final length at once: a list that grows needs twice the memory, and in a page to push numbers one by one
        // takes some hundredths of the time that the picture does.
        let mut bytes = vec![0; head.len() + 4 * count];
        bytes[..head.len()].copy_from_slice(&head);
        let (words, _) = bytes[head.len()..].as_chunks_mut();
        let (first, second) = words.split_at_mut(numbers[0].len());
        for (words, numbers) in [first, second].into_iter().zip(numbers) {
            for (word, number) in words.iter_mut().zip(numbers) {
                *word = number.to_le_bytes();
            }
        }
        bytes
    }

    /// Reads what [`Answer::encode`] wrote; `None` if it is something else.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (head, length) = decode_from_slice(bytes, legacy()).ok()?;
        let (words, []) = bytes[length..].as_chunks::<4>() else {
            return None;
        };
        Some(match head {
            AnswerHead::Ray { number, report } => Self::Ray { number, report },
            AnswerHead::Failed { frame, message } => Self::Failed { frame, message },
            AnswerHead::Drawn {
                frame,
                block,
                pixels,
            } => {
                let (rgb, errors) = words.split_at_checked(pixels)?;
                let numbers =
                    |words: &[[u8; 4]]| words.iter().map(|w| f32::from_le_bytes(*w)).collect();
                Self::Drawn {
                    frame,
                    block,
                    rgb: numbers(rgb),
                    errors: numbers(errors),
                }
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_come_back_as_they_went() {
        let block = Block {
            x: 3,
            y: 4,
            width: 1,
            height: 2,
        };
        let drawn = Answer::Drawn {
            frame: 7,
            block,
            rgb: vec![0.5, 1e-9, 3.0, f32::MAX, 0.0, -0.0],
            errors: vec![0.25],
        };
        let report = RayReport {
            points: vec![[1.0, 2.0, 3.0]],
            jumps: vec![0],
            length: 0.1,
            end: "sky".into(),
            object: false,
        };
        let failed = Answer::Failed {
            frame: None,
            message: "no \"table\"".into(),
        };
        for answer in [drawn, Answer::Ray { number: 3, report }, failed] {
            let bytes = answer.encode();
            assert_eq!(Answer::decode(&bytes), Some(answer));
            for length in 0..bytes.len().min(40) {
                assert_eq!(Answer::decode(&bytes[..length]), None);
            }
        }
    }

    #[test]
    fn work_comes_back_as_it_went() {
        let work = Work::Ray(RayQuery {
            number: 4,
            kind: PictureKind::Flat,
            u: [1.0, f64::MAX, -0.0],
            direction: [0.6, 0.0, 0.8],
        });
        let bytes = work.encode();
        assert_eq!(Work::decode(&bytes), Some(work));
        for length in 0..bytes.len() {
            assert_eq!(Work::decode(&bytes[..length]), None);
        }
        assert_eq!(Work::decode(&[bytes, vec![0]].concat()), None);
    }

    #[test]
    fn events_are_read_from_json_and_unknown_ones_are_refused() {
        let read = |text: &str| serde_json::from_str::<ViewerEvent>(text);
        let hold = r#"{"type":"hold","go":[0,0,1],"turn":[0,0],"roll":0,"fast":false}"#;
        assert!(matches!(
            read(hold),
            Ok(ViewerEvent::Hold { fast: false, .. })
        ));
        let show = r#"{"type":"show","kind":"exact","split":null}"#;
        let wanted = ViewerEvent::Show {
            kind: PictureKind::Exact,
            split: None,
        };
        assert_eq!(read(show).unwrap(), wanted);
        assert!(read(r#"{"type":"launch"}"#).is_err());
        assert!(read(r#"{"type":"home"}"#).is_ok());
        assert!(read("[]").is_err());
    }

    #[test]
    fn a_pose_and_a_camera_say_the_same() {
        let camera = Camera::looking(
            DVec3::new(1.0, 2.0, 3.0),
            DVec3::new(0.6, 0.0, 0.8),
            DVec3::Y,
        );
        let back = Pose::of(&camera, 70.0).camera().unwrap();
        assert!(back.rotation.angle_between(camera.rotation) < 1e-7 && back.u == camera.u);
        let nowhere = Pose {
            up: [0.6, 0.0, 0.8],
            ..Pose::of(&camera, 70.0)
        };
        assert!(nowhere.camera().is_none());
    }
}
