use geofan::{
    expr::{Tape, real::Real},
    manifold::{Carried, Manifold},
};
use std::time::Instant;
fn go<R: Real, const W: usize>(t: &Tape, name: &str) {
    let mut r = t.registers::<R, W>();
    for k in 0..18 {
        if k < 6 {
            for l in 0..W {
                r.input(k)[l] = R::from_f64(0.1 + 0.01 * l as f64 + 0.1 * k as f64);
            }
        }
    }
    let mut best = f64::MAX;
    for _ in 0..20 {
        let t0 = Instant::now();
        for _ in 0..2000 {
            t.run(&mut r);
            std::hint::black_box(&mut r);
        }
        best = best.min(t0.elapsed().as_secs_f64() / 2000.0);
    }
    let (a, b) = t.operations();
    println!(
        "{name}: {:.1} ns/run  {:.2} ns/lane  {:.2} ns/instr ({a}+{b})",
        best * 1e9,
        best * 1e9 / W as f64,
        best * 1e9 / (a + b) as f64
    );
}
fn main() {
    // clock: dependent adds
    let t0 = Instant::now();
    let mut x = 1u64;
    for i in 0..100_000_000u64 {
        x = std::hint::black_box(x + i);
    }
    println!("1e8 dependent {:?} {x}", t0.elapsed());
    for name in [
        "gaussian-bump",
        "three-bumps",
        "ellis-wormhole",
        "schwarzschild",
    ] {
        let m = Manifold::load(format!("assets/manifolds/{name}.toml").as_ref(), &[]).unwrap();
        for frame in [false, true] {
            let t = m.flow(Carried {
                frame,
                deviation: false,
            });
            go::<f64, 8>(t, &format!("{name} {frame} f64 8"));
            go::<f64, 16>(t, &format!("{name} {frame} f64 16"));
            go::<f64, 32>(t, &format!("{name} {frame} f64 32"));
            go::<f32, 32>(t, &format!("{name} {frame} f32 32"));
            go::<f32, 64>(t, &format!("{name} {frame} f32 64"));
            if std::env::args().nth(1).is_some() {
                println!("{t:#?}");
            }
        }
    }
}
