//! Headers: what is written is read again, what is out of range is refused, and when promises are kept.

use super::*;
use geofan_core::quantiles::Quantiles;

fn header() -> Header {
    Header {
        generator: "0.1.0".into(),
        manifold: ManifoldRecord {
            name: "Flat space".into(),
            source: "flat.toml".into(),
            text: "name = \"Flat space\"\n# ∂".into(),
            parameters: vec![("a".into(), 1.5), ("b".into(), -0.0)],
        },
        reduction: Reduction::Translation,
        cameras: vec![[-1.0, 1.0], [0.0, 1e300]],
        faces: 6,
        plan: PlanRecord {
            tangents: TangentPromise::AsPoints,
            tolerance: 5e-7,
            least_volume: 0.25,
            most_arc_halvings: 4,
            mapping: MappedChebyshev::new(0.75),
            parallax: [[0.25, 0.0, 0.0], [0.0; 3], [0.0, -1.0, 0.0]],
            sphere: Some([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
            seed: u64::MAX,
            ..PlanRecord::new(24.0, 0.5, vec![2, 3], vec![8, 8, 20])
        },
        certify_rays: 20_000,
        certificate: Some(Certificate {
            mrad: quantiles(0.1),
            screen_mrad: quantiles(0.2),
            sky_mrad: None,
            rotation_mrad: None,
            flagged: 0.01,
            rays: 20_000,
            seed: 1,
            tolerance: 1e-9,
            exact_rays_baked: 123_456,
        }),
        shard: None,
    }
}

fn quantiles(x: f64) -> Quantiles {
    Quantiles {
        p50: x,
        p95: 2.0 * x,
        p99: 3.0 * x,
        max: 4.0 * x,
    }
}

#[test]
fn a_header_comes_back_as_it_was() {
    let header = header();
    let bytes = header.encode().unwrap();
    assert_eq!(Header::decode(&bytes).unwrap(), header);
}

#[test]
fn intervals_are_the_same_but_for_the_rounding_of_their_larger_end() {
    let same = |a: [f64; 2], b: [f64; 2]| same_intervals(&[a], &[b]);
    assert!(same([3.6e-15, 1.0], [0.0, 1.0]));
    assert!(same([-2.0, 1.0], [-2.0 - 1e-12, 1.0]));
    assert!(!same([0.0, 1.0], [1e-11, 1.0]));
    assert!(!same([0.0, f64::INFINITY], [0.0, f64::INFINITY]));
    assert!(!same([f64::NAN, 1.0], [f64::NAN, 1.0]));
    assert!(same([0.0, 0.0], [0.0, 0.0]));
}

#[test]
fn numbers_of_a_plan_are_those_that_a_bake_can_choose() {
    let good = header().plan;
    assert!(good.check_numbers().is_ok());
    let changes: [fn(&mut PlanRecord); 5] = [
        |plan| plan.tolerance = 1e-300,
        |plan| plan.tolerance = f64::NAN,
        |plan| plan.length = 1e300,
        |plan| plan.max_error = 1e-6,
        |plan| plan.max_error = f64::INFINITY,
    ];
    for change in changes {
        let mut plan = good.clone();
        change(&mut plan);
        assert!(plan.check_numbers().is_err());
    }
}

#[test]
fn a_promise_of_tangents_is_a_flag_or_a_two_and_a_number() {
    let bytes = |tangents| {
        let plan = PlanRecord {
            tangents,
            ..header().plan
        };
        plan.encode().unwrap()
    };
    let plain = bytes(TangentPromise::AsPoints);
    let own = bytes(TangentPromise::Own(2.0));
    // Behind two numbers of eight bytes.
    assert_eq!(plain[16], 1);
    assert_eq!(bytes(TangentPromise::None)[16], 0);
    assert_eq!(
        (own[16], own[17..25].to_vec()),
        (2, 2.0_f64.to_le_bytes().to_vec())
    );
    assert_eq!(own[25..], plain[17..]);
    for tangents in [TangentPromise::None, TangentPromise::Own(0.125)] {
        let mut header = header();
        header.plan.tangents = tangents;
        assert_eq!(Header::decode(&header.encode().unwrap()).unwrap(), header);
    }
    let mut wrong = header().encode().unwrap();
    let at = wrong.windows(plain.len()).position(|w| w == plain).unwrap();
    wrong[at + 16] = 3;
    assert!(Header::decode(&wrong).is_err());
}

#[test]
fn tangents_with_a_promise_of_their_own_are_judged_by_it() {
    let kept = |tangents, sky: f64| {
        let Header {
            mut plan,
            certificate,
            ..
        } = header();
        plan.tangents = tangents;
        let mut certificate = certificate.unwrap();
        certificate.screen_mrad = quantiles(0.1);
        certificate.sky_mrad = Some(quantiles(sky));
        let excess = plan.sky_excess(&certificate).is_some();
        assert_eq!(plan.is_sky_kept(&certificate), Some(!excess));
        (plan.is_kept(&certificate), excess)
    };
    // A 99th percentile of 0.9 with a promise of 0.5 for points.
    assert_eq!(kept(TangentPromise::AsPoints, 0.3), (true, true));
    assert_eq!(kept(TangentPromise::AsPoints, 0.1), (true, false));
    assert_eq!(kept(TangentPromise::Own(1.0), 0.3), (true, false));
    assert_eq!(kept(TangentPromise::Own(0.8), 0.3), (false, true));
}

#[test]
fn a_header_with_a_tail_or_cut_short_is_refused() {
    let mut bytes = header().encode().unwrap();
    for cut in 0..bytes.len() {
        assert!(Header::decode(&bytes[..cut]).is_err());
    }
    bytes.push(0);
    let error = Header::decode(&bytes).unwrap_err().to_string();
    assert!(error.contains("1 bytes too many"), "{error}");
}

#[test]
fn a_hostile_length_is_refused_before_memory_is_taken() {
    let bytes = u64::MAX.to_le_bytes();
    assert!(Header::decode(&bytes).is_err());
    let bytes = (1_u64 << 40).to_le_bytes();
    assert!(Header::decode(&bytes).is_err());
}

/// wincode has no serde: a structure is its fields one after the other, as a tuple is.
#[test]
fn wincode_reads_and_writes_the_same_bytes() {
    let Header { manifold, plan, .. } = header();
    type Manifold = (String, String, String, Vec<(String, f64)>);
    // An enumeration is its number, as 32 bits.
    type Fitting = (u32, u32, u32);
    type Last = (f64, [[f64; 3]; 3], Option<[[f64; 3]; 3]>, Vec<u8>, u64);
    type Sizes = (Vec<u32>, Fitting, f64, u32, Vec<u32>, Last);
    let by_bincode = encode(&manifold).unwrap();
    let mirror: Manifold = (
        manifold.name,
        manifold.source,
        manifold.text,
        manifold.parameters,
    );
    assert_eq!(wincode::serialize(&mirror).unwrap(), by_bincode);
    assert_eq!(
        wincode::deserialize::<Manifold>(&by_bincode).unwrap(),
        mirror
    );
    let by_bincode = plan.encode().unwrap();
    // Tangents promised as points: the byte of a flag that is set.
    let start = (plan.max_error, plan.length, true, plan.tolerance);
    let sizes = (
        plan.nodes,
        (plan.most_rays, 0, plan.refinement),
        plan.least_volume,
        plan.most_arc_halvings,
        plan.cells,
        (0.75, plan.parallax, plan.sphere, Vec::new(), plan.seed),
    );
    let mirror: ((f64, f64, bool, f64), Sizes) = (start, sizes);
    assert_eq!(wincode::serialize(&mirror).unwrap(), by_bincode);
    let options = (
        Some((1_u32, 2_u32, 3_u64)),
        None::<u8>,
        vec![[0.5_f64, -1.0]],
    );
    let by_bincode = encode(&options).unwrap();
    assert_eq!(wincode::serialize(&options).unwrap(), by_bincode);
}
