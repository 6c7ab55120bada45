//! A chunk whose refinement is stopped: at whatever question that is, it ends without beginning another piece, and goes on
//! where it was with the decisions that were kept.

use super::{DecisionLog, RefinementTally, Refiner};
use crate::plan::{plan, usual_tangents};
use geofan_bundle::{Division, PlanRecord, Table, Tree, rays::RaySpace};
use geofan_core::{Stop, Unobserved, diagnostic::SourceText, manifold::Manifold};
use std::{collections::BTreeSet, sync::Arc};

/// A bump without symmetry and a box of cameras, so that boxes have five axes and become trains.
const SPACE: &str = r#"
name = "a bump"
coordinates = ["x", "y", "z"]
metric = { conformal = "exp(0.3*exp(-((x - 0.3)^2 + 1.2*(y + 0.2)^2 + 0.8*z^2)))" }
[cameras]
parameters = { a = [-1.0, 1.0], b = [-1.0, 1.0], c = [-1.0, 1.0] }
at = ["a", "b", "c"]
length = 1.5
"#;

/// A ball of glass seen from a region beside it, so that boxes are mixed and divided at edges.
const GLASS: &str = r#"
name = "a ball of glass"
coordinates = ["x", "y", "z"]
symmetry = { rotation = "origin" }
metric = { conformal = "if(x^2 + y^2 + z^2 < 1, 1.5, 1)" }
[cameras]
parameters = { a = [1.5, 2.0] }
at = ["a", "0", "0"]
length = 6.0
"#;

/// A lens too sharp for all directions to be one patch, from one place.
const SHARP: &str = r#"
name = "a sharp lens"
coordinates = ["x", "y", "z"]
metric = { conformal = "1 + exp(-16*((x - 0.8)^2 + (y + 0.2)^2 + 1.1*z^2))" }
[cameras]
at = ["0", "0", "0"]
length = 2.0
"#;

/// The most operations between two questions: a second or so.
const MOST: u64 = 1 << 32;

/// The most rays that are followed between two questions.
const MOST_RAYS: u64 = 1920;

struct Bake {
    space: RaySpace,
    plan: PlanRecord,
    division: Division,
}

impl Bake {
    fn new(text: &str, length: f64, promise: f64) -> Self {
        let manifold = Manifold::from_source(SourceText::new("space", text), &[]).unwrap();
        let space = RaySpace::new(Arc::new(manifold)).unwrap();
        let tangents = usual_tangents(&space, promise);
        let (space, plan) = plan(space, length, promise, tangents, &Unobserved).unwrap();
        let division = plan.division(&space);
        Self {
            space,
            plan,
            division,
        }
    }

    /// Refines the first chunk on one thread, with `log`; also returns the rays and questions that it took, and its largest
    /// piece.
    fn chunk(&self, stop: Stop, log: Option<&DecisionLog>) -> (Option<Tree>, u64, u64, u64) {
        let tally = RefinementTally::new(stop);
        let refiner = Refiner {
            space: &self.space,
            plan: &self.plan,
            division: &self.division,
            tally: &tally,
            flagged: None,
            log,
        };
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        let tree = pool.install(|| refiner.chunk(0));
        let (asked, largest) = tally.stop().counts();
        (tree, tally.counts().rays, asked, largest)
    }
}

#[test]
fn a_chunk_ends_at_any_question_and_asks_between_pieces_of_a_second() {
    let bake = Bake::new(SPACE, 1.5, 20.0);
    let (tree, all_rays, asked, largest) = bake.chunk(Stop::default(), None);
    assert!(tree.is_some() && asked > 100, "{asked}");
    assert!(largest <= MOST, "{largest}");
    // Some of its questions, and with each the next one.
    let some = (0..8).map(|k| 1 + k * (asked - 2) / 7);
    let questions: BTreeSet<u64> = some.flat_map(|k| [k, k + 1]).collect();
    let mut before: Option<(u64, u64)> = None;
    for question in questions {
        let (tree, rays, _, largest) = bake.chunk(Stop::at_question(question), None);
        assert!(tree.is_none(), "question {question}");
        assert!(largest <= MOST && rays <= all_rays);
        if let Some((last, fewer)) = before
            && last + 1 == question
        {
            // What the piece between the two took: all that came before is the same, and nothing came behind.
            assert!(
                (fewer..=fewer + MOST_RAYS).contains(&rays),
                "question {question}"
            );
        }
        before = Some((question, rays));
    }
}

#[test]
fn a_stopped_chunk_goes_on_where_it_was() {
    for (text, length, promise) in [(GLASS, 6.0, 5.0), (SHARP, 3.0, 1.0)] {
        let bake = Bake::new(text, length, promise);
        let shape = Table::tensor_shape(&bake.space, bake.plan.mapping);
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("boxes");
        let open = || DecisionLog::open(&path, 0, [7; 16], shape).unwrap();
        let (whole, all_rays, asked, _) = bake.chunk(Stop::default(), None);
        let whole = whole.unwrap().encode();
        // Stopped at two questions, the second time with a block that was cut off.
        for question in [asked / 2, asked / 6] {
            let (tree, rays, _, _) = bake.chunk(Stop::at_question(question), Some(&open()));
            assert!(
                tree.is_none() && rays <= all_rays,
                "{question}: {rays} of {all_rays}"
            );
            let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
            let length = file.metadata().unwrap().len();
            assert!(length > 100, "nothing is kept");
            file.set_len(length - 5).unwrap();
        }
        let (tree, rays, asked_at_last, _) = bake.chunk(Stop::default(), Some(&open()));
        assert!(tree.unwrap().encode() == whole && rays == all_rays);
        assert!(asked_at_last < 2 * asked / 3, "{asked_at_last} of {asked}");
        // The decisions of another bake are none.
        let other = DecisionLog::open(&path, 0, [8; 16], shape).unwrap();
        drop(other);
        assert_eq!(std::fs::metadata(&path).unwrap().len(), 0);
    }
}
