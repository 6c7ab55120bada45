//! The `[camera]` of a scene: where it is and how it draws.
//!
//! In: a table of the scene file. Out: [`CameraEntry`] with its [`Lens`]: projection, stereo, crop.
//!
//! ```toml
//! [camera]
//! at = [3.0, 0.0, 0.0]
//! look = [-1.0, 0.0, 0.0]
//! up = [0.0, 0.0, 1.0]
//! projection = "fisheye"     # "perspective" (default), "panorama", "fisheye", "orthographic", "cube"
//! fov = 180.0                # perspective: across the picture; fisheye: across the circle
//! # width = 4.0              # orthographic: length in the metric across the picture
//! stereo = { separation = 0.065, convergence = 2.0, layout = "side-by-side" }    # or "over-under"
//! rest = "static"            # at rest in the chart; default "normal", as the observer of the standard frame
//! # velocity = [0.3, 0, 0]    # or past that observer, in its frame; light has 1
//! crop = [0.25, 0.25, 0.5, 0.5]    # x, y, width and height as parts of the picture
//! ```

use super::{
    file::{CameraEntry, position},
    named_table::{NamedTable, NamedValue},
    trajectory::CameraMotion,
};
use geofan_core::error::Result;

/// Keys that tell where a camera is.
pub(super) const PLACE_KEYS: [&str; 7] =
    ["at", "parameters", "look", "up", "fov", "rest", "velocity"];

/// Keys that tell how it draws.
pub(super) const LENS_KEYS: [&str; 4] = ["projection", "width", "stereo", "crop"];

/// Says how a camera draws what is around it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Lens {
    /// From pixels to directions.
    pub projection: CameraProjection,
    /// Two eyes, each with a picture.
    pub stereo: Option<Stereo>,
    /// The part of the picture that is drawn: x, y, width and height, parts of the whole.
    pub crop: Option<[f64; 4]>,
}

/// Maps pixels to directions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum CameraProjection {
    /// On a plane.
    #[default]
    Perspective,
    /// All directions by longitude and latitude; the picture's middle is ahead.
    Panorama,
    /// A circle, as wide as the shorter side, in which the distance from the middle is the angle from
    /// the view (equidistant).
    Fisheye,
    /// Parallel rays from the plane across the view: from the ends of geodesics that leave the camera
    /// across the view, in the direction of the view carried along them.
    Orthographic {
        /// Length in the metric across the picture.
        width: f64,
    },
    /// Six squares in rows: right, left, up, down, ahead, back.
    Cube,
}

/// Two eyes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stereo {
    /// Length in the metric from the left eye to the right.
    pub separation: f64,
    /// Length in the metric at which both pictures agree; infinite if none is given.
    pub convergence: f64,
    /// Where the eyes' pictures are.
    pub layout: StereoLayout,
}

/// Where the pictures of two eyes are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StereoLayout {
    /// The left eye's on the left.
    #[default]
    SideBySide,
    /// The left eye's above.
    OverUnder,
}

impl StereoLayout {
    /// Pictures across and down.
    pub fn grid(self) -> (usize, usize) {
        match self {
            Self::SideBySide => (2, 1),
            Self::OverUnder => (1, 2),
        }
    }

    /// Returns its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::SideBySide => "side-by-side",
            Self::OverUnder => "over-under",
        }
    }
}

impl CameraProjection {
    /// Returns its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Perspective => "perspective",
            Self::Panorama => "panorama",
            Self::Fisheye => "fisheye",
            Self::Orthographic { .. } => "orthographic",
            Self::Cube => "cube",
        }
    }
}

/// Reads the keys that all cameras share. One of [`LENS_KEYS`] is read where it is allowed.
pub(super) fn camera_entry(table: &NamedTable) -> Result<CameraEntry> {
    let (position, position_span) = position(table)?;
    let look = table
        .required("look", "look = [-1.0, 0.0, 0.0]")?
        .direction()?;
    let up_value = table.required("up", "up = [0.0, 0.0, 1.0]")?;
    let up = up_value.direction()?;
    let across = look.cross(up);
    // Below 1e-6 the picture's turn about the view is decided by the last digits of the file.
    if across.length() < 1e-6 {
        return Err(up_value
            .complain(String::from("`up` is parallel to `look`"))
            .with_label("leaves open which way is up in the picture")
            .with_hint("choose an `up` that is not along the view, such as another axis")
            .into());
    }
    let projection = projection(table)?;
    let (motion, motion_span) = CameraMotion::read(table)?;
    Ok(CameraEntry {
        motion,
        motion_span,
        name: None,
        position,
        position_span,
        look,
        up: across.cross(look).normalize(),
        fov_degrees: fov(table, projection)?,
        lens: Lens {
            projection,
            stereo: stereo(table, projection)?,
            crop: table.optional("crop").map(|v| crop(&v)).transpose()?,
        },
    })
}

fn projection(table: &NamedTable) -> Result<CameraProjection> {
    // The width is read below.
    let orthographic = CameraProjection::Orthographic { width: 0.0 };
    let choices = [
        CameraProjection::Perspective,
        CameraProjection::Panorama,
        CameraProjection::Fisheye,
        orthographic,
        CameraProjection::Cube,
    ]
    .map(|projection| (projection.name(), projection));
    let chosen = table.optional("projection").map(|v| v.choice(&choices));
    let chosen = chosen.transpose()?.unwrap_or_default();
    if chosen == orthographic {
        let width = table.required("width", "width = 4.0")?;
        return Ok(CameraProjection::Orthographic {
            width: positive(&width, "the length across the picture, in the metric")?,
        });
    }
    match table.optional("width") {
        None => Ok(chosen),
        Some(width) => Err(width
            .complain(format!("a {} camera has no `width`", chosen.name()))
            .with_label("says how much an orthographic camera sees")
            .with_hint("`fov` is the angle of view")
            .into()),
    }
}

/// The angle of view of cameras that give none, degrees.
pub const USUAL_FOV: f64 = 90.0;

fn fov(table: &NamedTable, projection: CameraProjection) -> Result<f64> {
    let value = table.optional("fov");
    match (projection, value) {
        (CameraProjection::Fisheye, None) => Ok(180.0),
        (_, None) => Ok(USUAL_FOV),
        (CameraProjection::Perspective, Some(value)) => match value.number()? {
            degrees if degrees > 0.0 && degrees < 180.0 => Ok(degrees),
            _ => Err(value
                .complain(String::from("`fov` must lie between 0 and 180 degrees"))
                .with_label("the horizontal angle of view, ends excluded")
                .with_hint("90 is usual; `projection = \"fisheye\"` sees up to 360")
                .into()),
        },
        (CameraProjection::Fisheye, Some(value)) => match value.number()? {
            degrees if degrees > 0.0 && degrees <= 360.0 => Ok(degrees),
            _ => Err(value
                .complain(String::from(
                    "`fov` of a fisheye must be above 0 and at most 360 degrees",
                ))
                .with_label("the angle across the circle")
                .with_hint("180 is a half sphere")
                .into()),
        },
        (_, Some(value)) => Err(value
            .complain(format!(
                "a camera with this projection has no `fov`: {}",
                projection.name()
            ))
            .with_label("does nothing here")
            .with_hint(match projection {
                CameraProjection::Orthographic { .. } => "how much it sees is its `width`",
                _ => "it sees all directions",
            })
            .into()),
    }
}

fn stereo(table: &NamedTable, projection: CameraProjection) -> Result<Option<Stereo>> {
    let Some(value) = table.optional("stereo") else {
        return Ok(None);
    };
    if let CameraProjection::Orthographic { .. } = projection {
        return Err(value
            .complain(String::from("an orthographic camera has no `stereo`"))
            .with_label("parallel rays from two eyes see the same")
            .into());
    }
    let expected = "a table such as { separation = 0.065, convergence = 2.0 }";
    let table = value.table(String::from("stereo"), expected)?;
    table.allow_only(&["separation", "convergence", "layout"])?;
    let separation = table.required("separation", "separation = 0.065")?;
    let layouts =
        [StereoLayout::SideBySide, StereoLayout::OverUnder].map(|layout| (layout.name(), layout));
    let layout = table.optional("layout").map(|v| v.choice(&layouts));
    let stereo = Stereo {
        separation: positive(&separation, "the length between the eyes, in the metric")?,
        convergence: match table.optional("convergence") {
            Some(value) => positive(&value, "where both eyes' pictures agree")?,
            None => f64::INFINITY,
        },
        layout: layout.transpose()?.unwrap_or_default(),
    };
    if stereo.convergence <= stereo.separation {
        return Err(value
            .complain(String::from(
                "`convergence` must be greater than `separation`",
            ))
            .with_label("eyes cannot look at a point between them")
            .into());
    }
    Ok(Some(stereo))
}

fn crop(value: &NamedValue) -> Result<[f64; 4]> {
    let parts = value.array("four numbers such as [0.25, 0.25, 0.5, 0.5]")?;
    let numbers: Vec<f64> = parts
        .iter()
        .map(NamedValue::number)
        .collect::<Result<_>>()?;
    let inside = |start: f64, size: f64| start >= 0.0 && size > 0.0 && start + size <= 1.0 + 1e-12;
    match numbers[..] {
        [x, y, width, height] if inside(x, width) && inside(y, height) => Ok([x, y, width, height]),
        _ => Err(value
            .complain(String::from(
                "`crop` must be x, y, width and height inside the picture",
            ))
            .with_label("parts of the picture, from 0 to 1, from its upper left corner")
            .with_hint("[0.25, 0.25, 0.5, 0.5] is the middle")
            .into()),
    }
}

/// Reads a number greater than 0; `meaning` says what it is for.
fn positive(value: &NamedValue, meaning: &str) -> Result<f64> {
    match value.number()? {
        number if number > 0.0 => Ok(number),
        _ => Err(value
            .complain(String::from("this must be greater than 0"))
            .with_label(meaning)
            .into()),
    }
}
