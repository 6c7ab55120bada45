//! `geofan check`: a bundle against exact paths.
//!
//! In: a bundle. Out: quantiles of its errors on fresh random rays, and whether its promise holds
//! on them too.

use super::bake::warn_unfinished;
use crate::terminal::{self, CommonArgs, Outcome, ProgressDisplay};
use geofan_bake::certify;
use geofan_bundle::{Bundle, Certificate, Checked, FAR, Outlier, PlanRecord, rays::RaySpace};
use geofan_core::{Error, Result};
use serde_json::json;
use std::path::PathBuf;

/// Options of `geofan check`.
#[derive(Debug, clap::Args)]
pub struct CheckArgs {
    /// The bundle
    #[arg(value_name = "B.fan")]
    bundle: PathBuf,
    /// Number of random rays to compare
    #[arg(long, value_name = "N", default_value_t = 100_000,
          value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    rays: u64,
    /// Seed of the random rays; the bundle's own certificate has seed 1
    #[arg(long, value_name = "K", default_value_t = 2)]
    seed: u64,
}

/// Compares a bundle with exact paths and prints the errors.
pub fn run(args: &CheckArgs, common: &CommonArgs) -> Result<Outcome> {
    let size = std::fs::metadata(&args.bundle);
    let bytes = size.map_err(|e| Error::io(&args.bundle, e))?.len();
    let bundle = Bundle::read(&args.bundle)?;
    let plan = &bundle.header.plan;
    let progress = ProgressDisplay::new(common, "checking", args.rays);
    let rays = args.rays as usize;
    let found = certify(
        &bundle.table,
        rays,
        args.seed,
        plan.tolerance,
        plan.max_error,
        |count| {
            progress.inc(count);
            Ok(())
        },
    )?;
    progress.finish();
    report(&found, (plan, &bundle.table.space), bytes, common)?;
    warn_unfinished(&bundle.manifold, &found.unfinished);
    Ok(match plan.is_kept(&found.certificate) {
        true => Outcome::Done,
        false => Outcome::CheckFailed,
    })
}

/// Prints quantiles and the worst rays.
fn report(
    checked: &Checked,
    (plan, space): (&PlanRecord, &RaySpace),
    bytes: u64,
    common: &CommonArgs,
) -> Result<()> {
    let found = &checked.certificate;
    let worst: Vec<_> = checked
        .worst
        .iter()
        .map(|o| json!({"ray": o, "why": o.why()}))
        .collect();
    if common.json {
        return terminal::print_json(&json!({
            "mrad": found.mrad,
            "screen_mrad": found.screen_mrad,
            "sky_mrad": found.sky_mrad,
            "rotation_mrad": found.rotation_mrad,
            "flagged": found.flagged,
            "bytes": bytes,
            "rays": found.rays,
            "seed": found.seed,
            "promise": plan.max_error,
            "sky_promise": plan.tangents.mrad(plan.max_error),
            "beyond_20_promises": checked.far,
            "unfinished": checked.unfinished,
            "worst": worst,
        }));
    }
    let verdict = match plan.is_kept(found) {
        true => "kept",
        false => "NOT KEPT",
    };
    terminal::print(&format!(
        "{}ends       {}\n{bytes} bytes\npromise: {}: {verdict}\n{}",
        found.lines(),
        checked.unfinished,
        plan.promises(space),
        sky_excess(plan, found)
    ))?;
    outliers(checked)
}

/// Says that sky errors exceed what was promised of them on the rays that steered the bake, if they do.
fn sky_excess(plan: &PlanRecord, found: &Certificate) -> String {
    match (plan.tangents.mrad(plan.max_error), found.sky_mrad) {
        (Some(promise), Some(sky)) if sky.p99 > promise => format!(
            "sky errors of these rays exceed it: p99 {:.3} mrad, among those that end where directions are promised\n",
            sky.p99
        ),
        _ => String::new(),
    }
}

/// Prints the worst rays, and why they are.
fn outliers(checked: &Checked) -> Result<()> {
    if checked.far == 0 {
        return Ok(());
    }
    let mut text = format!(
        "{} rays beyond {FAR} times the promise; the worst:\n",
        checked.far
    );
    for outlier in &checked.worst {
        let Outlier { at, dir, s, .. } = outlier;
        let (error, patch, why) = (outlier.screen_mrad, &outlier.patch, outlier.why());
        text += &format!(
            "{error:>10.3} mrad: at {at:.6?} dir {dir:.6?} s {s:.4}; chunk {} box {:.4?}: {why}\n",
            patch.chunk, patch.intervals
        );
    }
    terminal::print(&text)
}
