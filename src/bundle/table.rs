//! The table in memory, and what is left of it when the camera is fixed.
//!
//! In: chunks of the table ([`Tree`]s) over the rays of a [`FanSpace`]. Out: [`Fan`]s: all paths
//! from one camera position, and from those single [`FanPath`]s: position, tangent and transported
//! rotation at any arc length. Interpolation *is* the contraction of the camera axes, so a camera
//! anywhere in the region costs the same.

use super::{
    bytes::Damage,
    contracted::Contracted,
    patch::Patch,
    tree::{Shape, Tree},
};
use crate::{
    error::Result,
    expr::vectorised,
    fan::{FanSpace, Located, Place, Start},
};
use glam::{DMat3, DQuat, DVec3};
use std::sync::OnceLock;

/// How a table is divided into chunks.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    /// Cells along each stored camera parameter.
    pub cells: Vec<usize>,
    /// Faces of directions.
    pub faces: usize,
}

impl Division {
    /// The number of chunks: cells × faces, faces running fastest.
    pub fn chunks(&self) -> usize {
        self.cells.iter().product::<usize>() * self.faces
    }

    /// The cell (along each parameter) and the face of a chunk.
    pub fn of(&self, chunk: usize) -> (Vec<usize>, usize) {
        let mut rest = chunk / self.faces;
        let cell = self.cells.iter().map(|n| {
            let c = rest % n;
            rest /= n;
            c
        });
        (cell.collect(), chunk % self.faces)
    }

    /// The first chunk (face 0) of the cell that holds `parameters`, and the parameters in it, in
    /// [−1, 1].
    pub(super) fn locate(&self, intervals: &[[f64; 2]], parameters: &[f64]) -> (usize, Vec<f64>) {
        let (mut cell, mut stride) = (0, 1);
        let mut inner = Vec::new();
        for ((&n, [low, high]), p) in self.cells.iter().zip(intervals).zip(parameters) {
            let t = if high > low {
                (p - low) / (high - low) * n as f64
            } else {
                0.5
            };
            let k = (t.max(0.0) as usize).min(n - 1);
            cell += k * stride;
            stride *= n;
            inner.push((2.0 * (t - k as f64) - 1.0).clamp(-1.0, 1.0));
        }
        (cell * self.faces, inner)
    }
}

/// A chunk, decoded when it is first used: a table of megabytes opens in milliseconds, and a camera
/// needs the chunks of one cell only.
#[derive(Debug, Clone)]
pub struct Chunk {
    bytes: Vec<u8>,
    shape: Shape,
    tree: OnceLock<Result<Tree, Damage>>,
}

impl Chunk {
    /// From what [`Tree::encode`] wrote.
    pub fn new(bytes: Vec<u8>, shape: Shape) -> Self {
        Self {
            bytes,
            shape,
            tree: OnceLock::new(),
        }
    }

    /// The coded chunk.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The tree.
    ///
    /// # Errors
    /// The bytes are not a tree.
    pub fn tree(&self) -> Result<&Tree, Damage> {
        let decode = || Tree::decode(&self.bytes, self.shape);
        self.tree.get_or_init(decode).as_ref().map_err(|e| *e)
    }
}

/// A baked table.
#[derive(Debug, Clone)]
pub struct Table {
    /// The rays it covers.
    pub space: FanSpace,
    /// How it is divided.
    pub division: Division,
    /// How far paths go.
    pub length: f64,
    /// The chunks, in order.
    pub chunks: Vec<Chunk>,
}

impl Table {
    /// What the tensors of a table over `space` look like.
    pub fn shape(space: &FanSpace) -> Shape {
        Shape {
            cameras: space.cameras().len(),
            directions: space.directions(),
            displacement: space.displacement_channels().len(),
            rotation: space.rotation_channels().len(),
        }
    }

    /// How many patches and flagged boxes there are.
    ///
    /// # Errors
    /// A chunk is damaged.
    pub fn counts(&self) -> Result<(usize, usize), Damage> {
        let mut sum = (0, 0);
        for chunk in &self.chunks {
            let (patches, flagged) = chunk.tree()?.count();
            sum = (sum.0 + patches, sum.1 + flagged);
        }
        Ok(sum)
    }

    /// All paths from the camera position `u`.
    ///
    /// # Errors
    /// `u` is not in the camera region, or the patches there are damaged.
    pub fn fan(&self, u: DVec3) -> Result<Fan<'_>> {
        let place = self.space.place(u)?;
        let (first, camera) = self
            .division
            .locate(self.space.cameras(), &place.parameters);
        let faces: Result<Vec<FanNode>, Damage> = (0..self.division.faces)
            .map(|face| {
                Ok(FanNode::contract(
                    self.chunks[first + face].tree()?,
                    &camera,
                ))
            })
            .collect();
        let faces = faces.map_err(|e| crate::Error::input("bundle", e.to_string()))?;
        Ok(Fan {
            table: self,
            place,
            faces,
        })
    }
}

/// A tree at one camera: only direction (axes 0, 1) and arc length (axis 2) are left.
#[derive(Debug, Clone)]
enum FanNode {
    Split {
        axis: usize,
        halves: Box<[FanNode; 2]>,
    },
    Leaf {
        displacement: Contracted,
        rotation: Option<Contracted>,
    },
    Flagged,
}

/// The local coordinate in the half that holds `x`, and which half it is.
pub fn half(x: f64) -> (usize, f64) {
    if x < 0.0 {
        (0, 2.0 * x + 1.0)
    } else {
        (1, 2.0 * x - 1.0)
    }
}

impl FanNode {
    fn contract(tree: &Tree, camera: &[f64]) -> Self {
        match tree {
            Tree::Flagged => Self::Flagged,
            Tree::Leaf(patch) => Self::leaf(patch, camera),
            Tree::Split { axis, halves } if *axis < camera.len() => {
                let mut camera = camera.to_vec();
                let (side, inner) = half(camera[*axis]);
                camera[*axis] = inner;
                Self::contract(&halves[side], &camera)
            }
            Tree::Split { axis, halves } => Self::Split {
                axis: axis - camera.len(),
                halves: Box::new(halves.each_ref().map(|half| Self::contract(half, camera))),
            },
        }
    }

    fn leaf(patch: &Patch, camera: &[f64]) -> Self {
        Self::Leaf {
            displacement: patch.displacement.contract(camera),
            rotation: patch.rotation.as_ref().map(|r| r.contract(camera)),
        }
    }
}

/// All paths from one camera position.
#[derive(Debug, Clone)]
pub struct Fan<'t> {
    table: &'t Table,
    /// The camera position.
    pub place: Place,
    faces: Vec<FanNode>,
}

impl<'t> Fan<'t> {
    /// The path in the direction `d` (standard frame, unit).
    pub fn path(&self, d: DVec3) -> FanPath<'_, 't> {
        let located = self.table.space.locate(&self.place, d);
        let lift = self.table.space.lift();
        let mut path = FanPath {
            fan: self,
            start: lift.start(located.u, located.v),
            pieces: Vec::new(),
            coefficients: Vec::new(),
            located,
        };
        let mut direction = [0.0; 2];
        direction[..path.located.direction.len()].copy_from_slice(&path.located.direction);
        let root = &self.faces[path.located.face];
        path.collect(root, direction, [0.0, self.table.length]);
        path
    }
}

/// Arc lengths summed at once.
const LANES: usize = 16;

/// A piece of a path: polynomials in the arc length.
#[derive(Debug, Clone, Copy)]
struct Piece {
    interval: [f64; 2],
    /// Where its displacement coefficients start, and their (rows, channels).
    displacement: (usize, (usize, usize)),
    rotation: Option<(usize, (usize, usize))>,
}

/// One path of a fan.
#[derive(Debug, Clone)]
pub struct FanPath<'f, 't> {
    fan: &'f Fan<'t>,
    start: Start,
    located: Located,
    /// In order of arc length; `None` where the patch is flagged.
    pieces: Vec<([f64; 2], Option<Piece>)>,
    coefficients: Vec<f64>,
}

impl FanPath<'_, '_> {
    fn collect(&mut self, node: &FanNode, direction: [f64; 2], interval: [f64; 2]) {
        match node {
            FanNode::Flagged => self.pieces.push((interval, None)),
            FanNode::Split { axis, halves } if *axis == self.arc_axis() => {
                let middle = 0.5 * (interval[0] + interval[1]);
                self.collect(&halves[0], direction, [interval[0], middle]);
                self.collect(&halves[1], direction, [middle, interval[1]]);
            }
            FanNode::Split { axis, halves } => {
                let mut direction = direction;
                let (side, inner) = half(direction[*axis]);
                direction[*axis] = inner;
                self.collect(&halves[side], direction, interval);
            }
            FanNode::Leaf {
                displacement,
                rotation,
            } => {
                let mut put = |table: &Contracted| {
                    let start = self.coefficients.len();
                    table.direction(direction[0], direction[1], &mut self.coefficients);
                    (start, table.shape())
                };
                let piece = Piece {
                    interval,
                    displacement: put(displacement),
                    rotation: rotation.as_ref().map(put),
                };
                self.pieces.push((interval, Some(piece)));
            }
        }
    }

    fn arc_axis(&self) -> usize {
        self.fan.table.space.directions()
    }

    /// The first arc length at which the table gives up; infinite if it never does.
    pub fn flagged_from(&self) -> f64 {
        let first = self.pieces.iter().find(|(_, piece)| piece.is_none());
        first.map_or(f64::INFINITY, |(interval, _)| interval[0])
    }

    fn piece(&self, s: f64) -> Option<&Piece> {
        let after = self.pieces.partition_point(|(interval, _)| interval[1] < s);
        let (_, piece) = self.pieces.get(after.min(self.pieces.len() - 1))?;
        piece.as_ref()
    }

    /// The values (or slopes in s) at `s` of the polynomials stored at `start`.
    fn sum(&self, (start, (rows, channels)): (usize, (usize, usize)), weights: &[f64]) -> [f64; 4] {
        let mut sums = [0.0; 4];
        let rows = self.coefficients[start..start + rows * channels].chunks_exact(channels);
        for (row, w) in rows.zip(weights) {
            for (sum, c) in sums.iter_mut().zip(row) {
                *sum += w * c;
            }
        }
        sums
    }

    /// Chart point and tangent (chart components) at arc length `s`; `None` where flagged.
    pub fn at(&self, s: f64) -> Option<(DVec3, DVec3)> {
        let (stored, tangent) = self.stored_at(s)?;
        let (u, differential) = self.located.isometry.apply(stored);
        Some((u, differential * tangent))
    }

    /// Chart points and tangents at the ascending arc lengths `s`, appended to `u` and `v`; ends
    /// where the table gives up.
    pub fn sample(&self, s: &[f64], u: &mut Vec<DVec3>, v: &mut Vec<DVec3>) {
        let mut rest = s;
        let affine = self.located.isometry.affine();
        for (interval, piece) in &self.pieces {
            let last = interval[1] >= self.fan.table.length;
            let here = match last {
                true => rest.len(),
                false => rest.partition_point(|s| *s <= interval[1]),
            };
            let Some(piece) = piece else {
                if here > 0 {
                    return;
                }
                continue;
            };
            for block in rest[..here].chunks(LANES) {
                let mut lengths = [block[0]; LANES];
                lengths[..block.len()].copy_from_slice(block);
                let sums = self.sums(piece, &lengths);
                for (lane, s) in block.iter().enumerate() {
                    let (stored, tangent) = self.state(&sums, lane, *s);
                    // Affine isometries, nearly all of them, are worked out once for the path.
                    let (point, tangent) = match &affine {
                        Some((q, t)) => (*q * stored + *t, *q * tangent),
                        None => {
                            let (point, differential) = self.located.isometry.apply(stored);
                            (point, differential * tangent)
                        }
                    };
                    u.push(point);
                    v.push(tangent);
                }
            }
            rest = &rest[here..];
        }
    }

    fn stored_at(&self, s: f64) -> Option<(DVec3, DVec3)> {
        let sums = self.sums(self.piece(s)?, &[s]);
        Some(self.state(&sums, 0, s))
    }

    /// Chebyshev sums of the displacement channels and of their slopes in the arc length, at `W`
    /// arc lengths of one piece at once, by the recurrences of `T_k` and `T'_k`.
    fn sums<const W: usize>(&self, piece: &Piece, s: &[f64; W]) -> [[[f64; W]; 4]; 2] {
        let [low, high] = piece.interval;
        let scale = 2.0 / (high - low);
        let (start, (rows, channels)) = piece.displacement;
        let rows = self.coefficients[start..start + rows * channels].chunks_exact(channels);
        let mut sums = [[[0.0; W]; 4]; 2];
        vectorised(
            #[inline(always)]
            || {
                let t = s.map(|s| scale * (s - low) - 1.0);
                let (mut value, mut next) = ([1.0; W], t);
                let (mut rate, mut next_rate) = ([0.0; W], [scale; W]);
                for row in rows {
                    for (c, x) in row.iter().enumerate() {
                        for l in 0..W {
                            sums[0][c][l] += value[l] * x;
                            sums[1][c][l] += rate[l] * x;
                        }
                    }
                    for l in 0..W {
                        let after = 2.0 * t[l] * next[l] - value[l];
                        let slope = 2.0 * (scale * next[l] + t[l] * next_rate[l]) - rate[l];
                        (value[l], next[l], rate[l], next_rate[l]) =
                            (next[l], after, next_rate[l], slope);
                    }
                }
            },
        );
        sums
    }

    /// Point and tangent of the stored ray from [`FanPath::sums`].
    fn state<const W: usize>(
        &self,
        sums: &[[[f64; W]; 4]; 2],
        lane: usize,
        s: f64,
    ) -> (DVec3, DVec3) {
        let space = &self.fan.table.space;
        let (mut values, mut slopes) = ([0.0; 4], [0.0; 4]);
        for (k, channel) in space.displacement_channels().iter().enumerate() {
            values[*channel] = sums[0][k][lane];
            slopes[*channel] = sums[1][k][lane];
        }
        space.lift().decode_state(&self.start, values, slopes, s)
    }

    /// The chart point and tangent at `s`, the tangent the first one carried along by the transported
    /// rotation, because a geodesic's tangent is parallel. The slope of the displacement, which is
    /// what [`FanPath::at`] gives, is a polynomial's derivative: where the table stores rotations
    /// this is some ten times closer. `None` where flagged.
    pub fn state_at(&self, s: f64) -> Option<(DVec3, DVec3)> {
        let (stored, slope) = self.stored_at(s)?;
        let tangent = match self.stored_rotation(stored, s) {
            None => slope,
            Some(q) => {
                let manifold = self.fan.table.space.manifold();
                manifold.standard_frame(stored) * (q * self.located.d)
            }
        };
        let (u, differential) = self.located.isometry.apply(stored);
        Some((u, differential * tangent))
    }

    /// The transported rotation at `s` relative to the standard frames; `None` where flagged or
    /// where the table has none.
    pub fn rotation(&self, s: f64) -> Option<DQuat> {
        let (u, _) = self.stored_at(s)?;
        let q = self.stored_rotation(u, s)?;
        let space = &self.fan.table.space;
        let place = &self.fan.place;
        let turned = space.true_rotation(place, &self.located, u, DMat3::from_quat(q));
        Some(DQuat::from_mat3(&turned))
    }

    /// The transported rotation of the stored ray, at whose chart point `u` it is.
    fn stored_rotation(&self, u: DVec3, s: f64) -> Option<DQuat> {
        let piece = self.piece(s)?;
        let stored = piece.rotation?;
        let width = piece.interval[1] - piece.interval[0];
        let t = 2.0 * (s - piece.interval[0]) / width - 1.0;
        let mut values = [0.0; super::tensor::MOST_DEGREES];
        super::chebyshev::values(t, &mut values[..stored.1.0]);
        let mut q = [0.0; 4];
        let space = &self.fan.table.space;
        for (channel, x) in space
            .rotation_channels()
            .iter()
            .zip(self.sum(stored, &values))
        {
            q[*channel] = x;
        }
        let twist = space.lift().twist(u);
        Some(twist.conjugate() * DQuat::from_array(q).normalize())
    }
}
