//! Whatever a user does: random events, and what holds after each.

use super::{Machine, bundle, manifold, session};
use crate::protocol::{PictureKind, Pose, ViewerEvent};
use geofan_core::random::Stream;

/// A random event, some of them nonsense.
fn random_event(random: &mut Stream) -> ViewerEvent {
    let mut number = |scale: f64| {
        let x = random.uniform();
        let odd = [f64::NAN, f64::INFINITY, -1e300, 0.0];
        if x < 0.03 {
            odd[(random.uniform() * 4.0) as usize % 4]
        } else {
            (2.0 * x - 1.0) * scale
        }
    };
    match (number(1.0).abs().min(0.999) * 24.0) as usize {
        0..=5 => ViewerEvent::Hold {
            go: [number(1.2), number(1.2), number(1.2)],
            turn: [number(1.0), number(1.0)],
            roll: number(1.0),
            fast: number(1.0) > 0.0,
        },
        6..=8 => ViewerEvent::Look {
            right: number(0.3),
            down: number(0.3),
        },
        9 => ViewerEvent::Speed {
            factor: 1.0 + number(0.9),
        },
        10 => ViewerEvent::Zoom {
            factor: 1.0 + number(0.9),
        },
        11 => ViewerEvent::Home,
        12 => ViewerEvent::Show {
            kind: [
                PictureKind::Table,
                PictureKind::Exact,
                PictureKind::Flat,
                PictureKind::Error,
            ][(number(2.0).abs() as usize).min(3)],
            split: (number(1.0) > 0.0).then_some(PictureKind::Exact),
        },
        13 => ViewerEvent::Exposure { stops: number(5.0) },
        14 => ViewerEvent::Beyond {
            allowed: number(1.0) > 0.5,
        },
        15 => ViewerEvent::Hover {
            x: number(1.0),
            y: number(1.0),
        },
        16 => ViewerEvent::Pick {
            x: number(1.0).abs(),
            y: number(1.0).abs(),
        },
        17 => ViewerEvent::Follow,
        18 => ViewerEvent::Record {
            on: number(1.0) > 0.0,
        },
        19 => ViewerEvent::Replay {
            text: String::new(),
        },
        20 => ViewerEvent::Resize {
            width: number(900.0).abs() as u32,
            height: number(900.0).abs() as u32,
        },
        21 => ViewerEvent::Paths {
            passes: number(9.0).abs() as u32,
        },
        22 => ViewerEvent::Resolution { share: number(2.0) },
        _ => ViewerEvent::Place(Pose {
            at: [number(3.0), number(3.0), number(3.0)],
            look: [number(1.0), number(1.0), number(1.0)],
            up: [0.0, 0.0, 1.0],
            fov: number(100.0),
        }),
    }
}

/// Random events of a session; `GEOFAN_VIEW_STEPS` asks for more, 60,000 are 30 minutes of the session's clock.
fn steps() -> usize {
    let asked = std::env::var("GEOFAN_VIEW_STEPS").ok();
    asked.and_then(|steps| steps.parse().ok()).unwrap_or(250)
}

#[test]
fn whatever_a_user_does_the_axes_stay_orthonormal_and_the_camera_inside() {
    let golden = bundle("three-bumps-rail");
    let sphere = bundle("s3");
    let ended = manifold(
        "metric = { conformal = '1 + 1/(4*(x^2 + y^2 + z^2))' }\nexit = [{ name = 'sky', when = 'x^2 + y^2 + z^2 - 25' }]\n[domain]\ninside = ['x^2 + y^2 + z^2 - 0.04']\n[cameras]\nparameters = { c = [1, 2] }\nat = ['c', '0', '0']\nlength = 10",
    );
    let torus = manifold(
        "metric = { conformal = '1' }\n[domain]\nx = [-1, 1]\ny = [-1, 1]\nz = [-1, 1]\nperiodic = ['x', 'y', 'z']\n[cameras]\nlength = 12",
    );
    for (seed, bundle, space) in [
        (1, Some(&golden), golden.manifold.clone()),
        (2, Some(&sphere), sphere.manifold.clone()),
        (3, None, ended),
        (4, None, torus),
    ] {
        let mut session = session(bundle, &space);
        let mut machine = Machine::new(2e-7);
        let mut random = Stream::new(&[seed]);
        for step in 0..steps() {
            let event = random_event(&mut random);
            session.handle(machine.now, event.clone());
            machine.run(&mut session, 0.03);
            let section = session.next_section(machine.now);
            if let Some(section) = section.filter(|_| random.uniform() < 0.5) {
                session.section_decoded(section);
            }
            let camera = session.camera();
            let axes = camera.axes(&space);
            let gram = axes.transpose() * space.metric(camera.u) * axes;
            let off = (gram - glam::DMat3::IDENTITY).to_cols_array();
            let worst = off.into_iter().map(f64::abs).fold(0.0, f64::max);
            assert!(
                worst < 1e-12,
                "{} step {step}: {worst:e} after {event:?}",
                space.name
            );
            assert!(space.domain.violation(camera.u).is_none());
            assert!(camera.u.is_finite());
            let _ = session.panel(machine.now);
        }
    }
}
