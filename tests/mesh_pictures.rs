//! Small mesh files as people bring them, in pictures: how much of the view each covers, in which
//! colours, and what is said about it. Space is flat, and most files hold a part of the plane x = 0.

use geofan_render::{
    ExactTracer, Seen, Stage, drawing::draw, frame::Paths, no_clock, picture::Picture,
    shade::Footprints,
};
use std::path::Path;

const SIZE: (usize, usize) = (192, 144);
/// The camera is at this x and looks along −x; y is to the right and z up.
const DISTANCE: f64 = 4.0;
const SKY: [f32; 3] = [0.1, 0.1, 0.3];

/// What is seen of a mesh, and what is said.
struct Shown {
    picture: Picture,
    /// Area of the plane x = 0 that is covered.
    area: f64,
    warnings: Vec<String>,
}

/// The side of a pixel in the plane at distance 1.
fn pixel_side() -> f64 {
    2.0 * 30_f64.to_radians().tan() / SIZE.0 as f64
}

/// Draws the file `tests/data/meshes/NAME` with its origin at `at`.
fn shown_at(name: &str, at: [f64; 3]) -> Shown {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    let space = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n\
                 exit = [{ name = 'sky', when = 'x^2 + y^2 + z^2 - 100' }]\n[cameras]\nlength = 18\n";
    write("space.toml", space);
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/meshes");
    let mesh = Path::new(data).join(name);
    let scene = format!(
        "manifold = 'space.toml'\n\
         camera = {{ at = [{DISTANCE}, 0, 0], look = [-1, 0, 0], up = [0, 0, 1], fov = 60 }}\n\
         sky = {{ sky = {{ color = {SKY:?} }} }}\n[[object]]\nmesh = '{}'\nat = {at:?}\n",
        mesh.display()
    );
    write("scene.toml", &scene);
    let stage = Stage::load(&folder.path().join("scene.toml"), &[])
        .unwrap_or_else(|e| panic!("{}", e.report(false)));
    let view = stage.view(&stage.scene.camera, SIZE).unwrap();
    let tracer = ExactTracer::new(&stage.world.manifold, view.u, 18.0, 1e-8);
    let paths = Paths::Exact(&tracer);
    let drawing = draw(&stage.world, &view, paths, 1, Footprints::Points, &no_clock);
    let covered = drawing.outcomes.iter();
    let covered = covered.filter(|seen| matches!(seen, Seen::Surface(_)));
    Shown {
        area: covered.count() as f64 * (DISTANCE * pixel_side()).powi(2),
        picture: drawing.picture,
        warnings: stage.world.warnings,
    }
}

fn shown(name: &str) -> Shown {
    shown_at(name, [0.0; 3])
}

impl Shown {
    #[track_caller]
    fn covers(&self, area: f64, within: f64) {
        let found = self.area;
        assert!((found - area).abs() < within, "{found} is not {area}");
    }

    /// Whether one thing is said, with these words in it.
    #[track_caller]
    fn says(&self, words: &[&str]) {
        let [said] = self.warnings.as_slice() else {
            panic!("{:?}", self.warnings)
        };
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
    }

    /// The colour at (y, z) of the plane `depth` before the camera.
    fn at(&self, depth: f64, y: f64, z: f64) -> [f32; 3] {
        let side = depth * pixel_side();
        let column = SIZE.0 as f64 / 2.0 + y / side;
        let row = SIZE.1 as f64 / 2.0 - z / side;
        self.picture.pixel(column as usize, row as usize)
    }

    /// Checks the colour at (y, z) of a surface across the view; the lamp is at the camera.
    #[track_caller]
    fn is_lit(&self, depth: f64, [y, z]: [f64; 2], colour: [f32; 3]) {
        let cosine = depth / (depth * depth + y * y + z * z).sqrt();
        let light = 0.2 + 0.8 * cosine as f32;
        self.is(depth, [y, z], colour.map(|c| c * light));
    }

    #[track_caller]
    fn is(&self, depth: f64, [y, z]: [f64; 2], colour: [f32; 3]) {
        let found = self.at(depth, y, z);
        let same = (0..3).all(|k| (found[k] - colour[k]).abs() < 0.01);
        assert!(same, "{found:?} at ({y}, {z}) is not {colour:?}");
    }
}

const RED: [f32; 3] = [1.0, 0.0, 0.0];
const GREEN: [f32; 3] = [0.0, 1.0, 0.0];
const BLUE: [f32; 3] = [0.0, 0.0, 1.0];
const WHITE: [f32; 3] = [1.0; 3];
const GREY: [f32; 3] = [0.7; 3];

/// Rows of pixels along the sides of a square of side 2 may count or not.
const OF_A_SQUARE: f64 = 0.1;

#[test]
fn a_concave_face_covers_its_own_area_and_no_more() {
    let shown = shown("concave.obj");
    // Its arms are eight pixels wide.
    shown.covers(0.76, 0.08);
    assert!(shown.warnings.is_empty(), "{:?}", shown.warnings);
    shown.is(DISTANCE, [0.0, 0.0], SKY);
    shown.is_lit(DISTANCE, [0.9, 0.0], GREY);
}

#[test]
fn lines_are_left_out_with_a_word() {
    let shown = shown("polyline.obj");
    shown.covers(0.005, 0.005);
    shown.says(&["polyline.obj:9: 1 lines left out"]);
}

#[test]
fn a_mark_of_editors_changes_neither_vertices_nor_materials() {
    let moved = shown("bomshift.obj");
    moved.covers(4.0, OF_A_SQUARE);
    moved.is_lit(DISTANCE, [-0.9, -0.9], GREY);
    let red = shown("bom_mtllib.obj");
    red.covers(4.0, OF_A_SQUARE);
    red.is_lit(DISTANCE, [0.5, 0.5], RED);
}

#[test]
fn materials_are_found_however_their_statements_are_written() {
    for name in ["inlinecomment.obj", "tabuse.obj", "usefirst.obj"] {
        let shown = shown(name);
        assert!(shown.warnings.is_empty(), "{name}: {:?}", shown.warnings);
        shown.covers(4.0, OF_A_SQUARE);
        shown.is_lit(DISTANCE, [0.5, 0.5], RED);
    }
    let grey = shown("usenone.obj");
    assert!(grey.warnings.is_empty(), "{:?}", grey.warnings);
    grey.covers(4.0, OF_A_SQUARE);
    grey.is_lit(DISTANCE, [0.5, 0.5], GREY);
}

#[test]
fn colours_of_vertices_are_drawn() {
    let shown = shown("vcol.obj");
    assert!(shown.warnings.is_empty(), "{:?}", shown.warnings);
    shown.is_lit(DISTANCE, [-0.5, 0.5], RED);
}

#[test]
fn positions_of_surveyors_keep_their_centimetres() {
    let shown = shown_at("utm.obj", [-500_000.0, -4_000_000.2, -100.2]);
    shown.covers(0.16, 0.02);
    assert!(shown.warnings.is_empty(), "{:?}", shown.warnings);
}

#[test]
fn a_cube_without_normals_has_flat_faces() {
    let shown = shown("cube.obj");
    shown.covers((2.0 * DISTANCE / (DISTANCE - 1.0)).powi(2), 0.2);
    for [y, z] in [[0.0, 0.0], [0.9, 0.0], [0.9, 0.9], [-0.9, 0.9]] {
        shown.is_lit(DISTANCE - 1.0, [y, z], GREY);
    }
}

#[test]
fn options_of_a_map_are_no_part_of_its_name() {
    let shown = shown("opt_s.obj");
    assert!(shown.warnings.is_empty(), "{:?}", shown.warnings);
    // Twice in either direction.
    for corner in [-1.0, 0.0] {
        let at = |y: f64, z: f64| [corner + y, corner + z];
        shown.is_lit(DISTANCE, at(0.25, 0.75), RED);
        shown.is_lit(DISTANCE, at(0.75, 0.75), GREEN);
        shown.is_lit(DISTANCE, at(0.25, 0.25), BLUE);
        shown.is_lit(DISTANCE, at(0.75, 0.25), WHITE);
    }
}

#[test]
fn alpha_of_a_texture_cuts_its_surface() {
    let shown = shown("cut.obj");
    // Half, and half a texel more on either side.
    shown.covers(2.0 + 2.0 * 2.0 / 16.0, OF_A_SQUARE);
    shown.is_lit(DISTANCE, [-0.5, 0.0], GREEN);
    shown.is(DISTANCE, [0.5, 0.0], SKY);
}

#[test]
fn half_a_surface_shows_half_of_the_sky_and_none_shows_all() {
    let half = shown("half.obj");
    assert!(half.warnings.is_empty(), "{:?}", half.warnings);
    let cosine = 4.0 / (16.5_f32).sqrt();
    let light = 0.2 + 0.8 * cosine;
    for ([y, z], colour) in [([-0.5, 0.5], RED), ([0.5, -0.5], WHITE)] {
        let mixed = std::array::from_fn(|k| 0.5 * colour[k] * light + 0.5 * SKY[k]);
        half.is(DISTANCE, [y, z], mixed);
    }
    let none = shown("d0.obj");
    none.covers(0.0, 1e-9);
    none.says(&["d0.mtl: material `m`: is not there at all"]);
    none.is(DISTANCE, [0.5, -0.5], SKY);
}

#[test]
#[cfg(feature = "gltf")]
fn colours_of_vertices_are_those_of_unlit_surfaces_and_of_metal() {
    let shown = shown("coloured.gltf");
    assert!(shown.warnings.is_empty(), "{:?}", shown.warnings);
    shown.is(DISTANCE, [-0.5, 0.3], [0.8, 0.4, 0.2]);
    // Metal has nothing but its highlight, of the colour that it reflects.
    let [r, g, b] = shown.at(DISTANCE, 0.02, 0.02);
    assert!(r > 0.1, "{r}");
    assert!(
        (g / r - 0.5).abs() < 1e-4 && (b / r - 0.25).abs() < 1e-4,
        "{r} {g} {b}"
    );
}
