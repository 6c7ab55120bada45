//! Writing a scene as a page that needs no server.
//!
//! In: a loaded space and the viewer for browsers, compiled to WebAssembly. Out: one HTML file with everything
//! inside, compressed and in base 64; or a folder with the same in files, for a static host. The page carries
//! the files that the scene was loaded from, and loads them like the program does; it asks nobody for anything.

use super::loading::{LoadedSpace, SpaceSource};
use base64::{Engine, engine::general_purpose::STANDARD};
use geofan_core::{Error, Result, files::write_atomically, reading::read_file};
use geofan_light::EVEN;
use geofan_view::{Package, PageAbout, encode_light, ui};
use miniz_oxide::deflate::compress_to_vec;
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};

/// A page that has been written.
pub struct WrittenPage {
    /// The file, or the folder.
    pub output: PathBuf,
    /// Bytes of all files.
    pub bytes: usize,
}

/// Name of the viewer for browsers.
const WASM: &str = "geofan-web.wasm";

/// Compression of what a page carries: the strongest that pays.
const LEVEL: u8 = 9;

/// Most bytes of the viewer for browsers.
const MOST_OF_WASM: u64 = 64 << 20;

/// Writes the page of the space of `source` into `output`.
///
/// # Errors
/// Whatever is wrong with its files; there is no viewer for browsers; the place cannot be written.
pub fn write(
    source: &SpaceSource,
    settings: &[(String, f64)],
    wasm: Option<&Path>,
    output: &Path,
) -> Result<WrittenPage> {
    let wasm = read_wasm(wasm)?;
    let loaded = source.load(settings, None)?;
    if source.bundle.is_some() && loaded.draw.bundle().is_none() {
        let message = "it was baked from another manifold than the scene's";
        return Err(Error::input("--bundle", message));
    }
    let package = pack(source, &loaded, settings)?;
    let [wasm, space] = [&wasm, &package.encode()].map(|bytes| compress_to_vec(bytes, LEVEL));
    let title = title(&loaded);
    let is_file = output
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("html"));
    let files = match is_file {
        true => vec![(
            output.to_path_buf(),
            single_file(&title, &wasm, &space)?.into_bytes(),
        )],
        false => {
            fs::create_dir_all(output).map_err(|e| Error::io(output, e))?;
            let named = |name: &str, bytes: Vec<u8>| (output.join(name), bytes);
            vec![
                named("geofan-web.wasm.deflate", wasm),
                named("space.deflate", space),
                named("worker.js", ui::WORKER.into()),
                named("style.css", ui::STYLE.into()),
                named("viewer.js", ui::single_script().into_bytes()),
                named("index.html", folder_page(&title)?.into_bytes()),
            ]
        }
    };
    for (path, bytes) in &files {
        write_atomically(path, |out| out.write_all(bytes))?;
    }
    Ok(WrittenPage {
        output: output.to_path_buf(),
        bytes: files.iter().map(|(_, bytes)| bytes.len()).sum(),
    })
}

/// Reads the viewer for browsers.
fn read_wasm(asked: Option<&Path>) -> Result<Vec<u8>> {
    let beside = std::env::current_exe().ok();
    let beside = beside.and_then(|program| Some(program.parent()?.join(WASM)));
    let path = match asked {
        Some(path) => path.to_path_buf(),
        None => beside.filter(|path| path.is_file()).ok_or_else(|| {
            let message = format!(
                "there is no {WASM} beside this program; build it with .ci/page.sh, or say where it is with --wasm FILE"
            );
            Error::input("--page", message)
        })?,
    };
    let bytes = read_file(&path, b"\0asm", MOST_OF_WASM)?;
    match bytes.starts_with(b"\0asm") {
        true => Ok(bytes),
        false => Err(Error::input(
            path.display().to_string(),
            "is not WebAssembly",
        )),
    }
}

/// Packs all files of the space.
fn pack(source: &SpaceSource, loaded: &LoadedSpace, settings: &[(String, f64)]) -> Result<Package> {
    let made = loaded.made.iter().cloned();
    let mut files: Vec<(PathBuf, Vec<u8>)> = Vec::new();
    let scene_first = [&loaded.scene].into_iter().chain(&loaded.files);
    for path in scene_first {
        let known = files.iter().any(|(known, _)| known == path);
        let on_disk = !loaded.made.iter().any(|(name, _)| name == path);
        if !known && on_disk && source.bundle.as_ref() != Some(path) && path.is_file() {
            files.push((path.clone(), read_file(path, &[], u64::MAX)?));
        }
    }
    files.extend(made);
    // The scene's name is that of the first.
    files.sort_by_key(|(path, _)| *path != loaded.scene);
    let (mut package, scene) = Package::of_files(files);
    if let Some(bundle) = &source.bundle {
        package.add(PageAbout::BUNDLE, read_file(bundle, &[], u64::MAX)?);
    }
    if let Some(light) = &loaded.draw.stage.world.light {
        package.add(PageAbout::LIGHT, encode_light(light, EVEN));
    }
    let about = PageAbout {
        scene,
        settings: settings.to_vec(),
        length: loaded.draw.length(),
    };
    package.add(PageAbout::NAME, about.encode());
    Ok(package)
}

/// Returns the page's title.
fn title(loaded: &LoadedSpace) -> String {
    let name = &loaded.session.manifold.name;
    let escaped = name.replace('&', "&amp;").replace('<', "&lt;");
    format!("{escaped} · geofan")
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

/// Makes the page that has everything inside.
fn single_file(title: &str, wasm: &[u8], space: &[u8]) -> Result<String> {
    let html = with_head(title, "'none'")?;
    let html = replaced(&html, STYLE, &format!("<style>\n{}</style>", ui::STYLE))?;
    let data =
        |id: &str, text: &str| format!("<script type=\"text/plain\" id=\"{id}\">{text}</script>\n");
    let scripts = [
        data("geofan-wasm", &STANDARD.encode(wasm)),
        data("geofan-space", &STANDARD.encode(space)),
        data("geofan-worker", &STANDARD.encode(ui::WORKER)),
        format!("<script type=\"module\">\n{}</script>", ui::single_script()),
    ];
    replaced(&html, SCRIPT, &scripts.concat())
}

/// Makes the page of a folder.
fn folder_page(title: &str) -> Result<String> {
    let html = with_head(title, "'self'")?;
    replaced(
        &html,
        SCRIPT,
        "<script type=\"module\" src=\"viewer.js\"></script>",
    )
}
