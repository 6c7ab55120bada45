//! The bytes of a glTF file and of what it names.
//!
//! In: a `.gltf` or `.glb` file. Out: its document, and numbers and pictures out of its buffers. Every
//! range is checked: the reader of the crate `gltf` stops the program where a file lies about one.

use super::formats::located;
use crate::picture::{self, Picture};
use base64::Engine;
use geofan_core::{
    error::{Error, Result},
    reading::{MOST_OF_A_FILE, read_file},
};
use glam::DVec3;
use gltf::{Accessor, Document, Gltf, accessor::DataType, buffer, json::validation::Checked};
use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

/// A glTF document with its buffers.
pub(super) struct Source {
    /// The user's name of the file.
    pub name: String,
    /// Its contents.
    pub document: Document,
    /// Extensions that the file uses and that are not read.
    pub ignored: Vec<String>,
    buffers: Vec<Vec<u8>>,
    folder: PathBuf,
}

/// The numbers of an accessor, `width` for each item.
pub(super) struct Numbers {
    /// Numbers of an item.
    pub width: usize,
    /// All of them.
    pub values: Vec<f64>,
}

impl Numbers {
    /// Returns those of item `i`.
    pub(super) fn item(&self, i: usize) -> &[f64] {
        &self.values[i * self.width..][..self.width]
    }

    /// Returns the first three of item `i`, which has as many.
    pub(super) fn three(&self, i: usize) -> DVec3 {
        DVec3::from_slice(self.item(i))
    }
}

/// Extensions that a file may ask for.
const KNOWN: &[&str] = &[
    "KHR_texture_transform",
    "KHR_materials_unlit",
    "KHR_materials_emissive_strength",
    "KHR_mesh_quantization",
];

/// Most numbers of an accessor without bytes of its own: any number costs a damaged file nothing.
const MOST_ZEROS: usize = 1 << 26;

impl Source {
    /// Reads the file that the user calls `name`; what it names is in `folder`.
    pub(super) fn read(name: &str, bytes: &[u8], folder: &Path) -> Result<Self> {
        let refused = |message: String| Error::input(name, message);
        let gltf = Gltf::from_slice_without_validation(bytes);
        let Gltf { document, blob } = gltf.map_err(|e| match e {
            gltf::Error::Binary(_) => refused(format!("is not a whole binary glTF: {e}")),
            _ => refused(e.to_string()),
        })?;
        let mut json = document.into_json();
        let asked = json.extensions_required.iter();
        if let Some(unknown) = asked.clone().find(|e| !KNOWN.contains(&e.as_str())) {
            let message = format!(
                "needs the extension {unknown}, which is not read; export it without, for example from Blender without compression"
            );
            return Err(refused(message));
        }
        // The crate does not know all that is read here.
        json.extensions_required.clear();
        let used = json.extensions_used.iter();
        let ignored = used.filter(|e| !KNOWN.contains(&e.as_str()));
        let ignored: Vec<String> = ignored.cloned().collect();
        complete(&mut json).map_err(refused)?;
        let document = Document::from_json(json).map_err(|e| refused(e.to_string()))?;
        let mut source = Self {
            name: name.to_owned(),
            document,
            ignored,
            buffers: Vec::new(),
            folder: folder.to_owned(),
        };
        let mut blob = blob;
        for buffer in source.document.clone().buffers() {
            let bytes = match buffer.source() {
                buffer::Source::Bin => blob
                    .take()
                    .ok_or_else(|| String::from("has no binary part")),
                buffer::Source::Uri(uri) => source.file(uri).map(Cow::into_owned),
            };
            source.buffers.push(bytes.map_err(refused)?);
        }
        Ok(source)
    }

    /// Returns the bytes that a URI stands for.
    fn file<'a>(&self, uri: &'a str) -> Result<Cow<'a, [u8]>, String> {
        if let Some(data) = uri.strip_prefix("data:") {
            let (_, coded) = data
                .split_once(";base64,")
                .ok_or("has data that is not base64")?;
            let engine = base64::engine::general_purpose::STANDARD;
            let bytes = engine.decode(coded.trim_end());
            return bytes
                .map(Cow::Owned)
                .map_err(|e| format!("has damaged data: {e}"));
        }
        let path = self.path(uri);
        let bytes = read_file(&path, &[], MOST_OF_A_FILE).map_err(|e| e.to_string());
        bytes.map(Cow::Owned)
    }

    /// Returns the file that a relative URI names.
    fn path(&self, uri: &str) -> PathBuf {
        let name = unescaped(uri);
        located(&name, &[&self.folder]).unwrap_or_else(|| self.folder.join(&name))
    }

    /// Returns the picture of the image with this number.
    pub(super) fn picture(&self, image: usize) -> Result<Picture> {
        let wrong =
            |message: String| Error::input(format!("{}: image {image}", self.name), message);
        let image = &self.document.as_json().images.get(image);
        let image = image.ok_or_else(|| wrong(String::from("is not there")))?;
        if let Some(view) = image.buffer_view {
            let view = self.document.views().nth(view.value());
            let bytes = view.and_then(|view| self.view(&view));
            let bytes = bytes.ok_or_else(|| wrong(String::from("its data ends too early")))?;
            return picture::decode(bytes).map_err(wrong);
        }
        let uri = image.uri.as_deref().unwrap_or_default();
        if uri.starts_with("data:") {
            return picture::decode(&self.file(uri).map_err(wrong)?).map_err(wrong);
        }
        picture::read(&self.path(uri))
    }

    fn view(&self, view: &buffer::View<'_>) -> Option<&[u8]> {
        let bytes = self.buffers.get(view.buffer().index())?;
        bytes.get(view.offset()..view.offset().checked_add(view.length())?)
    }

    /// Returns the numbers of an accessor; whole numbers that are shares of their largest become shares.
    pub(super) fn numbers(&self, accessor: &Accessor<'_>) -> Result<Numbers, String> {
        let early = || format!("accessor {}: its data ends too early", accessor.index());
        let width = accessor.dimensions().multiplicity();
        let format = AccessorFormat {
            of: accessor.data_type(),
            normalized: accessor.normalized(),
        };
        let count = accessor.count();
        let mut values = match accessor.view() {
            Some(view) => {
                let stride = view.stride().unwrap_or(format.of.size() * width);
                let bytes = self.view(&view).and_then(|b| b.get(accessor.offset()..));
                format
                    .items(bytes.ok_or_else(early)?, stride, width, count)
                    .ok_or_else(early)?
            }
            None if count.saturating_mul(width) > MOST_ZEROS => return Err(early()),
            None => vec![0.0; count * width],
        };
        if let Some(sparse) = accessor.sparse() {
            let (places, items) = (sparse.indices(), sparse.values());
            let index = AccessorFormat {
                of: match places.index_type() {
                    gltf::accessor::sparse::IndexType::U8 => DataType::U8,
                    gltf::accessor::sparse::IndexType::U16 => DataType::U16,
                    gltf::accessor::sparse::IndexType::U32 => DataType::U32,
                },
                normalized: false,
            };
            let read =
                |view: buffer::View<'_>, offset: usize, format: AccessorFormat, width: usize| {
                    let stride = view.stride().unwrap_or(format.of.size() * width);
                    let bytes = self.view(&view)?.get(offset..)?;
                    format.items(bytes, stride, width, sparse.count())
                };
            let places = read(places.view(), places.offset(), index, 1).ok_or_else(early)?;
            let items = read(items.view(), items.offset(), format, width).ok_or_else(early)?;
            for (place, item) in places.iter().zip(items.chunks_exact(width)) {
                let at = *place as usize * width;
                values
                    .get_mut(at..at + width)
                    .ok_or_else(early)?
                    .copy_from_slice(item);
            }
        }
        Ok(Numbers { width, values })
    }
}

/// Gives positions the bounds that the crate insists on and nothing here needs, and refuses those that
/// are nowhere, at which the crate stops the program.
fn complete(json: &mut gltf::json::Root) -> Result<(), String> {
    let primitives = json.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let position = Checked::Valid(gltf::Semantic::Positions);
    let indices = primitives.filter_map(|p| p.attributes.get(&position));
    let indices: Vec<usize> = indices.map(|index| index.value()).collect();
    for index in indices {
        let count = json.accessors.len();
        let accessor = json.accessors.get_mut(index);
        let accessor =
            accessor.ok_or_else(|| format!("accessor {index}, but there are {count}"))?;
        let bounds = || Some(gltf::json::Value::from(vec![0.0; 3]));
        accessor.min = accessor.min.take().or_else(bounds);
        accessor.max = accessor.max.take().or_else(bounds);
    }
    Ok(())
}

/// How the numbers of an accessor are stored.
#[derive(Clone, Copy)]
struct AccessorFormat {
    of: DataType,
    normalized: bool,
}

impl AccessorFormat {
    /// Reads `count` items of `width` numbers, `stride` bytes apart; `None` if there are not enough bytes.
    fn items(self, bytes: &[u8], stride: usize, width: usize, count: usize) -> Option<Vec<f64>> {
        let size = self.of.size();
        if stride < size * width {
            return None;
        }
        let last = count.checked_sub(1).map_or(Some(0), |n| {
            n.checked_mul(stride)?.checked_add(size * width)
        });
        if last? > bytes.len() {
            return None;
        }
        let item = |i: usize| (0..width).map(move |k| &bytes[i * stride + k * size..][..size]);
        let all = (0..count).flat_map(item);
        Some(all.map(|bytes| self.number(bytes)).collect())
    }

    fn number(self, bytes: &[u8]) -> f64 {
        let [a, b] = [bytes[0], bytes.get(1).copied().unwrap_or(0)];
        let four = || [0, 1, 2, 3].map(|i| bytes.get(i).copied().unwrap_or(0));
        let (number, full) = match self.of {
            DataType::I8 => (f64::from(a as i8), 127.0),
            DataType::U8 => (f64::from(a), 255.0),
            DataType::I16 => (f64::from(i16::from_le_bytes([a, b])), 32767.0),
            DataType::U16 => (f64::from(u16::from_le_bytes([a, b])), 65535.0),
            DataType::U32 => (f64::from(u32::from_le_bytes(four())), 1.0),
            DataType::F32 => (f64::from(f32::from_le_bytes(four())), 1.0),
        };
        if self.normalized {
            (number / full).max(-1.0)
        } else {
            number
        }
    }
}

/// Returns a URI without its escapes.
fn unescaped(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let mut found = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while i < bytes.len() {
        let digits = uri.get(i + 1..i + 3).filter(|_| bytes[i] == b'%');
        let digits = digits.filter(|two| two.bytes().all(|c| c.is_ascii_hexdigit()));
        match digits.and_then(|two| u8::from_str_radix(two, 16).ok()) {
            Some(byte) => {
                found.push(byte);
                i += 3;
            }
            None => {
                found.push(bytes[i]);
                i += 1;
            }
        }
    }
    String::from_utf8_lossy(&found).into_owned()
}
