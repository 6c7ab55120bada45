//! Quantised Chebyshev coefficients of one group of channels, as a tensor train.
//!
//! In: real cores and a step. Out: rounded cores, coded with those of the other patches of a chunk
//! ([`Tensor::encode`]); the small table that remains when the camera is fixed ([`Tensor::contract`]); and
//! the coefficients of single rays ([`Tensor::at_many`]). The tensor itself is never unpacked.
//!
//! A tensor with axes (camera…, direction…, arc length, channel) is a product of cores
//! `C_1 D_1 C_2 D_2 … C_d`, each over one axis (the last over arc length and channel), in the order
//! that its [`Layout`] tells. The diagonal matrices `D_k` divide by the singular values of the bond, and
//! the cores are multiplied by them: `C_k` is then the centre of a train that is orthogonal to both
//! sides, so that one step for all cores makes each rounded integer cost the same error (I. V.
//! Oseledets, *Tensor-train decomposition*, SIAM J. Sci. Comput. 33 (2011)). Its columns and rows are
//! orthogonal too, and a file holds only the numbers that this leaves free ([`crate::householder`]: an
//! eighth fewer bytes for three bumps on a quarter of a floor). [`Layout::Plain`] has a single core over
//! all axes: where ranks explode it is smaller.

use crate::{
    coder::{IntegerDecoder, IntegerEncoder},
    contracted::{self, Contracted},
    decode::{ByteReader, DecodeBudget, DecodeError},
    matrix::{added, product},
    polynomial::{TermWeights, Variables},
    train::unweight,
    train_core::{Core, Factor, OpenMatrix, Power, StepSize, StoredCore, axis_along, matrix_chain},
    tree::TensorShape,
};
use geofan_core::parallel::*;
use geofan_expr::real::Real;
use std::sync::{Arc, OnceLock};

/// Quantised coefficients of one group of channels.
#[derive(Debug, Clone)]
pub struct Tensor {
    pub(crate) layout: Layout,
    pub(crate) variables: Variables,
    pub(crate) step: StepSize,
    pub(crate) cores: Vec<Core>,
    /// The last core as cameras take it, once one has asked for it.
    pub(crate) rows: OnceLock<Arc<[f32]>>,
}

/// The largest product of sums of cores that is taken for a table's.
const LARGEST_PRODUCT: f64 = 1e30;

impl Tensor {
    /// Counts the axes: camera…, direction…, arc length, channel.
    fn axes(&self) -> usize {
        self.cores.iter().map(|core| core.shape.len() - 2).sum()
    }

    pub(crate) fn table_axes(&self) -> Vec<Vec<usize>> {
        self.layout.cores(self.axes() - 2)
    }

    /// Returns the lengths of the axes (camera…, direction…, arc length, channel).
    pub fn shape(&self) -> Vec<usize> {
        let mut shape = vec![0; self.axes()];
        for (axes, core) in self.table_axes().iter().zip(&self.cores) {
            for (axis, n) in axes.iter().zip(&core.shape[1..]) {
                shape[*axis] = *n;
            }
        }
        shape
    }

    /// Returns the ranks of the bonds; none in the plain layout.
    pub fn ranks(&self) -> Vec<usize> {
        let inner = &self.cores[..self.cores.len() - 1];
        inner.iter().map(|core| core.scales.len()).collect()
    }

    /// Sums out the axes of the cores that have `weights`.
    pub(crate) fn matrices<T: Real>(&self, weights: &[Option<&[T]>]) -> Vec<OpenMatrix<T>> {
        let axes = self.table_axes();
        let matrices = axes.iter().zip(&self.cores);
        matrices
            .map(|(axes, core)| self.matrix(axes, core, weights))
            .collect()
    }

    /// Returns the first `count` cores as factors of a chain, where those `weights` are of cameras.
    fn factors<'c, T: Real>(
        &'c self,
        weights: &[Option<&'c [T]>],
        count: usize,
    ) -> Vec<Factor<'c, T>> {
        let axes = self.table_axes();
        let factors = axes.iter().zip(&self.cores[..count]);
        factors
            .map(|(axes, core)| self.factor(axes, core, weights))
            .collect()
    }

    fn factor<'c, T: Real>(
        &self,
        axes: &[usize],
        core: &'c Core,
        weights: &[Option<&'c [T]>],
    ) -> Factor<'c, T> {
        let unit = self.step.value();
        match axes {
            [axis] => match weights[*axis] {
                None => Factor::Packed(core, unit),
                Some(weights) => Factor::Summed(core, weights, unit),
            },
            _ => Factor::Known(self.matrix(axes, core, weights)),
        }
    }

    /// Sums out those of the `axes` of one core that have `weights`.
    fn matrix<T: Real>(
        &self,
        axes: &[usize],
        core: &Core,
        weights: &[Option<&[T]>],
    ) -> OpenMatrix<T> {
        let weights: Vec<Option<&[T]>> = axes.iter().map(|a| weights[*a]).collect();
        // The unit of the step belongs to every core.
        let mut values = core.closed(&weights, self.step.value());
        if axes.len() > 1 {
            unweight(&mut values, &core.shape);
        }
        OpenMatrix {
            left: core.shape[0],
            right: core.shape[core.shape.len() - 1],
            values,
        }
    }

    /// Copies `matrices`, those over directions made anew with other `weights`.
    fn with_directions<T: Real>(
        &self,
        matrices: &[OpenMatrix<T>],
        weights: &[Option<&[T]>],
    ) -> Vec<OpenMatrix<T>> {
        // Cores over cameras stay as they are.
        let rays = self.axes() - 2;
        let directions = self.variables.cameras..rays;
        let axes = self.table_axes();
        let cores = axes.iter().zip(&self.cores).zip(matrices);
        let matrix = |((axes, core), matrix): ((&Vec<usize>, &Core), &OpenMatrix<T>)| match axes
            .iter()
            .any(|axis| directions.contains(axis))
        {
            true => self.matrix(axes, core, weights),
            false => matrix.clone(),
        };
        cores.map(matrix).collect()
    }

    /// Lists the ray axes without `weights`, in the order of the cores.
    fn open<T>(&self, weights: &[Option<&[T]>]) -> Vec<usize> {
        let axes = self.table_axes().concat();
        let open = |axis: &usize| weights[*axis].is_none();
        axes[..axes.len() - 2]
            .iter()
            .copied()
            .filter(open)
            .collect()
    }

    /// Contracts the camera axes at the parameters `camera` in [−1, 1] to a table over (direction 1,
    /// direction 2, arc length, channel); with one direction parameter the second axis has length 1. In
    /// single precision, as the table is stored: rounding adds 1e-7 or so of the largest coefficient.
    pub fn contract(&self, camera: &[f64]) -> Contracted {
        let shape = self.shape();
        let weights = &self.variables.weights::<f32>(&shape, camera)[0];
        let weights = open_beyond(weights, shape.len());
        let row: usize = shape[shape.len() - 2..].iter().product();
        // The last core, over arc length and channel, is worth multiplying only for few directions.
        let before = self.cores.len() - 1;
        let rank = self.cores[before].shape[0];
        let split = before > 0 && rank < row;
        let factors = self.factors(&weights, before + usize::from(!split));
        let width = if split { rank } else { row };
        let table = in_table_order(matrix_chain(factors), &self.open(&weights), &shape, width);
        let rows = split.then(|| self.rows(row));
        Contracted::new(&shape[camera.len()..], &table, rows, self.variables)
    }

    /// Returns the last core as rows of `row` numbers.
    fn rows(&self, row: usize) -> Arc<[f32]> {
        let make = || {
            let last = self.cores.len() - 1;
            let open = vec![None; self.axes()];
            let matrix: OpenMatrix<f32> =
                self.matrix(&self.table_axes()[last], &self.cores[last], &open);
            contracted::rows(&matrix.values, row)
        };
        self.rows.get_or_init(make).clone()
    }

    /// Computes the coefficients that remain at parameters in [−1, 1] of the first axes, in table order.
    /// With camera and direction, for a single ray, that is cheaper than [`Tensor::contract`].
    pub fn at(&self, parameters: &[f64]) -> Vec<f64> {
        self.at_in(parameters)
    }

    fn at_in<T: Real>(&self, parameters: &[f64]) -> Vec<T> {
        let shape = self.shape();
        let sets: Vec<TermWeights<T>> = self.variables.weights(&shape, parameters);
        let sets = sets.iter().map(|weights| open_beyond(weights, shape.len()));
        let sets: Vec<Vec<Option<&[T]>>> = sets.collect();
        let row = shape[shape.len() - 2..].iter().product();
        // The chain for the first set of weights; others share its cores over cameras.
        let (open, matrices) = (self.open(&sets[0]), self.matrices(&sets[0]));
        let others = sets[1..]
            .iter()
            .map(|weights| self.with_directions(&matrices, weights));
        let mut all: Vec<Vec<OpenMatrix<T>>> = others.collect();
        all.push(matrices);
        // The product of each chain, and their sum.
        let sum = |matrices: Vec<OpenMatrix<T>>| {
            let factors = matrices.into_iter().map(Factor::Known).collect();
            in_table_order(matrix_chain(factors), &open, &shape, row)
        };
        added(&all.into_iter().map(sum).collect::<Vec<_>>())
    }

    /// Counts the integers that it holds, of 32 bits each.
    pub fn integers(&self) -> usize {
        self.cores.iter().map(Core::integers).sum()
    }

    /// Estimates the bytes that it takes in a chunk, where models are shared with other tensors.
    pub fn bytes(&self) -> usize {
        let (mut structure, mut integers) = (Vec::new(), IntegerEncoder::new());
        self.encode(&mut structure, &mut integers);
        structure.len() + integers.bytes()
    }

    /// Writes the tensor: its shape to `out`, its integers to `integers`.
    pub(crate) fn encode(&self, out: &mut Vec<u8>, integers: &mut IntegerEncoder) {
        out.push(self.layout.code());
        out.extend(self.step.0.to_le_bytes());
        for core in &self.cores {
            core.encode(out, integers, self.step);
        }
    }

    /// Tells whether products of neighbouring cores, in any order, stay far from the end of single precision.
    fn is_finite(&self) -> bool {
        let sizes = self.cores.iter().map(|core| core.largest_sum);
        let sizes: Vec<f64> = sizes.map(|sum| sum * self.step.value()).collect();
        let product_of = |chain: &[f64]| chain.iter().product::<f64>();
        let lengths = 1..=sizes.len();
        let mut chains = lengths.flat_map(|n| sizes.windows(n));
        chains.all(|chain| product_of(chain) < LARGEST_PRODUCT)
    }

    /// Counts the numbers that are left when the first `cameras` axes are summed out ([`Tensor::contract`]).
    fn opened(&self, cameras: usize) -> u64 {
        let shape = self.shape();
        let (rays, row) = shape[cameras..].split_at(shape.len() - 2 - cameras);
        let last = &self.cores[self.cores.len() - 1];
        let width = row.iter().product::<usize>().min(last.shape[0].max(1));
        let width = if self.cores.len() > 1 {
            width
        } else {
            row.iter().product()
        };
        rays.iter()
            .fold(width as u64, |all, n| all.saturating_mul(*n as u64))
    }
}

/// A tensor whose cores are being restored.
#[derive(Debug)]
pub(crate) struct StoredTensor {
    layout: Layout,
    variables: Variables,
    step: StepSize,
    /// Number of terms along the arc length.
    lengths: usize,
    cores: Vec<Arc<OnceLock<Result<Core, DecodeError>>>>,
}

impl StoredTensor {
    /// Reads what [`Tensor::encode`] wrote: a tensor of this `shape`. `scope` restores cores while the next ones are read,
    /// and `budget` is what the tensors of a table may ask for.
    ///
    /// # Errors
    /// It is not one.
    pub fn decode<'s>(
        input: &mut ByteReader<'_>,
        integers: &mut IntegerDecoder,
        shape: TensorShape,
        (scope, budget): (&TaskScope<'s>, &'s DecodeBudget),
    ) -> Result<Self, DecodeError> {
        let TensorShape {
            variables,
            directions,
            channels,
        } = shape;
        let rays = variables.cameras + directions;
        // Layout and step.
        let layout = Layout::of_code(input.u8()?, rays);
        let layout = layout.ok_or(DecodeError("layout of a tensor"))?;
        let step = Power(input.i16()?).within_range("step")?;
        // The cores, each behind the one before.
        let (mut cores, mut before, mut lengths) = (Vec::new(), None, 0);
        let axes = layout.cores(rays);
        for (k, axes_of_core) in axes.iter().enumerate() {
            let last = k + 1 == axes.len();
            let along = axis_along(axes_of_core, variables.cameras);
            let read = (axes_of_core.len(), along);
            let core = StoredCore::decode(input, integers, (before, last), read, (step, budget))?;
            if last && core.length(axes_of_core.len() - 1) != channels {
                return Err(DecodeError("number of channels"));
            }
            if last {
                lengths = core.length(axes_of_core.len() - 2);
            }
            before = Some(core.before());
            let place = Arc::new(OnceLock::new());
            cores.push(place.clone());
            scope.spawn(move |_| _ = place.set(core.restored(budget)));
        }
        Ok(Self {
            layout,
            variables,
            step,
            lengths,
            cores,
        })
    }

    /// Returns the number of terms along the arc length.
    pub fn lengths(&self) -> usize {
        self.lengths
    }

    /// Returns the tensor, once all its cores are restored.
    ///
    /// # Errors
    /// Its numbers are too large, or more than is left of the budget.
    pub fn restored(self, budget: &DecodeBudget) -> Result<Tensor, DecodeError> {
        let core = |place| {
            let place = Arc::into_inner(place).and_then(OnceLock::into_inner);
            place.unwrap_or(Err(DecodeError("order of cores")))
        };
        let tensor = Tensor {
            cores: self.cores.into_iter().map(core).collect::<Result<_, _>>()?,
            layout: self.layout,
            variables: self.variables,
            step: self.step,
            rows: OnceLock::new(),
        };
        // A camera opens all directions of the tensor at once, in single precision.
        let opened = tensor.opened(tensor.variables.cameras);
        budget.take_memory(opened.saturating_mul(4))?;
        match tensor.is_finite() {
            true => Ok(tensor),
            false => Err(DecodeError("size of coefficients")),
        }
    }
}

/// Pads the weights of the first axes with none for the others of `axes`.
fn open_beyond<T>(weights: &[Vec<T>], axes: usize) -> Vec<Option<&[T]>> {
    let mut all: Vec<Option<&[T]>> = weights.iter().map(|w| Some(w.as_slice())).collect();
    all.resize(axes, None);
    all
}

/// Puts `values` over the ray axes `rays` and rows of `row` numbers in ascending order of axes.
fn in_table_order<T: Copy>(values: Vec<T>, rays: &[usize], shape: &[usize], row: usize) -> Vec<T> {
    if rays.is_sorted() {
        return values;
    }
    let mut ascending = rays.to_vec();
    ascending.sort_unstable();
    let stride = |axis: &usize| -> usize {
        let after = rays.iter().skip_while(|a| *a != axis).skip(1);
        after.map(|a| shape[*a]).product()
    };
    // The place of each row, axis by axis.
    let mut firsts = vec![0];
    for axis in &ascending {
        let stride = stride(axis);
        let along = |first: &usize| (0..shape[*axis]).map(move |i| first + i * stride).collect();
        firsts = firsts
            .iter()
            .flat_map(|f| -> Vec<usize> { along(f) })
            .collect();
    }
    let rows = firsts.iter().flat_map(|f| &values[f * row..(f + 1) * row]);
    rows.copied().collect()
}

/// The assignment of axes to the cores of a train. Each ray axis has a core of its own, in any order; arc
/// length and channel share the last. The order matters: ranks are small where axes that belong together
/// stand together, and which do depends on the manifold, the region and the face of directions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Layout {
    /// One core over all axes.
    Plain,
    /// A train with these ray axes, one to a core.
    Train(Vec<usize>),
}

impl Layout {
    /// Pairs each camera axis with a direction axis.
    pub fn paired(cameras: usize, directions: usize) -> Self {
        let mut order = Vec::new();
        for j in 0..cameras.max(directions) {
            order.extend((j < cameras).then_some(j));
            order.extend((j < directions).then_some(cameras + j));
        }
        Self::Train(order)
    }

    /// Lists the axes of each core of a tensor with this many ray axes.
    pub fn cores(&self, rays: usize) -> Vec<Vec<usize>> {
        match self {
            Self::Plain => vec![(0..rays + 2).collect()],
            Self::Train(order) => {
                let last = vec![rays, rays + 1];
                order.iter().map(|axis| vec![*axis]).chain([last]).collect()
            }
        }
    }

    /// Returns the number that stands for the layout: 0, or one more than the rank of the order among all
    /// orders sorted like words.
    pub fn code(&self) -> u8 {
        let Self::Train(order) = self else { return 0 };
        let smaller_after = |i: usize| order[i + 1..].iter().filter(|a| **a < order[i]).count();
        let rank = (0..order.len()).fold(0, |rank, i| rank * (order.len() - i) + smaller_after(i));
        1 + rank as u8
    }

    /// Finds the layout of `rays` ray axes, five at most, that `code` stands for; `None` if there is none.
    pub fn of_code(code: u8, rays: usize) -> Option<Self> {
        let Some(mut rank) = usize::from(code).checked_sub(1) else {
            return Some(Self::Plain);
        };
        let mut places: Vec<usize> = (1..=rays)
            .map(|left| {
                let place = rank % left;
                rank /= left;
                place
            })
            .collect();
        places.reverse();
        let mut left: Vec<usize> = (0..rays).collect();
        let order = places.iter().map(|place| left.remove(*place)).collect();
        (rank == 0).then_some(Self::Train(order))
    }
}

/// Rays that are multiplied together: their products with a core stay in a cache.
const RAYS: usize = 24;

impl Tensor {
    /// Evaluates [`Tensor::at`] at many `points` (parameters of all cameras and directions): the cores are made
    /// real once and multiplied by blocks of rays, so every integer is read once for a block, not for a ray.
    pub fn at_many(&self, points: &[&[f64]]) -> Vec<Vec<f64>> {
        self.many::<f64>(points)
    }

    /// Evaluates in single precision, as tables are read for pictures, in half the time: rounding adds 1e-7 or
    /// so of the largest coefficient.
    pub fn at_many_in_single(&self, points: &[&[f64]]) -> Vec<Vec<f64>> {
        self.many::<f32>(points)
    }

    fn many<T: Real>(&self, points: &[&[f64]]) -> Vec<Vec<f64>> {
        if self.layout == Layout::Plain {
            return points.par_iter().map(|x| self.at(x)).collect();
        }
        let cores = self.matrices::<T>(&vec![None; self.shape().len()]);
        let blocks = points.par_chunks(RAYS);
        let blocks = blocks.map(|points| self.block(&cores, points));
        blocks.collect::<Vec<_>>().concat()
    }

    /// Multiplies `cores` by the weights of `points`, from the first to the last: the rows that remain.
    fn block<T: Real>(&self, cores: &[OpenMatrix<T>], points: &[&[f64]]) -> Vec<Vec<f64>> {
        let shape = self.shape();
        let sets = points.iter().map(|x| self.variables.weights(&shape, x));
        let sets: Vec<Vec<TermWeights<T>>> = sets.collect();
        let axes = self.table_axes();
        let is_direction = |k: &usize| axes[*k][0] >= self.variables.cameras;
        let (last, rays) = (cores.len() - 1, 0..cores.len() - 1);
        let [first, after] = [
            rays.clone().find(is_direction),
            rays.clone().rfind(is_direction),
        ];
        // One row for each ray; from the first to the last direction one for each set of its weights.
        let mut rows = vec![T::ONE; points.len()];
        for k in rays {
            if Some(k) == first {
                rows = rows.repeat(sets[0].len());
            }
            let weights = |row: usize| &sets[row % points.len()][row / points.len()][axes[k][0]];
            let (core, count) = (&cores[k], rows.len() / cores[k].left);
            let mut weighted = Vec::with_capacity(rows.len() * weights(0).len());
            for (row, values) in rows.chunks_exact(core.left).enumerate() {
                put_products(values, weights(row), &mut weighted);
            }
            rows = product(&weighted, weighted.len() / count, &core.values);
            if Some(k) == after {
                let all = rows.chunks_exact(rows.len() / sets[0].len());
                rows = added(&all.map(<[T]>::to_vec).collect::<Vec<_>>());
            }
        }
        let rows = product(&rows, cores[last].left, &cores[last].values);
        let row = rows.chunks_exact(rows.len() / points.len());
        row.map(|row| row.iter().map(|x| x.to_f64()).collect())
            .collect()
    }
}

/// Appends each of `values` times each of `weights`, these running fastest.
fn put_products<T: Real>(values: &[T], weights: &[T], to: &mut Vec<T>) {
    for x in values {
        to.extend(weights.iter().map(|w| *x * *w));
    }
}

#[cfg(test)]
mod tests;
