//! Which kind of file a mesh comes in, by what is in it.
//!
//! In: the bytes of a file and its name. Out: a [`MeshFormat`] that can be read, or an error that names
//! the format and says what to do. Names lie more often than contents do.

use geofan_core::error::{Error, Result};
use std::path::Path;

/// Formats that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MeshFormat {
    /// Wavefront OBJ.
    Obj,
    /// Stanford's polygon format.
    Ply,
    /// glTF, as text or binary.
    #[cfg(feature = "gltf")]
    Gltf,
}

/// Advice for most files that are not read.
const CONVERT: &str = "convert it to OBJ or PLY, for example with Blender or MeshLab";

/// Formats known by how a file begins: bytes, name, and what to do.
const KNOWN: &[(&[u8], &str, &str)] = &[
    (b"\xff\xfe", "UTF-16 text", SAVE_AS_UTF_8),
    (b"\xfe\xff", "UTF-16 text", SAVE_AS_UTF_8),
    (b"Kaydara FBX Binary", "an FBX file", CONVERT),
    (b"; FBX", "an FBX file", CONVERT),
    (
        b"BLENDER",
        "a Blender file",
        "export it as OBJ from Blender",
    ),
    (
        b"\x28\xb5\x2f\xfd",
        "a compressed file (perhaps of Blender)",
        UNPACK,
    ),
    (b"\x1f\x8b", "a compressed file", UNPACK),
    (
        b"PK\x03\x04",
        "a ZIP archive (as 3MF and USDZ files are)",
        UNPACK,
    ),
    (b"<?xml", "an XML file (perhaps COLLADA or X3D)", CONVERT),
    (b"<COLLADA", "a COLLADA file", CONVERT),
    (b"OFF\n", "an OFF file", CONVERT),
    (b"OFF\r", "an OFF file", CONVERT),
    (b"COFF", "an OFF file", CONVERT),
    (b"#usda", "a USD file", CONVERT),
    (b"PXR-USDC", "a USD file", CONVERT),
    (
        b"ISO-10303-21",
        "a STEP file",
        "tessellate it and export it as OBJ",
    ),
    (b"AC10", "a DWG file", CONVERT),
    (b"MM", "a 3DS file", CONVERT),
    (b"\x89PNG", "a PNG picture", "name a mesh instead"),
];

const SAVE_AS_UTF_8: &str = "save it as UTF-8 (most editors offer that under `Save as`)";
const UNPACK: &str = "unpack it, or export the mesh as OBJ";

impl MeshFormat {
    /// Returns the format of the file with these first bytes.
    pub(super) fn of(path: &Path, bytes: &[u8]) -> Result<Self> {
        if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
            return Ok(Self::Ply);
        }
        #[cfg(feature = "gltf")]
        if is_gltf(bytes) {
            return Ok(Self::Gltf);
        }
        let known = KNOWN.iter().find(|(start, ..)| bytes.starts_with(start));
        let known = known.map(|(_, name, advice)| (*name, *advice));
        let found = known
            .or_else(|| stl(bytes))
            .or_else(|| gltf(bytes))
            .or_else(|| binary(bytes));
        match found {
            Some((name, advice)) => {
                let message = format!("is {name}, which is not read; {advice}");
                Err(Error::input(path.display().to_string(), message))
            }
            None => Ok(Self::Obj),
        }
    }
}

/// Recognises a binary STL file by the number of triangles that it gives: it has no other mark.
fn stl(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    let count = bytes.get(80..84).and_then(|n| n.try_into().ok());
    let size = count.map(|n: [u8; 4]| 84 + 50 * u64::from(u32::from_le_bytes(n)));
    let start = &bytes[..bytes.len().min(1024)];
    let text = bytes.starts_with(b"solid") && contains(start, b"facet");
    (text || size == Some(bytes.len() as u64)).then_some(("an STL file", CONVERT))
}

fn is_gltf(bytes: &[u8]) -> bool {
    let json = bytes.trim_ascii_start().starts_with(b"{");
    bytes.starts_with(b"glTF") || json && contains(bytes, b"\"asset\"")
}

/// Names a glTF file, for a program that does not read it.
fn gltf(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    is_gltf(bytes).then_some((
        "a glTF file",
        "build the program with its feature `gltf`, or convert it to OBJ",
    ))
}

/// Recognises what is no text by its zeros; one in every other byte is UTF-16 without its mark.
fn binary(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    let start = &bytes[..bytes.len().min(64)];
    let zeros =
        |first: usize| start.len() > 3 && start.iter().skip(first).step_by(2).all(|b| *b == 0);
    match start.contains(&0) {
        false => None,
        true if zeros(0) != zeros(1) => Some(("UTF-16 text", SAVE_AS_UTF_8)),
        true => Some(("a binary file of an unknown kind", CONVERT)),
    }
}

fn contains(bytes: &[u8], word: &[u8]) -> bool {
    bytes.windows(word.len()).any(|w| w == word)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(bytes: &[u8]) -> String {
        let found = MeshFormat::of(Path::new("a.obj"), bytes);
        found.map_or_else(|e| e.to_string(), |f| format!("{f:?}"))
    }

    #[test]
    fn texts_of_objects_are_taken_as_such() {
        assert_eq!(told(b"ply\nformat ascii 1.0\n"), "Ply");
        let texts = [
            "",
            "v 1 2 3\n",
            "# Kaydara\n",
            "o plyers\n",
            "solid\n",
            "{\n",
            "mtllib MM.mtl\n",
        ];
        for text in texts {
            assert_eq!(told(text.as_bytes()), "Obj", "{text}");
        }
    }

    #[test]
    fn other_files_are_named_with_what_to_do() {
        let utf16 =
            |text: &str| -> Vec<u8> { text.encode_utf16().flat_map(u16::to_le_bytes).collect() };
        let stl = [&[0; 80][..], &1_u32.to_le_bytes(), &[7; 50]].concat();
        let cases: [(&[u8], &str, &str); 9] = [
            (&utf16("\u{feff}v 1 2 3\n"), "UTF-16", "save it as UTF-8"),
            (&utf16("v 1 2 3\n"), "UTF-16", "save it as UTF-8"),
            (&stl, "an STL file", "convert it to OBJ or PLY"),
            (
                b"solid cube\n facet normal 0 0 1\n",
                "an STL file",
                "convert it to OBJ",
            ),
            (b"PK\x03\x04...", "a ZIP archive", "unpack it"),
            (b"Kaydara FBX Binary  \0", "an FBX file", "convert"),
            (b"BLENDER-v300", "a Blender file", "export it as OBJ"),
            (b"<?xml version=\"1.0\"?>", "an XML file", "convert"),
            (b"\x01\x02\0\x03\x04\x05", "a binary file", "convert"),
        ];
        for (bytes, name, advice) in cases {
            let message = told(bytes);
            assert!(message.starts_with("a.obj: is "), "{message}");
            assert!(
                message.contains(name) && message.contains(advice),
                "{message}"
            );
        }
    }
}
