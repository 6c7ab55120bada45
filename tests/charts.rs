//! One manifold in two charts: end points, transported frames and areas of the same 1,000 paths agree
//! through the change of chart and its differential.

mod support;

use geofan_core::{
    geodesic::{JacobiField, Path, Ray, paths},
    manifold::Manifold,
    random::Stream,
};
use glam::{DMat3, DVec3};
use num_dual::Dual64;
use support::{asset, settings, worse};

const PATHS: usize = 1000;

/// A change of chart, written over dual numbers so that its differential is exact.
type Change = fn([Dual64; 3]) -> [Dual64; 3];

/// The image of `u`, and the differential.
fn image(change: Change, u: DVec3) -> (DVec3, DMat3) {
    let columns = [0, 1, 2]
        .map(|k| change([0, 1, 2].map(|i| Dual64::new(u[i], if i == k { 1.0 } else { 0.0 }))));
    let slope = columns.map(|column| DVec3::from_array(column.map(|x| x.eps)));
    let point = DVec3::from_array(columns[0].map(|x| x.re));
    (point, DMat3::from_cols(slope[0], slope[1], slope[2]))
}

/// The stereographic chart of S³ to the graph of its hemisphere: r -> 2r/(1 + r²).
fn to_graph(u: [Dual64; 3]) -> [Dual64; 3] {
    let r2 = u[0] * u[0] + u[1] * u[1] + u[2] * u[2];
    u.map(|x| x * 2.0 / (r2 + 1.0))
}

/// Poincaré's half-space to his ball: the inversion about (0, 0, −1) with radius √2, then z -> −z.
fn to_ball([x, y, z]: [Dual64; 3]) -> [Dual64; 3] {
    let d2 = x * x + y * y + (z + 1.0) * (z + 1.0);
    [x * 2.0 / d2, y * 2.0 / d2, -((z + 1.0) * 2.0 / d2) + 1.0]
}

/// Largest differences over all paths.
#[derive(Debug, Default)]
struct Off {
    point: f64,
    tangent: f64,
    frame: f64,
    area: f64,
}

fn follow(manifold: &Manifold, rays: &[Ray]) -> Vec<Path> {
    paths(manifold, settings(1e-13, false), rays.iter().copied())
}

/// The transport of a path as a matrix of chart components, and its area.
fn transport(manifold: &Manifold, ray: &Ray, path: &Path) -> (DMat3, f64) {
    let (step, s) = (path.steps.last().unwrap(), path.length);
    let here = manifold.standard_frame(step.position(s));
    let turn = DMat3::from_quat(step.rotation(s).unwrap());
    let spread = JacobiField::new(here.inverse(), step.tangent(s), step.deviation(s).unwrap());
    let matrix = here * turn * manifold.standard_frame(ray.u).inverse();
    (matrix, spread.signed_area())
}

fn compare(charts: [&str; 2], change: Change, starts: impl Fn(&mut Stream) -> (DVec3, f64)) -> Off {
    let [a, b] = charts.map(asset);
    let mut stream = Stream::new(&[2, 2]);
    let (mut first, mut second) = (Vec::new(), Vec::new());
    for _ in 0..PATHS {
        let (u, length) = starts(&mut stream);
        let ray = Ray::new(&a, u, stream.direction(), length);
        let (image, differential) = image(change, u);
        let d = b.standard_frame(image).inverse() * (differential * ray.v);
        second.push(Ray::new(&b, image, d.normalize(), length));
        first.push(ray);
    }
    let mut off = Off::default();
    let found = follow(&a, &first).into_iter().zip(follow(&b, &second));
    for ((p, q), (ray, other)) in found.zip(first.iter().zip(&second)) {
        let (step, twin, s) = (p.steps.last().unwrap(), q.steps.last().unwrap(), ray.length);
        let (u, map) = image(change, step.position(s));
        let inverse = b.standard_frame(u).inverse();
        off.point = worse(off.point, (inverse * (u - twin.position(s))).length());
        let tangent = inverse * (map * step.tangent(s) - twin.tangent(s));
        off.tangent = worse(off.tangent, tangent.length());
        let ((m, area), (n, same)) = (transport(&a, ray, &p), transport(&b, other, &q));
        let start = image(change, ray.u).1;
        let turn = inverse * (map * m - n * start) * start.inverse() * b.standard_frame(other.u);
        off.frame = turn
            .to_cols_array()
            .into_iter()
            .map(f64::abs)
            .fold(off.frame, worse);
        off.area = worse(off.area, (area - same).abs() / (s * s + area.abs()));
    }
    println!("{charts:?}: {off:?}");
    off
}

fn assert_small(off: &Off) {
    for (what, off) in [
        ("point", off.point),
        ("tangent", off.tangent),
        ("frame", off.frame),
        ("area", off.area),
    ] {
        assert!(off < 1e-9, "{what}: {off}");
    }
}

#[test]
fn the_three_sphere_is_the_same_by_stereography_and_as_a_graph() {
    // Within 1.3 rad of the pole, so that no path leaves the hemisphere.
    let off = compare(["s3", "s3-graph"], to_graph, |stream| {
        let angle = stream.between(0.0, 0.7);
        let u = stream.direction() * (angle / 2.0).tan();
        (u, stream.between(0.1, 1.3 - angle))
    });
    assert_small(&off);
}

#[test]
fn hyperbolic_space_is_the_same_in_the_half_space_and_the_ball() {
    let off = compare(["h3-half-space", "h3-ball"], to_ball, |stream| {
        let wide = |stream: &mut Stream| stream.between(-1.0, 1.0);
        let u = DVec3::new(wide(stream), wide(stream), wide(stream).exp());
        (u, stream.between(0.1, 3.0))
    });
    assert_small(&off);
}
