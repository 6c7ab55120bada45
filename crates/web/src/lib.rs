//! The viewer in a page: plain functions around a session, and around drawing, for WebAssembly.
//!
//! In and out: bytes in two buffers. The page writes into the one that [`exports::geofan_input`] makes room in,
//! calls a function, and reads the other. The page's own thread has a session; each of its workers draws. Both
//! open the same package (`geofan_view::Package`).

pub mod exports;
mod instance;
