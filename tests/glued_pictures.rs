//! Pictures inside glued spaces against the same scenes unfolded by hand, and tables against exact paths.

mod support;

use geofan_bundle::Bundle;
use geofan_render::{
    Cubic, ExactGridTracer, ExactTracer, Journey, Seen, Stage, View,
    frame::{Outcomes, Paths, offsets, trace},
    intersect::HitSearch,
    scene::PoseFile,
};
use glam::{DVec3, DVec4};
use support::{Place, by_table, catalogue_text};

const SQUARE: &str = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n";

fn scene(manifold: &str, camera: &str, objects: &str) -> String {
    format!("manifold = '{manifold}'\n[camera]\n{camera}\n{objects}")
}

fn object(at: [f64; 3], scale: f64, turn: f64) -> String {
    format!(
        "[[object]]\nmesh = 'square.obj'\nat = [{}, {}, {}]\nscale = {scale}\nrotate = {{ axis = [0, 0, 1], degrees = {turn} }}\n",
        at[0], at[1], at[2]
    )
}

/// Returns the share of samples that see alike: the same kind of thing, at the same arc length.
fn alike(a: &Outcomes, b: &Outcomes, allowed: f32) -> f64 {
    let same = |(a, b): &(&Seen, &Seen)| match (a, b) {
        (Seen::Surface(a), Seen::Surface(b)) => (a.s - b.s).abs() <= allowed * a.s,
        (Seen::Surface(_), _) | (_, Seen::Surface(_)) => false,
        _ => true,
    };
    let count = a.iter().zip(b).filter(same).count();
    count as f64 / a.len() as f64
}

/// What is seen by exact paths.
fn exact(stage: &Stage, view: &View, length: f64) -> Outcomes {
    let tracer = ExactTracer::new(&stage.world.manifold, view.u, length, 1e-9);
    trace(&stage.world, view, Paths::Exact(&tracer), &offsets(1)).outcomes
}

fn stage(place: &Place, name: &str) -> (Stage, View) {
    let stage =
        Stage::load(&place.path(name), &[]).unwrap_or_else(|e| panic!("{}", e.report(false)));
    let view = stage.view(&stage.scene.camera, (96, 64)).unwrap();
    (stage, view)
}

fn surfaces(outcomes: &Outcomes) -> usize {
    let surface = |seen: &&Seen| matches!(seen, Seen::Surface(_));
    outcomes.iter().filter(surface).count()
}

#[test]
fn a_half_turn_space_is_the_lattice_of_its_copies() {
    // The square sticks out of the cube through two faces.
    let (at, scale) = ([0.9, 0.2, 0.85], 0.3);
    let mut copies = String::new();
    for layer in -4..=4_i32 {
        let odd = layer.rem_euclid(2) == 1;
        let (sign, turn) = if odd { (-1.0, 180.0) } else { (1.0, 0.0) };
        for i in -4..=4 {
            for j in -4..=4 {
                let place = [
                    sign * at[0] + 2.0 * f64::from(i),
                    sign * at[1] + 2.0 * f64::from(j),
                    at[2] + 2.0 * f64::from(layer),
                ];
                copies += &object(place, scale, turn);
            }
        }
    }
    let camera = "at = [0.1, -0.4, -0.3]\nlook = [0.6, 0.5, 0.45]\nup = [0, 0, 1]\nfov = 100";
    let flat = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n";
    let place = Place::with(&[
        ("square.obj", SQUARE),
        ("glued.toml", &catalogue_text("half-turn")),
        ("flat.toml", flat),
        (
            "glued-scene.toml",
            &scene("glued.toml", camera, &object(at, scale, 0.0)),
        ),
        ("flat-scene.toml", &scene("flat.toml", camera, &copies)),
    ]);
    let length = 6.0;
    let (glued, view) = stage(&place, "glued-scene.toml");
    let (unfolded, flat_view) = stage(&place, "flat-scene.toml");
    let seen = exact(&glued, &view, length);
    let truth = exact(&unfolded, &flat_view, length);
    assert!(surfaces(&truth) > 80, "{}", surfaces(&truth));
    let share = alike(&seen, &truth, 1e-5);
    assert!(share > 0.999, "exact: {share}");
    // Interpolated paths of the cover, and the table.
    let knots = ExactGridTracer::choose_knots(&glued.world.cover, view.u, length, 1e-7);
    let grid = ExactGridTracer::new(&glued.world.cover, view.u, knots, 1e-7);
    let fast = trace(
        &glued.world,
        &view,
        Paths::Lattice(&grid, 5e-4),
        &offsets(1),
    )
    .outcomes;
    let share = alike(&fast, &truth, 1e-3);
    assert!(share > 0.985, "lattice: {share}");
    let direct = trace(&glued.world, &view, Paths::Direct(&grid), &offsets(1)).outcomes;
    let share = alike(&direct, &truth, 1e-3);
    assert!(share > 0.995, "one by one: {share}");
}

#[test]
fn the_table_of_the_sphere_shows_poincares_space_as_exact_paths_do() {
    let camera = "at = [0.05, -0.11, 0.03]\nlook = [-0.35, 1.0, -0.1]\nup = [0, 0, 1]\nfov = 90";
    let text = catalogue_text("poincare");
    // The sphere alone, with the same region.
    let (from, to) = (
        text.find("[[glue]]").unwrap(),
        text.find("[domain]").unwrap(),
    );
    let sphere = format!("{}{}", &text[..from], &text[to..]);
    let place = Place::with(&[
        ("square.obj", SQUARE),
        ("poincare.toml", &text),
        ("sphere.toml", &sphere),
        (
            "scene.toml",
            &scene(
                "poincare.toml",
                camera,
                &(object([0.0, 0.05, 0.0], 0.05, 20.0) + &object([0.15, 0.02, 0.05], 0.05, 0.0)),
            ),
        ),
    ]);
    place
        .bake("sphere.toml -o sphere.fan --max-error 0.2 --quiet")
        .success();
    let bundle = Bundle::read(&place.path("sphere.fan")).unwrap();
    let (stage, view) = stage(&place, "scene.toml");
    stage.check_bundle(&bundle).unwrap();
    let truth = exact(&stage, &view, 3.0);
    assert!(surfaces(&truth) > 500, "{}", surfaces(&truth));
    let fast = by_table(&stage, &view, &bundle, 2e-4);
    let share = alike(&fast, &truth, 2e-3);
    println!("{share} alike, {} surfaces", surfaces(&truth));
    assert!(share > 0.97, "{share}");
    // The command measures the table by paths of the sphere: those of the glued space lie elsewhere.
    let told = assert_cmd::Command::cargo_bin("geofan")
        .unwrap()
        .current_dir(place.path(""))
        .args(
            "compare scene.toml --bundle sphere.fan --out pictures --size 48x32 --spp 4".split(' '),
        )
        .args(["--frames", "1", "--json", "--quiet"])
        .assert();
    let told: serde_json::Value =
        serde_json::from_slice(&told.success().get_output().stdout).unwrap();
    let p99 = told["screen_mrad"]["p99"].as_f64().unwrap();
    assert!(p99 < 0.3, "{p99}");
    // With one sample a pixel, edges that pass its middle decide: 38 dB, whatever the table's promise.
    let psnr = told["psnr"].as_f64().unwrap();
    assert!(psnr >= 42.0, "{psnr} dB");
}

#[test]
fn all_120_images_of_a_mesh_are_in_one_picture_of_poincares_space() {
    let text = catalogue_text("poincare");
    let (from, to) = (
        text.find("[[glue]]").unwrap(),
        text.find("[domain]").unwrap(),
    );
    let sphere = format!("{}{}", &text[..from], &text[to..]);
    let middle = [0.06, 0.04, -0.05];
    let globe = format!(
        "[[object]]\nmesh = '{}/assets/meshes/globe.obj'\nat = {middle:?}\nscale = 0.01\n",
        env!("CARGO_MANIFEST_DIR")
    );
    let camera =
        "at = [-0.05, 0.03, 0.02]\nlook = [1.0, 0.2, 0.1]\nup = [0, 0, 1]\nprojection = 'panorama'";
    let place = Place::with(&[
        ("poincare.toml", &text),
        ("sphere.toml", &sphere),
        ("scene.toml", &scene("poincare.toml", camera, &globe)),
    ]);
    place.bake("sphere.toml -o sphere.fan --quiet").success();
    let bundle = Bundle::read(&place.path("sphere.fan")).unwrap();
    let stage = Stage::load(&place.path("scene.toml"), &[])
        .unwrap_or_else(|e| panic!("{}", e.report(false)));
    let view = stage.view(&stage.scene.camera, (1024, 512)).unwrap();
    let seen = by_table(&stage, &view, &bundle, 5e-4);
    // Every geodesic from the camera to the globe's middle ends on its surface, a radius before.
    let point = glam::DVec3::from(middle);
    let around = geofan_light::LightFan::new(&stage.world.cover, view.u, 3.0, (point, point));
    let (images, _) = around.connections(&[point], 1e-10);
    assert_eq!(images.len(), 120);
    let radius = 0.02;
    for (_, image) in images {
        let (x, y) = view.pixel(image.direction).unwrap();
        let at = [(y as usize).min(511), (x as usize).min(1023), 0];
        match &seen[at] {
            Seen::Surface(hit) => {
                let before = image.s - f64::from(hit.s);
                assert!(
                    (0.3 * radius..1.1 * radius).contains(&before),
                    "{before} {image:?}"
                );
            }
            other => panic!("{other:?} {image:?}"),
        }
    }
}

#[test]
fn pictures_by_tables_have_all_the_small_copies_far_away() {
    let camera = "at = [-0.25, -0.12, 0.08]\nlook = [1.0, 0.5, -0.25]\nup = [0, 0, 1]\nfov = 95";
    let text = catalogue_text("seifert-weber");
    let place = Place::with(&[
        ("square.obj", SQUARE),
        ("space.toml", &text),
        (
            "scene.toml",
            &scene(
                "space.toml",
                camera,
                &(object([0.1, 0.06, -0.06], 0.25, 30.0) + &object([-0.1, 0.3, 0.1], 0.2, 0.0)),
            ),
        ),
    ]);
    place
        .bake("space.toml -o space.fan --max-error 0.2 --length 4.5 --quiet")
        .success();
    let bundle = Bundle::read(&place.path("space.fan")).unwrap();
    let (stage, view) = stage(&place, "scene.toml");
    let truth = exact(&stage, &view, 4.5);
    let fast = by_table(&stage, &view, &bundle, 2e-4);
    let (share, count) = (alike(&fast, &truth, 2e-3), surfaces(&truth));
    println!("{share} alike, {} of {count} surfaces", surfaces(&fast));
    assert!(count > 200 && share > 0.97, "{share}, {count}");
    let far = |seen: &&Seen| matches!(seen, Seen::Surface(hit) if hit.s > 3.0);
    let [known, found] = [&truth, &fast].map(|seen| seen.iter().filter(far).count());
    assert!(
        known > 50 && 10 * found.abs_diff(known) < known,
        "{found} of {known}"
    );
}

/// An object that was carried out of the domain is where its image inside is.
#[test]
fn objects_far_outside_the_domain_are_seen_inside() {
    let camera = "at = [0.1, -0.4, -0.3]\nlook = [0.6, 0.5, 0.45]\nup = [0, 0, 1]\nfov = 100";
    let scene = |at: [f64; 3], turn: f64| scene("glued.toml", camera, &object(at, 0.3, turn));
    let place = Place::with(&[
        ("square.obj", SQUARE),
        ("glued.toml", &catalogue_text("half-turn")),
        ("near.toml", &scene([0.9, 0.2, 0.85], 0.0)),
        // Three cells over and five up: turned by half.
        ("far.toml", &scene([-0.9 + 6.0, -0.2, 0.85 + 10.0], 180.0)),
    ]);
    let (near, view) = stage(&place, "near.toml");
    let (far, _) = stage(&place, "far.toml");
    let truth = exact(&near, &view, 6.0);
    let share = alike(&exact(&far, &view, 6.0), &truth, 1e-5);
    assert!(surfaces(&truth) > 300 && share > 0.999, "{share}");
    let knots = ExactGridTracer::choose_knots(&far.world.cover, view.u, 6.0, 1e-7);
    let grid = ExactGridTracer::new(&far.world.cover, view.u, knots, 1e-7);
    let paths = Paths::Lattice(&grid, 5e-4);
    let share = alike(
        &trace(&far.world, &view, paths, &offsets(1)).outcomes,
        &truth,
        1e-3,
    );
    assert!(share > 0.985, "{share}");
}

#[test]
fn a_camera_on_its_way_through_a_face_comes_in_through_the_other() {
    let pose = |time: f64, at: &str| {
        format!("[[pose]]\ntime = {time}\nat = {at}\nlook = [0.3, 0.9, 0.1]\nup = [0, 0, 1]\n")
    };
    let place = Place::with(&[
        ("poincare.toml", &catalogue_text("poincare")),
        (
            "poses.toml",
            &(pose(0.0, "[0.05, -0.11, 0.03]") + &pose(1.0, "[0.02, 0.32, 0.03]")),
        ),
    ]);
    let poses = PoseFile::load(&place.path("poses.toml"), 90.0).unwrap();
    let space = support::asset("poincare");
    let gluing = space.gluing().unwrap();
    let journey = Journey::new(&space, &poses).unwrap();
    let mut crossed = 0;
    for k in 0..=40 {
        let time = f64::from(k) / 40.0;
        let (inside, outside) = (journey.pose(time).0, journey.pose_in_cover(time).0);
        assert_eq!(gluing.violated(inside.u), None, "{time}");
        let (u, word) = gluing.locate(outside.u).unwrap();
        crossed += usize::from(!word.is_empty());
        // The same place, and the camera's axes by the differentials of the maps between.
        assert!((inside.u - u).length() < 1e-12);
        let carried = gluing.carried(&word, outside.u, outside.axes(&space));
        let off = (inside.axes(&space) - carried).to_cols_array();
        assert!(off.iter().all(|x| x.abs() < 1e-9), "{time}: {off:?}");
    }
    assert!(crossed > 5, "{crossed}");
}

/// Flat space with a wall at x = 1 that is a mirror, or turns what goes through it round, which is the same.
fn beside_a_wall(wall: &str) -> String {
    format!(
        "name = 'wall'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = '1' }}\n\
         [[glue]]\nface = '1 - x'\n{wall}\n\
         [[exit]]\nname = 'sky'\nwhen = 'x^2 + y^2 + z^2 - 36'\n\
         [cameras]\nparameters = {{ c = [-0.5, 0.5] }}\nat = ['c', '0.1', '0.2']\nlength = 14\n"
    )
}

const MIRROR: &str = "mirror = true";
const TURNED_ROUND: &str = "map = ['2 - x', 'y', 'z']";

#[test]
fn a_mirror_shows_what_the_reflection_in_it_does() {
    let objects = object([-1.0, 0.3, 0.4], 0.4, 0.0) + &object([0.5, -0.6, -0.2], 0.2, 0.0);
    let camera = "parameters = { c = 0.1 }\nlook = [1, 0.1, 0]\nup = [0, 0, 1]\nfov = 110";
    let text = |wall| scene(wall, camera, &objects);
    let place = Place::with(&[
        ("mirror.toml", &beside_a_wall(MIRROR)),
        ("turned.toml", &beside_a_wall(TURNED_ROUND)),
        ("square.obj", SQUARE),
        ("scene.toml", &text("mirror.toml")),
        ("other.toml", &text("turned.toml")),
    ]);
    // A table of such a space is of no use, and a bake says so.
    let baked = place
        .bake("mirror.toml -o mirror.fan --max-error 0.5")
        .success();
    let said = String::from_utf8_lossy(&baked.get_output().stderr).into_owned();
    assert!(said.contains("has mirrors or portals"), "{said}");
    assert!(!said.contains("end by their length"), "{said}");
    let bundle = Bundle::read(&place.path("mirror.fan")).unwrap();
    let (mirrored, view) = stage(&place, "scene.toml");
    let (turned, other_view) = stage(&place, "other.toml");
    let truth = exact(&turned, &other_view, 14.0);
    assert!(surfaces(&truth) > 80, "{}", surfaces(&truth));
    let shown = exact(&mirrored, &view, 14.0);
    assert_eq!(alike(&shown, &truth, 1e-6), 1.0);
    // A table knows nothing of mirrors: its pictures are of exact paths.
    let by_table = by_table(&mirrored, &view, &bundle, 5e-4);
    assert_eq!(alike(&by_table, &truth, 1e-6), 1.0);
}

/// The light of a lamp at `lamp` on a square about `at`, and what is said.
fn light_on(space: &str, lamp: &str, at: [f64; 3]) -> (f64, String) {
    let camera = "at = [-0.5, 0.1, 0.2]\nlook = [1, 0, 0]\nup = [0, 0, 1]\nfov = 90";
    let lamp = format!("[[light]]\nkind = 'point'\nat = {lamp}\nintensity = [1, 1, 1]\n");
    let text = scene("space.toml", camera, &(object(at, 0.1, 0.0) + &lamp));
    let place = Place::with(&[
        ("space.toml", space),
        ("square.obj", SQUARE),
        ("scene.toml", &text),
    ]);
    let (mut stage, _) = stage(&place, "scene.toml");
    geofan_light::cache::light_up(&mut stage.world, None, 6.0, |_, _| {});
    let values = &stage.world.light.as_ref().unwrap().values;
    let all = values.iter().map(|light| f64::from(light[0] + light[3]));
    let mean = all.sum::<f64>() / values.len() as f64;
    (mean, stage.world.warnings.join(" "))
}

/// Irradiance of a unit lamp at `lamp` on a level surface at `u`, as if the space were flat and empty.
fn bare(lamp: [f64; 3], u: [f64; 3]) -> f64 {
    let way = DVec3::from(lamp) - DVec3::from(u);
    way.z.abs() / way.length().powi(3)
}

#[test]
fn lamps_light_by_way_of_mirrors_and_portals_as_their_images_do() {
    let flat = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n";
    let (at, lamp) = ([-0.5, 0.3, -0.4], [-0.4, 0.2, 0.5]);
    let lit = |space: &str| {
        let (mean, said) = light_on(space, &format!("{lamp:?}"), at);
        assert!(said.is_empty(), "{said}");
        mean
    };
    // A square of two tenths is small: means over it are those of its middle to second order.
    let alone = lit(flat);
    let size = alone / bare(lamp, at);
    assert!((size - 1.0).abs() < 0.02, "{size}");
    let mirrored = lit(&beside_a_wall(MIRROR));
    let image = bare([2.4, 0.2, 0.5], at);
    assert!(
        ((mirrored - alone) / image - 1.0).abs() < 0.01,
        "{mirrored} {alone}"
    );
    // The same by the map that turns what comes round.
    let turned = lit(&beside_a_wall(TURNED_ROUND));
    assert!(
        (mirrored / turned - 1.0).abs() < 1e-6,
        "{mirrored} {turned}"
    );
    // Two mirrors: three images.
    let two = lit(&(beside_a_wall(MIRROR) + "[[glue]]\nface = '1.2 + y'\nmirror = true\n"));
    let images = [[2.4, 0.2, 0.5], [-0.4, -2.6, 0.5], [2.4, -2.6, 0.5]];
    let images: f64 = images.map(|image| bare(image, at)).into_iter().sum();
    assert!(((two - alone) / images - 1.0).abs() < 0.01, "{two} {alone}");
    // A portal above the square leads to where the lamp is another time, from below.
    let portal = "[[glue]]\nface = '0.1 - z'\nmap = ['x', 'y', 'z + 3']\nopening = '0.16 - (x + 0.45)^2 - (y - 0.25)^2'\n\
                  [[glue]]\nface = 'z - 3.1'\nmap = ['x', 'y', 'z - 3']\nopening = '0.16 - (x + 0.45)^2 - (y - 0.25)^2'\n";
    let (through, _) = light_on(&(flat.to_owned() + portal), "[-0.4, 0.2, 3.5]", at);
    assert!((through / alone - 1.0).abs() < 1e-6, "{through} {alone}");
}

#[test]
fn a_mirror_stands_in_the_way_of_a_lamp() {
    let flat = "name = 'flat'\ncoordinates = ['x', 'y', 'z']\nmetric = { conformal = '1' }\n";
    let ball = format!("{flat}[[glue]]\nface = 'x^2 + y^2 + z^2 - 0.09'\nmirror = true\n");
    let (behind, _) = light_on(&ball, "[0, 0, 1]", [0.0, 0.0, -1.0]);
    let (aside, _) = light_on(&ball, "[1, 0, 1]", [1.0, 0.0, -1.0]);
    assert!(behind == 0.0 && aside > 0.1, "{behind} {aside}");
    // Beside the ball, a convex mirror, its share is added to the lamp's own.
    let (beside, _) = light_on(&ball, "[1, 0, 0]", [0.0, 0.0, 1.0]);
    let image = by_ball(0.3, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    let own = bare([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    assert!(
        (beside / (own + image) - 1.0).abs() < 0.02,
        "{beside} {own} {image}"
    );
}

/// Irradiance of a unit lamp on a level surface by way of a ball that is a mirror, both as far from its middle: the
/// path meets it on the way between; areas are followed by differences of neighbouring rays.
fn by_ball(radius: f64, lamp: [f64; 3], u: [f64; 3]) -> f64 {
    let (lamp, u) = (DVec3::from(lamp), DVec3::from(u));
    let met = (lamp + u).normalize() * radius;
    let toward = (met - lamp).normalize();
    // Where a ray meets the plane through `u` across the reflected one.
    let n = met.normalize();
    let out = toward - n * (2.0 * n.dot(toward));
    let end = |d: DVec3| {
        let (half, rest) = (lamp.dot(d), lamp.length_squared() - radius * radius);
        let at = lamp + d * (-half - (half * half - rest).sqrt());
        let n = at.normalize();
        let back = d - n * (2.0 * n.dot(d));
        at + back * ((u - at).dot(out) / back.dot(out))
    };
    let (e1, e2) = toward.any_orthonormal_pair();
    const STEP: f64 = 1e-5;
    let [a, b] = [e1, e2].map(|e| {
        let [ahead, back] = [1.0, -1.0].map(|sign| end((toward + e * (sign * STEP)).normalize()));
        (ahead - back) / (2.0 * STEP)
    });
    out.z.abs() / a.cross(b).length()
}

/// The chart point and the tangent where a great circle of the three-sphere is after the arc length `s`.
fn on_great_circle([p, v]: [DVec4; 2], s: f64) -> (DVec3, DVec3) {
    let (sin, cos) = s.sin_cos();
    let (at, way) = (p * cos + v * sin, v * cos - p * sin);
    let scale = 1.0 / (1.0 + at.w);
    let u = at.truncate() * scale;
    (u, (way.truncate() - u * way.w) * scale)
}

#[test]
fn paths_by_the_missing_point_of_a_chart_meet_what_their_short_pieces_do() {
    // Beside the point of the domain that is the missing one.
    let about = support::asset("lens-space").located(DVec3::new(1e7, 2e7, -1e7));
    let at = |by: [f64; 3]| (about + DVec3::from(by)).to_array();
    let objects =
        object(at([0.01, 0.02, 0.03]), 0.04, 20.0) + &object(at([-0.03, 0.0, -0.02]), 0.03, 0.0);
    let camera = "at = [0.2, -0.05, 0.1]\nlook = [0, 1, 0]\nup = [0, 0, 1]";
    let text = scene("space.toml", camera, &objects);
    let place = Place::with(&[
        ("space.toml", &catalogue_text("lens-space")),
        ("square.obj", SQUARE),
        ("scene.toml", &text),
    ]);
    let (stage, _) = stage(&place, "scene.toml");
    let mut random = geofan_core::random::Stream::new(&[7]);
    let mut unit =
        || DVec4::from_array(std::array::from_fn(|_| random.uniform() - 0.5)).normalize();
    let (mut hits, mut parted) = (0, 0);
    for _ in 0..400 {
        // From a point near the missing one, a short way before and behind.
        let p = (unit() * 0.03 - DVec4::W).normalize();
        let v = unit().reject_from_normalized(p).normalize();
        let first = |count: usize| {
            let mut search = HitSearch::new(&stage.world);
            let ends = |k: usize| [k, k + 1].map(|k| 0.4 * (k as f64 / count as f64 - 0.5));
            let piece = |k: usize| {
                let [a, b] = ends(k).map(|s| on_great_circle([p, v], s));
                Cubic {
                    s: ends(k).map(|s| s + 1.0),
                    u: [a.0, b.0],
                    v: [a.1, b.1],
                }
            };
            (0..count).find_map(|k| search.first_hit(&piece(k), f64::INFINITY))
        };
        let (long, short) = (first(3), first(400));
        hits += usize::from(short.is_some());
        let alike = match (long, short) {
            (Some(long), Some(short)) => (long.s - short.s).abs() < 2e-3,
            (long, short) => long.is_none() == short.is_none(),
        };
        parted += usize::from(!alike);
    }
    // A few graze an edge.
    assert!(hits > 40 && parted <= 1, "{hits} hits, {parted} parted");
}
