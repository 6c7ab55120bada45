//! One number for how far two pictures are apart.
//!
//! In: two pictures of one size. Out: peak signal to noise ratio in decibel, of what a screen
//! shows: sRGB code values within [0, 1], peak 1.

use geofan_core::error::{Error, Result};
use geofan_render::picture::{Picture, srgb_shown};

/// `-10 log10` of the mean squared difference of all sRGB code values; infinite for pictures that
/// look the same.
pub fn psnr(a: &Picture, b: &Picture) -> Result<f64> {
    check_same_size(a, b)?;
    let squared = |(&a, &b): (&f32, &f32)| {
        let difference = f64::from(srgb_shown(a)) - f64::from(srgb_shown(b));
        difference * difference
    };
    let sum: f64 = a.rgb.iter().zip(&b.rgb).map(squared).sum();
    if sum == 0.0 {
        return Ok(f64::INFINITY);
    }
    Ok(-10.0 * (sum / a.rgb.len() as f64).log10())
}

/// Refuses to compare pictures of different sizes.
pub(super) fn check_same_size(a: &Picture, b: &Picture) -> Result<()> {
    if a.rgb.dim() == b.rgb.dim() {
        return Ok(());
    }
    let size = |picture: &Picture| format!("{}x{}", picture.width(), picture.height());
    let message = format!("{} and {} pixels cannot be compared", size(a), size(b));
    Err(Error::input("pictures of different sizes", message))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_render::picture::srgb_decode;

    fn grey(code: f32) -> Picture {
        Picture::filled(7, 5, [srgb_decode(code); 3])
    }

    #[test]
    fn a_tenth_of_the_range_everywhere_is_twenty_decibel() {
        let ratio = psnr(&grey(0.5), &grey(0.6)).unwrap();
        approx::assert_abs_diff_eq!(ratio, 20.0, epsilon = 1e-4);
        let one_way = psnr(&grey(0.2), &grey(0.9)).unwrap();
        assert_eq!(one_way, psnr(&grey(0.9), &grey(0.2)).unwrap());
    }

    #[test]
    fn pictures_that_look_the_same_are_infinitely_close() {
        assert_eq!(psnr(&grey(0.5), &grey(0.5)).unwrap(), f64::INFINITY);
        let (white, sun) = (
            Picture::filled(2, 2, [1.0; 3]),
            Picture::filled(2, 2, [9.0; 3]),
        );
        assert_eq!(psnr(&white, &sun).unwrap(), f64::INFINITY);
    }

    #[test]
    fn pictures_of_different_sizes_are_refused() {
        let failure = psnr(&grey(0.5), &Picture::filled(7, 6, [0.0; 3])).unwrap_err();
        assert!(failure.to_string().contains("7x5 and 7x6"), "{failure}");
    }
}
