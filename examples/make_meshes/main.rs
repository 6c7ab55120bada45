//! Writes the meshes of the example scenes.
//!
//! In: a folder (`cargo run --release --example make_meshes -- assets/meshes`).
//! Out: five OBJ files with their MTL files: `torus-knot`, `pawn`, `teapot`, `globe`, `letter-F`.
//! All are centred near the origin, about unit radius, z up, wound anticlockwise from outside,
//! and checked before they are written.

use std::path::PathBuf;

use anyhow::{Context, Result};

mod mesh;
mod shapes;
mod teapot;

fn main() -> Result<()> {
    let folder: PathBuf = std::env::args_os()
        .nth(1)
        .context("usage: make_meshes FOLDER")?
        .into();
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    let meshes = [
        shapes::torus_knot(),
        shapes::pawn(),
        teapot::teapot(),
        shapes::globe(),
        shapes::letter_f(),
    ];
    for mesh in &meshes {
        mesh.check();
        mesh.write(&folder)?;
        println!("{:12} {:6} triangles", mesh.name, mesh.triangle_count());
    }
    let total: usize = meshes.iter().map(mesh::Mesh::triangle_count).sum();
    println!("{:12} {total:6} triangles", "total");
    Ok(())
}
