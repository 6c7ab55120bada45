//! Bakes of tiny tables by the program: equal bytes whichever way they are made, and what is said
//! when they cannot be made.

mod support;

use assert_cmd::assert::Assert;
use geofan_bake::certify;
use geofan_bundle::Bundle;
use geofan_core::random::Stream;
use geofan_render::Camera;
use glam::DVec3;
use serde_json::Value;
use std::fs;
use support::Place;

/// A mild lens seen from anywhere on a shell: two axes, four chunks.
const LENS: &str = r#"
name = "lens"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(h*exp(-(x^2 + y^2 + z^2)/2))" }
[parameters]
h = 0.1
[symmetry]
rotation = "origin"
[cameras]
parameters = { c = [1, 2] }
at = ["c", "0", "0"]
length = 3.0
"#;

/// The same from one point: one face of one axis.
const POINT: &str = r#"
name = "point"
coordinates = ["x", "y", "z"]
metric = { conformal = "1 + 0.1*exp(-x^2)" }
[cameras]
at = ["1", "0", "0"]
length = 2.0
"#;

/// A lens seen from anywhere in a box, with all reflections and exchanges of coordinates.
const BOX: &str = r#"
name = "box"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(0.2*exp(-(x^2 + y^2 + z^2)/2))" }
[cameras]
parameters = { a = [-1, 1], b = [-1, 1], c = [-1, 1] }
at = ["a", "b", "c"]
length = 2.0
"#;

fn place() -> Place {
    Place::with(&[
        ("lens.toml", LENS),
        ("point.toml", POINT),
        ("box.toml", BOX),
    ])
}

/// A bake of the lens; tests differ in what they add.
fn lens(place: &Place, arguments: &str) -> Assert {
    place.bake(&format!(
        "lens.toml --max-error 2 --certify-rays 400 {arguments}"
    ))
}

fn json(place: &Place, arguments: &str) -> Value {
    let output = lens(place, arguments).success().get_output().stdout.clone();
    serde_json::from_slice(&output).unwrap()
}

fn stderr(assert: &Assert) -> String {
    String::from_utf8(assert.get_output().stderr.clone()).unwrap()
}

#[test]
fn a_bake_keeps_its_promise_and_leaves_one_file() {
    let place = place();
    let report = json(&place, "-o b.fan --json");
    assert!(report["screen_mrad"]["p99"].as_f64().unwrap() <= 2.0);
    assert!(report["rotation_mrad"]["p99"].as_f64().unwrap() <= 10.0);
    assert_eq!(report["kept"], true);
    let size = fs::metadata(place.path("b.fan")).unwrap().len();
    assert_eq!(report["bytes"], size);
    assert!(!place.path("b.fan.parts").exists());
    let bundle = Bundle::read(&place.path("b.fan")).unwrap();
    let certificate = bundle.header.certificate.clone().unwrap();
    assert_eq!(report["exact_rays"], certificate.exact_rays_baked);
    let fresh = certify(&bundle.table, 500, 77, 1e-9, 2.0, |_| Ok(())).unwrap();
    assert!(fresh.certificate.keeps(2.0), "{fresh:?}");
}

#[test]
fn any_number_of_threads_makes_the_same_bytes() {
    let place = place();
    for threads in [1, 2, 7] {
        let output = format!("{threads}.fan");
        lens(&place, &format!("-o {output} --threads {threads}")).success();
    }
    assert!(place.bytes("1.fan") == place.bytes("2.fan"));
    assert!(place.bytes("1.fan") == place.bytes("7.fan"));
}

#[test]
fn shards_merge_to_the_bytes_of_an_undivided_bake() {
    let place = place();
    lens(&place, "-o whole.fan").success();
    for share in 1..=3 {
        lens(&place, &format!("-o {share}.fan --shard {share}/3")).success();
    }
    assert!(!place.path("1.fan.parts").exists());
    place
        .bake("merge 3.fan 1.fan 2.fan -o merged.fan")
        .success();
    assert!(place.bytes("whole.fan") == place.bytes("merged.fan"));

    let missing = place.bake("merge 3.fan 1.fan -o no.fan").code(2);
    assert!(stderr(&missing).contains("missing of its 3 shards: 2"));
    let twice = place
        .bake("merge 1.fan 1.fan 2.fan 3.fan -o no.fan")
        .code(2);
    assert!(stderr(&twice).contains("same share"));
    let whole = place.bake("merge 1.fan whole.fan -o no.fan").code(2);
    assert!(stderr(&whole).contains("whole bundle"));
    place
        .bake("lens.toml --max-error 3 --shard 2/3 -o other.fan")
        .success();
    let other = place.bake("merge 1.fan other.fan 3.fan -o no.fan").code(2);
    assert!(stderr(&other).contains("not of the same bake"));
    assert!(!place.path("no.fan").exists());
    let over = place.bake("merge 1.fan 2.fan 3.fan -o 2.fan").code(2);
    assert!(stderr(&over).contains("name another output"));
}

#[test]
fn more_cells_are_more_chunks_of_a_table_as_good() {
    let place = place();
    lens(&place, "-o usual.fan").success();
    lens(&place, "-o b.fan --cells 9").success();
    let [usual, finer] =
        ["usual.fan", "b.fan"].map(|name| Bundle::read(&place.path(name)).unwrap());
    assert_eq!(4 * finer.table.chunks.len(), 9 * usual.table.chunks.len());
    let fresh = certify(&finer.table, 500, 77, 1e-9, 2.0, |_| Ok(())).unwrap();
    assert!(fresh.certificate.keeps(2.0), "{fresh:?}");
    let none = place.bake("point.toml -o p.fan --cells 2").code(2);
    assert!(stderr(&none).contains("no camera parameters"));
    let many = place.bake("box.toml -o p.fan --cells 200").code(2);
    assert!(stderr(&many).contains("48000000 chunks"));
    assert!(!place.path("p.fan").exists());
}

#[test]
fn chunks_in_each_others_places_under_new_checksums_are_found_by_a_check() {
    let place = place();
    lens(&place, "-o b.fan").success();
    let mut contents = geofan_bundle::Contents::read(&place.path("b.fan")).unwrap();
    let first = contents.chunks[0].1.clone();
    contents.chunks[0].1 = std::mem::replace(&mut contents.chunks[2].1, first);
    contents.write(&place.path("forged.fan")).unwrap();
    let check = |name: &str| {
        let mut command = assert_cmd::cargo::cargo_bin_cmd!("geofan");
        let arguments = ["check", name, "--rays", "400", "--quiet"];
        command.current_dir(place.path("")).args(arguments).assert()
    };
    check("b.fan").success();
    check("forged.fan").code(1);
}

/// Leaves the parts of a finished bake in `b.fan.parts`, as an interruption would: a bake that
/// cannot write its result keeps them.
fn parts_of_a_bake(place: &Place) {
    lens(place, "--max-size 1200 -o b.fan").code(1);
    assert!(place.path("b.fan.parts/chunk-000000").exists());
}

#[test]
fn resuming_uses_whole_parts_and_bakes_damaged_missing_and_foreign_ones_again() {
    let place = place();
    lens(&place, "-o whole.fan").success();
    // A limit that only the finished file exceeds: all parts are there.
    let limit = place.bytes("whole.fan").len() - 1;
    lens(&place, &format!("--max-size {limit} -o b.fan")).code(1);
    let part = |k: usize| place.path(&format!("b.fan.parts/chunk-00000{k}"));
    assert!((0..4).all(|k| part(k).exists()));

    fs::remove_file(part(0)).unwrap();
    let mut damaged = fs::read(part(1)).unwrap();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 4;
    fs::write(part(1), damaged).unwrap();
    fs::copy(part(3), part(2)).unwrap();
    fs::write(place.path("b.fan.parts/.geofan-x.part"), "cut off").unwrap();
    // Earlier versions did not note whose chunks they are.
    let files = fs::read_dir(place.path("b.fan.parts")).unwrap();
    let notes = files.map(|file| file.unwrap()).filter(|file| {
        let name = file.file_name();
        name.to_string_lossy().starts_with("plan-")
    });
    let notes: Vec<_> = notes.map(|note| note.path()).collect();
    assert_eq!(notes.len(), 1);
    fs::remove_file(&notes[0]).unwrap();
    lens(&place, "--resume -o b.fan").success();
    assert!(place.bytes("whole.fan") == place.bytes("b.fan"));
    assert!(!place.path("b.fan.parts").exists());
}

#[test]
fn without_resume_parts_are_discarded_with_a_note() {
    let place = place();
    lens(&place, "-o whole.fan").success();
    let limit = place.bytes("whole.fan").len() - 1;
    lens(&place, &format!("--max-size {limit} -o b.fan")).code(1);
    let again = lens(&place, "-o b.fan").success();
    assert!(stderr(&again).contains("discarded 12 chunks"));
    assert!(place.bytes("whole.fan") == place.bytes("b.fan"));
}

#[test]
fn parts_of_another_promise_are_neither_used_nor_lost() {
    let place = place();
    place
        .bake("lens.toml --max-error 0.3 --certify-rays 400 --max-size 1200 -o b.fan")
        .code(1);
    lens(&place, "-o whole.fan").success();
    let refused = lens(&place, "--resume -o b.fan").code(2);
    let text = stderr(&refused);
    assert!(text.contains("with other options"), "{text}");
    assert!(place.path("b.fan.parts/chunk-000000").exists());
    lens(&place, "-o b.fan").success();
    assert!(place.bytes("whole.fan") == place.bytes("b.fan"));
}

#[test]
fn refinement_may_end_where_a_share_of_the_rays_is_left() {
    let place = Place::with(&[("strong.toml", &LENS.replace("length = 3.0", "length = 8.0"))]);
    let bake = |flags: &str| -> Value {
        let fixed = "strong.toml --set h=2 --max-error 0.05 --certify-rays 400 -o b.fan --json";
        let assert = place.bake(&format!("{fixed}{flags}")).success();
        serde_json::from_slice(&assert.get_output().stdout).unwrap()
    };
    let all = bake("");
    assert_eq!(all["flagged"], 0.0);
    let mut before = all;
    for most in [0.3, 0.6] {
        let report = bake(&format!(" --flagged {}", 100.0 * most));
        let flagged = report["flagged"].as_f64().unwrap();
        // What is left when the first level with so little is done; and a sample of 400 rays.
        assert!(flagged > 0.0 && flagged < most + 0.1, "{most}: {flagged}");
        assert_eq!(report["kept"], true);
        let less = |key: &str| report[key].as_u64().unwrap() < before[key].as_u64().unwrap();
        assert!(less("bytes") && less("exact_rays"), "{report} {before}");
        before = report;
    }
    for wrong in ["0", "100", "-1", "nan", "half"] {
        let assert = place.bake(&format!("strong.toml -o b.fan --flagged={wrong}"));
        assert!(stderr(&assert.code(2)).contains("--flagged"), "{wrong}");
    }
}

#[test]
fn a_space_without_mirrors_is_baked_as_it_is_when_none_may_be_used() {
    let uneven = BOX
        .replace(
            "(x^2 + y^2 + z^2)",
            "((x-0.3)^2 + (y+0.17)^2/1.3 + z^2/2 + 0.2*x*y*z)",
        )
        .replace("b = [-1, 1], c = [-1, 1]", "")
        .replace(r#"["a", "b", "c"]"#, r#"["a", "0.1", "0.2"]"#);
    let place = Place::with(&[("uneven.toml", &uneven)]);
    for options in ["-o a.fan", "--no-mirrors -o b.fan"] {
        let common = "uneven.toml --max-error 20 --certify-rays 300";
        place.bake(&format!("{common} {options}")).success();
    }
    assert!(place.bytes("a.fan") == place.bytes("b.fan"));
}

#[test]
fn units_that_no_bundle_can_hold_are_refused_before_the_bake() {
    for unit in ["1e40", "1e-40"] {
        let text = POINT.replace("1 + 0.1*exp(-x^2)", &format!("{unit}*(1 + 0.1*exp(-x^2))"));
        let place = Place::with(&[("far.toml", &text)]);
        let refused = place
            .bake(&format!("far.toml -o far.fan --length {unit}"))
            .code(2);
        assert!(stderr(&refused).contains("write the metric in other units"));
        assert!(!place.path("far.fan.parts").exists());
    }
}

#[test]
fn a_size_limit_loosens_the_promise_and_refuses_an_explicit_one() {
    let place = place();
    lens(&place, "-o whole.fan").success();
    let limit = place.bytes("whole.fan").len();
    let explicit = place
        .bake(&format!(
            "lens.toml -o b.fan --max-error 0.02 --max-size {limit}"
        ))
        .code(1);
    let text = stderr(&explicit);
    assert!(
        text.contains("0.0200 mrad") && text.contains(&limit.to_string()),
        "{text}"
    );
    assert!(!place.path("b.fan").exists());
    // Below what no promise reaches, nothing is baked.
    let hopeless = place.bake("lens.toml -o d.fan --max-size 100").code(1);
    assert!(stderr(&hopeless).contains("without any paths"));
    assert!(!place.path("d.fan.parts/chunk-000000").exists());
    let loosened = place
        .bake(&format!(
            "lens.toml -o c.fan --certify-rays 4000 --max-size {limit} --json"
        ))
        .success();
    let report: Value = serde_json::from_slice(&loosened.get_output().stdout).unwrap();
    assert!(report["bytes"].as_u64().unwrap() <= limit as u64);
    assert!(report["promise"].as_f64().unwrap() >= 0.5);
    assert!(!place.path("c.fan.parts").exists());
    // A limit that the file just fits is kept, and one byte less is not.
    lens(&place, &format!("--max-size {limit} -o whole.fan")).success();
    lens(&place, &format!("--max-size {} -o e.fan", limit - 1)).code(1);
}

#[test]
fn a_camera_at_one_point_can_be_baked_without_frames() {
    let place = place();
    let output = place
        .bake("point.toml -o p.fan --max-error 5 --no-frames --certify-rays 3000 --json")
        .success();
    let report: Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    assert!(report["rotation_mrad"].is_null());
    assert!(report["screen_mrad"]["p99"].as_f64().unwrap() <= 5.0);
}

#[test]
#[cfg(unix)]
fn an_interrupted_bake_says_how_to_go_on() {
    let place = place();
    // Long enough to have installed its handlers; the bake takes far longer.
    let text = place.interrupted(
        "lens.toml -o b.fan --max-error 0.0001 --threads 1",
        "b.fan.parts",
    );
    assert!(
        text.contains("--max-error 0.0001 --threads 1 --resume"),
        "{text}"
    );
    assert!(place.path("b.fan.parts").exists() && !place.path("b.fan").exists());
}

#[test]
fn a_claim_that_is_false_far_from_cameras_only_is_refused_with_the_point() {
    let place = place();
    // A second lens beside the cameras' line, a fifth as wide as it is far from the origin.
    let needle = "exp(-((x - 1.7)^2 + (y - 0.9)^2 + (z - 0.4)^2)/(2*0.1^2))";
    let text = LENS.replace("^2)/2)", &format!("^2)/2) + 0.5*{needle}"));
    assert!(text.contains(needle));
    std::fs::write(place.path("needle.toml"), text).unwrap();
    let said = stderr(&place.bake("needle.toml -o b.fan --max-error 2").code(2));
    assert!(
        said.contains("this symmetry is not one of the metric: at x = "),
        "{said}"
    );
    assert!(said.contains("needle.toml:8:1"), "{said}");
    assert!(!place.path("b.fan.parts").exists());
}

#[test]
fn wrong_flags_and_files_are_bad_input() {
    let place = place();
    for wrong in [
        "lens.toml",
        "none.toml -o b.fan",
        "lens.toml -o nowhere/b.fan",
        "lens.toml -o .",
        "lens.toml -o ./lens.toml",
        "lens.toml -o b.fan --max-error 0",
        "lens.toml -o b.fan --max-size many",
        "lens.toml -o b.fan --shard 0/3",
        "lens.toml -o b.fan --shard 4/3",
        "lens.toml -o b.fan --shard 1/2 --max-size 4MiB",
        "lens.toml -o b.fan --length -1",
        "lens.toml -o b.fan --set g=1",
        "lens.toml -o b.fan --certify-rays 0",
        "merge -o b.fan",
        "merge lens.toml -o b.fan",
        "merge none.fan -o b.fan",
        "demo --nonsense",
    ] {
        place.bake(wrong).code(2);
    }
    assert!(!place.path("b.fan").exists() && !place.path("b.fan.parts").exists());
}

#[test]
#[cfg(target_os = "linux")]
fn a_place_that_takes_no_files_is_the_environment() {
    let place = place();
    // Nobody, not even root, can make a folder there.
    lens(&place, "-o /proc/self/b.fan").code(3);
}

#[test]
fn an_explicit_promise_that_does_not_fit_keeps_its_parts_for_a_larger_limit() {
    let place = place();
    parts_of_a_bake(&place);
    lens(&place, "--max-size 1MiB --resume -o b.fan").success();
}

/// Both ways of moving share no step: one integrates, the other reads what was baked.
#[test]
fn a_camera_moved_by_table_comes_where_the_geodesic_goes() {
    let place = place();
    place
        .bake("lens.toml -o lens.fan --max-error 0.2")
        .success();
    let bundle = Bundle::read(&place.path("lens.fan")).unwrap();
    let (manifold, table) = (bundle.manifold.as_ref(), &bundle.table);
    let mut stream = Stream::new(&[11]);
    let (mut points, mut turns) = (Vec::new(), Vec::new());
    for _ in 0..300 {
        let camera = Camera {
            u: stream.direction() * stream.between(1.0, 2.0),
            rotation: stream.rotation(),
        };
        let by = stream.direction() * stream.between(0.1, 2.9);
        let exact = camera.moved(manifold, by);
        let read = camera.moved_by(table, by).unwrap();
        assert!((exact.length - read.length).abs() < 1e-12);
        let off =
            manifold.standard_frame(exact.camera.u).inverse() * (read.camera.u - exact.camera.u);
        points.push(1e3 * off.length() / exact.length);
        turns.push(1e3 * exact.camera.rotation.angle_between(read.camera.rotation));
    }
    for errors in [&mut points, &mut turns] {
        errors.sort_by(f64::total_cmp);
        assert!(
            errors[297] < 0.3 && errors[299] < 2.0,
            "{:?}",
            &errors[290..]
        );
    }
    assert!(camera_outside(table));
}

fn camera_outside(table: &geofan_bundle::Table) -> bool {
    let camera = Camera::looking(DVec3::X * 9.0, -DVec3::X, DVec3::Z);
    camera.moved_by(table, DVec3::X).is_err()
}

#[test]
fn chunks_that_mirrors_make_of_others_are_not_stored() {
    let place = place();
    let bake = |name: &str, arguments: &str| {
        let options = "--max-error 4 --max-sky-error 4 --certify-rays 400";
        place
            .bake(&format!("box.toml -o {name} {options}{arguments}"))
            .success();
        Bundle::read(&place.path(name)).unwrap()
    };
    let [folded, whole] = [bake("folded.fan", ""), bake("whole.fan", " --no-mirrors")];
    assert_eq!(folded.header.plan.mirrors.len(), 47);
    assert_eq!(
        (folded.table.chunks.len(), whole.table.chunks.len()),
        (2, 8)
    );
    let size = |b: &Bundle| b.contents().encode().unwrap().len();
    let [few, many] = [&folded, &whole].map(size);
    assert!(2 * few < many, "{few} {many}");
    // Rays from everywhere in all directions, against exact ones.
    let checked = certify(&folded.table, 2000, 3, 1e-9, 4.0, |_| Ok(())).unwrap();
    let certificate = checked.certificate;
    assert!(certificate.screen_mrad.p99 < 4.0, "{certificate:?}");
    assert!(certificate.sky_mrad.unwrap().p99 < 4.0);
    assert!(certificate.rotation_mrad.unwrap().p99 < 8.0);
    // A box of the table is named where the ray's image is.
    let table = &folded.table;
    let camera = table.space.place(DVec3::new(0.5, -0.3, 0.8)).unwrap();
    for d in [
        DVec3::X,
        DVec3::NEG_Y,
        DVec3::new(0.2, 0.3, -0.9).normalize(),
    ] {
        let located = table.space.locate(&camera, d);
        let found = table.box_at(&camera, &located, 1.0).unwrap();
        assert!(found.chunk < 2 && !found.flagged);
    }
}

#[test]
fn a_space_whose_cameras_are_far_from_the_origin_or_small_has_a_certificate() {
    let far = r#"
name = "slab"
coordinates = ["x", "y", "z"]
metric = { conformal = "1.5 - 0.2*exp(-x^2 - y^2)" }
exit = [{ name = "end", when = "abs(z - 100) - 2" }, { name = "side", when = "x^2 + y^2 - 9" }]
symmetry = { translation = ["z"] }
[cameras]
at = ["0.1", "0", "100"]
length = 2.0
"#;
    let small = r#"
name = "flat"
coordinates = ["x", "y", "z"]
metric = { conformal = "1" }
symmetry = { group = ["x + px", "y + py", "z + pz"] }
exit = [{ name = "sky", when = "(x^2 + y^2 + z^2)/1e-12 - 9" }]
[cameras]
length = 5e-6
"#;
    let place = Place::with(&[("far.toml", far), ("small.toml", small)]);
    for name in ["far", "small"] {
        let bake = format!("{name}.toml -o {name}.fan --max-error 5 --certify-rays 200");
        place.bake(&bake).success();
    }
}
