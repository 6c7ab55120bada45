//! `geofan info MANIFOLD --at a,b,c`: the differential geometry at a point, in words and as JSON.

use assert_cmd::cargo::cargo_bin_cmd;
use serde_json::Value;

fn info(name: &str, arguments: &[&str]) -> String {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/manifolds");
    let mut command = cargo_bin_cmd!("geofan");
    command.arg("info").arg(format!("{folder}/{name}.toml"));
    let output = command
        .args(arguments)
        .env("NO_COLOR", "1")
        .output()
        .unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap()
}

fn json(name: &str, at: &str) -> Value {
    let text = info(name, &["--at", at, "--json"]);
    serde_json::from_str::<Value>(&text).unwrap()["at"].clone()
}

#[track_caller]
fn close(found: &Value, expected: f64) {
    let found = found.as_f64().unwrap();
    assert!(
        (found - expected).abs() < 1e-12,
        "{found} instead of {expected}"
    );
}

#[test]
fn everything_at_a_point_of_the_half_space_is_as_by_hand() {
    let at = json("h3-half-space", "0.3,-0.2,0.5");
    for k in 0..3 {
        close(&at["metric"][k][k], 4.0);
        close(&at["inverse"][k][k], 0.25);
        close(&at["frame"][k][k], 0.5);
        close(&at["ricci"][k][k], -8.0);
    }
    close(&at["scalar"], -6.0);
    // Γ^z_xx = 1/z, Γ^x_xz = Γ^z_zz = −1/z.
    close(&at["christoffel"][2][0][0], 2.0);
    close(&at["christoffel"][0][0][2], -2.0);
    close(&at["christoffel"][2][2][2], -2.0);
    close(&at["christoffel"][0][1][1], 0.0);
    // R_xyxy = K (g_xx g_yy − g_xy²)
    close(&at["riemann"][0][1][0][1], -16.0);
    close(&at["riemann"][0][1][1][0], 16.0);
    close(&at["riemann"][0][1][0][2], 0.0);
    // Going along x, the frame (z ∂_x, z ∂_y, z ∂_z) turns from x towards −z at the rate 1/z.
    close(&at["connection"][0][2][0], 2.0);
    close(&at["connection"][0][0][2], -2.0);
    close(&at["connection"][2][0][1], 0.0);
}

#[test]
fn the_same_is_said_in_words() {
    let text = info("sol", &["--at", "0.1,0.2,0"]);
    let at = text.find("\nmetric\n").expect("a metric");
    insta::assert_snapshot!(&text[at + 1..]);
}

#[test]
fn without_a_point_the_cost_of_a_right_hand_side_is_told() {
    let text = info("gaussian-bump", &[]);
    assert!(text.contains("right-hand side  path: "), "{text}");
    assert!(text.contains(" operations, 1 functions"), "{text}");
    assert!(!text.contains("Christoffel"), "{text}");
}
