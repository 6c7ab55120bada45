use super::*;

fn parse(text: &str) -> Result<Mesh> {
    Mesh::parse("a.obj", text, Path::new("/nonexistent"))
}

fn refusal(text: &str) -> String {
    let error = parse(text).expect_err(text);
    assert_eq!(error.exit_code(), 2);
    error.to_string()
}

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";

#[test]
fn a_quad_with_everything_is_read() {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 2\n\
                f 1/1/1 2/2/1 3/3/1 4/4/1\n";
    let mesh = parse(text).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(mesh.positions[2], DVec3::new(1.0, 1.0, 0.0));
    assert_eq!(mesh.normals, [DVec3::Z; 4]);
    assert_eq!(mesh.uvs[3], [0.0, 1.0]);
    assert_eq!(mesh.material_of, [0, 0]);
    assert_eq!(mesh.materials[0].kd, [0.7; 3]);
    assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
}

#[test]
fn missing_normals_are_smoothed_across_texture_seams() {
    // A roof: two equal faces at right angles whose ridge has two sets of texture coordinates.
    let text = "v 0 0 1\nv 0 1 1\nv 1 0 0\nv -1 0 0\nvt 0 0\nvt 1 1\n\
                f 1/1 3/1 2/1\nf 1/2 2/2 4/2\n";
    let mesh = Mesh::parse_creased("a.obj", text, Path::new(""), 90.0).unwrap();
    assert_eq!(mesh.positions.len(), 6);
    for (position, normal) in mesh.positions.iter().zip(&mesh.normals) {
        if position.x == 0.0 {
            assert!(normal.abs_diff_eq(DVec3::Z, 1e-12), "{normal}");
        } else {
            let slope = DVec3::new(position.x, 0.0, 1.0).normalize();
            assert!(normal.abs_diff_eq(slope, 1e-12), "{normal}");
        }
    }
}

#[test]
fn normals_given_for_some_corners_only_are_computed_for_all() {
    let text = format!("{TRIANGLE}vn 1 0 0\nf 1//1 2 3\n");
    assert_eq!(parse(&text).unwrap().normals, [DVec3::Z; 3]);
    let zero = format!("{TRIANGLE}vn 0 0 0\nvn nan 0 0\nvn 1 0 0\nf 1//1 2//2 3//3\n");
    assert_eq!(
        parse(&zero).unwrap().normals,
        [DVec3::Z, DVec3::Z, DVec3::X]
    );
}

#[test]
fn numbers_that_are_not_finite_are_refused_with_their_line() {
    for word in ["nan", "inf", "-inf", "1e999", "abc", "0,5"] {
        let text = format!("v 0 0 0\n# comment\nv 1 {word} 0\nv 0 1 0\nf 1 2 3\n");
        let message = refusal(&text);
        assert!(message.starts_with("a.obj:3: "), "{message}");
    }
    assert!(refusal("v 0 0\n").starts_with("a.obj:1: "));
    assert!(refusal("v 0 0 0 0\n").starts_with("a.obj:1: "));
}

#[test]
fn indices_that_point_nowhere_are_refused_with_their_line() {
    for face in [
        "1 2 4",
        "0 1 2",
        "1 2 -4",
        "1/1 2/1 3/1",
        "1//2 2//2 3//2",
        "1/1/1/1 2 3",
    ] {
        let message = refusal(&format!("{TRIANGLE}f {face}\nf 1 2 3\n"));
        assert!(message.starts_with("a.obj:4: "), "{face}: {message}");
    }
    for face in [
        "9223372036854775807 2 3",
        "-9223372036854775808 2 3",
        "1/ x 3",
        "",
        "/1 2 3",
    ] {
        assert!(
            refusal(&format!("{TRIANGLE}f {face}\n")).starts_with("a.obj:4: "),
            "{face}"
        );
    }
    for vn in ["6148914691236517206", "99999999999999999999"] {
        let text = format!("{TRIANGLE}vn 0 0 1\nf 1//{vn} 2//1 3//1\n");
        assert!(refusal(&text).starts_with("a.obj:5: "));
    }
}

#[test]
fn errors_of_the_parser_carry_a_line() {
    assert!(refusal(&format!("{TRIANGLE}vn 0 0\nf 1 2 3\n")).starts_with("a.obj:4: "));
    assert!(refusal(&format!("{TRIANGLE}vt\nf 1 2 3\n")).starts_with("a.obj:4: "));
}

#[test]
fn degenerate_faces_are_left_out_and_counted() {
    let text = format!("{TRIANGLE}f 1 2 3\nf 1 2\nf 1 1 2\nf 1 2 2 1\n");
    let mesh = parse(&text).unwrap();
    assert_eq!(mesh.triangles.len(), 1);
    assert!(
        mesh.warnings.iter().any(|w| w.contains("1 faces of fewer")),
        "{:?}",
        mesh.warnings
    );
    assert!(
        mesh.warnings
            .iter()
            .any(|w| w.contains("3 triangles without area")),
        "{:?}",
        mesh.warnings
    );
}

#[test]
fn a_mesh_without_triangles_is_refused() {
    for text in [
        "",
        "# nothing\n",
        TRIANGLE,
        &format!("{TRIANGLE}f 1 1 1\n"),
        "\u{fffd}\0\n",
    ] {
        assert!(refusal(text).contains("no triangle"), "{text:?}");
    }
}

#[test]
fn missing_materials_give_grey_and_a_warning() {
    let text = format!("mtllib none.mtl\n{TRIANGLE}usemtl gold\nf 1 2 3\n");
    let mesh = parse(&text).unwrap();
    assert_eq!(mesh.materials[0].kd, [0.7; 3]);
    assert!(mesh.warnings[0].contains("none.mtl"), "{:?}", mesh.warnings);
    assert!(mesh.warnings[1].contains("`gold`"), "{:?}", mesh.warnings);
}

#[test]
fn materials_and_textures_are_read_beside_the_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let mtl = "newmtl red\nKd 1 0 0\nKs 0.5\nNs 20\nd 0.5\nmap_Kd dot.png\nnewmtl lamp\nKe 4 4 4\n\
               map_Kd gone.png\nKd oops\n";
    std::fs::write(folder.path().join("m.mtl"), mtl).unwrap();
    let dot = folder.path().join("dot.png");
    image::save_buffer(dot, &[255, 255, 0], 1, 1, image::ColorType::Rgb8).unwrap();
    let path = folder.path().join("m.obj");
    let text = format!("mtllib m.mtl\n{TRIANGLE}usemtl lamp\nf 1 2 3\nusemtl red\nf 1 3 2\n");
    std::fs::write(&path, text).unwrap();

    let mesh = Mesh::load(&path).unwrap();
    let named = |i: usize| &mesh.materials[mesh.material_of[i] as usize];
    assert_eq!((named(0).name.as_str(), named(0).ke), ("lamp", [4.0; 3]));
    let red = named(1);
    assert_eq!(
        (red.kd, red.ks, red.ns, red.dissolve),
        ([1.0, 0.0, 0.0], [0.5; 3], 20.0, 0.5)
    );
    assert_eq!(
        red.map_kd.as_ref().unwrap().texture.sample(0.1, 0.9),
        [1.0, 1.0, 0.0]
    );
    assert!(named(0).map_kd.is_none());
    assert_eq!(mesh.warnings.len(), 2, "{:?}", mesh.warnings);
    assert!(mesh.warnings[0].contains("m.mtl:10: ignored `Kd oops`"));
    assert!(mesh.warnings[1].contains("gone.png"));
}

#[test]
fn an_absent_file_is_bad_input() {
    assert_eq!(
        Mesh::load(Path::new("/nonexistent.obj"))
            .unwrap_err()
            .exit_code(),
        2
    );
}

#[test]
fn damaged_text_never_panics() {
    let good = "mtllib a\nv 0 0 0 1 1 1\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\no x\nusemtl y\nf 1/1/1 2/1/1 -1/-1/-1 1\n";
    for cut in 0..good.len() {
        let _ = parse(&good[cut..]);
        for odd in ["\n", "/", "-", "9", " ", "\t", "\u{e9}", "f", "\\"] {
            let _ = parse(&format!("{}{odd}{}", &good[..cut], &good[cut..]));
        }
    }
}

#[test]
fn faces_smooth_their_normals_within_their_group_only() {
    let roof = "v 0 0 1\nv 0 1 1\nv 1 0 0\nv -1 0 0\n";
    let normals = |text: &str| parse(&format!("{roof}{text}")).unwrap().normals;
    let slopes = [
        DVec3::new(1.0, 0.0, 1.0).normalize(),
        DVec3::new(-1.0, 0.0, 1.0).normalize(),
    ];
    let flat = normals("s off\nf 1 3 2\nf 1 2 4\n");
    assert_eq!(flat.len(), 6);
    assert!(flat[..3].iter().all(|n| n.abs_diff_eq(slopes[0], 1e-12)));
    assert!(flat[3..].iter().all(|n| n.abs_diff_eq(slopes[1], 1e-12)));
    let apart = normals("g left\ns 1\nf 1 3 2\ng right\ns 2\nf 1 2 4\n");
    assert!(
        apart
            .iter()
            .all(|n| slopes.iter().any(|s| n.abs_diff_eq(*s, 1e-12)))
    );
    let together = normals("s 1\nf 1 3 2\no other\nf 1 2 4\n");
    assert!(together.iter().any(|n| n.abs_diff_eq(DVec3::Z, 1e-12)));
}

#[test]
fn a_line_may_go_on_after_a_backslash_and_line_numbers_stay() {
    let mesh = parse(&format!("{TRIANGLE}f 1 \\\n 2 \\\n 3\n")).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    let message = refusal(&format!("{TRIANGLE}f 1 \\\n 2 3\nf 1 2 9\n"));
    assert!(message.starts_with("a.obj:6: "), "{message}");
}

#[test]
fn what_grows_in_a_file_takes_time_in_proportion() {
    use std::fmt::Write;
    let folder = tempfile::tempdir().unwrap();
    let count = 100_000;
    // As many materials as faces.
    let mut text = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\n");
    let mut library = String::new();
    // As many words that might be libraries.
    text += "mtllib m.mtl\nmtllib";
    (0..count).for_each(|k| write!(text, " {k}.mtl").unwrap());
    for k in 0..count {
        write!(text, "\nusemtl m{k} # {k}\nf 1 2 3").unwrap();
        write!(library, "newmtl m{k}\nKd 0.5 0 0\n").unwrap();
    }
    std::fs::write(folder.path().join("m.mtl"), library).unwrap();
    let began = std::time::Instant::now();
    let mesh = Mesh::parse("many.obj", &text, folder.path()).unwrap();
    assert_eq!(mesh.materials.len(), count);
    assert!(mesh.materials.iter().all(|m| m.kd == [0.5, 0.0, 0.0]));
    // One face: a staircase with a corner in the middle of every side.
    let mut text = String::new();
    for k in 0..count / 4 {
        let places = [
            [k, k],
            [2 * k + 1, 2 * k],
            [k + 1, k],
            [2 * k + 2, 2 * k + 1],
        ];
        for (i, [x, y]) in places.into_iter().enumerate() {
            let half = if i % 2 == 1 { 0.5 } else { 1.0 };
            let [x, y] = [x as f64 * half, y as f64 * half];
            writeln!(text, "v {x} {y} 0").unwrap();
        }
    }
    let end = count / 4;
    writeln!(text, "v {end} {end} 0\nv 0 {end} 0\nf").unwrap();
    text.truncate(text.len() - 1);
    (1..=4 * end + 2).for_each(|k| write!(text, " {k}").unwrap());
    let mesh = Mesh::parse("stairs.obj", &text, folder.path()).unwrap();
    let area: f64 = (mesh.triangles.iter())
        .map(|t| 0.5 * mesh.doubled_area(*t).z)
        .sum();
    let n = end as f64;
    let known = n * (n + 1.0) / 2.0;
    assert!((area - known).abs() < 1e-6 * known, "{area} {known}");
    assert!(began.elapsed().as_secs() < 60, "{:?}", began.elapsed());
}
