use super::*;
use crate::{MappedChebyshev, Polynomial, StepSize, TangentPromise, Train, Tree, Variables};
use geofan_core::{diagnostic::SourceText, random::Stream};
use ndarray::{ArrayD, IxDyn};

const FLAT: &str = r#"
name = "flat"
coordinates = ["x", "y", "z"]
metric = { conformal = "n" }
[parameters]
n = 1.0
[cameras]
parameters = { c = [-1, 1] }
at = ["c", "0", "0"]
length = 5.0
"#;

fn plan() -> PlanRecord {
    PlanRecord {
        tangents: TangentPromise::AsPoints,
        mapping: MappedChebyshev::new(0.8),
        parallax: [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]],
        ..PlanRecord::new(5.0, 0.5, vec![1], vec![3, 3, 3, 4])
    }
}

/// Random coefficients in the shape of a flat table.
fn bundle(nodes: usize) -> Bundle {
    let source = SourceText::new("folder/flat.toml", FLAT);
    let manifold = Manifold::from_source(source, &[("n".into(), 1.25)]).unwrap();
    let space = RaySpace::new(Arc::new(manifold)).unwrap();
    let mut stream = Stream::new(&[3]);
    let mut leaf = || {
        let shape = IxDyn(&[nodes, 3, 3, 4, 3]);
        let polynomial = Polynomial {
            coefficients: ArrayD::from_shape_simple_fn(shape, || stream.uniform()),
            variables: Variables::of_face(1, plan().mapping),
        };
        let tensor = Train::plain(&polynomial).rounded(StepSize::near(1e-6));
        Tree::Leaf(Arc::new(tensor.unwrap()))
    };
    let chunks = (0..6).map(|face| match face {
        5 => Tree::Flagged,
        4 => Tree::Split {
            axis: 3,
            halves: Box::new([leaf(), Tree::Flagged]),
        },
        _ => leaf(),
    });
    let chunks = (0..).zip(chunks.map(|tree| tree.encode())).collect();
    let contents = Contents::new(space, plan(), 0, chunks).unwrap();
    Bundle::from_contents(contents).unwrap()
}

#[test]
fn a_bundle_comes_back_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.fan");
    let bundle = bundle(3);
    let size = bundle.write(&path).unwrap();
    let read = Bundle::read(&path).unwrap();
    assert_eq!(read.header, bundle.header);
    assert_eq!(read.header.manifold.source, "flat.toml");
    assert_eq!(read.manifold.parameters, [("n".to_string(), 1.25)]);
    let again = read.contents().encode().unwrap();
    assert_eq!(again, fs::read(&path).unwrap());
    assert_eq!(again.len() as u64, size);
    let u = glam::DVec3::new(0.3, 0.0, 0.0);
    let d = glam::DVec3::X;
    let at = |b: &Bundle| b.table.fan(u).unwrap().path(d).at(2.0).unwrap();
    assert_eq!(at(&read), at(&bundle));
}

#[test]
fn every_truncation_is_refused() {
    let bytes = bundle(1).contents().encode().unwrap();
    for length in 0..bytes.len() {
        assert!(Bundle::from_bytes(&bytes[..length]).is_err(), "{length}");
    }
}

#[test]
fn every_flipped_bit_is_refused() {
    let bytes = bundle(3).contents().encode().unwrap();
    let mut stream = Stream::new(&[4]);
    for _ in 0..500 {
        let bit = (stream.bits() % (8 * bytes.len() as u64)) as usize;
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(Bundle::from_bytes(&damaged).is_err(), "bit {bit}");
    }
}

/// The bytes of a file whose hashes are right and whose header is not.
fn forged(change: impl Fn(&mut Header)) -> Vec<u8> {
    let mut contents = bundle(1).contents();
    change(&mut contents.header);
    let manifold = contents.space.manifold();
    contents.id = identity(manifold, &contents.header.plan).unwrap();
    contents.encode().unwrap()
}

/// A mirror of the space of [`bundle`].
fn mirror() -> crate::rays::Mirror {
    let space = bundle(1).contents().space;
    let rays = [(glam::DVec3::new(0.3, 0.2, -0.1), glam::DVec3::Y)];
    let mut found = crate::rays::Mirror::find(&space, &rays, &|| false).unwrap();
    found.remove(0)
}

/// A change of a header.
type Change = fn(&mut Header);

#[test]
fn headers_that_disagree_with_their_manifold_are_refused() {
    let changes: [Change; 14] = [
        |h| h.cameras[0][1] = 2.0,
        |h| h.cameras.clear(),
        |h| h.faces = 1,
        |h| h.plan.cells = vec![u32::MAX, u32::MAX, u32::MAX],
        |h| h.plan.cells = vec![0],
        |h| h.plan.cells = vec![2],
        |h| h.plan.nodes.clear(),
        |h| h.plan.length = f64::NAN,
        |h| h.plan.mirrors = vec![mirror(); 48],
        |h| h.reduction = crate::rays::Reduction::Rotation,
        |h| h.manifold.parameters[0].1 = 2.0,
        |h| h.manifold.text = "name = \"".into(),
        |h| h.manifold.name = "curved".into(),
        |h| {
            h.shard = Some(ShardRecord {
                index: 9,
                of: 3,
                exact_rays: 0,
            });
        },
    ];
    assert!(Bundle::from_bytes(&forged(|_| {})).is_ok());
    for (i, change) in changes.into_iter().enumerate() {
        assert!(Bundle::from_bytes(&forged(change)).is_err(), "change {i}");
    }
}

/// A certificate such as a bake finds.
fn certificate() -> Certificate {
    let quantiles = geofan_core::quantiles::Quantiles {
        p50: 0.1,
        p95: 0.2,
        p99: 0.3,
        max: f64::INFINITY,
    };
    Certificate {
        mrad: quantiles,
        screen_mrad: quantiles,
        sky_mrad: Some(quantiles),
        rotation_mrad: None,
        flagged: 0.5,
        rays: 100,
        seed: 1,
        tolerance: 1e-9,
        exact_rays_baked: 7,
    }
}

#[test]
fn numbers_of_a_header_that_are_none_are_refused() {
    let certified = |h: &mut Header, change: fn(&mut Certificate)| {
        let mut certificate = certificate();
        change(&mut certificate);
        h.certificate = Some(certificate);
    };
    let good = forged(|h| certified(h, |_| {}));
    assert!(Bundle::from_bytes(&good).is_ok());
    let of_certificates: [fn(&mut Certificate); 9] = [
        |c| c.mrad.p50 = f64::NAN,
        |c| c.mrad.p95 = 0.0,
        |c| c.screen_mrad.max = f64::NAN,
        |c| c.screen_mrad.p50 = -0.1,
        |c| {
            c.sky_mrad = c
                .sky_mrad
                .map(|q| geofan_core::quantiles::Quantiles { p99: f64::NAN, ..q })
        },
        |c| {
            c.rotation_mrad = c
                .sky_mrad
                .map(|q| geofan_core::quantiles::Quantiles { p99: 0.0, ..q })
        },
        |c| c.flagged = f64::NAN,
        |c| c.flagged = 1.5,
        |c| c.tolerance = f64::NAN,
    ];
    for (i, change) in of_certificates.into_iter().enumerate() {
        let bytes = forged(|h| certified(h, change));
        assert!(Bundle::from_bytes(&bytes).is_err(), "certificate {i}");
    }
    let of_plans: [Change; 14] = [
        |h| h.plan.max_error = f64::NAN,
        |h| h.plan.max_error = 0.0,
        |h| h.plan.length = f64::INFINITY,
        |h| h.plan.tolerance = f64::NAN,
        |h| h.plan.tangents = TangentPromise::Own(f64::NAN),
        |h| h.plan.nodes[1] = 0,
        |h| h.plan.most_rays = 0,
        |h| h.plan.least_volume = f64::NAN,
        |h| h.plan.least_volume = 2.0,
        |h| h.plan.mapping = MappedChebyshev::new(f64::NAN),
        |h| h.plan.parallax[1][2] = f64::NAN,
        |h| h.plan.sphere = Some([[f64::NAN; 3]; 3]),
        |h| h.plan.chart_map = crate::rays::ChartMap::Sphere { radius: f64::NAN },
        |h| h.certify_rays = u64::MAX,
    ];
    for (i, change) in of_plans.into_iter().enumerate() {
        assert!(Bundle::from_bytes(&forged(change)).is_err(), "plan {i}");
    }
    for camera in [f64::NAN, f64::INFINITY] {
        assert!(Bundle::from_bytes(&forged(|h| h.cameras[0][0] = camera)).is_err());
        assert!(Bundle::from_bytes(&forged(|h| h.manifold.parameters[0].1 = camera)).is_err());
    }
}

#[test]
fn a_plan_that_is_not_that_of_the_id_is_refused_whichever_number_differs() {
    let changes: [Change; 14] = [
        |h| h.plan.max_error = 0.25,
        |h| h.plan.length = 4.0,
        |h| h.plan.tangents = TangentPromise::None,
        |h| h.plan.tolerance = 1e-8,
        |h| h.plan.nodes[2] = 4,
        |h| h.plan.most_rays += 1,
        |h| h.plan.chart_map = crate::rays::ChartMap::Sphere { radius: 1.0 },
        |h| h.plan.refinement += 1,
        |h| h.plan.least_volume = 0.5,
        |h| h.plan.most_arc_halvings += 1,
        |h| h.plan.mapping = MappedChebyshev::NONE,
        |h| h.plan.parallax[0][0] = 0.2,
        |h| h.plan.mirrors = vec![mirror()],
        |h| h.plan.seed += 1,
    ];
    for (i, change) in changes.into_iter().enumerate() {
        let mut contents = bundle(1).contents();
        change(&mut contents.header);
        let error = Bundle::from_bytes(&contents.encode().unwrap()).unwrap_err();
        assert!(error.to_string().contains("id"), "{i}: {error}");
    }
}

#[test]
fn hostile_chunks_under_right_hashes_are_refused_or_left_undecoded() {
    let mut stream = Stream::new(&[6]);
    let contents = bundle(1).contents();
    for _ in 0..300 {
        let mut contents = contents.clone();
        let payload = &mut contents.chunks[0].1;
        let at = (stream.bits() % payload.len() as u64) as usize;
        payload[at] = stream.bits() as u8;
        if let Ok(bundle) = Bundle::from_bytes(&contents.encode().unwrap())
            && let Ok(fan) = bundle.table.fan(glam::DVec3::ZERO)
        {
            let _ = fan.path(glam::DVec3::X).at(1.0);
        }
    }
}

#[test]
fn a_shard_is_told_from_a_bundle() {
    let mut contents = bundle(1).contents();
    contents.chunks.retain(|c| c.0 % 2 == 1);
    assert!(Contents::decode("t", &contents.encode().unwrap()).is_err());
    contents.header.shard = Some(ShardRecord {
        index: 2,
        of: 2,
        exact_rays: 5,
    });
    let read = Contents::decode("t", &contents.encode().unwrap()).unwrap();
    let error = Bundle::from_contents(read).unwrap_err();
    assert!(error.to_string().contains("shard 2 of 2"));
}

#[test]
fn complaints_name_the_file_and_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.fan");
    let bytes = bundle(1).contents().encode().unwrap();
    fs::write(&path, &bytes[..bytes.len() - 20]).unwrap();
    let error = Bundle::read(&path).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    let text = error.to_string();
    assert!(text.contains("b.fan: is truncated at byte"), "{text}");
    assert!(text.contains("bake again"), "{text}");
}
