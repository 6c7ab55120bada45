//! Light around a rotating black hole, in both charts of the catalogue, against quadratures in Boyer and
//! Lindquist's coordinates: lines of sight, deflections, shadows, dragging, and what is conserved.

mod support;

use geofan_core::{
    diagnostic::SourceText,
    geodesic::{End, Path, Ray, Settings, Step, paths, signed_area},
    manifold::Manifold,
    random::Stream,
};
use glam::DVec3;
use std::f64::consts::PI;
use support::{catalogue_text, settings};

/// A file of the catalogue with this angular momentum, and its sky at `far` M.
fn hole(name: &str, a: f64, far: f64) -> Manifold {
    edited(name, a, &[("r - 45*M", &format!("r - {far:?}*M"))])
}

/// A file of the catalogue with the second text of each pair for the first.
fn edited(name: &str, a: f64, edits: &[(&str, &str)]) -> Manifold {
    let text = edits.iter().fold(catalogue_text(name), |text, (old, new)| {
        text.replace(old, new)
    });
    Manifold::from_source(SourceText::new(name, text), &[("a".into(), a)]).unwrap()
}

fn path(manifold: &Manifold, u: DVec3, d: DVec3, length: f64, events: bool) -> Path {
    let ray = Ray::new(manifold, u, d.normalize(), length);
    paths(manifold, settings(1e-13, events), [ray]).remove(0)
}

fn last(path: &Path) -> &Step {
    path.steps.last().unwrap()
}

fn end(path: &Path) -> DVec3 {
    last(path).position(path.length)
}

/// Boyer and Lindquist's radius.
fn radius(u: DVec3, a: f64) -> f64 {
    let b = u.length_squared() - a * a;
    (0.5 * (b + (b * b + 4.0 * a * a * u.z * u.z).sqrt())).sqrt()
}

/// Energy 1's angular momentum about z, of light seen at `u` in the direction `n` (chart components).
fn momentum(manifold: &Manifold, u: DVec3, n: DVec3) -> f64 {
    let turn = DVec3::new(-u.y, u.x, 0.0);
    n.dot(manifold.metric(u) * turn) / manifold.share(u, n)
}

/// The inward direction in the equator at (x, 0, 0) with this angular momentum, in the standard frame.
fn inward(manifold: &Manifold, u: DVec3, b: f64) -> DVec3 {
    let direction = |angle: f64| DVec3::new(-f64::cos(angle), f64::sin(angle), 0.0);
    let of = |angle: f64| momentum(manifold, u, manifold.standard_frame(u) * direction(angle));
    let (mut low, mut high) = (-0.5 * PI, 0.5 * PI);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if of(middle) < b {
            low = middle;
        } else {
            high = middle;
        }
    }
    direction(0.5 * (low + high))
}

/// The angle about z that `path` sweeps.
fn swept(path: &Path) -> f64 {
    let mut sum = 0.0;
    for step in &path.steps {
        for k in 0..8 {
            let at = |k: f64| step.position(step.start + (step.end - step.start) * k / 8.0);
            let (a, b) = (
                at(f64::from(k)).truncate(),
                at(f64::from(k) + 1.0).truncate(),
            );
            sum += a.perp_dot(b).atan2(a.dot(b));
        }
    }
    sum
}

#[track_caller]
fn assert_near(found: DVec3, expected: DVec3, within: f64) {
    let off = (found - expected).length();
    assert!(off < within, "{found} is {off:.1e} from {expected}");
}

/// Angular momentum, start, direction, length, end, area.
type Sight = (f64, [f64; 3], [f64; 3], f64, [f64; 3], Option<f64>);

#[test]
fn lines_of_sight_end_where_null_geodesics_of_spacetime_do() {
    let ingoing: [Sight; 5] = [
        (
            0.9,
            [10.0, 0.0, 0.0],
            [-0.95, -0.2, 0.1],
            30.0,
            [-0.23741810473, 1.81191855534, 0.61057051529],
            Some(332.76502),
        ),
        (
            0.9,
            [10.0, 0.0, 0.0],
            [-0.97, -0.24, 0.03],
            40.0,
            [0.86382856134, -4.94890301191, -0.52691191678],
            Some(15195.262),
        ),
        (
            0.9,
            [6.0, 0.0, 8.0],
            [-0.6, -0.35, -0.8],
            40.0,
            [4.88322178022, 13.28416585474, -2.74276763419],
            Some(15457.354),
        ),
        (
            0.9,
            [1.2, 0.9, 0.4],
            [0.3, 0.5, 0.2],
            5.0,
            [4.50411618821, 4.10293177555, 2.31816846697],
            Some(22.011573),
        ),
        (
            0.999,
            [10.0, 0.0, 0.0],
            [-0.985, -0.185, 0.0],
            40.0,
            [-0.92899151254, -1.35626617049, 0.0],
            Some(323.87803),
        ),
    ];
    let outgoing: [Sight; 2] = [
        (
            0.9,
            [10.0, 0.0, 0.0],
            [-0.9, -0.4, 0.03],
            40.0,
            [0.94329053752, 13.83933614900, -0.86032587399],
            None,
        ),
        (
            0.999,
            [10.0, 0.0, 0.0],
            [-0.8, -0.5, 0.1],
            40.0,
            [-16.59990335584, 7.74023424967, -0.63909477420],
            None,
        ),
    ];
    let all = ingoing.map(|sight| ("kerr-ingoing", sight)).into_iter();
    for (name, (a, u, d, s, to, area)) in all.chain(outgoing.map(|sight| ("kerr", sight))) {
        let hole = hole(name, a, 45.0);
        let found = path(&hole, u.into(), d.into(), s, false);
        assert_near(end(&found), to.into(), 1e-9);
        let Some(area) = area else { continue };
        let columns = last(&found).deviation(s).unwrap();
        let own = signed_area(
            &hole.local_frame(end(&found)),
            last(&found).tangent(s),
            columns,
        );
        assert!((own.abs() / area - 1.0).abs() < 1e-6, "{own} {area}");
    }
}

/// What a ray in the equator with angular momentum `b` sweeps from radius `from` to infinity.
fn beyond(a: f64, b: f64, from: f64) -> f64 {
    // dφ/dr = (b - a + a T/Δ)/√(T² - Δ (b - a)²), T = r² + a² - a b; in u = 1/r, by Simpson's rule.
    let rate = |u: f64| {
        let (t, delta) = (1.0 + (a * a - a * b) * u * u, 1.0 - 2.0 * u + a * a * u * u);
        ((b - a) + a * t / delta) / (t * t - delta * (b - a) * (b - a) * u * u).sqrt()
    };
    let n = 2000;
    let h = 1.0 / from / f64::from(n);
    let sum: f64 = (0..n)
        .map(|k| {
            let u = h * f64::from(k);
            rate(u) + 4.0 * rate(u + 0.5 * h) + rate(u + h)
        })
        .sum();
    sum * h / 6.0
}

#[test]
fn light_is_deflected_by_elliptic_integrals_of_the_third_kind() {
    for (a, table) in [
        (
            0.9,
            [
                (3.0, 6.12039098739192),
                (6.0, 1.026210238700829),
                (10.0, 0.5046329840006724),
                (20.0, 0.2229374890909269),
                (-7.0, 2.588830366514554),
                (-10.0, 0.7205036139539613),
                (-20.0, 0.251128295437648),
            ],
        ),
        (
            0.999,
            [
                (3.0, 3.869244153816859),
                (6.0, 0.9883752925570645),
                (10.0, 0.4968832553613356),
                (20.0, 0.2215807949677523),
                (-7.0, 6.056365296578084),
                (-10.0, 0.7393004278044741),
                (-20.0, 0.252903734033742),
            ],
        ),
    ] {
        let hole = hole("kerr-ingoing", a, 50.0)
            .forward()
            .unwrap()
            .into_owned();
        for (b, deflection) in table {
            let found = passing(&hole, a, b);
            let all = swept(&found).abs() + 2.0 * beyond(a, b, 50.0).abs();
            let off = all - PI - deflection;
            assert!(off.abs() < 1e-9, "a = {a}, b = {b}: off by {off:.1e}");
        }
    }
}

/// Light in the equator from r = 50 past the hole and back.
fn passing(hole: &Manifold, a: f64, b: f64) -> Path {
    let u = DVec3::X * (2500.0 + a * a).sqrt();
    let found = path(hole, u, inward(hole, u, b), 400.0, true);
    assert_eq!(found.end.name(hole), "sky");
    found
}

#[test]
fn from_fifty_and_back_light_sweeps_the_angle_and_takes_the_time_of_quadratures() {
    for (a, b, angle, time) in [
        (0.9, 3.0, 9.14119218786248, 135.28692735813),
        (0.9, 4.0, 5.15900078831676, 122.10858812286),
        (0.9, 6.0, 3.92653350221548, 116.23834863557),
        (0.9, 10.0, 3.24289920270592, 111.01304323819),
        (0.9, -7.0, 5.45032568334834, 129.90435231237),
        (0.9, -10.0, 3.46029366334023, 114.39498000885),
        (0.999, 2.2, 22.5511305755273, 165.0885717083),
        (0.999, 6.0, 3.88862573835264, 115.89089630215),
    ] {
        for name in ["kerr", "kerr-ingoing"] {
            let hole = hole(name, a, 50.0).forward().unwrap().into_owned();
            let found = passing(&hole, a, b);
            let (off, late) = (swept(&found).abs() - angle, found.length - time);
            // Inside the ergosphere the other integrator agreed to 4e-10.
            let within = if b == 2.2 { 5e-9 } else { 1e-9 };
            assert!(
                off.abs() < within,
                "{name} a = {a}, b = {b}: angle off by {off:.1e}"
            );
            assert!(
                late.abs() < 10.0 * within,
                "{name} a = {a}, b = {b}: time off by {late:.1e}"
            );
        }
    }
}

/// The direction of the edge of the shadow on the arc from the middle of the shadow through `d`.
fn edge(hole: &Manifold, u: DVec3, d: DVec3) -> DVec3 {
    // The faster the hole turns, the longer light stays near its innermost orbit.
    let length = if hole.parameters[1].1 > 0.99 {
        2000.0
    } else {
        300.0
    };
    let sky = End::Exit(hole.exit_named("sky").unwrap());
    let d = d.normalize();
    let centre = hole.local_frame(u).frame.inverse() * -u;
    let centre = centre.normalize();
    let aside = d.reject_from(centre).normalize();
    let at = |angle: f64| centre * angle.cos() + aside * angle.sin();
    let settings = Settings::bare(1e-12).with_events();
    let known = aside.dot(d).atan2(centre.dot(d));
    let (mut low, mut high) = (known - 1e-4, known + 1e-4);
    // As many rays as the integrator has lanes, then the interval between two of them.
    while high - low > 2e-11 {
        let width = (high - low) / 31.0;
        let angle = |k: u32| low + width * f64::from(k);
        let rays = (0..32).map(|k| Ray::new(hole, u, at(angle(k)), length));
        let ends: Vec<End> = paths(hole, settings, rays).iter().map(|p| p.end).collect();
        let first = ends.iter().position(|end| *end == sky).unwrap_or(0);
        assert!(first > 0, "{u} {d}: the edge is not near");
        (low, high) = (angle(first as u32 - 1), angle(first as u32));
    }
    at(0.5 * (low + high))
}

/// A hole for cameras that need not see what is behind its horizon: rays end half way from the innermost
/// orbit of light to it, instead of circling above it for ever.
fn opaque(name: &str, a: f64) -> Manifold {
    let orbit = 2.0 * (1.0 + (2.0 / 3.0 * f64::acos(-a)).cos());
    let end = 0.5 * (orbit + 1.0 + (1.0 - a * a).sqrt());
    let end = format!("r - {end:?}");
    edited(
        name,
        a,
        &[("r - 0.2*M", &end), ("r = [1.0, 12.0]", "r = [5.0, 12.0]")],
    )
}

/// Angular momentum, point, and the edge's direction; a z component stands for both signs.
type Edge = (f64, [f64; 3], [f64; 3]);

const OUTSIDE: [f64; 3] = [10.0, 0.0, 0.0];
const ABOVE: [f64; 3] = [6.0, 0.0, 8.0];

#[test]
fn the_shadow_has_the_edge_that_bardeen_found() {
    let ingoing: [Edge; 9] = [
        (0.9, OUTSIDE, [-0.974176003292, -0.225789978985, 0.0]),
        (
            0.9,
            OUTSIDE,
            [-0.949025425724, -0.115006969582, 0.293469143653],
        ),
        (
            0.9,
            OUTSIDE,
            [-0.925499802903, 0.034119554190, -0.377208126701],
        ),
        (
            0.9,
            OUTSIDE,
            [-0.898954863981, 0.236547267619, 0.368680814129],
        ),
        (0.9, OUTSIDE, [-0.868674535919, 0.495383236137, 0.0]),
        (
            0.9,
            ABOVE,
            [-0.606484494635, -0.273198141748, -0.746685565090],
        ),
        (
            0.9,
            ABOVE,
            [-0.565633112173, 0.449999405000, -0.691056957069],
        ),
        (0.999, OUTSIDE, [-0.985330575021, -0.170656549622, 0.0]),
        (0.999, OUTSIDE, [-0.862375427690, 0.506269317375, 0.0]),
    ];
    let outgoing: [Edge; 7] = [
        (0.9, OUTSIDE, [-0.955630053309, -0.294569518471, 0.0]),
        (
            0.9,
            OUTSIDE,
            [-0.837252711909, 0.084395119549, 0.540264157794],
        ),
        (0.9, OUTSIDE, [-0.699673821511, 0.714462415731, 0.0]),
        (
            0.9,
            ABOVE,
            [-0.582789809795, -0.390639637492, -0.712570495613],
        ),
        (
            0.9,
            ABOVE,
            [-0.483501652603, 0.638806096213, -0.598458790035],
        ),
        (0.999, OUTSIDE, [-0.977818636528, -0.209453369654, 0.0]),
        (0.999, OUTSIDE, [-0.684120344711, 0.729369147930, 0.0]),
    ];
    let all = ingoing.map(|edge| ("kerr-ingoing", edge)).into_iter();
    for (name, (a, u, d)) in all.chain(outgoing.map(|edge| ("kerr", edge))) {
        let (u, d) = (DVec3::from(u), DVec3::from(d));
        let found = edge(&opaque(name, a), u, d);
        let off = (found - d.normalize()).length();
        assert!(off < 1e-9, "{name} a = {a} {d}: off by {off:.1e}");
    }
}

#[test]
fn on_the_axis_the_shadow_is_a_circle() {
    for (a, r, degrees) in [(0.9, 10.0, 21.385503621070), (0.999, 6.0, 29.707286288865)] {
        let hole = opaque("kerr-ingoing", a);
        for azimuth in [0.0_f64, 1.0, 2.5] {
            let (sin, cos) = f64::to_radians(degrees).sin_cos();
            let d = DVec3::new(sin * azimuth.cos(), sin * azimuth.sin(), -cos);
            let off = (edge(&hole, DVec3::Z * r, d) - d).length();
            assert!(off < 1e-9, "a = {a}: off by {off:.1e}");
        }
    }
}

#[test]
fn space_drags_light_that_has_no_angular_momentum() {
    for (a, expected) in [(0.9, 0.165401643167054), (0.999, 0.178015520030381)] {
        let hole = hole("kerr-ingoing", a, 45.0)
            .forward()
            .unwrap()
            .into_owned();
        let u = DVec3::X * (400.0 + a * a).sqrt();
        let fall = path(&hole, u, inward(&hole, u, 0.0), 19.0, false);
        // Where it is at r = 3.
        let r = |s: f64| radius(fall.step_at(s).unwrap().position(s), a);
        let (mut low, mut high) = (0.0, 19.0);
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if r(middle) > 3.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        let at = fall.step_at(low).unwrap().position(low);
        // In this chart (x + iy) = (r + ia) e^iφ, and φ differs from Boyer and Lindquist's by ∫ a/Δ dr.
        let phi = |u: DVec3, r: f64| u.y.atan2(u.x) - f64::atan2(a, r);
        let [inner, outer] = [-1.0, 1.0].map(|sign| 1.0 + sign * (1.0 - a * a).sqrt());
        let shift = |r: f64| a / (outer - inner) * ((r - outer) / (r - inner)).ln();
        let found = phi(at, 3.0) - phi(u, 20.0) + shift(20.0) - shift(3.0);
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }
}

#[test]
fn matter_in_orbit_sees_the_frequency_of_textbooks() {
    // Ω = 1/(r^(3/2) + a); light with ξ = L/E is seen with U^t (1 - Ω ξ).
    let (r, a, xi) = (6.0, 0.9, 2.3);
    let omega = 1.0 / (f64::powf(r, 1.5) + a);
    for name in ["kerr", "kerr-ingoing"] {
        let sight = hole(name, a, 45.0);
        let light = sight.forward().unwrap();
        let u = DVec3::X * (r * r + a * a).sqrt();
        let u = glam::DMat3::from_rotation_z(0.8) * u;
        let velocity = omega * DVec3::new(-u.y, u.x, 0.0);
        // Directions with this angular momentum lie on a cone; lines of sight see it turned round.
        for (space, xi) in [(&*light, xi), (&sight, -xi)] {
            let frame = space.standard_frame(u);
            for tilt in [-0.7_f64, 0.2, 1.1] {
                let axis = frame.inverse() * velocity;
                let (p, q) = axis.normalize().any_orthonormal_pair();
                let across = p * tilt.cos() + q * tilt.sin();
                let direction = |angle: f64| {
                    frame * (axis.normalize() * f64::sin(angle) + across * f64::cos(angle))
                };
                let (mut low, mut high) = (-0.5 * PI, 0.5 * PI);
                for _ in 0..200 {
                    let middle = 0.5 * (low + high);
                    if momentum(space, u, direction(middle)) < xi {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                let found = space.frequency(u, direction(low), velocity);
                assert!(
                    (found - 1.1467374743085939).abs() < 1e-12,
                    "{name}: {found}"
                );
            }
        }
    }
}

/// What Boyer and Lindquist's coordinates say about light at a chart point of kerr-ingoing.
struct Boyer {
    a: f64,
    r: f64,
    cos: f64,
    sin: f64,
    /// The differentials of t, r, θ and φ applied to a vector (t, x, y, z).
    rows: [[f64; 4]; 4],
}

impl Boyer {
    fn new(u: DVec3, a: f64) -> Self {
        let r = radius(u, a);
        let (cos, sigma) = (u.z / r, r * r + a * a * (u.z / r).powi(2));
        let (sin, delta) = ((1.0 - cos * cos).sqrt(), r * r - 2.0 * r + a * a);
        // From r⁴ - (ρ² - a²) r² - a² z² = 0.
        let dr = DVec3::new(u.x * r, u.y * r, u.z * (r * r + a * a) / r) / sigma;
        let dtheta = (DVec3::Z - dr * cos) / (-r * sin);
        // φ of the chart is atan2(y, x) - atan(a/r); t and φ of Boyer and Lindquist lag by integrals over r.
        let rho2 = u.x * u.x + u.y * u.y;
        let dphi = DVec3::new(-u.y, u.x, 0.0) / rho2 + dr * (a / (r * r + a * a));
        let dphi = dphi - dr * (a / delta);
        let dt = dr * (-2.0 * r / delta);
        let row = |time: f64, d: DVec3| [time, d.x, d.y, d.z];
        Self {
            a,
            r,
            cos,
            sin,
            rows: [row(1.0, dt), row(0.0, dr), row(0.0, dtheta), row(0.0, dphi)],
        }
    }

    fn components(&self, v: [f64; 4]) -> [f64; 4] {
        self.rows
            .map(|row| row.iter().zip(v).map(|(x, y)| x * y).sum())
    }

    /// Carter's constant of light with energy 1 and angular momentum `l`.
    fn carter(&self, k: [f64; 4], l: f64) -> f64 {
        let sigma = self.r * self.r + (self.a * self.cos).powi(2);
        let theta = sigma * self.components(k)[2];
        theta * theta + self.cos * self.cos * (l * l / (self.sin * self.sin) - self.a * self.a)
    }

    /// Walker and Penrose's constant of light `k` polarised along `f`: (A - iB)(r - i a cos θ).
    fn walker_penrose(&self, k: [f64; 4], f: [f64; 4]) -> [f64; 2] {
        let ([kt, kr, kh, kp], [ft, fr, fh, fp]) = (self.components(k), self.components(f));
        let (a, sin) = (self.a, self.sin);
        let even = kt * fr - kr * ft + a * sin * sin * (kr * fp - kp * fr);
        let odd = sin * ((self.r * self.r + a * a) * (kp * fh - kh * fp) - a * (kt * fh - kh * ft));
        let (c, s) = (self.r, a * self.cos);
        [even * c - odd * s, -(odd * c + even * s)]
    }
}

#[test]
fn energy_carters_constant_and_polarisation_are_kept_along_random_paths() {
    let a = 0.999;
    let hole = hole("kerr-ingoing", a, 45.0)
        .forward()
        .unwrap()
        .into_owned();
    let mut stream = Stream::new(&[19]);
    let (mut worst, mut turned, mut nearest) = (0.0_f64, 0.0_f64, f64::INFINITY);
    for _ in 0..60 {
        let u = stream.direction() * stream.between(1.5, 9.0);
        let d = stream.direction();
        if radius(u, a) < 1.2 {
            continue;
        }
        let found = path(&hole, u, d, 15.0, true);
        let e = d.any_orthonormal_vector();
        // Vectors of spacetime for light of energy 1: direction, and polarisation of unit length.
        let at = |step: &Step, s: f64| {
            let (u, v) = (step.position(s), step.tangent(s));
            let n = hole.sight(u, v);
            let lapse = 1.0 / (hole.normal_frequency(u, n) * hole.share(u, n));
            let k = 1.0 / (hole.share(u, n) * lapse * lapse);
            let frame = hole.standard_frame(u);
            let f = frame * (step.rotation(s).unwrap() * e) / lapse;
            let boyer = Boyer::new(u, a);
            let k = [k, k * v.x, k * v.y, k * v.z];
            let wp = boyer.walker_penrose(k, [0.0, f.x, f.y, f.z]);
            (
                n.dot(hole.metric(u) * n),
                momentum(&hole, u, n),
                boyer,
                k,
                wp,
            )
        };
        let (_, l0, boyer, k, wp0) = at(&found.steps[0], 0.0);
        let carter = boyer.carter(k, l0);
        let scale = 1.0 + carter.abs() + l0 * l0;
        let size = wp0[0].hypot(wp0[1]);
        for step in &found.steps {
            let (speed, l, boyer, k, wp) = at(step, step.end);
            nearest = nearest.min(boyer.r);
            worst = worst.max((speed - 1.0).abs());
            worst = worst.max((l - l0).abs() / scale);
            worst = worst.max((boyer.carter(k, l) - carter).abs() / scale);
            turned = turned.max((wp[0] - wp0[0]).hypot(wp[1] - wp0[1]) / size);
        }
    }
    assert!(nearest < 1.0, "nothing came near: {nearest}");
    assert!(worst < 1e-10 && turned < 1e-9, "{worst:.1e} {turned:.1e}");
}
