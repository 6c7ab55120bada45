//! The rules of a session, with a clock and an engine that are made up.

#[path = "session_hint_tests.rs"]
mod hints;
#[path = "session_picture_tests.rs"]
mod pictures;
#[path = "session_random_tests.rs"]
mod random;

use super::*;
use crate::{
    DrawSpace, StartScene,
    frame_plan::Block,
    protocol::{DrawRequest, ViewerEvent},
};
use geofan_bundle::Bundle;
use geofan_core::{
    diagnostic::SourceText,
    manifold::Manifold,
    reading::{FileSource, with_source},
};
use geofan_light::path_tracer::{Estimator, PathTracer, PathTracerSettings};
use geofan_render::{Stage, scene::SceneFile};
use std::{path::Path, rc::Rc, sync::Arc};

/// The manifold of a file with this text after its name and the coordinates x, y, z.
pub(crate) fn manifold(text: &str) -> Arc<Manifold> {
    let text = format!("name = 'test'\ncoordinates = ['x', 'y', 'z']\n{text}");
    let source = SourceText::new("test.toml", text);
    Arc::new(Manifold::from_source(source, &[]).unwrap_or_else(|e| panic!("{}", e.report(false))))
}

/// A golden bundle.
pub(crate) fn bundle(name: &str) -> Bundle {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden");
    Bundle::read(Path::new(&format!("{folder}/{name}.fan"))).unwrap()
}

/// The folder of the catalogue.
const CATALOGUE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/manifolds");

/// The first scene of a manifold, loaded.
pub(crate) fn start_stage(manifold: &Arc<Manifold>, length: f64) -> Stage {
    let scene = StartScene::new(manifold, "m.toml", length).unwrap();
    let mut files = scene.files;
    files.push(("s.toml".into(), scene.text));
    files.push(("m.toml".into(), manifold.source.text.clone()));
    let source: FileSource = Rc::new(move |path| {
        let found = files.iter().find(|(name, _)| Path::new(name) == path);
        let found = found.map(|(_, text)| text.clone().into_bytes());
        // Samples of fields lie where the catalogue has them.
        found.or_else(|| std::fs::read(Path::new(CATALOGUE).join(path)).ok())
    });
    with_source(source, || Stage::load(Path::new("s.toml"), &[]))
        .unwrap_or_else(|e| panic!("{}: {}", manifold.name, e.report(false)))
}

/// A session in a golden bundle's space, or in that of a text.
fn session(bundle: Option<&Bundle>, manifold: &Arc<Manifold>) -> Session {
    let length = manifold.length.unwrap_or(10.0);
    let stage = start_stage(manifold, length);
    Session::new(SessionSpace::new(&stage.scene, manifold, bundle, length).unwrap())
}

const FLAT: &str = "metric = { conformal = '1' }\nexit = [{ name = 'sky', when = 'x^2 + y^2 + z^2 - 100' }]\n[cameras]\nparameters = { c = [0, 1] }\nat = ['c', '0', '0']\nlength = 10";

/// An engine that answers with grey after a time for each pixel, and draws one block at a time.
struct Machine {
    now: f64,
    cost: f64,
    frames: Vec<DrawRequest>,
    /// The display shows what it gets.
    shows: bool,
}

impl Machine {
    fn new(cost: f64) -> Self {
        Self {
            now: 0.0,
            cost,
            frames: Vec::new(),
            shows: true,
        }
    }

    /// Lets the session run for `seconds`.
    fn run(&mut self, session: &mut Session, seconds: f64) {
        let end = self.now + seconds;
        while self.now < end {
            match session.next_work(self.now, 1) {
                None => self.now += 0.004,
                Some(Work::Draw(request)) => {
                    let block = request.block;
                    let pixels = block.width * block.height;
                    self.now += self.cost * (pixels * usize::from(request.samples)) as f64;
                    let answer = Answer::Drawn {
                        frame: request.frame,
                        block,
                        rgb: vec![0.2; 3 * pixels],
                        errors: Vec::new(),
                    };
                    session.accept(self.now, answer);
                    self.frames.push(request);
                }
                Some(Work::Ray(query)) => {
                    let report = RayReport {
                        points: vec![query.u],
                        jumps: Vec::new(),
                        length: 1.0,
                        end: "sky".into(),
                        object: false,
                    };
                    session.accept(
                        self.now,
                        Answer::Ray {
                            number: query.number,
                            report,
                        },
                    );
                }
            }
            for patch in session
                .take_patches()
                .into_iter()
                .filter(|p| p.last && self.shows)
            {
                session.handle(self.now, ViewerEvent::Shown { frame: patch.frame });
            }
        }
    }
}

fn hold(forwards: f64) -> ViewerEvent {
    ViewerEvent::Hold {
        go: [0.0, 0.0, forwards],
        turn: [0.0; 2],
        roll: 0.0,
        fast: false,
    }
}

#[test]
fn a_held_key_moves_by_speed_times_time_whatever_the_frame_rate() {
    let flat = manifold(FLAT);
    let mut ways = Vec::new();
    for cost in [1e-8, 4e-7] {
        let mut session = session(None, &flat);
        let start = session.camera().u;
        let mut machine = Machine::new(cost);
        session.handle(0.0, hold(1.0));
        machine.run(&mut session, 1.0);
        session.handle(machine.now, hold(0.0));
        let way = (session.camera().u - start).length();
        assert!((way - session.speed * machine.now).abs() < 1e-9, "{way}");
        ways.push(machine.frames.len());
    }
    assert!(ways[0] > ways[1]);
}

#[test]
fn a_long_pause_does_not_throw_the_camera_far() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let start = session.camera().u;
    session.handle(0.0, hold(1.0));
    session.handle(1.0, hold(0.0));
    session.handle(1e6, hold(0.0));
    assert!((session.camera().u - start).length() <= 0.2 * session.speed);
}

#[test]
fn a_picked_path_is_followed_along_its_geodesic_wherever_the_camera_looks_meanwhile() {
    let sphere = manifold(
        "metric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }\n[cameras]\nparameters = { c = [0.2, 0.4] }\nat = ['c', '0.1', '0']\nlength = 3",
    );
    let mut session = session(None, &sphere);
    let mut machine = Machine::new(1e-8);
    session.handle(0.0, ViewerEvent::Follow);
    assert!(session.panel(0.0).hint.unwrap().contains("pick"));
    machine.run(&mut session, 0.5);
    session.handle(machine.now, ViewerEvent::Pick { x: 0.7, y: 0.4 });
    machine.run(&mut session, 0.1);
    let (query, report) = session.picked.clone().unwrap();
    session.handle(machine.now, ViewerEvent::Follow);
    let seconds = 1.5 / session.speed;
    machine.run(&mut session, 0.2 * seconds);
    session.handle(
        machine.now,
        ViewerEvent::Look {
            right: 0.4,
            down: -0.3,
        },
    );
    machine.run(&mut session, seconds);
    assert!(!session.panel(machine.now).travelling);
    let camera = Camera {
        u: DVec3::from_array(query.u),
        rotation: glam::DQuat::IDENTITY,
    };
    let by = DVec3::from_array(query.direction) * (0.9 * report.length);
    let expected = camera.moved(&sphere, by).camera.u;
    assert!((session.camera().u - expected).length() < 1e-7);
}

#[test]
fn home_and_named_places_are_found_and_impossible_ones_are_refused_with_a_reason() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let home = *session.camera();
    session.handle(0.0, hold(1.0));
    session.handle(0.1, hold(0.0));
    assert_ne!(session.camera().u, home.u);
    session.handle(0.2, ViewerEvent::Home);
    assert_eq!(session.camera().u, home.u);
    let pose = |at, look| {
        ViewerEvent::Place(Pose {
            at,
            look,
            up: [0.0, 0.0, 1.0],
            fov: 60.0,
        })
    };
    for (at, look) in [
        ([f64::NAN; 3], [1.0, 0.0, 0.0]),
        ([0.0; 3], [0.0, 0.0, 1.0]),
        ([0.0; 3], [0.0; 3]),
    ] {
        session.handle(0.3, pose(at, look));
        assert_eq!(session.camera().u, home.u);
        assert!(session.panel(0.3).hint.is_some());
    }
    session.handle(0.4, pose([0.5, 0.25, 0.0], [0.0, 1.0, 0.0]));
    assert_eq!(session.camera().u, DVec3::new(0.5, 0.25, 0.0));
    session.handle(
        0.5,
        ViewerEvent::View {
            name: "nowhere".into(),
        },
    );
    assert!(session.panel(0.5).hint.unwrap().contains("nowhere"));
}

#[test]
fn the_table_s_edge_stops_the_camera_with_a_hint_or_lets_it_go_on_with_exact_paths() {
    let bundle = bundle("s3");
    let mut session = session(Some(&bundle), &bundle.manifold.clone());
    assert_eq!(session.panel(0.0).kind, PictureKind::Table);
    let mut machine = Machine::new(1e-8);
    session.handle(0.0, hold(-1.0));
    machine.run(&mut session, 8.0);
    let panel = session.panel(machine.now);
    assert!(panel.hint.unwrap().contains("beyond") && panel.within_table);
    session.handle(machine.now, ViewerEvent::Beyond { allowed: true });
    machine.run(&mut session, 2.0);
    let panel = session.panel(machine.now);
    assert!(panel.hint.is_none() && !panel.within_table);
}

/// The space of a golden bundle, with its table and without.
fn with_and_without_table() -> [SessionSpace; 2] {
    let bundle = bundle("s3");
    let with = session(Some(&bundle), &bundle.manifold).space().clone();
    let without = SessionSpace {
        table: None,
        ..with.clone()
    };
    [with, without]
}

#[test]
fn chosen_kinds_are_shown_again_when_a_table_comes() {
    let [with, without] = with_and_without_table();
    let kinds = |session: &mut Session| {
        let panel = session.panel(0.0);
        (panel.kind, panel.split)
    };
    let split = (PictureKind::Table, Some(PictureKind::Exact));
    let show = |(kind, split)| ViewerEvent::Show { kind, split };
    let mut session = Session::new(with.clone());
    session.handle(0.0, show(split));
    session.replace_space(without.clone());
    assert_eq!(kinds(&mut session), (PictureKind::Exact, None));
    session.replace_space(with.clone());
    assert_eq!(kinds(&mut session), split);
    // What is asked for before the first table comes waits for it.
    let mut session = Session::new(without.clone());
    session.handle(0.0, show(split));
    assert!(session.panel(0.0).hint.unwrap().contains("no table yet"));
    session.replace_space(with.clone());
    assert_eq!(kinds(&mut session), split);
    assert_eq!(session.panel(0.0).hint, None);
    // Unless something else has been chosen since; what is there already is no choice.
    let exact = (PictureKind::Exact, None);
    for (first, expected) in [(Some(split), exact), (None, (PictureKind::Table, None))] {
        let mut session = Session::new(without.clone());
        for kinds in first.into_iter().chain([exact]) {
            session.handle(0.0, show(kinds));
        }
        session.replace_space(with.clone());
        assert_eq!(kinds(&mut session), expected);
    }
}

#[test]
fn a_table_that_comes_leaves_the_picked_path_and_the_flight_along_it() {
    let [with, without] = with_and_without_table();
    let mut session = Session::new(without);
    let mut machine = Machine::new(1e-8);
    session.handle(0.0, ViewerEvent::Pick { x: 0.5, y: 0.5 });
    machine.run(&mut session, 0.1);
    session.handle(machine.now, ViewerEvent::Follow);
    session.replace_space(with);
    let panel = session.panel(machine.now);
    assert!(panel.travelling && panel.picked.is_some());
    let other = manifold(FLAT);
    let stage = start_stage(&other, 10.0);
    session.replace_space(SessionSpace::new(&stage.scene, &other, None, 10.0).unwrap());
    let panel = session.panel(machine.now);
    assert!(!panel.travelling && panel.picked.is_none());
}

#[test]
fn what_halts_nothing_forgets_the_picked_path() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-8);
    session.handle(0.0, ViewerEvent::Pick { x: 0.5, y: 0.5 });
    machine.run(&mut session, 0.1);
    session.handle(machine.now, ViewerEvent::Follow);
    for left in [true, false] {
        session.handle(machine.now, ViewerEvent::Halt);
        let panel = session.panel(machine.now);
        assert_eq!((panel.travelling, panel.picked.is_some()), (false, left));
    }
}

#[test]
fn a_recorded_way_is_replayed_to_where_it_ended() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-8);
    session.handle(0.0, ViewerEvent::Record { on: true });
    session.handle(0.0, hold(1.0));
    machine.run(&mut session, 1.3);
    session.handle(machine.now, hold(0.0));
    session.handle(machine.now, ViewerEvent::Record { on: false });
    let end = *session.camera();
    session.handle(machine.now, ViewerEvent::Home);
    session.handle(
        machine.now,
        ViewerEvent::Replay {
            text: String::new(),
        },
    );
    machine.run(&mut session, 3.0);
    assert!((session.camera().u - end.u).length() < 1e-6);
    session.handle(
        machine.now,
        ViewerEvent::Replay {
            text: "[[pose]]".into(),
        },
    );
    assert!(session.panel(machine.now).hint.is_some());
}

#[test]
fn a_replayed_way_has_the_scene_s_angle_of_view_and_tells_what_is_not_shown() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-8);
    let usual = session.panel(0.0).pose.fov;
    session.handle(0.0, ViewerEvent::Zoom { factor: 0.5 });
    let pose = |time: i32, more: &str| {
        format!(
            "[[pose]]\ntime = {time}\nat = [0.{time}, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n{more}\n"
        )
    };
    let text = pose(0, "") + &pose(1, "");
    session.handle(0.0, ViewerEvent::Replay { text });
    machine.run(&mut session, 2.0);
    let panel = session.panel(machine.now);
    assert_eq!((panel.pose.fov, panel.hint), (usual, None));
    let text = pose(0, "velocity = [0.5, 0, 0]") + &pose(1, "");
    session.handle(machine.now, ViewerEvent::Replay { text });
    let hint = session.panel(machine.now).hint.unwrap_or_default();
    assert!(hint.contains("`velocity`"), "{hint}");
}

#[test]
fn a_point_of_the_flat_picture_is_where_the_straight_line_leads() {
    let sphere = manifold(
        "metric = { conformal = '2/(1 + x^2 + y^2 + z^2)' }\n[cameras]\nparameters = { c = [0.2, 0.4] }\nat = ['c', '0.1', '0']\nlength = 3",
    );
    let drawer = DrawSpace::new(start_stage(&sphere, 3.0), None, 3.0);
    let ends = [PictureKind::Flat, PictureKind::Exact].map(|kind| {
        let query = RayQuery {
            number: 1,
            kind,
            u: [0.2, 0.1, 0.0],
            direction: [0.0, 0.6, 0.8],
        };
        let Answer::Ray { report, .. } = drawer.answer(&Work::Ray(query)) else {
            panic!("a path is told")
        };
        let (first, last) = (report.points[0], report.points[report.points.len() - 1]);
        (DVec3::from_array(last) - DVec3::from_array(first)).normalize()
    });
    let straight = DVec3::new(0.0, 0.6, 0.8);
    assert!(ends[0].abs_diff_eq(straight, 1e-9), "{}", ends[0]);
    assert!(!ends[1].abs_diff_eq(straight, 1e-2), "{}", ends[1]);
}

#[test]
fn other_skies_stand_beyond_every_exit_until_the_scene_s_come_back() {
    let flat = manifold(FLAT);
    let stage = start_stage(&flat, 10.0);
    let mut draw = DrawSpace::new(stage, None, 10.0);
    let request = DrawRequest {
        frame: 1,
        // Well before the sky in the line of sight, −z: paths are followed over 10.
        u: [0.0, 0.1, -5.0],
        rotation: [0.0, 0.0, 0.0, 1.0],
        fov: 60.0,
        size: (24, 16),
        block: Block {
            x: 0,
            y: 0,
            width: 24,
            height: 16,
        },
        margin: 0,
        samples: 1,
        kind: PictureKind::Exact,
        each: true,
        pass: None,
    };
    let mut picture = |sky: SkyChoice| {
        draw.dress(sky);
        draw.answer(&Work::Draw(request.clone()))
    };
    let scene = picture(SkyChoice::Scene);
    let [stars, grid] = [SkyChoice::Stars, SkyChoice::Grid].map(&mut picture);
    assert_ne!(stars, grid);
    assert_eq!(picture(SkyChoice::Scene), scene);
    let mut session = session(None, &flat);
    let stars = ViewerEvent::Sky {
        sky: SkyChoice::Stars,
    };
    session.handle(0.0, stars);
    assert_eq!(session.panel(0.0).sky, SkyChoice::Stars);
}

#[test]
fn what_cannot_be_drawn_is_said_and_not_tried_for_ever() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let Some(Work::Draw(request)) = session.next_work(0.0, 1) else {
        panic!("a picture is wanted")
    };
    let message = String::from("the table is damaged");
    session.accept(
        0.1,
        Answer::Failed {
            frame: Some(request.frame),
            message,
        },
    );
    assert!(session.next_work(0.2, 1).is_none());
    assert!(session.panel(0.2).hint.unwrap().contains("damaged"));
    session.handle(
        0.3,
        ViewerEvent::Look {
            right: 0.1,
            down: 0.0,
        },
    );
    assert!(session.next_work(0.3, 1).is_some());
}

#[test]
fn a_block_drawn_alone_is_the_part_of_the_whole_picture() {
    let bundle = bundle("s3");
    let space = bundle.manifold.clone();
    let stage = start_stage(&space, bundle.table.length);
    let mut session =
        Session::new(SessionSpace::new(&stage.scene, &space, Some(&bundle), 3.0).unwrap());
    session.handle(
        0.0,
        ViewerEvent::Resize {
            width: 320,
            height: 192,
        },
    );
    let drawer = DrawSpace::new(stage, Some(bundle), 3.0);
    let Some(Work::Draw(first)) = session.next_work(0.0, 1) else {
        panic!("a picture is wanted")
    };
    // A still one, not the first, which is small.
    let whole = DrawRequest {
        size: (320, 192),
        margin: 2,
        each: true,
        ..first
    };
    let light = |request: DrawRequest| match drawer.answer(&Work::Draw(request)) {
        Answer::Drawn { rgb, .. } => rgb,
        other => panic!("{other:?}"),
    };
    let all = light(DrawRequest {
        block: Block {
            x: 0,
            y: 0,
            width: 320,
            height: 192,
        },
        size: (320, 192),
        ..whole.clone()
    });
    let block = Block {
        x: 64,
        y: 64,
        width: 192,
        height: 64,
    };
    let part = light(DrawRequest {
        block,
        size: (320, 192),
        margin: 64,
        ..whole.clone()
    });
    let mut differing = 0;
    for (y, x) in (0..block.height).flat_map(|y| (0..block.width).map(move |x| (y, x))) {
        for c in 0..3 {
            let a = all[3 * ((y + block.y) * 320 + x + block.x) + c];
            let b = part[3 * (y * block.width + x) + c];
            differing += usize::from((a - b).abs() > 1e-3);
        }
    }
    assert!(
        differing * 1000 <= 3 * block.width * block.height,
        "{differing}"
    );
    // The other ways of drawing give something too.
    for kind in [PictureKind::Exact, PictureKind::Flat, PictureKind::Error] {
        let block = Block {
            x: 0,
            y: 0,
            width: 32,
            height: 16,
        };
        let size = (32, 16);
        let rgb = light(DrawRequest {
            kind,
            block,
            size,
            each: true,
            ..whole.clone()
        });
        assert!(
            rgb.iter().all(|x| x.is_finite()) && rgb.iter().any(|x| *x > 0.0),
            "{kind:?}"
        );
    }
    // Traced light is that of the path tracer, sample by sample, in whatever block a pixel is.
    let (block, pass) = (
        Block {
            x: 5,
            y: 3,
            width: 9,
            height: 7,
        },
        Some(2),
    );
    let size = (32, 16);
    let traced = light(DrawRequest {
        block,
        size,
        pass,
        ..whole.clone()
    });
    let view = View::of_camera(&whole.camera(), whole.fov, size);
    let settings = PathTracerSettings {
        seed: 0,
        length: drawer.length(),
        tolerance: 1e-8,
        bounces: u32::MAX,
        estimator: Estimator::Connected,
    };
    let tracer = PathTracer::new(&drawer.stage.world, &view, settings);
    let all = tracer.pass(2, || false).unwrap();
    for (i, pixel) in traced.chunks_exact(3).enumerate() {
        let at = (block.y + i / block.width) * size.0 + block.x + i % block.width;
        let known = all[at].to_array().map(|x| x as f32);
        assert_eq!(*pixel, known, "{i}");
    }
    let query = RayQuery {
        number: 1,
        kind: PictureKind::Exact,
        u: whole.u,
        direction: [1.0, 0.0, 0.0],
    };
    let Answer::Ray { report, .. } = drawer.answer(&Work::Ray(query)) else {
        panic!("a path is told")
    };
    assert!(report.points.len() > 10 && report.length > 0.0);
}
