//! The command line of `geofan-bake`. No mathematics.

use geofan::{Error, Result, terminal, terminal::Outcome};
use geofan_bake::{
    args::{Cli, Command},
    demo, run, shard, sweep,
};
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli: Cli = terminal::parse();
    terminal::run(&cli.common, || dispatch(&cli))
}

fn dispatch(cli: &Cli) -> Result<Outcome> {
    match (&cli.command, &cli.bake) {
        (Some(Command::Merge(args)), None) => shard::merge(args, &cli.common),
        (Some(Command::Demo(args)), None) => demo::run(args, &cli.common),
        (Some(Command::Sweep(args)), None) => sweep::run(args, &cli.common),
        (None, Some(args)) => run::run(args, &cli.common),
        _ => Err(Error::input(
            "MANIFOLD",
            "give either a manifold to bake or a subcommand",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{CommandFactory, Parser};

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
        assert!(Cli::try_parse_from(["geofan-bake", "m.toml", "-o", "b.fan"]).is_ok());
        assert!(Cli::try_parse_from(["geofan-bake", "merge", "a", "-o", "b.fan"]).is_ok());
        assert!(Cli::try_parse_from(["geofan-bake", "demo"]).is_ok());
        assert!(Cli::try_parse_from(["geofan-bake", "--threads", "2", "demo"]).is_ok());
        assert!(Cli::try_parse_from(["geofan-bake", "m.toml"]).is_err());
        assert!(Cli::try_parse_from(["geofan-bake", "-o", "b.fan"]).is_err());
    }
}
