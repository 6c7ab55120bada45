//! Damage of JPEG files.
//!
//! In: the bytes of a file. Out: what is wrong with it. Decoders make the best of a damaged file, as
//! browsers do: they fill with grey what is missing, and say nothing.

use zune_jpeg::{
    JpegDecoder,
    errors::DecodeErrors,
    zune_core::{bytestream::ZCursor, options::DecoderOptions},
};

const START: u8 = 0xd8;
const END: u8 = 0xd9;

/// Markers that stand alone: TEM, and RST0 to RST7.
const ALONE: [std::ops::RangeInclusive<u8>; 2] = [0x01..=0x01, 0xd0..=0xd7];

/// Refuses a file that was cut short or whose data cannot be decoded to their end. What decodes to a wrong
/// picture goes unnoticed, as such files have no checksums.
pub(super) fn check(bytes: &[u8]) -> Result<(), String> {
    if !ends(bytes) {
        return Err("was cut short: the picture goes on where the file ends".into());
    }
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(usize::MAX)
        .set_max_height(usize::MAX);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    // Whatever is odd in headers takes nothing from the picture.
    if decoder.decode_headers().is_err() {
        return Ok(());
    }
    match decoder.decode() {
        Err(DecodeErrors::Unsupported(_)) | Ok(_) => Ok(()),
        Err(e) => Err(format!(
            "is damaged, and part of its picture is lost ({e:?})"
        )),
    }
}

/// Tells if the file has its end marker after all of its segments and scans.
fn ends(bytes: &[u8]) -> bool {
    let mut at = 0;
    while let Some((marker, next)) = next_marker(bytes, at) {
        match marker {
            END => return true,
            START => at = next,
            _ if ALONE.iter().any(|range| range.contains(&marker)) => at = next,
            _ => {
                let Some(&[high, low]) = bytes.get(next..next + 2) else {
                    return false;
                };
                at = next + usize::from(u16::from_be_bytes([high, low])).max(2);
            }
        }
    }
    false
}

/// Finds the first marker from `at` on, and what follows it; among the data of scans 0xff is followed by 0.
fn next_marker(bytes: &[u8], at: usize) -> Option<(u8, usize)> {
    let rest = bytes.get(at..)?;
    let pairs = rest
        .windows(2)
        .position(|pair| pair[0] == 0xff && !matches!(pair[1], 0 | 0xff))?;
    Some((rest[pairs + 1], at + pairs + 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture with noise, so that its data are long.
    fn jpeg() -> Vec<u8> {
        let pixel = |x: u32, y: u32| image::Rgb([(x * 37) as u8, (y * 91) as u8, (x * y) as u8]);
        let image = image::RgbImage::from_fn(64, 48, pixel);
        let mut bytes = std::io::Cursor::new(Vec::new());
        image
            .write_to(&mut bytes, image::ImageFormat::Jpeg)
            .unwrap();
        bytes.into_inner()
    }

    #[test]
    fn whole_files_pass_also_with_something_behind_them() {
        let mut bytes = jpeg();
        assert_eq!(check(&bytes), Ok(()));
        bytes.extend([0, 0xff, 0, 1, 2]);
        assert_eq!(check(&bytes), Ok(()));
    }

    #[test]
    fn files_cut_anywhere_are_refused() {
        let bytes = jpeg();
        for length in (0..bytes.len()).step_by(7) {
            assert!(
                check(&bytes[..length]).unwrap_err().contains("cut short"),
                "{length}"
            );
        }
    }

    #[test]
    fn a_picture_with_a_marker_among_its_data_is_refused() {
        let mut bytes = jpeg();
        let middle = bytes.len() * 3 / 4;
        bytes.splice(middle..middle + 2, [0xff, START]);
        assert!(check(&bytes).unwrap_err().contains("damaged"));
    }
}
