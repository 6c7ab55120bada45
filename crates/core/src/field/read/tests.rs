use super::*;
use std::fs;

const SHAPE: [usize; 3] = [2, 3, 4];

/// The sample at [x, y, z].
fn number(x: usize, y: usize, z: usize) -> f64 {
    100.0 * x as f64 + 10.0 * y as f64 + z as f64
}

/// All samples, z fastest.
fn samples() -> Samples {
    let [nx, ny, nz] = SHAPE;
    let mut values = Vec::new();
    for x in 0..nx {
        for y in 0..ny {
            values.extend((0..nz).map(|z| number(x, y, z)));
        }
    }
    Samples::new(SHAPE, values)
}

/// The same numbers, x fastest.
fn x_fastest() -> Vec<f64> {
    let [nx, ny, nz] = SHAPE;
    let mut values = Vec::new();
    for z in 0..nz {
        for y in 0..ny {
            values.extend((0..nx).map(|x| number(x, y, z)));
        }
    }
    values
}

fn npy(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let head = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((head.len() as u16).to_le_bytes());
    bytes.extend(head.as_bytes());
    bytes.extend(data);
    bytes
}

fn doubles(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// Reads a file of this name and content.
fn read(name: &str, content: &[u8], source: &SampleSource) -> SampleReading<Samples> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, content).unwrap();
    let files = vec![path];
    SampleSource {
        files,
        ..source.clone()
    }
    .read()
}

#[test]
fn arrays_of_numpy_are_read_in_both_orders_and_all_types() {
    let plain = SampleSource::default();
    let found = read(
        "a.npy",
        &npy("<f8", "False", "(2, 3, 4)", &doubles(&samples().values)),
        &plain,
    );
    assert_eq!(found.unwrap(), samples());
    let found = read(
        "a.npy",
        &npy("<f8", "True", "(2, 3, 4)", &doubles(&x_fastest())),
        &plain,
    );
    assert_eq!(found.unwrap(), samples());
    let big: Vec<u8> = samples()
        .values
        .iter()
        .flat_map(|x| (*x as i16).to_be_bytes())
        .collect();
    let found = read("a.npy", &npy(">i2", "False", "(2,3,4)", &big), &plain);
    assert_eq!(found.unwrap(), samples());
}

#[test]
fn arrays_that_cannot_be_used_are_named() {
    let plain = SampleSource::default();
    let message = |bytes: &[u8]| read("a.npy", bytes, &plain).unwrap_err().message;
    let data = doubles(&samples().values);
    assert!(message(b"not an array").contains("first bytes"));
    assert!(message(&npy("<f8", "False", "(6, 4)", &data)).contains("2 axes"));
    assert!(message(&npy("<f8", "False", "(2, 3, 5)", &data)).contains("another length"));
    assert!(message(&npy("<c16", "False", "(2, 3, 4)", &data)).contains("c16"));
    assert!(message(&npy("<f8", "False", "(0, 3, 4)", &[])).contains("0 x 3 x 4"));
    let huge = format!("({0}, {0}, {0})", u64::MAX);
    assert!(message(&npy("<f8", "False", &huge, &data)).contains("samples"));
    let whole = npy("<f8", "False", "(2, 3, 4)", &data);
    for length in 0..whole.len() {
        assert!(read("a.npy", &whole[..length], &plain).is_err());
    }
}

#[test]
fn numbers_without_a_head_need_a_shape_that_fits() {
    let source = SampleSource {
        shape: Some(SHAPE),
        number: Some(NumberType::F64),
        x_fastest: Some(true),
        ..SampleSource::default()
    };
    let bytes = doubles(&x_fastest());
    assert_eq!(read("a.raw", &bytes, &source).unwrap(), samples());
    let fault = read("a.raw", &bytes[1..], &source).unwrap_err();
    assert_eq!(fault.key, "shape");
    assert!(fault.message.contains("take 192 bytes, the file has 191"));
    let fault = read("a.raw", &bytes, &SampleSource::default()).unwrap_err();
    assert!(fault.message.contains("needs `shape`"));
    let fault = read("a.npy", &bytes, &source).unwrap_err();
    assert_eq!(fault.key, "shape");
}

#[cfg(feature = "samples")]
#[test]
fn archives_of_numpy_have_their_arrays_by_name_compressed_or_not() {
    use std::io::{Cursor, Write};
    use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};
    let array = npy("<f8", "False", "(2, 3, 4)", &doubles(&samples().values));
    for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        let options = SimpleFileOptions::default().compression_method(method);
        for name in ["logn", "other"] {
            archive.start_file(format!("{name}.npy"), options).unwrap();
            archive.write_all(&array).unwrap();
        }
        let bytes = archive.finish().unwrap().into_inner();
        let asked = |array: Option<&str>| SampleSource {
            array: array.map(String::from),
            ..SampleSource::default()
        };
        assert_eq!(
            read("a.npz", &bytes, &asked(Some("logn"))).unwrap(),
            samples()
        );
        let fault = read("a.npz", &bytes, &asked(Some("n"))).unwrap_err();
        assert_eq!(fault.key, "array");
        assert!(fault.hint.unwrap().contains("logn"));
        let fault = read("a.npz", &bytes, &asked(None)).unwrap_err();
        assert!(
            fault.message.contains("several arrays"),
            "{}",
            fault.message
        );
        for length in (0..bytes.len()).step_by(7) {
            assert!(read("a.npz", &bytes[..length], &asked(Some("logn"))).is_err());
        }
    }
}

#[cfg(feature = "samples")]
mod pictures {
    use super::*;
    use base64::{Engine, engine::general_purpose::STANDARD};
    use flate2::{Compression, write::ZlibEncoder};
    use std::io::{Cursor, Write};

    fn vti(file: &str, array: &str, appended: &[u8]) -> Vec<u8> {
        let mut bytes = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" {file}>\n\
             <ImageData WholeExtent=\"0 1 0 2 0 3\" Origin=\"-1 0 5\" Spacing=\"2 0.5 1\">\n\
             <Piece Extent=\"0 1 0 2 0 3\">\n<PointData Scalars=\"n\">\n{array}\n</PointData>\n\
             </Piece>\n</ImageData>\n"
        )
        .into_bytes();
        bytes.extend(appended);
        bytes.extend(b"</VTKFile>\n");
        bytes
    }

    fn check(bytes: &[u8]) {
        let mut found = read("a.vti", bytes, &SampleSource::default()).unwrap();
        let limits = found.limits.take();
        assert_eq!(found, samples());
        assert_eq!(limits, Some([[-1.0, 1.0], [0.0, 1.0], [5.0, 8.0]]));
    }

    #[test]
    fn images_of_vtk_are_read_in_all_their_encodings() {
        let numbers: Vec<String> = x_fastest().iter().map(f64::to_string).collect();
        let ascii = format!(
            "<DataArray type=\"Float64\" Name=\"n\" format=\"ascii\">\n{}\n</DataArray>",
            numbers.join(" ")
        );
        check(&vti("byte_order=\"LittleEndian\"", &ascii, b""));
        // Base64 in place, the length before the numbers.
        let data = doubles(&x_fastest());
        let mut with_length = (data.len() as u32).to_le_bytes().to_vec();
        with_length.extend(&data);
        let inline = |text: &str| {
            format!(
                "<DataArray type=\"Float64\" Name=\"n\" format=\"binary\">\n{text}\n</DataArray>"
            )
        };
        check(&vti(
            "byte_order=\"LittleEndian\"",
            &inline(&STANDARD.encode(&with_length)),
            b"",
        ));
        // Compressed in two blocks, their lengths encoded apart.
        let blocks = [&data[..128], &data[128..]].map(|block| {
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(block).unwrap();
            encoder.finish().unwrap()
        });
        let lengths = [2, 128, 64, blocks[0].len() as u64, blocks[1].len() as u64];
        let lengths: Vec<u8> = lengths.iter().flat_map(|n| n.to_le_bytes()).collect();
        let text = STANDARD.encode(lengths) + &STANDARD.encode(blocks.concat());
        let file = "byte_order=\"LittleEndian\" header_type=\"UInt64\" compressor=\"vtkZLibDataCompressor\"";
        check(&vti(file, &inline(&text), b""));
        // Raw bytes behind the XML.
        let reference = "<DataArray type=\"Float64\" Name=\"n\" format=\"appended\" offset=\"0\"/>";
        let mut appended = b"<AppendedData encoding=\"raw\">\n_".to_vec();
        appended.extend(&with_length);
        appended.extend(b"\n</AppendedData>\n");
        let bytes = vti("byte_order=\"LittleEndian\"", reference, &appended);
        check(&bytes);
        for length in 0..bytes.len() - 40 {
            assert!(
                read("a.vti", &bytes[..length], &SampleSource::default()).is_err(),
                "{length}"
            );
        }
    }

    #[test]
    fn an_image_of_vtk_that_is_not_one_whole_piece_is_refused_by_what_it_is() {
        let array = "<DataArray type=\"Float64\" Name=\"n\" format=\"ascii\">\n1\n</DataArray>";
        let whole = String::from_utf8(vti("byte_order=\"LittleEndian\"", array, b"")).unwrap();
        let said = |text: String| {
            let read = read("a.vti", text.as_bytes(), &SampleSource::default());
            read.unwrap_err().message
        };
        let part = said(whole.replace("<Piece Extent=\"0 1", "<Piece Extent=\"0 0"));
        assert!(part.contains("a part of the whole extent"), "{part}");
        let second = said(whole.replace(
            "</ImageData>",
            "<Piece Extent=\"0 1 0 2 0 3\"/></ImageData>",
        ));
        assert!(second.contains("several pieces"), "{second}");
        let none = said(whole.replace("Piece", "Peace"));
        assert!(none.contains("it has no Piece"), "{none}");
    }

    #[test]
    fn slices_of_openexr_are_stacked_file_by_file_or_layer_by_layer() {
        use ::exr::prelude::{
            AnyChannel, AnyChannels, Encoding, FlatSamples, Image, ImageAttributes, IntegerBounds,
            Layer, LayerAttributes, WritableImage,
        };
        let [nx, ny, nz] = SHAPE;
        let layer = |z: usize| {
            let values = (0..ny).flat_map(|y| (0..nx).map(move |x| number(x, y, z) as f32));
            let channel = AnyChannel::new("n", FlatSamples::F32(values.collect()));
            let attributes = LayerAttributes::named(format!("z{z}").as_str());
            let channels = AnyChannels::sort([channel].into_iter().collect());
            Layer::new((nx, ny), attributes, Encoding::UNCOMPRESSED, channels)
        };
        let write = |layers: Vec<_>| {
            let window = IntegerBounds::from_dimensions((nx, ny));
            let image = Image::from_layers(ImageAttributes::new(window), layers);
            let mut bytes = Cursor::new(Vec::new());
            image.write().to_buffered(&mut bytes).unwrap();
            bytes.into_inner()
        };
        let together = write((0..nz).map(layer).collect::<Vec<_>>());
        let found = read("a.exr", &together, &SampleSource::default()).unwrap();
        assert_eq!(found, samples());
        let folder = tempfile::tempdir().unwrap();
        let files: Vec<PathBuf> = (0..nz)
            .map(|z| {
                let path = folder.path().join(format!("{z}.exr"));
                fs::write(&path, write(vec![layer(z)])).unwrap();
                path
            })
            .collect();
        let source = SampleSource {
            files,
            ..SampleSource::default()
        };
        assert_eq!(source.read().unwrap(), samples());
        let wrong = SampleSource {
            array: Some("R".into()),
            ..source
        };
        assert_eq!(wrong.read().unwrap_err().key, "array");
    }
}
