//! Names that a file uses in two senses, or where they are not known: the complaint says which.

use geofan_core::{diagnostic::SourceText, manifold::Manifold};

/// What is said about a file; `None` if it is accepted.
fn refusal(text: &str) -> Option<String> {
    let text = format!("name = 'test'\n{text}");
    let read = Manifold::from_source(SourceText::new("test.toml", text), &[]);
    read.err().map(|error| error.report(false))
}

#[test]
fn a_key_that_means_two_entries_of_the_metric_is_refused() {
    for (text, said) in [
        (
            "coordinates = ['a', 'aa', 'aaa']\nmetric = { aa = '1', aaaa = '0.5', aaaaaa = '1' }\n",
            [
                "`aaaa` means the entry of `aa` and `aa` and that of `a` and `aaa`",
                "write `yy` or `xz`",
            ],
        ),
        (
            "coordinates = ['x', 'xx', 'xxx']\nmetric = { xx = '1', xxxx = '0.5', xxxxxx = '1' }\n",
            [
                "`xxxx` means the entry of `xx` and `xx` and that of `x` and `xxx`",
                "call the coordinates otherwise",
            ],
        ),
        (
            "coordinates = ['r', 'tr', 'rr']\nspacetime = { tt = '-1', rr = '1', trtr = '1', rrrr = '1', trr = '0.3' }\n",
            [
                "`trr` means the entry of `r` and `tr` and that of `t` and `rr`",
                "write `rtr` or `rrt`",
            ],
        ),
    ] {
        let report = refusal(text).expect("ambiguous");
        assert!(said.iter().all(|said| report.contains(said)), "{report}");
    }
    // The other order of the names has one meaning, and without time there is no entry of t and rr.
    for text in [
        "coordinates = ['r', 'tr', 'rr']\nspacetime = { tt = '-1', rr = '1', trtr = '1', rrrr = '1', rrt = '0.3' }\n",
        "coordinates = ['r', 'tr', 'rr']\nmetric = { rr = '1', trtr = '1', rrrr = '1', trr = '0.3' }\n",
        "coordinates = ['r', 'th', 'ph']\nmetric = { xx = '1', thth = '1 + r^2', phph = '1', xz = '0.1' }\n",
    ] {
        assert_eq!(refusal(text), None, "{text}");
    }
}

#[test]
fn a_let_in_a_pulled_back_coordinate_is_told_from_a_name_that_nobody_declares() {
    let text = |r: &str| {
        format!(
            "coordinates = ['x', 'y', 'z']\npullback = {{ s = 'sqrt({r} + z)', u = 'sqrt({r} - z)', p = 'atan2(y, x)' }}\n\
             metric = {{ ss = 's^2 + u^2', uu = 's^2 + u^2', pp = 's^2*u^2' }}\nlet = {{ r = 'sqrt(x^2 + y^2 + z^2)' }}\n\
             cameras = {{ at = ['1', '0', '0'] }}\n"
        )
    };
    let report = refusal(&text("r")).expect("a let");
    assert!(report.contains("unknown name `r`"), "{report}");
    assert!(report.contains("`r` is a let; here"), "{report}");
    assert!(!report.contains("declare it"), "{report}");
    let report = refusal(&text("q")).expect("nobody's");
    assert!(report.contains("declare it under [parameters]"), "{report}");
    assert_eq!(refusal(&text("sqrt(x^2 + y^2 + z^2)")), None);
}
