//! The size of moving pictures, from the times that pictures took.
//!
//! In: the pixels and the seconds of each picture drawn while the camera moved. Out: the size of the next, so
//! that it takes about [`WANTED`]. A picture takes a time that its size does not change (the table is fixed to
//! the camera), and one for each pixel; both are read from the times of pictures of different sizes. Sizes come
//! in steps, and a larger one is taken only with room to spare, so that the picture does not flicker between
//! two.

/// Seconds that a moving picture should take: thirty a second.
const WANTED: f64 = 0.033;

/// Where the time that no size changes is more than a share of that, a picture may take so many times as long:
/// a smaller one would look worse and hardly be sooner.
const OVER_FIXED: f64 = 2.0;

/// Shares of the display's sides that are drawn. Finer steps would change more often and show no more.
const STEPS: [f64; 8] = [1.0, 0.75, 0.5, 0.375, 0.25, 0.1875, 0.125, 0.09375];

/// A larger size is taken when it is expected to take at most this share of the wanted time, a smaller one
/// when the present takes more than the other.
const ROOM: [f64; 2] = [0.85, 1.2];

/// Weight of the newest time in the means: a single slow picture (another program's work) moves them little.
const NEWEST: f64 = 0.3;

/// Sizes tell the two times apart when their deviation is at least this share of their mean.
const APART: f64 = 0.1;

/// Seconds a pixel from which on a large block of a still picture, 31,000 pixels, takes longer than an event may wait;
/// below it small blocks would cost their margins for nothing. Usual spaces take a hundredth, the figure-eight knot's
/// complement forty times as long (on two cores, without a table).
const SLOW: f64 = 1e-5;

/// Pixels of the first picture of a kind, of which nothing is known: it appears at once on usual machines.
const FIRST: f64 = 320.0 * 180.0;

/// Running means of pixels `x`, seconds `y`, `x²` and `xy`.
#[derive(Debug, Clone, Copy)]
struct Means {
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
}

/// Chooses the size of moving pictures.
#[derive(Debug, Clone, Default)]
pub struct ResolutionControl {
    means: Option<Means>,
    /// Seconds that no size changes.
    fixed: f64,
    step: Option<usize>,
}

impl ResolutionControl {
    /// Takes note that a picture of `pixels` took `seconds`.
    pub fn observe(&mut self, pixels: usize, seconds: f64) {
        if pixels == 0 || !seconds.is_finite() || seconds < 0.0 {
            return;
        }
        let (x, y) = (pixels as f64, seconds);
        let now = Means {
            x,
            y,
            xx: x * x,
            xy: x * y,
        };
        let means = self.means.map_or(now, |known| {
            let towards = |from: f64, to: f64| from + NEWEST * (to - from);
            Means {
                x: towards(known.x, now.x),
                y: towards(known.y, now.y),
                xx: towards(known.xx, now.xx),
                xy: towards(known.xy, now.xy),
            }
        });
        self.means = Some(means);
        let variance = means.xx - means.x * means.x;
        if variance > (APART * means.x).powi(2) {
            let slope = (means.xy - means.x * means.y) / variance;
            self.fixed = means.y - slope.clamp(0.0, means.y / means.x) * means.x;
        }
        self.fixed = self.fixed.min(means.y);
    }

    /// Forgets what is known: another way of drawing costs something else.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Tells whether a pixel takes so long that still pictures must be drawn in small blocks.
    pub fn is_slow(&self) -> bool {
        self.means
            .is_some_and(|means| means.y > SLOW * means.x + self.fixed)
    }

    /// Returns the seconds that a picture of `pixels` is expected to take.
    fn expected(&self, pixels: f64) -> Option<f64> {
        let means = self.means?;
        Some(self.fixed + (means.y - self.fixed) * pixels / means.x)
    }

    /// Returns the size of the next moving picture on a display of `width` × `height`.
    pub fn size(&mut self, (width, height): (usize, usize)) -> (usize, usize) {
        let pixels = |step: usize| (width * height) as f64 * STEPS[step] * STEPS[step];
        let last = STEPS.len() - 1;
        let wanted = WANTED.max(OVER_FIXED * self.fixed);
        let takes = |step: usize| self.expected(pixels(step));
        let fits = |step: usize, room: f64| takes(step) <= Some(room * wanted);
        let mut step = match (self.step, self.means) {
            (Some(step), _) => step,
            // The first known time decides at once.
            (None, Some(_)) => (0..last).find(|s| fits(*s, 1.0)).unwrap_or(last),
            (None, None) => (0..last).find(|s| pixels(*s) <= FIRST).unwrap_or(last),
        };
        if self.means.is_some() {
            while step < last && !fits(step, ROOM[1]) {
                step += 1;
            }
            while step > 0 && fits(step - 1, ROOM[0]) {
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
        let wobble =
            |k: usize| 1.15e-7 * (1.0 + 0.1 * if k.is_multiple_of(2) { 1.0 } else { -1.0 });
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
    fn where_every_picture_takes_a_time_of_its_own_the_smallest_is_not_chosen_in_vain() {
        let mut control = ResolutionControl::default();
        let mut widths = Vec::new();
        for _ in 0..40 {
            let (w, h) = control.size((640, 360));
            control.observe(w * h, 0.06 + 1e-7 * (w * h) as f64);
            widths.push(w);
        }
        assert!(widths[10..].iter().all(|w| *w == 640), "{widths:?}");
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
