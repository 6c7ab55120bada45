//! The program `geofan-bake`: another name for `geofan bake`.

use std::process::ExitCode;

fn main() -> ExitCode {
    geofan::commands::geofan_bake()
}
