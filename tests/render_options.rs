//! What `geofan render` says of options that do nothing, of pictures without anything, and of work that is
//! there already.

mod support;

use geofan_render::picture::read;
use std::fs;
use support::Place;

const FLAT: &str = "name = 'flat'
coordinates = ['x', 'y', 'z']
metric = { conformal = '1' }
[[exit]]
name = 'sky'
when = 'x^2 + y^2 + z^2 - 9'
[cameras]
parameters = { c = [-1, 1] }
at = ['c', '0', '0']
length = 8
";

const SQUARE: &str = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n";

const CAMERA: &str = "manifold = 'flat.toml'
[camera]
at = [0.5, 0, 0]
look = [-1, 0, 0.1]
up = [0, 0, 1]
";

const SKY: &str = "[sky]\nsky = { pattern = 'grid' }\n";

const WAY: &str = "[[pose]]\ntime = 0\nat = [-0.5, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n
[[pose]]\ntime = 1\nat = [0.5, 0, 0]\nlook = [1, 0.2, 0]\nup = [0, 0, 1]\n";

fn place(rest: &str) -> Place {
    let scene = format!("{CAMERA}{rest}");
    let files = [
        ("flat.toml", FLAT),
        ("square.obj", SQUARE),
        ("way.toml", WAY),
        ("scene.toml", &scene),
    ];
    Place::with(&files)
}

/// Renders with `arguments`: the exit code and all that was said.
fn render(place: &Place, arguments: &str) -> (i32, String) {
    let output = assert_cmd::Command::cargo_bin("geofan")
        .unwrap()
        .current_dir(place.path(""))
        .env("NO_COLOR", "1")
        .args("render scene.toml --size 12x8".split(' '))
        .args(arguments.split_whitespace())
        .output()
        .unwrap();
    let said = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
    (output.status.code().unwrap(), said.concat())
}

#[test]
fn options_that_would_do_nothing_are_refused_with_what_to_do() {
    let place = place(SKY);
    place.bake("flat.toml -o flat.fan --quiet").success();
    let refused = [
        ("--length 5 --bundle flat.fan", "--length", "--tracer exact"),
        (
            "--length 5 --bundle flat.fan --tracer local",
            "--length",
            "--tracer exact",
        ),
        ("--seed 3", "--seed", "--tracer path"),
        ("--seed 3 --bundle flat.fan", "--seed", "--tracer path"),
        ("--time 2 --tracer local", "--time", "--tracer path"),
        ("--resume", "--resume", "--tracer path"),
        ("--bounces 2", "--bounces", "--tracer path"),
        ("--error 0.1", "--error", "--bundle"),
        (
            "--error 0.1 --bundle flat.fan --tracer exact",
            "--error",
            "--bundle",
        ),
        (
            "--tracer path --bundle flat.fan",
            "--bundle",
            "leave it out",
        ),
        (
            "--tracer local --tolerance 1e-6",
            "--tolerance",
            "leave it out",
        ),
    ];
    for (options, name, remedy) in refused {
        let (code, said) = render(&place, &format!("{options} -o a.png"));
        assert_eq!(code, 2, "{options}: {said}");
        let complete =
            said.contains(name) && said.contains("does nothing") && said.contains(remedy);
        assert!(complete, "{options}: {said}");
        assert!(!place.path("a.png").exists(), "{options}");
    }
    let heeded = [
        "--length 5",
        "--length 5 --bundle flat.fan --tracer exact",
        "--error 0.1 --bundle flat.fan",
        "--tolerance 1e-6",
        "--tracer path --seed 3 --bounces 2",
    ];
    for options in heeded {
        let (code, said) = render(&place, &format!("{options} -o a.png"));
        assert_eq!(code, 0, "{options}: {said}");
    }
}

#[test]
fn a_picture_in_which_nothing_can_be_seen_is_told() {
    let square = "[[object]]\nmesh = 'square.obj'\nat = [0, 0, -0.5]\nscale = 0.4\n";
    for (rest, tracer, told) in [
        ("", "exact", "nothing can be seen"),
        ("", "local", "nothing can be seen"),
        ("", "path", "the picture is black"),
        (square, "path", "the picture is black"),
        (square, "exact", ""),
        (SKY, "exact", ""),
        (SKY, "path", ""),
        // The sky of paths that end by their length is never reached here.
        (
            "[sky]\nlength = { pattern = 'grid' }\n",
            "exact",
            "nothing can be seen",
        ),
    ] {
        // The square is below.
        let place = place(rest);
        let scene = fs::read_to_string(place.path("scene.toml")).unwrap();
        let down = scene.replace("look = [-1, 0, 0.1]", "look = [-0.6, 0, -0.5]");
        fs::write(place.path("scene.toml"), down).unwrap();
        let (code, said) = render(&place, &format!("--tracer {tracer} -o a.png"));
        assert_eq!(code, 0, "{said}");
        let warns = said.contains("nothing can be seen") || said.contains("the picture is black");
        assert_eq!(warns, !told.is_empty(), "{rest} {tracer}: {said}");
        assert!(said.contains(told), "{rest} {tracer}: {said}");
    }
}

#[test]
fn what_makes_colours_of_no_meaning_is_told() {
    let no_clock = FLAT.replace("metric =", "lapse = 'x + 0.1'\nmetric =");
    let no_clock = no_clock.replace("c = [-1, 1]", "c = [0.4, 1]");
    let no_direction = FLAT.replace("[cameras]", "direction = ['vx/0', '0', '0']\n[cameras]");
    let square = "redshift = true\n[[object]]\nmesh = 'square.obj'\nat = [-0.6, 0, 0]\nscale = 0.3\nrotate = { axis = [0, 1, 0], degrees = 90 }\n";
    let dark = "[[object]]\nmesh = 'square.obj'\nat = [-0.6, 0, 0]\nrotate = { axis = [0, 1, 0], degrees = 90 }\n\
        [[light]]\nkind = 'point'\nat = [0, 0, 0]\nintensity = [0, 0, 0]\n";
    for (manifold, rest, told) in [
        (&no_clock[..], square, "the lapse is not positive"),
        (&no_direction, SKY, "`direction` is zero or no number"),
        (FLAT, dark, "the picture is black"),
        (FLAT, square, ""),
        (FLAT, SKY, ""),
    ] {
        let place = place("");
        fs::write(place.path("flat.toml"), manifold).unwrap();
        let scene = match rest.strip_prefix("redshift = true\n") {
            Some(rest) => CAMERA.replace("[camera]", "redshift = true\n[camera]") + rest,
            None => CAMERA.to_string() + rest,
        };
        fs::write(place.path("scene.toml"), scene).unwrap();
        let (code, said) = render(&place, "-o a.png");
        assert_eq!(code, 0, "{said}");
        assert!(
            said.contains(told) && said.contains("WARN") != told.is_empty(),
            "{rest}: {said}"
        );
    }
}

#[test]
fn resuming_a_finished_picture_says_so_and_leaves_it_alone() {
    let place = place(SKY);
    let path = "--tracer path --spp 3 --resume -o a.png";
    // Nothing to go on with: it begins.
    let (code, said) = render(&place, path);
    assert_eq!(code, 0, "{said}");
    let drawn = place.bytes("a.png");
    assert!(!place.path("a.png.passes").exists());
    let (code, said) = render(&place, &path.replace("--spp 3", "--spp 9"));
    assert!(code == 0 && said.contains("taken to be finished"), "{said}");
    assert_eq!(place.bytes("a.png"), drawn);
    let (code, said) = render(&place, &format!("--json {path}"));
    assert!(code == 0 && said.contains("\"finished\":true"), "{said}");
    // Another sky or lamp makes another picture of samples that are there.
    let (code, said) = render(&place, "--tracer path --spp 9 --time 1e-9 -o b.png");
    assert_eq!(code, 0, "{said}");
    let scene = format!("{CAMERA}{}", SKY.replace("grid", "stars"));
    fs::write(place.path("scene.toml"), scene).unwrap();
    let (code, said) = render(&place, "--tracer path --spp 9 --resume -o b.png");
    assert!(code == 2 && said.contains("another picture"), "{said}");
}

/// Writes a sky of one colour.
fn paint(place: &Place, colour: [u8; 3]) {
    let sky = image::RgbImage::from_pixel(8, 4, image::Rgb(colour));
    sky.save(place.path("sky.png")).unwrap();
}

#[test]
fn frames_are_kept_only_if_they_are_of_the_same_animation() {
    let place = place("[sky]\nsky = { image = 'sky.png' }\n");
    paint(&place, [200, 40, 40]);
    place.bake("flat.toml -o flat.fan --quiet").success();
    let draw = |options: &str| {
        let arguments = format!("--json --camera-path way.toml --frames 3 {options} -o f-%02d.png");
        render(&place, &arguments)
    };
    let kept = |options: &str, kept: usize| {
        let (code, said) = draw(options);
        assert_eq!(code, 0, "{options}: {said}");
        let count = format!("\"kept\":{kept}");
        assert!(said.contains(&count), "{options}: {said}");
    };
    kept("", 0);
    kept("", 3);
    fs::remove_file(place.path("f-01.png")).unwrap();
    kept("", 2);
    let red = read(&place.path("f-01.png")).unwrap().pixel(3, 3);
    // A comment changes nothing.
    let scene = fs::read_to_string(place.path("scene.toml")).unwrap();
    fs::write(place.path("scene.toml"), format!("# the same\n{scene}")).unwrap();
    kept("", 3);
    let refused = |options: &str| {
        let (code, said) = draw(options);
        let told = said.contains("f-00.png") && said.contains("was not drawn for this");
        assert!(code == 2 && told, "{options}: {said}");
    };
    for options in [
        "--spp 2",
        "--length 7",
        "--tolerance 1e-6",
        "--tracer local",
        "--bundle flat.fan",
        "--crop 0,0,4,4",
    ] {
        refused(options);
    }
    // Another sky under the same name, another mesh, another way, another space.
    paint(&place, [40, 40, 200]);
    refused("");
    paint(&place, [200, 40, 40]);
    kept("", 3);
    let changes = [
        ("way.toml", "[1, 0.2, 0]", "[1, 0.3, 0]"),
        ("flat.toml", "conformal = '1'", "conformal = '1.01'"),
        (
            "scene.toml",
            "[sky]",
            "[[object]]\nmesh = 'square.obj'\nat = [0, 0, -0.5]\nscale = 0.1\n[sky]",
        ),
        ("scene.toml", "# the same", "light_points = 5000"),
        ("scene.toml", "# the same", "delay = true"),
    ];
    for (name, from, to) in changes {
        let text = fs::read_to_string(place.path(name)).unwrap();
        assert!(text.contains(from));
        fs::write(place.path(name), text.replace(from, to)).unwrap();
        let (code, said) = draw("");
        assert!(
            code == 2 && said.contains("was not drawn for this"),
            "{name}: {said}"
        );
        fs::write(place.path(name), text).unwrap();
    }
    kept("", 3);
    // What is no longer the frame that was drawn is not kept in silence: half a file, nothing, another picture.
    let whole = fs::read(place.path("f-01.png")).unwrap();
    let other = fs::read(place.path("sky.png")).unwrap();
    for changed in [&whole[..whole.len() / 2], &[], &other[..]] {
        fs::write(place.path("f-01.png"), changed).unwrap();
        let (code, said) = draw("");
        let told = said.contains("f-01.png") && said.contains("not as it was drawn");
        assert!(code == 2 && told, "{said}");
    }
    fs::remove_file(place.path("f-01.png")).unwrap();
    kept("", 2);
    assert!(fs::read(place.path("f-01.png")).unwrap() == whole);
    kept("", 3);
    // Frames of an unknown origin are nobody's.
    fs::remove_file(place.path("f-%02d.png.keys")).unwrap();
    refused("");
    for number in 0..3 {
        fs::remove_file(place.path(&format!("f-0{number}.png"))).unwrap();
    }
    paint(&place, [40, 40, 200]);
    kept("", 0);
    let blue = read(&place.path("f-01.png")).unwrap().pixel(3, 3);
    assert!(
        red[0] > 0.5 && red[2] < 0.1 && blue[2] > 0.5 && blue[0] < 0.1,
        "{red:?} {blue:?}"
    );
}

#[cfg(unix)]
#[test]
fn a_video_takes_its_name_only_when_it_is_whole() {
    use std::os::unix::fs::PermissionsExt;
    let place = place(SKY);
    // A program that writes what it reads, and may fail then.
    let film = |status: u8| {
        let program = place.path("bin/ffmpeg");
        fs::create_dir_all(place.path("bin")).unwrap();
        let text = format!("#!/bin/sh\nfor last; do :; done\ncat > \"$last\"\nexit {status}\n");
        fs::write(&program, text).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        let found = std::env::var("PATH").unwrap_or_default();
        let arguments = "render scene.toml --size 12x8 --tracer exact --camera-path way.toml --frames 3 -o way.mp4";
        let output = assert_cmd::Command::cargo_bin("geofan")
            .unwrap()
            .current_dir(place.path(""))
            .env("PATH", format!("{}:{found}", place.path("bin").display()))
            .args(arguments.split(' '))
            .output()
            .unwrap();
        let files = fs::read_dir(place.path("")).unwrap();
        let names = files.map(|file| file.unwrap().file_name());
        assert!(
            names
                .into_iter()
                .all(|name| !name.to_string_lossy().starts_with(".geofan-"))
        );
        output.status.code()
    };
    assert_eq!(film(1), Some(3));
    assert!(!place.path("way.mp4").exists());
    assert_eq!(film(0), Some(0));
    assert_eq!(place.bytes("way.mp4").len(), 3 * 12 * 8 * 3);
}

#[test]
fn samples_that_are_not_gone_on_from_are_discarded_with_a_word() {
    let place = place(SKY);
    let (_, said) = render(&place, "--tracer path --spp 4000 --time 0.01 -o p.png");
    assert!(place.path("p.png.passes").exists(), "{said}");
    let (code, said) = render(&place, "--tracer path --spp 2 -o p.png");
    assert_eq!(code, 0, "{said}");
    assert!(
        said.contains("the samples in p.png.passes are discarded"),
        "{said}"
    );
    assert!(!place.path("p.png.passes").exists());
}

#[test]
fn a_comparison_does_not_replace_the_pictures_that_it_reads() {
    let place = place("[sky]\nsky = { image = 'exact.png' }\n");
    let sky = "exact.png";
    image::RgbImage::new(8, 4).save(place.path(sky)).unwrap();
    let before = place.bytes(sky);
    let compare = assert_cmd::Command::cargo_bin("geofan")
        .unwrap()
        .current_dir(place.path(""))
        .args("compare scene.toml --tracer local --size 12x8 --out .".split(' '))
        .assert()
        .code(2);
    let said = String::from_utf8(compare.get_output().stderr.clone()).unwrap();
    assert!(said.contains("exact.png: is read for this"), "{said}");
    assert_eq!(place.bytes(sky), before);
}

#[test]
fn a_folder_is_no_video() {
    let place = place(SKY);
    fs::create_dir(place.path("way.mp4")).unwrap();
    let (code, said) = render(&place, "--camera-path way.toml --frames 3 -o way.mp4");
    assert_eq!(code, 2, "{said}");
    assert!(
        said.contains("way.mp4: is a folder, a file is needed"),
        "{said}"
    );
}
