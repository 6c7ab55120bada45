//! Work behind, while somebody looks around already: baking a table, and decoding it ahead of the camera.
//!
//! In: the space as it is. Out: a bundle in the user's cache, under the manifold's identity, and from then on in
//! the space. A space that changes ends the bake of the one before; what was done is kept and gone on with when
//! that space comes back. Half of the threads bake: the picture comes first.

use super::loading::{PresentSpace, SharedSpace};
use crate::user_cache;
use geofan_bake::{BakeOptions, BakeResult, bake};
use geofan_bundle::Bundle;
use geofan_core::{
    Error, Observer, Progress, Result, files::make_output_folder, manifold::Manifold,
};
use std::{io, path::Path, sync::Arc, time::Duration};

/// Time between two looks at whether the space is another one.
const LOOK: Duration = Duration::from_millis(300);

/// Time between two looks at whether a chunk is to be decoded.
const PAUSE: Duration = Duration::from_millis(4);

/// Rays of the certificate, as for `geofan bake`.
const CERTIFY_RAYS: u64 = 20_000;

/// Bakes a table for every space that has none, until the viewer ends.
pub fn bake_tables(shared: &Arc<SharedSpace>) {
    let Some(folder) = user_cache::folder("tables") else {
        return;
    };
    let threads = rayon::current_num_threads().div_ceil(2);
    let Ok(pool) = rayon::ThreadPoolBuilder::new().num_threads(threads).build() else {
        return;
    };
    let mut tried = 0;
    while !shared.has_ended() {
        let PresentSpace {
            version, loaded, ..
        } = shared.present();
        if version != tried && loaded.draw.bundle().is_none() {
            tried = version;
            let manifold = loaded.session.manifold.clone();
            let work = BehindBake { shared, version };
            let made = pool.install(|| table(&folder, manifold, loaded.draw.length(), &work));
            let told = made.err().map(|error| match is_baked_elsewhere(&error) {
                true => {
                    // It is there as soon as the other is done.
                    tried = 0;
                    "another viewer bakes the table".to_string()
                }
                false => format!("no table: {error}"),
            });
            shared.set_background(told);
        }
        std::thread::sleep(LOOK);
    }
}

/// Decodes chunks of the table as viewers ask for them, ahead of their cameras, until the viewer ends.
pub fn decode_ahead(shared: &SharedSpace) {
    while !shared.has_ended() {
        if !shared.decode_chunk() {
            std::thread::sleep(PAUSE);
        }
    }
}

/// Finds the table of a manifold in the cache, or bakes it there, and gives it to the space.
fn table(folder: &Path, manifold: Arc<Manifold>, length: f64, work: &BehindBake<'_>) -> Result<()> {
    let path = folder.join(format!("{}.fan", identity(&manifold, length)));
    let found = Bundle::read(&path).ok();
    let found = found.filter(|bundle| {
        let differences = manifold.differences_of_covers(&bundle.manifold);
        differences.is_empty()
    });
    if let Some(bundle) = found {
        work.shared.set_table(bundle);
        return Ok(());
    }
    make_output_folder(folder)?;
    let options = BakeOptions {
        max_sky_error: None,
        max_error: None,
        max_size: None,
        length: Some(length),
        frames: true,
        mirrors: true,
        cells: None,
        share: None,
        resume: true,
        wait: false,
        certify_rays: CERTIFY_RAYS,
    };
    match bake(manifold, &path, &options, work) {
        Ok(BakeResult::Bundle { bundle, .. }) => {
            work.shared.set_table(*bundle);
            Ok(())
        }
        Ok(_) => Ok(()),
        Err(_) if work.cancelled() => Ok(()),
        Err(error) => Err(error),
    }
}

/// Tells whether a bake did not begin because another process makes the same bundle.
fn is_baked_elsewhere(error: &Error) -> bool {
    matches!(error, Error::Environment { source, .. } if source.kind() == io::ErrorKind::WouldBlock)
}

/// Returns the name of a manifold's table: equal for equal geometry and length.
fn identity(manifold: &Manifold, length: f64) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&manifold.cover().meaning_digest());
    hasher.update(&length.to_le_bytes());
    hasher.finalize().to_hex()[..32].to_string()
}

/// Watches a bake for the viewers.
struct BehindBake<'s> {
    shared: &'s SharedSpace,
    version: u64,
}

impl Observer for BehindBake<'_> {
    fn progress(&self, progress: Progress<'_>) {
        let Progress {
            work, done, total, ..
        } = progress;
        let text = match total {
            0 => format!("baking a table behind: {work}"),
            _ => format!("baking a table behind: {work} {done} of {total}"),
        };
        self.shared.set_background(Some(text));
    }

    fn cancelled(&self) -> bool {
        self.shared.has_ended() || self.shared.present().version != self.version
    }
}
