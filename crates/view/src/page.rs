//! A scene as a page that needs no server.
//!
//! In: where a space comes from and the viewer for browsers, compiled to WebAssembly. Out: one HTML file with
//! everything inside, compressed by LZMA and written as text; or a folder with the same in files, for a static host.
//! The page carries the files that the scene was loaded from, and loads them like the program does; but meshes,
//! pictures and samples are packed, so that it needs no readers of their formats. It asks nobody for anything.
//!
//! Bytes become text that HTML carries unchanged in one of two codes; `ui/unpack.js` undoes both.
//!
//! - Letters, for pages that lie in other texts, a notebook's: 91 letters, two for every 13 bits, the least bits first.
//!   They are all that can be printed but `"`, `&` and `<`, which HTML has a use for. A byte takes 1.23 letters, where
//!   base 64 takes 1.33.
//! - Code units, for pages that are files in UTF-16: two bytes are the number of one code unit, the first the lower
//!   half. Of all numbers a few are not carried unchanged; [`ESCAPE`] stands before those, and their highest bit is
//!   turned. Compressed bytes take up 1.03 bytes each.

use crate::{
    LoadedSpace, Package, PageAbout, SpaceSource, encode_light,
    loaded_space::{packed, placements},
    ui::{self, opening_script, single_script, worker_script},
};
use geofan_core::{
    Error, Result,
    files::{check_not_read, check_output, make_output_folder, write_atomically},
    reading::read_file,
};
use geofan_light::even_points;
use geofan_render::scene::{pack_cuts, pack_points};
use lzma_rust2::{LzmaOptions, LzmaWriter};
use std::{
    io::Write,
    path::{Path, PathBuf},
};

/// Compression of what a page carries: the strongest.
const LEVEL: u32 = 9;

/// Most bytes of the viewer for browsers.
const MOST_OF_WASM: u64 = 64 << 20;

/// A page of a space, made and not yet written.
pub struct Page {
    title: String,
    /// The viewer for browsers, compressed.
    wasm: Vec<u8>,
    /// The package of the space, compressed.
    space: Vec<u8>,
    /// All files that were read for it.
    read: Vec<PathBuf>,
    warnings: Vec<String>,
}

impl Page {
    /// Name of the viewer for browsers.
    pub const WASM: &str = "geofan-web.wasm";

    /// Makes the page of the space of `source`, with these parameters of its manifold; `wasm` is the file of the
    /// viewer for browsers.
    ///
    /// # Errors
    /// Whatever is wrong with any file.
    pub fn new(source: &SpaceSource, settings: &[(String, f64)], wasm: &Path) -> Result<Self> {
        let mut read = vec![wasm.to_path_buf()];
        let wasm = read_wasm(wasm)?;
        let loaded = source.load_with_bundle(settings)?;
        read.extend_from_slice(&loaded.files);
        let package = pack(source, &loaded, settings)?;
        // Whoever writes a page that would not open is told here.
        PageAbout::open(&package, None)?;
        PageAbout::open_session(&package, None)?;
        let name = &loaded.session.manifold.name;
        let escaped = name.replace('&', "&amp;").replace('<', "&lt;");
        Ok(Self {
            title: format!("{escaped} · geofan"),
            wasm: compressed(&wasm)?,
            space: compressed(&package.encode())?,
            read,
            warnings: loaded.warnings().map(String::from).collect(),
        })
    }

    /// Returns what is doubtful about the scene, in words.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Returns the page as one HTML text that has everything inside, in letters that other texts carry, too.
    ///
    /// # Errors
    /// The user interface lacks a part that is to be replaced.
    pub fn html(&self) -> Result<String> {
        let scripts = scripts().map(|(id, kind, text)| script(id, kind, &text));
        self.whole(in_letters, ui::STYLE, &scripts.concat())
    }

    /// Returns the bytes of the page as one HTML file, in UTF-16. Letters take two bytes there, and compressed bytes
    /// hardly more than one; so style sheet and scripts are compressed, but for the one that unpacks them.
    fn file(&self) -> Result<Vec<u8>> {
        let style = ("", "text/css", ui::STYLE.to_owned());
        let parts: Vec<_> = [style].into_iter().chain(scripts()).collect();
        let listed = serde_json::to_vec(&parts).expect("texts are JSON");
        let packed = script(
            "geofan-scripts",
            "text/plain",
            &in_code_units(&compressed(&listed)?),
        );
        let opening = script("geofan-opening", "module", &opening_script());
        let page = self.whole(in_code_units, UNSTYLED, &(packed + &opening))?;
        Ok(utf16_file(&page))
    }

    /// Returns the page with everything inside: what is compressed as text, its style sheet and its scripts.
    fn whole(&self, text: impl Fn(&[u8]) -> String, style: &str, scripts: &str) -> Result<String> {
        let html = with_head(&self.title, "'none'")?;
        let html = replaced(&html, STYLE, &format!("<style>\n{style}</style>"))?;
        let data = |id: &str, bytes: &[u8]| script(id, "text/plain", &text(bytes));
        let parts = data("geofan-wasm", &self.wasm) + &data("geofan-space", &self.space) + scripts;
        replaced(&html, SCRIPT, &parts)
    }

    /// Writes the page: one file where `output` is named `.html` or `.htm`, else a folder. Returns the bytes of all files.
    ///
    /// # Errors
    /// The place cannot be written, or a file that was read for the page, or one of something else, would be replaced.
    pub fn write(&self, output: &Path) -> Result<usize> {
        let named = |ending: &str| {
            let extension = output.extension();
            extension.is_some_and(|e| e.eq_ignore_ascii_case(ending))
        };
        let is_file = named("html") || named("htm");
        let files = match is_file {
            true => {
                check_output(output)?;
                vec![(output.to_path_buf(), self.file()?)]
            }
            false => {
                make_output_folder(output)?;
                let files = self.folder(output)?;
                refuse_foreign(output, &files)?;
                files
            }
        };
        for (path, _) in &files {
            check_not_read(path, &self.read)?;
        }
        for (path, bytes) in &files {
            write_atomically(path, |out| out.write_all(bytes))?;
        }
        Ok(files.iter().map(|(_, bytes)| bytes.len()).sum())
    }

    /// Makes the files of a folder.
    fn folder(&self, output: &Path) -> Result<Vec<(PathBuf, Vec<u8>)>> {
        let named = |name: &str, bytes: Vec<u8>| (output.join(name), bytes);
        let script = "<script type=\"module\" src=\"viewer.js\"></script>";
        let index = replaced(&with_head(&self.title, "'self'")?, SCRIPT, script)?;
        Ok(vec![
            named("geofan-web.wasm.lzma", self.wasm.clone()),
            named("space.lzma", self.space.clone()),
            named("worker.js", worker_script().into_bytes()),
            named("style.css", ui::STYLE.into()),
            named("viewer.js", single_script().into_bytes()),
            named("index.html", index.into_bytes()),
        ])
    }
}

/// Refuses a folder that has some of the `files` of a page, but not all: those are of something else.
fn refuse_foreign(folder: &Path, files: &[(PathBuf, Vec<u8>)]) -> Result<()> {
    let there = || {
        files
            .iter()
            .map(|(path, _)| path)
            .filter(|path| path.exists())
    };
    match there().next() {
        Some(path) if there().count() < files.len() => {
            let name = path.file_name().unwrap_or_default().display();
            let message = format!(
                "holds {name}, which would be replaced, and is no page of geofan; remove that file, or name another folder"
            );
            Err(Error::input(folder.display().to_string(), message))
        }
        _ => Ok(()),
    }
}

/// Returns what runs in a page of one file: the text of its workers, and its own script. Of each an identity, the kind of
/// script, and the text.
fn scripts() -> [(&'static str, &'static str, String); 2] {
    [
        ("geofan-worker", "text/plain", worker_script()),
        ("geofan-viewer", "module", single_script()),
    ]
}

/// Writes a script of a page.
fn script(id: &str, kind: &str, text: &str) -> String {
    format!("<script type=\"{kind}\" id=\"{id}\">{text}</script>\n")
}

/// Compresses bytes by LZMA, with the length in the head. Nothing in them is aligned to whole words, so that where
/// a byte stands says nothing about it.
fn compressed(bytes: &[u8]) -> Result<Vec<u8>> {
    let failed = |e: std::io::Error| Error::input("page", format!("cannot be compressed: {e}"));
    let options = LzmaOptions {
        pb: 0,
        ..LzmaOptions::with_preset(LEVEL)
    };
    let length = bytes.len() as u64;
    let mut writer =
        LzmaWriter::new_use_header(Vec::new(), &options, Some(length)).map_err(failed)?;
    writer.write_all(bytes).map_err(failed)?;
    writer.finish().map_err(failed)
}

/// Reads the viewer for browsers.
fn read_wasm(path: &Path) -> Result<Vec<u8>> {
    let bytes = read_file(path, b"\0asm", MOST_OF_WASM)?;
    match bytes.starts_with(b"\0asm") {
        true => Ok(bytes),
        false => Err(Error::input(
            path.display().to_string(),
            "is not WebAssembly",
        )),
    }
}

/// Packs all files of the space that its page reads.
fn pack(source: &SpaceSource, loaded: &LoadedSpace, settings: &[(String, f64)]) -> Result<Package> {
    let mut files = packed(source, loaded)?;
    // The scene's name is that of the first.
    files.sort_by_key(|(path, _)| *path != loaded.scene);
    let (mut package, scene) = Package::of_files(files);
    if let Some(bundle) = &source.bundle {
        package.add(PageAbout::BUNDLE, read_file(bundle, &[], u64::MAX)?);
    }
    let world = &loaded.draw.stage.world;
    if let Some(light) = &world.light {
        package.add(PageAbout::LIGHT, encode_light(light, even_points(world)));
    }
    let (cuts, points): (Vec<_>, Vec<_>) = placements(loaded)?.into_iter().unzip();
    package.add(PageAbout::CUTS, pack_cuts(&cuts));
    package.add(PageAbout::POINTS, pack_points(&points));
    let about = PageAbout {
        scene,
        settings: settings.to_vec(),
        length: loaded.draw.length(),
    };
    package.add(PageAbout::NAME, about.encode());
    Ok(package)
}

/// Returns the rights of a page: it may run its own content. A folder's page reads its own files, too.
fn policy(connect: &str) -> String {
    format!(
        "default-src 'none'; script-src 'unsafe-inline' 'self' 'wasm-unsafe-eval' blob:; style-src 'unsafe-inline' 'self'; img-src data: blob:; worker-src blob: 'self'; connect-src {connect}; base-uri 'none'; form-action 'none'"
    )
}

/// Replaces a part of the user interface's page that must be there.
fn replaced(html: &str, part: &str, by: &str) -> Result<String> {
    match html.contains(part) {
        true => Ok(html.replacen(part, by, 1)),
        false => Err(Error::input("index.html", format!("lacks {part}"))),
    }
}

/// What a page looks like before its style sheet is unpacked: nothing is seen but the background and a word that it opens.
const UNSTYLED: &str =
    "html { visibility: hidden; background: #000; } #hint { visibility: visible; color: #fff; }";

const TITLE: &str = "<title>geofan</title>";
const STYLE: &str = r#"<link rel="stylesheet" href="style.css">"#;
const SCRIPT: &str = r#"<script type="module" src="served.js"></script>"#;

fn with_head(title: &str, connect: &str) -> Result<String> {
    let head = format!(
        "<meta http-equiv=\"Content-Security-Policy\" content=\"{}\">\n<title>{title}</title>",
        policy(connect)
    );
    replaced(ui::HTML, TITLE, &head)
}

/// Bits of two letters.
const BITS_OF_TWO: u32 = 13;

/// The code unit before one that stands for another: the first for private use.
const ESCAPE: u16 = 0xE000;

/// The highest bit of a code unit. Turned, no code unit that is not carried unchanged remains one.
const TURNED: u16 = 0x8000;

/// What a file in UTF-16 begins with, the lower halves first. It goes before whatever a server tells of the encoding.
const BYTE_ORDER_MARK: [u8; 2] = [0xFF, 0xFE];

/// Writes bytes in letters.
fn in_letters(bytes: &[u8]) -> String {
    let letters: Vec<char> = ('!'..='~')
        .filter(|c| !['"', '&', '<'].contains(c))
        .collect();
    let mut text = String::with_capacity(bytes.len() / 4 * 5 + 8);
    let (mut held, mut count) = (0_u32, 0);
    let mut put = |two: usize| {
        text.push(letters[two % letters.len()]);
        text.push(letters[two / letters.len()]);
    };
    for byte in bytes {
        held |= u32::from(*byte) << count;
        count += 8;
        if count >= BITS_OF_TWO {
            put((held & ((1 << BITS_OF_TWO) - 1)) as usize);
            held >>= BITS_OF_TWO;
            count -= BITS_OF_TWO;
        }
    }
    if count > 0 {
        put(held as usize);
    }
    text
}

/// Writes bytes in code units of UTF-16. A single last byte is followed by a zero.
fn in_code_units(bytes: &[u8]) -> String {
    let units = bytes.chunks(2).flat_map(|two| {
        let unit = u16::from_le_bytes([two[0], *two.get(1).unwrap_or(&0)]);
        match is_carried(unit) {
            true => [Some(unit), None],
            false => [Some(ESCAPE), Some(unit ^ TURNED)],
        }
    });
    char::decode_utf16(units.flatten())
        .map(|c| c.expect("no half of a pair is carried"))
        .collect()
}

/// Tells whether a code unit comes through HTML in UTF-16 as it is: halves of pairs, the zero, line ends that are
/// made equal, what may end a script, and the mark itself do not.
fn is_carried(unit: u16) -> bool {
    let is_half = (0xD800..0xE000).contains(&unit);
    !is_half && ![0, u16::from(b'\r'), u16::from(b'<'), ESCAPE].contains(&unit)
}

/// Encodes a page as a file in UTF-16.
fn utf16_file(text: &str) -> Vec<u8> {
    let units = text.encode_utf16().flat_map(u16::to_le_bytes);
    BYTE_ORDER_MARK.into_iter().chain(units).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Undoes [`in_letters`], as the page does.
    fn bytes_of_letters(text: &str) -> Vec<u8> {
        let letters: Vec<char> = ('!'..='~')
            .filter(|c| !['"', '&', '<'].contains(c))
            .collect();
        let values: Vec<usize> = text
            .chars()
            .map(|c| letters.iter().position(|l| *l == c).unwrap())
            .collect();
        let (mut held, mut count, mut bytes) = (0_usize, 0, Vec::new());
        for two in values.chunks_exact(2) {
            held |= (two[0] + 91 * two[1]) << count;
            count += 13;
            while count >= 8 {
                bytes.push(held as u8);
                held >>= 8;
                count -= 8;
            }
        }
        bytes.truncate(text.len() / 2 * 13 / 8);
        bytes
    }

    /// Undoes [`in_code_units`], as the page does.
    fn bytes_of_code_units(text: &str) -> Vec<u8> {
        let mut units = text.encode_utf16();
        let mut bytes = Vec::new();
        while let Some(unit) = units.next() {
            let meant = match unit == ESCAPE {
                true => units.next().unwrap() ^ TURNED,
                false => unit,
            };
            bytes.extend(meant.to_le_bytes());
        }
        bytes
    }

    #[test]
    fn bytes_come_back_with_at_most_one_more() {
        for length in 0..100_usize {
            let bytes: Vec<u8> = (0..length).map(|i| (i * 89 + length * 7) as u8).collect();
            for back in [
                bytes_of_letters(&in_letters(&bytes)),
                bytes_of_code_units(&in_code_units(&bytes)),
            ] {
                assert!(
                    back.starts_with(&bytes) && back.len() <= length + 1,
                    "{length}"
                );
            }
        }
    }

    #[test]
    fn every_pair_of_bytes_is_carried() {
        let bytes: Vec<u8> = (0..=u16::MAX).flat_map(u16::to_le_bytes).collect();
        let text = in_code_units(&bytes);
        assert!(!text.contains(['\0', '\r', '<']));
        assert_eq!(bytes_of_code_units(&text), bytes);
        let file = utf16_file(&text);
        assert_eq!(file.len(), 2 + 2 * (65536 + 2048 + 4));
    }
}
