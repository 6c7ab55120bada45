//! Sixteen samples at once: the pixel step.
//!
//! In: a tile's ribbon and endings, and how each sample's path comes from its sixteen ([`Mixing`]).
//! Out: what each sample sees.

use super::{
    accel::PacketHits,
    curve::Ending,
    intersect::Hit,
    lanes::{LANES, Lanes, Points, SingleLanes, each, each_point, lane, range},
    outcome::{Seen, beyond},
    ribbon::{Ribbon, RibbonChord},
    sheaf::{Sheaf, Spread, shifted},
    world::World,
};
use glam::{DVec2, Vec3};

/// How the paths of sixteen samples come from the sixteen of a sheaf: the weights of each path, for
/// all samples. In single precision, which is enough for differences between neighbours.
pub struct Mixing(Box<[SingleLanes; LANES]>);

impl Mixing {
    /// Bicubic weights of 4 × 4 paths at even spacing, at places in the tile as fractions of its
    /// side.
    #[inline(always)]
    pub fn bicubic(places: &[DVec2; LANES]) -> Self {
        let x = cubic_lanes(|l| places[l].x);
        let y = cubic_lanes(|l| places[l].y);
        let mut weights = Box::new([[0.0; LANES]; LANES]);
        for i in 0..LANES {
            for l in 0..LANES {
                weights[i][l] = x[i % 4][l] * y[i / 4][l];
            }
        }
        Self(weights)
    }

    #[inline(always)]
    fn mix(&self, values: &Lanes) -> Lanes {
        let spread = Spread::of(&[*values, [0.0; LANES], [0.0; LANES]]);
        self.mix_points(&spread)[0]
    }

    /// The points of the sixteen samples. The weights sum to 1, so only differences need them.
    #[inline(always)]
    pub fn mix_points(&self, spread: &Spread) -> Points {
        let mut sums = [[0.0; LANES]; 3];
        for (i, weights) in self.0.iter().enumerate() {
            for c in 0..3 {
                let difference = spread.differences[c][i];
                for l in 0..LANES {
                    sums[c][l] += weights[l] * difference;
                }
            }
        }
        each_point(|c, l| spread.middle[c] + f64::from(sums[c][l]))
    }
}

/// Lagrange's cubic weights at `t` for nodes 0, 1/3, 2/3, 1.
#[inline(always)]
pub fn cubic(t: f64) -> [f64; 4] {
    let (a, b, c, d) = (t, t - 1.0 / 3.0, t - 2.0 / 3.0, t - 1.0);
    [
        -4.5 * b * c * d,
        13.5 * a * c * d,
        -13.5 * a * b * d,
        4.5 * a * b * c,
    ]
}

/// [`cubic`] in every lane.
#[inline(always)]
fn cubic_lanes(t: impl Fn(usize) -> f64) -> [SingleLanes; 4] {
    let mut weights = [[0.0; LANES]; 4];
    for l in 0..LANES {
        let w = cubic(t(l));
        for i in 0..4 {
            weights[i][l] = w[i] as f32;
        }
    }
    weights
}

/// What the samples of a tile have in common.
pub struct Target<'a> {
    world: &'a World,
    ribbon: &'a Ribbon,
    /// The exit of all.
    exit: Option<usize>,
    limits: Lanes,
    skies: Spread,
}

/// The first hits of sixteen paths.
struct Found {
    /// Arc lengths of the hits; of the endings where there are none.
    s: Lanes,
    hit: [bool; LANES],
    triangle: [u64; LANES],
    weights: [Lanes; 2],
    tangent: Points,
}

impl<'a> Target<'a> {
    /// The paths of `sheaf` must share their exit.
    pub fn new(world: &'a World, sheaf: &Sheaf<'_>, ribbon: &'a Ribbon) -> Self {
        Self {
            world,
            ribbon,
            exit: sheaf.exit().flatten(),
            limits: sheaf.limits(),
            skies: Spread::of(&sheaf.skies()),
        }
    }

    /// What sixteen samples see.
    #[inline(always)]
    pub fn seen(&self, mixing: &Mixing) -> [Seen; LANES] {
        // An infinite limit times a weight is no number.
        let limits = match self.exit {
            Some(_) => mixing.mix(&self.limits),
            None => [f64::INFINITY; LANES],
        };
        let found = self.first_hits(mixing, &limits);
        let sky = mixing.mix_points(&self.skies);
        let mut seen = [Seen::Nothing; LANES];
        for l in 0..LANES {
            seen[l] = match (found.hit[l], self.exit) {
                (true, _) => Seen::Surface(found.hit(l)),
                (false, Some(exit)) => Seen::Sky {
                    exit: exit as u32,
                    s: found.s[l],
                    direction: lane(&sky, l).as_vec3().normalize_or_zero(),
                },
                (false, None) => Seen::Nothing,
            };
        }
        seen
    }

    /// What sixteen samples see whose paths end each in its own way.
    #[inline(always)]
    pub fn seen_before(&self, mixing: &Mixing, endings: &[Ending; LANES]) -> [Seen; LANES] {
        let limits = each(|l| endings[l].limit());
        let found = self.first_hits(mixing, &limits);
        let mut seen = [Seen::Nothing; LANES];
        for l in 0..LANES {
            seen[l] = match found.hit[l] {
                true => Seen::Surface(found.hit(l)),
                false => beyond(&endings[l]),
            };
        }
        seen
    }

    #[inline(always)]
    fn first_hits(&self, mixing: &Mixing, limits: &Lanes) -> Found {
        let mut found = Found {
            s: *limits,
            hit: [false; LANES],
            triangle: [0; LANES],
            weights: [[0.0; LANES]; 2],
            tangent: [[0.0; LANES]; 3],
        };
        // The ends of the chord before, which are often needed again.
        let mut known: [Option<(usize, Points)>; 2] = [None, None];
        for chord in &self.ribbon.chords {
            let ends = [chord.from, chord.from + 1].map(|v| {
                let again = known.iter().flatten().find(|(k, _)| *k == v);
                again.map_or_else(|| mixing.mix_points(self.ribbon.point(v)), |(_, p)| *p)
            });
            known = [Some((chord.from, ends[0])), Some((chord.from + 1, ends[1]))];
            let s = [chord.from, chord.from + 1].map(|v| self.ribbon.vertices[v].s);
            let share = 1.0 / (s[1] - s[0]);
            let most = each(|l| ((found.s[l] - s[0]) * share).min(1.0));
            if range(&most)[1] < 0.0 {
                break;
            }
            let [a, b] = ends.map(|p| shifted(&p, chord.shift));
            let roots = self.ribbon.roots(chord);
            let hits = self.world.accelerator.first_hits(roots, &a, &b, &most);
            if range(&hits.t)[0] < f64::INFINITY {
                self.keep(mixing, chord, &hits, &mut found);
            }
        }
        found
    }

    /// Takes over the hits of one chord, which are nearer than what was known.
    #[inline(always)]
    fn keep(&self, mixing: &Mixing, chord: &RibbonChord, hits: &PacketHits, found: &mut Found) {
        let [from, to] = [chord.from, chord.from + 1].map(|v| &self.ribbon.vertices[v]);
        let [v0, v1] = [from, to].map(|v| mixing.mix_points(&v.tangent));
        for l in 0..LANES {
            let t = hits.t[l];
            if t < f64::INFINITY {
                found.hit[l] = true;
                found.s[l] = from.s + t * (to.s - from.s);
                found.triangle[l] = hits.triangle[l];
                for c in 0..2 {
                    found.weights[c][l] = hits.weights[c][l];
                }
                for c in 0..3 {
                    found.tangent[c][l] = v0[c][l] + t * (v1[c][l] - v0[c][l]);
                }
            }
        }
    }
}

impl Found {
    fn hit(&self, l: usize) -> Hit {
        let [x, y, z] = self.tangent.map(|lanes| lanes[l] as f32);
        Hit {
            s: self.s[l],
            v: Vec3::new(x, y, z),
            triangle: self.triangle[l] as u32,
            barycentric: self.weights.map(|w| w[l] as f32),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_weights_reproduce_cubics() {
        let f = |t: f64| 1.0 - 2.0 * t + 3.0 * t * t - 4.0 * t * t * t;
        let nodes = [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0].map(f);
        for t in [0.0, 0.1, 0.5, 0.77, 1.0] {
            let sum: f64 = cubic(t).iter().zip(nodes).map(|(w, f)| w * f).sum();
            assert!((sum - f(t)).abs() < 1e-14);
        }
    }
}
