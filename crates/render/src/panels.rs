//! The parts of a picture: one for each eye and each face of a cube.
//!
//! In: a camera, its lens, the size of the file and perhaps a part of it. Out: [`PicturePanels`], each with a
//! [`View`] of its own, and the file put together from their pictures.
//!
//! The eyes of a stereo camera stand half of their separation to its left and right, on the geodesic across
//! its view; its axes are carried along. Where a picture shows all directions (panorama, cube), the eyes are
//! beside the direction of each pixel, as if the head were turned: else depth would be wrong everywhere but
//! ahead. Towards both poles they come together.

use super::{
    journey::Camera,
    picture::{Frame, Layer, LayerValues, Metadata, Picture},
    scene::{CameraEntry, CameraProjection, Lens, Stereo, StereoLayout},
    view::{Optics, View},
};
use geofan_core::{
    error::{Error, Result},
    manifold::Manifold,
};
use glam::DVec3;
use ndarray::{Array2, s};
use std::ops::Range;

/// Columns and rows of a picture.
pub type Part = (Range<usize>, Range<usize>);

/// All parts of a picture.
#[derive(Debug, Clone)]
pub struct PicturePanels {
    /// Pixels across and down of what is drawn.
    pub size: (usize, usize),
    /// The parts; they do not overlap.
    pub parts: Vec<PicturePanel>,
    /// The whole picture, and where what is drawn lies in it.
    frame: Frame,
    camera: Camera,
    fov: f64,
    lens: Lens,
}

/// One part.
#[derive(Debug, Clone)]
pub struct PicturePanel {
    /// Sees what is shown there.
    pub view: View,
    /// Its upper left pixel in the file.
    pub at: (usize, usize),
    /// Its place among the parts of the whole picture, of which some may be cut off.
    pub number: usize,
}

/// Columns and rows in which the six faces of a cube may lie.
const CUBES: [(usize, usize); 4] = [(6, 1), (3, 2), (2, 3), (1, 6)];

/// Where the faces of a cube look and what is up there, in the camera's axes (right, up, backwards): right,
/// left, up, down, ahead, back.
const FACES: [(DVec3, DVec3); 6] = [
    (DVec3::X, DVec3::Y),
    (DVec3::NEG_X, DVec3::Y),
    (DVec3::Y, DVec3::Z),
    (DVec3::NEG_Y, DVec3::NEG_Z),
    (DVec3::NEG_Z, DVec3::Y),
    (DVec3::Z, DVec3::Y),
];

/// Chooses the size of a picture by `lens` where none is asked for.
pub fn usual_size(lens: &Lens) -> (usize, usize) {
    let (width, height) = match lens.projection {
        CameraProjection::Perspective | CameraProjection::Orthographic { .. } => (1280, 720),
        CameraProjection::Panorama => (1280, 640),
        CameraProjection::Fisheye => (720, 720),
        CameraProjection::Cube => (1536, 1024),
    };
    let (across, down) = lens.stereo.map_or((1, 1), |stereo| stereo.layout.grid());
    (width * across, height * down)
}

impl PicturePanels {
    /// Divides a picture of `size` by a camera at `u`; only `crop` is drawn, or what the lens says.
    ///
    /// # Errors
    /// A size that cannot be divided as the lens asks, a crop outside the picture, an eye outside the space.
    pub fn new(
        manifold: &Manifold,
        (entry, u): (&CameraEntry, DVec3),
        size: (usize, usize),
        crop: Option<Part>,
    ) -> Result<Self> {
        let camera = Camera::looking(u, entry.look, entry.up);
        Self::through(
            manifold,
            (camera, entry.fov_degrees),
            entry.lens,
            size,
            crop,
        )
    }

    /// Divides the picture of a camera that is placed, with an angle of view in degrees.
    ///
    /// # Errors
    /// As of [`PicturePanels::new`].
    pub fn through(
        manifold: &Manifold,
        (camera, fov): (Camera, f64),
        lens: Lens,
        size: (usize, usize),
        crop: Option<Part>,
    ) -> Result<Self> {
        let whole = CameraRig {
            manifold,
            camera,
            fov,
            lens,
        }
        .panels(size)?;
        let (columns, rows) = match crop {
            Some(part) => part,
            None => lens
                .crop
                .map_or((0..size.0, 0..size.1), |crop| pixels(crop, size)),
        };
        if columns.is_empty() || rows.is_empty() || columns.end > size.0 || rows.end > size.1 {
            let message = format!(
                "columns {} to {} and rows {} to {} are not inside a picture of {}x{}",
                columns.start, columns.end, rows.start, rows.end, size.0, size.1
            );
            return Err(Error::input("--crop", message));
        }
        let parts = whole.into_iter().enumerate().filter_map(|(number, panel)| {
            let panel = PicturePanel { number, ..panel };
            panel.within(&columns, &rows)
        });
        Ok(Self {
            size: (columns.len(), rows.len()),
            parts: parts.collect(),
            frame: Frame {
                size,
                corner: (columns.start, rows.start),
            },
            camera,
            fov,
            lens,
        })
    }

    /// Makes the same picture by a camera that moves past the normal observer with `velocity` (standard frame).
    #[must_use]
    pub fn with_velocity(mut self, velocity: DVec3) -> Self {
        for panel in &mut self.parts {
            panel.view = panel.view.with_velocity(velocity);
        }
        self
    }

    /// Returns the view of a picture that has only one part.
    ///
    /// # Errors
    /// It has several.
    pub fn single(self) -> Result<View> {
        let mut parts = self.parts;
        match (parts.pop(), parts.is_empty()) {
            (Some(panel), true) => Ok(panel.view),
            _ => Err(Error::input(
                "the camera",
                "a cube or two eyes are several pictures, and this takes one; `geofan render` draws them",
            )),
        }
    }

    /// Puts the file together from one picture for each part, in order. Layers are those of the first.
    pub fn join(&self, mut pictures: Vec<Picture>) -> Picture {
        if let [panel] = &self.parts[..]
            && panel.view.size == self.size
        {
            return pictures.swap_remove(0);
        }
        let (width, height) = self.size;
        let mut whole = Picture::filled(width, height, [0.0; 3]);
        for layer in pictures.first().iter().flat_map(|picture| &picture.layers) {
            let values = match layer.values {
                LayerValues::Float(_) => LayerValues::Float(Array2::zeros((height, width))),
                LayerValues::Index(_) => LayerValues::Index(Array2::zeros((height, width))),
            };
            let name = layer.name.clone();
            whole.layers.push(Layer { name, values });
        }
        for (panel, picture) in self.parts.iter().zip(&pictures) {
            let (x, y) = panel.at;
            whole.paste(x, y, picture);
            let place = s![y..y + picture.height(), x..x + picture.width()];
            for (to, from) in whole.layers.iter_mut().zip(&picture.layers) {
                match (&mut to.values, &from.values) {
                    (LayerValues::Float(to), LayerValues::Float(from)) => {
                        to.slice_mut(place).assign(from);
                    }
                    (LayerValues::Index(to), LayerValues::Index(from)) => {
                        to.slice_mut(place).assign(from);
                    }
                    _ => {}
                }
            }
        }
        whole
    }

    /// Takes the part numbered `part` out of the picture of the file.
    pub fn cut(&self, whole: &Picture, part: usize) -> Picture {
        let PicturePanel { view, at, .. } = &self.parts[part];
        let (columns, rows) = (at.0..at.0 + view.size.0, at.1..at.1 + view.size.1);
        Picture::new(whole.rgb.slice(s![rows, columns, ..]).to_owned())
    }

    /// Adds to the notes of a file what this is a picture of.
    #[must_use]
    pub fn described(&self, notes: Metadata) -> Metadata {
        let axes = glam::DMat3::from_quat(self.camera.rotation);
        let vector = |v: DVec3| format!("{} {} {}", v.x, v.y, v.z);
        let mut notes = notes
            .with("projection", self.lens.projection.name())
            .with("at", vector(self.camera.u))
            .with("look", vector(-axes.z_axis))
            .with("up", vector(axes.y_axis));
        match self.lens.projection {
            CameraProjection::Perspective => {
                notes = notes.with("fov", self.fov.to_string());
                if self.lens.stereo.is_none() {
                    let width = 2.0 * (0.5 * self.fov.to_radians()).tan();
                    notes.screen_width = Some(width as f32);
                }
            }
            CameraProjection::Fisheye => notes = notes.with("fov", self.fov.to_string()),
            CameraProjection::Orthographic { width } => {
                notes = notes.with("width", width.to_string())
            }
            CameraProjection::Cube => notes = notes.with("faces", "right left up down ahead back"),
            CameraProjection::Panorama => {}
        }
        if let Some(stereo) = self.lens.stereo {
            let layout = match stereo.layout {
                StereoLayout::SideBySide => "side-by-side, left eye on the left",
                StereoLayout::OverUnder => "over-under, left eye above",
            };
            notes = notes
                .with("stereo", layout)
                .with("separation", stereo.separation.to_string())
                .with("convergence", stereo.convergence.to_string());
        }
        if self.frame.size != self.size {
            notes.frame = Some(self.frame);
        }
        notes
    }

    /// Tells what the user should know of the picture's shape.
    pub fn warning(&self) -> Option<String> {
        let (across, down) = self.lens.stereo.map_or((1, 1), |s| s.layout.grid());
        let (width, height) = (self.frame.size.0 / across, self.frame.size.1 / down);
        (self.lens.projection == CameraProjection::Panorama && width != 2 * height).then(|| {
            format!(
                "a panorama of {width}x{height} is not twice as wide as high: other programs will show it stretched"
            )
        })
    }
}

/// Rounds the part `[x, y, width, height]` of a picture to columns and rows.
fn pixels([x, y, width, height]: [f64; 4], size: (usize, usize)) -> Part {
    let along = |start: f64, length: f64, whole: usize| {
        let edge = |share: f64| ((share * whole as f64).round() as usize).min(whole);
        // Something is left of the smallest part.
        let first = edge(start).min(whole - 1);
        first..edge(start + length).max(first + 1)
    };
    (along(x, width, size.0), along(y, height, size.1))
}

impl PicturePanel {
    /// Cuts it to these columns and rows, which become the file.
    fn within(self, columns: &Range<usize>, rows: &Range<usize>) -> Option<Self> {
        let part = |at: usize, length: usize, inside: &Range<usize>| {
            let first = at.max(inside.start);
            let last = (at + length).min(inside.end);
            (first < last).then(|| (first - at..last - at, first - inside.start))
        };
        let (width, height) = self.view.size;
        let (columns, x) = part(self.at.0, width, columns)?;
        let (rows, y) = part(self.at.1, height, rows)?;
        Some(Self {
            view: self.view.cropped(columns, rows),
            at: (x, y),
            number: self.number,
        })
    }
}

/// A camera with its lens in a space.
struct CameraRig<'m> {
    manifold: &'m Manifold,
    camera: Camera,
    fov: f64,
    lens: Lens,
}

impl CameraRig<'_> {
    /// Divides a whole picture.
    fn panels(&self, size: (usize, usize)) -> Result<Vec<PicturePanel>> {
        let Some(stereo) = self.lens.stereo else {
            return self.faces(&self.camera, size);
        };
        let (across, down) = stereo.layout.grid();
        let (width, height) = (size.0 / across, size.1 / down);
        if (width * across, height * down) != size || width * height == 0 {
            let message = match stereo.layout {
                StereoLayout::SideBySide => {
                    format!("two eyes side by side need an even width, not {}", size.0)
                }
                StereoLayout::OverUnder => format!(
                    "two eyes over each other need an even height, not {}",
                    size.1
                ),
            };
            return Err(Error::input("--size", message));
        }
        let mut panels = Vec::new();
        for (number, side) in [-0.5, 0.5].into_iter().enumerate() {
            let corner = ((across - 1) * number * width, (down - 1) * number * height);
            let eye = self.eye(stereo, side * stereo.separation, (width, height))?;
            panels.extend(eye.into_iter().map(|panel| PicturePanel {
                at: (panel.at.0 + corner.0, panel.at.1 + corner.1),
                ..panel
            }));
        }
        Ok(panels)
    }

    /// Divides the picture of an eye that is `right` to the right of the camera.
    fn eye(&self, stereo: Stereo, right: f64, size: (usize, usize)) -> Result<Vec<PicturePanel>> {
        let each = |panels: Vec<PicturePanel>, change: &dyn Fn(View) -> View| {
            let changed = |panel: PicturePanel| PicturePanel {
                view: change(panel.view),
                ..panel
            };
            panels.into_iter().map(changed).collect()
        };
        match self.lens.projection {
            CameraProjection::Panorama | CameraProjection::Cube => {
                let up = self.camera.rotation * DVec3::Y;
                let turn = |view: View| view.turning(up, right, stereo.convergence);
                Ok(each(self.faces(&self.camera, size)?, &turn))
            }
            _ => {
                let moved = self.camera.moved(self.manifold, DVec3::X * right);
                if moved.length < right.abs() * (1.0 - 1e-9) {
                    return Err(Error::input(
                        "stereo",
                        "an eye would be outside the space: move the camera or make `separation` smaller",
                    ));
                }
                let converge = |view: View| view.converged(right, stereo.convergence);
                Ok(each(self.faces(&moved.camera, size)?, &converge))
            }
        }
    }

    /// Divides the picture of one eye.
    fn faces(&self, camera: &Camera, size: (usize, usize)) -> Result<Vec<PicturePanel>> {
        let fov = self.fov;
        let optics = match self.lens.projection {
            CameraProjection::Cube => return cube(camera, size),
            CameraProjection::Perspective if !(fov > 0.0 && fov < 180.0) => {
                let message = format!("an angle of view of {fov} degrees is not below 180");
                return Err(Error::input("fov", message));
            }
            CameraProjection::Perspective => Optics::Perspective { fov },
            CameraProjection::Panorama => Optics::Panorama,
            CameraProjection::Fisheye => Optics::Fisheye { fov },
            CameraProjection::Orthographic { width } => Optics::Orthographic { width },
        };
        let view = View::through(camera, optics, size);
        let (at, number) = ((0, 0), 0);
        Ok(vec![PicturePanel { view, at, number }])
    }
}

/// Lays out the six faces of a cube.
fn cube(camera: &Camera, (width, height): (usize, usize)) -> Result<Vec<PicturePanel>> {
    let fits = |(columns, rows): &(usize, usize)| {
        let side = width / columns;
        side > 0 && (side * columns, side * rows) == (width, height)
    };
    let Some((columns, _)) = CUBES.into_iter().find(fits) else {
        let message = format!(
            "a cube is six squares: 6:1, 3:2, 2:3 or 1:6 for each eye, such as 1536x1024, not {width}x{height}"
        );
        return Err(Error::input("--size", message));
    };
    let side = width / columns;
    let face = |(number, (look, up)): (usize, (DVec3, DVec3))| {
        let turned = Camera::looking(camera.u, camera.rotation * look, camera.rotation * up);
        PicturePanel {
            view: View::of_camera(&turned, 90.0, (side, side)),
            at: (number % columns * side, number / columns * side),
            number,
        }
    };
    Ok(FACES.into_iter().enumerate().map(face).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::diagnostic::SourceText;

    fn panels(lens: Lens, size: (usize, usize), crop: Option<Part>) -> Result<PicturePanels> {
        let text = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n[domain]\ny = [-1, 1]\n";
        let manifold = Manifold::from_source(SourceText::new("flat", text), &[]).unwrap();
        let camera = Camera::looking(DVec3::ZERO, -DVec3::X, DVec3::Z);
        PicturePanels::through(&manifold, (camera, 90.0), lens, size, crop)
    }

    fn cube_lens() -> Lens {
        Lens {
            projection: CameraProjection::Cube,
            ..Lens::default()
        }
    }

    fn stereo_lens(separation: f64, layout: StereoLayout) -> Lens {
        let stereo = Stereo {
            separation,
            convergence: f64::INFINITY,
            layout,
        };
        Lens {
            stereo: Some(stereo),
            ..Lens::default()
        }
    }

    #[test]
    fn the_faces_of_a_cube_meet_along_their_edges() {
        for size in [(48, 8), (24, 16), (16, 24), (8, 48)] {
            let cube = panels(cube_lens(), size, None).unwrap();
            assert_eq!(cube.parts.len(), 6);
            let at = |face: usize, x: f64, y: f64| cube.parts[face].view.direction(x, y);
            // Ahead: its left edge is the right edge of left, its top the bottom of up, and so on.
            for t in [0.0, 3.0, 8.0] {
                let close = |a: DVec3, b: DVec3| assert!((a - b).length() < 1e-12, "{a} {b}");
                close(at(4, 0.0, t), at(1, 8.0, t));
                close(at(4, 8.0, t), at(0, 0.0, t));
                close(at(4, t, 0.0), at(2, t, 8.0));
                close(at(4, t, 8.0), at(3, t, 0.0));
                close(at(5, 8.0, t), at(1, 0.0, t));
                close(at(5, 0.0, t), at(0, 8.0, t));
            }
        }
        let failure = panels(cube_lens(), (100, 50), None)
            .unwrap_err()
            .to_string();
        assert!(failure.contains("six squares"), "{failure}");
    }

    #[test]
    fn eyes_stand_apart_and_have_half_of_the_picture_each() {
        let beside = panels(stereo_lens(0.5, StereoLayout::SideBySide), (20, 6), None).unwrap();
        // Right is +y.
        let [left, right] = &beside.parts[..] else {
            panic!("two eyes");
        };
        assert!((left.view.u - DVec3::Y * -0.25).length() < 1e-9);
        assert!((right.view.u - DVec3::Y * 0.25).length() < 1e-9);
        assert_eq!((left.at, right.at), ((0, 0), (10, 0)));
        assert_eq!(right.view.size, (10, 6));
        let over = panels(stereo_lens(0.5, StereoLayout::OverUnder), (20, 6), None).unwrap();
        assert_eq!(over.parts[1].at, (0, 3));
        assert_eq!(over.parts[1].view.size, (20, 3));
        let odd = panels(stereo_lens(0.5, StereoLayout::SideBySide), (21, 6), None);
        assert!(odd.unwrap_err().to_string().contains("even width"));
        let outside = panels(stereo_lens(2.5, StereoLayout::OverUnder), (20, 6), None);
        assert!(
            outside
                .unwrap_err()
                .to_string()
                .contains("outside the space")
        );
    }

    #[test]
    fn a_crop_takes_what_it_covers_of_every_part() {
        let part = panels(cube_lens(), (24, 16), Some((6..11, 5..10))).unwrap();
        assert_eq!((part.size, part.parts.len()), ((5, 5), 4));
        let sizes: Vec<_> = part.parts.iter().map(|p| (p.at, p.view.size)).collect();
        let expected = [
            ((0, 0), (2, 3)),
            ((2, 0), (3, 3)),
            ((0, 3), (2, 2)),
            ((2, 3), (3, 2)),
        ];
        assert_eq!(sizes, expected);
        let picture = |(x, y): (usize, usize), panel: &PicturePanel| {
            let (width, height) = panel.view.size;
            Picture::from_fn(width, height, |i, j| [(x + i) as f32, (y + j) as f32, 1.0])
        };
        let whole = part.join(part.parts.iter().map(|p| picture(p.at, p)).collect());
        for (x, y) in (0..5).flat_map(|x| (0..5).map(move |y| (x, y))) {
            assert_eq!(whole.pixel(x, y), [x as f32, y as f32, 1.0]);
        }
        let cut = part.cut(&whole, 3);
        assert_eq!((cut.width(), cut.pixel(0, 0)), (3, [2.0, 3.0, 1.0]));
        assert!(panels(cube_lens(), (24, 16), Some((20..25, 0..3))).is_err());
        let lens = Lens {
            crop: Some([0.25, 0.5, 0.5, 0.5]),
            ..Lens::default()
        };
        assert_eq!(panels(lens, (20, 10), None).unwrap().size, (10, 5));
    }
}
