//! Chunks that ask for more than their bytes can tell.

use crate::{
    DecodeBudget, DecodeError, MappedChebyshev, TensorShape, Tree, Variables, decode::put_bytes,
    tensor::Layout,
};
use std::sync::Arc;

/// Tensors over one camera parameter and the directions of a face.
pub(crate) const SHAPE: TensorShape = TensorShape {
    variables: Variables {
        cameras: 1,
        mapping: MappedChebyshev::NONE,
        sphere: false,
    },
    directions: 2,
    channels: 3,
};

/// One core of a patch that somebody wrote by hand: lengths of its axes and its right rank.
type Shape<'s> = &'s [u32];

/// Writes a patch: the bytes of its structure, and the number of its integers, scales included.
fn patch(layout: &Layout, step: i16, cores: &[Shape<'_>]) -> (Vec<u8>, u32) {
    let mut structure = vec![254, layout.code()];
    structure.extend(step.to_le_bytes());
    let (mut left, mut integers) = (1, 0);
    for (k, core) in cores.iter().enumerate() {
        structure.extend(core.iter().flat_map(|n| n.to_le_bytes()));
        let right = core[core.len() - 1];
        let scales = if k + 1 == cores.len() { 0 } else { right };
        integers += left * core.iter().product::<u32>() + scales;
        left = right;
    }
    (structure, integers)
}

/// Writes a chunk of this structure, whose integers are coded in `words`.
fn chunk(structure: &[u8], integers: u32, words: &[u8]) -> Vec<u8> {
    let mut bytes = integers.to_le_bytes().to_vec();
    put_bytes(&mut bytes, words);
    put_bytes(&mut bytes, structure);
    bytes
}

/// Reads the boxes of a chunk and nothing more, as `geofan info` does.
fn outline(bytes: &[u8]) -> Result<Tree, DecodeError> {
    Tree::outline(
        bytes,
        SHAPE,
        &Arc::new(DecodeBudget::for_bytes(bytes.len())),
    )
}

fn train() -> Layout {
    Layout::paired(1, 2)
}

#[test]
fn a_rank_of_a_hundred_thousand_is_refused_before_its_numbers_are_made() {
    let cores = |rank: u32| {
        let cores: [Vec<u32>; 4] = [vec![1, rank], vec![128, 1], vec![1, 1], vec![1, 3, 1]];
        let (structure, integers) = patch(&train(), 0, &cores.each_ref().map(Vec::as_slice));
        chunk(&structure, integers, &[0; 32_000])
    };
    assert_eq!(outline(&cores(100)).unwrap().count(), (1, 0));
    let error = outline(&cores(131_072)).unwrap_err();
    assert!(error.0.contains("for its size"), "{error}");
}

#[test]
fn patches_that_open_to_more_than_their_bytes_can_tell_are_refused() {
    // Twenty thousand integers, which a camera multiplies out to a million and a half.
    let cores: [Shape<'_>; 4] = [&[1, 1], &[128, 1], &[128, 96], &[32, 3, 1]];
    let (structure, integers) = patch(&train(), 0, &cores);
    let chunk = |patches: u32| {
        // Halved along the camera's axis again and again: low halves are patches, the last high one too.
        let mut all = Vec::new();
        for _ in 1..patches {
            all.push(0);
            all.extend(&structure);
        }
        all.extend(&structure);
        chunk(&all, patches * integers, &[0; 4])
    };
    assert!(outline(&chunk(1)).is_ok());
    assert!(outline(&chunk(10)).is_err());
}

#[test]
fn steps_and_scales_beyond_single_precision_are_refused() {
    let cores: [Shape<'_>; 4] = [&[2, 1], &[2, 1], &[2, 1], &[2, 3, 1]];
    for (step, refused) in [
        (0, false),
        (32 * 90, false),
        (32 * 101, true),
        (i16::MIN, true),
    ] {
        let (structure, integers) = patch(&train(), step, &cores);
        let bytes = chunk(&structure, integers, &[0; 4]);
        assert_eq!(outline(&bytes).is_err(), refused, "{step}");
    }
}

#[test]
fn products_beyond_single_precision_are_refused() {
    // Noise instead of zeros.
    let cores: [Shape<'_>; 4] = [&[8, 4], &[8, 4], &[8, 4], &[8, 3, 1]];
    let noise: Vec<u8> = (0..4000_u32)
        .map(|k| (k.wrapping_mul(2_654_435_761) >> 13) as u8)
        .collect();
    let refused = |step: i16| {
        let (structure, integers) = patch(&train(), step, &cores);
        let bytes = chunk(&structure, integers, &noise);
        let budget = Arc::new(DecodeBudget::for_bytes(bytes.len()));
        Tree::decode(&bytes, SHAPE, &budget).unwrap_err().0
    };
    // What is left over is noticed after all numbers.
    assert_eq!(refused(0), "end");
    assert_eq!(refused(32 * 90), "size of coefficients");
}
