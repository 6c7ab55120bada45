use super::*;
use geofan_core::error::Error;

const GOOD: &str = r#"
manifold = "../manifolds/ellis-wormhole.toml"

[camera]
at = [3.0, 0, 0.0]
look = [-2.0, 0.0, 0.0]
up = [1.0, 0.0, 1.0]
fov = 80

[[view]]
name = "throat"
parameters = { c = 0.25, a = 1 }
look = [0, 1, 0]
up = [0, 0, 1]

[[object]]
mesh = "../meshes/teapot.obj"
at = [1.0, 0.5, 0.0]
scale = 0.2
rotate = { axis = [0,0,2], degrees = 90 }
placement = "exponential"
crease = 45

[[object]]
mesh = "/meshes/cube.obj"
at = [0, 0, 0]

[[light]]
kind = "point"
at = [0.0, 2.0, 0.0]
intensity = [10, 10, 10]

[sky]
near = { image = "../skies/near.png" }
far = { pattern = "grid" }
up = { pattern = { color = [0, 0.5, 1] } }
down = { color = [0, 0.5, 1] }
"#;

fn parse(text: &str) -> Result<SceneFile> {
    SceneFile::parse(SourceText::new("s.toml", text), Path::new("scenes"))
}

#[test]
fn the_whole_format_is_read() {
    let scene = parse(GOOD).unwrap();
    assert_eq!(
        scene.manifold,
        Path::new("scenes/../manifolds/ellis-wormhole.toml")
    );
    assert_eq!(
        &scene.source.text[scene.manifold_span.clone()],
        "\"../manifolds/ellis-wormhole.toml\""
    );
    assert_eq!(
        scene.camera.position,
        CameraPosition::Chart(DVec3::new(3.0, 0.0, 0.0))
    );
    assert_eq!(
        (scene.camera.look, scene.camera.up),
        (DVec3::NEG_X, DVec3::Z)
    );
    assert_eq!(scene.camera.fov_degrees, 80.0);
    let view = scene.view("throat").unwrap();
    let parameters = vec![("c".to_owned(), 0.25), ("a".to_owned(), 1.0)];
    assert_eq!(view.position, CameraPosition::Parameters(parameters));
    assert_eq!(view.fov_degrees, 90.0);
    let [teapot, cube] = scene.objects.as_slice() else {
        panic!()
    };
    assert!((teapot.rotation * DVec3::X).abs_diff_eq(DVec3::Y, 1e-15));
    assert_eq!(
        (teapot.scale, teapot.placement),
        (0.2, Placement::Exponential)
    );
    assert_eq!(
        (cube.scale, cube.placement, cube.rotation),
        (1.0, Placement::Linear, DQuat::IDENTITY)
    );
    assert_eq!((teapot.crease, cube.crease), (45.0, 30.0));
    assert_eq!(cube.mesh, Path::new("/meshes/cube.obj"));
    assert_eq!(scene.lights[0].intensity, [10.0; 3]);
    let blue = SkyEntry::Pattern(Pattern::Colour([0.0, 0.5, 1.0]));
    let skies: Vec<_> = scene
        .skies
        .iter()
        .map(|(name, _, sky)| (name.as_str(), sky))
        .collect();
    assert_eq!(
        skies[0],
        ("near", &SkyEntry::Image("scenes/../skies/near.png".into()))
    );
    assert_eq!(skies[1], ("far", &SkyEntry::Pattern(Pattern::Grid)));
    assert_eq!(skies[2..], [("up", &blue), ("down", &blue)]);
}

/// Replaces `from` by `to` in the good file, and expects a complaint with `message` that
/// underlines `underlined`.
fn refused(from: &str, to: &str, message: &str, underlined: &str) {
    assert_eq!(GOOD.matches(from).count(), 1, "{from:?} must be unique");
    let Err(Error::Source(diagnostic)) = parse(&GOOD.replace(from, to)) else {
        panic!("{to:?} was not refused with a place");
    };
    let report = diagnostic.report(false);
    assert!(report.contains(message), "{to:?} gave\n{report}");
    let marked = &diagnostic.source.text[diagnostic.span.clone()];
    assert_eq!(marked, underlined, "{to:?} gave\n{report}");
}

#[test]
fn every_mistake_is_underlined() {
    refused("fov = 80", "fvo = 80", "did you mean `fov`?", "fvo");
    refused("[[light]]", "[[lihgt]]", "did you mean `light`?", "lihgt");
    refused("fov = 80", "fov = 180", "between 0 and 180", "180");
    refused("fov = 80", "fov = 0", "between 0 and 180", "0");
    refused("fov = 80", "fov = nan", "not a finite number", "nan");
    refused("fov = 80", "fov = \"wide\"", "must be a number", "\"wide\"");
    refused(
        "[3.0, 0, 0.0]",
        "[3.0, inf, 0.0]",
        "not a finite number",
        "inf",
    );
    refused("[3.0, 0, 0.0]", "[3.0, 0]", "three numbers", "[3.0, 0]");
    refused("[3.0, 0, 0.0]", "3.0", "three numbers", "3.0");
    refused(
        "look = [-2.0, 0.0, 0.0]",
        "look = [0, 0, 0]",
        "zero vector",
        "[0, 0, 0]",
    );
    refused(
        "[1.0, 0.0, 1.0]",
        "[4, 0, 0]",
        "parallel to `look`",
        "[4, 0, 0]",
    );
    refused(
        "at = [3.0, 0, 0.0]\n",
        "",
        "neither `at` nor `parameters`",
        "[camera]",
    );
    refused(
        "fov = 80",
        "parameters = { c = 1 }",
        "both `at` and",
        "{ c = 1 }",
    );
    refused("scale = 0.2", "scale = 0", "greater than 0", "0");
    refused("scale = 0.2", "scale = -1.5", "greater than 0", "-1.5");
    refused("crease = 45", "crease = 181", "between 0 and 180", "181");
    refused(
        "\"exponential\"",
        "\"exp\"",
        "known here: linear, exponential",
        "\"exp\"",
    );
    refused(
        "\"point\"",
        "\"piont\"",
        "did you mean `point`?",
        "\"piont\"",
    );
    refused("\"grid\"", "\"grd\"", "did you mean `grid`?", "\"grd\"");
    refused("{ pattern = \"grid\" }", "{}", "exactly one of", "{}");
    refused(
        "{ pattern = \"grid\" }",
        "\"grid\"",
        "a table under the name of an exit",
        "\"grid\"",
    );
    refused("axis = [0,0,2]", "axis = [0,0,0]", "zero vector", "[0,0,0]");
    refused(
        "intensity = [10, 10, 10]",
        "intensity = [1, -1, 0]",
        "never negative",
        "[1, -1, 0]",
    );
    refused("fov = 80", "look = [0, 1, 0]", "not valid TOML", "look");
    refused(
        "mesh = \"../meshes/teapot.obj\"",
        "",
        "[[object]] has no `mesh`",
        "[[object]]",
    );
    refused(
        "look = [-2.0, 0.0, 0.0]",
        "",
        "[camera] has no `look`",
        "[camera]",
    );
    refused(
        "manifold = \"../manifolds/ellis-wormhole.toml\"",
        "",
        "has no `manifold`",
        "",
    );
    refused("\"../meshes/teapot.obj\"", "\"\"", "is empty", "\"\"");
    refused("[sky]", "[sky", "not valid TOML", "");
}

#[test]
fn two_views_of_one_name_are_refused() {
    let again = "[[view]]\nname = 'throat'\nat = [0,0,1]\nlook = [1,0,0]\nup = [0,0,1]\n[sky]";
    refused("[sky]", again, "same name", "'throat'");
}

#[test]
fn damaged_text_never_panics() {
    for cut in 0..GOOD.len() {
        let _ = parse(&GOOD[..cut]).map_err(|e| e.report(false));
        let _ = parse(&GOOD[cut..]).map_err(|e| e.report(false));
        for odd in ["\u{e9}", "[", "=", "{", "\"", "9e999"] {
            let text = format!("{}{odd}{}", &GOOD[..cut], &GOOD[cut + 1..]);
            let _ = parse(&text).map_err(|e| e.report(false));
        }
    }
}
