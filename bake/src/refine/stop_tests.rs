//! A chunk whose refinement is stopped: at whatever question that is, it ends without beginning another piece.

use super::{RefinementTally, Refiner};
use crate::plan::{plan, usual_tangents};
use geofan_bundle::{Division, PlanRecord, Tree, rays::RaySpace};
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
    fn new() -> Self {
        let manifold = Manifold::from_source(SourceText::new("bump", SPACE), &[]).unwrap();
        let space = RaySpace::new(Arc::new(manifold)).unwrap();
        let tangents = usual_tangents(&space, 20.0);
        let (space, plan) = plan(space, 1.5, 20.0, tangents, &Unobserved).unwrap();
        let division = plan.division(&space);
        Self {
            space,
            plan,
            division,
        }
    }

    /// Refines the first chunk on one thread; also returns the rays and questions that it took, and its largest piece.
    fn chunk(&self, stop: Stop) -> (Option<Tree>, u64, u64, u64) {
        let tally = RefinementTally {
            stop,
            ..RefinementTally::default()
        };
        let refiner = Refiner {
            space: &self.space,
            plan: &self.plan,
            division: &self.division,
            tally: &tally,
        };
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        let tree = pool.install(|| refiner.chunk(0));
        let (asked, largest) = tally.stop.counts();
        (tree, tally.rays.into_inner(), asked, largest)
    }
}

#[test]
fn a_chunk_ends_at_any_question_and_asks_between_pieces_of_a_second() {
    let bake = Bake::new();
    let (tree, all_rays, asked, largest) = bake.chunk(Stop::default());
    assert!(tree.is_some() && asked > 100, "{asked}");
    assert!(largest <= MOST, "{largest}");
    // Some of its questions, and with each the next one.
    let some = (0..8).map(|k| 1 + k * (asked - 2) / 7);
    let questions: BTreeSet<u64> = some.flat_map(|k| [k, k + 1]).collect();
    let mut before: Option<(u64, u64)> = None;
    for question in questions {
        let (tree, rays, _, largest) = bake.chunk(Stop::at_question(question));
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
