//! What a sweep found, for people.
//!
//! In: [`Results`] of all manifolds. Out: figures as SVG and PNG in `figures/`, and `index.html`,
//! which stands alone.

mod analysis;
mod figures;
mod heat;
mod page;

use crate::sweep::subject::Results;
use figures::Figure;
use geofan_core::{Error, Result, files::write_atomically};
use std::{fs, io::Write, path::Path};

/// Writes the figures and the page about `all` into `out`; `command` is what repeats it.
///
/// # Errors
/// A figure cannot be drawn, or the place cannot be written.
pub fn write(out: &Path, all: &[Results], command: &str) -> Result<()> {
    let folder = out.join("figures");
    fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
    let mut figures: Vec<Vec<Figure>> = Vec::new();
    for results in all {
        let mut own = figures::figures(results)?;
        own.extend(heat::pictures(results)?);
        for figure in &own {
            save(&folder, figure)?;
        }
        figures.push(own);
    }
    let html = page::page(all, &figures, command);
    write_atomically(&out.join("index.html"), |file| {
        file.write_all(html.as_bytes())
    })
}

fn save(folder: &Path, figure: &Figure) -> Result<()> {
    let path = |ending: &str| folder.join(format!("{}.{ending}", figure.name));
    if let Some(svg) = &figure.svg {
        write_atomically(&path("svg"), |file| file.write_all(svg.as_bytes()))?;
    }
    write_atomically(&path("png"), |file| file.write_all(&figure.png))
}

#[cfg(test)]
mod tests;
