//! From chunks to a bundle: certificate, file, and the report about both.
//!
//! In: all chunks of a bake. Out: the bundle's file and its summary on stdout. Shards that are
//! merged come through here as well, so both give the same bytes.

use geofan::{
    Error, Result,
    bundle::{Bundle, Certificate, Contents, certify},
    terminal::{self, CommonArgs, Interrupt, Outcome, Progress},
};
use serde_json::json;
use std::{path::Path, time::Instant};

/// Measures the table of `contents` and writes it, certificate included, to `path`.
///
/// # Errors
/// Interrupted (`resume` says how to go on), or the place cannot be written.
pub fn finish(
    contents: Contents,
    exact_rays: u64,
    path: &Path,
    resume: &str,
    interrupt: &Interrupt,
    common: &CommonArgs,
) -> Result<Finished> {
    let bundle = Bundle::from_contents(contents).map_err(|e| e.about(path))?;
    let (plan, rays) = (&bundle.header.plan, bundle.header.certify_rays);
    let progress = Progress::new(common, "certifying", rays);
    let tell = |count| {
        progress.inc(count);
        match interrupt.requested() {
            true => Err(Error::Interrupted {
                resume: resume.into(),
            }),
            false => Ok(()),
        }
    };
    let rays = rays as usize;
    let promise = plan.max_error;
    let checked = certify(
        &bundle.table,
        rays,
        plan.seed,
        plan.tolerance,
        promise,
        tell,
    )?;
    let mut certificate = checked.certificate;
    progress.finish();
    certificate.exact_rays_baked = exact_rays;
    let bundle = bundle.certified(certificate.clone());
    let bytes = bundle.write(path)?;
    Ok(Finished {
        bundle,
        certificate,
        bytes,
    })
}

/// A bundle that has been written.
#[derive(Debug)]
pub struct Finished {
    /// The bundle.
    pub bundle: Bundle,
    /// Its certificate.
    pub certificate: Certificate,
    /// Its size.
    pub bytes: u64,
}

impl Finished {
    /// Prints what was made; the outcome says whether the promise is kept.
    ///
    /// # Errors
    /// stdout cannot be written.
    pub fn report(&self, path: &Path, started: Instant, common: &CommonArgs) -> Result<Outcome> {
        let promise = self.bundle.header.plan.max_error;
        let kept = self.certificate.keeps(promise);
        let counts = self.bundle.table.counts();
        let (patches, given_up) =
            counts.map_err(|e| Error::input(path.display().to_string(), e.to_string()))?;
        let seconds = started.elapsed().as_secs_f64();
        let (certificate, bytes) = (&self.certificate, self.bytes);
        if common.json {
            terminal::print_json(&json!({
                "path": path.display().to_string(),
                "bytes": bytes,
                "promise": promise,
                "kept": kept,
                "mrad": certificate.mrad,
                "screen_mrad": certificate.screen_mrad,
                "sky_mrad": certificate.sky_mrad,
                "rotation_mrad": certificate.rotation_mrad,
                "flagged": certificate.flagged,
                "rays": certificate.rays,
                "seed": certificate.seed,
                "exact_rays": certificate.exact_rays_baked,
                "patches": patches,
                "flagged_boxes": given_up,
                "seconds": seconds,
            }))?;
        } else {
            let (path, lines) = (path.display(), certificate.lines());
            terminal::print(&format!(
                "{path}: {bytes} bytes, {patches} patches, {given_up} flagged boxes\n\
                 promise: 99 % of screen errors within {promise} mrad\n{lines}\
                 {} rays integrated, {seconds:.1} s\n",
                certificate.exact_rays_baked
            ))?;
        }
        if kept {
            return Ok(Outcome::Done);
        }
        let p99 = certificate.screen_mrad.p99;
        terminal::line(&format!(
            "error: the promise of {promise} mrad is not kept: the certificate found {p99:.4}"
        ));
        Ok(Outcome::CheckFailed)
    }
}
