//! Quantisation: coefficients → the smallest tensor that keeps the promise on the held-out rays.
//!
//! In: the polynomial of a box and its held-out rays. Out: its coefficients, as a tensor train or plain,
//! rounded with the coarsest step whose error keeps the promise. Steps are octaves in 32 parts.

use super::{
    Refiner,
    held_out::HeldOutRays,
    tensor_train::{best_layout, decompose},
};
use geofan_bundle::{Polynomial, StepSize, Tensor, Train};
use geofan_core::Stop;

/// Steps tried: this many, each the next coarser. The finest decides whether the box can be kept at
/// all, the coarsest is 15 octaves above.
const STEPS: i16 = 480;

/// Error that rounding all coefficients with the finest step may add, in units of an error that uses up
/// the promise: steps of `1/√n` of it for `n` coefficients add 0.3 of it. A box that
/// only holds with finer ones is so near its limit that its halves take fewer bytes (Ellis: 1 MB
/// against 5); coarser ones halve boxes that need not be.
const FINEST: f64 = 1.0;

/// The finest step as a share of the largest coefficient: so many bits a core has room for.
const ROOM: f64 = 1.6e-8;

/// The finest step in units of an error that uses up the promise, for any number of coefficients: most of
/// those of large patches round to zero and add nothing. The second is tried on whole spheres that do not
/// hold with the first: six faces take several times their bytes.
const FINE_ENOUGH: [f64; 2] = [0.005, 0.0025];

/// The step tried first: nearly all patches hold with it, and with the finest, which takes longest to try, it
/// is only found out that they do.
const LIKELY: i16 = 10;

/// Errors up to this, in units of the promise, tell by how much a step is too coarse; larger ones need
/// not grow as steps do.
const NEAR: f64 = 4.0;

/// Steps that usually double the error: more than an octave has, because truncation adds to the error of
/// rounding.
const USUAL: f64 = 44.0;

/// Singular values below this share of the finest step round to zero: their vectors would need an entry
/// that is more than half of their length. Of those a little above, most do as well (with 0.5 a quarter
/// of the floor has ranks of 400, of which 200 are left).
const NEGLIGIBLE: f64 = 1.0;

/// The largest ranks worth having: beyond the first plain coefficients are smaller, where they are tried.
const MOST_RANKS: [usize; 2] = [500, 1500];

/// The most coefficients for which rounding them one by one is tried: larger polynomials always take
/// fewer bytes as trains, and reading them at a ray takes as long as fitting them.
const MOST_PLAIN: f64 = 3e5;

/// Operations for each integer of a tensor that is read at the held-out rays.
const READING: usize = 500;

impl Refiner<'_> {
    /// Finds the smallest tensor of the polynomial that keeps the promise on the held-out rays.
    pub fn quantise(&self, polynomial: &Polynomial, held_out: &HeldOutRays<'_>) -> Option<Tensor> {
        if !polynomial.is_finite() {
            return None;
        }
        let unit = self.plan.max_error / held_out.weight();
        let finest = finest(polynomial, unit, held_out.on_sphere());
        self.smallest(polynomial, &finest, |tensor| held_out.error(tensor, unit))
    }

    /// Finds the smallest tensor of the polynomial that tells where an edge is, whose `error` must be at most 1; one of
    /// `unit` is as large as that.
    pub fn quantise_place(
        &self,
        polynomial: &Polynomial,
        unit: f64,
        error: impl Fn(&Tensor) -> f64,
    ) -> Option<Tensor> {
        self.smallest(polynomial, &finest(polynomial, unit, false), error)
    }

    /// Returns the smaller of the tensor train and the plain coefficients, each rounded as coarsely as the
    /// `error`, in units of the promise, allows, from the first of the `finest` steps that does.
    fn smallest(
        &self,
        polynomial: &Polynomial,
        finest: &[f64],
        error: impl Fn(&Tensor) -> f64,
    ) -> Option<Tensor> {
        let count = polynomial.coefficients.len() as f64;
        let stop = self.tally.stop();
        let layout = best_layout(polynomial, stop)?;
        let most_rank = MOST_RANKS[usize::from(count > MOST_PLAIN)];
        let train = finest.iter().find_map(|finest| {
            let threshold = (NEGLIGIBLE * finest, most_rank);
            let train = decompose(polynomial, layout.clone(), threshold, stop)?;
            coarsest(&train, *finest, &error, stop)
        });
        if count > MOST_PLAIN {
            return train.map(|(_, tensor)| tensor);
        }
        let plain = Train::plain(polynomial);
        if stop.told() {
            return None;
        }
        let Some((step, train)) = train else {
            return Some(coarsest(&plain, finest[0], &error, stop)?.1);
        };
        // At the same step plain coefficients round more often: if they are larger all the same,
        // there is no need to try them.
        let bytes = train.bytes();
        let promising = plain.rounded(step).is_some_and(|t| t.bytes() < bytes);
        let plain = promising
            .then(|| coarsest(&plain, finest[0], &error, stop))
            .flatten();
        match plain {
            Some((_, plain)) if plain.bytes() < bytes => Some(plain),
            _ => Some(train),
        }
    }
}

/// Lists the finest steps worth trying, where `unit` is an error that uses up the promise.
fn finest(polynomial: &Polynomial, unit: f64, on_sphere: bool) -> Vec<f64> {
    let usual = FINEST / (polynomial.coefficients.len() as f64).sqrt();
    let room = ROOM * largest(polynomial);
    let mut finest = FINE_ENOUGH
        .map(|share| (unit * share.max(usual)).max(room))
        .to_vec();
    finest.truncate(if on_sphere { 2 } else { 1 });
    finest.dedup();
    finest
}

/// Rounds `train` with the coarsest of the steps whose error keeps the promise; `None` if none does, or when it is
/// stopped.
fn coarsest(
    train: &Train,
    finest: f64,
    error: &impl Fn(&Tensor) -> f64,
    stop: &Stop,
) -> Option<(StepSize, Tensor)> {
    coarsest_kept(|k| {
        let step = StepSize::near(finest).coarser(k);
        let tensor = train.rounded_while(step, stop)?;
        // Its cores are made real, and then multiplied by rays.
        if !stop.goes_on(READING * tensor.integers()) {
            return None;
        }
        Some((error(&tensor), (step, tensor)))
    })
}

/// Finds the coarsest step that keeps the promise and returns its result, where `tried` gives the error and
/// the result of a step by its number: rounding more coarsely is hardly ever better.
fn coarsest_kept<T>(tried: impl Fn(i16) -> Option<(f64, T)>) -> Option<T> {
    let keeping = |found: &(f64, T)| found.0 <= 1.0;
    let (mut keeps, mut misses, mut best) = match tried(LIKELY) {
        Some((error, found)) if error <= 1.0 => ((LIKELY, error), (STEPS, f64::INFINITY), found),
        missed => {
            let (error, found) = tried(0).filter(keeping)?;
            let missed = missed.map_or(f64::INFINITY, |(error, _)| error);
            ((0, error), (LIKELY, missed), found)
        }
    };
    let mut kept_count = 1;
    while misses.0 - keeps.0 > 1 {
        let k = match misses.1 <= NEAR {
            true => between(keeps, misses),
            false => beyond(keeps, kept_count).min(i16::midpoint(keeps.0, misses.0)),
        };
        match tried(k) {
            Some((error, found)) if error <= 1.0 => {
                (best, keeps) = (found, (k, error));
                kept_count += 1;
            }
            found => misses = (k, found.map_or(f64::INFINITY, |(error, _)| error)),
        }
    }
    Some(best)
}

/// Chooses a step between one that keeps the promise and one that does not, each with its error: where a
/// power law between them meets the promise.
fn between(keeps: (i16, f64), misses: (i16, f64)) -> i16 {
    let share = (1.0 / keeps.1).ln() / (misses.1 / keeps.1).ln();
    let steps = (share * f64::from(misses.0 - keeps.0)) as i16;
    (keeps.0 + steps).clamp(keeps.0 + 1, misses.0 - 1)
}

/// Chooses a step after `tried` ones that keep the promise, the last with its error, while none is known
/// that nearly does: farther each time, in case errors grow more slowly than they usually do.
fn beyond(keeps: (i16, f64), tried: i16) -> i16 {
    let steps = USUAL * (1.0 / keeps.1).log2() * f64::from(tried);
    keeps.0.saturating_add((steps as i16).max(1))
}

/// Returns the size of the largest coefficient.
fn largest(polynomial: &Polynomial) -> f64 {
    polynomial
        .coefficients
        .iter()
        .fold(0.0, |a, c| a.max(c.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn the_last_step_that_keeps_the_promise_is_found_in_few_trials() {
        for (floor, crossing) in [(0.3, 154.0), (0.9, 301.0), (0.01, 6.4)] {
            let trials = Cell::new(0);
            let found = coarsest_kept(|k| {
                trials.set(trials.get() + 1);
                let rounding = 2_f64.powf((f64::from(k) - crossing) / 32.0);
                Some((floor + (1.0 - floor) * rounding, k))
            });
            assert_eq!(found, Some(crossing as i16));
            // The finest step is tried besides.
            assert!(trials.get() <= 14, "{trials:?}");
        }
    }
}
