//! Camera paths: geodesics between poses, and speed along them.

use super::*;
use geofan_core::diagnostic::SourceText;

const SPHERE: &str = r#"
name = "S3"
coordinates = ["x", "y", "z"]
metric = { conformal = "2/(1 + x^2 + y^2 + z^2)" }
"#;

#[test]
fn joined_points_are_as_far_apart_as_the_sphere_has_them() {
    let manifold = Manifold::from_source(SourceText::new("s3", SPHERE), &[]).unwrap();
    let lift = |u: DVec3| {
        (u * 2.0 / (1.0 + u.length_squared()))
            .extend((1.0 - u.length_squared()) / (1.0 + u.length_squared()))
    };
    let (a, b) = (DVec3::new(0.3, -0.2, 0.5), DVec3::new(-0.7, 0.9, 0.4));
    let ray = geodesic_between(&manifold, a, b).unwrap();
    let angle = lift(a).dot(lift(b)).acos();
    assert!((ray.length - angle).abs() < 1e-6, "{} {angle}", ray.length);
}

#[test]
fn poses_are_joined_however_near_they_are_to_each_other() {
    let manifold = Manifold::from_source(SourceText::new("s3.toml", SPHERE), &[]).unwrap();
    for k in 0..18 {
        let pose = |time: usize, x: f64| {
            format!(
                "[[pose]]\ntime = {time}\nat = [{x:?}, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n"
            )
        };
        let to = 3.0 + 0.1_f64.powi(k);
        let text = pose(0, 3.0) + &pose(1, to);
        let file = PoseFile::parse(SourceText::new("path.toml", text), 90.0).unwrap();
        let journey = Journey::new(&manifold, &file).unwrap();
        let off = (journey.pose(1.0).0.u.x - to).abs();
        assert!(
            off <= CLOSE * (to - 3.0) + 2.0 * ROUNDING * to,
            "{k}: {off:e}"
        );
    }
}

#[test]
fn speed_is_zero_at_the_ends_and_never_turns_back() {
    let slopes = monotone_slopes(&[0.0, 1.0, 3.0, 4.0], &[0.0, 2.0, 2.5, 9.0]);
    assert_eq!((slopes[0], slopes[3]), (0.0, 0.0));
    // Three times the smaller chord is the limit of monotony.
    assert!(slopes[1] > 0.0 && slopes[1] <= 0.75 && slopes[2] <= 0.75);
}
