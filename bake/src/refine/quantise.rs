//! Coefficients → the smallest tensor that keeps the promise on the held-out rays.

use super::{
    ROTATION_SHARE, Refiner,
    decompose::decompose,
    held_out::{HeldOut, Quantity},
};
use geofan::bundle::{Patch, Polynomial, Scale, Tensor, Train};

/// Quantisation steps tried: this many, each √2 of the one before. The finest decides whether the
/// box can be kept at all.
const STEPS: i32 = 36;

/// The finest step, in units of an error that uses up the promise. Rounding with it must add next to
/// nothing even where ten thousand coefficients do, because they belong to what lies beyond an exit:
/// with 0.02 Sol took 40 MB instead of half of one.
const FINEST: f64 = 5e-4;

/// A step that changes nothing, as a share of the largest coefficient.
const UNROUNDED: f64 = 1e-7;

/// The finest step as a share of the largest coefficient: so many bits a core has room for.
const ROOM: f64 = 4e-9;

/// Singular values below this share of the finest step round to zero.
const NEGLIGIBLE: f64 = 0.5;

impl Refiner<'_> {
    /// The smallest patch of the polynomials that keeps the promise on the held-out rays.
    pub fn quantise(
        &self,
        displacement: &Polynomial,
        rotation: &Polynomial,
        held_out: &HeldOut,
    ) -> Option<Patch> {
        if !displacement.is_finite() || !rotation.is_finite() {
            return None;
        }
        let promise = self.plan.max_error;
        let displacement = self.smallest(
            displacement,
            promise / held_out.weight(self.space),
            |tensor| held_out.holds(self, tensor, Quantity::Screen, promise),
        )?;
        let limit = ROTATION_SHARE * promise;
        let rotation = match self.plan.frames {
            false => None,
            // A quaternion turns by twice the angle.
            true => Some(self.smallest(rotation, 0.5e-3 * limit, |tensor| {
                held_out.holds(self, tensor, Quantity::Rotation, limit)
            })?),
        };
        Some(Patch {
            displacement,
            rotation,
        })
    }

    /// Whether the displacement holds in the first half of the arc lengths, hardly rounded.
    pub fn holds_early(&self, displacement: &Polynomial, held_out: &HeldOut) -> bool {
        let plain = Train::plain(&displacement.0, self.space.cameras().len());
        let tensor = plain.rounded(Scale::near(UNROUNDED * largest(displacement)));
        let promise = self.plan.max_error;
        let holds = |tensor| held_out.holds_early(self, &tensor, Quantity::Screen, promise);
        tensor.is_some_and(holds)
    }

    /// The smaller of the tensor train and the plain coefficients, each rounded as coarsely as
    /// `holds` allows; `unit` is an error that uses up the promise.
    fn smallest(
        &self,
        polynomial: &Polynomial,
        unit: f64,
        holds: impl Fn(&Tensor) -> bool,
    ) -> Option<Tensor> {
        let cameras = self.space.cameras().len();
        let finest = (FINEST * unit).max(ROOM * largest(polynomial));
        let threshold = NEGLIGIBLE * finest;
        let plain = Train::plain(&polynomial.0, cameras);
        let Some(train) = decompose(&polynomial.0, cameras, threshold) else {
            return Some(coarsest(&plain, finest, &holds)?.1);
        };
        let (step, train) = coarsest(&train, finest, &holds)?;
        // At the same step plain coefficients round more often: if they are larger all the same,
        // there is no need to try them.
        let promising = plain
            .rounded(step)
            .is_some_and(|t| t.bytes() < train.bytes());
        let plain = promising
            .then(|| coarsest(&plain, finest, &holds))
            .flatten();
        match plain {
            Some((_, plain)) if plain.bytes() < train.bytes() => Some(plain),
            _ => Some(train),
        }
    }
}

/// `train` rounded with the coarsest of the steps that `holds`, by bisection: rounding more coarsely
/// is hardly ever better.
fn coarsest(
    train: &Train,
    finest: f64,
    holds: &impl Fn(&Tensor) -> bool,
) -> Option<(Scale, Tensor)> {
    let rounded = |k: i32| {
        let step = Scale::near(finest * 2_f64.powf(0.5 * f64::from(k)));
        let tensor = train.rounded(step).filter(holds)?;
        Some((step, tensor))
    };
    let mut best = rounded(0)?;
    let (mut low, mut high) = (0, STEPS);
    while high - low > 1 {
        let middle = (low + high) / 2;
        match rounded(middle) {
            Some(found) => (best, low) = (found, middle),
            None => high = middle,
        }
    }
    Some(best)
}

/// The size of the largest coefficient.
fn largest(polynomial: &Polynomial) -> f64 {
    polynomial.0.iter().fold(0.0, |a, c| a.max(c.abs()))
}
