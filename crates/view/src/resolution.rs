//! The size of moving pictures, from the times that pictures took.
//!
//! In: the pixels and the seconds of each picture drawn while the camera moved. Out: the size of the next, so
//! that it takes about [`WANTED`]. Sizes come in steps, and a larger one is taken only with room to spare, so
//! that the picture does not flicker between two.

/// Seconds that a moving picture should take: thirty a second.
const WANTED: f64 = 0.033;

/// Shares of the display's sides that are drawn. Finer steps would change more often and show no more.
const STEPS: [f64; 8] = [1.0, 0.75, 0.5, 0.375, 0.25, 0.1875, 0.125, 0.09375];

/// A larger size is taken when it is expected to take at most this share of the wanted time, a smaller one
/// when the present takes more than the other.
const ROOM: [f64; 2] = [0.85, 1.2];

/// Weight of the newest time in the mean: a single slow picture (another program's work) moves it little.
const NEWEST: f64 = 0.4;

/// Pixels of the very first picture, of which nothing is known: it appears at once on any machine.
const FIRST: f64 = 320.0 * 180.0;

/// Chooses the size of moving pictures.
#[derive(Debug, Clone, Default)]
pub struct ResolutionControl {
    /// Seconds a pixel.
    cost: Option<f64>,
    step: Option<usize>,
}

impl ResolutionControl {
    /// Takes note that a picture of `pixels` took `seconds`.
    pub fn observe(&mut self, pixels: usize, seconds: f64) {
        if pixels == 0 || !seconds.is_finite() || seconds < 0.0 {
            return;
        }
        let cost = seconds / pixels as f64;
        self.cost = Some(match self.cost {
            None => cost,
            Some(known) => known + NEWEST * (cost - known),
        });
    }

    /// Forgets what is known: another way of drawing costs something else.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Returns the size of the next moving picture on a display of `width` × `height`.
    pub fn size(&mut self, (width, height): (usize, usize)) -> (usize, usize) {
        let whole = (width * height) as f64;
        let expected = |step: usize| {
            self.cost
                .map(|cost| cost * whole * STEPS[step] * STEPS[step])
        };
        let last = STEPS.len() - 1;
        let mut step = match (self.step, self.cost) {
            (Some(step), _) => step,
            // The first known time decides at once.
            (None, Some(_)) => (0..last)
                .find(|s| expected(*s) <= Some(WANTED))
                .unwrap_or(last),
            (None, None) => (0..last)
                .find(|s| whole * STEPS[*s] * STEPS[*s] <= FIRST)
                .unwrap_or(last),
        };
        if self.cost.is_some() {
            while step < last && expected(step) > Some(ROOM[1] * WANTED) {
                step += 1;
            }
            while step > 0 && expected(step - 1) <= Some(ROOM[0] * WANTED) {
                step -= 1;
            }
            self.step = Some(step);
        }
        let side = |length: usize| ((length as f64 * STEPS[step]).round() as usize).max(1);
        (side(width), side(height))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Draws pictures on a machine of so many seconds a pixel; returns their sizes.
    fn run(control: &mut ResolutionControl, cost: impl Fn(usize) -> f64, n: usize) -> Vec<usize> {
        let mut widths = Vec::new();
        for k in 0..n {
            let (w, h) = control.size((1280, 720));
            control.observe(w * h, cost(k) * (w * h) as f64);
            widths.push(w);
        }
        widths
    }

    #[test]
    fn a_slow_machine_gets_small_pictures_and_a_fast_one_whole_ones() {
        let fast = run(&mut ResolutionControl::default(), |_| 2e-8, 10);
        assert_eq!(fast[9], 1280);
        let slow = run(&mut ResolutionControl::default(), |_| 1e-6, 10);
        assert_eq!(slow[9], 240);
        let middle = run(&mut ResolutionControl::default(), |_| 1e-7, 10);
        assert_eq!(middle[9], 640);
    }

    #[test]
    fn the_size_settles_though_times_vary_by_a_tenth() {
        let wobble = |k: usize| 1.15e-7 * (1.0 + 0.1 * if k % 2 == 0 { 1.0 } else { -1.0 });
        let widths = run(&mut ResolutionControl::default(), wobble, 60);
        assert!(widths[5..].windows(2).all(|w| w[0] == w[1]), "{widths:?}");
    }

    #[test]
    fn a_machine_that_becomes_busy_and_free_again_is_followed() {
        let mut control = ResolutionControl::default();
        let free = run(&mut control, |_| 3e-8, 10)[9];
        let busy = run(&mut control, |_| 4e-7, 10)[9];
        let again = run(&mut control, |_| 3e-8, 20)[19];
        assert!(busy < free && again == free, "{free} {busy} {again}");
    }

    #[test]
    fn nonsense_is_not_taken_for_a_time() {
        let mut control = ResolutionControl::default();
        control.observe(0, 1.0);
        control.observe(10, f64::NAN);
        control.observe(10, -1.0);
        assert_eq!(control.size((320, 180)), (320, 180));
        assert_eq!(control.size((1, 1)), (1, 1));
    }
}
