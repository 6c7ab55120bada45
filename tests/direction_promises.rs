//! What tables promise of directions: at exits as much as of points, along paths that only shade four times as
//! much, or what is asked for.

mod support;

use serde_json::Value;
use support::Place;

/// A lens seen from a line beside its middle, in a space that nothing leaves.
const CLOSED: &str = r#"
name = "closed"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(0.5*exp(-(x^2 + y^2 + z^2)/2))" }
[symmetry]
rotation = "origin"
[cameras]
parameters = { c = [1, 3] }
at = ["c", "0", "0"]
length = 6.0
"#;

/// The same with an exit.
fn open() -> String {
    let exit = "[[exit]]\nname = \"sky\"\nwhen = \"x^2 + y^2 + z^2 - 16\"\n[symmetry]";
    CLOSED.replace("[symmetry]", exit)
}

fn place() -> Place {
    Place::with(&[("closed.toml", CLOSED), ("open.toml", &open())])
}

/// What a bake to 0.1 mrad says.
fn baked(place: &Place, arguments: &str) -> Value {
    let line = format!("{arguments} -o b.fan --max-error 0.1 --certify-rays 2000 --json");
    let output = place.bake(&line).success().get_output().stdout.clone();
    serde_json::from_slice(&output).unwrap()
}

fn number(report: &Value, path: &str) -> f64 {
    report.pointer(path).unwrap().as_f64().unwrap()
}

#[test]
fn directions_that_only_shade_are_promised_four_times_as_much_and_cost_less() {
    let place = place();
    let bytes = |report: &Value| number(report, "/bytes");
    let usual = baked(&place, "closed.toml");
    assert_eq!(number(&usual, "/sky_promise"), 0.4);
    assert!(number(&usual, "/sky_mrad/p99") <= 0.4);
    let as_points = baked(&place, "closed.toml --max-sky-error 0.1");
    assert!(number(&as_points, "/sky_mrad/p99") <= 0.1);
    let points_alone = baked(&place, "closed.toml --no-frames");
    assert_eq!(points_alone["sky_promise"], Value::Null);
    let [usual, as_points, points_alone] = [&usual, &as_points, &points_alone].map(bytes);
    println!("{usual} bytes, {as_points} as points, {points_alone} without directions");
    assert!(points_alone <= usual && usual < as_points);
}

#[test]
fn at_exits_directions_are_promised_as_points_are_unless_something_else_is_asked_for() {
    let place = place();
    let usual = baked(&place, "open.toml");
    assert_eq!(number(&usual, "/sky_promise"), 0.1);
    // The same, spelt out, is the same table: its number of eight bytes is all that is added.
    let spelt_out = baked(&place, "open.toml --max-sky-error 0.1");
    assert_eq!(number(&spelt_out, "/bytes"), number(&usual, "/bytes") + 8.0);
    assert_eq!(spelt_out["sky_mrad"], usual["sky_mrad"]);
    let tighter = baked(&place, "open.toml --max-sky-error 0.02");
    assert_eq!(number(&tighter, "/sky_promise"), 0.02);
    assert!(number(&tighter, "/sky_mrad/p99") <= 0.02);
    assert!(number(&tighter, "/screen_mrad/p99") <= 0.1);
}

#[test]
fn info_and_check_say_what_is_promised_of_directions_and_where() {
    let place = place();
    for (file, promise, at) in [("closed", 0.4, "paths"), ("open", 0.1, "exits")] {
        baked(&place, &format!("{file}.toml"));
        let run = |arguments: &str| {
            let mut command = assert_cmd::cargo::cargo_bin_cmd!("geofan");
            command.args(arguments.split(' ')).arg(place.path("b.fan"));
            String::from_utf8(command.assert().success().get_output().stdout.clone()).unwrap()
        };
        let info: Value = serde_json::from_str(&run("info --json")).unwrap();
        assert_eq!(info["sky_promise"], promise);
        assert_eq!(info["sky_promise_at"], at);
        let words = match at {
            "paths" => "of sky errors all along paths within 0.4 mrad",
            _ => "of sky errors at exits within 0.1 mrad",
        };
        for text in [run("info"), run("check --rays 1000")] {
            assert!(text.contains(words), "{text}");
        }
    }
}

#[test]
fn no_directions_cannot_have_a_promise() {
    let place = place();
    let line = "open.toml -o b.fan --no-frames --max-sky-error 1";
    place.bake(line).failure().code(2);
}
