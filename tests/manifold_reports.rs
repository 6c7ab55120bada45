//! What is said about manifold files that cannot work: the whole report, word for word, so that a
//! change of wording or a span that slips is seen.

use geofan_core::{diagnostic::SourceText, manifold::Manifold};
use insta::assert_snapshot;

/// The report on `text`, with the name and coordinates put before it.
fn report(text: &str) -> String {
    let text = format!("name = \"test\"\ncoordinates = [\"x\", \"y\", \"z\"]\n{text}");
    let error = Manifold::from_source(SourceText::new("m.toml", text), &[]).unwrap_err();
    error.report(false)
}

#[test]
fn a_misspelt_name_is_underlined_with_what_was_meant() {
    let text = r#"metric = { conformal = "1 + alpah*x^2" }
[parameters]
alpha = 0.1"#;
    assert_snapshot!(report(text), @r#"
    error: unknown name `alpah`
     --> m.toml:3:29
      |
    3 | metric = { conformal = "1 + alpah*x^2" }
      |                             ^^^^^
      |
      = help: did you mean `alpha`?
    "#);
}

#[test]
fn a_function_with_too_few_arguments_is_underlined_whole() {
    let text = r#"metric = { conformal = "1 + atan2(x)^2" }"#;
    assert_snapshot!(report(text), @r#"
    error: `atan2` takes 2 arguments, 1 given
     --> m.toml:3:29
      |
    3 | metric = { conformal = "1 + atan2(x)^2" }
      |                             ^^^^^^^^
    "#);
}

#[test]
fn a_missing_bracket_is_shown_where_it_should_be() {
    let text = r#"metric = { conformal = "1/(1 + (x^2 + y^2)" }"#;
    assert_snapshot!(report(text), @r#"
    error: a closing bracket is missing here
     --> m.toml:3:43
      |
    3 | metric = { conformal = "1/(1 + (x^2 + y^2)" }
      |                                           ^
    "#);
}

#[test]
fn a_missing_operator_is_shown_where_it_should_be() {
    let text = r#"metric = { conformal = "1 + 2 x" }"#;
    assert_snapshot!(report(text), @r#"
    error: an operator is missing before this
     --> m.toml:3:31
      |
    3 | metric = { conformal = "1 + 2 x" }
      |                               ^
      |
      = help: products need `*`
    "#);
}

#[test]
fn a_metric_that_is_not_positive_is_shown_with_its_entries() {
    let text = r#"metric = { xx = "1", yy = "1", zz = "-1" }

[cameras]
at = ["0", "0", "0"]"#;
    assert_snapshot!(report(text), @r#"
    error: the metric is not positive definite at x = 0.000000, y = 0.000000, z = 0.000000
     --> m.toml:3:1
      |
    3 | metric = { xx = "1", yy = "1", zz = "-1" }
      | ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^ xx, yy, zz, xy, xz, yz = [1.000, 1.000, -1.000, 0.000, 0.000, 0.000] there
      |
      = help: restrict the region with [domain] or [cameras], or mend the expressions
    "#);
}

#[test]
fn a_metric_that_is_infinite_is_shown_with_the_point() {
    let text = r#"metric = { conformal = "1/x" }
[cameras]
at=["0","0","0"]"#;
    assert_snapshot!(report(text), @r#"
    error: the metric is not finite at x = 0.000000, y = 0.000000, z = 0.000000
     --> m.toml:3:1
      |
    3 | metric = { conformal = "1/x" }
      | ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^ xx, yy, zz, xy, xz, yz = [inf, inf, inf, 0.000, 0.000, 0.000] there
      |
      = help: restrict the region with [domain] or [cameras], or mend the expressions
    "#);
}

#[test]
fn two_definitions_are_one_too_many() {
    let text = r#"embedding = ["x", "y", "z", "x*y"]
metric = { conformal = "1" }"#;
    assert_snapshot!(report(text), @r#"
    error: both `embedding` and `metric` are given
     --> m.toml:4:10
      |
    4 | metric = { conformal = "1" }
      |          ^^^^^^^^^^^^^^^^^^^
      |
      = help: keep exactly one of them
    "#);
}

#[test]
fn a_false_symmetry_is_shown_with_point_and_discrepancy() {
    let text = r#"metric = { conformal = "1 + x^2" }

[symmetry]
rotation = "origin""#;
    assert_snapshot!(report(text), @r#"
    error: this symmetry is not one of the metric: at x = 0.000000, y = -0.333333, z = -0.600000 and its image x = -0.582232, y = 0.363145, z = -0.015597 lengths differ by 7.93e-1
     --> m.toml:6:1
      |
    6 | rotation = "origin"
      | ^^^^^^^^^^^^^^^^^^^ claimed here
      |
      = help: remove the claim, or mend the metric
    "#);
}

#[test]
fn cameras_outside_the_domain_are_shown_with_the_point() {
    let text = r#"metric = { conformal = "1" }

[domain]
x = [-1, 1]

[cameras]
parameters = { c = [0, 3] }
at = ["c", "0", "0"]"#;
    assert_snapshot!(report(text), @r#"
    error: the camera region leaves the domain: x = 1.500000, y = 0.000000, z = 0.000000 is outside a coordinate limit
      --> m.toml:10:1
       |
    10 | at = ["c", "0", "0"]
       | ^^^^^^^^^^^^^^^^^^^^ camera positions
       |
       = help: make the camera region smaller, or the domain larger
    "#);
}

#[test]
fn a_misspelt_key_is_named_and_not_the_absence_of_the_right_one() {
    let text = r#"metirc = { conformal = "1" }"#;
    assert_snapshot!(report(text), @r#"
    error: unknown key `metirc`
     --> m.toml:3:1
      |
    3 | metirc = { conformal = "1" }
      | ^^^^^^
      |
      = help: did you mean `metric`?
    "#);
}

#[test]
fn a_name_declared_twice_says_what_it_was() {
    let text = r#"metric = { conformal = "1" }
[parameters]
r = 1.0
[let]
r = "sqrt(x^2)""#;
    assert_snapshot!(report(text), @r#"
    error: `r` is declared twice: it is already a parameter
     --> m.toml:7:1
      |
    7 | r = "sqrt(x^2)"
      | ^
      |
      = help: a name may be declared once; choose another
    "#);
}

#[test]
fn the_tangent_has_no_place_in_a_metric() {
    let text = r#"metric = { conformal = "1 + w" }
[let]
w = "x*vx""#;
    assert_snapshot!(report(text), @r#"
    error: the tangent may be used only in exits
     --> m.toml:3:29
      |
    3 | metric = { conformal = "1 + w" }
      |                             ^
      |
      = help: metrics, embeddings and domains depend on the point alone
    "#);
}

#[test]
fn a_camera_position_does_not_know_the_coordinates() {
    let text = r#"metric = { conformal = "1" }
[cameras]
parameters = { c = [0, 1] }
at = ["c", "x", "0"]"#;
    assert_snapshot!(report(text), @r#"
    error: unknown name `x`
     --> m.toml:6:13
      |
    6 | at = ["c", "x", "0"]
      |             ^
      |
      = help: `x` is a coordinate; a camera's position uses [parameters] and the camera parameters
    "#);
}

#[test]
fn a_number_in_place_of_an_expression_needs_quotes() {
    let text = r#"metric = { conformal = 1 }"#;
    assert_snapshot!(report(text), @r#"
    error: a string is needed here, this is an integer
     --> m.toml:3:24
      |
    3 | metric = { conformal = 1 }
      |                        ^
      |
      = help: put quotes around it
    "#);
}

#[test]
fn broken_toml_is_shown_where_it_breaks() {
    let text = r#"metric = { conformal = "1"
[domain]
x = [-1, 1]"#;
    assert_snapshot!(report(text), @r#"
    error: missing key for inline table element, expected `,`
     --> m.toml:4:1
      |
    4 | [domain]
      | ^
      |
      = help: the file is TOML: key = value lines and [table] headings
    "#);
}

#[test]
fn glued_limits_must_be_given() {
    let text = r#"metric = { conformal = "1" }
[domain]
periodic = ["x"]"#;
    assert_snapshot!(report(text), @r#"
    error: `x` is periodic but has no limits
     --> m.toml:5:13
      |
    5 | periodic = ["x"]
      |             ^^^
      |
      = help: add `x = [lower, upper]`
    "#);
}
