//! Files of samples: what cannot be a field is refused at its place, what is another space, and what bundles bring along.

mod support;

use geofan_bundle::{
    Bundle, Contents, PlanRecord, Polynomial, StepSize, Train, Tree, Variables, rays::RaySpace,
};
use geofan_core::{diagnostic::SourceText, manifold::Manifold};
use glam::DVec3;
use ndarray::{ArrayD, IxDyn};
use std::{fs, sync::Arc};
use support::sampled::{BOX, LENS, Sampled, cube, log_index, write_npy};

#[test]
fn a_changed_sample_is_another_space_and_a_moved_file_is_not() {
    let first = Sampled::new(17, |u| log_index(u, 0.0));
    let again = Sampled::new(17, |u| log_index(u, 0.0));
    let changed = Sampled::new(17, |u| {
        log_index(u, 0.0) + if u.length() < 0.1 { 1e-6 } else { 0.0 }
    });
    let [a, b, c] = [&first, &again, &changed].map(|s| s.manifold(BOX, LENS));
    assert_eq!(a.differences(&b), [""; 0]);
    assert_eq!(a.fingerprint(), b.fingerprint());
    assert_ne!(a.fingerprint(), c.fingerprint());
    assert!(a.differences(&c)[0].contains("component xx of the metric differs"));
    // Elsewhere and under another name.
    fs::rename(
        first.folder.path().join("logn.npy"),
        first.folder.path().join("moved.npy"),
    )
    .unwrap();
    let text = Sampled::text(BOX, LENS).replace("logn.npy", "moved.npy");
    let name = first.folder.path().join("m.toml").display().to_string();
    let moved = Manifold::from_source(SourceText::new(name, text), &[]).unwrap();
    assert_eq!(a.differences(&moved), [""; 0]);
}

#[test]
fn what_cannot_be_a_field_is_refused_at_its_place() {
    let sampled = Sampled::new(17, |u| log_index(u, 0.0));
    let [small, single] = [5, 1].map(|n| Sampled::new(n, |_| 0.0));
    let mut values = cube(17, |u| log_index(u, 0.0));
    values[17 * 17 * 3 + 17 * 4 + 5] = f32::NAN;
    let broken = Sampled::new(17, |_| 0.0);
    write_npy(&broken.folder.path().join("logn.npy"), [17; 3], &values);
    let cases = [
        (
            &sampled,
            format!("{BOX}\ndegree = 1"),
            LENS,
            "degree = 1",
            "not smooth enough for a metric",
        ),
        (
            &sampled,
            format!("{BOX}\ndegree = 3"),
            "embedding = [\"x\", \"y\", \"z\", \"logn(x, y, z)\"]",
            "degree = 3",
            "not smooth enough for an embedding",
        ),
        (
            &sampled,
            format!("{BOX}\nendian = \"little\""),
            LENS,
            "endian = \"little\"",
            "for files without a head",
        ),
        (
            &single,
            BOX.into(),
            LENS,
            "box = ",
            "one sample has no places",
        ),
        (
            &sampled,
            format!("{BOX}\ndegree = 4"),
            LENS,
            "degree = 4",
            "degree 1, 3 or 5, not 4",
        ),
        (
            &sampled,
            "box = { x = [4, -4], y = [0, 1], z = [0, 1] }".into(),
            LENS,
            "box",
            "lower limit first",
        ),
        (&sampled, String::new(), LENS, "logn", "needs `box`"),
        (
            &sampled,
            format!("{BOX}\noutside = \"wrap\""),
            LENS,
            "wrap",
            "cannot be `wrap`",
        ),
        (
            &sampled,
            format!("{BOX}\narray = \"n\""),
            LENS,
            "array",
            "holds one array",
        ),
        (
            &sampled,
            format!("{BOX}\nsmooth = 40"),
            LENS,
            "smooth",
            "reaches over",
        ),
        (
            &sampled,
            format!("{BOX}\nshape = [3, 3, 3]"),
            LENS,
            "shape",
            "without a head",
        ),
        (
            &sampled,
            format!("{BOX}\ndegre = 3"),
            LENS,
            "degre",
            "unknown key `degre`",
        ),
        (
            &small,
            BOX.into(),
            LENS,
            "file",
            "5 samples along x; degree 5 needs 6",
        ),
        (
            &broken,
            BOX.into(),
            LENS,
            "file",
            "sample [3, 4, 5] of `logn` is NaN",
        ),
        (
            &sampled,
            BOX.into(),
            "metric = { conformal = \"exp(logn(x, y))\" }",
            "logn(x, y)",
            "takes 3 arguments",
        ),
        (
            &sampled,
            BOX.into(),
            "metric = { conformal = \"exp(lognn(x, y, z))\" }",
            "lognn",
            "did you mean `logn`?",
        ),
    ];
    for (files, section, rest, place, message) in cases {
        let report = files.load(&section, rest).expect_err(&section);
        assert!(report.contains(message), "{section}\n{report}");
        assert!(
            report.contains(place) && report.contains("^"),
            "{section}\n{report}"
        );
    }
    for (name, message) in [
        ("sin", "is a function"),
        ("x", "already a coordinate"),
        ("a b", "is not a name"),
    ] {
        let text = Sampled::text(BOX, LENS).replace("field.logn", &format!("field.\"{name}\""));
        let path = sampled.folder.path().join("m.toml").display().to_string();
        let error = Manifold::from_source(SourceText::new(path, text), &[]).unwrap_err();
        assert!(
            error.report(false).contains(message),
            "{}",
            error.report(false)
        );
    }
    let text = Sampled::text(BOX, LENS);
    let lost = Manifold::from_source(SourceText::new("nowhere/m.toml", text), &[]).unwrap_err();
    let report = lost.report(false);
    assert!(
        report.contains("no such file") && report.contains("relative to the manifold"),
        "{report}"
    );
}

/// Makes a bundle of `manifold` that has paths of zeros, with one camera parameter.
fn bundle_of(manifold: &Arc<Manifold>) -> Vec<u8> {
    let space = RaySpace::new(manifold.clone()).unwrap();
    let plan = PlanRecord::new(5.0, 0.5, vec![1], vec![1, 1, 1, 1]);
    let polynomial = Polynomial {
        coefficients: ArrayD::zeros(IxDyn(&[1, 1, 1, 1, 3])),
        variables: Variables::of_face(1, plan.mapping),
    };
    let tensor = Train::plain(&polynomial)
        .rounded(StepSize::near(1e-6))
        .unwrap();
    let chunk = Tree::Leaf(Arc::new(tensor)).encode();
    let chunks = (0..6).map(|face| (face, chunk.clone())).collect();
    let contents = Contents::new(space, plan, 0, chunks).unwrap();
    contents.encode().unwrap()
}

/// Checks that `bytes` alone are a bundle of `manifold`.
fn check_bundle(bytes: &[u8], manifold: &Manifold) {
    let bundle = Bundle::from_bytes(bytes).unwrap();
    assert_eq!(bundle.manifold.differences(manifold), [""; 0]);
    assert_eq!(bundle.contents().encode().unwrap(), bytes);
    let other = bundle.contents().manifold_with("b.fan", &[]).unwrap();
    assert_eq!(other.differences(manifold), [""; 0]);
}

const RAIL: &str =
    "[cameras]\nparameters = { c = [-1, 1] }\nat = [\"c\", \"0\", \"0\"]\nlength = 5.0\n";

#[test]
fn a_bundle_brings_its_samples_along() {
    let sampled = Sampled::new(17, |u| log_index(u, 0.0));
    let manifold = Arc::new(sampled.manifold(BOX, &format!("{LENS}\n{RAIL}")));
    let bytes = bundle_of(&manifold);
    assert!(bytes.len() < 17 * 17 * 17 * 4);
    // The reader has the bytes alone.
    drop(sampled);
    check_bundle(&bytes, &manifold);
}

#[test]
fn a_bundle_brings_the_places_along_that_only_an_image_tells() {
    let folder = tempfile::tempdir().unwrap();
    let numbers = cube(9, |u| log_index(u, 0.0));
    let numbers: Vec<String> = numbers.iter().map(f32::to_string).collect();
    let image = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" byte_order=\"LittleEndian\">\n\
         <ImageData WholeExtent=\"0 8 0 8 0 8\" Origin=\"-4 -4 -5\" Spacing=\"1 1 1.25\">\n\
         <Piece Extent=\"0 8 0 8 0 8\">\n<PointData>\n<DataArray type=\"Float32\" Name=\"n\" format=\"ascii\">\n\
         {}\n</DataArray>\n</PointData>\n</Piece>\n</ImageData>\n</VTKFile>\n",
        numbers.join(" ")
    );
    fs::write(folder.path().join("n.vti"), image).unwrap();
    let load = |section: &str| {
        let name = folder.path().join("m.toml").display().to_string();
        let text = format!(
            "name = \"image\"\ncoordinates = [\"x\", \"y\", \"z\"]\n{LENS}\n[field.logn]\nfile = \"n.vti\"\n{section}\n{RAIL}"
        );
        Arc::new(Manifold::from_source(SourceText::new(name, text), &[]).unwrap())
    };
    let sections = ["", "box = { x = [-4, 4], y = [-4, 4], z = [-5, 5] }"];
    let [own, told] = sections.map(load);
    let bytes = [bundle_of(&own), bundle_of(&told)];
    drop(folder);
    check_bundle(&bytes[0], &own);
    check_bundle(&bytes[1], &told);
    // Both are the same space.
    let u = DVec3::new(0.3, -0.2, 0.7);
    assert_eq!(own.metric(u), told.metric(u));
}
