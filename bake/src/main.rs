use geofan::{
    bundle::{Table, Tree},
    fan::FanSpace,
    manifold::Manifold,
};
use geofan_bake::{
    plan::Plan,
    refine::{Refiner, Tally},
};
use std::sync::Arc;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let m = match Manifold::load(a[1].as_ref(), &[]) {
        Ok(m) => m,
        Err(e) => {
            eprintln!("{}", e.report(false));
            return;
        }
    };
    let length = m.length.unwrap();
    let space = FanSpace::new(Arc::new(m)).unwrap();
    let plan = Plan::new(&space, length, a[2].parse().unwrap(), a.get(3).is_none());
    let tally = Tally::default();
    let t = std::time::Instant::now();
    let r = Refiner {
        space: &space,
        plan: &plan,
        tally: &tally,
    };
    let chunks: Vec<Tree> = (0..plan.division(&space).chunks())
        .map(|c| {
            let t = r.chunk(c).unwrap();
            eprintln!("chunk {c} {:?} {:?}", t.count(), tally);
            t
        })
        .collect();
    eprintln!("{:?} {:?}", t.elapsed(), tally);
    let table = Table {
        division: plan.division(&space),
        space,
        length,
        chunks,
    };
    let mut stream = geofan::random::Stream::new(&[99]);
    let man = table.space.manifold().clone();
    let region = man.cameras.as_ref().unwrap();
    let (mut scr, mut mr, mut rot, mut fl) = (vec![], vec![], vec![], 0);
    for _ in 0..400 {
        let p: Vec<f64> = (0..region.dimension()).map(|_| stream.uniform()).collect();
        let mut u = region.at(&region.lerp(&p));
        if man.symmetry.rotation {
            u = stream.rotation() * u;
        }
        let fan = table.fan(u).unwrap();
        let dirs: Vec<_> = (0..16).map(|_| (u, stream.direction())).collect();
        let key = stream.bits();
        let pr = geofan::bundle::measure::probe(&man, plan.tolerance, length, &dirs, |i, l| {
            vec![l * (1.0 - geofan::random::Stream::new(&[key, i as u64]).uniform())]
        });
        for ((_, d), p) in dirs.iter().zip(pr) {
            let path = fan.path(*d);
            for q in p.probes {
                match path.at(q.s) {
                    None => fl += 1,
                    Some((u, _)) => {
                        let e = q.deviation(u, path.rotation(q.s));
                        scr.push(e.screen_mrad);
                        mr.push(e.mrad);
                        rot.push(e.rotation_mrad.unwrap_or(0.0));
                    }
                }
            }
        }
    }
    for (n, v) in [("screen", &mut scr), ("mrad", &mut mr), ("rot", &mut rot)] {
        v.sort_by(f64::total_cmp);
        let l = v.len();
        println!(
            "{n} p50 {:.4} p95 {:.4} p99 {:.4} max {:.4}",
            v[l / 2],
            v[l * 95 / 100],
            v[l * 99 / 100],
            v[l - 1]
        );
    }
    println!("flagged {} of {}", fl, fl + scr.len());
}
