//! The stars and the glow of the sky between them.
//!
//! In: nothing. Out: [`Star`]s with their light, and the glow by direction, both linear and scaled
//! for the eye rather than for physics: real stars span more contrast than a picture holds.

use glam::Vec3;

/// A star.
#[derive(Debug, Clone, Copy)]
pub(super) struct Star {
    /// Unit vector.
    pub(super) direction: Vec3,
    /// Radiance times solid angle, linear red, green, blue.
    pub(super) light: Vec3,
    /// Radius of its disc, radians.
    pub(super) radius: f32,
}

impl Star {
    fn new(direction: Vec3, magnitude: f32, index: f32) -> Self {
        // Brighter stars are wider, as they are on film: a pixel at full white says nothing of how
        // bright a star is. From about two to six pixels across in a 1280-wide view of 90°.
        let radius = 1e-3 * (4.0 - 0.45 * magnitude).clamp(1.5, 4.2);
        Self {
            direction,
            light: colour(index) * flux(magnitude),
            radius,
        }
    }
}

/// Bright stars of constellations that everyone knows and that have no mirror symmetry: right ascension and declination in
/// degrees, magnitude, colour index B−V.
const CONSTELLATIONS: &[(f32, f32, f32, f32)] = &[
    // Big Dipper.
    (165.93, 61.75, 1.8, 1.1),
    (165.46, 56.38, 2.3, 0.0),
    (178.46, 53.69, 2.4, 0.0),
    (183.86, 57.03, 3.2, 0.1),
    (193.51, 55.96, 1.8, 0.0),
    (200.98, 54.93, 2.2, 0.1),
    (206.89, 49.31, 1.9, -0.1),
    // Polaris, Arcturus, Spica.
    (37.95, 89.26, 2.0, 0.6),
    (213.92, 19.18, 0.0, 1.3),
    (201.30, -11.16, 1.0, -0.2),
    // Cassiopeia.
    (10.13, 56.54, 2.2, 1.2),
    (2.29, 59.15, 2.3, 0.3),
    (14.18, 60.72, 2.4, -0.1),
    (21.45, 60.24, 2.7, 0.2),
    (28.60, 63.67, 3.3, -0.1),
    // Orion.
    (88.79, 7.41, 0.4, 1.8),
    (78.63, -8.20, 0.1, 0.0),
    (81.28, 6.35, 1.6, -0.2),
    (86.94, -9.67, 2.1, -0.2),
    (85.19, -1.94, 1.8, -0.2),
    (84.05, -1.20, 1.7, -0.2),
    (83.00, -0.30, 2.2, -0.2),
    (83.82, -5.91, 2.8, -0.2),
    // Sirius, Procyon, Castor, Pollux, Capella, Aldebaran and the Pleiades.
    (101.29, -16.72, -1.4, 0.0),
    (114.83, 5.22, 0.4, 0.4),
    (113.65, 31.89, 1.6, 0.0),
    (116.33, 28.03, 1.1, 1.0),
    (79.17, 46.00, 0.1, 0.8),
    (68.98, 16.51, 0.9, 1.5),
    (56.87, 24.11, 2.9, -0.1),
    (57.29, 24.05, 3.6, -0.1),
    (56.22, 24.11, 3.7, -0.1),
    (56.46, 24.37, 3.9, -0.1),
    (56.58, 23.95, 4.1, -0.1),
    // Leo.
    (152.09, 11.97, 1.4, -0.1),
    (154.99, 19.84, 2.1, 1.1),
    (177.26, 14.57, 2.1, 0.1),
    (168.53, 20.52, 2.5, 0.1),
    (168.56, 15.43, 3.3, 0.0),
    (146.46, 23.77, 3.0, 0.8),
    (154.17, 23.42, 3.4, 0.3),
    (151.83, 16.76, 3.5, 0.0),
    // Vega, Altair, Deneb and the rest of the Swan.
    (279.23, 38.78, 0.0, 0.0),
    (297.70, 8.87, 0.8, 0.2),
    (310.36, 45.28, 1.2, 0.1),
    (305.56, 40.26, 2.2, 0.7),
    (311.55, 33.97, 2.5, 1.0),
    (296.24, 45.13, 2.9, 0.0),
    (292.68, 27.96, 3.1, 1.1),
    // Scorpion.
    (247.35, -26.43, 1.0, 1.8),
    (241.36, -19.81, 2.6, -0.1),
    (240.08, -22.62, 2.3, -0.1),
    (239.71, -26.11, 2.9, -0.2),
    (245.30, -25.59, 2.9, 0.1),
    (248.97, -28.22, 2.8, -0.2),
    (252.54, -34.29, 2.3, 1.1),
    (252.97, -38.05, 3.0, -0.2),
    (253.65, -42.36, 3.6, 1.4),
    (258.04, -43.24, 3.3, 0.4),
    (264.33, -43.00, 1.9, 0.4),
    (266.90, -40.13, 3.0, 0.5),
    (265.62, -39.03, 2.4, -0.2),
    (263.40, -37.10, 1.6, -0.2),
    // Southern Cross and the Pointers, Canopus, Achernar, Fomalhaut.
    (186.65, -63.10, 0.8, -0.2),
    (191.93, -59.69, 1.2, -0.2),
    (187.79, -57.11, 1.6, 1.6),
    (183.79, -58.75, 2.8, -0.2),
    (219.90, -60.83, -0.2, 0.7),
    (210.96, -60.37, 0.6, -0.2),
    (95.99, -52.70, -0.7, 0.2),
    (24.43, -57.24, 0.5, -0.2),
    (344.41, -29.62, 1.2, 0.1),
];

/// Number of scattered stars; the eye sees about as many in both halves of a dark sky.
const SCATTERED: u32 = 9000;
/// Magnitude of the brightest and the faintest scattered star.
const MAGNITUDES: (f32, f32) = (3.0, 7.0);
/// North pole of the milky way, and its centre, in degrees.
const POLE: (f32, f32) = (192.86, 27.13);
const CENTRE: (f32, f32) = (266.40, -28.94);

/// Returns the unit vector to a longitude and latitude in degrees.
pub(super) fn at(longitude: f32, latitude: f32) -> Vec3 {
    let (sin, cos) = latitude.to_radians().sin_cos();
    let (y, x) = longitude.to_radians().sin_cos();
    Vec3::new(x * cos, y * cos, sin)
}

/// Makes all stars.
pub(super) fn stars() -> Vec<Star> {
    let known = CONSTELLATIONS
        .iter()
        .map(|&(ra, dec, magnitude, index)| Star::new(at(ra, dec), magnitude, index));
    known.chain((0..SCATTERED).filter_map(faint_star)).collect()
}

/// Returns the light of a star of that magnitude: 1.8 times a magnitude and not 2.5, so that faint stars are
/// seen beside bright ones. With the factor, one of magnitude 5½ is as bright as white paper.
fn flux(magnitude: f32) -> f32 {
    2.6e-6 * 1.8_f32.powf(5.5 - magnitude)
}

/// Returns the linear colour by B−V, green about 1: from blue-white at −0.3 through white to orange at 1.8.
fn colour(index: f32) -> Vec3 {
    let warm = ((index + 0.3) / 2.1).clamp(0.0, 1.0);
    let (blue, white, orange) = (
        Vec3::new(0.6, 0.8, 1.35),
        Vec3::new(1.05, 1.0, 0.95),
        Vec3::new(1.7, 0.85, 0.32),
    );
    if warm < 0.35 {
        blue.lerp(white, warm / 0.35)
    } else {
        white.lerp(orange, (warm - 0.35) / 0.65)
    }
}

/// Makes the scattered star number `i`, unless it is one of those that thin out away from the band.
fn faint_star(i: u32) -> Option<Star> {
    let direction = scattered(i, SCATTERED);
    let keep = 0.42 + 0.58 * band(direction).min(1.0);
    // Counts grow about threefold with each magnitude, as they do in the real sky.
    let (bright, faint) = MAGNITUDES;
    let magnitude = faint + (uniform(i, 3).max(1e-9).ln() / 3.0_f32.ln()).max(bright - faint);
    (uniform(i, 2) < keep).then(|| Star::new(direction, magnitude, 2.1 * uniform(i, 4) - 0.3))
}

/// Returns point `i` of `count` on a spiral over the sphere, jittered so that no pattern shows.
pub(super) fn scattered(i: u32, count: u32) -> Vec3 {
    let jitter = |dimension: u32| uniform(i, dimension) - 0.5;
    let z = 1.0 - 2.0 * (i as f32 + 0.5 + 60.0 * jitter(0)) / count as f32;
    // Those beyond a pole go back: held there, all of them were one star.
    let z = if z.abs() > 1.0 {
        z.signum() * 2.0 - z
    } else {
        z
    };
    // The golden angle, reduced in double precision: thousands of turns lose digits in single.
    let turn = (f64::from(i) * 0.618_033_988_749_895).fract() as f32;
    let longitude = (turn + 0.1 * jitter(1)) * std::f32::consts::TAU;
    let (sin, cos) = longitude.sin_cos();
    let across = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(across * cos, across * sin, z)
}

/// Returns a number in [0, 1) that depends on nothing but its arguments.
fn uniform(i: u32, dimension: u32) -> f32 {
    let mut x = i.wrapping_mul(0x9e37_79b9) ^ dimension.wrapping_mul(0x85eb_ca6b);
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^= x >> 16;
    (x >> 8) as f32 / (1 << 24) as f32
}

/// Returns the brightness of the milky way: 1 in its middle, a bulge at its centre, dark lanes along it.
fn band(d: Vec3) -> f32 {
    let (pole, centre) = (at(POLE.0, POLE.1), at(CENTRE.0, CENTRE.1));
    let wobble = 0.05 * noise(3.0 * d) + 0.03 * noise(9.0 * d);
    let height = pole.dot(d) + wobble;
    let toward = 0.5 + 0.5 * centre.dot(d);
    let width = 0.13 + 0.07 * toward * toward;
    let broad = (-(height / width).powi(2)).exp();
    let lane = (-((height - 0.02 + wobble) / 0.045).powi(2)).exp() * (0.4 + 0.6 * toward);
    let clumps = 1.0 + 0.5 * noise(6.0 * d) + 0.35 * noise(15.0 * d);
    (broad * clumps * (0.35 + 0.65 * toward) * (1.0 - 0.65 * lane)).max(0.0)
}

/// Returns the light between the stars.
pub(super) fn glow(d: Vec3) -> Vec3 {
    let (cold, warm) = (
        Vec3::new(0.0028, 0.0048, 0.0110),
        Vec3::new(0.0080, 0.0062, 0.0120),
    );
    let night = cold.lerp(warm, 0.5 + 0.5 * d.x);
    let toward = at(CENTRE.0, CENTRE.1).dot(d).max(0.0);
    let (outer, inner) = (
        Vec3::new(0.062, 0.066, 0.088),
        Vec3::new(0.150, 0.115, 0.082),
    );
    night + outer.lerp(inner, toward * toward) * band(d)
}

/// Returns smooth noise in about [-1, 1], one feature a unit.
fn noise(p: Vec3) -> f32 {
    let (cell, f) = (p.floor(), p - p.floor());
    let f = f * f * (Vec3::splat(3.0) - 2.0 * f);
    let value = |x: i32, y: i32, z: i32| {
        let c = cell.as_ivec3() + glam::IVec3::new(x, y, z);
        uniform(
            (c.x as u32).wrapping_mul(73) ^ (c.y as u32).wrapping_mul(19_349),
            c.z as u32,
        )
    };
    let edge = |y, z| value(0, y, z) + (value(1, y, z) - value(0, y, z)) * f.x;
    let face = |z| edge(0, z) + (edge(1, z) - edge(0, z)) * f.y;
    2.0 * (face(0) + (face(1) - face(0)) * f.z) - 1.0
}
