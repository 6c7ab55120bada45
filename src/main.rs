//! The program `geofan`.

use std::process::ExitCode;

fn main() -> ExitCode {
    geofan::commands::geofan()
}
