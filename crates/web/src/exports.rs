//! The functions that a page calls. Numbers go in and out; everything else is in the buffers.
//!
//! | function | input | output |
//! |---|---|---|
//! | `geofan_input(length)` | | room for so many bytes; returns where |
//! | `geofan_output()`, `geofan_output_length()` | | where the output is, and its length |
//! | `geofan_open_session()` | package | 0, or 1 and what was wrong |
//! | `geofan_open_drawing()` | package | 0, or 1 and what was wrong |
//! | `geofan_set_session()`, `geofan_set_drawing()` | all parameters as JSON, or none for those of the package | 0, or 1 and what was wrong |
//! | `geofan_dress()` | what skies show, as JSON | |
//! | `geofan_event(now)` | an event | |
//! | `geofan_trouble()` | a text | |
//! | `geofan_next(now, workers)` | | 1 and work, or 0 |
//! | `geofan_work()` | work | the answer |
//! | `geofan_accept(now)` | an answer | |
//! | `geofan_fail(now)` | work whose worker has failed | |
//! | `geofan_next_section(now)` | | a section to be decoded in every drawing, or −1 |
//! | `geofan_decode(section)` | | |
//! | `geofan_decoded(section)` | | |
//! | `geofan_patch()`, `geofan_message(now)` | | 1 and pixels or a message, or 0 |

// Exporting a function by its name counts as unsafe, because names must be unique; nothing else here is.
#![allow(unsafe_code)]

use crate::Instance;
use geofan_core::Result;
use std::cell::RefCell;

thread_local! {
    static INSTANCE: RefCell<Instance> = RefCell::default();
}

fn with<T>(call: impl FnOnce(&mut Instance) -> T) -> T {
    INSTANCE.with_borrow_mut(call)
}

/// Returns 0, or 1 with the reason in the output.
fn told(call: impl FnOnce(&mut Instance) -> Result<()>) -> u32 {
    with(|instance| match call(instance) {
        Ok(()) => 0,
        Err(error) => {
            instance.output = format!("error: {error}").into_bytes();
            1
        }
    })
}

/// Makes room for `length` bytes of input and returns where.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_input(length: usize) -> *mut u8 {
    with(|instance| {
        // The last input goes first: a page's memory keeps the most that was ever in use.
        instance.input = Vec::new();
        instance.input = vec![0; length];
        instance.input.as_mut_ptr()
    })
}

/// Returns where the output is.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_output() -> *const u8 {
    with(|instance| instance.output.as_ptr())
}

/// Returns the length of the output.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_output_length() -> usize {
    with(|instance| instance.output.len())
}

/// Opens a package for a session.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_open_session() -> u32 {
    told(Instance::open_session)
}

/// Opens a package for drawing.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_open_drawing() -> u32 {
    told(Instance::open_drawing)
}

/// Loads the session's space with other parameters.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_set_session() -> u32 {
    told(Instance::set)
}

/// Loads the drawing's space with other parameters.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_set_drawing() -> u32 {
    told(Instance::set)
}

/// Shows other skies.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_dress() {
    with(Instance::dress);
}

/// Takes an event.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_event(now: f64) {
    with(|instance| instance.event(now));
}

/// Takes a text about what is wrong.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_trouble() {
    with(Instance::trouble);
}

/// Gives out work.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_next(now: f64, workers: u32) -> u32 {
    with(|instance| instance.next(now, workers).into())
}

/// Does work.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_work() {
    with(Instance::work);
}

/// Takes an answer.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_accept(now: f64) {
    with(|instance| instance.accept(now));
}

/// Takes work that nobody does any more.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_fail(now: f64) {
    with(|instance| instance.fail(now));
}

/// Gives out a section of the table that every drawing is to decode.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_next_section(now: f64) -> i32 {
    with(|instance| instance.next_section(now))
}

/// Decodes a section of the drawing's table.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_decode(section: u32) {
    with(|instance| instance.decode(section as usize));
}

/// Tells the session that all drawings have decoded a section.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_decoded(section: u32) {
    with(|instance| instance.decoded(section as usize));
}

/// Gives out pixels.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_patch() -> u32 {
    with(|instance| instance.patch().into())
}

/// Gives out a message.
#[unsafe(no_mangle)]
pub extern "C" fn geofan_message(now: f64) -> u32 {
    with(|instance| instance.message(now).into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_view::{Package, PageAbout};

    /// Packs a space of flat parameters `a` and `b` of which the page's maker replaced `a` by 2.
    fn package() -> Package {
        let manifold = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = 'a*b' }\nparameters = { a = 1, b = 1 }\nexit = [{ name = 'sky', when = 'x^2 + y^2 + z^2 - 9' }]\n";
        let scene = "manifold = 'm.toml'\ncamera = { at = [0, 0, 0], look = [1, 0, 0], up = [0, 0, 1] }\nsky = { sky = { pattern = 'grid' } }\n";
        let mut package = Package::default();
        package.add("m.toml", manifold.into());
        package.add("s.toml", scene.into());
        let about = PageAbout {
            scene: "s.toml".into(),
            settings: vec![("a".into(), 2.0)],
            length: 10.0,
        };
        package.add(PageAbout::NAME, about.encode());
        package
    }

    #[test]
    fn with_no_parameters_everything_is_as_it_was_packed_and_with_others_the_lamps_light_is_left_out()
     {
        let mut package = package();
        package.add(PageAbout::LIGHT, vec![0]);
        let mut instance = Instance {
            input: package.encode(),
            ..Instance::default()
        };
        instance.open_session().unwrap();
        let mut set = |text: &str| {
            instance.input = text.into();
            instance.set().unwrap();
            let panel = instance.session.as_mut().unwrap().panel(0.0);
            let values: Vec<f64> = panel.parameters.iter().map(|(_, value)| *value).collect();
            (values, panel.background.is_some())
        };
        assert_eq!(set(r#"[["a",2],["b",3]]"#), (vec![2.0, 3.0], true));
        assert_eq!(set("[]"), (vec![2.0, 1.0], false));
    }

    #[test]
    fn a_session_and_a_drawing_of_one_package_make_a_picture_together() {
        let package = package();
        let (mut session, mut drawing) = (Instance::default(), Instance::default());
        for instance in [&mut session, &mut drawing] {
            instance.input = package.encode();
        }
        session.open_session().unwrap();
        drawing.open_drawing().unwrap();
        session.input = br#"{"type":"resize","width":64,"height":48}"#.to_vec();
        session.event(0.0);
        let mut pictures = 0;
        let mut now = 0.0;
        while pictures < 2 && now < 10.0 {
            now += 0.1;
            while session.next(now, 1) {
                drawing.input = session.output.clone();
                drawing.work();
                session.input = drawing.output.clone();
                session.accept(now);
                while session.patch() {
                    pictures += usize::from(session.output[0] & 2 == 2);
                    assert!(session.output[32..].chunks(4).any(|p| p[0] > 30));
                }
            }
        }
        assert!(pictures >= 2);
        assert!(session.message(now));
        // A worker that fails ends its picture, with a hint.
        session.input = br#"{"type":"home"}"#.to_vec();
        session.event(now);
        assert!(session.next(now, 1));
        session.input = session.output.clone();
        session.fail(now);
        assert!(!session.next(now, 1));
        let hint = session.session.as_mut().unwrap().panel(now).hint;
        assert_eq!(hint.as_deref(), Some("a worker has failed"));
        drawing.input = b"no package".to_vec();
        assert!(drawing.open_drawing().is_err());
    }
}
