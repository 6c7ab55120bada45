//! Keys of the native window: those of the user interface in the browser (`controls.js`), all by where they are on a US
//! keyboard.
//!
//! In: keys. Out: events.

use geofan_view::{PanelData, PictureKind, ViewerEvent};
use winit::keyboard::KeyCode;

/// What a key does while it is held: right, up, forwards; turn right, down; roll clockwise.
fn held(key: KeyCode) -> Option<[f64; 6]> {
    Some(match key {
        KeyCode::KeyW => [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        KeyCode::KeyS => [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        KeyCode::KeyA => [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        KeyCode::KeyD => [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        KeyCode::KeyQ => [0.0, -1.0, 0.0, 0.0, 0.0, 0.0],
        KeyCode::KeyE => [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        KeyCode::ArrowLeft => [0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
        KeyCode::ArrowRight => [0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        KeyCode::ArrowUp => [0.0, 0.0, 0.0, 0.0, -1.0, 0.0],
        KeyCode::ArrowDown => [0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        KeyCode::KeyZ => [0.0, 0.0, 0.0, 0.0, 0.0, -1.0],
        KeyCode::KeyC => [0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        _ => return None,
    })
}

fn is_fast(key: KeyCode) -> bool {
    matches!(key, KeyCode::ShiftLeft | KeyCode::ShiftRight)
}

/// Tells whether a key acts as long as it is held.
pub fn is_held(key: KeyCode) -> bool {
    is_fast(key) || held(key).is_some()
}

/// Says what all keys that are held down do together.
pub fn hold(keys: &[KeyCode]) -> ViewerEvent {
    let mut sum = [0.0; 6];
    for key in keys.iter().filter_map(|key| held(*key)) {
        for (sum, part) in sum.iter_mut().zip(key) {
            *sum += part;
        }
    }
    let [right, up, forwards, turn, down, roll] = sum;
    ViewerEvent::Hold {
        go: [right, up, forwards],
        turn: [turn, down],
        roll,
        fast: keys.iter().any(|key| is_fast(*key)),
    }
}

/// Samples of a pixel by path tracing that the key asks for, and of a picture that is saved.
const USUAL_PASSES: u32 = 256;
const SAVED_SAMPLES: u16 = 16;

/// Says what a key does once; `again` if it is still held down, `size` is the window's.
pub fn event(
    key: KeyCode,
    again: bool,
    panel: &PanelData,
    (width, height): (u32, u32),
) -> Option<ViewerEvent> {
    let stepwise = match key {
        KeyCode::Minus | KeyCode::NumpadSubtract => Some(ViewerEvent::Speed { factor: 0.8 }),
        KeyCode::Equal | KeyCode::NumpadAdd => Some(ViewerEvent::Speed { factor: 1.25 }),
        KeyCode::Comma => Some(ViewerEvent::Zoom { factor: 0.95 }),
        KeyCode::Period => Some(ViewerEvent::Zoom { factor: 1.05 }),
        KeyCode::BracketLeft => Some(exposure(panel, -0.5)),
        KeyCode::BracketRight => Some(exposure(panel, 0.5)),
        _ => None,
    };
    if stepwise.is_some() || again {
        return stepwise;
    }
    Some(match key {
        KeyCode::KeyX if panel.kind == PictureKind::Table => show(PictureKind::Exact),
        KeyCode::KeyX => show(usual(panel)),
        KeyCode::KeyV if panel.split.is_some() => show(panel.kind),
        KeyCode::KeyV => ViewerEvent::Show {
            kind: PictureKind::Table,
            split: Some(PictureKind::Exact),
        },
        KeyCode::KeyM => toggled(panel, PictureKind::Error),
        KeyCode::KeyG => toggled(panel, PictureKind::Flat),
        KeyCode::KeyL => ViewerEvent::Paths {
            passes: if panel.passes.1 > 0 { 0 } else { USUAL_PASSES },
        },
        KeyCode::KeyH => ViewerEvent::Home,
        KeyCode::KeyT => ViewerEvent::Follow,
        KeyCode::Escape => ViewerEvent::Halt,
        KeyCode::KeyB => ViewerEvent::Beyond {
            allowed: !panel.beyond,
        },
        KeyCode::KeyR => ViewerEvent::Record {
            on: panel.recording.is_none(),
        },
        KeyCode::KeyP => ViewerEvent::Replay {
            text: String::new(),
        },
        KeyCode::KeyK => ViewerEvent::Capture {
            width,
            height,
            samples: SAVED_SAMPLES,
            light: true,
        },
        KeyCode::Enter => ViewerEvent::Pick { x: 0.5, y: 0.5 },
        _ => return None,
    })
}

fn exposure(panel: &PanelData, stops: f64) -> ViewerEvent {
    ViewerEvent::Exposure {
        stops: panel.exposure + stops,
    }
}

fn show(kind: PictureKind) -> ViewerEvent {
    ViewerEvent::Show { kind, split: None }
}

/// The way in which pictures are made if nothing else is asked for.
fn usual(panel: &PanelData) -> PictureKind {
    match panel.promise {
        Some(_) => PictureKind::Table,
        None => PictureKind::Exact,
    }
}

fn toggled(panel: &PanelData, kind: PictureKind) -> ViewerEvent {
    match panel.kind == kind {
        true => show(usual(panel)),
        false => show(kind),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_held_together_add_up_and_opposite_ones_cancel() {
        let keys = [
            KeyCode::KeyW,
            KeyCode::KeyD,
            KeyCode::ShiftLeft,
            KeyCode::ArrowUp,
        ];
        let wanted = ViewerEvent::Hold {
            go: [1.0, 0.0, 1.0],
            turn: [0.0, -1.0],
            roll: 0.0,
            fast: true,
        };
        assert_eq!(hold(&keys), wanted);
        let nothing = ViewerEvent::Hold {
            go: [0.0; 3],
            turn: [0.0; 2],
            roll: 0.0,
            fast: false,
        };
        assert_eq!(hold(&[KeyCode::KeyW, KeyCode::KeyS]), nothing);
        assert!(!is_held(KeyCode::KeyX) && is_held(KeyCode::ShiftRight));
    }
}
