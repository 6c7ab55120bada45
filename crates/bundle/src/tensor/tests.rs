use super::*;
use crate::{
    chebyshev::MappedChebyshev,
    polynomial::{Polynomial, Variables},
    train::Train,
    train_core::StepSize,
};
use geofan_core::random::Stream;
use ndarray::{ArrayD, IxDyn};

#[test]
fn every_order_has_a_code_of_its_own() {
    for (rays, orders) in [(0, 1), (1, 1), (2, 2), (3, 6), (4, 24), (5, 120)] {
        let mut seen = std::collections::HashSet::new();
        for code in 1..=orders {
            let layout = Layout::of_code(code, rays).unwrap();
            assert_eq!(layout.code(), code);
            assert_eq!(layout.cores(rays).concat().len(), rays + 2);
            assert!(seen.insert(format!("{layout:?}")));
        }
        assert_eq!(Layout::of_code(orders + 1, rays), None);
    }
    assert_eq!(Layout::of_code(0, 3), Some(Layout::Plain));
    assert_eq!(Layout::paired(2, 2), Layout::Train(vec![0, 2, 1, 3]));
    assert_eq!(Layout::paired(3, 2), Layout::Train(vec![0, 3, 1, 4, 2]));
}

fn train(order: &[usize], variables: Variables) -> Tensor {
    let lengths = [3, 5, 4];
    let mut stream = Stream::new(&[9]);
    let (mut cores, mut scales, mut left) = (Vec::new(), Vec::new(), 1);
    let mut random =
        |shape: &[usize]| ArrayD::from_shape_fn(IxDyn(shape), |_| stream.between(-1.0, 1.0));
    for axis in order {
        cores.push(random(&[left, lengths[*axis], 2]));
        scales.push(vec![1.5, 0.2]);
        left = 2;
    }
    cores.push(random(&[left, 6, 3, 1]));
    let train = Train {
        layout: Layout::Train(order.to_vec()),
        variables,
        cores,
        singular: scales,
    };
    train.rounded(StepSize::near(1e-5)).unwrap()
}

#[test]
fn many_rays_are_what_each_is_alone() {
    let face = Variables::of_face(1, MappedChebyshev::new(0.7));
    let sphere = Variables {
        sphere: true,
        ..face
    };
    let points: Vec<[f64; 3]> = (0..RAYS + 5)
        .map(|k| [0.1, -0.7, 0.4].map(|x| x + 0.01 * k as f64))
        .collect();
    let points: Vec<&[f64]> = points.iter().map(<[f64; 3]>::as_slice).collect();
    for variables in [face, sphere] {
        let orders = [[0, 1, 2], [1, 0, 2], [2, 1, 0]];
        let plain = Polynomial {
            coefficients: ArrayD::from_elem(IxDyn(&[2, 3, 2, 4, 3]), 0.5),
            variables,
        };
        let plain = Train::plain(&plain).rounded(StepSize::near(1e-3)).unwrap();
        let trains = orders.map(|order| train(&order, variables));
        for tensor in trains.iter().chain([&plain]) {
            let found = [tensor.at_many(&points), tensor.at_many_in_single(&points)];
            for (found, most) in found.iter().zip([1e-12, 1e-5]) {
                for (found, x) in found.iter().zip(&points) {
                    let close = |(a, b): (&f64, &f64)| (a - b).abs() < most * (1.0 + b.abs());
                    let alone = tensor.at(x);
                    assert!(found.len() == alone.len() && found.iter().zip(&alone).all(close));
                }
            }
        }
    }
}
