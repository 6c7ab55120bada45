//! Which kind of file a mesh comes in, by what is in it; its text as statements; and the files that it names.
//!
//! In: the bytes of a file and its name. Out: a [`MeshFormat`] that can be read, or an error that names
//! the format and says what to do. Names lie more often than contents do.
//!
//! In: the bytes of an OBJ or MTL file. Out: text with line feeds only and every statement on a line ([`decoded`],
//! [`joined`]), and its [`statements`], each with the number that an editor shows for where it begins.

use geofan_core::{
    error::{Error, Result},
    reading::exists,
};
use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

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

/// Most folders of a path from another machine under which a file is looked for.
const MOST_FOLDERS: usize = 64;

/// Returns the file called `name` in one of `folders`: as it is named, else by ever less of its path, which may
/// be of another machine, else without regard to capitals.
pub(super) fn located(name: &str, folders: &[&Path]) -> Option<PathBuf> {
    let name = name.replace('\\', "/");
    let parts: Vec<&str> = name.split('/').collect();
    if parts.last().is_none_or(|last| last.is_empty()) {
        return None;
    }
    let deepest = parts.len().saturating_sub(MOST_FOLDERS).max(1);
    let shorter = (deepest..parts.len()).map(|from| parts[from..].join("/"));
    let names: Vec<String> = std::iter::once(name.clone())
        .chain(shorter)
        .filter(|n| !n.is_empty())
        .collect();
    let paths = || {
        names
            .iter()
            .flat_map(|name| folders.iter().map(move |f| f.join(name)))
    };
    paths()
        .find(|path| exists(path) && path.is_file())
        .or_else(|| paths().find_map(|path| in_capitals(&path)))
}

/// Returns the file in the folder of `path` whose name differs from its by capitals alone.
fn in_capitals(path: &Path) -> Option<PathBuf> {
    let folder = path.parent().filter(|f| !f.as_os_str().is_empty());
    let files = std::fs::read_dir(folder.unwrap_or(Path::new("."))).ok()?;
    let name = path.file_name()?.to_string_lossy().to_lowercase();
    let same = files
        .flatten()
        .filter(|file| file.file_name().to_string_lossy().to_lowercase() == name);
    let mut same: Vec<PathBuf> = same
        .map(|file| file.path())
        .filter(|path| path.is_file())
        .collect();
    same.sort();
    same.into_iter().next()
}

/// Returns the text in the bytes: without the mark that some editors put in front, with line feeds for the
/// line ends of other systems. Bytes that are not UTF-8 are read as Latin-1, which has a character
/// for each, so that names of materials and files stay apart.
pub(super) fn decoded(bytes: &[u8]) -> Cow<'_, str> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let text = match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => bytes.iter().map(|b| char::from(*b)).collect(),
    };
    match text.contains('\r') {
        true => Cow::Owned(text.replace("\r\n", "\n").replace('\r', "\n")),
        false => text,
    }
}

/// Returns the text with every line that ends in a backslash joined with the next. Blank lines take the place
/// of what has moved up, so that numbers of lines stay. A backslash at the end of a comment is part
/// of a path more often than not, and joins nothing.
pub(super) fn joined(text: &str) -> Cow<'_, str> {
    let part = |line: &str| -> Option<usize> {
        let part = line.trim_end().strip_suffix('\\')?;
        (!part.contains('#')).then_some(part.len())
    };
    if !text.contains('\\') || !text.lines().any(|line| part(line).is_some()) {
        return Cow::Borrowed(text);
    }
    let mut whole = String::with_capacity(text.len() + 1);
    let mut moved = 0;
    for line in text.lines() {
        if let Some(length) = part(line) {
            whole.push_str(&line[..length]);
            whole.push(' ');
            moved += 1;
            continue;
        }
        whole.push_str(line);
        (0..=moved).for_each(|_| whole.push('\n'));
        moved = 0;
    }
    Cow::Owned(whole)
}

/// A statement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Statement<'a> {
    /// The line in which it begins; the first is 1.
    pub line: usize,
    /// Its first word.
    pub key: &'a str,
    /// The rest of the line, with the comment at its end if there is one: names may hold a `#`.
    pub whole: &'a str,
    /// The rest of the line, without the comment.
    pub rest: &'a str,
}

/// The start of comments in which ZBrush writes the colours of vertices.
pub(super) const PAINT: &str = "#MRGB";

/// Returns the statements of a text, in order; lines that are empty or comments are none, but for [`PAINT`].
pub(super) fn statements(text: &str) -> impl Iterator<Item = Statement<'_>> {
    text.lines().enumerate().filter_map(|(i, line)| {
        let line = line.trim();
        let (key, whole) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let whole = whole.trim_start();
        let means = !key.is_empty() && (!key.starts_with('#') || key == PAINT);
        means.then(|| Statement {
            line: i + 1,
            key,
            whole,
            rest: without_comment(whole),
        })
    })
}

/// Returns what stands before a comment.
pub(super) fn without_comment(text: &str) -> &str {
    text.split('#').next().unwrap_or_default().trim_end()
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

    #[test]
    fn line_ends_of_all_systems_and_the_mark_of_editors_are_taken_away() {
        let bytes = b"\xef\xbb\xbfv 1\r\nv 2\rv 3\n";
        assert_eq!(decoded(bytes), "v 1\nv 2\nv 3\n");
        assert_eq!(decoded(b"newmtl B\xe4ume"), "newmtl B\u{e4}ume");
        assert_eq!(decoded("newmtl B\u{e4}ume".as_bytes()), "newmtl B\u{e4}ume");
    }

    #[test]
    fn statements_know_where_they_begin_and_where_their_comments_do() {
        let text = "# C:\\models\\\n\n\tf 1 \\\n 2 \\ \n3 # front\nusemtl\tMaterial #25\n\\\n\ng\n";
        let whole = joined(text);
        let found: Vec<Statement<'_>> = statements(&whole).collect();
        let told: Vec<_> = found.iter().map(|s| (s.line, s.key, s.rest)).collect();
        let known = [
            (3, "f", "1   2  3"),
            (6, "usemtl", "Material"),
            (9, "g", ""),
        ];
        assert_eq!(told, known);
        assert_eq!(found[1].whole, "Material #25");
    }
}
