//! Hyperbolic space divided by one screw: its domain reaches the ideal boundary, and most lines of a chart from the centre
//! leave the space before they meet a face.

use geofan_core::{diagnostic::SourceText, manifold::Manifold};
use glam::{DMat4, DVec3, DVec4};

/// The screw along the axis of the hyperboloid's z by this length and turn.
fn screw(length: f64, turn: f64) -> DMat4 {
    let ((s, c), (sh, ch)) = (turn.sin_cos(), (length.sinh(), length.cosh()));
    let rows = [
        [c, -s, 0.0, 0.0],
        [s, c, 0.0, 0.0],
        [0.0, 0.0, ch, sh],
        [0.0, 0.0, sh, ch],
    ];
    DMat4::from_cols_array_2d(&rows).transpose()
}

/// `−⟨a, b⟩` on the hyperboloid.
fn product(a: DVec4, b: DVec4) -> f64 {
    a.w * b.w - a.truncate().dot(b.truncate())
}

/// An orthonormal frame of the hyperboloid at `c`.
fn tangents(c: DVec4) -> [DVec4; 3] {
    let mut frame: Vec<DVec4> = Vec::new();
    for e in [DVec4::X, DVec4::Y, DVec4::Z] {
        let across = e - c * product(e, c);
        let v = frame.iter().fold(across, |v, w| v + *w * product(v, *w));
        frame.push(v / (-product(v, v)).sqrt());
    }
    [frame[0], frame[1], frame[2]]
}

/// How many powers of a screw bound the domain about `c`: the geodesic cosh t c + sinh t v is nearer to c than to its image p
/// up to tanh t = (cosh d(c, p) − 1)/−⟨v, p⟩.
fn faces_by_geodesics(screw: DMat4, c: DVec4) -> usize {
    let frame = tangents(c);
    let powers = |m: DMat4| {
        (0..40).scan(c, move |p, _| {
            *p = m * *p;
            Some(*p)
        })
    };
    let images: Vec<DVec4> = powers(screw).chain(powers(screw.inverse())).collect();
    let mut hits = vec![0; images.len()];
    let count = 40_000;
    for i in 0..count {
        let height = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(count);
        let (s, co) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
        let r = (1.0 - height * height).sqrt();
        let v = frame[0] * (r * co) + frame[1] * (r * s) + frame[2] * height;
        let tanh = |p: &DVec4| (product(c, *p) - 1.0) / -product(v, *p);
        let ends = images.iter().enumerate().map(|(k, p)| (tanh(p), k));
        let ends = ends.filter(|(tanh, _)| *tanh > 0.0 && *tanh < 1.0);
        if let Some((_, k)) = ends.min_by(|a, b| a.0.total_cmp(&b.0)) {
            hits[k] += 1;
        }
    }
    hits.into_iter().filter(|hits| *hits > 0).count()
}

/// A chart of hyperbolic space: metric and domain, lift and drop, and the map of a point to the hyperboloid.
struct Chart {
    head: &'static str,
    model: &'static str,
    lift: fn(DVec3) -> DVec4,
}

const BALL: Chart = Chart {
    head: "metric = { conformal = '2/(1 - r2)' }\ndomain = { inside = ['0.9999 - r2'] }\n",
    model: "lift = ['2*x/(1 - r2)', '2*y/(1 - r2)', '2*z/(1 - r2)', '(1 + r2)/(1 - r2)']\ndrop = ['X/(1 + W)', 'Y/(1 + W)', 'Z/(1 + W)']\n",
    lift: |u| {
        let r2 = u.length_squared();
        (2.0 * u).extend(1.0 + r2) / (1.0 - r2)
    },
};

const HALF_SPACE: Chart = Chart {
    head: "metric = { conformal = '1/z' }\ndomain = { inside = ['z - 1e-5'] }\n",
    model: "lift = ['x/z', 'y/z', '(r2 - 1)/(2*z)', '(r2 + 1)/(2*z)']\ndrop = ['X/(W - Z)', 'Y/(W - Z)', '1/(W - Z)']\n",
    lift: |u| {
        let r2 = u.length_squared();
        DVec4::new(u.x, u.y, 0.5 * (r2 - 1.0), 0.5 * (r2 + 1.0)) / u.z
    },
};

/// The quotient of a chart by a screw, about a centre.
fn quotient(chart: &Chart, screw: DMat4, centre: DVec3) -> Result<Manifold, String> {
    let rows = screw.transpose().to_cols_array_2d();
    let [x, y, z] = centre.to_array();
    let text = format!(
        "name = 'screw'\ncoordinates = ['x', 'y', 'z']\n{}let = {{ r2 = 'x^2 + y^2 + z^2' }}\n[quotient]\n{}centre = [{x:?}, {y:?}, {z:?}]\ngenerators = [{rows:?}]\n",
        chart.head, chart.model
    );
    let source = SourceText::new("screw.toml", text);
    Manifold::from_source(source, &[]).map_err(|e| e.report(false))
}

#[test]
fn hyperbolic_space_is_divided_by_a_screw_about_any_centre() {
    let about_axis = [
        DVec3::ZERO,
        DVec3::new(0.1, 0.2, 0.0),
        DVec3::new(0.5, 0.1, -0.3),
    ];
    let above = [
        DVec3::Z,
        DVec3::new(0.2, 0.4, 1.0),
        DVec3::new(1.5, -0.3, 2.0),
    ];
    for (chart, centres) in [(BALL, about_axis), (HALF_SPACE, above)] {
        for (length, turn) in [(0.8, 0.0), (0.8, 1.1), (2.5, 3.0), (1.5, 0.4)] {
            for centre in centres {
                let screw = screw(length, turn);
                let space = quotient(&chart, screw, centre);
                let space = space.unwrap_or_else(|e| panic!("{length} {turn} {centre}: {e}"));
                let gluing = space.gluing().unwrap();
                let count = faces_by_geodesics(screw, (chart.lift)(centre));
                let found = gluing.faces().len();
                assert_eq!(found, count, "{length} {turn} about {centre}");
                let far = gluing.faces()[0].carry(centre).unwrap().0;
                let (home, _) = gluing.locate(far).unwrap();
                assert!(home.distance(centre) < 1e-9, "{home}, not {centre}");
            }
        }
    }
}
