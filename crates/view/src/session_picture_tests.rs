//! What a session draws, and when: moving pictures, refined ones, samples of traced light, error pictures, saved ones.

use super::*;

#[test]
fn moving_pictures_get_as_small_as_the_machine_needs_and_still_ones_are_refined() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(3e-7);
    session.handle(
        0.0,
        ViewerEvent::Resize {
            width: 1280,
            height: 720,
        },
    );
    session.handle(0.0, hold(1.0));
    machine.run(&mut session, 2.0);
    let moving = machine.frames.last().unwrap().clone();
    assert!(moving.size.0 <= 640 && !moving.each, "{:?}", moving.size);
    session.handle(machine.now, hold(0.0));
    machine.frames.clear();
    machine.run(&mut session, 20.0);
    let samples: Vec<u16> = machine.frames.iter().map(|f| f.samples).collect();
    assert!(samples.is_sorted() && samples.contains(&1) && *samples.last().unwrap() == 16);
    let still: Vec<_> = machine.frames.iter().filter(|f| f.each).collect();
    assert!(still.iter().all(|f| f.size == (1280, 720)));
    // When all is done there is nothing more to do.
    machine.frames.clear();
    machine.run(&mut session, 1.0);
    assert!(machine.frames.is_empty());
    let panel = session.panel(machine.now);
    assert!(panel.samples == 16 && panel.settled);
}

#[test]
fn the_very_first_picture_is_a_small_one_however_late_the_engine_is() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-6);
    machine.now = 5.0;
    machine.run(&mut session, 0.05);
    let first = &machine.frames[0];
    assert!(first.size.0 <= 320 && !first.each, "{:?}", first.size);
    machine.run(&mut session, 5.0);
    assert_eq!(machine.frames.last().unwrap().size, (640, 360));
}

#[test]
fn light_is_traced_in_place_of_the_refined_picture_and_any_change_begins_it_anew() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-8);
    session.handle(0.0, ViewerEvent::Paths { passes: 6 });
    machine.run(&mut session, 5.0);
    let passes: Vec<u64> = machine.frames.iter().filter_map(|f| f.pass).collect();
    assert!(passes.is_sorted() && passes.first() == Some(&0) && passes.last() == Some(&5));
    // Not before the picture has all its samples.
    let first = machine
        .frames
        .iter()
        .position(|f| f.pass.is_some())
        .unwrap();
    assert_eq!(machine.frames[first - 1].samples, 16);
    let pixels = |frames: &[DrawRequest], pass: u64| -> usize {
        let of_pass = frames.iter().filter(|f| f.pass == Some(pass));
        of_pass.map(|f| f.block.width * f.block.height).sum()
    };
    assert!((0..6).all(|pass| pixels(&machine.frames, pass) == 640 * 360));
    let panel = session.panel(machine.now);
    assert!(panel.settled && panel.passes == (6, 6));
    // More of them go on from those that there are.
    machine.frames.clear();
    session.handle(machine.now, ViewerEvent::Paths { passes: 8 });
    machine.run(&mut session, 2.0);
    assert_eq!(machine.frames[0].pass, Some(6));
    // A head that turns throws them away.
    machine.frames.clear();
    session.handle(
        machine.now,
        ViewerEvent::Look {
            right: 0.01,
            down: 0.0,
        },
    );
    machine.run(&mut session, 5.0);
    assert_eq!(machine.frames[0].pass, None);
    assert_eq!(session.panel(machine.now).passes, (8, 8));
    // Without them the picture that they were put over is drawn again.
    machine.frames.clear();
    session.handle(machine.now, ViewerEvent::Paths { passes: 0 });
    machine.run(&mut session, 5.0);
    assert!(machine.frames.iter().all(|f| f.pass.is_none()) && !machine.frames.is_empty());
    assert_eq!(session.panel(machine.now).samples, 16);
}

#[test]
fn where_no_light_can_be_traced_a_hint_says_so() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let show = |kind: PictureKind| ViewerEvent::Show { kind, split: None };
    session.handle(0.0, show(PictureKind::Flat));
    session.handle(0.0, ViewerEvent::Paths { passes: 6 });
    let hint = session.panel(0.0).hint.unwrap_or_default();
    assert!(hint.contains("choose one of them"), "{hint}");
    session.handle(0.0, show(PictureKind::Exact));
    assert_eq!(session.panel(0.0).hint, None);
    session.handle(0.0, ViewerEvent::Paths { passes: 8 });
    assert_eq!(session.panel(0.0).hint, None);
}

#[test]
fn the_first_samples_of_traced_light_are_not_shown_alone() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-8);
    machine.run(&mut session, 5.0);
    session.handle(machine.now, ViewerEvent::Paths { passes: 64 });
    let mut shown = 0;
    for k in 0.. {
        let Some(Work::Draw(request)) = session.next_work(machine.now, 1) else {
            panic!("samples are wanted")
        };
        let pixels = 3 * request.block.width * request.block.height;
        let answer = Answer::Drawn {
            frame: request.frame,
            block: request.block,
            rgb: vec![k as f32; pixels],
            errors: Vec::new(),
        };
        session.accept(machine.now, answer);
        shown += session.take_patches().len();
        match request.pass {
            Some(pass) if pass < 3 => assert_eq!(shown, 0),
            Some(4) => break,
            _ => {}
        }
    }
    assert!(shown > 0);
}

#[test]
fn without_path_tracing_a_sample_that_is_being_drawn_is_never_shown() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-8);
    machine.run(&mut session, 5.0);
    session.handle(machine.now, ViewerEvent::Paths { passes: 64 });
    let Some(Work::Draw(first)) = session.next_work(machine.now, 1) else {
        panic!("samples are wanted")
    };
    assert_eq!(first.pass, Some(0));
    session.handle(machine.now, ViewerEvent::Paths { passes: 0 });
    let answer = Answer::Drawn {
        frame: first.frame,
        block: first.block,
        rgb: vec![9.0; 3 * first.block.width * first.block.height],
        errors: Vec::new(),
    };
    session.accept(machine.now, answer);
    assert!(session.take_patches().is_empty());
    // Nothing of it was shown, so the picture is still the refined one.
    assert!(session.next_work(machine.now, 1).is_none());
    assert!(session.panel(machine.now).settled);
}

#[test]
fn the_cells_of_a_camera_and_before_it_are_decoded_first_and_exact_paths_stand_in_until_then() {
    let bundle = bundle("three-bumps-rail");
    let mut session = session(Some(&bundle), &bundle.manifold.clone());
    let at = |x: f64| [x, 0.3, 0.2];
    let cell = |x: f64| bundle.table.chunks_at(DVec3::from_array(at(x))).unwrap();
    let (here, ahead) = (cell(1.0), cell(-1.0));
    assert!(here.len() == 1 && ahead.len() == 1 && here != ahead);
    let pose = Pose {
        at: at(1.0),
        look: [-1.0, 0.0, 0.0],
        up: [0.0, 0.0, 1.0],
        fov: 90.0,
    };
    session.handle(0.0, ViewerEvent::Place(pose));
    // Whatever their order in the file: the camera's own, then the other; each once.
    assert_eq!(session.next_section(0.0), Some(here[0]));
    assert_eq!(session.next_section(0.0), Some(ahead[0]));
    assert_eq!(session.next_section(0.0), None);
    let mut machine = Machine::new(1e-8);
    machine.run(&mut session, 2.0);
    // Exact paths between which is interpolated, and nothing that would take long.
    let stands_in = |f: &DrawRequest| f.kind == PictureKind::Exact && !f.each;
    assert!(!machine.frames.is_empty() && machine.frames.iter().all(stands_in));
    assert!(session.panel(machine.now).decoding && !session.panel(machine.now).settled);
    machine.frames.clear();
    session.section_decoded(here[0]);
    machine.run(&mut session, 2.0);
    let by_table = |f: &DrawRequest| f.kind == PictureKind::Table;
    assert!(!machine.frames.is_empty() && machine.frames.iter().all(by_table));
    assert!(session.panel(machine.now).settled);
    // Over the edge of the cell into one that is not decoded, and no picture waits for it.
    machine.frames.clear();
    session.handle(machine.now, hold(1.0));
    machine.run(&mut session, 2.5);
    assert!(session.camera().u.x < 0.0);
    for frame in &machine.frames {
        let is_here = bundle.table.chunks_at(DVec3::from_array(frame.u)).unwrap() == here;
        assert_eq!(by_table(frame), is_here, "{:?}", frame.u);
    }
    session.section_decoded(ahead[0]);
    machine.frames.clear();
    machine.run(&mut session, 1.0);
    assert!(machine.frames.iter().all(by_table));
}

#[test]
fn exposure_and_the_pointer_throw_no_work_away() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-7);
    machine.run(&mut session, 30.0);
    machine.frames.clear();
    session.handle(machine.now, ViewerEvent::Exposure { stops: 1.0 });
    let patches = session.take_patches();
    assert!(!patches.is_empty() && patches.last().unwrap().last);
    session.handle(machine.now, ViewerEvent::Hover { x: 0.5, y: 0.5 });
    session.handle(machine.now, ViewerEvent::Beyond { allowed: true });
    session.handle(machine.now, ViewerEvent::Speed { factor: 2.0 });
    machine.run(&mut session, 1.0);
    assert!(machine.frames.is_empty());
    assert_eq!(session.panel(machine.now).hover, Some(("sky".into(), 1.0)));
}

#[test]
fn what_was_under_the_pointer_is_told_no_more_when_the_camera_or_the_pointer_is_elsewhere() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-8);
    let hover = |x| ViewerEvent::Hover { x, y: 0.5 };
    session.handle(0.0, hover(0.5));
    machine.run(&mut session, 1.0);
    assert!(session.panel(machine.now).hover.is_some());
    session.handle(machine.now, hold(1.0));
    machine.run(&mut session, 1.0);
    assert_eq!(session.panel(machine.now).hover, None);
    // At rest it is asked again, without another event of the pointer.
    session.handle(machine.now, hold(0.0));
    machine.run(&mut session, 1.0);
    assert!(session.panel(machine.now).hover.is_some());
    session.handle(machine.now, hover(-1.0));
    assert_eq!(session.panel(machine.now).hover, None);
    session.handle(machine.now, hold(1.0));
    session.handle(machine.now, hold(0.0));
    machine.run(&mut session, 1.0);
    assert_eq!(session.panel(machine.now).hover, None);
}

#[test]
fn errors_are_told_of_error_pictures_only() {
    let bundle = bundle("s3");
    let mut session = session(Some(&bundle), &bundle.manifold.clone());
    session.handle(
        0.0,
        ViewerEvent::Look {
            right: 0.1,
            down: 0.0,
        },
    );
    // A picture of another kind is still being drawn when errors are asked for.
    let Some(Work::Draw(request)) = session.next_work(0.0, 1) else {
        panic!("a picture is wanted")
    };
    let show = ViewerEvent::Show {
        kind: PictureKind::Error,
        split: None,
    };
    session.handle(0.01, show);
    let answer = |request: &DrawRequest, error: f32| {
        let pixels = request.block.width * request.block.height;
        let of_errors = request.kind == PictureKind::Error;
        Answer::Drawn {
            frame: request.frame,
            block: request.block,
            rgb: vec![0.2; 3 * pixels],
            errors: vec![error; if of_errors { pixels } else { 0 }],
        }
    };
    session.accept(0.02, answer(&request, 0.0));
    assert!(session.panel(0.02).errors.is_none());
    let Some(Work::Draw(request)) = session.next_work(0.03, 1) else {
        panic!("an error picture is wanted")
    };
    session.accept(0.04, answer(&request, 0.5));
    let (quantiles, given_up) = session.panel(0.04).errors.unwrap();
    assert_eq!((quantiles.p50, given_up), (0.5, 0.0));
}

#[test]
fn where_the_table_knows_no_paths_the_exact_picture_stands_for_its_errors() {
    let bundle = bundle("s3");
    let mut session = session(Some(&bundle), &bundle.manifold.clone());
    let mut machine = Machine::new(1e-8);
    session.handle(0.0, ViewerEvent::Beyond { allowed: true });
    let show = ViewerEvent::Show {
        kind: PictureKind::Error,
        split: None,
    };
    session.handle(0.0, show);
    session.handle(0.0, hold(-1.0));
    while session.panel(machine.now).within_table && machine.now < 20.0 {
        machine.run(&mut session, 0.5);
    }
    session.handle(machine.now, hold(0.0));
    machine.frames.clear();
    machine.run(&mut session, 10.0);
    let panel = session.panel(machine.now);
    assert!(!panel.within_table && panel.settled && panel.errors.is_none());
    assert!(panel.hint.unwrap().contains("exact paths"));
    let mut frames = machine.frames.iter();
    assert!(frames.all(|frame| frame.kind == PictureKind::Exact));
}

#[test]
fn an_event_ends_the_refinement_after_the_block_that_is_being_drawn() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-6);
    machine.run(&mut session, 1.0);
    session.handle(
        machine.now,
        ViewerEvent::Look {
            right: 0.01,
            down: 0.0,
        },
    );
    machine.frames.clear();
    machine.run(&mut session, 0.05);
    assert!(!machine.frames[0].each, "the next picture is a moving one");
}

#[test]
fn a_display_that_falls_behind_is_waited_for() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-8);
    machine.shows = false;
    session.handle(0.0, hold(1.0));
    machine.run(&mut session, 1.0);
    assert!(machine.frames.len() <= crate::planning::AHEAD + 1);
}

#[test]
fn a_captured_picture_has_its_own_size_and_does_not_disturb_the_display() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-9);
    machine.run(&mut session, 5.0);
    session.handle(
        machine.now,
        ViewerEvent::Capture {
            width: 300,
            height: 200,
            samples: 4,
            light: false,
        },
    );
    machine.frames.clear();
    machine.run(&mut session, 1.0);
    assert!(
        machine
            .frames
            .iter()
            .all(|f| f.size == (300, 200) && f.samples == 4)
    );
    assert_eq!(session.panel(machine.now).size, (640, 360));
    session.handle(
        machine.now,
        ViewerEvent::Capture {
            width: 8192,
            height: 8192,
            samples: 1,
            light: false,
        },
    );
    assert!(session.panel(machine.now).hint.is_some());
}

/// Asks for a saved picture of several blocks.
fn capture() -> ViewerEvent {
    ViewerEvent::Capture {
        width: 600,
        height: 400,
        samples: 1,
        light: false,
    }
}

#[test]
fn a_captured_picture_keeps_the_exposure_that_it_was_asked_for_at_and_the_display_goes_on() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    session.handle(0.0, capture());
    let draw = |session: &mut Session, light: f32| {
        let Some(Work::Draw(request)) = session.next_work(0.0, 1) else {
            panic!("a picture is wanted");
        };
        let (frame, block) = (request.frame, request.block);
        let rgb = vec![light; 3 * block.width * block.height];
        let errors = Vec::new();
        let answer = Answer::Drawn {
            frame,
            block,
            rgb,
            errors,
        };
        session.accept(0.0, answer);
        session.take_patches().pop().unwrap()
    };
    let first = draw(&mut session, 0.1);
    let told = session.panel(0.0).background.unwrap();
    assert!(told.starts_with("saving a picture: 1 of"), "{told}");
    session.handle(0.0, ViewerEvent::Exposure { stops: 2.0 });
    let display = draw(&mut session, 0.1);
    let second = draw(&mut session, 0.1);
    assert!(first.capture && !display.capture && second.capture);
    assert_eq!(first.pixels[0], second.pixels[0]);
    assert_ne!(first.pixels[0], display.pixels[0]);
}

#[test]
fn a_captured_picture_begins_anew_with_a_hint_when_it_would_show_two_states() {
    let flat = manifold(FLAT);
    let stars = ViewerEvent::Sky {
        sky: SkyChoice::Stars,
    };
    for event in [Some(stars), None] {
        let mut session = session(None, &flat);
        session.handle(0.0, capture());
        let Some(Work::Draw(before)) = session.next_work(0.0, 1) else {
            panic!("the captured picture comes first");
        };
        match event {
            Some(event) => session.handle(0.0, event),
            None => session.replace_space(session.space().clone()),
        }
        // What is drawn of the first is of no use any more.
        let late = Answer::Drawn {
            frame: before.frame,
            block: before.block,
            rgb: vec![0.5; 3 * before.block.width * before.block.height],
            errors: Vec::new(),
        };
        session.accept(0.0, late);
        assert!(session.take_patches().iter().all(|patch| !patch.capture));
        let panel = session.panel(0.0);
        assert!(panel.hint.unwrap().contains("begins anew"));
        let told = panel.background.unwrap();
        assert!(told.starts_with("saving a picture: 0 of"), "{told}");
        let requests = std::iter::from_fn(|| session.next_work(0.0, 1));
        let again = requests.take(4).find_map(|work| match work {
            Work::Draw(request) if request.size == before.size => Some(request),
            _ => None,
        });
        let again = again.expect("it is drawn");
        assert_eq!(again.block, before.block);
        assert_ne!(again.frame, before.frame);
    }
}

#[test]
fn a_captured_picture_is_given_up_by_a_halt_and_where_its_camera_is_nowhere_any_more() {
    let flat = manifold(FLAT);
    let domain = FLAT.replace("[cameras]", "[domain]\ninside = ['x - 1.5']\n[cameras]");
    let elsewhere = manifold(&domain.replace("at = ['c'", "at = ['c + 2'"));
    for halts in [true, false] {
        let mut session = session(None, &flat);
        session.handle(0.0, capture());
        assert!(session.panel(0.0).background.is_some());
        match halts {
            true => session.handle(0.0, ViewerEvent::Halt),
            false => session.replace_space(self::session(None, &elsewhere).space().clone()),
        }
        let panel = session.panel(0.0);
        assert!(panel.hint.unwrap().contains("given up") && panel.background.is_none());
    }
}

#[test]
fn traced_light_on_the_display_is_saved_as_it_is_and_a_hint_tells_where_it_is_not() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let mut machine = Machine::new(1e-8);
    session.handle(0.0, ViewerEvent::Paths { passes: 6 });
    machine.run(&mut session, 5.0);
    let capture = |width, height| ViewerEvent::Capture {
        width,
        height,
        samples: 16,
        light: true,
    };
    session.handle(machine.now, capture(640, 360));
    let patch = session.take_patches().pop().unwrap();
    assert!(patch.capture && patch.light && patch.last && patch.block.is_within((640, 360)));
    let (light, _) = patch.pixels.as_chunks::<4>();
    assert_eq!(light.len(), 3 * 640 * 360);
    assert!(
        light
            .iter()
            .all(|x| (f32::from_le_bytes(*x) - 0.2).abs() < 1e-6)
    );
    assert_eq!(session.panel(machine.now).hint, None);
    session.handle(machine.now, capture(600, 400));
    let hint = session.panel(machine.now).hint.unwrap_or_default();
    assert!(hint.contains("without path tracing"), "{hint}");
}

#[test]
fn captured_light_is_linear_whatever_the_exposure() {
    let flat = manifold(FLAT);
    let mut session = session(None, &flat);
    let (width, height) = (40, 30);
    session.handle(0.0, ViewerEvent::Exposure { stops: 3.0 });
    let light = ViewerEvent::Capture {
        width,
        height,
        samples: 1,
        light: true,
    };
    session.handle(0.0, light);
    let Some(Work::Draw(request)) = session.next_work(0.0, 1) else {
        panic!("a captured picture comes first");
    };
    let pixels = request.block.width * request.block.height;
    let answer = Answer::Drawn {
        frame: request.frame,
        block: request.block,
        rgb: vec![0.2; 3 * pixels],
        errors: Vec::new(),
    };
    session.accept(0.1, answer);
    let patch = session.take_patches().pop().unwrap();
    assert!(patch.capture && patch.light && patch.last);
    assert_eq!(patch.pixels.len(), 12 * pixels);
    assert!(patch.pixels.chunks(4).all(|x| x == 0.2_f32.to_le_bytes()));
    assert_eq!(patch.encode()[0], 7);
}
