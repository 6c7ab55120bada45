//! Camera, scene, tracers, lattice, intersection, shading and pictures.

pub mod picture;
