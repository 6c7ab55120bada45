//! Text -> expression graph -> derivatives -> straight-line tape run over lanes of rays.
//!
//! In: the strings of a manifold file. Out: [`Tape`]s. A string is parsed into a [`Graph`] that
//! shares equal subexpressions ([`parse`](parse::parse)); [`Graph::derivative`] adds exact
//! derivatives to the same graph; [`Tape::compile`] turns the nodes wanted into instructions. Functions
//! given by samples are [`spline`]s; a tape computes all derivatives of one at a point together.

mod derivative;
mod graph;
pub mod parse;
pub mod real;
pub mod spelling;
pub mod spline;
mod tape;

pub use derivative::Direction;
pub use graph::{Binary, FieldId, Graph, Node, NodeId, Unary};
pub use tape::{Digest, Registers, Tape, TapeTooLarge, Wide, vectorised};
