//! The user interface's files.
//!
//! Plain HTML, style sheet and ES modules, without a build. The program serves them as they are; the page has
//! them in one file, with the modules put one after another ([`single_script`]).

/// The page's frame.
pub const HTML: &str = include_str!("../ui/index.html");

/// The style sheet.
pub const STYLE: &str = include_str!("../ui/style.css");

/// Modules, each behind those that it imports.
pub const MODULES: [(&str, &str); 9] = [
    ("asked.js", include_str!("../ui/asked.js")),
    ("controls.js", include_str!("../ui/controls.js")),
    ("exr.js", include_str!("../ui/exr.js")),
    ("display.js", include_str!("../ui/display.js")),
    ("panel.js", include_str!("../ui/panel.js")),
    ("chart_map.js", include_str!("../ui/chart_map.js")),
    ("address.js", include_str!("../ui/address.js")),
    ("socket_engine.js", include_str!("../ui/socket_engine.js")),
    ("viewer.js", include_str!("../ui/viewer.js")),
];

/// The module that begins when the program serves the user interface.
pub const SERVED_MAIN: (&str, &str) = ("served.js", include_str!("../ui/served.js"));

/// The engine of the page, and the module that begins there.
pub const PAGE_MODULES: [(&str, &str); 3] = [
    ("unpack.js", include_str!("../ui/unpack.js")),
    ("worker_engine.js", include_str!("../ui/worker_engine.js")),
    ("page.js", include_str!("../ui/page.js")),
];

/// The module that begins where the page's scripts are compressed.
const OPENING: &str = include_str!("../ui/opening.js");

/// What a worker of the page does.
const WORKER: &str = include_str!("../ui/worker.js");

/// Joins the page's modules to one script: names are unique among them, so imports and exports fall away.
pub fn single_script() -> String {
    let modules = MODULES
        .iter()
        .filter(|(name, _)| *name != "socket_engine.js");
    joined(modules.chain(&PAGE_MODULES).map(|(_, text)| *text))
}

/// Joins the script of the page's workers, which unpack, too.
pub fn worker_script() -> String {
    unpacking(WORKER)
}

/// Joins the script that unpacks the others of a page; without its comments, because nothing of it is compressed.
pub fn opening_script() -> String {
    let script = unpacking(OPENING);
    let is_code = |line: &&str| {
        !["//", "/*", "*"]
            .iter()
            .any(|c| line.trim_start().starts_with(c))
    };
    script
        .lines()
        .filter(is_code)
        .flat_map(|line| [line, "\n"])
        .collect()
}

fn unpacking(main: &str) -> String {
    let unpack = PAGE_MODULES.iter().filter(|(name, _)| *name == "unpack.js");
    joined(unpack.map(|(_, text)| *text).chain([main]))
}

fn joined<'t>(texts: impl Iterator<Item = &'t str>) -> String {
    let mut script = String::new();
    for text in texts {
        for line in text.lines().filter(|line| !line.starts_with("import ")) {
            script.push_str(line.strip_prefix("export ").unwrap_or(line));
            script.push('\n');
        }
    }
    script
}
