//! From chunks to a bundle: certificate and file.
//!
//! In: all chunks of a bake. Out: the bundle's file. Shards that are merged come through here as well,
//! so both give the same bytes.

use crate::certificate::certify;
use geofan_bundle::{Bundle, Certificate, Contents};
use geofan_core::{Error, Observer, Progress, Result};
use std::{
    path::Path,
    sync::atomic::{AtomicU64, Ordering::Relaxed},
};

/// Measures the table of `contents` and writes it, certificate included, to `path`.
///
/// # Errors
/// Interrupted (`resume` says how to go on), or the place cannot be written.
pub fn finish(
    contents: Contents,
    exact_rays: u64,
    path: &Path,
    resume: &str,
    observer: &dyn Observer,
) -> Result<Finished> {
    let bundle = Bundle::from_contents(contents).map_err(|e| e.about(path))?;
    let (plan, rays) = (&bundle.header.plan, bundle.header.certify_rays);
    let certified = AtomicU64::new(0);
    let tell = |count| {
        observer.progress(Progress {
            work: "certifying",
            done: certified.fetch_add(count, Relaxed) + count,
            total: rays,
            detail: "",
        });
        match observer.cancelled() {
            true => Err(Error::Interrupted {
                resume: resume.into(),
            }),
            false => Ok(()),
        }
    };
    let checked = certify(
        &bundle.table,
        rays as usize,
        plan.seed,
        plan.tolerance,
        plan.max_error,
        tell,
    )?;
    let mut certificate = checked.certificate;
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
    /// Tells whether the certificate keeps the promise.
    pub fn keeps_promise(&self) -> bool {
        self.certificate.keeps(self.bundle.header.plan.max_error)
    }
}
