use geofan::{bundle::Bundle, random::Stream};
use std::time::Instant;
fn main() {
    for p in std::env::args().skip(1) {
        let b = Bundle::read(std::path::Path::new(&p)).unwrap();
        let mut st = Stream::new(&[1]);
        let region = b.manifold.cameras.clone().unwrap();
        let mut times = vec![];
        for k in 0..440 {
            let x: Vec<f64> = (0..region.dimension()).map(|_| st.uniform()).collect();
            let mut y = [0.5; 3];
            y[..x.len()].copy_from_slice(&x);
            let u = region.at(&region.lerp(&y));
            let t = Instant::now();
            let f = b.table.fan(u).unwrap();
            let e = t.elapsed().as_secs_f64() * 1e3;
            std::hint::black_box(&f);
            if k >= 40 { times.push(e); }
        }
        times.sort_by(f64::total_cmp);
        println!("{p} p50 {:.2} p95 {:.2}", times[200], times[380]);
    }
}
