//! Expressions over the chart that a user gives besides the space itself: where cameras may be, curves, and functions
//! of a point.
//!
//! In: expressions of parameters, of a curve's one parameter, or of the coordinates; all may name the manifold's own
//! parameters. Out: [`CameraRegion`], 0 to 3 parameters in intervals mapped to chart points ([`CameraRegion::at`])
//! and back ([`CameraRegion::locate`]); [`ChartCurve`], point and velocity at any parameter, the velocity exact;
//! [`PointFunctions`], the values of what a scene gives as numbers of the point: velocities, temperatures.

use super::Manifold;
use geofan_expr::{
    Direction, Graph, Tape,
    parse::{Binding, ExpressionError, Scope, parse},
};
use glam::DVec3;

/// A region of camera positions.
#[derive(Debug, Clone)]
pub struct CameraRegion {
    /// The names of the parameters.
    pub names: Vec<String>,
    /// Their intervals.
    pub intervals: Vec<[f64; 2]>,
    /// Whether the file says where cameras may be. Otherwise they may be anywhere within the limits of the
    /// coordinates, or, with a group, at its identity.
    pub written: bool,
    /// parameters -> u (3), then ∂u/∂parameter (3 for each parameter).
    pub(super) map: Tape,
}

/// Distance outside its interval, as a share of it, at which a parameter is still taken as on
/// the edge: rounding in the inverse map, far below any promise of accuracy.
const EDGE: f64 = 1e-9;

impl CameraRegion {
    /// The number of parameters.
    pub fn dimension(&self) -> usize {
        self.names.len()
    }

    /// The chart point at `parameters`.
    pub fn at(&self, parameters: &[f64]) -> DVec3 {
        DVec3::from_slice(&self.map.at(parameters)[..3])
    }

    /// The parameters at the fractions `t` in [0, 1] of their intervals.
    pub fn lerp(&self, t: &[f64]) -> Vec<f64> {
        self.intervals
            .iter()
            .zip(t)
            .map(|([low, high], t)| low + (high - low) * t)
            .collect()
    }

    /// Returns whether `parameters` lie in their intervals.
    pub fn contains(&self, parameters: &[f64]) -> bool {
        parameters
            .iter()
            .zip(&self.intervals)
            .all(|(p, [low, high])| {
                let slack = EDGE * (high - low);
                (low - slack..=high + slack).contains(p)
            })
    }

    /// The parameters whose point is `u`, by Gauss–Newton from several starts; `None` if `u` is not
    /// in the region. The point found agrees with `u` to a relative 1e-9.
    pub fn locate(&self, u: DVec3) -> Option<Vec<f64>> {
        self.locate_by(u, |u, _| u)
    }

    /// Finds the parameters at whose point `value` is `u`; from a point and changes of it, `value`
    /// makes its own there, and its changes in their place.
    pub fn locate_by(
        &self,
        u: DVec3,
        value: impl Fn(DVec3, &mut [DVec3]) -> DVec3,
    ) -> Option<Vec<f64>> {
        let scale = self.size() + u.length() * 1e-3;
        let starts = (0..if self.dimension() == 0 { 1 } else { 27 })
            .map(|i: usize| [i % 3, i / 3 % 3, i / 9].map(|d| [0.5, 0.1, 0.9][d]));
        starts
            .map(|t| self.descend(u, &value, self.lerp(&t[..self.dimension()])))
            .find(|p| {
                (value(self.at(p), &mut []) - u).length() <= 1e-9 * scale.max(f64::MIN_POSITIVE)
                    && self.contains(p)
            })
            .map(|p| self.clamped(p))
    }

    /// The parameters nearest to `u` in the chart that are found by descent from the parameters `from`.
    pub fn nearest(&self, u: DVec3, from: Vec<f64>) -> Vec<f64> {
        self.clamped(self.descend(u, &|u, _| u, from))
    }

    fn clamped(&self, mut parameters: Vec<f64>) -> Vec<f64> {
        for (p, [low, high]) in parameters.iter_mut().zip(&self.intervals) {
            *p = p.clamp(*low, *high);
        }
        parameters
    }

    /// The extent of the region in the chart, from its corners and middle.
    fn size(&self) -> f64 {
        let middle = self.at(&self.lerp(&[0.5; 3]));
        (0..8)
            .map(|i| [i & 1, i >> 1 & 1, i >> 2 & 1].map(|i: usize| i as f64))
            .map(|t| (self.at(&self.lerp(&t)) - middle).length())
            .fold(0.0, f64::max)
    }

    fn descend(
        &self,
        u: DVec3,
        value: &impl Fn(DVec3, &mut [DVec3]) -> DVec3,
        mut p: Vec<f64>,
    ) -> Vec<f64> {
        let k = self.dimension();
        for _ in 0..60 {
            let o = self.map.at(&p);
            let mut columns: Vec<DVec3> =
                (0..k).map(|j| DVec3::from_slice(&o[3 + 3 * j..])).collect();
            let residual = u - value(DVec3::from_slice(&o[..3]), &mut columns);
            let Some(step) = least_squares(&columns, residual) else {
                break;
            };
            for ((p, d), [low, high]) in p.iter_mut().zip(&step).zip(&self.intervals) {
                let width = high - low;
                *p = (*p + d.clamp(-width, width)).clamp(low - EDGE * width, high + EDGE * width);
            }
            if residual.length() == 0.0 {
                break;
            }
        }
        p
    }
}

/// The `x` that minimises |Σ x_j columns_j − b|, by modified Gram–Schmidt; `None` when the columns
/// are dependent.
fn least_squares(columns: &[DVec3], b: DVec3) -> Option<Vec<f64>> {
    let n = columns.len();
    let mut q: Vec<DVec3> = Vec::new();
    let mut r = [[0.0; 3]; 3];
    for (j, &column) in columns.iter().enumerate() {
        let mut rest = column;
        for (i, qi) in q.iter().enumerate() {
            r[i][j] = qi.dot(rest);
            rest -= *qi * r[i][j];
        }
        r[j][j] = rest.length();
        if !(r[j][j] > 1e-14 * column.length()) {
            return None;
        }
        q.push(rest / r[j][j]);
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| r[i][j] * x[j]).sum();
        x[i] = (q[i].dot(b) - known) / r[i][i];
    }
    Some(x)
}

/// A curve `t -> u(t)`.
#[derive(Debug, Clone)]
pub struct ChartCurve {
    /// t -> u (3), u̇ (3).
    tape: Tape,
}

impl ChartCurve {
    /// The curve whose coordinates are `components`, expressions of `parameter` and of the parameters
    /// of `manifold` (as set); `parameter` hides one of the same name.
    ///
    /// # Errors
    /// A component's index (0 to 2) and what is wrong with it.
    pub fn parse(
        manifold: &Manifold,
        parameter: &str,
        components: [&str; 3],
    ) -> Result<Self, (usize, ExpressionError)> {
        let (mut graph, mut scope) = (Graph::new(), Scope::default());
        for (name, value) in &manifold.parameters {
            scope.bind(name, Binding::fixed(graph.constant(*value)));
        }
        scope.bind(parameter, Binding::fixed(graph.input(0)));
        let mut outputs = Vec::new();
        for (i, text) in components.iter().enumerate() {
            outputs.push(parse(text, &scope, &mut graph).map_err(|e| (i, e))?.node);
        }
        let mut along = Direction::of_input(&mut graph, 0);
        for i in 0..3 {
            outputs.push(graph.derivative(outputs[i], &mut along));
        }
        let too_large = |e: geofan_expr::TapeTooLarge| {
            let whole = 0..components[0].len();
            (0, ExpressionError::new(whole, e.to_string()))
        };
        let tape = Tape::compile(&graph, &outputs, 1).map_err(too_large)?;
        Ok(Self { tape })
    }

    /// Point and velocity at `t`, chart components.
    pub fn at(&self, t: f64) -> (DVec3, DVec3) {
        let o = self.tape.at(&[t]);
        (DVec3::from_slice(&o[..3]), DVec3::from_slice(&o[3..]))
    }
}

/// Evaluates expressions of the chart point.
#[derive(Debug, Clone)]
pub struct PointFunctions {
    tape: Tape,
}

impl PointFunctions {
    /// Reads `texts`, expressions of the coordinates and the parameters of `manifold` (as set).
    ///
    /// # Errors
    /// The index of a text and what is wrong with it.
    pub fn parse(manifold: &Manifold, texts: &[&str]) -> Result<Self, (usize, ExpressionError)> {
        let (mut graph, mut scope) = (Graph::new(), Scope::default());
        for (name, value) in &manifold.parameters {
            scope.bind(name, Binding::fixed(graph.constant(*value)));
        }
        for (k, name) in manifold.coordinates.iter().enumerate() {
            scope.bind(name, Binding::fixed(graph.input(k as u32)));
        }
        let mut outputs = Vec::new();
        for (i, text) in texts.iter().enumerate() {
            outputs.push(parse(text, &scope, &mut graph).map_err(|e| (i, e))?.node);
        }
        let too_large = |e: geofan_expr::TapeTooLarge| {
            let whole = 0..texts.first().map_or(0, |text| text.len());
            (0, ExpressionError::new(whole, e.to_string()))
        };
        let tape = Tape::compile(&graph, &outputs, 3).map_err(too_large)?;
        Ok(Self { tape })
    }

    /// Computes the values at `u`, in the order of the texts.
    pub fn at(&self, u: DVec3) -> Vec<f64> {
        self.tape.at(&u.to_array())
    }

    /// Computes the values at many points, a row for each, at a fraction of the cost.
    pub fn at_each(&self, points: impl ExactSizeIterator<Item = DVec3>) -> Vec<f64> {
        self.tape.at_each(points.map(|u| u.to_array()))
    }
}
