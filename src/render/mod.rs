//! Camera, scene, tracers, lattice, intersection, shading and pictures.

pub mod accel;
pub mod picture;
pub mod scene;
pub mod sky;
