//! The viewer in a native window, for those without a browser: the same session, and the keys of the user interface in
//! the browser (`controls.js`), all by where they are on a US keyboard.
//!
//! In: the space that all viewers share, and the window's keyboard and mouse. Out: pictures in the window, and in its
//! title what the panel tells of them. The session has a thread of its own; the window's thread shows what that
//! sends, and sends it events. Saved pictures and recorded ways are written into the current folder.

use super::{
    driver::Driver,
    shared_space::SharedSpace,
    window_picture::{WindowPicture, free_name},
};
use geofan_core::{Error, Result, files::write_atomically};
use geofan_view::{PanelData, Patch, PictureKind, ViewerEvent};
use softbuffer::{Context, Surface};
use std::{
    io::{self, Write},
    num::NonZeroU32,
    rc::Rc,
    sync::{
        Arc,
        mpsc::{Receiver, Sender, channel},
    },
    time::Duration,
};
use winit::{
    application::ApplicationHandler,
    dpi::{LogicalSize, PhysicalPosition},
    event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent},
    event_loop::{ActiveEventLoop, EventLoop, EventLoopProxy},
    keyboard::{KeyCode, PhysicalKey},
    window::{Window, WindowId},
};

/// The time that the session waits for an event when there is nothing to do.
const PAUSE: Duration = Duration::from_millis(4);

/// A press that moved less than this, in pixels, is a click.
const CLICK_REACH: f64 = 5.0;

/// About what a notch of a wheel is in pixels.
const NOTCH: f64 = 100.0;

/// First size of the window, in pixels of usual density.
const SIZE: (f64, f64) = (960.0, 540.0);

/// What the session tells the window.
enum Update {
    Patch(Patch),
    Panel(Box<PanelData>),
    Recorded(String),
    End,
}

/// Shows the space in a window until that is closed or the program is to end.
///
/// # Errors
/// There is no display, or no window can be opened on it.
pub fn run(shared: &Arc<SharedSpace>, ended: impl Fn() -> bool + Send) -> Result<()> {
    let events = EventLoop::<Update>::with_user_event().build();
    let events = events.map_err(|e| failed(&e.to_string()))?;
    let (send, receive) = channel();
    let proxy = events.create_proxy();
    let mut app = WindowApp {
        send,
        shown: None,
        picture: WindowPicture::default(),
        panel: None,
        held: Vec::new(),
        modified: false,
        pointer: PhysicalPosition::default(),
        press: None,
        trouble: None,
    };
    let done = std::thread::scope(|threads| {
        threads.spawn(move || drive(shared, &receive, &proxy, ended));
        let done = events.run_app(&mut app);
        shared.end();
        done
    });
    done.map_err(|e| failed(&e.to_string()))?;
    app.trouble.map_or(Ok(()), |trouble| Err(failed(&trouble)))
}

fn failed(message: &str) -> Error {
    Error::Environment {
        path: "window".into(),
        source: io::Error::other(message.to_string()),
    }
}

/// Drives the session.
fn drive(
    shared: &SharedSpace,
    events: &Receiver<ViewerEvent>,
    window: &EventLoopProxy<Update>,
    ended: impl Fn() -> bool,
) {
    let mut driver = Driver::new(shared);
    let (mut recorded, mut told) = (String::new(), f64::NEG_INFINITY);
    while !shared.has_ended() && !ended() {
        for event in events.try_iter() {
            driver.handle(event, shared);
        }
        let worked = driver.turn(shared);
        let mut updates: Vec<Update> = Vec::new();
        updates.extend(driver.session.take_patches().into_iter().map(Update::Patch));
        let now = driver.now();
        if now - told > 0.1 {
            told = now;
            updates.push(Update::Panel(Box::new(driver.session.panel(now))));
        }
        if driver.session.recorded() != recorded {
            recorded = driver.session.recorded().into();
            updates.push(Update::Recorded(recorded.clone()));
        }
        for update in updates {
            if window.send_event(update).is_err() {
                return;
            }
        }
        if !worked && let Ok(event) = events.recv_timeout(PAUSE) {
            driver.handle(event, shared);
        }
    }
    let _ = window.send_event(Update::End);
}

/// A window with what is drawn into it.
type Shown = Surface<Rc<Window>, Rc<Window>>;

/// The window's side.
struct WindowApp {
    send: Sender<ViewerEvent>,
    shown: Option<Shown>,
    picture: WindowPicture,
    panel: Option<Box<PanelData>>,
    /// Keys that are held down.
    held: Vec<KeyCode>,
    /// Ctrl, Alt or Super is held, with which keys are the system's.
    modified: bool,
    pointer: PhysicalPosition<f64>,
    /// How far the pointer has moved since the button went down.
    press: Option<f64>,
    trouble: Option<String>,
}

impl ApplicationHandler<Update> for WindowApp {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.shown.is_some() {
            return;
        }
        match open(events) {
            Ok(shown) => {
                let (width, height) = shown.window().inner_size().into();
                self.tell(ViewerEvent::Resize { width, height });
                self.shown = Some(shown);
            }
            Err(trouble) => {
                self.trouble = Some(trouble);
                events.exit();
            }
        }
    }

    fn user_event(&mut self, events: &ActiveEventLoop, update: Update) {
        match update {
            Update::End => events.exit(),
            Update::Panel(panel) => {
                if let Some(shown) = &self.shown {
                    shown.window().set_title(&title(&panel));
                }
                self.panel = Some(panel);
            }
            Update::Recorded(way) if !way.is_empty() => {
                let path = free_name("camera-path", "toml");
                let written = write_atomically(&path, |out| out.write_all(way.as_bytes()));
                tell_written(written.map(|()| path.display().to_string()));
            }
            Update::Recorded(_) => {}
            Update::Patch(patch) => self.take(&patch),
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested => events.exit(),
            WindowEvent::RedrawRequested => self.redraw(),
            WindowEvent::Resized(size) => self.tell(ViewerEvent::Resize {
                width: size.width,
                height: size.height,
            }),
            WindowEvent::Focused(false) => {
                self.held.clear();
                self.tell_held();
            }
            WindowEvent::ModifiersChanged(keys) => {
                let keys = keys.state();
                self.modified = keys.control_key() || keys.alt_key() || keys.super_key();
            }
            WindowEvent::KeyboardInput { event, .. } => {
                let down = event.state.is_pressed();
                if let PhysicalKey::Code(key) = event.physical_key
                    && !(down && self.modified)
                {
                    self.press_key(key, down, event.repeat);
                }
            }
            WindowEvent::CursorMoved { position, .. } => self.point(position),
            WindowEvent::CursorLeft { .. } => self.tell(ViewerEvent::Hover { x: -1.0, y: -1.0 }),
            WindowEvent::MouseInput {
                state,
                button: MouseButton::Left,
                ..
            } => self.press_button(state),
            WindowEvent::MouseWheel { delta, .. } => {
                let notches = match delta {
                    MouseScrollDelta::LineDelta(_, y) => f64::from(y),
                    MouseScrollDelta::PixelDelta(at) => at.y / NOTCH,
                };
                let factor = (0.2 * notches.clamp(-1.0, 1.0)).exp();
                self.tell(ViewerEvent::Speed { factor });
            }
            _ => {}
        }
    }
}

impl WindowApp {
    /// Sends an event. A session that is gone has ended the window, too.
    fn tell(&self, event: ViewerEvent) {
        let _ = self.send.send(event);
    }

    fn size(&self) -> (f64, f64) {
        let size = self.shown.as_ref().map(|shown| shown.window().inner_size());
        size.map_or((1.0, 1.0), |s| {
            (f64::from(s.width.max(1)), f64::from(s.height.max(1)))
        })
    }

    /// Takes pixels: for the window, or of a picture that is saved.
    fn take(&mut self, patch: &Patch) {
        if let Some(file) = self.picture.take(patch) {
            tell_written(file);
        }
        if patch.last && !patch.capture {
            self.tell(ViewerEvent::Shown { frame: patch.frame });
        }
        if let Some(shown) = &self.shown {
            shown.window().request_redraw();
        }
    }

    fn redraw(&mut self) {
        let Some(shown) = &mut self.shown else { return };
        let size = shown.window().inner_size();
        let sides = NonZeroU32::new(size.width).zip(NonZeroU32::new(size.height));
        let Some((width, height)) = sides else { return };
        if shown.resize(width, height).is_err() {
            return;
        }
        if let Ok(mut buffer) = shown.buffer_mut() {
            let size = (size.width as usize, size.height as usize);
            self.picture.draw(size, &mut buffer);
            let _ = buffer.present();
        }
    }

    fn press_key(&mut self, key: KeyCode, down: bool, again: bool) {
        if is_held(key) {
            self.held.retain(|held| *held != key);
            if down {
                self.held.push(key);
            }
            self.tell_held();
        } else if let Some(panel) = self.panel.as_ref().filter(|_| down) {
            let size = self
                .shown
                .as_ref()
                .map_or((1, 1), |s| s.window().inner_size().into());
            if let Some(event) = key_event(key, again, panel, size) {
                self.tell(event);
            }
        }
    }

    fn tell_held(&self) {
        self.tell(hold(&self.held));
    }

    fn point(&mut self, at: PhysicalPosition<f64>) {
        let (dx, dy) = (at.x - self.pointer.x, at.y - self.pointer.y);
        self.pointer = at;
        let (width, height) = self.size();
        match &mut self.press {
            Some(moved) => {
                *moved += dx.abs() + dy.abs();
                // The picture is dragged: what was under the pointer stays there.
                if *moved >= CLICK_REACH {
                    let (right, down) = (-dx / width, -dy / width);
                    self.tell(ViewerEvent::Look { right, down });
                }
            }
            None => self.tell(ViewerEvent::Hover {
                x: at.x / width,
                y: at.y / height,
            }),
        }
    }

    fn press_button(&mut self, state: ElementState) {
        let moved = self.press.take();
        if state.is_pressed() {
            self.press = Some(0.0);
        } else if moved.is_some_and(|moved| moved < CLICK_REACH) {
            let (width, height) = self.size();
            self.tell(ViewerEvent::Pick {
                x: self.pointer.x / width,
                y: self.pointer.y / height,
            });
        }
    }
}

/// Says in the log which file was written, or why it was not.
fn tell_written(file: Result<String>) {
    match file {
        Ok(name) => tracing::info!("{name}"),
        Err(error) => tracing::warn!("{error}"),
    }
}

/// Opens the window.
fn open(events: &ActiveEventLoop) -> std::result::Result<Shown, String> {
    let wanted = Window::default_attributes()
        .with_title("geofan")
        .with_inner_size(LogicalSize::new(SIZE.0, SIZE.1));
    let window = Rc::new(events.create_window(wanted).map_err(|e| e.to_string())?);
    let context = Context::new(window.clone()).map_err(|e| e.to_string())?;
    Surface::new(&context, window).map_err(|e| e.to_string())
}

/// Tells what the overlay of the user interface does, in one line.
fn title(panel: &PanelData) -> String {
    let (width, height) = panel.size;
    let (whole, _) = panel.display;
    let reduced = if width < whole {
        " (coarser while it moves)"
    } else {
        ""
    };
    let pace = match (panel.rate, panel.seconds) {
        (Some(rate), _) => format!("{rate:.0} frames a second"),
        (None, Some(seconds)) => format!("drawn in {:.0} ms", 1e3 * seconds),
        (None, None) => "…".into(),
    };
    let kind = format!("{:?}", panel.kind).to_lowercase();
    let passes = match panel.passes {
        (0, _) => String::new(),
        (done, wanted) => format!(" · {done} of {wanted} samples by path tracing"),
    };
    let said = [&panel.trouble, &panel.hint, &panel.background];
    let said = said.into_iter().flatten().next();
    let said = said.map_or(String::new(), |text| {
        format!(" · {}", text.lines().next().unwrap_or_default())
    });
    let name = &panel.manifold;
    format!("{name} · {kind} · {pace} · {width}×{height}{reduced}{passes}{said}")
}

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
fn is_held(key: KeyCode) -> bool {
    is_fast(key) || held(key).is_some()
}

/// Says what all keys that are held down do together.
fn hold(keys: &[KeyCode]) -> ViewerEvent {
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
fn key_event(
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
        KeyCode::KeyX => show(usual_kind(panel)),
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
            light: false,
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
fn usual_kind(panel: &PanelData) -> PictureKind {
    match panel.promise {
        Some(_) => PictureKind::Table,
        None => PictureKind::Exact,
    }
}

fn toggled(panel: &PanelData, kind: PictureKind) -> ViewerEvent {
    match panel.kind == kind {
        true => show(usual_kind(panel)),
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
