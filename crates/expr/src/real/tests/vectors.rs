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

#[test]
#[ignore = "prints timings"]
fn nanoseconds_per_element() {
    use fearless_simd::Simd;
    macro_rules! time {
        ($float:ident: $($name:ident: $kernel:expr,)*) => {$({
            let input: Vec<[$float; LANES]> = (0..64).map(|i| std::array::from_fn(|j| (0.1 + 0.013 * i as $float + 0.01 * j as $float) as $float)).collect();
            let mut output = vec![[0.0; LANES]; input.len()];
            const ROUNDS: usize = 2_000;
            let best = (0..7).map(|_| {
                let start = std::time::Instant::now();
                for _ in 0..ROUNDS {
                    let input = std::hint::black_box(&input);
                    dispatched!($kernel, input, output);
                    std::hint::black_box(&output);
                }
                start.elapsed().as_secs_f64()
            }).fold(f64::INFINITY, f64::min);
            println!("{:7} {} {:6.3} ns", stringify!($name), stringify!($float), 1e9 * best / (ROUNDS * input.len() * LANES) as f64);
        })*};
    }
    macro_rules! time_all {
        ($($float:ident)*) => {$(
            time!($float:
                sqrt: <$float as Real>::sqrt, floor: <$float as Real>::floor, exp: <$float as Real>::exp,
                ln: <$float as Real>::ln, sin: <$float as Real>::sin, cos: <$float as Real>::cos,
                tan: <$float as Real>::tan, asin: <$float as Real>::asin, acos: <$float as Real>::acos,
                atan: <$float as Real>::atan, sinh: <$float as Real>::sinh, cosh: <$float as Real>::cosh,
                tanh: <$float as Real>::tanh, asinh: <$float as Real>::asinh, acosh: <$float as Real>::acosh,
                atanh: <$float as Real>::atanh,
                atan2: |x: $float| <$float as Real>::atan2(x, 0.7),
                pow: |x: $float| <$float as Real>::pow(x, 2.3 - x),
            );
        )*};
    }
    println!("{:?}", fearless_simd::Level::new());
    time_all!(f64 f32);
}
