//! What a session tells of what it does not show, and why; and how it takes changes of the scene's cameras.

use super::*;

/// A session in the scene of a text.
fn session_of(scene: &str, manifold: &Arc<Manifold>) -> Session {
    Session::new(space_of(scene, manifold))
}

fn space_of(scene: &str, manifold: &Arc<Manifold>) -> SessionSpace {
    let scene = format!("manifold = 'm.toml'\n{scene}");
    let scene = SceneFile::parse(SourceText::new("s.toml", scene), Path::new("")).unwrap();
    SessionSpace::new(&scene, manifold, None, 10.0).unwrap()
}

/// A camera at a place, with further entries.
fn camera(x: f64, more: &str) -> String {
    format!("[camera]\nat = [{x}, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n{more}\n")
}

#[test]
fn every_camera_of_the_scene_tells_what_a_viewer_does_not_show_of_it() {
    let flat = manifold(FLAT);
    let text = "manifold = 'm.toml'\n[camera]\nat = [0, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\nfov = 90\n\
                [[view]]\nname = 'round'\nprojection = 'fisheye'\nat = [0, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\nfov = 180\n";
    let scene = SceneFile::parse(SourceText::new("s.toml", text), Path::new("")).unwrap();
    let mut session = Session::new(SessionSpace::new(&scene, &flat, None, 10.0).unwrap());
    assert_eq!(session.panel(0.0).hint, None);
    let name = String::from("round");
    session.handle(0.1, ViewerEvent::View { name });
    assert!(session.panel(0.1).hint.unwrap().contains("`projection`"));
    session.handle(0.2, ViewerEvent::Home);
    assert_eq!(session.panel(0.2).hint, None);
}

#[test]
fn all_that_a_viewer_does_not_show_is_told_at_once() {
    let flat = manifold(FLAT);
    let more = "fov = 180\nprojection = 'fisheye'\nvelocity = [0.5, 0, 0]";
    let hint = session_of(&camera(0.0, more), &flat)
        .panel(0.0)
        .hint
        .unwrap();
    assert!(
        hint.contains("`velocity`") && hint.contains("`projection`"),
        "{hint}"
    );
}

#[test]
fn wide_and_narrow_angles_of_view_are_those_of_the_scene() {
    let flat = manifold(FLAT);
    for fov in [0.25, 170.0, 178.5] {
        let mut session = session_of(&camera(0.0, &format!("fov = {fov}")), &flat);
        assert_eq!(session.panel(0.0).pose.fov, fov);
        // Zooming leads no farther that way, and back.
        let factors = if fov < 1.0 { [0.5, 2.0] } else { [2.0, 0.5] };
        session.handle(0.0, ViewerEvent::Zoom { factor: factors[0] });
        assert_eq!(session.panel(0.0).pose.fov, fov);
        session.handle(0.0, ViewerEvent::Zoom { factor: factors[1] });
        assert_eq!(session.panel(0.0).pose.fov, factors[1] * fov);
    }
}

#[test]
fn a_fisheye_s_angle_of_view_becomes_one_that_a_picture_on_a_plane_can_have() {
    let flat = manifold(FLAT);
    let mut space = session(None, &flat).space().clone();
    space.cameras[0].pose.fov = 220.0;
    let mut session = Session::new(space.clone());
    assert_eq!(session.panel(0.0).pose.fov, 150.0);
    session.camera.u = DVec3::splat(f64::NAN);
    session.replace_space(space);
    assert_eq!(session.panel(0.0).pose.fov, 150.0);
    // A replayed way has those that a plane can have.
    let pose = |time: i32| {
        format!(
            "[[pose]]\ntime = {time}\nat = [0.{time}, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n"
        )
    };
    let text = pose(0) + &pose(1) + "fov = 175\n";
    session.handle(0.0, ViewerEvent::Replay { text });
    Machine::new(1e-8).run(&mut session, 2.0);
    assert_eq!(session.panel(2.0).pose.fov, 175.0);
}

#[test]
fn another_camera_in_the_scene_moves_who_has_not_left_the_first_and_tells_others() {
    let flat = manifold(FLAT);
    let [first, second] = [0.0, 0.5].map(|x| space_of(&camera(x, ""), &flat));
    let mut session = Session::new(first.clone());
    session.replace_space(second.clone());
    assert_eq!((session.camera().u.x, session.panel(0.0).hint), (0.5, None));
    session.handle(0.0, ViewerEvent::Zoom { factor: 0.5 });
    session.replace_space(first);
    assert_eq!(session.camera().u.x, 0.5);
    assert!(session.panel(0.0).hint.unwrap().contains("Home"));
    session.handle(0.0, ViewerEvent::Home);
    assert_eq!((session.camera().u.x, session.panel(0.0).hint), (0.0, None));
}

#[test]
fn a_hint_to_pick_a_point_goes_when_one_is_picked() {
    let mut session = session(None, &manifold(FLAT));
    let mut machine = Machine::new(1e-8);
    session.handle(0.0, ViewerEvent::Follow);
    assert!(session.panel(0.0).hint.unwrap().contains("pick a point"));
    session.handle(0.0, ViewerEvent::Pick { x: 0.5, y: 0.5 });
    machine.run(&mut session, 0.2);
    let panel = session.panel(machine.now);
    assert!(panel.picked.is_some() && panel.hint.is_none());
}

#[test]
fn where_no_table_serves_the_reason_is_told_and_none_is_shown() {
    let bundle = bundle("s3");
    let text = "metric = { conformal = '1' }\n[[glue]]\nface = '1 - x'\nmirror = true\n";
    let mirror = manifold(text);
    let stage = start_stage(&mirror, 10.0);
    // Whatever the bundle, of which nothing is looked up.
    let space = SessionSpace::new(&stage.scene, &mirror, Some(&bundle), 10.0).unwrap();
    let mut session = Session::new(space);
    let (kind, split) = (PictureKind::Error, None);
    session.handle(0.0, ViewerEvent::Show { kind, split });
    let panel = session.panel(0.0);
    assert_eq!((panel.kind, panel.promise), (PictureKind::Exact, None));
    assert!(panel.no_table.unwrap().contains("mirrors"));
    assert!(panel.hint.unwrap().contains("mirrors"));
    // An engine's reason counts where there is no better one and no table.
    let [with, without] = with_and_without_table();
    assert_eq!(with.without_table(Some("none")).no_table, None);
    assert_eq!(
        without.without_table(Some("none")).no_table.unwrap(),
        "none"
    );
}

#[test]
fn a_picture_that_is_black_for_the_most_part_is_explained() {
    let mut session = session(None, &manifold(FLAT));
    for (grey, told) in [(0.2, false), (0.0, true)] {
        session.changed_at(0.0);
        let mut now = 0.0;
        while now < 3.0 {
            now += 0.01;
            if let Some(Work::Draw(request)) = session.next_work(now, 1) {
                let rgb = vec![grey; 3 * request.block.width * request.block.height];
                let (frame, block) = (request.frame, request.block);
                let errors = Vec::new();
                session.accept(
                    now,
                    Answer::Drawn {
                        frame,
                        block,
                        rgb,
                        errors,
                    },
                );
            }
        }
        let hint = session.panel(now).hint;
        assert_eq!(hint.is_some_and(|hint| hint.contains("black")), told);
    }
}

#[test]
fn a_path_over_glued_faces_tells_where_it_goes_on_elsewhere() {
    let face = |c: &str, side: f64| {
        let to = |d: &str| {
            if c == d {
                format!("'{d} - {}'", 2.0 * side)
            } else {
                format!("'{d}'")
            }
        };
        let map = ["x", "y", "z"].map(to).join(", ");
        format!(
            "[[glue]]\nface = '0.5 - {}*{c}'\nmap = [{map}]\n",
            2.0 * side
        )
    };
    let faces = ["x", "y", "z"].map(|c| face(c, 0.5) + &face(c, -0.5));
    let torus = manifold(&("metric = { conformal = '1' }\n".to_string() + &faces.concat()));
    let stage = start_stage(&torus, 3.2);
    let draw = DrawSpace::new(stage, None, 3.2);
    // The longest path of some, most of which end at the first scene's globes.
    let report = |i: u32| {
        let direction = DVec3::new(1.0, 0.03 * f64::from(i), 0.21).normalize();
        let query = RayQuery {
            number: 1,
            kind: PictureKind::Exact,
            u: [0.1, 0.02, 0.03],
            direction: direction.to_array(),
        };
        match draw.answer(&Work::Ray(query)) {
            Answer::Ray { report, .. } => report,
            _ => panic!("no ray"),
        }
    };
    let reports = (0..20).map(report);
    let report = reports
        .max_by(|a, b| a.length.total_cmp(&b.length))
        .unwrap();
    let at = |i: usize| DVec3::from_array(report.points[i]);
    let steps = (1..report.points.len()).filter(|i| at(*i).distance(at(i - 1)) > 0.5);
    let steps: Vec<usize> = steps.collect();
    assert!(
        !steps.is_empty() && report.jumps == steps,
        "{:?} {steps:?}",
        report.jumps
    );
    // Each part reaches the face on which it ends.
    let on_face = |u: DVec3| (u.abs().max_element() - 0.5).abs() < 1e-6;
    assert!(steps.iter().all(|i| on_face(at(i - 1)) && on_face(at(*i))));
}
