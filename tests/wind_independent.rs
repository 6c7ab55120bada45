//! Light in stationary spacetimes against an integrator that knows nothing of winds: Hamilton's equations
//! of null geodesics in four dimensions, `H = ½ g^μν p_μ p_ν`, for metrics written by hand, with
//! derivatives through the dual numbers of `num-dual`, by the DOP853 of `ode_solvers`. Polarisation is
//! transported in parallel beside it.

mod support;

use geofan_core::{
    geodesic::{Ray, elapsed, paths},
    manifold::Manifold,
    random::Stream,
};
use glam::{DMat4, DQuat, DVec3, DVec4};
use num_dual::{Dual64, DualNum};
use ode_solvers::{Dop853, OutputType, SVector, System};
use support::{asset, manifold, settings, worse};

/// `g_tt`, `g_ti`, `g_ij` (xx, yy, zz, xy, xz, yz) at a point.
type Entries = (Dual64, [Dual64; 3], [Dual64; 6]);

/// A stationary spacetime by a formula of this file.
#[derive(Clone, Copy)]
struct Spacetime(fn([Dual64; 3]) -> Entries);

const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

impl Spacetime {
    /// `g_μν`, t first.
    fn assembled(part: impl Fn(Dual64) -> f64, (tt, t, space): Entries) -> DMat4 {
        let mut g = [[0.0; 4]; 4];
        g[0][0] = part(tt);
        for i in 0..3 {
            g[0][i + 1] = part(t[i]);
            g[i + 1][0] = part(t[i]);
        }
        for (entry, (i, j)) in space.into_iter().zip(PAIRS) {
            g[i + 1][j + 1] = part(entry);
            g[j + 1][i + 1] = part(entry);
        }
        DMat4::from_cols_array_2d(&g)
    }

    fn metric(self, u: [f64; 3]) -> DMat4 {
        Self::assembled(|x| x.re, (self.0)(u.map(Dual64::from)))
    }

    /// `∂_k g_μν` for x, y and z.
    fn slopes(self, u: [f64; 3]) -> [DMat4; 3] {
        [0, 1, 2].map(|k| {
            let along = [0, 1, 2].map(|i| Dual64::new(u[i], f64::from(u8::from(i == k))));
            Self::assembled(|x| x.eps, (self.0)(along))
        })
    }
}

/// x (t first), p, polarisation.
type State = SVector<f64, 12>;

/// The equations with `dτ/dλ = rate · ẋ`, where `rate` is the covector of the path's parameter.
struct Flow {
    spacetime: Spacetime,
    parameter: fn([f64; 3]) -> [f64; 4],
}

impl System<f64, State> for Flow {
    fn system(&self, _: f64, y: &State, dy: &mut State) {
        let u = [y[1], y[2], y[3]];
        let inverse = self.spacetime.metric(u).inverse();
        let slopes = self.spacetime.slopes(u);
        let vector = |k: usize| DVec4::new(y[k], y[k + 1], y[k + 2], y[k + 3]);
        let (p, f) = (vector(4), vector(8));
        let k = inverse * p;
        let pace = DVec4::from((self.parameter)(u)).dot(k);
        // ∂_μ of what does not depend on t.
        let slope = |x: DVec4, y: DVec4| {
            DVec4::new(
                0.0,
                x.dot(slopes[0] * y),
                x.dot(slopes[1] * y),
                x.dot(slopes[2] * y),
            )
        };
        let along =
            |x: DVec4, y: DVec4| (0..3).fold(DVec4::ZERO, |sum, i| sum + slopes[i] * y * x[i + 1]);
        let force = 0.5 * slope(k, k);
        // Γ_μ(k, f) = ½ (k·∂ g f + f·∂ g k - ∂(k g f))
        let turned = 0.5 * (along(k, f) + along(f, k) - slope(k, f));
        let rate = -(inverse * turned);
        for c in 0..4 {
            dy[c] = k[c] / pace;
            dy[4 + c] = force[c] / pace;
            dy[8 + c] = rate[c] / pace;
        }
    }
}

fn integrate(flow: Flow, start: State, length: f64) -> State {
    let (tight, none) = (1e-13, 0.0);
    let mut solver = Dop853::from_param(
        flow,
        0.0,
        length,
        length,
        start,
        tight,
        tight,
        0.9,
        none,
        0.333,
        6.0,
        length,
        none,
        1_000_000,
        1_000_000_000,
        OutputType::Sparse,
    );
    solver.integrate().unwrap();
    *solver.y_out().last().unwrap()
}

/// The worst differences of positions, times and polarisations of random paths of light.
fn compare(
    (light, flow): (&Manifold, fn() -> Flow),
    rays: usize,
    seed: u64,
    start: impl Fn(&mut Stream) -> (DVec3, DVec3, f64),
) -> [f64; 3] {
    let mut stream = Stream::new(&[seed]);
    let mut off = [0.0; 3];
    for _ in 0..rays {
        let (u, d, length) = start(&mut stream);
        let ray = Ray::new(light, u, d, length);
        let path = paths(light, settings(1e-13, false), [ray]).remove(0);
        let Some(step) = path.steps.last().filter(|_| path.length == length) else {
            panic!("{u} {d}: the path ends at {}", path.length);
        };
        // p_t = -(1 + W·n), p_i = q_i - p_t b_i; polarisation in the rest space of the normal observer,
        // where dt = b(dx).
        let n = light.sight(u, ray.v);
        let (share, drift) = (light.share(u, n), light.drift(u));
        let q = light.metric(u) * n + drift * share;
        let e = d.any_orthonormal_vector();
        let polarised = |at: DVec3, turn: DQuat| {
            let f = light.standard_frame(at) * (turn * e);
            let f4 = DVec4::new(light.drift(at).dot(f), f.x, f.y, f.z);
            let g = flow().spacetime.metric(at.to_array());
            f4 / f4.dot(g * f4).sqrt()
        };
        let f = polarised(u, DQuat::IDENTITY);
        let state = State::from_iterator(
            [0.0, u.x, u.y, u.z, -share, q.x, q.y, q.z]
                .into_iter()
                .chain(f.to_array()),
        );
        let other = integrate(flow(), state, length);
        let at = DVec3::new(other[1], other[2], other[3]);
        let inverse = light.standard_frame(at).inverse();
        off[0] = worse(
            off[0],
            (inverse * (step.position(length) - at)).length() / length,
        );
        let time = elapsed(light, &path, length);
        off[1] = worse(off[1], (time - other[0]).abs() / length);
        // Polarisations that differ by a multiple of the wave vector are the same.
        let g = flow().spacetime.metric(at.to_array());
        let k = g.inverse() * DVec4::new(other[4], other[5], other[6], other[7]);
        let (mine, theirs) = (
            polarised(step.position(length), step.rotation(length).unwrap()),
            DVec4::new(other[8], other[9], other[10], other[11]),
        );
        let difference = mine - theirs;
        let difference = difference - k * (difference[0] / k[0]);
        off[2] = worse(off[2], difference.length() / theirs.length());
    }
    println!(
        "positions {:.1e}, times {:.1e}, polarisations {:.1e}",
        off[0], off[1], off[2]
    );
    off
}

#[track_caller]
fn assert_all(off: [f64; 3], within: f64) {
    assert!(off.iter().all(|x| *x <= within), "{off:?}");
}

/// `η + f l l` with l = (1, (r x + a y)/(r² + a²), (r y - a x)/(r² + a²), z/r).
fn kerr_schild([x, y, z]: [Dual64; 3]) -> Entries {
    let a = 0.9;
    let b = x * x + y * y + z * z - a * a;
    let r2 = (b + (b * b + z * z * (4.0 * a * a)).sqrt()) * 0.5;
    let r = r2.sqrt();
    let f = r * r2 * 2.0 / (r2 * r2 + z * z * (a * a));
    let l = [
        (r * x + y * a) / (r2 + a * a),
        (r * y - x * a) / (r2 + a * a),
        z / r,
    ];
    let space = PAIRS.map(|(i, j)| f * l[i] * l[j] + f64::from(u8::from(i == j)));
    (f - 1.0, l.map(|l| f * l), space)
}

#[test]
fn a_hundred_rays_around_a_rotating_hole_agree() {
    let hole = asset("kerr-ingoing").forward().unwrap().into_owned();
    let flow = || Flow {
        spacetime: Spacetime(kerr_schild),
        parameter: |_| [1.0, 0.0, 0.0, 0.0],
    };
    let off = compare((&hole, flow), 100, 31, |stream| {
        let u = stream.direction() * stream.between(2.5, 12.0);
        (u, stream.direction(), stream.between(1.0, 8.0))
    });
    assert_all(off, 1e-8);
}

#[test]
fn a_hundred_rays_in_goedels_universe_agree() {
    let universe = asset("goedel").forward().unwrap().into_owned();
    let flow = || Flow {
        spacetime: Spacetime(|[x, _, _]| {
            let (zero, one, e) = (Dual64::from(0.0), Dual64::from(1.0), x.exp());
            (
                -one,
                [zero, -e, zero],
                [one, e * e * -0.5, one, zero, zero, zero],
            )
        }),
        // dτ = dt + e^x dy
        parameter: |[x, ..]| [1.0, 0.0, x.exp(), 0.0],
    };
    let off = compare((&universe, flow), 100, 37, |stream| {
        let u = DVec3::from_array([0; 3].map(|_| stream.between(-1.0, 1.0)));
        (u, stream.direction(), stream.between(0.5, 8.0))
    });
    assert_all(off, 1e-8);
}

#[test]
fn a_hundred_rays_through_a_warp_drive_agree() {
    let drive = asset("alcubierre").forward().unwrap().into_owned();
    let flow = || Flow {
        spacetime: Spacetime(|[x, y, z]| {
            let r = (x * x + y * y + z * z).sqrt();
            let wall = |at: f64| ((r + at) * 4.0).tanh();
            let f = (wall(2.0) - wall(-2.0)) / (2.0 * f64::tanh(8.0));
            // dx - W dt with W = 2 (f - 1)
            let w = (f - 1.0) * 2.0;
            let (zero, one) = (Dual64::from(0.0), Dual64::from(1.0));
            (
                w * w - 1.0,
                [-w, zero, zero],
                [one, one, one, zero, zero, zero],
            )
        }),
        parameter: |_| [1.0, 0.0, 0.0, 0.0],
    };
    let off = compare((&drive, flow), 100, 41, |stream| {
        let u = stream.direction() * stream.between(0.2, 3.5);
        (u, stream.direction(), stream.between(0.5, 5.0))
    });
    assert_all(off, 1e-8);
}

/// A metric, a wind and a drift without any symmetry.
const STIRRED: &str = "
metric = { xx = '1 + 0.3*sin(y)^2', yy = '1.2 + 0.2*cos(x + z)', zz = '0.9 + 0.1*x^2/(1 + x^2)', xy = '0.2*sin(z)', yz = '0.15*cos(x)' }
wind = ['0.4*sin(y) + 0.1*z', '0.3*cos(z)*x', '0.5*sin(x*y)']
drift = ['0.2*y*z', '0.3*sin(x)', '0.25*cos(x + y)']
lapse = '1 + 0.2*sin(x)'
";

/// The same in four dimensions: `−(dt − b)² + G(dx − W(dt − b))²`, whatever the lapse.
fn stirred([x, y, z]: [Dual64; 3]) -> Entries {
    let zero = Dual64::from(0.0);
    let g = [
        y.sin().powi(2) * 0.3 + 1.0,
        (x + z).cos() * 0.2 + 1.2,
        x * x / (x * x + 1.0) * 0.1 + 0.9,
        z.sin() * 0.2,
        zero,
        x.cos() * 0.15,
    ];
    let w = [
        y.sin() * 0.4 + z * 0.1,
        z.cos() * x * 0.3,
        (x * y).sin() * 0.5,
    ];
    let b = [y * z * 0.2, x.sin() * 0.3, (x + y).cos() * 0.25];
    let place = |i: usize, j: usize| {
        PAIRS
            .iter()
            .position(|p| *p == (i.min(j), i.max(j)))
            .unwrap()
    };
    let lowered = [0, 1, 2].map(|i| (0..3).fold(zero, |sum, j| sum + g[place(i, j)] * w[j]));
    let square = (0..3).fold(zero, |sum, i| sum + lowered[i] * w[i]);
    // With θ = dt - b: (W² - 1) θ² - 2 θ W·dx + G dx².
    let tt = square - 1.0;
    let t = [0, 1, 2].map(|i| -tt * b[i] - lowered[i]);
    let space = PAIRS
        .map(|(i, j)| tt * b[i] * b[j] + lowered[i] * b[j] + lowered[j] * b[i] + g[place(i, j)]);
    (tt, t, space)
}

#[test]
fn metric_wind_and_drift_together_are_one_spacetime() {
    let light = manifold(STIRRED).forward().unwrap().into_owned();
    let flow = || Flow {
        spacetime: Spacetime(stirred),
        parameter: |[x, y, z]| [1.0, -0.2 * y * z, -0.3 * x.sin(), -0.25 * (x + y).cos()],
    };
    let off = compare((&light, flow), 30, 43, |stream| {
        let u = DVec3::from_array([0; 3].map(|_| stream.between(-1.5, 1.5)));
        (u, stream.direction(), stream.between(0.5, 4.0))
    });
    assert_all(off, 1e-9);
}

#[test]
fn a_spacetime_is_what_its_slices_are_and_what_observers_at_rest_make_of_it() {
    // One spacetime in three ways of writing it; paths, times and frequencies are the same.
    let entries = "xx = '1.3 + 0.1*sin(y)', yy = '1.1', zz = '1 + 0.2*cos(x)', xy = '0.1*z'";
    let (shift, lapse) = (["0.2*sin(y)", "0.1*x", "0.15"], "1 + 0.1*cos(z)");
    let slices = manifold(&format!(
        "metric = {{ {entries} }}\nshift = {shift:?}\nlapse = '{lapse}'"
    ));
    let lower = |a: &str, b: &str, c: &str| format!("({a})*s1 + ({b})*s2 + ({c})*s3");
    let spacetime = |observers: &str| {
        let [xx, yy, zz, xy] = ["1.3 + 0.1*sin(y)", "1.1", "1 + 0.2*cos(x)", "0.1*z"];
        let (tx, ty, tz) = (lower(xx, xy, "0"), lower(xy, yy, "0"), lower("0", "0", zz));
        manifold(&format!(
            "[let]\ns1 = '{}'\ns2 = '{}'\ns3 = '{}'\ntx = '{tx}'\nty = '{ty}'\ntz = '{tz}'
            [spacetime]\nobservers = '{observers}'\ntt = 'tx*s1 + ty*s2 + tz*s3 - ({lapse})^2'
            tx = 'tx'\nty = 'ty'\ntz = 'tz'\n{}",
            shift[0],
            shift[1],
            shift[2],
            entries.replace(", ", "\n"),
        ))
    };
    let (normal, fixed) = (spacetime("normal"), spacetime("static"));
    let (u, d) = (
        DVec3::new(0.3, -0.6, 0.4),
        DVec3::new(0.7, 0.2, -0.5).normalize(),
    );
    let follow = |space: &Manifold, d: DVec3, s: f64| {
        let path = paths(space, settings(1e-13, false), [Ray::new(space, u, d, s)]).remove(0);
        (path.steps.last().unwrap().position(s), path)
    };
    let (end, _) = follow(&slices, d, 3.0);
    assert!((follow(&normal, d, 3.0).0 - end).length() < 1e-12);
    // Observers at rest see the same line of sight in another direction, and measure it otherwise.
    let v = Ray::new(&slices, u, d, 1.0).v;
    let unit = v / v.dot(fixed.metric(u) * v).sqrt();
    let seen = fixed.local_frame(u).direction(unit);
    let (mut low, mut high) = (0.0, 12.0);
    let (_, path) = follow(&fixed, seen, high);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if elapsed(&fixed, &path, middle) < 3.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    let other = path.step_at(low).unwrap().position(low);
    assert!((other - end).length() < 1e-9, "{other} {end}");
    let g = |space: &Manifold, v: DVec3| {
        space.frequency(u, space.sight(u, v), DVec3::new(0.1, -0.2, 0.05))
    };
    assert!((g(&slices, v) - g(&normal, v)).abs() < 1e-13);
    assert!((g(&slices, v) - g(&fixed, unit)).abs() < 1e-12);
    let still = fixed.normal_frequency(u, unit);
    assert!((still - slices.frequency(u, slices.sight(u, v), DVec3::ZERO)).abs() < 1e-12);
}
