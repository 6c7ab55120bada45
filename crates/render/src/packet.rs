//! Sixteen samples at once: the pixel step.
//!
//! In: a tile's ribbon and endings, and how each sample's path comes from its sixteen ([`Bicubic`]).
//! Out: what each sample sees.

use super::{
    accel::PacketHits,
    curve::Ending,
    intersect::Hit,
    lanes::{LANES, Lanes, Points, SingleLanes, SinglePoints, each, each_point, range, single},
    outcome::{Seen, beyond},
    ribbon::{Chords, Ribbon, RibbonChord},
    sheaf::{Offsets, PathPatch},
    world::World,
};
use geofan_expr::real::Real;
use glam::{DVec2, DVec3, Vec3};

/// How the paths of sixteen samples come from the sixteen of a sheaf: the weights of each path, for
/// all samples. In single precision, which is enough for differences between neighbours.
#[repr(align(64))]
pub struct Bicubic([SingleLanes; LANES]);

impl Bicubic {
    /// Bicubic weights of 4 × 4 paths at even spacing, at places in the tile as fractions of its
    /// side.
    #[inline(always)]
    pub fn new(places: &[DVec2; LANES]) -> Self {
        let x = cubic_lanes(|l| places[l].x);
        let y = cubic_lanes(|l| places[l].y);
        let mut weights = [[0.0; LANES]; LANES];
        for i in 0..LANES {
            for l in 0..LANES {
                weights[i][l] = x[i % 4][l] * y[i / 4][l];
            }
        }
        Self(weights)
    }

    #[inline(always)]
    fn mix(&self, values: &Lanes) -> Lanes {
        let spread = Offsets::of(&[*values, [0.0; LANES], [0.0; LANES]]);
        let [mixed] = self.mix_components([&spread.differences[0]]);
        each(|l| spread.middle.x + f64::from(mixed[l]))
    }

    /// The points of the sixteen samples.
    #[inline(always)]
    pub fn mix_points(&self, spread: &Offsets) -> Points {
        let mixed = self.mix_spread(spread);
        each_point(|c, l| mixed.middle[c] + f64::from(mixed.differences[c][l]))
    }

    /// The same by how they differ from the middle of `spread`: the weights sum to 1, so only
    /// differences need them.
    #[inline(always)]
    pub fn mix_spread(&self, spread: &Offsets) -> Offsets {
        Offsets {
            middle: spread.middle,
            differences: self.mix_components(spread.differences.each_ref()),
        }
    }

    /// Several at once: the sums of one alone would wait for each other.
    #[inline(always)]
    fn mix_components<const N: usize>(&self, differences: [&SingleLanes; N]) -> [SingleLanes; N] {
        let mut sums = [[0.0; LANES]; N];
        for i in 0..LANES {
            let weights = &self.0[i];
            for n in 0..N {
                let difference = differences[n][i];
                for l in 0..LANES {
                    sums[n][l] += weights[l] * difference;
                }
            }
        }
        sums
    }
}

/// Lagrange's cubic weights at `t` for nodes 0, 1/3, 2/3, 1.
#[inline(always)]
pub fn cubic<T: Real>(t: T) -> [T; 4] {
    let number = T::from_f64;
    let (a, b) = (t, t - number(1.0 / 3.0));
    let (c, d) = (t - number(2.0 / 3.0), t - T::ONE);
    [
        number(-4.5) * b * c * d,
        number(13.5) * a * c * d,
        number(-13.5) * a * b * d,
        number(4.5) * a * b * c,
    ]
}

/// [`cubic`] in every lane.
#[inline(always)]
fn cubic_lanes(t: impl Fn(usize) -> f64) -> [SingleLanes; 4] {
    let mut weights = [[0.0; LANES]; 4];
    for l in 0..LANES {
        let w = cubic(t(l) as f32);
        for i in 0..4 {
            weights[i][l] = w[i];
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
    skies: Offsets,
}

/// The first hits of sixteen paths.
#[repr(C, align(64))]
struct Found {
    /// Arc lengths of the hits; of the endings where there are none.
    s: Lanes,
    hit: [bool; LANES],
    triangle: [u32; LANES],
    weights: [SingleLanes; 2],
    tangent: SinglePoints,
}

impl<'a> Target<'a> {
    /// The paths of `sheaf` must share their exit.
    pub fn new(world: &'a World, sheaf: &PathPatch<'_>, ribbon: &'a Ribbon) -> Self {
        Self {
            world,
            ribbon,
            exit: sheaf.exit().flatten(),
            limits: sheaf.limits(),
            skies: Offsets::of(&sheaf.skies()),
        }
    }

    /// Shows what each of sixteen samples sees, where they may meet something on `chords`.
    #[inline(always)]
    pub fn see(&self, mixing: &Bicubic, chords: &Chords, mut show: impl FnMut(usize, Seen)) {
        // An infinite limit times a weight is no number.
        let limits = match self.exit {
            Some(_) => mixing.mix(&self.limits),
            None => [f64::INFINITY; LANES],
        };
        let found = self.first_hits(mixing, chords, &limits);
        let sky = directions(&mixing.mix_spread(&self.skies));
        for l in 0..LANES {
            let seen = match (found.hit[l], self.exit) {
                (true, _) => Seen::Surface(found.hit(l)),
                (false, Some(exit)) => Seen::Sky {
                    exit: exit as u32,
                    s: found.s[l] as f32,
                    direction: Vec3::new(sky[0][l], sky[1][l], sky[2][l]),
                },
                (false, None) => Seen::Nothing,
            };
            show(l, seen);
        }
    }

    /// The same of sixteen samples whose paths end each in its own way.
    #[inline(always)]
    pub fn see_before(
        &self,
        mixing: &Bicubic,
        chords: &Chords,
        endings: &[Ending; LANES],
        mut show: impl FnMut(usize, Seen),
    ) {
        let limits = each(|l| endings[l].limit());
        let found = self.first_hits(mixing, chords, &limits);
        for l in 0..LANES {
            let seen = match found.hit[l] {
                true => Seen::Surface(found.hit(l)),
                false => beyond(&endings[l]),
            };
            show(l, seen);
        }
    }

    #[inline(always)]
    fn first_hits(&self, mixing: &Bicubic, chords: &Chords, limits: &Lanes) -> Found {
        let mut found = Found {
            s: *limits,
            hit: [false; LANES],
            triangle: [0; LANES],
            weights: [[0.0; LANES]; 2],
            tangent: [[0.0; LANES]; 3],
        };
        let mut ends = Ends::default();
        for chord in chords.iter() {
            let (s, next) = (self.s(chord.from), self.s(chord.from + 1));
            let share = 1.0 / (next - s);
            let most = single(|l| ((found.s[l] - s) * share).min(1.0) as f32);
            if !(range(&most)[1] >= 0.0) {
                break;
            }
            self.mix_ends(mixing, chord.from, &mut ends);
            let roots = chords.roots(chord);
            let accelerator = &self.world.accelerator;
            let both = ends.from(chord.from);
            if let Some(hits) = accelerator.first_hits(roots, both, chord.shift, &most) {
                self.keep(mixing, chord, &hits, &mut found);
            }
        }
        found
    }

    /// The arc length of a vertex of the ribbon.
    #[inline(always)]
    fn s(&self, vertex: usize) -> f64 {
        self.ribbon.vertices[vertex].s
    }

    /// Makes sure of both ends of the chords that begin at vertex `from`.
    #[inline(always)]
    fn mix_ends(&self, mixing: &Bicubic, from: usize, ends: &mut Ends) {
        for vertex in [from, from + 1] {
            if ends.vertices[vertex % 2] != Some(vertex) {
                ends.points[vertex % 2] = mixing.mix_spread(self.ribbon.point(vertex));
                ends.vertices[vertex % 2] = Some(vertex);
            }
        }
    }

    /// Takes over the hits of one chord, which are nearer than what was known.
    #[inline(always)]
    fn keep(&self, mixing: &Bicubic, chord: &RibbonChord, hits: &PacketHits, found: &mut Found) {
        let (from, to) = (chord.from, chord.from + 1);
        let (s, length) = (self.s(from), self.s(to) - self.s(from));
        let start = mixing.mix_spread(&self.ribbon.vertices[from].tangent);
        let end = mixing.mix_spread(&self.ribbon.vertices[to].tangent);
        for l in 0..LANES {
            let hit = hits.t[l] < f32::INFINITY;
            let at = s + f64::from(hits.t[l]) * length;
            found.hit[l] |= hit;
            found.s[l] = if hit { at } else { found.s[l] };
            found.triangle[l] = if hit {
                hits.triangle[l]
            } else {
                found.triangle[l]
            };
        }
        for k in 0..2 {
            put(&mut found.weights[k], &hits.weights[k], &hits.t);
        }
        for c in 0..3 {
            let (a, b) = (start.middle[c] as f32, end.middle[c] as f32);
            let tangent = single(|l| {
                let (a, b) = (a + start.differences[c][l], b + end.differences[c][l]);
                a + hits.t[l] * (b - a)
            });
            put(&mut found.tangent[c], &tangent, &hits.t);
        }
    }
}

/// The ends of a chord, which are often those of the next too: each stays in the place that the parity of
/// its number gives it.
#[derive(Default)]
struct Ends {
    vertices: [Option<usize>; 2],
    points: [Offsets; 2],
}

impl Ends {
    /// Those of the chords that begin at vertex `from`.
    #[inline(always)]
    fn from(&self, from: usize) -> [&Offsets; 2] {
        [&self.points[from % 2], &self.points[(from + 1) % 2]]
    }
}

/// Puts the numbers of the lanes with a finite place `t` into `to`.
#[inline(always)]
fn put(to: &mut SingleLanes, from: &SingleLanes, t: &SingleLanes) {
    for l in 0..LANES {
        to[l] = if t[l] < f32::INFINITY { from[l] } else { to[l] };
    }
}

/// Sixteen vectors made unit vectors; zero stays.
#[inline(always)]
fn directions(vectors: &Offsets) -> SinglePoints {
    let middle: DVec3 = vectors.middle;
    let mut to = vectors.differences;
    for c in 0..3 {
        let middle = middle[c] as f32;
        to[c] = single(|l| middle + vectors.differences[c][l]);
    }
    let length = single(|l| {
        let squared = to[0][l] * to[0][l] + to[1][l] * to[1][l] + to[2][l] * to[2][l];
        1.0 / squared.max(f32::MIN_POSITIVE).sqrt()
    });
    for c in 0..3 {
        for l in 0..LANES {
            to[c][l] *= length[l];
        }
    }
    to
}

impl Found {
    #[inline(always)]
    fn hit(&self, l: usize) -> Hit {
        let ([x, y, z], [b, c]) = (&self.tangent, &self.weights);
        Hit {
            s: self.s[l] as f32,
            v: Vec3::new(x[l], y[l], z[l]),
            triangle: self.triangle[l],
            barycentric: [b[l], c[l]],
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
