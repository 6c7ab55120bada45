//! Data flows one way: no stage imports a later one, and there is no unsafe code.
//!
//! The sources are read as text: comments are cut off, then every path from the crate's root is
//! looked at. That is less than a compiler sees, and enough for code that means no harm.

use std::{
    fs,
    path::{Path, PathBuf},
};

/// The stages in order; modules of one line may import each other.
const STAGES: &[&[&str]] = &[
    &[
        "prefetch",
        "spelling",
        "diagnostic",
        "error",
        "files",
        "quantiles",
        "random",
    ],
    &["document"],
    &["expr"],
    &["manifold"],
    &["geodesic"],
    &["fan"],
    &["bundle"],
    &["render"],
];

/// Outside the order: they may import every stage, no stage may import them.
const OUTSIDE: &[&str] = &["terminal", "commands"];

/// What makes crates out of the modules.
const ROOTS: &[&str] = &["lib", "main"];

/// Files that may contain unsafe code, from the repository's root.
const MAY_BE_UNSAFE: &[&str] = &["src/prefetch.rs"];

/// A source file without its comments.
struct Source {
    /// From the repository's root, with `/`.
    path: String,
    code: String,
}

impl Source {
    /// The names of the modules from the crate's root to this file.
    fn modules(&self) -> Vec<&str> {
        let inside = self.path.split_once("src/").map_or("", |(_, rest)| rest);
        let mut names: Vec<_> = inside.trim_end_matches(".rs").split('/').collect();
        if names.last() == Some(&"mod") {
            names.pop();
        }
        names
    }

    /// The modules at the crate's root that it names.
    fn imports(&self) -> Vec<String> {
        let up = "super::".repeat(self.modules().len());
        let mut found: Vec<_> = after(&self.code, "crate::")
            .chain(after(&self.code, "geofan::"))
            .flat_map(first_names)
            .collect();
        // Deep enough a chain of `super` is the root, too; an inline module makes it less deep, so
        // only known names count.
        let above = after(&self.code, &up).flat_map(first_names);
        found.extend(above.filter(|name| rank(name).is_some() || OUTSIDE.contains(&&**name)));
        found
    }
}

fn rank(module: &str) -> Option<usize> {
    STAGES.iter().position(|stage| stage.contains(&module))
}

fn is_of_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// What follows each occurrence of `prefix` that is not the end of a longer word.
fn after<'a>(code: &'a str, prefix: &'a str) -> impl Iterator<Item = &'a str> {
    code.match_indices(prefix)
        .filter(|(at, _)| !code[..*at].ends_with(is_of_word))
        .map(|(at, _)| &code[at + prefix.len()..])
}

/// The first names of a path or of a group of paths: `a::b` gives a; `{a::{b, c}, d}` gives a, d.
fn first_names(path: &str) -> Vec<String> {
    let word = |text: &str| text.chars().take_while(|c| is_of_word(*c)).collect();
    let Some(group) = path.strip_prefix('{') else {
        return vec![word(path)];
    };
    let mut depth = 0_usize;
    let mut names = vec![String::new()];
    for c in group.chars() {
        match c {
            '}' if depth == 0 => break,
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => names.push(String::new()),
            _ if depth == 0 => names.last_mut().expect("never empty").push(c),
            _ => {}
        }
    }
    let mut names: Vec<_> = names.iter().map(|name| word(name.trim_start())).collect();
    names.retain(|name: &String| !name.is_empty());
    names
}

/// Cuts off what follows `//`, but not in `https://`.
fn without_comments(text: &str) -> String {
    let code = |line: &str| {
        let mut starts = line.match_indices("//").map(|(at, _)| at);
        let end = starts.find(|at| !line[..*at].ends_with(':'));
        line[..end.unwrap_or(line.len())].to_owned() + "\n"
    };
    text.lines().map(code).collect()
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_owned()
}

/// All Rust files in `folder`, in order of their paths.
fn sources(folder: &str) -> Vec<Source> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder of sources") {
            let path = entry.expect("a readable folder").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = fs::read_to_string(&path).expect("UTF-8");
                let inside = path.strip_prefix(root()).expect("below the root");
                found.push(Source {
                    path: inside.to_string_lossy().replace('\\', "/"),
                    code: without_comments(&text),
                });
            }
        }
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    assert!(!found.is_empty(), "no sources in {folder}");
    found
}

/// What is wrong with the imports of `source`.
fn violations(source: &Source) -> Vec<String> {
    let module = source.modules()[0];
    if OUTSIDE.contains(&module) || ROOTS.contains(&module) {
        return Vec::new();
    }
    let path = &source.path;
    let Some(own) = rank(module) else {
        return vec![format!("{path}: `{module}` has no place in STAGES")];
    };
    let wrong = |name: &String| match rank(name) {
        Some(other) if other <= own => None,
        Some(_) => Some(format!("{path}: `{module}` imports the later `{name}`")),
        None if OUTSIDE.contains(&name.as_str()) => {
            Some(format!("{path}: `{module}` imports `{name}`"))
        }
        // An item that the crate's root exports again: `crate::Error`.
        None if name.starts_with(char::is_uppercase) => None,
        None => Some(format!("{path}: `{name}` has no place in STAGES")),
    };
    source.imports().iter().filter_map(wrong).collect()
}

#[test]
fn no_stage_imports_a_later_one() {
    let found: Vec<_> = sources("src").iter().flat_map(violations).collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn every_stage_exists() {
    let sources = sources("src");
    for stage in STAGES.iter().copied().flatten() {
        let exists = sources.iter().any(|source| source.modules()[0] == *stage);
        assert!(exists, "`{stage}` is in STAGES but not in src/");
    }
}

#[test]
fn unsafe_code_is_only_where_it_may_be() {
    for source in ["src", "bake/src"].into_iter().flat_map(sources) {
        let mut words = source.code.split(|c| !is_of_word(c));
        let found = words.any(|word| word == "unsafe");
        let allowed = MAY_BE_UNSAFE.contains(&source.path.as_str());
        assert!(!found || allowed, "{} contains unsafe code", source.path);
    }
}

#[test]
fn the_scan_finds_every_kind_of_import() {
    let source = |path: &str, text: &str| Source {
        path: path.into(),
        code: without_comments(text),
    };
    for wrong in [
        "use crate::bundle::Table;",
        "use crate::{\n    expr::{Tape, Graph},\n    bundle::{Fan, Table},\n};",
        "use {crate::render, std::fmt};",
        "fn f(u: f64) -> crate::bundle::Table {",
        "use super::super::render;",
        "use super::super::{manifold::Exit, render};",
        "use crate::terminal::Progress;",
        "use crate::unheard_of;",
        "let url = \"https://a\"; crate::bundle::g();",
    ] {
        let found = violations(&source("src/geodesic/path.rs", wrong));
        assert_eq!(found.len(), 1, "{wrong}: {found:?}");
    }
    for right in [
        "use crate::{diagnostic::SourceText, manifold::{Exit, Manifold}};",
        "use crate::geodesic::Path;",
        "use super::{End, Ray};",
        "use crate::Error;",
        "use othercrate::bundle;",
        "/// [`crate::bundle::Table`]",
    ] {
        let found = violations(&source("src/geodesic/path.rs", right));
        assert!(found.is_empty(), "{right}: {found:?}");
    }
    let above = violations(&source("src/expr/mod.rs", "use super::render;"));
    assert_eq!(above.len(), 1);
    let outside = source("src/terminal/mod.rs", "use crate::render;");
    assert!(violations(&outside).is_empty());
}
