//! What a stranger's bytes are given to: every reader of files and messages, and a little of what follows.
//!
//! In: bytes. Out: nothing, or an error that says what is wrong; never a panic. `cargo fuzz` runs these with
//! coverage (see `Cargo.toml` here), `tests/fuzzing.rs` with mutations of valid files on any compiler.

use geofan::{
    bundle::{Bundle, Contents, container},
    diagnostic::SourceText,
    manifold::Manifold,
    random::Stream,
    render::{
        picture,
        scene::{Mesh, PoseFile, SceneFile},
    },
    view::ViewerEvent,
};
use glam::DVec3;
use std::{cell::RefCell, collections::HashMap, fs, path::Path, sync::Arc};
use tempfile::TempDir;

/// A reader, by name.
pub type Target = (&'static str, fn(&[u8]));

/// All of them.
pub const TARGETS: [Target; 10] = [
    ("bundle", bundle),
    ("resealed", resealed),
    ("hostile", hostile),
    ("manifold", manifold),
    ("scene", scene),
    ("mesh", mesh),
    ("material", material),
    ("picture", picture),
    ("camera_path", camera_path),
    ("message", message),
];

/// Opens a bundle and looks paths up in it.
pub fn bundle(bytes: &[u8]) {
    if let Ok(bundle) = Bundle::from_bytes(bytes) {
        look_up(&bundle);
    }
}

/// Looks paths up from the middle of the camera region: numbers that come back must be numbers.
fn look_up(bundle: &Bundle) {
    let _ = bundle.table.counts();
    let Some(region) = &bundle.manifold.cameras else {
        return;
    };
    let middle = vec![0.4; region.dimension()];
    let Ok(fan) = bundle.fan(region.at(&region.lerp(&middle))) else {
        return;
    };
    for d in [DVec3::X, DVec3::new(-0.6, 0.64, 0.48), DVec3::NEG_Z] {
        let path = fan.path(d);
        let length = bundle.header.plan.length;
        for share in [0.01, 0.4, 1.0] {
            if let Some((u, v)) = path.at(share * length) {
                assert!(u.is_finite() && v.is_finite(), "{u} {v}");
            }
        }
    }
}

/// Changes a bundle below its checksums: the first bytes say where and how, and it is sealed again.
pub fn resealed(bytes: &[u8]) {
    let Some((key, rest)) = bytes.split_first_chunk::<9>() else {
        return;
    };
    let Ok((header, fields, chunks)) = container::decode(rest) else {
        return;
    };
    let mut stream = Stream::new(&[u64::from_le_bytes(key[..8].try_into().unwrap_or_default())]);
    let mut header_bytes = header.payload.to_vec();
    let mut payloads: Vec<(u32, Vec<u8>)> = chunks
        .iter()
        .map(|chunk| (chunk.index, chunk.payload.to_vec()))
        .collect();
    let mut samples: Vec<Vec<u8>> = fields.iter().map(|field| field.payload.to_vec()).collect();
    for _ in 0..=key[8] % 4 {
        let parts = payloads.iter_mut().map(|(_, payload)| payload);
        let mut parts: Vec<&mut Vec<u8>> = parts.chain(&mut samples).collect();
        parts.push(&mut header_bytes);
        let place = (stream.bits() % parts.len() as u64) as usize;
        change(parts[place], &mut stream);
    }
    let sealed = container::encode(header.id, &header_bytes, &samples, &payloads);
    let kept = fields.iter().map(|field| field.payload).eq(&samples);
    match header_bytes == header.payload && kept {
        true => with_header_of(rest, &sealed),
        false => bundle(&sealed),
    }
}

/// Opens a bundle of the same header and samples as another: the manifold that was rebuilt from those serves again, and
/// nothing else.
fn with_header_of(other: &[u8], bytes: &[u8]) {
    let (Some(mut contents), Ok((_, _, chunks))) = (decoded(other), container::decode(bytes))
    else {
        return bundle(bytes);
    };
    let chunks = chunks
        .iter()
        .map(|chunk| (chunk.index, chunk.payload.to_vec()));
    contents.chunks = chunks.collect();
    if let Ok(bundle) = Bundle::from_contents(contents) {
        look_up(&bundle);
    }
}

/// Changes, inserts, removes or copies a few of the bytes.
pub fn change(bytes: &mut Vec<u8>, stream: &mut Stream) {
    const TELLING: [u8; 10] = [0, 1, 2, 127, 128, 253, 254, 255, b'"', b'\n'];
    let at = (stream.bits() % (bytes.len() as u64 + 1)) as usize;
    let run = (1 + stream.bits() % 8).min((bytes.len() - at) as u64) as usize;
    match stream.bits() % 7 {
        0 if run > 0 => bytes[at] ^= 1 << (stream.bits() % 8),
        1 if run > 0 => bytes[at] = TELLING[(stream.bits() % 10) as usize],
        2 => drop(bytes.drain(at..at + run)),
        3 => drop(bytes.splice(at..at, (0..run).map(|_| stream.bits() as u8))),
        4 => bytes.extend_from_within(at..at + run),
        5 => {
            let copy = bytes[at..at + run].to_vec();
            let to = (stream.bits() % (bytes.len() as u64 + 1)) as usize;
            drop(bytes.splice(to..to, copy));
        }
        _ => bytes[at..at + run].fill_with(|| stream.bits() as u8),
    }
}

/// The most bundles that are kept decoded: of those that mutations begin with there are a dozen.
const KEPT: usize = 32;

thread_local! {
    /// The bundles decoded last, by their bytes: hostile chunks are put into the same few again and again.
    static DECODED: RefCell<HashMap<Vec<u8>, Contents>> = RefCell::default();
}

/// Decodes a bundle, or remembers it.
fn decoded(bytes: &[u8]) -> Option<Contents> {
    DECODED.with_borrow_mut(|known| {
        if let Some(contents) = known.get(bytes) {
            return Some(contents.clone());
        }
        let contents = Contents::decode("fuzz", bytes).ok()?;
        if known.len() == KEPT {
            known.clear();
        }
        known.insert(bytes.to_vec(), contents.clone());
        Some(contents)
    })
}

/// Writes chunks of valid coding around hostile sizes and numbers into a bundle, which is sealed again.
pub fn hostile(bytes: &[u8]) {
    let Some((key, rest)) = bytes.split_first_chunk::<8>() else {
        return;
    };
    let Some(mut contents) = decoded(rest) else {
        return;
    };
    let mut stream = Stream::new(&[u64::from_le_bytes(*key)]);
    let axes = contents.header.plan.nodes.len();
    for (_, payload) in &mut contents.chunks {
        *payload = hostile_chunk(axes, &mut stream);
    }
    if let Ok(bytes) = contents.encode() {
        bundle(&bytes);
    }
}

/// Makes a chunk of a few patches of any shape over so many axes, and noise for its numbers.
fn hostile_chunk(axes: usize, stream: &mut Stream) -> Vec<u8> {
    let mut structure = Vec::new();
    let mut integers = 0_u64;
    for _ in 0..stream.bits() % 4 {
        structure.push((stream.bits() % axes as u64) as u8);
        integers += hostile_patch(&mut structure, axes, stream);
    }
    integers += hostile_patch(&mut structure, axes, stream);
    let zeros = stream.bits().is_multiple_of(2);
    let words =
        (0..4 * (stream.bits() % 4000)).map(|_| if zeros { 0 } else { stream.bits() as u8 });
    let words: Vec<u8> = words.collect();
    let mut bytes = (integers.min(u32::MAX.into()) as u32)
        .to_le_bytes()
        .to_vec();
    geofan::bundle::put_bytes(&mut bytes, &words);
    geofan::bundle::put_bytes(&mut bytes, &structure);
    bytes
}

/// Adds one patch of three channels and returns the number of its integers.
fn hostile_patch(structure: &mut Vec<u8>, axes: usize, stream: &mut Stream) -> u64 {
    let mut small = |most: u64| 1 + stream.bits() % (1 << (stream.bits() % most));
    let plain = small(2) == 1;
    structure.extend([254, if plain { 0 } else { 1 }]);
    structure.extend((small(15) as i16 - 1).to_le_bytes());
    let (mut left, mut integers) = (1_u64, 0_u64);
    let cores = if plain { 1 } else { axes };
    for core in 1..=cores {
        let last = core == cores;
        let lengths = if plain { axes } else { 1 };
        let mut shape: Vec<u64> = (0..lengths).map(|_| small(8)).collect();
        shape.extend(last.then_some(3));
        shape.push(if last { 1 } else { small(18) });
        structure.extend(shape.iter().flat_map(|n| (*n as u32).to_le_bytes()));
        let right = shape[shape.len() - 1];
        let product = shape.iter().fold(left, |all, n| all.saturating_mul(*n));
        integers = integers
            .saturating_add(product)
            .saturating_add(if last { 0 } else { right });
        left = right;
    }
    integers
}

/// Reads a text as UTF-8, as the readers of files do.
fn text(bytes: &[u8]) -> Option<Arc<SourceText>> {
    let text = std::str::from_utf8(bytes).ok()?;
    Some(SourceText::new("fuzz.toml", text))
}

/// Compiles a manifold and looks at its metric.
pub fn manifold(bytes: &[u8]) {
    let Some(source) = text(bytes) else { return };
    if let Ok(manifold) = Manifold::from_source(source, &[]) {
        let u = DVec3::new(0.3, -0.2, 0.4);
        let _ = (manifold.metric(u), manifold.fingerprint());
    }
}

/// Reads a scene.
pub fn scene(bytes: &[u8]) {
    if let Some(source) = text(bytes) {
        let _ = SceneFile::parse(source, Path::new("no-such-folder"));
    }
}

/// Reads a mesh.
pub fn mesh(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let _ = Mesh::parse("fuzz.obj", &text, Path::new("no-such-folder"));
}

thread_local! {
    /// A place for files that readers find by their name.
    static FOLDER: RefCell<Option<TempDir>> = const { RefCell::new(None) };
}

/// Writes a file of this name and shows its folder to `read`.
fn with_file(name: &str, bytes: &[u8], read: impl FnOnce(&Path)) {
    FOLDER.with_borrow_mut(|folder| {
        if folder.is_none() {
            *folder = TempDir::new().ok();
        }
        let Some(folder) = folder else { return };
        if fs::write(folder.path().join(name), bytes).is_ok() {
            read(folder.path());
        }
    });
}

/// Reads the materials of a mesh.
pub fn material(bytes: &[u8]) {
    const MESH: &str = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n";
    with_file("m.mtl", bytes, |folder| {
        let _ = Mesh::parse("fuzz.obj", MESH, folder);
    });
}

/// Reads a picture of any kind.
pub fn picture(bytes: &[u8]) {
    with_file("picture", bytes, |folder| {
        let _ = picture::read(&folder.join("picture"));
    });
}

/// Reads poses of a camera.
pub fn camera_path(bytes: &[u8]) {
    if let Some(source) = text(bytes) {
        let _ = PoseFile::parse(source, 90.0);
    }
}

/// Reads a message to the viewer.
pub fn message(bytes: &[u8]) {
    let _ = serde_json::from_slice::<ViewerEvent>(bytes);
}
