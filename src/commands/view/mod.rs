//! `geofan view`: looking around in a scene, in the browser; or the same written into one page.
//!
//! In: a scene file, or a bare manifold file, and perhaps a bundle. Out: the viewer's user interface on a local
//! address, until a signal ends it; or a page. The viewer's rules and its pages are in `geofan-view`; here are its
//! threads, clocks and sockets: [`shared_space`] watches files and bakes, [`server`] answers requests of
//! which it checks everything, [`opening`] brings the browser there, [`driver`] has one session behind a WebSocket; with
//! the feature `window` that may have a native window instead.

mod driver;
mod opening;
mod server;
mod shared_space;
#[cfg(feature = "window")]
mod window;
#[cfg(feature = "window")]
mod window_picture;

use crate::{
    terminal::{self, CommonArgs, Outcome, TerminalObserver, values},
    user_cache,
};
use clap::Args;
use geofan_core::{Error, Observer, Result};
use geofan_view::{Page, SpaceSource};
use serde_json::json;
use server::Server;
use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    time::Duration,
};

/// Options of `geofan view`.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// The scene file, or a manifold file
    scene: PathBuf,
    /// The table to look paths up in [default: one baked in the background, kept in the user's cache]
    #[arg(long, value_name = "FILE")]
    bundle: Option<PathBuf>,
    /// Arc length of exact paths [default: the manifold's, else 10]
    #[arg(long, value_name = "L", value_parser = values::length)]
    length: Option<f64>,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    set: Vec<(String, f64)>,
    /// Print the address and open no browser
    #[arg(long)]
    no_open: bool,
    /// Bake no table in the background where there is no bundle
    #[arg(long)]
    no_bake: bool,
    /// The local address to serve on [default: 127.0.0.1 and any free port]
    #[arg(long, value_name = "127.0.0.1:PORT")]
    listen: Option<SocketAddr>,
    /// Write a page that needs no server instead: one file (out.html), or a folder for a static host
    #[arg(long, value_name = "out.html|DIR", conflicts_with_all = ["listen", "no_open", "no_bake"])]
    page: Option<PathBuf>,
    /// Show it in a window of its own, without a browser
    #[cfg(feature = "window")]
    #[arg(long, conflicts_with_all = ["listen", "no_open", "page"])]
    window: bool,
    /// The viewer for pages, as `.ci/page.sh` builds it [default: geofan-web.wasm beside this program]
    #[arg(long, value_name = "FILE", requires = "page")]
    wasm: Option<PathBuf>,
}

/// Runs the viewer, or writes the page.
pub fn run(args: &ViewArgs, common: &CommonArgs) -> Result<Outcome> {
    let source = SpaceSource {
        file: args.scene.clone(),
        bundle: args.bundle.clone(),
        length: args.length,
    };
    if let Some(output) = &args.page {
        // A folder is made where it is missing, but the one that it is in.
        let folder = output
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
            let message = format!("{} is no folder: make it first", folder.display());
            return Err(Error::input("--page", message));
        }
        let page = Page::new(&source, &args.set, &viewer(args.wasm.as_deref())?)?;
        for warning in page.warnings() {
            tracing::warn!("{warning}");
        }
        return report_page(output, page.write(output)?, common);
    }
    let listen = args.listen.unwrap_or((Ipv4Addr::LOCALHOST, 0).into());
    if !is_loopback(listen.ip()) {
        let message =
            "the viewer is served to this machine only: give 127.0.0.1:PORT or [::1]:PORT";
        return Err(Error::input("--listen", message));
    }
    let observer = TerminalObserver::new(common)?;
    let shared = shared_space::SharedSpace::open(source, args.set.clone(), no_table(args))?;
    #[cfg(feature = "window")]
    if args.window {
        return run_window(args, &shared, &observer);
    }
    let server = Server::bind(listen, shared.clone())?;
    announce(&server, args, common)?;
    std::thread::scope(|threads| {
        spawn_helpers(threads, args, &shared);
        threads.spawn(|| server.serve());
        while !observer.cancelled() {
            std::thread::sleep(Duration::from_millis(50));
        }
        shared.end();
        server.wake();
    });
    Ok(Outcome::Done)
}

/// Returns the reason for which no table is baked behind, if there is one.
fn no_table(args: &ViewArgs) -> Option<&'static str> {
    match (args.no_bake, user_cache::folder("tables")) {
        (true, _) => Some("no table is baked behind: --no-bake says so"),
        (false, None) => {
            Some("no table is baked behind: there is no folder to keep it in (GEOFAN_CACHE)")
        }
        (false, Some(_)) => None,
    }
}

/// Starts the threads that watch files, bake tables and decode them behind, until the space's end.
fn spawn_helpers<'s>(
    threads: &'s std::thread::Scope<'s, '_>,
    args: &ViewArgs,
    shared: &'s std::sync::Arc<shared_space::SharedSpace>,
) {
    threads.spawn(|| shared.watch());
    if !args.no_bake {
        threads.spawn(|| shared_space::bake_tables(shared));
    }
    threads.spawn(|| shared_space::decode_ahead(shared));
}

/// Runs the viewer in a window of its own.
#[cfg(feature = "window")]
fn run_window(
    args: &ViewArgs,
    shared: &std::sync::Arc<shared_space::SharedSpace>,
    observer: &TerminalObserver,
) -> Result<Outcome> {
    std::thread::scope(|threads| {
        spawn_helpers(threads, args, shared);
        let done = window::run(shared, || observer.cancelled());
        shared.end();
        done
    })?;
    Ok(Outcome::Done)
}

/// Tells whether only this machine reaches an address.
fn is_loopback(address: IpAddr) -> bool {
    address.is_loopback()
}

/// Prints the address, and opens the browser.
fn announce(server: &Server, args: &ViewArgs, common: &CommonArgs) -> Result<()> {
    let address = server.address();
    match common.json {
        true => terminal::print_json(&json!({ "address": address }))?,
        false => terminal::print(&format!("{address}\n"))?,
    }
    if !args.no_open {
        opening::open_browser(&server.opening_address());
    }
    Ok(())
}

/// Finds the viewer for pages.
fn viewer(asked: Option<&Path>) -> Result<PathBuf> {
    if let Some(path) = asked {
        return Ok(path.to_path_buf());
    }
    let program = std::env::current_exe().ok();
    let beside = program.and_then(|program| Some(program.parent()?.join(Page::WASM)));
    beside.filter(|path| path.is_file()).ok_or_else(|| {
        let message = format!(
            "there is no {} beside this program; build it with .ci/page.sh, or say where it is with --wasm FILE",
            Page::WASM
        );
        Error::input("--page", message)
    })
}

/// Says what was written.
fn report_page(output: &Path, bytes: usize, common: &CommonArgs) -> Result<Outcome> {
    let use_of = match output.is_dir() {
        true => "for a web server; a browser opens no folder by itself",
        false => "opens without a server",
    };
    let output = output.display().to_string();
    if common.json {
        terminal::print_json(&json!({ "output": output, "bytes": bytes }))?;
    } else if !common.quiet {
        let size = bytes as f64 / 1e6;
        terminal::print(&format!("{output}: {size:.2} MB, {use_of}\n"))?;
    }
    Ok(Outcome::Done)
}
