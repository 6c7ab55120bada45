// Not `forbid`: the slices that `ndarray::s!` writes allow unsafe code for themselves, and `prefetch` needs it.
#![deny(unsafe_code)]
#![warn(missing_docs)]
//! geofan: precomputed geodesic lookup tables for curved 3-dimensional spaces.
//!
//! Light in a curved space travels along geodesics. Following each pixel's geodesic step by step is
//! exact and slow; geofan does that work once, offline, and stores it so that a frame only has to
//! look it up.
//!
//! # The tour
//!
//! Data flows one way. Each stage says in its first lines what comes in and what goes out.
//!
//! 1. [`document`] reads TOML and remembers where everything stands; [`diagnostic`] turns a mistake
//!    into a message with the line, the column and the text underlined.
//! 2. [`expr`] turns the strings of a manifold file into a graph, adds exact derivatives to it and
//!    compiles it to a tape that runs over lanes of rays.
//! 3. [`manifold`] makes a space of them: metric, standard frames, geodesic equation, domain, exits,
//!    symmetry, camera region. A claim of the file that is false is refused here.
//! 4. [`geodesic`] follows rays: an adaptive integrator with dense output that carries the
//!    transported frame and the geodesic deviation along.
//! 5. [`fan`] says which rays a table must know: camera positions and directions as parameters, what
//!    symmetries, claimed or found, remove of them, and exact samples at given parameters.
//! 6. [`bundle`] holds all those rays as patches, quantised and compressed: polynomials on faces of
//!    directions, or waves on the whole sphere of them; the file, its checksums, its contraction to one
//!    camera, its certificate.
//! 7. [`render`] makes a picture: paths from a tracer, intersected with the scene, shaded.
//!
//! [`terminal`] is what the two programs share with a command line. [`error`], [`files`],
//! `prefetch`, [`quantiles`], [`random`] and [`spelling`] serve every stage.
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
//!     manifold::{Carried, Manifold},
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
//! let settings = Settings { tolerance: 1e-11, carried: Carried::default(), events: true };
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
//! | patch | a box of camera × direction parameters on which all paths are one polynomial; its directions are (a part of) a face of a cube, or the whole sphere |
//! | pole | of the sphere of directions: the way along which a table's cameras are spread most |
//! | aim, parallax | the direction a table knows a ray by, and what it differs by from the ray's own (times a length): seen from the middle of the camera's cell, the ray's point on a sphere about it |
//! | flagged | of a patch or ray: the table gave up on it, it is integrated exactly |
//! | tracer | anything that turns a camera and directions into paths: *exact* integrates, *table* looks up |
//! | exit | a named way out of the manifold, with a sky of its own |
//! | area | how far a unit solid angle has spread: `s²` in flat space; a zero is a caustic |
//! | mrad error | distance across the ray between table and exact position at equal `s`, divided by `s`, times 1000; one mrad is about one pixel of a 1920-wide view of 90° |
//! | screen error | the same divided by the ray's magnification (taken as at least 0.25): what an eye can see |
//! | certificate | the errors of fresh random rays, written into the bundle with their number and seed |
//!
//! # Architecture
//!
//! A stage imports only stages to the left of it:
//!
//! ```text
//! spelling diagnostic error files quantiles random
//!   < document < expr < manifold < geodesic < fan < bundle < render
//! ```
//!
//! `terminal`, and the commands of the program `geofan`, may import everything; nothing imports
//! them. `tests/stages.rs` checks this.
//!
//! Baking lives in the package `geofan-bake` (folder `bake/`): it decides what to bake, where and
//! until when, and has no mathematics of its own; encoding stands beside decoding, here. So the
//! renderer never carries what only an offline bake needs.

pub mod bundle;
pub mod diagnostic;
pub mod document;
pub mod error;
pub mod expr;
pub mod fan;
pub mod files;
pub mod geodesic;
pub mod manifold;
mod prefetch;
pub mod quantiles;
pub mod random;
pub mod render;
pub mod spelling;
pub mod terminal;

pub use error::{Error, Result};
