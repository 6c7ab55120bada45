//! The program `geofan`.

use std::process::ExitCode;

fn main() -> ExitCode {
    geofan::program::geofan()
}
