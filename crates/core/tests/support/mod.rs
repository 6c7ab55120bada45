//! What several tests need: manifolds from text, settings.

// Each test uses a part of it.
#![allow(dead_code)]

use geofan_core::{diagnostic::SourceText, geodesic::Settings, manifold::Manifold};

/// The manifold of a file with this text after its name and the coordinates x, y, z.
pub fn manifold(text: &str) -> Manifold {
    let text = format!("name = 'test'\ncoordinates = ['x', 'y', 'z']\n{text}");
    Manifold::from_source(SourceText::new("test.toml", text), &[])
        .unwrap_or_else(|e| panic!("{}", e.report(false)))
}

/// What is said about a file that begins with a flat metric.
pub fn refusal(text: &str) -> String {
    let text = format!(
        "name = 'test'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = '1' }}\n{text}"
    );
    match Manifold::from_source(SourceText::new("test.toml", text), &[]) {
        Err(error) => error.report(false),
        Ok(_) => panic!("accepted"),
    }
}

/// A glued face with its map.
pub fn pair(face: &str, map: [&str; 3]) -> String {
    let [x, y, z] = map;
    format!("[[glue]]\nface = '{face}'\nmap = ['{x}', '{y}', '{z}']\n")
}

/// A manifold of the catalogue.
pub fn asset(name: &str) -> Manifold {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/manifolds");
    let file = std::path::Path::new(folder).join(format!("{name}.toml"));
    Manifold::load(&file, &[]).unwrap_or_else(|e| panic!("{}", e.report(false)))
}

/// Settings that carry everything.
pub fn settings(tolerance: f64, events: bool) -> Settings {
    Settings {
        events,
        ..Settings::bare(tolerance).with_frame().with_deviation()
    }
}
