//! Meshes as common programs export them: each file of `tests/data/obj` isolates what one of them does,
//! and is read as the format's specification says (*Advanced Visualizer Manual*, appendix B1), or,
//! where that says nothing, as the program that writes it means it.

use geofan_render::{
    Footprint,
    scene::{Material, Mesh},
};
use glam::DVec3;
use std::path::PathBuf;

fn path(name: &str) -> PathBuf {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/obj");
    PathBuf::from(folder).join(name)
}

fn load(name: &str) -> Mesh {
    Mesh::load(&path(name)).unwrap_or_else(|e| panic!("{}", e.report(false)))
}

/// A mesh that nothing has to be said about.
fn silent(name: &str) -> Mesh {
    let mesh = load(name);
    assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
    mesh
}

/// Whether one thing alone is said about a mesh, and how that ends.
#[track_caller]
fn told(mesh: &Mesh, end: &str) {
    let said = mesh.warnings.as_slice();
    assert!(matches!(said, [one] if one.ends_with(end)), "{said:?}");
}

fn corners(mesh: &Mesh, triangle: usize) -> [DVec3; 3] {
    mesh.triangles[triangle].map(|v| mesh.positions[v as usize])
}

/// The area of the triangles whose material has this name.
fn area_of(mesh: &Mesh, material: Option<&str>) -> f64 {
    let chosen =
        (0..mesh.triangles.len()).filter(|i| material.is_none_or(|m| of(mesh, *i).name == m));
    let areas = chosen.map(|i| {
        let [a, b, c] = corners(mesh, i);
        0.5 * (b - a).cross(c - a).length()
    });
    areas.sum()
}

fn area(mesh: &Mesh) -> f64 {
    area_of(mesh, None)
}

fn of(mesh: &Mesh, triangle: usize) -> &Material {
    &mesh.materials[mesh.material_of[triangle] as usize]
}

/// The texture's colour at texture coordinates, as a material shows it.
fn texel(material: &Material, u: f32, v: f32) -> [f32; 3] {
    let map = material.map_kd.as_ref().expect("a texture");
    let colour = map.filtered([u, v], &Footprint::POINT);
    [0, 1, 2].map(|k| colour[k] * material.kd[k])
}

fn close(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-9, "{a} is not {b}");
}

#[track_caller]
fn near(a: &[f32], b: &[f32]) {
    let same = a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3);
    assert!(same, "{a:?} is not {b:?}");
}

const RED: [f32; 3] = [1.0, 0.0, 0.0];
const GREEN: [f32; 3] = [0.0, 1.0, 0.0];
const BLUE: [f32; 3] = [0.0, 0.0, 1.0];
const WHITE: [f32; 3] = [1.0; 3];

#[test]
fn a_cube_of_blender_has_its_normals_and_both_materials() {
    let mesh = silent("blender.obj");
    close(area(&mesh), 24.0);
    close(area_of(&mesh, Some("Material")), 16.0);
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = corners(&mesh, i);
        let flat = (b - a).cross(c - a).normalize();
        assert!(
            triangle
                .iter()
                .all(|v| mesh.normals[*v as usize].abs_diff_eq(flat, 1e-12))
        );
    }
    let material = of(&mesh, 0);
    near(&material.kd, &[0.8, 0.1, 0.2]);
    near(
        &[material.ns, material.ni, material.dissolve],
        &[250.0, 1.45, 1.0],
    );
    let clear = of(&mesh, 8);
    assert_eq!((clear.dissolve, clear.is_glass()), (0.25, false));
}

#[test]
fn faces_without_a_material_in_blender_are_grey_without_a_word() {
    let mesh = silent("blender-no-material.obj");
    near(&of(&mesh, 0).kd, &[0.8, 0.1, 0.2]);
    near(&of(&mesh, 1).kd, &[0.7; 3]);
}

#[test]
fn colours_of_vertices_are_as_a_screen_shows_them() {
    let mesh = silent("blender-vertex-colours.obj");
    near(&of(&mesh, 0).kd, &WHITE);
    let at = |x: f64, z: f64| {
        let place = DVec3::new(x, 0.0, z);
        let vertex = mesh.positions.iter().position(|p| *p == place).unwrap();
        mesh.colours[vertex]
    };
    near(&at(-1.0, 1.0), &[1.0, 0.0, 0.0, 1.0]);
    near(&at(-1.0, -1.0), &[0.2140, 0.2140, 0.2140, 1.0]);
    near(&at(1.0, -1.0), &[1.0; 4]);
}

#[test]
fn polypaint_of_zbrush_is_read_from_its_comments() {
    let mesh = silent("zbrush.obj");
    let known = [RED, GREEN, BLUE, WHITE];
    for (colour, known) in mesh.colours.iter().zip(known) {
        near(&colour[..3], &known);
    }
    assert_eq!(mesh.colours.len(), 4);
}

#[test]
fn colours_as_bytes_with_opacity_are_read() {
    let mesh = silent("scanner.obj");
    near(&mesh.colours[0], &[1.0, 0.0, 0.0, 1.0]);
    near(&mesh.colours[3], &[1.0, 0.0, 0.0, 0.2]);
}

#[test]
fn a_texture_of_maya_is_shown_although_its_colour_is_black_and_illum_4_is_not_glass() {
    let mesh = load("maya.obj");
    assert_eq!(mesh.warnings.len(), 1, "{:?}", mesh.warnings);
    assert!(mesh.warnings[0].contains("`lambert2SG`") && mesh.warnings[0].contains("Kd is black"));
    close(area(&mesh), 4.0);
    let material = of(&mesh, 0);
    assert!(!material.is_glass() && !material.is_clear());
    near(&texel(material, 0.25, 0.75), &RED);
    near(&texel(material, 0.75, 0.75), &GREEN);
    near(&texel(material, 0.25, 0.25), &BLUE);
    near(&texel(material, 0.75, 0.25), &WHITE);
}

#[test]
fn names_with_a_number_sign_and_paths_of_windows_are_found_in_3ds_max() {
    let mesh = load("3dsmax.obj");
    // The ambient map is the one thing that is not drawn.
    told(
        &mesh,
        "3dsmax.mtl: material `Material #25`: map_Ka not drawn",
    );
    let material = of(&mesh, 0);
    assert_eq!(
        (material.name.as_str(), material.dissolve),
        ("Material #25", 0.75)
    );
    assert_eq!(mesh.normals, [DVec3::Z; 4]);
}

#[test]
fn normals_of_meshlab_are_made_unit_and_its_coordinates_may_stand_between_faces() {
    let mesh = silent("meshlab.obj");
    assert!(mesh.normals.iter().all(|n| *n == DVec3::Z));
    assert_eq!(mesh.uvs, [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
    let material = of(&mesh, 0);
    assert_eq!((material.dissolve, material.ks), (1.0, [1.0; 3]));
    near(&texel(material, 0.25, 0.75), &RED);
}

#[test]
fn a_face_of_rhino_over_several_lines_keeps_its_notch() {
    let mesh = silent("rhino.obj");
    close(area(&mesh), 7.0);
    assert!((0..mesh.triangles.len()).all(|i| {
        let [a, b, c] = corners(&mesh, i);
        (b - a).cross(c - a).z > 0.0
    }));
    near(&of(&mesh, 0).kd, &[0.9, 0.0, 0.0]);
}

#[test]
fn free_form_surfaces_are_refused_with_what_to_do() {
    let error = Mesh::load(&path("rhino-nurbs.obj"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("rhino-nurbs.obj: holds free-form surfaces"),
        "{error}"
    );
    assert!(error.contains("export it as polygons"), "{error}");
}

#[test]
fn points_and_lines_are_left_out_with_their_number_and_first_line() {
    let mesh = load("rhino-curves.obj");
    close(area(&mesh), 0.5);
    let told: Vec<&str> = mesh
        .warnings
        .iter()
        .filter_map(|w| w.split(".obj:").nth(1))
        .collect();
    assert_eq!(told.len(), 2, "{:?}", mesh.warnings);
    assert!(
        told.iter().any(|w| w.starts_with("9: 2 lines left out")),
        "{told:?}"
    );
    assert!(
        told.iter().any(|w| w.starts_with("8: 1 points left out")),
        "{told:?}"
    );
}

#[test]
fn a_floor_of_sketchup_keeps_its_hole_on_both_sides() {
    let mesh = silent("sketchup.obj");
    close(area_of(&mesh, Some("[Wood Floor]1")), 11.0);
    close(area_of(&mesh, Some("BackColor")), 12.0);
    near(&texel(of(&mesh, 0), 0.25, 0.75), &RED);
    assert!(mesh.normals.iter().all(|n| n.z.abs() == 1.0));
}

#[test]
fn several_libraries_on_a_line_are_read_though_a_name_holds_spaces() {
    let mesh = silent("cinema4d.obj");
    near(&of(&mesh, 0).kd, &[0.25, 0.5, 0.75]);
    assert!(of(&mesh, 0).is_glass());
    near(&of(&mesh, 1).kd, &[0.9, 0.0, 0.0]);
}

#[test]
fn indices_may_count_back_and_faces_may_come_first() {
    close(area(&silent("houdini.obj")), 4.5);
    close(area(&silent("faces-first.obj")), 4.0);
}

#[test]
fn line_ends_marks_of_editors_comments_and_order_change_nothing() {
    for name in ["mac-classic.obj", "hand-written.obj", "material-first.obj"] {
        let mesh = silent(name);
        close(area(&mesh), 4.0);
        near(&of(&mesh, 0).kd, &[0.9, 0.0, 0.0]);
    }
    let mesh = silent("notepad.obj");
    close(area(&mesh), 4.0);
    assert_eq!(mesh.triangles.len(), 2);
}

#[test]
fn positions_keep_double_precision() {
    let mesh = silent("photogrammetry.obj");
    let [a, b, c] = corners(&mesh, 0);
    close(a.distance(b), 0.4);
    close(b.distance(c), 0.4);
    close(area(&mesh), 0.16);
    near(&of(&mesh, 0).kd, &WHITE);
    near(&texel(of(&mesh, 0), 0.75, 0.75), &GREEN);
}

#[test]
fn weights_divide_positions() {
    let mesh = silent("cad-weights.obj");
    assert_eq!(mesh.positions[0], DVec3::new(-1.0, -1.0, 0.0));
    assert_eq!(mesh.positions[2], DVec3::new(1.0, 1.0, 0.0));
    close(area(&mesh), 4.0);
}

#[test]
fn what_of_a_material_is_not_drawn_is_told_once() {
    let mesh = load("substance.obj");
    told(
        &mesh,
        "substance.mtl: material `Metal`: Pm, Pr, map_Pr, norm not drawn",
    );
    let emission = of(&mesh, 0).map_ke.as_ref().unwrap();
    near(&emission.filtered([0.25, 0.25], &Footprint::POINT), &BLUE);
    assert_eq!(of(&mesh, 0).ke, [1.0; 3]);
}

#[test]
fn opacities_come_from_maps_their_channels_and_transparency() {
    let mesh = silent("foliage.obj");
    let [leaf, masked, glass] = [0, 2, 4].map(|i| of(&mesh, i));
    let at = |material: &Material, u: f32| material.map_d.as_ref().unwrap().at([u, 0.5]);
    near(&[at(leaf, 0.25), at(leaf, 0.75)], &[1.0, 0.0]);
    near(&[at(masked, 0.25), at(masked, 0.75)], &[128.0 / 255.0, 1.0]);
    assert_eq!((glass.dissolve, glass.map_d.is_none()), (0.25, true));
}

#[test]
fn options_of_maps_scale_shift_clamp_and_stretch() {
    let mesh = silent("map-options.obj");
    let [tiled, once] = [0, 2].map(|i| of(&mesh, i));
    // Places are 2 u + 0.5 and 2 v.
    near(&texel(tiled, 0.125, 0.125), &WHITE);
    near(&texel(tiled, 0.125, 0.375), &GREEN);
    near(&texel(tiled, 0.375, 0.375), &RED);
    near(&texel(tiled, 0.875, 0.875), &RED);
    // Beyond a quarter the edge goes on; values are 0.25 to 0.75, times Kd.
    near(&texel(once, 0.9, 0.9), &[0.125, 0.375, 0.125]);
    near(&texel(once, 0.0625, 0.9), &[0.375, 0.125, 0.125]);
}

#[test]
fn without_normals_edges_above_the_crease_angle_are_sharp() {
    let turned = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        DVec3::new(sin, 0.0, cos)
    };
    let normals = |mesh: &Mesh, x: f64| -> Vec<DVec3> {
        let at = mesh.positions.iter().zip(&mesh.normals);
        let found = at.filter(|(p, _)| (p.x - x).abs() < 1e-6 && p.y == 0.0 && p.z > -1.0);
        found.map(|(_, n)| *n).collect()
    };
    let one_of = |found: &[DVec3], known: &[DVec3]| {
        let has = |n: &DVec3| found.iter().any(|f| f.abs_diff_eq(*n, 1e-6));
        assert!(
            found.len() == known.len() && known.iter().all(has),
            "{found:?}"
        );
    };
    let edge = 1.939_692_62;
    let mesh = silent("smoothing.obj");
    one_of(&normals(&mesh, 0.0), &[turned(0.0)]);
    one_of(&normals(&mesh, 1.0), &[turned(10.0)]);
    one_of(&normals(&mesh, edge), &[turned(20.0), turned(90.0)]);
    let flat = Mesh::load_creased(&path("smoothing.obj"), 10.0).unwrap();
    one_of(&normals(&flat, 1.0), &[turned(0.0), turned(20.0)]);
    let smooth = Mesh::load_creased(&path("smoothing.obj"), 180.0).unwrap();
    one_of(&normals(&smooth, edge), &[turned(55.0)]);
    // Groups say more than angles do.
    let groups = silent("smoothing-groups.obj");
    one_of(&normals(&groups, 1.0), &[turned(0.0), turned(20.0)]);
    one_of(&normals(&groups, edge), &[turned(55.0)]);
}

#[test]
fn one_texture_coordinate_is_enough() {
    let mesh = silent("texture-strip.obj");
    let mut found: Vec<[f32; 2]> = mesh.uvs.clone();
    found.sort_by(|a, b| a.partial_cmp(b).unwrap());
    assert_eq!(found, [[0.25, 0.0], [0.25, 0.0], [0.75, 0.0], [0.75, 0.0]]);
}
