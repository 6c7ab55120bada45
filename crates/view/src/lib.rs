//! Looking around in a curved space: the viewer's core.
//!
//! In: events of a user ([`ViewerEvent`]), the time as a number of seconds, and answers to what was asked for
//! ([`Answer`]). Out: work to be done ([`Work`]: blocks of pixels, rays), pixels to be shown ([`Patch`]), and
//! everything that a panel shows, as data ([`PanelData`]). Nothing here has threads, a clock, files or a
//! network: an engine has them, and drives a [`Session`] in this circle:
//!
//! ```text
//! UI ── event ──> Session::handle
//!                 Session::next_work ── Work ──> DrawSpace::answer, on any thread or worker
//!                 Session::accept  <── Answer ──┘   └> Patch ──> UI
//!                 Session::panel ── PanelData ──> UI
//! ```
//!
//! There are two engines for the one user interface in [`ui`]: the program's, which serves it on a local
//! address, and the page's, in which the same crates run in the browser's workers. The messages between user
//! interface and engine are those of `ui/PROTOCOL.md`.
//!
//! With the feature `files`, spaces are loaded from the disk ([`SpaceSource`]) and written as pages ([`Page`]).

mod error_classes;
mod frame_plan;
#[cfg(feature = "files")]
mod loaded_space;
mod motion;
mod package;
#[cfg(feature = "files")]
mod page;
mod panel;
mod planning;
mod protocol;
mod session;
mod shown_picture;
mod spaces;
mod start_scene;
mod steering;
pub mod ui;

pub use frame_plan::Block;
#[cfg(feature = "files")]
pub use loaded_space::{LoadedSpace, SpaceSource, bundle_of_another};
pub use motion::{Movement, StopReason, moved};
pub use package::Package;
pub use package::{PageAbout, decode_light, encode_light};
#[cfg(feature = "files")]
pub use page::Page;
pub use panel::{PanelData, PanelFeed};
pub use planning::ResolutionControl;
pub use protocol::{
    Answer, DrawRequest, Patch, PictureKind, Pose, RayQuery, RayReport, SkyChoice, ViewerEvent,
    Work,
};
pub use session::Session;
pub use spaces::{DrawSpace, SceneCamera, SessionSpace, TablePromise};
pub use start_scene::StartScene;
pub use steering::Recording;
