//! Messages of an engine to the user interface besides pixels.
//!
//! In: a session, and the time. Out: JSON messages: the panel when it has changed, a few times a second at
//! most, and the text of a recording when one has ended.

use crate::session::Session;
use serde_json::json;

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
