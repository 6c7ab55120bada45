//! The program `geofan-bake`: another name for `geofan bake`.

use std::process::ExitCode;

fn main() -> ExitCode {
    geofan::program::geofan_bake()
}
