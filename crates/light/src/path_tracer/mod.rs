//! Path tracing in a curved space: the rendering equation by chance, without bias.
//!
//! In: a world, a view, a seed and a number of samples. Out: radiance of every pixel with its
//! variance ([`Film`]).
//!
//! A path starts at the camera and is reflected at random (`bsdf`); between surfaces it follows
//! exact geodesics, many at a time over the integrator's lanes (`walk`). Light is gathered where a
//! path meets a surface with `Ke` or a sky, and directly: from point lights through every geodesic
//! that connects them to the surface ([`crate`]), from surfaces with `Ke` through the
//! one that Newton's method finds from a chart-straight guess (`emitters`). Radiance does not
//! change along a geodesic; what changes is the area that a solid angle covers.
//!
//! Every sample depends on nothing but the seed, its pixel and its number, and pixels are summed
//! pass by pass: the same picture comes from any number of threads and from any interruptions.

mod bsdf;
mod emitters;
mod film;
mod ggx;
mod surface;
mod walk;

pub use film::Film;
pub use walk::{Estimator, PathTracer, Settings};
