//! The panel's contents, as data, and when they are told.
//!
//! In: numbers and names of a session, and the time. Out: [`PanelData`], which a user interface turns into words and
//! controls (fields that have no value now are null); and the JSON messages of an engine besides pixels ([`PanelFeed`]):
//! the panel when it has changed, a few times a second at most, and the text of a recording when one has ended.

use crate::{
    error_classes::LEGEND,
    protocol::{PictureKind, Pose, RayReport, SkyChoice},
    session::Session,
};
use geofan_core::quantiles::Quantiles;
use serde::Serialize;
use serde_json::json;

/// Everything that a panel shows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PanelData {
    /// Name of the manifold.
    pub manifold: String,
    /// Names of its coordinates.
    pub coordinates: [String; 3],
    /// Its parameters.
    pub parameters: Vec<(String, f64)>,
    /// Those of them whose values some viewer of the same space chose.
    pub chosen: Vec<String>,
    /// Names of the scene's further cameras.
    pub views: Vec<String>,
    /// Where the camera is.
    pub pose: Pose,
    /// Scalar curvature there; null where it cannot be computed.
    pub curvature: Option<f64>,
    /// The way of drawing, and that of the right half.
    pub kind: PictureKind,
    /// See `kind`.
    pub split: Option<PictureKind>,
    /// The table's promise in mrad; null without a table.
    pub promise: Option<f64>,
    /// The reason for which there will be none, where that is known.
    pub no_table: Option<String>,
    /// The certificate of the table, in words.
    pub certificate: Option<String>,
    /// What the skies show.
    pub sky: SkyChoice,
    /// The camera may leave the table's region.
    pub beyond: bool,
    /// The camera is where the table knows all paths.
    pub within_table: bool,
    /// The table's cell here is not decoded yet: exact paths stand in for it.
    pub decoding: bool,
    /// Length a second.
    pub speed: f64,
    /// Share of the display's sides that moving pictures have; 0: as large as the machine draws in time.
    pub moving_share: f64,
    /// Stops.
    pub exposure: f64,
    /// Columns and rows of the last whole picture, and its samples a pixel.
    pub size: (usize, usize),
    /// See `size`.
    pub samples: u16,
    /// Samples of a pixel by path tracing, and how many are wanted.
    pub passes: (u32, u32),
    /// Nothing moves, and nothing is left to be refined.
    pub settled: bool,
    /// Columns and rows of the display.
    pub display: (usize, usize),
    /// Seconds that the last whole picture took.
    pub seconds: Option<f64>,
    /// Moving pictures a second; null when nothing moves.
    pub rate: Option<f64>,
    /// The reason for which the camera stopped or something cannot be drawn.
    pub hint: Option<String>,
    /// A mistake in a file; the last good state is shown.
    pub trouble: Option<String>,
    /// Work that goes on behind, or what is left out for want of it, in words.
    pub background: Option<String>,
    /// Errors of the last whole error picture, mrad, and the share of paths given up.
    pub errors: Option<(Quantiles, f64)>,
    /// Classes of error pictures: most mrad (null: more, or given up), colour.
    pub legend: Vec<(Option<f32>, [u8; 3])>,
    /// The thing under the pointer: name, arc length.
    pub hover: Option<(String, f64)>,
    /// The picked path.
    pub picked: Option<RayReport>,
    /// Seconds recorded so far; null when nothing is recorded.
    pub recording: Option<f64>,
    /// There is a recording to replay.
    pub recorded: bool,
    /// The camera moves by itself.
    pub travelling: bool,
}

impl PanelData {
    /// Lists the classes of error pictures.
    pub fn legend() -> Vec<(Option<f32>, [u8; 3])> {
        let class = |(most, colour): (f32, [u8; 3])| (most.is_finite().then_some(most), colour);
        LEGEND.map(class).to_vec()
    }
}

/// Seconds between two panels: a number that changes faster cannot be read.
const INTERVAL: f64 = 0.1;

/// Remembers what has been told.
#[derive(Debug, Clone, Default)]
pub struct PanelFeed {
    panel: String,
    recorded: String,
    told: Option<f64>,
}

impl PanelFeed {
    /// Returns the messages that are due.
    pub fn next(&mut self, session: &mut Session, now: f64) -> Vec<String> {
        let mut messages = Vec::new();
        if session.recorded() != self.recorded {
            self.recorded = session.recorded().into();
            messages.push(json!({ "type": "recorded", "text": self.recorded }).to_string());
        }
        if self.told.is_some_and(|told| now < told + INTERVAL) {
            return messages;
        }
        self.told = Some(now);
        let panel = json!({ "type": "panel", "panel": session.panel(now) }).to_string();
        if panel != self.panel {
            messages.push(panel.clone());
            self.panel = panel;
        }
        messages
    }
}
