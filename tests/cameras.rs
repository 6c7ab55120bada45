//! Cameras against a program that shares no code with them: projections by formulas of this file, and
//! geodesics and transport of a conformal metric integrated by the DOP853 of `ode_solvers`.

mod support;

use geofan_render::{
    ExactTracer, PicturePanels, Seen, Stage,
    frame::{Outcomes, Paths, offsets, trace},
};
use glam::DVec3;
use ode_solvers::{Dop853, OutputType, SVector, System};
use std::f64::consts::PI;
use support::camera_scene::{LENS_SPACE, panels, stage};

/// The lens of [`LENS_SPACE`]: its metric is exp(2φ) δ with this φ.
const STRENGTH: f64 = 0.4;
const LENS: DVec3 = DVec3::new(0.6, 0.3, -0.2);

/// Where the sky begins.
const RADIUS: f64 = 5.0;

/// The camera of every scene: where it is, and its axes before they are made perpendicular.
const AT: DVec3 = DVec3::new(-0.7, 0.4, 0.3);
const LOOK: DVec3 = DVec3::new(1.0, 0.2, -0.3);
const UP: DVec3 = DVec3::new(0.1, -0.2, 1.0);

/// Traces the middle of every pixel of a file exactly, axes (row, column).
fn seen(stage: &Stage, panels: &PicturePanels) -> Outcomes {
    let (width, height) = panels.size;
    let mut all = Outcomes::from_elem((height, width, 1), Seen::Nothing);
    for panel in &panels.parts {
        let tracer = ExactTracer::new(&stage.world.manifold, panel.view.u, 30.0, 1e-10);
        let traced = trace(
            &stage.world,
            &panel.view,
            Paths::Exact(&tracer),
            &offsets(1),
        );
        for ((y, x, _), seen) in traced.outcomes.indexed_iter() {
            all[(panel.at.1 + y, panel.at.0 + x, 0)] = *seen;
        }
    }
    all
}

// The other program.

/// φ and its gradient.
fn field(u: DVec3) -> (f64, DVec3) {
    let phi = STRENGTH * (-(u - LENS).length_squared() / 2.0).exp();
    (phi, (LENS - u) * phi)
}

/// Point, tangent and three carried vectors, chart components.
type State = SVector<f64, 15>;

struct Flow;

impl System<f64, State> for Flow {
    fn system(&self, _: f64, y: &State, dy: &mut State) {
        let part = |k: usize| DVec3::new(y[3 * k], y[3 * k + 1], y[3 * k + 2]);
        let (u, v) = (part(0), part(1));
        let (_, grad) = field(u);
        for k in 0..5 {
            let rate = match k {
                0 => v,
                _ => {
                    // −Γ(v, w) of a metric exp(2φ) δ.
                    let w = part(k);
                    grad * v.dot(w) - w * grad.dot(v) - v * grad.dot(w)
                }
            };
            for c in 0..3 {
                dy[3 * k + c] = rate[c];
            }
        }
    }
}

/// A camera: a point and axes (right, up, ahead) by their lengths in the metric.
#[derive(Clone, Copy)]
struct Eye {
    u: DVec3,
    axes: [DVec3; 3],
}

impl Eye {
    fn here() -> Self {
        let ahead = LOOK.normalize();
        let right = ahead.cross(UP).normalize();
        Self {
            u: AT,
            axes: [right, right.cross(ahead), ahead],
        }
    }

    fn vector(&self, [x, y, z]: [f64; 3]) -> DVec3 {
        self.axes[0] * x + self.axes[1] * y + self.axes[2] * z
    }

    /// At the end of the geodesic along `way` (its length is how far), axes carried.
    fn moved(&self, way: DVec3) -> Self {
        let length = way.length();
        if length == 0.0 {
            return *self;
        }
        let end = follow(self.u, way / length, self.axes, length);
        let scale = field(end[0]).0.exp();
        Self {
            u: end[0],
            axes: [2, 3, 4].map(|k| end[k] * scale),
        }
    }

    /// The direction in which a ray from here leaves.
    fn sky(&self, direction: DVec3) -> DVec3 {
        // Newton's method on the length at which it does.
        let mut length = 2.0 * RADIUS;
        for _ in 0..30 {
            let [u, v, ..] = follow(self.u, direction, self.axes, length);
            let step = (u.length_squared() - RADIUS * RADIUS) / (2.0 * u.dot(v));
            length -= step;
            if step.abs() < 1e-9 {
                break;
            }
        }
        follow(self.u, direction, self.axes, length)[1].normalize()
    }
}

/// Point, tangent and carried axes after `length`; vectors in the metric at the start, chart components out.
fn follow(u: DVec3, direction: DVec3, axes: [DVec3; 3], length: f64) -> [DVec3; 5] {
    let scale = (-field(u).0).exp();
    let start = [
        u,
        direction * scale,
        axes[0] * scale,
        axes[1] * scale,
        axes[2] * scale,
    ];
    let start = State::from_iterator(start.iter().flat_map(|v| v.to_array()));
    let (tight, none) = (1e-12, 0.0);
    let mut solver = Dop853::from_param(
        Flow,
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
    solver.integrate().expect("a smooth space");
    let end = solver.y_out().last().unwrap();
    [0, 1, 2, 3, 4].map(|k| DVec3::new(end[3 * k], end[3 * k + 1], end[3 * k + 2]))
}

/// Where the sky of a pixel is, by a ray of the other program; `None` where the picture shows nothing.
type Other<'a> = &'a dyn Fn(f64, f64) -> Option<DVec3>;

/// Compares every `stride`th pixel of a picture by `camera`.
fn compare(camera: &str, size: (usize, usize), stride: usize, other: Other<'_>) {
    let stage = stage(LENS_SPACE, camera, "");
    let seen = seen(&stage, &panels(&stage, size));
    let (mut compared, mut worst) = (0, 0.0_f64);
    for y in (0..size.1).step_by(stride) {
        for x in ((y / stride) % stride..size.0).step_by(stride) {
            let expected = other(x as f64 + 0.5, y as f64 + 0.5);
            match (seen[(y, x, 0)], expected) {
                (Seen::Sky { direction, .. }, Some(expected)) => {
                    worst = worst.max((direction.as_dvec3() - expected).length());
                    compared += 1;
                }
                (Seen::Nothing, None) => {}
                (found, expected) => panic!("{camera}: {x} {y}: {found:?} {expected:?}"),
            }
        }
    }
    assert!(compared > 20, "{compared}");
    // Skies are kept in single precision.
    assert!(worst < 1e-6, "{camera}: {worst}");
}

/// The direction of a point of a plane 90° wide.
fn plane(x: f64, y: f64, (w, h): (f64, f64)) -> [f64; 3] {
    [2.0 * x / w - 1.0, (h - 2.0 * y) / w, 1.0]
}

/// Longitude to the right and latitude upwards.
fn globe(x: f64, y: f64, (w, h): (f64, f64)) -> (f64, f64) {
    (2.0 * PI * (x / w - 0.5), PI * (0.5 - y / h))
}

fn on_globe((longitude, latitude): (f64, f64)) -> [f64; 3] {
    [
        longitude.sin() * latitude.cos(),
        latitude.sin(),
        longitude.cos() * latitude.cos(),
    ]
}

#[test]
fn a_perspective_is_a_plane_of_rays() {
    let eye = Eye::here();
    let other = |x: f64, y: f64| Some(eye.sky(eye.vector(plane(x, y, (60.0, 40.0))).normalize()));
    compare("fov = 90", (60, 40), 5, &other);
}

#[test]
fn a_panorama_is_longitude_and_latitude() {
    let eye = Eye::here();
    let other = |x: f64, y: f64| Some(eye.sky(eye.vector(on_globe(globe(x, y, (80.0, 40.0))))));
    compare("projection = 'panorama'", (80, 40), 6, &other);
}

#[test]
fn a_fisheye_is_equidistant_in_its_circle_and_black_beyond() {
    let eye = Eye::here();
    for fov in [180.0_f64, 250.0, 360.0] {
        let other = |x: f64, y: f64| {
            let (x, y) = (x - 36.0, 20.0 - y);
            let radius = x.hypot(y);
            let angle = radius / 20.0 * fov.to_radians() / 2.0;
            let d = [
                x / radius * angle.sin(),
                y / radius * angle.sin(),
                angle.cos(),
            ];
            (radius <= 20.0).then(|| eye.sky(eye.vector(d)))
        };
        let camera = format!("projection = 'fisheye'\nfov = {fov}");
        compare(&camera, (72, 40), 5, &other);
    }
}

#[test]
fn a_cube_is_six_squares_in_rows() {
    let eye = Eye::here();
    for columns in [6, 3, 2, 1] {
        let rows = 6 / columns;
        let other = |x: f64, y: f64| {
            let (column, row) = ((x / 12.0) as usize, (y / 12.0) as usize);
            let a = 2.0 * (x / 12.0 - column as f64) - 1.0;
            let b = 1.0 - 2.0 * (y / 12.0 - row as f64);
            // Right, left, up, down, ahead, back.
            let d = match row * columns + column {
                0 => [1.0, b, -a],
                1 => [-1.0, b, a],
                2 => [a, 1.0, -b],
                3 => [a, -1.0, b],
                4 => [a, b, 1.0],
                _ => [-a, b, -1.0],
            };
            Some(eye.sky(eye.vector(d).normalize()))
        };
        compare("projection = 'cube'", (12 * columns, 12 * rows), 4, &other);
    }
}

#[test]
fn an_orthographic_picture_has_parallel_rays_from_geodesics_across_the_view() {
    let eye = Eye::here();
    let other = |x: f64, y: f64| {
        let (a, b) = (3.0 * (x - 30.0) / 60.0, 3.0 * (20.0 - y) / 60.0);
        let moved = eye.moved(eye.vector([a, b, 0.0]));
        Some(moved.sky(moved.vector([0.0, 0.0, 1.0])))
    };
    compare(
        "projection = 'orthographic'\nwidth = 3.0",
        (60, 40),
        5,
        &other,
    );
}

#[test]
fn two_eyes_on_a_geodesic_across_the_view_look_at_the_same_plane() {
    let eye = Eye::here();
    for (layout, size) in [("side-by-side", (80, 30)), ("over-under", (40, 60))] {
        let other = |x: f64, y: f64| {
            let (x, y, side) = match layout {
                "side-by-side" => (x % 40.0, y, if x < 40.0 { -0.2 } else { 0.2 }),
                _ => (x, y % 30.0, if y < 30.0 { -0.2 } else { 0.2 }),
            };
            let moved = eye.moved(eye.vector([side, 0.0, 0.0]));
            // From the eye to the point of the plane 1.5 ahead of the middle.
            let [a, b, c] = plane(x, y, (40.0, 30.0));
            Some(moved.sky(moved.vector([1.5 * a - side, 1.5 * b, 1.5 * c]).normalize()))
        };
        let camera =
            format!("stereo = {{ separation = 0.4, convergence = 1.5, layout = '{layout}' }}");
        compare(&camera, size, 5, &other);
    }
}

#[test]
fn without_a_convergence_both_eyes_look_straight_ahead() {
    let eye = Eye::here();
    let other = |x: f64, y: f64| {
        let side = if x < 40.0 { -0.2 } else { 0.2 };
        let moved = eye.moved(eye.vector([side, 0.0, 0.0]));
        Some(moved.sky(moved.vector(plane(x % 40.0, y, (40.0, 30.0))).normalize()))
    };
    compare("stereo = { separation = 0.4 }", (80, 30), 5, &other);
}

#[test]
fn eyes_with_fisheyes_look_at_the_same_sphere() {
    let eye = Eye::here();
    let other = |x: f64, y: f64| {
        let side = if x < 40.0 { -0.2 } else { 0.2 };
        let (x, y) = (x % 40.0 - 20.0, 20.0 - y);
        let radius = x.hypot(y);
        let angle = radius / 20.0 * PI / 2.0;
        let [a, b, c] = [
            x / radius * angle.sin(),
            y / radius * angle.sin(),
            angle.cos(),
        ];
        let moved = eye.moved(eye.vector([side, 0.0, 0.0]));
        let d = moved.vector([1.5 * a - side, 1.5 * b, 1.5 * c]).normalize();
        (radius <= 20.0).then(|| moved.sky(d))
    };
    let camera = "projection = 'fisheye'\nstereo = { separation = 0.4, convergence = 1.5 }";
    compare(camera, (80, 40), 5, &other);
}

#[test]
fn eyes_that_see_all_around_turn_with_the_direction() {
    let eye = Eye::here();
    let turned = |direction: [f64; 3], side: f64| {
        // To the right of the direction and level, as long as the direction's level part.
        let right = eye.vector([direction[2], 0.0, -direction[0]]) * side;
        let moved = eye.moved(right);
        // Components of an eye's axes are those of the camera's: they are carried along.
        let d = [
            direction[0] * 1.5 - direction[2] * side,
            direction[1] * 1.5,
            direction[2] * 1.5 + direction[0] * side,
        ];
        moved.sky(moved.vector(d).normalize())
    };
    let panorama = |x: f64, y: f64| {
        let side = if y < 20.0 { -0.2 } else { 0.2 };
        Some(turned(on_globe(globe(x, y % 20.0, (40.0, 20.0))), side))
    };
    let stereo = "stereo = { separation = 0.4, convergence = 1.5, layout = 'over-under' }";
    let camera = format!("projection = 'panorama'\n{stereo}");
    compare(&camera, (40, 40), 4, &panorama);
    let cube = |x: f64, y: f64| {
        let side = if y < 12.0 { -0.2 } else { 0.2 };
        let face = (x / 12.0) as usize;
        let (a, b) = (
            2.0 * (x / 12.0 - face as f64) - 1.0,
            1.0 - 2.0 * (y % 12.0 / 12.0),
        );
        let d = [
            [1.0, b, -a],
            [-1.0, b, a],
            [a, 1.0, -b],
            [a, -1.0, b],
            [a, b, 1.0],
            [-a, b, -1.0],
        ][face];
        let length = d.iter().map(|x| x * x).sum::<f64>().sqrt();
        Some(turned(d.map(|x| x / length), side))
    };
    let camera = format!("projection = 'cube'\n{stereo}");
    compare(&camera, (72, 24), 4, &cube);
}
