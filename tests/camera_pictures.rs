//! Pictures of every projection: what is drawn by other tracers, parts of pictures, files, sizes, refusals.

mod support;

use geofan_render::{
    ExactTracer, Seen,
    drawing::draw,
    frame::{Paths, no_clock, offsets, trace},
    picture::{LayerValues, read, read_exr},
    shade::Footprints,
};
use std::path::Path;
use support::camera_scene::{LENS_SPACE, panels, stage, write_scene};

const FLAT: &str = "name = 'flat'
coordinates = ['x', 'y', 'z']
metric = { xx = '1', yy = '1.49', zz = '1.09', xy = '0.7', xz = '0.3', yz = '0.21' }
[[exit]]
name = 'sky'
when = 'x^2 + y^2 + z^2 - 25'
[cameras]
length = 20
";

/// Squares around and behind the camera.
const CLUTTER: &str = "
[[object]]\nmesh = 'square.obj'\nat = [0.5, 0.2, 0.1]\nscale = 0.4\nrotate = { axis = [1, 1, 0], degrees = 70 }
[[object]]\nmesh = 'square.obj'\nat = [-0.7, 0.4, -0.4]\nscale = 0.5
[[object]]\nmesh = 'square.obj'\nat = [-1.9, 0.3, 0.4]\nscale = 0.6\nrotate = { axis = [0, 1, 0], degrees = 90 }
";

const ALL: [(&str, (usize, usize)); 7] = [
    ("fov = 100", (60, 40)),
    ("projection = 'panorama'", (80, 40)),
    ("projection = 'fisheye'\nfov = 220", (50, 40)),
    ("projection = 'orthographic'\nwidth = 2.0", (50, 40)),
    ("projection = 'cube'", (60, 40)),
    ("stereo = { separation = 0.1, convergence = 1.0 }", (80, 30)),
    (
        "projection = 'panorama'\nstereo = { separation = 0.1 }",
        (80, 40),
    ),
];

#[test]
fn in_flat_space_the_local_view_is_the_exact_one_in_every_projection() {
    for (camera, size) in ALL {
        let stage = stage(FLAT, camera, CLUTTER);
        let mut surfaces = 0;
        for panel in panels(&stage, size).parts {
            let tracer = ExactTracer::new(&stage.world.manifold, panel.view.u, 20.0, 1e-9);
            let by = |paths| trace(&stage.world, &panel.view, paths, &offsets(1)).outcomes;
            let (exact, local) = (by(Paths::Exact(&tracer)), by(Paths::Straight(20.0)));
            let mut edges = 0;
            for (a, b) in exact.iter().zip(&local) {
                match (a, b) {
                    (Seen::Surface(a), Seen::Surface(b)) if a.triangle == b.triangle => {
                        assert!((a.s - b.s).abs() < 1e-4 * (1.0 + a.s), "{camera}");
                        surfaces += 1;
                    }
                    (Seen::Sky { direction: a, .. }, Seen::Sky { direction: b, .. }) => {
                        assert!((*a - *b).length() < 1e-5, "{camera}: {a} {b}");
                    }
                    (Seen::Nothing, Seen::Nothing) | (Seen::Length, Seen::Length) => {}
                    _ => edges += 1,
                }
            }
            // An edge may fall on either side of the middle of a pixel.
            assert!(edges <= 3, "{camera}: {edges}");
        }
        assert!(surfaces > 50, "{camera}: {surfaces}");
    }
}

/// Runs the program in `folder`: its exit code, and what was said.
fn geofan(folder: &Path, arguments: &str) -> (Option<i32>, String) {
    let output = assert_cmd::Command::cargo_bin("geofan")
        .unwrap()
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .args(arguments.split(' '))
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code(),
        text(output.stdout) + &text(output.stderr),
    )
}

fn render(folder: &Path, arguments: &str) {
    let (code, said) = geofan(folder, &format!("render scene.toml --quiet {arguments}"));
    assert_eq!(code, Some(0), "{arguments}: {said}");
}

#[test]
fn path_traced_pictures_show_what_exact_ones_do_in_every_projection() {
    for (camera, (width, height)) in ALL {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        write_scene(folder, LENS_SPACE, camera, "");
        let size = format!("--size {width}x{height} --spp 16");
        render(folder, &format!("{size} --tracer exact -o exact.exr"));
        render(folder, &format!("{size} --tracer path -o path.exr"));
        let [exact, path] = ["exact.exr", "path.exr"].map(|name| read(&folder.join(name)).unwrap());
        let mean = |x: &geofan_render::picture::Picture| x.rgb.mean().unwrap();
        let change = (&exact.rgb - &path.rgb).mapv(f32::abs).mean().unwrap();
        // Lines of the pattern are as thin as a pixel, and pixels of one are not filtered alike.
        assert!(
            change < 0.25 * mean(&exact),
            "{camera}: {change} of {}",
            mean(&exact)
        );
        assert!((mean(&path) / mean(&exact) - 1.0).abs() < 0.05, "{camera}");
        for name in ["Z", "exit"] {
            assert_eq!(
                exact.layer(name).map(LayerValues::dim),
                Some((height, width))
            );
            assert_eq!(
                path.layer(name).map(LayerValues::dim),
                Some((height, width))
            );
        }
    }
}

#[test]
fn a_crop_is_the_same_as_in_the_whole_and_lies_in_it() {
    for (camera, (width, height)) in ALL {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        write_scene(folder, LENS_SPACE, camera, CLUTTER);
        // Several samples, so that the pixel filter reaches over the edges of the crop; and traced light with its noise.
        for way in ["--spp 4", "--spp 1 --tracer path"] {
            let size = format!("--size {width}x{height} {way}");
            render(folder, &format!("{size} -o whole.exr"));
            render(folder, &format!("{size} --crop 13,7,29,21 -o part.exr"));
            render(folder, &format!("{size} --crop 13,7,29,21 -o part.png"));
            let small = read(&folder.join("part.png")).unwrap();
            assert_eq!((small.width(), small.height()), (29, 21));
            let unlike = unlike_in_crop(folder, (width, height));
            assert_eq!(unlike, 0, "{camera} {way}");
        }
    }
}

/// Counts the pixels of `part.exr`, cut from columns 13 to 41 and rows 7 to 27, that are unlike those of `whole.exr`; beyond
/// the cut it must be black.
fn unlike_in_crop(folder: &Path, (width, height): (usize, usize)) -> usize {
    let [whole, part] = ["whole.exr", "part.exr"].map(|name| read(&folder.join(name)).unwrap());
    assert_eq!((part.width(), part.height()), (width, height));
    let places = (0..width).flat_map(|x| (0..height).map(move |y| (x, y)));
    let unlike = |&(x, y): &(usize, usize)| {
        if (13..42).contains(&x) && (7..28).contains(&y) {
            return part.pixel(x, y) != whole.pixel(x, y);
        }
        assert_eq!(part.pixel(x, y), [0.0; 3]);
        false
    };
    places.filter(unlike).count()
}

#[test]
fn files_tell_how_they_were_projected() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let notes = |camera: &str, size: &str| {
        write_scene(folder, LENS_SPACE, camera, "");
        render(folder, &format!("--size {size} -o a.exr"));
        let (_, metadata) = read_exr(&folder.join("a.exr")).unwrap();
        metadata.notes
    };
    let has = |notes: &[(String, String)], key: &str, text: &str| {
        let note = notes.iter().find(|(k, _)| k == key);
        let note = note.unwrap_or_else(|| panic!("{key} in {notes:?}"));
        assert!(note.1.contains(text), "{note:?}");
    };
    let found = notes("fov = 80", "16x12");
    has(&found, "projection", "perspective");
    has(&found, "fov", "80");
    has(&found, "at", "-0.7 0.4 0.3");
    has(
        &notes("projection = 'panorama'", "16x8"),
        "projection",
        "panorama",
    );
    let found = notes("projection = 'fisheye'\nfov = 220", "12x12");
    has(&found, "projection", "fisheye");
    has(&found, "fov", "220");
    has(
        &notes("projection = 'orthographic'\nwidth = 2.5", "12x12"),
        "width",
        "2.5",
    );
    has(
        &notes("projection = 'cube'", "12x2"),
        "faces",
        "right left up down ahead back",
    );
    let stereo = "stereo = { separation = 0.1, convergence = 2.5, layout = 'over-under' }";
    let found = notes(stereo, "12x12");
    has(&found, "stereo", "over-under");
    has(&found, "separation", "0.1");
    has(&found, "convergence", "2.5");
}

#[test]
fn what_a_camera_cannot_do_is_refused_with_the_place() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (camera, size, complaint) in [
        ("projection = 'mercator'", "8x8", "mercator"),
        ("projection = 'panorama'\nfov = 90", "8x8", "no `fov`"),
        ("projection = 'fisheye'\nfov = 400", "8x8", "360"),
        ("fov = 180", "8x8", "between 0 and 180"),
        ("projection = 'orthographic'", "8x8", "`width` is missing"),
        ("width = 2.0", "8x8", "no `width`"),
        (
            "projection = 'orthographic'\nwidth = 1\nstereo = { separation = 0.1 }",
            "8x8",
            "orthographic",
        ),
        ("stereo = { separation = -0.1 }", "8x8", "greater than 0"),
        (
            "stereo = { separation = 0.1, convergence = 0.05 }",
            "8x8",
            "convergence",
        ),
        (
            "stereo = { separation = 0.1, layout = 'crossed' }",
            "8x8",
            "crossed",
        ),
        ("stereo = { separation = 0.1 }", "9x8", "even width"),
        ("stereo = { separation = 99.0 }", "8x8", "outside the space"),
        ("projection = 'cube'", "8x8", "six squares"),
        ("crop = [0.5, 0.5, 0.6, 0.1]", "8x8", "inside the picture"),
    ] {
        write_scene(folder, LENS_SPACE, camera, "");
        let (code, said) = geofan(folder, &format!("render scene.toml --size {size} -o a.png"));
        assert_eq!(code, Some(2), "{camera}: {said}");
        assert!(said.contains(complaint), "{camera}: {said}");
    }
    write_scene(folder, LENS_SPACE, "", "");
    for (crop, complaint) in [
        ("1,2,3", "x,y,width,height"),
        ("1,2,0,3", "at least one pixel"),
        ("6,6,4,1", "not inside a picture"),
    ] {
        let arguments = format!("render scene.toml --size 8x8 --crop {crop} -o a.png");
        let (code, said) = geofan(folder, &arguments);
        assert!(
            code == Some(2) && said.contains(complaint),
            "{crop}: {said}"
        );
    }
    write_scene(folder, LENS_SPACE, "projection = 'panorama'", "");
    let (code, said) = geofan(folder, "render scene.toml --size 10x10 -o a.png");
    assert!(
        code == Some(0) && said.contains("not twice as wide"),
        "{said}"
    );
}

#[test]
fn pictures_have_the_size_that_suits_their_projection() {
    for (camera, size) in [
        ("", (1280, 720)),
        ("projection = 'panorama'", (1280, 640)),
        ("projection = 'fisheye'", (720, 720)),
        ("projection = 'cube'", (1536, 1024)),
        ("stereo = { separation = 0.1 }", (2560, 720)),
        (
            "stereo = { separation = 0.1, layout = 'over-under' }",
            (1280, 1440),
        ),
    ] {
        let stage = stage(LENS_SPACE, camera, "");
        assert_eq!(geofan_render::usual_size(&stage.scene.camera.lens), size);
    }
}

#[test]
fn what_is_outside_the_circle_of_a_fisheye_is_black_with_many_samples_too() {
    let space = LENS_SPACE.replace(
        "[cameras]",
        "[[exit]]\nname = 'never'\nwhen = '-1 - x^2'\n[cameras]",
    );
    let stage = stage(&space, "projection = 'fisheye'", "");
    let view = stage.view(&stage.scene.camera, (40, 40)).unwrap();
    let tracer = ExactTracer::new(&stage.world.manifold, view.u, 30.0, 1e-8);
    let drawing = draw(
        &stage.world,
        &view,
        Paths::Exact(&tracer),
        8,
        Footprints::Filtered,
        &no_clock,
    );
    for (x, y) in (0..40).flat_map(|x| (0..40).map(move |y| (x, y))) {
        let radius = (x as f64 - 19.5).hypot(y as f64 - 19.5);
        if radius > 23.0 {
            assert_eq!(drawing.picture.pixel(x, y), [0.0; 3]);
        }
        if radius < 17.0 {
            assert!(drawing.picture.pixel(x, y)[1] > 0.0, "{x} {y}");
        }
    }
}
