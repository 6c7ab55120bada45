//! A scene as a page that needs no server.
//!
//! In: where a space comes from and the viewer for browsers, compiled to WebAssembly. Out: one HTML file with
//! everything inside, compressed by LZMA and written as text ([`crate::page_text`]); or a folder with the same in
//! files, for a static host. The page carries the files that the scene was loaded from, and loads them like the
//! program does; but meshes, pictures and samples are packed, so that it needs no readers of their formats. It asks
//! nobody for anything.

use crate::{
    LoadedSpace, Package, PageAbout, SpaceSource, encode_light,
    loaded_space::{packed, placements},
    page_text::{in_code_units, in_letters, utf16_file},
    ui::{self, opening_script, single_script, worker_script},
};
use geofan_core::{
    Error, Result,
    files::{check_output, make_output_folder, write_atomically},
    reading::read_file,
};
use geofan_light::EVEN;
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
        let wasm = read_wasm(wasm)?;
        let loaded = source.load_with_bundle(settings)?;
        let package = pack(source, &loaded, settings)?;
        // Whoever writes a page that would not open is told here.
        PageAbout::open(&package, None)?;
        let name = &loaded.session.manifold.name;
        let escaped = name.replace('&', "&amp;").replace('<', "&lt;");
        Ok(Self {
            title: format!("{escaped} · geofan"),
            wasm: compressed(&wasm)?,
            space: compressed(&package.encode())?,
        })
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
    /// The place cannot be written.
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
                self.folder(output)?
            }
        };
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
    if let Some(light) = &loaded.draw.stage.world.light {
        package.add(PageAbout::LIGHT, encode_light(light, EVEN));
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

/// What a page looks like before its style sheet is unpacked: nothing is seen but the background.
const UNSTYLED: &str = "html { visibility: hidden; background: #000; }";

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
