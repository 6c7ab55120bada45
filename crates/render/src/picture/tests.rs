//! Tests of pictures as a whole: colours, sizes and files of every kind.

use super::*;
use ndarray::Array2;
use std::fs;

/// A picture of smooth colours, some beyond white, with one layer of each kind.
pub(super) fn sample(width: usize, height: usize) -> Picture {
    let ramp = |x: usize, y: usize| {
        let (u, v) = (x as f32 / width as f32, y as f32 / height as f32);
        [u, v, 4.0 * u * v]
    };
    let depth = Array2::from_shape_fn((height, width), |(y, x)| (x + 10 * y) as f32 / 3.0);
    let id = Array2::from_shape_fn((height, width), |(y, x)| (x * 70_000 + y) as u32);
    Picture::from_fn(width, height, ramp)
        .with_float("Z", depth)
        .with_index("id", id)
}

#[test]
fn srgb_encoding_and_decoding_undo_each_other() {
    for i in -10..=200 {
        let linear = i as f32 / 100.0;
        approx::assert_abs_diff_eq!(srgb_decode(srgb_encode(linear)), linear, epsilon = 1e-5);
    }
    approx::assert_abs_diff_eq!(srgb_encode(0.5), 0.735_357, epsilon = 1e-5);
    approx::assert_abs_diff_eq!(srgb_decode(0.5), 0.214_041, epsilon = 1e-5);
}

#[test]
fn what_a_screen_cannot_show_is_clamped_and_nan_is_black() {
    assert_eq!(srgb_shown(f32::NAN), 0.0);
    assert_eq!(srgb_shown(-1.0), 0.0);
    assert_eq!(srgb_shown(f32::INFINITY), srgb_shown(1.0));
}

#[test]
fn drawing_outside_a_picture_is_clipped() {
    let mut picture = Picture::filled(4, 3, [0.0; 3]);
    picture.fill(2..99, 1..99, [1.0; 3]);
    picture.fill(50..60, 50..60, [1.0; 3]);
    picture.paste(3, 2, &Picture::filled(5, 5, [2.0; 3]));
    picture.paste(9, 9, &Picture::filled(5, 5, [2.0; 3]));
    assert_eq!(picture.rgb.sum(), 3.0 * (3.0 + 2.0));
    assert_eq!(picture.pixel(3, 2), [2.0; 3]);
}

#[test]
fn the_ending_of_the_name_chooses_the_format_and_others_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.png", "a.EXR"] {
        let path = folder.path().join(name);
        write(&path, &sample(8, 5), &Metadata::default()).unwrap();
        let back = read(&path).unwrap();
        assert_eq!((back.width(), back.height()), (8, 5));
    }
    for name in ["a.gif", "a", "png"] {
        let path = folder.path().join(name);
        let failure = write(&path, &sample(8, 5), &Metadata::default()).unwrap_err();
        assert_eq!(failure.exit_code(), 2);
        assert!(failure.to_string().contains(".png or .exr"), "{failure}");
        assert_eq!(read(&path).unwrap_err().exit_code(), 2);
    }
}

#[test]
fn a_missing_file_and_a_missing_folder_are_bad_input() {
    let path = Path::new("/no-such-folder/a.png");
    assert_eq!(read(path).unwrap_err().exit_code(), 2);
    let failure = write(path, &sample(2, 2), &Metadata::default()).unwrap_err();
    assert_eq!(failure.exit_code(), 2);
}

#[test]
fn a_layer_of_another_size_and_an_empty_picture_are_refused() {
    let path = Path::new("/tmp/never-written.exr");
    let odd = Picture::filled(4, 4, [0.0; 3]).with_float("Z", Array2::zeros((4, 5)));
    let failure = write(path, &odd, &Metadata::default()).unwrap_err();
    assert!(failure.to_string().contains("layer Z is 5x4"), "{failure}");
    let empty = Picture::filled(0, 4, [0.0; 3]);
    assert!(write(path, &empty, &Metadata::default()).is_err());
}

/// `bytes` cut short at many places, and with one byte changed at many places, all of the header
/// among them.
fn damaged_copies(bytes: &[u8]) -> Vec<Vec<u8>> {
    let stride = (bytes.len() / 60).max(1);
    let cuts = (0..bytes.len())
        .step_by(stride)
        .map(|n| bytes[..n].to_vec());
    let places = (0..bytes.len()).filter(|i| *i < 350 || i % stride == 0);
    let changes = places.map(|place| {
        let mut copy = bytes.to_vec();
        copy[place] ^= [0x01, 0x80, 0xff][place % 3];
        copy
    });
    cuts.chain(changes).collect()
}

#[test]
fn damaged_files_of_every_kind_give_pictures_or_messages_but_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.png", "a.exr", "a.jpg", "a.hdr"] {
        let path = folder.path().join(name);
        save_as(&path, &sample(24, 17));
        let bytes = fs::read(&path).unwrap();
        assert!(read(&path).is_ok(), "{name} undamaged");
        let mut refused = 0;
        for copy in damaged_copies(&bytes) {
            fs::write(&path, copy).unwrap();
            if let Err(failure) = read(&path) {
                assert_eq!(failure.exit_code(), 2);
                assert!(failure.to_string().contains(name), "{failure}");
                refused += 1;
            }
        }
        assert!(refused > 50, "{name}: only {refused} refused");
    }
}

/// Saves in formats that only reading knows as well.
fn save_as(path: &Path, picture: &Picture) {
    match extension(path).as_str() {
        "jpg" | "hdr" => {
            let (width, height) = (picture.width() as u32, picture.height() as u32);
            let values = picture.rgb.iter().copied().collect();
            let image = image::Rgb32FImage::from_raw(width, height, values).unwrap();
            let image = image::DynamicImage::ImageRgb32F(image);
            match extension(path).as_str() {
                "jpg" => image.into_rgb8().save(path).unwrap(),
                _ => image.save(path).unwrap(),
            }
        }
        _ => write(path, picture, &Metadata::default().with("command", "test")).unwrap(),
    }
}

#[test]
fn radiance_pictures_are_read_as_linear_light() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sky.hdr");
    let picture = Picture::filled(8, 4, [0.25, 1.0, 8.0]);
    save_as(&path, &picture);
    let back = read(&path).unwrap();
    for (a, b) in back.rgb.iter().zip(&picture.rgb) {
        approx::assert_relative_eq!(a, b, max_relative = 0.05);
    }
}

#[test]
fn a_header_that_asks_for_too_many_pixels_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge.hdr");
    let header = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99999 +X 99999\n";
    fs::write(&path, header).unwrap();
    let failure = read(&path).unwrap_err().to_string();
    assert!(failure.contains("huge.hdr"), "{failure}");
    assert!(failure.contains("too many"), "{failure}");
}

#[test]
fn the_kind_of_a_file_is_told_by_what_is_inside() {
    let folder = tempfile::tempdir().unwrap();
    let kinds = ["a.png", "a.jpg", "a.hdr", "a.exr"];
    for (i, name) in kinds.iter().enumerate() {
        let path = folder.path().join(name);
        save_as(&path, &sample(24, 17));
        let misnamed = folder.path().join(kinds[(i + 1) % 4].replace('a', "b"));
        fs::rename(&path, &misnamed).unwrap();
        let back = read(&misnamed).unwrap();
        assert_eq!((back.width(), back.height()), (24, 17));
    }
    let text = folder.path().join("text.png");
    fs::write(&text, "none of them").unwrap();
    let failure = read(&text).unwrap_err().to_string();
    assert!(
        failure.contains("is not a PNG, JPEG, Radiance or OpenEXR file"),
        "{failure}"
    );
}

fn pixels(value: impl Fn(usize) -> f32) -> Pixels {
    let shape = (5, 7, 3);
    Pixels {
        shape,
        values: (0..5 * 7 * 3).map(value).collect(),
    }
}

#[test]
fn code_values_come_back_exactly_in_a_byte_each() {
    let srgb = pixels(|i| srgb_decode((i * 37 % 256) as f32 / 255.0));
    let linear = pixels(|i| (i * 91 % 256) as f32 / 255.0);
    for pixels in [srgb, linear] {
        let bytes = pixels.pack();
        assert_eq!(bytes.len(), 10 + pixels.values.len());
        assert_eq!(Pixels::unpack(&bytes), Some(pixels));
    }
}

#[test]
fn light_comes_back_to_within_its_stated_error() {
    let values = [0.0, 1e-30, 0.3, 7.5, 65_000.0, 1e30, -2.0, f32::INFINITY];
    let pixels = pixels(|i| values[i % values.len()] * (1.0 + 1e-3 * i as f32));
    let back = Pixels::unpack(&pixels.pack()).unwrap();
    for (a, b) in pixels.values.iter().zip(&back.values) {
        assert!(a == b || (a - b).abs() <= a.abs() / 4096.0, "{a} {b}");
    }
}

#[test]
fn other_bytes_are_refused() {
    let bytes = pixels(|i| i as f32).pack();
    for length in 0..bytes.len() {
        assert_eq!(Pixels::unpack(&bytes[..length]), None);
    }
    let mut odd = bytes.clone();
    odd[9] = 9;
    assert_eq!(Pixels::unpack(&odd), None);
}
