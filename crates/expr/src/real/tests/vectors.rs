//! In vector instructions: the same bits, and how fast.

use super::{cases, samples};
use crate::real::Real;

const LANES: usize = 16;

/// Applies `kernel` to blocks of lanes in vector instructions of the best kind this machine has.
macro_rules! dispatched {
    ($kernel:expr, $input:expr, $output:expr) => {{
        let (input, output) = (&$input[..], &mut $output[..]);
        fearless_simd::dispatch!(fearless_simd::Level::new(), simd => simd.vectorize(
            #[inline(always)]
            || {
                for (x, y) in input.iter().zip(output.iter_mut()) {
                    // Through locals: memory that might overlap keeps short loops scalar.
                    let (x, mut result) = (*x, [0.0; LANES]);
                    for i in 0..LANES {
                        result[i] = $kernel(x[i]);
                    }
                    *y = result;
                    // One block is one unit of work, as on a tape: no vectors across blocks.
                    std::hint::black_box(&mut *y);
                }
            }
        ))
    }};
}

#[test]
fn vector_instructions_give_the_same_bits_as_scalar_ones() {
    use fearless_simd::Simd;
    macro_rules! same_bits {
        ($float:ident: $($name:ident)*) => {$({
            let case = cases().into_iter().find(|case| case.name == stringify!($name)).expect("a known function");
            let all: Vec<$float> = samples(&case, case.logarithmic[1]).into_iter().map(|x| x as $float).collect();
            let (input, _) = all.as_chunks::<LANES>();
            let mut output = vec![[0.0; LANES]; input.len()];
            dispatched!(<$float as Real>::$name, input, output);
            for (x, y) in input.as_flattened().iter().zip(output.as_flattened()) {
                let scalar = std::hint::black_box(<$float as Real>::$name)(*x);
                assert!(y.to_bits() == scalar.to_bits() || (y.is_nan() && scalar.is_nan()), "{} at {x:e}", case.name);
            }
        })*};
    }
    same_bits!(f64: exp ln sinh cosh tanh sin cos tan asin acos atan asinh acosh atanh);
    same_bits!(f32: exp ln sinh cosh tanh sin cos tan asin acos atan asinh acosh atanh);
}
