//! What samples see by a table.

use geofan_bundle::Bundle;
use geofan_render::{
    Lookup, Stage, View,
    frame::{Outcomes, Paths, offsets, trace},
};

/// What is seen by interpolated paths of a table that promises `error` radians.
pub fn by_table(stage: &Stage, view: &View, bundle: &Bundle, error: f64) -> Outcomes {
    let lookup = Lookup::new(&bundle.table, error, 1e-8);
    let fan = bundle.fan(view.u).unwrap();
    let tracer = lookup.tracer(&fan);
    let paths = Paths::Lattice(&tracer, 5e-4);
    trace(&stage.world, view, paths, &offsets(1)).outcomes
}
