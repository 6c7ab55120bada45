//! The camera: pixels to rays.
//!
//! In: a camera and a picture size. Out: for any point of the picture the unit direction in the standard
//! frame at the camera, and for those that do not start there ([`View::ray`]) from where. Pixel (0, 0) is
//! the upper left one; its middle is the point (0.5, 0.5). The picture is upright and not mirrored: right
//! is `look × up`. All maps go on smoothly beyond the picture's edges, so that paths can be interpolated
//! across them.
//!
//! With `x`, `y` from the middle, in units of the picture's width `W` or height `H`, to the right and down:
//!
//! | optics | direction (right, down, ahead) |
//! |---|---|
//! | perspective | (2x tan(fov/2), 2y H/W tan(fov/2), 1), normalised |
//! | panorama | longitude 2πx to the right, latitude πy downwards |
//! | fisheye | at the angle fov · r from ahead, r the distance in units of the circle's diameter |
//! | orthographic | ahead, from a point away from the camera |
//!
//! A camera may move past the normal observer at its point, who has the standard frame. With the velocity
//! β there (light has 1) and γ = 1/√(1 − β²), what it sees in the direction d of its own axes that
//! observer sees in `[d − γβ + (γ−1)(d·β̂)β̂]/[γ(1 − β·d)]`, and light is bluer to it by `γ(1 + β·d)` for
//! `d` as that observer has it.

use super::{
    journey::Camera,
    scene::{CameraEntry, CameraProjection},
};
use glam::{DMat3, DQuat, DVec3};
use std::{
    f64::consts::{PI, TAU},
    ops::Range,
};

/// Maps pixels to rays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Optics {
    /// A plane; the horizontal angle of view.
    Perspective {
        /// Degrees.
        fov: f64,
    },
    /// All directions by longitude and latitude.
    Panorama,
    /// A circle; the angle of view across it.
    Fisheye {
        /// Degrees.
        fov: f64,
    },
    /// Parallel rays; the length across the picture.
    Orthographic {
        /// Length in the metric.
        width: f64,
    },
}

/// A ray of a picture, in the standard frame at the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PictureRay {
    /// Direction and length of the geodesic from the camera at whose end the ray starts.
    pub offset: DVec3,
    /// Unit vector: the ray's direction when carried along that geodesic.
    pub direction: DVec3,
}

/// An eye that is turned with the direction in which it looks, as a head would be.
#[derive(Debug, Clone, Copy, PartialEq)]
struct TurningEye {
    /// The axis about which, standard frame.
    up: DVec3,
    /// Length from the middle to the right.
    right: f64,
    /// One over the length at which both eyes' pictures agree.
    nearness: f64,
}

/// A camera with a picture.
#[derive(Debug, Clone)]
pub struct View {
    /// Chart point.
    pub u: DVec3,
    /// Pixels across and down.
    pub size: (usize, usize),
    /// The picture that this is a part of, and where its corner is there.
    whole: (usize, usize),
    corner: (usize, usize),
    /// To the right, down and ahead, in the standard frame.
    axes: DMat3,
    optics: Optics,
    /// The side of a pixel: on the plane at distance 1 in perspective, in space of parallel rays.
    pixel: f64,
    /// Shift to the right, of what is at distance 1, that an eye's picture undoes.
    lean: f64,
    turning: Option<TurningEye>,
    /// The velocity of the camera past the normal observer, standard frame; shorter than 1.
    velocity: DVec3,
}

/// Points along each side of a picture by which [`View::spread`] tells what is seen: sections of a table reach over many.
const SPREAD: usize = 17;

/// Returns the side of a pixel of a picture `width` pixels wide, where `optics` have one for all of it.
fn pixel_side(optics: Optics, width: usize) -> f64 {
    let whole = match optics {
        Optics::Perspective { fov } => 2.0 * (0.5 * fov.to_radians()).tan(),
        Optics::Orthographic { width } => width,
        Optics::Panorama | Optics::Fisheye { .. } => 0.0,
    };
    whole / width as f64
}

/// Cosine of the angle to the line of sight up to which a direction is at a right angle to it, but for rounding.
const SQUARE: f64 = 1e-12;

impl View {
    /// Makes the view of `camera` from the chart point `u`: of its own projection, which must not be a cube's,
    /// by one eye, uncropped. [`super::PicturePanels`] is the view with all that.
    pub fn new(camera: &CameraEntry, u: DVec3, size: (usize, usize)) -> Self {
        let placed = Camera::looking(u, camera.look, camera.up);
        let fov = camera.fov_degrees;
        let optics = match camera.lens.projection {
            CameraProjection::Perspective | CameraProjection::Cube => Optics::Perspective { fov },
            CameraProjection::Panorama => Optics::Panorama,
            CameraProjection::Fisheye => Optics::Fisheye { fov },
            CameraProjection::Orthographic { width } => Optics::Orthographic { width },
        };
        Self::through(&placed, optics, size)
    }

    /// Makes the view of `camera` in perspective at a horizontal angle of view of `fov_degrees`.
    pub fn of_camera(camera: &Camera, fov_degrees: f64, size: (usize, usize)) -> Self {
        Self::through(camera, Optics::Perspective { fov: fov_degrees }, size)
    }

    /// Makes the view of `camera` through `optics`.
    pub fn through(camera: &Camera, optics: Optics, size: (usize, usize)) -> Self {
        let axes = DMat3::from_quat(camera.rotation);
        Self {
            u: camera.u,
            size,
            whole: size,
            corner: (0, 0),
            axes: DMat3::from_cols(axes.x_axis, -axes.y_axis, -axes.z_axis),
            optics,
            pixel: pixel_side(optics, size.0),
            lean: 0.0,
            turning: None,
            velocity: DVec3::ZERO,
        }
    }

    /// Makes the same view by a camera that moves past the normal observer with `velocity` (standard frame,
    /// shorter than 1).
    #[must_use]
    pub fn with_velocity(&self, velocity: DVec3) -> Self {
        Self {
            velocity,
            ..self.clone()
        }
    }

    /// Returns the velocity of the camera past the normal observer, standard frame.
    pub fn velocity(&self) -> DVec3 {
        self.velocity
    }

    /// Makes the view of an eye that is `right` to the right of a middle between two: it is there already,
    /// and what the middle would see at `convergence` in any pixel it sees in that pixel too. On a plane that
    /// is what is as far ahead; else, what is as far away. Exact in flat space.
    #[must_use]
    pub fn converged(&self, right: f64, convergence: f64) -> Self {
        Self {
            lean: right / convergence,
            ..self.clone()
        }
    }

    /// Makes the view of an eye that is `right` to the right of the camera whatever its direction is, turned
    /// with it about `up` (standard frame) and nearing the camera towards both poles.
    #[must_use]
    pub fn turning(&self, up: DVec3, right: f64, convergence: f64) -> Self {
        let nearness = 1.0 / convergence;
        let turning = Some(TurningEye {
            up,
            right,
            nearness,
        });
        Self {
            turning,
            ..self.clone()
        }
    }

    /// Cuts the picture to these columns and rows.
    #[must_use]
    pub fn cropped(&self, columns: Range<usize>, rows: Range<usize>) -> Self {
        Self {
            size: (columns.len(), rows.len()),
            corner: (self.corner.0 + columns.start, self.corner.1 + rows.start),
            ..self.clone()
        }
    }

    /// Returns the number of a pixel of the view, row by row, in the whole picture, where parts of the same size that come
    /// before it, `part` of them, are counted first.
    pub fn number_in_whole(&self, column: usize, row: usize, part: usize) -> u64 {
        let (width, height) = self.whole;
        let rows = part * height + self.corner.1 + row;
        (rows * width + self.corner.0 + column) as u64
    }

    /// Widens the picture by `margin` pixels on each side where the whole picture goes on; also returns the columns and rows
    /// in it of the picture as it was.
    pub fn widened(&self, margin: usize) -> (Self, (Range<usize>, Range<usize>)) {
        let along = |corner: usize, length: usize, whole: usize| {
            let first = corner.saturating_sub(margin);
            let last = (corner + length + margin).min(whole).max(corner + length);
            (first, last - first, corner - first..corner - first + length)
        };
        let (x, width, columns) = along(self.corner.0, self.size.0, self.whole.0);
        let (y, height, rows) = along(self.corner.1, self.size.1, self.whole.1);
        let wide = Self {
            size: (width, height),
            corner: (x, y),
            ..self.clone()
        };
        (wide, (columns, rows))
    }

    /// Makes a picture of about `size` of it.
    #[must_use]
    pub fn resized(&self, size: (usize, usize)) -> Self {
        let scaled = |n: usize, to: usize, from: usize| (n * to).div_ceil(from);
        let both = |n: (usize, usize)| {
            let (w, h) = self.size;
            (scaled(n.0, size.0, w), scaled(n.1, size.1, h))
        };
        let whole = both(self.whole);
        Self {
            size,
            whole,
            pixel: pixel_side(self.optics, whole.0),
            corner: both(self.corner),
            ..self.clone()
        }
    }

    /// Returns the camera that sees this.
    pub fn camera(&self) -> Camera {
        Camera::looking(self.u, self.look(), -self.axes.y_axis)
    }

    /// Returns the map from pixels to rays.
    pub fn optics(&self) -> Optics {
        self.optics
    }

    /// Tells whether all rays start at the camera.
    pub fn is_central(&self) -> bool {
        self.turning.is_none() && !matches!(self.optics, Optics::Orthographic { .. })
    }

    /// Finds the point of the picture in `direction` (standard frame), which may be beyond the picture's edges: the
    /// inverse of [`View::direction`]. `None` behind a camera in perspective, of parallel rays, and of an eye
    /// that turns.
    pub fn pixel(&self, direction: DVec3) -> Option<(f64, f64)> {
        let seen = self.in_camera(direction);
        let (w, h) = (self.whole.0 as f64, self.whole.1 as f64);
        let own = (self.axes.transpose() * seen).normalize_or_zero();
        // On the sphere, before what an eye leans: see `ray`.
        let along = own.x * self.lean;
        let far = (along * along + 1.0 - self.lean * self.lean).sqrt() - along;
        let ahead = own * far + DVec3::X * self.lean;
        let (x, y) = match self.optics {
            _ if self.turning.is_some() => return None,
            Optics::Perspective { .. } => return self.own_pixel(seen),
            Optics::Orthographic { .. } => return None,
            Optics::Panorama => {
                let longitude = ahead.x.atan2(ahead.z);
                (
                    w * longitude / TAU,
                    h * ahead.y.clamp(-1.0, 1.0).asin() / PI,
                )
            }
            Optics::Fisheye { fov } => {
                let across = ahead.x.hypot(ahead.y);
                let radius = across.atan2(ahead.z) * w.min(h) / fov.to_radians();
                let share = if across > 0.0 { radius / across } else { 0.0 };
                (ahead.x * share, ahead.y * share)
            }
        };
        let (middle_x, middle_y) = self.middle();
        Some((x + middle_x, y + middle_y))
    }

    /// Finds the point of the picture at which a camera of parallel rays shows what lies at `p` in its axes (right, up,
    /// backwards), lengths of the metric; another camera, what lies in that direction.
    pub fn pixel_of(&self, p: DVec3) -> Option<(f64, f64)> {
        if !matches!(self.optics, Optics::Orthographic { .. }) {
            return self.pixel((self.camera().rotation * p).normalize());
        }
        let (middle_x, middle_y) = self.middle();
        let (x, y) = (p.x / self.pixel, -p.y / self.pixel);
        (self.turning.is_none() && p.z < 0.0).then_some((middle_x + x, middle_y + y))
    }

    /// Finds the point of the picture in `direction` as the camera sees it, in motion or not.
    pub(crate) fn own_pixel(&self, direction: DVec3) -> Option<(f64, f64)> {
        if !matches!(self.optics, Optics::Perspective { .. }) {
            return None;
        }
        let depth = direction.dot(self.look());
        let along = |axis: DVec3| direction.dot(axis) / (depth * axis.length_squared());
        let [right, down] = self.pixel_axes();
        let (x, y) = self.middle();
        let leaned = x + self.lean / self.pixel;
        let ahead = depth > SQUARE * direction.length();
        ahead.then(|| (along(right) + leaned, along(down) + y))
    }

    /// Returns `direction` (standard frame, any length, which is kept) as the moving camera sees it.
    pub fn in_camera(&self, direction: DVec3) -> DVec3 {
        let length = direction.length();
        if self.velocity == DVec3::ZERO || length == 0.0 {
            return direction;
        }
        aberrated(direction / length, self.velocity) * length
    }

    /// Returns how much bluer light from `direction` (standard frame, unit) is to the moving camera than to
    /// the normal observer.
    pub fn blueshift(&self, direction: DVec3) -> f64 {
        let slowed = (1.0 - self.velocity.length_squared()).sqrt();
        (1.0 + self.velocity.dot(direction)) / slowed
    }

    /// Returns the direction of the middle of the whole picture.
    pub fn look(&self) -> DVec3 {
        self.axes.z_axis
    }

    /// Makes the same view from `u`: the same components in the standard frame there.
    pub fn moved(&self, u: DVec3) -> Self {
        Self { u, ..self.clone() }
    }

    /// Makes the view turned by `angle` (radians) to the right about the picture's upward direction.
    pub fn turned(&self, angle: f64) -> Self {
        let turn = DQuat::from_axis_angle(self.axes.y_axis, angle);
        Self {
            axes: DMat3::from_quat(turn) * self.axes,
            ..self.clone()
        }
    }

    /// Returns the direction of the point (x, y) of the picture.
    pub fn direction(&self, x: f64, y: f64) -> DVec3 {
        self.ray(x, y).direction
    }

    /// Returns the directions of some points of the picture, evenly spaced from edge to edge.
    pub fn spread(&self) -> Vec<DVec3> {
        let (width, height) = (self.size.0 as f64, self.size.1 as f64);
        let share = |k: usize| k as f64 / (SPREAD - 1) as f64;
        let place = |i: usize| (share(i % SPREAD) * width, share(i / SPREAD) * height);
        let places = (0..SPREAD * SPREAD).map(place);
        places
            .map(|(x, y)| self.direction(x, y))
            .filter(|d| d.is_finite())
            .collect()
    }

    /// Returns the address by which a tracer knows the ray that is wanted: its direction, or, in a view whose
    /// rays start elsewhere, the point of the picture.
    pub fn address(&self, x: f64, y: f64) -> DVec3 {
        match self.is_central() {
            true => self.direction(x, y),
            false => DVec3::new(x, y, 0.0),
        }
    }

    /// Returns the length by which one radian of [`View::pixel_angle`] moves a parallel ray in flat space, at
    /// all distances; other rays are moved by the distance.
    pub fn reach(&self) -> Option<f64> {
        match self.optics {
            Optics::Orthographic { width } => Some(0.5 * width),
            _ => None,
        }
    }

    /// Returns the ray of the point (x, y) of the picture.
    pub fn ray(&self, x: f64, y: f64) -> PictureRay {
        let seen = self.seen(x, y);
        // On a sphere, what is leaned towards is at distance 1; on the plane, at depth 1.
        let (offset, leaned) = match self.turning {
            Some(eye) => {
                let seen = seen.normalize();
                let right = seen.cross(eye.up) * eye.right;
                (right, seen - right * eye.nearness)
            }
            None if self.lean == 0.0 => (self.parallel_offset(x, y), seen),
            None => {
                let lean = self.axes.x_axis * self.lean;
                (self.parallel_offset(x, y), seen - lean)
            }
        };
        let own = leaned.normalize();
        let direction = match self.velocity == DVec3::ZERO {
            true => own,
            false => aberrated(own, -self.velocity),
        };
        PictureRay { offset, direction }
    }

    /// Finds the vector that a camera without eyes sees at a point of the picture, standard frame: at depth 1
    /// in perspective, else at distance 1.
    fn seen(&self, x: f64, y: f64) -> DVec3 {
        let (w, h) = (self.whole.0 as f64, self.whole.1 as f64);
        let (middle_x, middle_y) = self.middle();
        let (x, y) = (x - middle_x, y - middle_y);
        let ahead = match self.optics {
            Optics::Perspective { .. } => {
                let [right, down] = self.pixel_axes();
                return self.look() + right * x + down * y;
            }
            Optics::Panorama => {
                let (sin, cos) = (TAU * x / w).sin_cos();
                let (down, level) = (PI * y / h).sin_cos();
                DVec3::new(sin * level, down, cos * level)
            }
            Optics::Fisheye { fov } => {
                let radius = x.hypot(y);
                let (sin, cos) = (radius * fov.to_radians() / w.min(h)).sin_cos();
                let across = if radius > 0.0 { sin / radius } else { 0.0 };
                DVec3::new(x * across, y * across, cos)
            }
            Optics::Orthographic { .. } => DVec3::Z,
        };
        self.axes * ahead
    }

    /// Finds where the ray of a point of the picture starts.
    fn parallel_offset(&self, x: f64, y: f64) -> DVec3 {
        if !matches!(self.optics, Optics::Orthographic { .. }) {
            return DVec3::ZERO;
        }
        let (middle_x, middle_y) = self.middle();
        let [right, down] = self.pixel_axes();
        right * (x - middle_x) + down * (y - middle_y)
    }

    /// Returns the middle of the whole picture, counted from this part's corner.
    fn middle(&self) -> (f64, f64) {
        let along = |whole: usize, corner: usize| 0.5 * whole as f64 - corner as f64;
        (
            along(self.whole.0, self.corner.0),
            along(self.whole.1, self.corner.1),
        )
    }

    /// Returns the steps by one pixel to the right and down, of the sides that all pixels have.
    fn pixel_axes(&self) -> [DVec3; 2] {
        [self.axes.x_axis, self.axes.y_axis].map(|axis| axis * self.pixel)
    }

    /// Returns the angle of one pixel where it is largest, radians; of parallel rays, as if what is half a picture
    /// away were seen in perspective, 90° wide. To a camera in motion the sky is crowded together ahead, and a
    /// pixel holds as much more of it.
    pub fn pixel_angle(&self) -> f64 {
        let speed = self.velocity.length();
        match speed == 0.0 {
            true => self.own_pixel_angle(),
            false => self.own_pixel_angle() * ((1.0 + speed) / (1.0 - speed)).sqrt(),
        }
    }

    /// Returns the angle of one pixel as the camera sees it.
    fn own_pixel_angle(&self) -> f64 {
        let (w, h) = (self.whole.0 as f64, self.whole.1 as f64);
        match self.optics {
            Optics::Perspective { .. } => self.pixel_axes()[0].length(),
            Optics::Panorama => (TAU / w).max(PI / h),
            Optics::Fisheye { fov } => fov.to_radians() / w.min(h),
            Optics::Orthographic { .. } => 2.0 / w,
        }
    }

    /// Tells whether the point (x, y) of the picture shows anything: of a fisheye, the circle does.
    pub fn shows(&self, x: f64, y: f64) -> bool {
        self.shows_some(x..x, y..y)
    }

    /// Tells whether any point in these columns and rows shows anything.
    pub fn shows_some(&self, columns: Range<f64>, rows: Range<f64>) -> bool {
        let Optics::Fisheye { .. } = self.optics else {
            return true;
        };
        let (x, y) = self.middle();
        let nearest =
            |middle: f64, along: Range<f64>| (middle - middle.clamp(along.start, along.end)).abs();
        let radius = 0.5 * self.whole.0.min(self.whole.1) as f64;
        nearest(x, columns).hypot(nearest(y, rows)) <= radius
    }
}

/// Returns the unit direction in which someone who moves with `velocity` sees what is in the direction `d`.
fn aberrated(d: DVec3, velocity: DVec3) -> DVec3 {
    let gamma = 1.0 / (1.0 - velocity.length_squared()).sqrt();
    let along = velocity.dot(d);
    // (γ − 1)/β² = γ²/(γ + 1), without a division by a small speed.
    let turned = d + velocity * (gamma + gamma * gamma / (gamma + 1.0) * along);
    (turned / (gamma * (1.0 + along))).normalize()
}

#[cfg(test)]
#[path = "view_tests.rs"]
mod tests;
