//! Tests of the shared space: parameters that are refused, chosen and rewritten, files that change while they are read.

use super::*;
use geofan_render::sky::Sky;
use std::time::UNIX_EPOCH;

/// Writes a space with these parameters, of which the first must not be 2.
fn write(file: &Path, [a, b]: [f64; 2]) {
    let text = format!(
        "name = 'two'\ncoordinates = ['x', 'y', 'z']\nmetric = {{ conformal = 'a*b/(a - 2)' }}\n\
         [parameters]\na = {a}\nb = {b}\n[cameras]\nparameters = {{ c = [0, 1] }}\nat = ['c', '0.1', '0']\nlength = 5\n"
    );
    fs::write(file, text).unwrap();
}

/// Opens such a space, with a value of `b` that the command gives, and returns its file in a folder, too.
fn opened_with_b() -> (tempfile::TempDir, PathBuf, Arc<SharedSpace>) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("space.toml");
    write(&file, [3.0, 1.0]);
    let source = SpaceSource {
        file: file.clone(),
        bundle: None,
        length: None,
    };
    let shared = SharedSpace::open(source, vec![("b".into(), 1.5)], None).unwrap();
    (folder, file, shared)
}

#[test]
fn a_refused_parameter_is_forgotten_and_what_was_asked_for_since_is_not() {
    let (_folder, _, shared) = opened_with_b();
    shared.set_parameter("a", 2.0);
    let refused = shared.state().settings.clone();
    shared.set_parameter("b", 4.0);
    shared.state().forget_refused(&refused);
    assert_eq!(shared.state().settings, [("b".to_string(), 4.0)]);
    shared.set_parameter("a", 2.0);
    shared.reload();
    assert!(shared.present().trouble.is_some());
    shared.set_parameter("b", 5.0);
    shared.reload();
    let present = shared.present();
    assert_eq!(present.trouble, None);
    let parameters = &present.loaded.session.manifold.parameters;
    assert_eq!(
        parameters[..],
        [("a".to_string(), 3.0), ("b".to_string(), 5.0)]
    );
}

#[test]
fn a_value_written_into_the_file_takes_the_place_of_one_chosen_before() {
    let (_folder, file, shared) = opened_with_b();
    let parameters = || {
        shared.reload();
        let manifold = shared.present().loaded.session.manifold.clone();
        [manifold.parameters[0].1, manifold.parameters[1].1]
    };
    shared.set_parameter("a", 2.5);
    assert_eq!(parameters(), [2.5, 1.5]);
    // It is told to all viewers; what the command gives is not for their addresses.
    assert_eq!(shared.present().chosen, ["a"]);
    // Another line of the file leaves what was chosen, and what the command gives stays.
    write(&file, [3.0, 2.0]);
    assert_eq!(parameters(), [2.5, 1.5]);
    write(&file, [4.0, 2.0]);
    assert_eq!(parameters(), [4.0, 1.5]);
    assert!(shared.present().chosen.is_empty());
    shared.set_parameter("a", 4.5);
    assert_eq!(parameters(), [4.5, 1.5]);
}

#[test]
fn what_changes_while_files_are_read_counts_as_changed() {
    let folder = tempfile::tempdir().unwrap();
    let [old, new, missing] = ["old", "new", "missing"].map(|name| folder.path().join(name));
    fs::write(&old, "1").unwrap();
    let mut files = WatchedFiles::since(UNIX_EPOCH, vec![old.clone()], &[]);
    assert!(files.have_changed() && !files.have_changed());
    // Loading begins; meanwhile one file is saved, another appears that nobody knew of.
    let (begun, before) = (SystemTime::now(), files.stamped());
    fs::write(&old, "22").unwrap();
    fs::write(&new, "3").unwrap();
    let later = begun + Duration::from_secs(1);
    let file = fs::File::options().write(true).open(&new).unwrap();
    file.set_modified(later).unwrap();
    let read = vec![old.clone(), missing.clone()];
    let mut files = WatchedFiles::since(begun, read, &before);
    assert!(files.have_changed() && !files.have_changed());
    let mut files = WatchedFiles::since(begun, vec![new], &before);
    assert!(files.have_changed());
    // A file that is looked for and comes.
    let mut files = WatchedFiles::since(begun, vec![missing.clone()], &[]);
    assert!(!files.have_changed());
    fs::write(&missing, "4").unwrap();
    assert!(files.have_changed() && !files.have_changed());
}

#[test]
fn other_cameras_or_another_length_want_another_table_and_the_old_one_serves_until_then() {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("s3.toml");
    fs::copy(golden.join("s3.toml"), &file).unwrap();
    let source = SpaceSource {
        file: file.clone(),
        bundle: None,
        length: None,
    };
    let shared = SharedSpace::open(source, Vec::new(), None).unwrap();
    let wanted = || {
        let loaded = shared.present().loaded;
        let name = identity(&loaded.session.manifold, loaded.session.length);
        let lacks = shared.lacks_table(&loaded, &name);
        (name, lacks, loaded.session.table.is_some())
    };
    let (name, lacks, _) = wanted();
    assert!(lacks);
    shared.set_table(name.clone(), Bundle::read(&golden.join("s3.fan")).unwrap());
    let text = fs::read_to_string(&file).unwrap();
    for (from, to, other) in [
        ("name =", "# a comment\nname =", false),
        ("1.5", "1.75", true),
        ("\"c\", \"0\"", "\"0\", \"c\"", true),
        ("length = 3", "length = 2", true),
    ] {
        fs::write(&file, text.replace(from, to)).unwrap();
        shared.reload();
        let (found, lacks, has_table) = wanted();
        assert!(lacks == other && (found != name) == other, "{to}");
        assert!(has_table, "{to}");
    }
}

#[test]
fn a_bundle_that_another_manifold_s_takes_the_place_of_is_told_of_and_the_one_before_stays() {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let folder = tempfile::tempdir().unwrap();
    let bundle = folder.path().join("own.fan");
    let put = |name: &str| fs::copy(golden.join(name), &bundle).unwrap();
    put("s3.fan");
    let source = SpaceSource {
        file: golden.join("s3.toml"),
        bundle: Some(bundle.clone()),
        length: None,
    };
    let shared = SharedSpace::open(source, Vec::new(), None).unwrap();
    put("three-bumps-rail.fan");
    shared.reload();
    let present = shared.present();
    assert!(present.trouble.unwrap().contains("another manifold"));
    assert!(present.version == 1 && present.loaded.session.table.is_some());
    put("s3.fan");
    shared.reload();
    assert_eq!(shared.present().trouble, None);
}

#[test]
fn sections_that_two_viewers_ask_for_at_once_are_both_decoded() {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let source = SpaceSource {
        file: golden.join("three-bumps-rail.toml"),
        bundle: Some(golden.join("three-bumps-rail.fan")),
        length: None,
    };
    let shared = SharedSpace::open(source, Vec::new(), None).unwrap();
    assert!(shared.wants_section());
    for section in [0, 1] {
        shared.set_section(1, section);
    }
    assert!(!shared.wants_section());
    assert!(shared.decode_section() && shared.decode_section() && !shared.decode_section());
    let promise = shared.present().loaded.session.table.clone().unwrap();
    assert!([0, 1].map(|k| promise.table.section(k).unwrap().is_decoded()) == [true; 2]);
}

#[test]
fn other_skies_are_shown_in_the_same_space() {
    let (_folder, _, shared) = opened_with_b();
    let before = shared.present();
    shared.set_sky(SkyChoice::Stars);
    let after = shared.present();
    assert!(Arc::ptr_eq(&before.loaded, &after.loaded) && !shared.is_loading());
    assert_eq!((after.version, after.sky), (1, SkyChoice::Stars));
    // A space that is loaded later has them, too.
    shared.reload();
    for loaded in [after.loaded, shared.present().loaded] {
        let draw = loaded.draw.read().unwrap();
        let mut skies = draw.stage.world.skies.iter().flatten();
        assert!(skies.any(|sky| matches!(sky, Sky::Stars(_))));
    }
}
