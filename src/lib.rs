//! geofan: precomputed geodesic lookup tables for curved 3-dimensional spaces.
//!
//! Light in a curved space travels along geodesics. Following each pixel's geodesic step by step is
//! exact and slow; geofan does that work once, offline, and stores it so that a frame only has to
//! look it up.
//!
//! # The tour
//!
//! Data flows one way through crates that can each be taken alone; this one re-exports them all. Each
//! stage says in its first lines what comes in and what goes out.
//!
//! 1. [`expr`] turns the strings of a manifold file into a graph, adds exact derivatives to it and
//!    compiles it to a tape that runs over lanes of rays.
//! 2. [`manifold`] makes a space of them: metric, standard frames, geodesic equation, domain, exits,
//!    symmetry, camera region. A claim of the file that is false is refused here. [`document`] reads
//!    the file and [`diagnostic`] turns a mistake into a message with the text underlined.
//! 3. [`geodesic`] follows rays: an adaptive integrator with dense output that carries the
//!    transported frame and the geodesic deviation along.
//! 4. [`bundle`] holds all rays of a camera region as patches, quantised and compressed:
//!    [`bundle::rays`] says which rays a table must know, as parameters, after symmetry; the rest
//!    stores and evaluates them, down to the file and its checksums.
//! 5. [`bake`] decides what to store, where and until when, and measures the certificate.
//! 6. [`render`] makes a picture: paths from a tracer, intersected with the scene, shaded.
//! 7. [`light`] connects lamps with surfaces, and traces paths.
//! 8. [`view`] lets people look around: sessions, without the threads, clocks and sockets that drive them.
//! 9. [`study`] compares pictures and tables with their rivals.
//!
//! [`error`], [`files`], [`keeping`], [`observer`], [`parallel`], [`quantiles`], [`random`] and [`reading`] serve every
//! stage; [`field`] reads the samples that a manifold file names.
//!
//! # Example
//!
//! The 3-sphere in its stereographic chart: after arc length π every geodesic is at the antipode of
//! its start, which in this chart is −u/|u|².
//!
//! ```
//! use geofan::{
//!     diagnostic::SourceText,
//!     geodesic::{Ray, Settings, paths},
//!     manifold::Manifold,
//! };
//! use glam::DVec3;
//! use std::f64::consts::PI;
//!
//! let text = r#"
//! name = "three-sphere"
//! coordinates = ["x", "y", "z"]
//! metric = { conformal = "2/(1 + x^2 + y^2 + z^2)" }
//! "#;
//! let sphere = Manifold::from_source(SourceText::new("sphere.toml", text), &[])?;
//!
//! let start = DVec3::new(0.5, 0.0, 0.0);
//! let direction = DVec3::new(0.2, 0.9, -0.3).normalize(); // in the standard frame at `start`
//! let settings = Settings::bare(1e-11).with_events();
//! let found = paths(&sphere, settings, [Ray::new(&sphere, start, direction, PI)]);
//!
//! let last = found[0].steps.last().expect("a path of positive length has steps");
//! let antipode = -start / start.length_squared();
//! assert!((last.position(PI) - antipode).length() < 1e-8);
//! # Ok::<(), geofan::Error>(())
//! ```
//!
//! # Glossary
//!
//! | word | meaning |
//! |---|---|
//! | manifold | a 3-dimensional curved space in one chart: an embedding `f(u): R³ → R^N` or a metric `g_ij(u)` |
//! | chart point `u`, tangent `v` | coordinates of a point; components of a vector in the natural basis `r_i = ∂f/∂u^i` |
//! | `G(u)` | metric matrix; `G = JᵀJ` for an embedding |
//! | `S(u)` | Gram–Schmidt matrix, upper triangular, `Sᵀ G S = I`; its columns are the *standard frame* at `u` |
//! | camera | chart point `u` and rotation `R`; its axes are the columns of `S(u) R` |
//! | path | geodesic followed for a length `s ∈ [0, L]` at unit speed; carries position and transported frame |
//! | fan | all paths from one camera position |
//! | bundle | the compressed set of fans over a region of camera positions; one file, `*.fan` |
//! | patch | a box of camera × direction parameters and an interval of arc lengths on which all paths are one polynomial; its directions are (a part of) a face of a cube, or the whole sphere |
//! | pole | of the sphere of directions: the way along which a table's cameras are spread most |
//! | aim, parallax | the direction a table knows a ray by, and what it differs by from the ray's own (times a length): seen from the middle of the camera's cell, the ray's point on a sphere about it |
//! | flagged | of a patch or ray: the table gave up on it, it is integrated exactly |
//! | tracer | anything that turns a camera and directions into paths: *exact* integrates, *table* looks up |
//! | exit | a named way out of the manifold, with a sky of its own |
//! | glued domain | the part of the chart inside all faces of a gluing; a path that leaves through a face goes on where its map leads |
//! | cover, copy | the chart without its gluing; the image of the domain by a deck transformation, a product of maps |
//! | area | how far a unit solid angle has spread: `s²` in flat space; a zero is a caustic |
//! | mrad error | distance across the ray between table and exact position at equal `s`, divided by `s`, times 1000; one mrad is about one pixel of a 1920-wide view of 90° |
//! | screen error | the same divided by the ray's magnification (taken as at least 0.25): what an eye can see |
//! | certificate | the errors of fresh random rays, written into the bundle with their number and seed |
//!
//! # Architecture
//!
//! A crate imports only crates to the left of it:
//!
//! ```text
//! geofan-expr < geofan-core < geofan-bundle < geofan-render < geofan-light < geofan-view  < geofan
//!                                           < geofan-bake                  < geofan-study < geofan
//! ```
//!
//! `geofan-web` is `geofan-view` for the browser, beside this package. `geofan-bundle` alone reads a bundle and looks paths up in it, without threads, files or clocks if
//! its features are off. The programs are in the root package.

pub use geofan_bake as bake;
pub use geofan_bundle as bundle;
pub use geofan_core::{
    Error, Result, diagnostic, document, error, field, files, geodesic, keeping, manifold,
    observer, parallel, quantiles, random, reading,
};
pub use geofan_expr as expr;
pub use geofan_light as light;
pub use geofan_render as render;
pub use geofan_study as study;
pub use geofan_view as view;

#[cfg(feature = "program")]
#[doc(hidden)]
pub mod commands;
#[cfg(feature = "program")]
mod terminal;
#[cfg(feature = "program")]
mod user_cache;
