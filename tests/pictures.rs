//! Pictures as other programs write them: what is read is what their formats say.

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, Vec2,
    WritableImage,
};
use geofan::render::picture::{LayerValues, Picture, read};
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data/pictures")
        .join(name)
}

fn refusal(path: &Path) -> String {
    let failure = read(path).expect_err("refused");
    assert_eq!(failure.exit_code(), 2);
    failure.to_string()
}

#[test]
fn a_picture_is_the_display_window_whatever_the_data_window_is() {
    let full = read(&data("full.exr")).unwrap();
    assert_eq!((full.width(), full.height()), (200, 100));
    // More data than is displayed.
    assert_eq!(read(&data("over.exr")).unwrap().rgb, full.rgb);
    // Less: columns 40 to 159 of rows 20 to 79.
    let crop = read(&data("crop.exr")).unwrap();
    assert_eq!((crop.width(), crop.height()), (200, 100));
    for y in 0..100 {
        for x in 0..200 {
            let inside = (40..160).contains(&x) && (20..80).contains(&y);
            let expected = if inside { full.pixel(x, y) } else { [0.0; 3] };
            assert_eq!(crop.pixel(x, y), expected, "{x} {y}");
        }
    }
}

/// Writes channels of `values` (float) of a data window at `corner`, displayed in `display`.
fn write_exr(
    path: &Path,
    channels: &[(&str, Vec<f32>)],
    (corner, size): ([i32; 2], (usize, usize)),
    change: impl FnOnce(&mut exr::meta::header::ImageAttributes),
) {
    let channel = |(name, values): &(&str, Vec<f32>)| {
        AnyChannel::new(*name, FlatSamples::F32(values.clone()))
    };
    let channels = AnyChannels::sort(channels.iter().map(channel).collect());
    let attributes = LayerAttributes {
        layer_position: Vec2(corner[0], corner[1]),
        ..LayerAttributes::default()
    };
    let layer = Layer::new(size, attributes, Encoding::FAST_LOSSLESS, channels);
    let mut image = Image::from_layer(layer);
    change(&mut image.attributes);
    image.write().to_file(path).unwrap();
}

#[test]
fn windows_may_begin_anywhere_and_layers_are_placed_like_colours() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let ramp = |start: f32| (0..6).map(|i| start + i as f32).collect::<Vec<f32>>();
    let channels = [
        ("R", ramp(1.0)),
        ("G", ramp(11.0)),
        ("B", ramp(21.0)),
        ("Z", ramp(31.0)),
    ];
    // Display from (-5, 7), 4 by 3; data of 3 by 2 from (-6, 8): a column is beyond its left edge.
    write_exr(&path, &channels, ([-6, 8], (3, 2)), |attributes| {
        attributes.display_window = window([-5, 7], (4, 3));
    });
    let picture = read(&path).unwrap();
    let expected = [[0.0; 4], [2.0, 3.0, 0.0, 0.0], [5.0, 6.0, 0.0, 0.0]];
    for (y, row) in expected.iter().enumerate() {
        for (x, red) in row.iter().enumerate() {
            let add = |step: f32| if *red > 0.0 { red + step } else { 0.0 };
            assert_eq!(picture.pixel(x, y), [*red, add(10.0), add(20.0)], "{x} {y}");
            let Some(LayerValues::Float(z)) = picture.layer("Z") else {
                panic!("Z is a layer");
            };
            assert_eq!(z[(y, x)], add(30.0));
        }
    }
    // Nothing that is displayed has data.
    write_exr(&path, &channels, ([100, 100], (3, 2)), |attributes| {
        attributes.display_window = window([0, 0], (4, 3));
    });
    assert!(read(&path).unwrap().rgb.iter().all(|x| *x == 0.0));
}

fn window(corner: [i32; 2], size: (usize, usize)) -> exr::meta::attribute::IntegerBounds {
    exr::meta::attribute::IntegerBounds::new(Vec2(corner[0], corner[1]), Vec2(size.0, size.1))
}

/// Colours by the formulas of `make_pictures.py`, in double precision.
fn ramp(x: usize, y: usize) -> [f64; 3] {
    let (s, t) = (x as f64 / 64.0, y as f64 / 48.0);
    let light = 0.5 + 0.25 * s + 0.2 * t;
    let (red, blue) = ((1.0 + 0.4 * s - 0.2) * light, (1.0 + 0.5 * t - 0.3) * light);
    let green = (light - 0.21263901 * red - 0.07219232 * blue) / 0.71516868;
    [red, green, blue]
}

#[test]
fn luminance_and_chroma_become_colours_in_every_compression() {
    // What the compressions lose, and halves.
    let lossy = [
        ("b44", 1.5e-2),
        ("b44a", 1.5e-2),
        ("dwaa", 2e-2),
        ("dwab", 2e-2),
    ];
    let exact = ["no", "rle", "zips", "zip", "piz", "pxr24"].map(|name| (name, 1e-3));
    for (name, within) in exact.into_iter().chain(lossy).chain([("float", 2e-6)]) {
        let picture = read(&data(&format!("yc-{name}.exr"))).unwrap();
        assert_eq!((picture.width(), picture.height()), (64, 48));
        // Far enough from the edges that the filter has all its samples.
        for (x, y) in (14..50).flat_map(|x| (14..34).map(move |y| (x, y))) {
            for (found, expected) in picture.pixel(x, y).into_iter().zip(ramp(x, y)) {
                let off = (f64::from(found) - expected).abs();
                assert!(off < within, "{name} {x} {y}: {found} {expected}");
            }
        }
    }
}

#[test]
fn damaged_files_of_luminance_and_chroma_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    for name in ["no", "rle", "zips", "zip", "piz", "pxr24", "b44", "dwaa"] {
        let bytes = std::fs::read(data(&format!("yc-{name}.exr"))).unwrap();
        let stride = bytes.len() / 40;
        for place in (0..bytes.len()).filter(|i| (*i < 400 && i % 5 == 0) || i % stride == 0) {
            let mut copy = bytes.clone();
            copy[place] ^= [0x01, 0x80, 0xff][place % 3];
            std::fs::write(&path, &copy).unwrap();
            let _ = read(&path);
            std::fs::write(&path, &bytes[..place]).unwrap();
            assert!(read(&path).is_err(), "{name} cut at {place}");
        }
    }
}

#[test]
fn files_of_cie_xyz_become_rec709() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    // D65 and the red primary of Rec.709, as published (IEC 61966-2-1).
    let xyz = [[0.95047, 0.4124564], [1.0, 0.2126729], [1.08883, 0.0193339]].map(Vec::from);
    let check = |picture: Picture| {
        let expected = [[1.0, 1.0, 1.0], [1.0, 0.0, 0.0]];
        for (x, colour) in expected.into_iter().enumerate() {
            for (found, expected) in picture.pixel(x, 0).into_iter().zip(colour) {
                assert!((found - expected).abs() < 1e-3, "{found} {expected}");
            }
        }
    };
    let channels = |names: [&'static str; 3]| -> Vec<(&'static str, Vec<f32>)> {
        names.into_iter().zip(xyz.clone()).collect()
    };
    write_exr(&path, &channels(["X", "Y", "Z"]), ([0, 0], (2, 1)), |_| {});
    check(read(&path).unwrap());
    // The same as red, green and blue with the primaries of XYZ, as the OpenEXR library writes it.
    write_exr(
        &path,
        &channels(["R", "G", "B"]),
        ([0, 0], (2, 1)),
        |attributes| {
            attributes.chromaticities = Some(exr::meta::attribute::Chromaticities {
                red: Vec2(1.0, 0.0),
                green: Vec2(0.0, 1.0),
                blue: Vec2(0.0, 0.0),
                white: Vec2(1.0 / 3.0, 1.0 / 3.0),
            });
        },
    );
    check(read(&path).unwrap());
}

#[test]
fn where_no_channels_fit_those_that_there_are_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let names = ["Beauty.R", "Beauty.G", "Beauty.B", "G", "B"];
    let channels: Vec<_> = names.iter().map(|name| (*name, vec![0.5; 4])).collect();
    write_exr(&path, &channels, ([0, 0], (2, 2)), |_| {});
    let failure = refusal(&path);
    for name in names {
        assert!(failure.contains(name), "{failure}");
    }
    assert!(
        failure.contains("a.exr") && failure.contains("R, G and B"),
        "{failure}"
    );
}

#[test]
fn a_radiance_picture_signed_rgbe_is_read() {
    let picture = read(&data("rgbe.hdr")).unwrap();
    assert_eq!((picture.width(), picture.height()), (4, 2));
    assert!(picture.rgb.iter().all(|x| *x == 1.0));
}

#[test]
fn a_jpeg_that_was_cut_short_is_refused() {
    let failure = refusal(&data("trunc.jpg"));
    assert!(
        failure.contains("cut short") && failure.contains("trunc.jpg"),
        "{failure}"
    );
}
