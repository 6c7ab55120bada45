use geofan::{
    geodesic::*,
    manifold::{Carried, Manifold},
    random::Stream,
};
use glam::DVec3;
use std::time::Instant;
#[path = "../../benches/rival/mod.rs"]
mod rival;
fn time(name: &str, n: usize, mut f: impl FnMut()) {
    f();
    let mut best = f64::MAX;
    for _ in 0..60 {
        let t = Instant::now();
        f();
        best = best.min(t.elapsed().as_secs_f64());
    }
    println!("{name:40} {:.3} us/ray", best / n as f64 * 1e6);
}
struct Count(usize, usize);
impl Sink for Count {
    fn step(&mut self, _: usize, _: &Step) {
        self.0 += 1;
    }
    fn end(&mut self, _: usize, _: End, _: f64, n: usize) {
        self.1 += n;
    }
}
fn main() {
    let which = std::env::args().nth(1).unwrap_or_default();
    let load = |name: &str, set: &[(String, f64)]| {
        Manifold::load(format!("assets/manifolds/{name}.toml").as_ref(), set).unwrap()
    };
    let bump = load("gaussian-bump", &[("H".into(), 2.0)]);
    let mut r = Stream::new(&[1]);
    let n = 4096;
    let rays: Vec<Ray> = (0..n)
        .map(|_| {
            let u = DVec3::new(r.between(-2., 2.), r.between(-2., 2.), r.between(-2., 2.));
            Ray::new(&bump, u, r.direction(), 9.0)
        })
        .collect();
    let s = |tolerance, frame, deviation, events| Settings {
        tolerance,
        carried: Carried { frame, deviation },
        events,
    };
    let on = |x: &str| which.is_empty() || which == x;
    for tol in [1e-6, 1e-8, 1e-10] {
        let mut c = Count(0, 0);
        follow(
            &bump,
            s(tol, false, false, false),
            rays.iter().copied(),
            &mut c,
        );
        let rival = rival::Bump {
            height: 2.0,
            limits: rival::Limits::None,
        };
        let tried: usize = rays
            .iter()
            .map(|r| {
                rival
                    .follow([r.u.x, r.u.y, r.u.z, r.v.x, r.v.y, r.v.z], 9.0, tol)
                    .1
            })
            .sum();
        let truth = ends(&bump, s(1e-13, false, false, false), rays.iter().copied());
        let got = ends(&bump, s(tol, false, false, false), rays.iter().copied());
        let mut e: Vec<f64> = truth
            .iter()
            .zip(&got)
            .map(|(a, b)| {
                (a.as_ref().unwrap().0.position(9.0) - b.as_ref().unwrap().0.position(9.0)).length()
                    / 9.0
            })
            .collect();
        let mut e2: Vec<f64> = truth
            .iter()
            .zip(&rays)
            .map(|(a, r)| {
                let y = rival
                    .follow([r.u.x, r.u.y, r.u.z, r.v.x, r.v.y, r.v.z], 9.0, tol)
                    .0;
                (a.as_ref().unwrap().0.position(9.0) - DVec3::new(y[0], y[1], y[2])).length() / 9.0
            })
            .collect();
        println!(
            "tol {tol:e}: accepted {} tried {} rival tried {}",
            c.0 as f64 / n as f64,
            c.1 as f64 / n as f64,
            tried as f64 / n as f64
        );
        println!(
            "   {:?}\n   {:?}",
            geofan::quantiles::Quantiles::of(&mut e),
            geofan::quantiles::Quantiles::of(&mut e2)
        );
    }
    if on("bump6") {
        time("bump 1e-6 ends", n, || {
            std::hint::black_box(ends(
                &bump,
                s(1e-6, false, false, false),
                rays.iter().copied(),
            ));
        });
    }
    if on("rival") {
        let rival = rival::Bump {
            height: 2.0,
            limits: rival::Limits::None,
        };
        time("rival 1e-6", n, || {
            for r in &rays {
                std::hint::black_box(rival.follow(
                    [r.u.x, r.u.y, r.u.z, r.v.x, r.v.y, r.v.z],
                    9.0,
                    1e-6,
                ));
            }
        });
    }
    if on("bump8f") {
        time("bump 1e-8 frame ends", n, || {
            std::hint::black_box(ends(
                &bump,
                s(1e-8, true, false, false),
                rays.iter().copied(),
            ));
        });
        time("bump 1e-8 frame paths", n, || {
            std::hint::black_box(paths(
                &bump,
                s(1e-8, true, false, false),
                rays.iter().copied(),
            ));
        });
    }
    for name in ["ellis-wormhole", "schwarzschild"] {
        if on(name) {
            let m = load(name, &[]);
            let rays: Vec<Ray> = (0..n)
                .map(|_| Ray::new(&m, DVec3::new(6.0, 0.5, 0.3), r.direction(), 24.0))
                .collect();
            let mut c = Count(0, 0);
            follow(
                &m,
                s(1e-8, false, false, true),
                rays.iter().copied(),
                &mut c,
            );
            println!("{name} steps {}", c.1 as f64 / n as f64);
            time(&format!("{name} 1e-8 ends"), n, || {
                std::hint::black_box(ends(&m, s(1e-8, false, false, true), rays.iter().copied()));
            });
            time(&format!("{name} 1e-8 frame paths"), n, || {
                std::hint::black_box(paths(&m, s(1e-8, true, false, true), rays.iter().copied()));
            });
            time(&format!("{name} 1e-8 frame area paths"), n, || {
                std::hint::black_box(paths(&m, s(1e-8, true, true, true), rays.iter().copied()));
            });
        }
    }
    if on("fixed") {
        let m = load("three-bumps", &[]);
        let rays: Vec<(DVec3, DVec3)> = (0..n)
            .map(|_| {
                let r = Ray::new(&m, DVec3::new(2.0, 0.5, 0.3), r.direction(), 9.0);
                (r.u, r.v)
            })
            .collect();
        time("fixed 24 f32", n, || {
            std::hint::black_box(fixed_steps::<f32>(&m, &rays, 9.0, 24));
        });
    }
}
