//! The log of the decisions about the boxes of a chunk, so that an interruption loses few of them.
//!
//! In: each decision as it is taken. Out: the decisions again after an interruption, by the names of their boxes
//! ([`DecisionLog`]): it then loses no more than the boxes that are being decided. A chunk can take hours, a box a minute. The
//! log's file has one checksummed block with the bundle's id for each. What follows a block that was cut off or damaged is as
//! good as none, and so is the file of another bake or version. A decision is stored as the [`Tree`] that it makes of its box,
//! in which parts that are still open are given up.

use super::{
    GENERATOR, WorkCounts,
    edges::EdgeDivision,
    refinement_tree::{Decision, ParameterBox},
    separatrix::SeparatrixDivision,
};
use geofan_bundle::{
    ByteReader, DecodeBudget, DecodeError, TensorShape, Tree,
    container::{BlockKind, Id, first_block, put_block},
    put_bytes,
};
use geofan_core::{Error, Result};
use std::{
    array::from_fn,
    collections::HashMap,
    fs::File,
    io::{Read, Seek, SeekFrom, Write},
    num::NonZeroU32,
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

/// Keeps the decisions about the boxes of one chunk.
#[derive(Debug)]
pub struct DecisionLog {
    chunk: u32,
    id: Id,
    shape: TensorShape,
    /// The decisions of an earlier run, by the names of their boxes.
    earlier: Mutex<HashMap<Vec<u64>, Vec<u8>>>,
    /// The file that decisions are added to; none from the first that could not be written.
    file: Mutex<Option<File>>,
}

impl DecisionLog {
    /// Opens the file at `path`, made if need be, for the decisions about `chunk` of the bundle `id`, whose tensors have this
    /// `shape`.
    ///
    /// # Errors
    /// The file cannot be read or written.
    pub fn open(path: &Path, chunk: u32, id: Id, shape: TensorShape) -> Result<Self> {
        let failed = |e| Error::io(path, e);
        let mut options = File::options();
        let options = options.create(true).truncate(false).read(true).write(true);
        let mut file = options.open(path).map_err(failed)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(failed)?;
        let (earlier, whole) = read_all(&bytes, chunk, id);
        // What is added follows the last whole block.
        file.set_len(whole).map_err(failed)?;
        file.seek(SeekFrom::Start(whole)).map_err(failed)?;
        Ok(Self {
            chunk,
            id,
            shape,
            earlier: Mutex::new(earlier),
            file: Mutex::new(Some(file)),
        })
    }

    /// Returns what an earlier run decided about a box with this error budget, and what it counted for that.
    pub(super) fn earlier(
        &self,
        bounds: &ParameterBox,
        budget: f64,
    ) -> Option<(Decision, WorkCounts)> {
        let record = locked(&self.earlier).remove(&bounds.name)?;
        let mut shape = self.shape;
        shape.variables.sphere &= bounds.face.is_none();
        decode(&record, budget, shape).ok().flatten()
    }

    /// Adds the decision about a box with this error budget, and what was counted for it. Where it cannot be written, as on a
    /// full disk, it and those that follow are not kept.
    pub(super) fn add(
        &self,
        bounds: &ParameterBox,
        budget: f64,
        decision: &Decision,
        counts: WorkCounts,
    ) {
        let record = encode(bounds, budget, decision, counts);
        let mut block = Vec::new();
        put_block(
            &mut block,
            BlockKind::Decision,
            self.chunk,
            self.id,
            &record,
        );
        let mut file = locked(&self.file);
        let written = file.as_mut().map(|file| file.write_all(&block));
        if let Some(Err(error)) = written {
            tracing::warn!(
                "an interruption will lose what is done of chunk {}: {error}",
                self.chunk
            );
            *file = None;
        }
    }
}

/// Locks what no panic can have left half done: what is behind is changed by single calls.
fn locked<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the records of the whole blocks at the beginning of a file, by the names of their boxes, and the bytes that those
/// take.
fn read_all(bytes: &[u8], chunk: u32, id: Id) -> (HashMap<Vec<u64>, Vec<u8>>, u64) {
    let mut rest = bytes;
    let mut records = HashMap::new();
    while let Some((record, behind)) = first_block(rest, BlockKind::Decision, chunk, id) {
        let Ok(name) = box_name(&mut ByteReader(record)) else {
            break;
        };
        records.insert(name, record.to_vec());
        rest = behind;
    }
    (records, (bytes.len() - rest.len()) as u64)
}

/// Reads the name of the box that a record is about.
fn box_name(input: &mut ByteReader<'_>) -> Result<Vec<u64>, DecodeError> {
    if input.bytes()? != GENERATOR.as_bytes() {
        return Err(DecodeError("version"));
    }
    let numbers = input.bytes()?.chunks_exact(size_of::<u64>());
    numbers.map(|number| ByteReader(number).u64()).collect()
}

/// Makes the record of a decision: version, box, budget, counts, which decision, and its tree.
fn encode(bounds: &ParameterBox, budget: f64, decision: &Decision, counts: WorkCounts) -> Vec<u8> {
    let mut out = Vec::new();
    put_bytes(&mut out, GENERATOR.as_bytes());
    let name: Vec<u8> = bounds.name.iter().flat_map(|n| n.to_le_bytes()).collect();
    put_bytes(&mut out, &name);
    out.extend(budget.to_bits().to_le_bytes());
    let WorkCounts {
        rays,
        patches,
        bytes,
        volume,
    } = counts;
    out.extend(
        [rays, patches, bytes, volume]
            .iter()
            .flat_map(|n| n.to_le_bytes()),
    );
    let open = || Box::new([Tree::Flagged, Tree::Flagged]);
    let halved = |axis: usize| Tree::Split {
        axis,
        halves: open(),
    };
    let (kind, tree) = match decision {
        Decision::Fitted(tree) => (0, tree.clone()),
        Decision::Unread(tree) => (1, tree.clone()),
        Decision::Halve(axis) => (2, halved(*axis)),
        Decision::Mixed(axis) => (3, halved(*axis)),
        Decision::Faces => (4, Tree::Faces(Box::new(from_fn(|_| Tree::Flagged)))),
        Decision::Edge(crossing) => {
            let (place, parts) = (crossing.place.clone(), open());
            (5, Tree::Edge { place, parts })
        }
        Decision::Separatrix(found) => {
            let tree = Tree::Separatrix {
                place: found.place.clone(),
                reach: found.reach,
                sides: open(),
            };
            (6, tree)
        }
    };
    out.push(kind);
    match decision {
        Decision::Edge(crossing) => {
            out.extend(crossing.edge.get().to_le_bytes());
            out.extend(crossing.share.to_bits().to_le_bytes());
        }
        Decision::Separatrix(found) => out.extend(found.share.to_bits().to_le_bytes()),
        _ => {}
    }
    out.extend(tree.encode());
    out
}

/// Reads what [`encode`] made; none if it was another budget.
fn decode(
    record: &[u8],
    budget: f64,
    shape: TensorShape,
) -> Result<Option<(Decision, WorkCounts)>, DecodeError> {
    let mut input = ByteReader(record);
    box_name(&mut input)?;
    if input.u64()? != budget.to_bits() {
        return Ok(None);
    }
    let counts = WorkCounts {
        rays: input.u64()?,
        patches: input.u64()?,
        bytes: input.u64()?,
        volume: input.u64()?,
    };
    let kind = input.u8()?;
    let edge = match kind {
        5 => NonZeroU32::new(input.u32()?),
        _ => None,
    };
    let share = match kind {
        5 | 6 => f64::from_bits(input.u64()?),
        _ => 1.0,
    };
    let budget = Arc::new(DecodeBudget::for_bytes(input.0.len()));
    let tree = Tree::decode(input.0, shape, &budget)?;
    let decision = match (kind, tree, edge) {
        (0, tree, _) => Decision::Fitted(tree),
        (1, tree, _) => Decision::Unread(tree),
        (2, Tree::Split { axis, .. }, _) => Decision::Halve(axis),
        (3, Tree::Split { axis, .. }, _) => Decision::Mixed(axis),
        (4, Tree::Faces(_), _) => Decision::Faces,
        (5, Tree::Edge { place, .. }, Some(edge)) => {
            Decision::Edge(Box::new(EdgeDivision { edge, place, share }))
        }
        (6, Tree::Separatrix { place, reach, .. }, _) => {
            let found = SeparatrixDivision {
                place,
                reach,
                share,
            };
            Decision::Separatrix(Arc::new(found))
        }
        _ => return Err(DecodeError("decision")),
    };
    Ok(Some((decision, counts)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_bundle::{
        MappedChebyshev, Polynomial, SideReach, StepSize, Tensor, Train, Variables,
    };
    use ndarray::{ArrayD, IxDyn};

    const VARIABLES: Variables = Variables {
        cameras: 0,
        mapping: MappedChebyshev::NONE,
        sphere: false,
    };

    /// Makes a tensor of these numbers along its first axis.
    fn tensor(numbers: [f64; 3], channels: usize) -> Arc<Tensor> {
        let coefficients = numbers.map(|x| vec![x; channels]).concat();
        let polynomial = Polynomial {
            coefficients: ArrayD::from_shape_vec(IxDyn(&[3, 1, 1, channels]), coefficients)
                .unwrap(),
            variables: VARIABLES,
        };
        let train = Train::plain(&polynomial);
        Arc::new(train.rounded(StepSize::near(1e-6)).unwrap())
    }

    #[test]
    fn every_decision_is_read_again_also_below_the_faces_of_a_sphere() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("boxes-000000");
        let shape = TensorShape {
            variables: Variables {
                sphere: true,
                ..VARIABLES
            },
            directions: 2,
            channels: 3,
        };
        let open = || DecisionLog::open(&path, 0, [7; 16], shape).unwrap();
        let sphere = ParameterBox::whole(3, None, vec![5]);
        let faces = sphere.faces();
        let place = tensor([0.25; 3], 1);
        let edge = EdgeDivision {
            edge: NonZeroU32::MIN,
            place: place.clone(),
            share: 0.3,
        };
        let separatrix = SeparatrixDivision {
            place,
            reach: SideReach::covering(1, [-0.3, 0.4]).unwrap(),
            share: 0.6,
        };
        let decisions = [
            (&sphere, Decision::Faces),
            (&faces[0], Decision::Halve(0)),
            (&faces[1], Decision::Mixed(1)),
            (&faces[2], Decision::Edge(Box::new(edge))),
            (&faces[3], Decision::Separatrix(Arc::new(separatrix))),
            (&faces[4], Decision::Fitted(Tree::Leaf(tensor([0.5; 3], 3)))),
            (&faces[5], Decision::Unread(Tree::Flagged)),
        ];
        let counts = WorkCounts {
            rays: 7,
            ..WorkCounts::default()
        };
        let log = open();
        for (bounds, decision) in &decisions {
            log.add(bounds, 0.5, decision, counts);
        }
        let log = open();
        for (bounds, decision) in &decisions {
            let (again, counted) = log.earlier(bounds, 0.5).expect("it is kept");
            assert_eq!(counted.rays, 7);
            // What is equal is written alike.
            let record = |decision| encode(bounds, 0.5, decision, counts);
            assert_eq!(record(&again), record(decision));
        }
        assert!(
            log.earlier(&sphere, 0.5).is_none(),
            "each is asked for once"
        );
    }
}
