//! Text -> expression graph -> derivatives -> straight-line tape run over lanes of rays.

mod kernels;
pub mod real;
