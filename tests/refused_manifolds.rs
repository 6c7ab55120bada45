//! Manifold files of every kind that cannot work, with the whole of what is said about each: the files
//! in `snapshots/` hold the reports. After a deliberate change of wording:
//! `INSTA_UPDATE=always cargo test --test refused_manifolds`, then read the difference.

use geofan_core::{diagnostic::SourceText, manifold::Manifold};
use insta::{Settings, assert_snapshot};

/// A file of which only this much is written; name, coordinates and flat metric come before it.
const FLAT: &str = "metric = { conformal = \"1\" }\n";

/// The report on a whole file with some parameters set.
fn refusal(text: &str, settings: &[(String, f64)]) -> String {
    match Manifold::from_source(SourceText::new("m.toml", text), settings) {
        Err(error) => error.report(false),
        Ok(_) => panic!("accepted:\n{text}"),
    }
}

/// Compares with `snapshots/refused_manifolds__NAME.snap`.
fn shown(name: &str, reports: String) {
    let mut settings = Settings::clone_current();
    settings.set_omit_expression(true);
    settings.bind(|| assert_snapshot!(name, reports));
}

/// The reports on files that begin with a name and the coordinates x, y, z.
fn refusals(cases: &[(&str, String)]) -> String {
    let report = |(what, text): &(&str, String)| {
        let text = format!("name = \"test\"\ncoordinates = [\"x\", \"y\", \"z\"]\n{text}");
        format!("# {what}\n{}\n", refusal(&text, &[]))
    };
    cases.iter().map(report).collect::<Vec<_>>().join("\n")
}

/// Cases of one expression, the conformal factor.
fn expressions(cases: &[(&'static str, &str)]) -> String {
    let case = |(what, text): &(&'static str, &str)| {
        (
            *what,
            format!("metric = {{ conformal = \"{text}\" }}\n[parameters]\nalpha = 1\n"),
        )
    };
    refusals(&cases.iter().map(case).collect::<Vec<_>>())
}

/// Cases of what follows a flat metric.
fn after_flat(cases: &[(&'static str, &str)]) -> String {
    let case = |(what, text): &(&'static str, &str)| (*what, format!("{FLAT}{text}"));
    refusals(&cases.iter().map(case).collect::<Vec<_>>())
}

#[test]
fn expressions_that_mean_nothing() {
    shown(
        "expressions_that_mean_nothing",
        expressions(&[
            ("a name nobody declared", "1 + q*x"),
            ("a misspelt function", "sqr(x)"),
            ("a function nobody knows", "erf(x)"),
            ("a function without its argument", "sin + x"),
            ("one argument too many", "sin(x, y)"),
            ("no argument", "cos()"),
            ("one argument of two", "max(x)"),
            ("one value of two after a condition", "if(x < 1, 2)"),
            ("if without a comparison", "if(x, 1, 2)"),
            ("a comparison outside if", "1 + (x < 1)"),
            ("two comparisons in one", "if(0 < x < 1, 1, 2)"),
            ("equality", "if(x == 1, 1, 2)"),
            ("an empty expression", ""),
            ("an operand is missing", "1 + "),
            ("two operators", "1 * / x"),
            ("a power in another language", "x**2"),
            ("a product without its sign", "2x + 1"),
            ("a bracket that is not closed", "2*(x + 1"),
            ("a bracket that was not opened", "2*x + 1)"),
            ("square brackets", "[x + 1]"),
            ("a comma outside a call", "x, y"),
            ("a strange character", "x § y"),
            ("a number with two points", "1.2.3"),
            ("a number that is too large", "1e999"),
            ("a lonely point", ". + 1"),
            ("a parameter used as a function", "alpha(x)"),
            ("the tangent", "1 + vx^2"),
        ]),
    );
}

#[test]
fn expressions_nested_too_deeply() {
    let deep = format!("{}x{}", "(".repeat(300), ")".repeat(300));
    let text = format!(
        "name = \"t\"\ncoordinates = [\"x\", \"y\", \"z\"]\nmetric = {{ conformal = \"{deep}\" }}\n"
    );
    let report = refusal(&text, &[]);
    assert!(report.contains("nested more than 200 deep"), "{report}");
    assert!(report.contains("name parts of it in [let]"), "{report}");
}

#[test]
fn names_that_cannot_be() {
    let flat = |text: &str| format!("{FLAT}{text}");
    shown(
        "names_that_cannot_be",
        refusals(&[
            (
                "a parameter called as a coordinate",
                flat("[parameters]\nx = 1.0\n"),
            ),
            (
                "a let called as a parameter",
                flat("[parameters]\na = 1.0\n[let]\na = \"2\"\n"),
            ),
            (
                "a let called as a component of the tangent",
                flat("[let]\nvy = \"2\"\n"),
            ),
            ("a let called as a function", flat("[let]\nsin = \"2\"\n")),
            (
                "a name with a sign in it",
                flat("[let]\nr-squared = \"x^2\"\n"),
            ),
            (
                "a name that begins with a digit",
                flat("[parameters]\n2a = 1.0\n"),
            ),
            ("a let that names itself", flat("[let]\na = \"a + 1\"\n")),
            (
                "a let that names one below it",
                flat("[let]\na = \"b + 1\"\nb = \"x\"\n"),
            ),
            (
                "a key given twice",
                flat("[parameters]\na = 1.0\na = 2.0\n"),
            ),
            (
                "a parameter that is an expression",
                flat("[parameters]\na = \"1/2\"\n"),
            ),
            (
                "a parameter that is infinite",
                flat("[parameters]\na = inf\n"),
            ),
            ("a let that is a number", flat("[let]\na = 3\n")),
            ("a section that is a number", flat("let = 3\n")),
        ]),
    );
}

#[test]
fn files_without_what_they_need() {
    let reports = [
        ("an empty file", ""),
        (
            "no name",
            "coordinates = [\"x\", \"y\", \"z\"]\nmetric = { conformal = \"1\" }\n",
        ),
        ("a name that is a number", "name = 3\n"),
        (
            "no coordinates",
            "name = \"t\"\nmetric = { conformal = \"1\" }\n",
        ),
        (
            "two coordinates",
            "name = \"t\"\ncoordinates = [\"x\", \"y\"]\n",
        ),
        (
            "a coordinate twice",
            "name = \"t\"\ncoordinates = [\"x\", \"y\", \"x\"]\n",
        ),
        (
            "a coordinate that is another's tangent",
            "name = \"t\"\ncoordinates = [\"x\", \"vx\", \"z\"]\n",
        ),
        (
            "a coordinate that is a number",
            "name = \"t\"\ncoordinates = [\"x\", 2, \"z\"]\n",
        ),
        (
            "neither embedding nor metric",
            "name = \"t\"\ncoordinates = [\"x\", \"y\", \"z\"]\n",
        ),
        ("an unknown section", "name = \"t\"\n[camera]\nlength = 3\n"),
        ("no TOML", "name: test\n"),
        ("a string without its end", "name = \"test\n"),
    ]
    .map(|(what, text)| format!("# {what}\n{}\n", refusal(text, &[])));
    shown("files_without_what_they_need", reports.join("\n"));
}

#[test]
fn metrics_and_embeddings_that_are_none() {
    let case = |what: &'static str, text: &str| (what, format!("{text}\n"));
    let seventeen = vec!["\"x\""; 17].join(", ");
    shown(
        "metrics_and_embeddings_that_are_none",
        refusals(&[
            case("two components", "embedding = [\"x\", \"y\"]"),
            case(
                "seventeen components",
                &format!("embedding = [{seventeen}]"),
            ),
            case("an embedding that is a string", "embedding = \"x\""),
            case(
                "a component that is a number",
                "embedding = [\"x\", \"y\", 3, \"z\"]",
            ),
            case("a metric that is a string", "metric = \"1\""),
            case("a metric without entries", "metric = {}"),
            case("a metric without yy", "metric = { xx = \"1\", zz = \"1\" }"),
            case(
                "an entry nobody knows",
                "metric = { xx = \"1\", yy = \"1\", zz = \"1\", tt = \"1\" }",
            ),
            case(
                "conformal and an entry",
                "metric = { conformal = \"1\", xx = \"1\" }",
            ),
            case(
                "an entry twice",
                "metric = { xx = \"1\", yy = \"1\", zz = \"1\", xy = \"0.1\", yx = \"0.1\" }",
            ),
            case(
                "not positive off the diagonal",
                "metric = { xx = \"1\", yy = \"1\", zz = \"1\", xy = \"2\" }",
            ),
            case("zero", "metric = { conformal = \"x - x\" }"),
            case("not a number", "metric = { conformal = \"sqrt(x - 9)\" }"),
            case(
                "an embedding that is flattened",
                "embedding = [\"x\", \"y\", \"x + y\"]",
            ),
            case(
                "an embedding of two variables",
                "embedding = [\"x\", \"y\", \"x*y\", \"x^2\"]",
            ),
        ]),
    );
}

#[test]
fn domains_that_cannot_be() {
    let glued = |metric: &str| {
        format!(
            "metric = {{ conformal = \"{metric}\" }}\n[domain]\nx = [0, 2]\nperiodic = [\"x\"]\n"
        )
    };
    let mut reports = after_flat(&[
        ("limits the wrong way round", "[domain]\nx = [1, -1]\n"),
        ("limits that are equal", "[domain]\nx = [1, 1]\n"),
        ("one limit", "[domain]\nx = [1]\n"),
        ("limits that are not finite", "[domain]\nx = [0, inf]\n"),
        ("limits that are strings", "[domain]\nx = [\"0\", \"pi\"]\n"),
        ("a coordinate nobody knows", "[domain]\nw = [0, 1]\n"),
        ("glued without limits", "[domain]\nperiodic = [\"y\"]\n"),
        (
            "glued and unknown",
            "[domain]\nx = [0, 1]\nperiodic = [\"w\"]\n",
        ),
        ("a condition that is no list", "[domain]\ninside = \"x\"\n"),
        (
            "a condition with the tangent",
            "[domain]\ninside = [\"1 - vx\"]\n",
        ),
        (
            "a condition that does not parse",
            "[domain]\ninside = [\"1 -\"]\n",
        ),
        (
            "a condition that never holds",
            "[domain]\ninside = [\"-1 - x^2\"]\n[cameras]\nat = [\"0\", \"0\", \"0\"]\n",
        ),
    ]);
    reports += "\n";
    let seam = |medium: &str| format!("{medium}\n{}", glued("1"));
    reports += &refusals(&[
        (
            "values that do not meet where they are glued",
            glued("1 + x"),
        ),
        (
            "a wind that does not",
            seam("wind = [\"0\", \"0.2*x\", \"0\"]"),
        ),
        (
            "a drift that does not",
            seam("drift = [\"0\", \"0.2*x^2\", \"0\"]"),
        ),
        ("a lapse that does not", seam("lapse = \"2 + x\"")),
        (
            "a claim inside of an inline table",
            "symmetry = { rotation = \"origin\" }\nmetric = { conformal = \"1 + 0.1*x\" }\n".into(),
        ),
    ]);
    shown("domains_that_cannot_be", reports);
}

#[test]
fn exits_that_lead_nowhere() {
    shown(
        "exits_that_lead_nowhere",
        after_flat(&[
            (
                "one exit in single brackets",
                "[exit]\nname = \"a\"\nwhen = \"x\"\n",
            ),
            ("an exit without a name", "[[exit]]\nwhen = \"x - 1\"\n"),
            ("an exit without a condition", "[[exit]]\nname = \"a\"\n"),
            (
                "two exits of one name",
                "[[exit]]\nname = \"a\"\nwhen = \"x\"\n[[exit]]\nname = \"a\"\nwhen = \"y\"\n",
            ),
            (
                "an exit called limit",
                "[[exit]]\nname = \"limit\"\nwhen = \"x\"\n",
            ),
            (
                "an exit called inside",
                "[[exit]]\nname = \"inside\"\nwhen = \"x\"\n",
            ),
            (
                "an exit called length",
                "[[exit]]\nname = \"length\"\nwhen = \"x\"\n",
            ),
            (
                "a direction of two components",
                "[[exit]]\nname = \"a\"\nwhen = \"x\"\ndirection = [\"vx\", \"vy\"]\n",
            ),
            (
                "a direction that is a string",
                "[[exit]]\nname = \"a\"\nwhen = \"x\"\ndirection = \"vx\"\n",
            ),
            (
                "a direction of a name nobody declared",
                "[[exit]]\nname = \"a\"\nwhen = \"x\"\ndirection = [\"vx\", \"vy\", \"vw\"]\n",
            ),
            (
                "a misspelt key",
                "[[exit]]\nname = \"a\"\nwhen = \"x\"\ndirektion = [\"vx\", \"vy\", \"vz\"]\n",
            ),
            (
                "a condition that is a comparison",
                "[[exit]]\nname = \"a\"\nwhen = \"x > 1\"\n",
            ),
        ]),
    );
}

#[test]
fn symmetries_that_are_none() {
    let lens = |claim: &str| {
        format!("metric = {{ conformal = \"1 + exp(-x^2 - 2*y^2)\" }}\n[symmetry]\n{claim}\n")
    };
    shown(
        "symmetries_that_are_none",
        refusals(&[
            ("rotations", lens("rotation = \"origin\"")),
            (
                "rotations about something else",
                lens("rotation = \"centre\""),
            ),
            ("translations", lens("translation = [\"y\"]")),
            ("translations along nothing", lens("translation = [\"w\"]")),
            (
                "translations that are a string",
                lens("translation = \"z\""),
            ),
            (
                "a group that is not one of isometries",
                lens("group = [\"x + px\", \"y + py\", \"z + pz\"]"),
            ),
            (
                "a group of two components",
                lens("group = [\"x + px\", \"y + py\"]"),
            ),
            (
                "a group of names nobody declared",
                lens("group = [\"x + qx\", \"y + py\", \"z + pz\"]"),
            ),
            (
                "a group whose identity is elsewhere",
                format!("{FLAT}[symmetry]\ngroup = [\"x + px + 1\", \"y + py\", \"z + pz\"]\n"),
            ),
            (
                "a group that brings 0 elsewhere",
                format!("{FLAT}[symmetry]\ngroup = [\"x + px\", \"y + py\", \"z + 2*pz\"]\n"),
            ),
            ("a symmetry nobody knows", lens("reflection = \"x\"")),
        ]),
    );
}

#[test]
fn cameras_that_cannot_be() {
    shown(
        "cameras_that_cannot_be",
        after_flat(&[
            (
                "four parameters",
                "[cameras]\nparameters = { a = [0, 1], b = [0, 1], c = [0, 1], d = [0, 1] }\nat = [\"a\", \"b\", \"c\"]\n",
            ),
            (
                "an interval the wrong way round",
                "[cameras]\nparameters = { c = [1, 0] }\nat = [\"c\", \"0\", \"0\"]\n",
            ),
            (
                "an interval of three",
                "[cameras]\nparameters = { c = [1, 2, 3] }\nat = [\"c\", \"0\", \"0\"]\n",
            ),
            (
                "parameters without a place",
                "[cameras]\nparameters = { c = [0, 1] }\n",
            ),
            (
                "a parameter called as a coordinate",
                "[cameras]\nparameters = { x = [0, 1] }\nat = [\"x\", \"0\", \"0\"]\n",
            ),
            (
                "a place of two coordinates",
                "[cameras]\nat = [\"0\", \"0\"]\n",
            ),
            ("a place that is numbers", "[cameras]\nat = [0, 0, 0]\n"),
            (
                "a place of a name nobody declared",
                "[cameras]\nat = [\"d\", \"0\", \"0\"]\n",
            ),
            (
                "a place that is not finite",
                "[cameras]\nat = [\"1/0\", \"0\", \"0\"]\n",
            ),
            (
                "a place outside the limits",
                "[domain]\nx = [-1, 1]\n[cameras]\nat = [\"2\", \"0\", \"0\"]\n",
            ),
            (
                "a place that violates a condition",
                "[domain]\ninside = [\"1 - y^2\"]\n[cameras]\nparameters = { c = [0, 3] }\nat = [\"0\", \"c\", \"0\"]\n",
            ),
            ("a length of nothing", "[cameras]\nlength = 0\n"),
            ("a length below nothing", "[cameras]\nlength = -2.5\n"),
            ("a length that is not finite", "[cameras]\nlength = inf\n"),
            ("a length that is a string", "[cameras]\nlength = \"3\"\n"),
            ("a misspelt key", "[cameras]\nlenght = 3\n"),
        ]),
    );
}

#[test]
fn parameters_that_cannot_be_set() {
    let one = "name = \"t\"\ncoordinates = [\"x\", \"y\", \"z\"]\nmetric = { conformal = \"alpha\" }\n\
        [parameters]\nalpha = 1\n";
    let none =
        "name = \"t\"\ncoordinates = [\"x\", \"y\", \"z\"]\nmetric = { conformal = \"1\" }\n";
    let cases = [
        (one, "alpah", 2.0),
        (one, "beta", 2.0),
        (one, "alpha", f64::NAN),
        (one, "alpha", 0.0),
        (none, "alpha", 2.0),
        (none, "x", 2.0),
    ];
    let reports = cases.map(|(text, name, value)| {
        let report = refusal(text, &[(name.to_string(), value)]);
        format!("# {name} = {value}\n{report}\n")
    });
    shown("parameters_that_cannot_be_set", reports.join("\n"));
}

#[test]
fn files_that_are_no_text() {
    let folder = tempfile::TempDir::new().unwrap();
    let file = folder.path().join("m.toml");
    let said = |path: &std::path::Path| {
        let report = Manifold::load(path, &[]).unwrap_err().report(false);
        report.replace(&path.display().to_string(), "m.toml")
    };
    let mut reports = vec![format!("# no file\n{}\n", said(&file))];
    reports.push(format!("# a folder\n{}\n", said(folder.path())));
    std::fs::write(&file, [b'n', b'a', 0xff, 0xfe, b'=']).unwrap();
    reports.push(format!("# not UTF-8\n{}\n", said(&file)));
    std::fs::write(&file, b"name = \"a\0b\"\n").unwrap();
    reports.push(format!("# a zero byte\n{}\n", said(&file)));
    shown("files_that_are_no_text", reports.join("\n"));
}

#[test]
fn space_may_end_anywhere_but_at_the_one_place_of_a_camera() {
    // Neither is a metric on the whole of the box about the origin: the one ends at an exit, the other nowhere.
    let bodies = [
        "metric = { conformal = \"(1 + 0.5/r)^3/(1 - 0.5/r)\" }\n[let]\nr = \"sqrt(x^2 + y^2 + z^2)\"\n[[exit]]\nname = \"horizon\"\nwhen = \"0.51 - r\"\n",
        "metric = { conformal = \"sqrt(x^2 - 0.3)\" }\n",
    ];
    for body in bodies {
        let file = |at: &str| {
            format!(
                "name = \"test\"\ncoordinates = [\"x\", \"y\", \"z\"]\n{body}[cameras]\nat = {at}\nlength = 5\n"
            )
        };
        let good = SourceText::new("m.toml", file("[\"6\", \"1\", \"2\"]"));
        if let Err(error) = Manifold::from_source(good, &[]) {
            panic!("{}", error.report(false));
        }
        refusal(&file("[\"0.2\", \"0.1\", \"0\"]"), &[]);
    }
}
