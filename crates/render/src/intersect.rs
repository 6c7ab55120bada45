//! Curves against triangles.
//!
//! In: a cubic piece of a path. Out: its first hit. A piece whose box meets no leaf of the tree is
//! skipped; another is flattened into as many chords as keep it within [`CHORD_ERROR`] of the
//! cubic, and each chord is a straight segment. Glued coordinates: the piece is tried in every
//! period in which the scene's box is.

use super::{accel::Accelerator, curve::Piece};
use geofan_core::manifold::Domain;
use glam::{DVec3, Vec3};

/// A point of a curve on a triangle; its chart point is [`super::World::point`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Arc length.
    pub s: f32,
    /// Tangent, chart components.
    pub v: Vec3,
    /// Index of the triangle.
    pub triangle: u32,
    /// Weights of its second and third corners.
    pub barycentric: [f32; 2],
}

/// Angle (radians) by which chords may depart from the curve: a twentieth of a mrad, a small part
/// of a pixel.
pub const CHORD_ERROR: f64 = 5e-5;

/// Most chords of one piece: pieces are short already, so more means a broken curve.
const MOST_CHORDS: f64 = 64.0;

/// The first hit of `piece` before arc length `limit`.
pub fn first_hit(
    accelerator: &Accelerator,
    domain: &Domain,
    piece: &Piece,
    limit: f64,
) -> Option<Hit> {
    let (low, high) = piece.bounds();
    if !is_glued(domain) {
        return hit_shifted(accelerator, piece, limit, DVec3::ZERO, (low, high));
    }
    let mut first: Option<Hit> = None;
    for shift in shifts(accelerator, domain, low, high) {
        let hit = hit_shifted(accelerator, piece, limit, shift, (low, high));
        if let Some(hit) = hit
            && first.is_none_or(|f| hit.s < f.s)
        {
            first = Some(hit);
        }
    }
    first
}

/// Whether a curve inside the box may meet anything: cheaper than to divide it into pieces.
pub fn may_meet(accelerator: &Accelerator, domain: &Domain, (low, high): (DVec3, DVec3)) -> bool {
    is_glued(domain) || accelerator.touches(low, high)
}

/// The box outside which curves meet nothing; `None` if that is not known.
pub fn region(accelerator: &Accelerator, domain: &Domain) -> Option<(DVec3, DVec3)> {
    accelerator.bounds().filter(|_| !is_glued(domain))
}

/// Whether any coordinate is glued.
pub fn is_glued(domain: &Domain) -> bool {
    domain.periodic.iter().any(|p| *p)
}

/// The displacements by whole periods that bring the box into reach of the scene.
pub fn shifts(accelerator: &Accelerator, domain: &Domain, low: DVec3, high: DVec3) -> Vec<DVec3> {
    let Some((least, most)) = accelerator.bounds() else {
        return Vec::new();
    };
    let mut shifts = vec![DVec3::ZERO];
    for k in 0..3 {
        if let Some(period) = domain.period(k) {
            let from = ((least[k] - high[k]) / period).ceil() as i64;
            let to = ((most[k] - low[k]) / period).floor() as i64;
            shifts = shifts
                .iter()
                .flat_map(|s| {
                    (from..=to).map(move |n| {
                        let mut shift = *s;
                        shift[k] = n as f64 * period;
                        shift
                    })
                })
                .collect();
        }
    }
    shifts
}

fn hit_shifted(
    accelerator: &Accelerator,
    piece: &Piece,
    limit: f64,
    shift: DVec3,
    (low, high): (DVec3, DVec3),
) -> Option<Hit> {
    if !accelerator.touches(low + shift, high + shift) {
        return None;
    }
    let allowed = CHORD_ERROR * piece.s[1] * piece.v[1].length().min(piece.v[0].length());
    let chords = (piece.sagitta() / allowed)
        .sqrt()
        .ceil()
        .clamp(1.0, MOST_CHORDS);
    let mut from = piece.u[0] + shift;
    for i in 0..chords as usize {
        let end = (i + 1) as f64 / chords;
        let to = piece.position(end) + shift;
        if let Some(hit) = accelerator.first_hit_on_chord(from, to) {
            let t = (i as f64 + hit.t) / chords;
            let s = piece.arc(t);
            return (s <= limit).then(|| Hit {
                s: s as f32,
                v: piece.tangent(t).as_vec3(),
                triangle: hit.triangle,
                barycentric: [hit.barycentric.0 as f32, hit.barycentric.1 as f32],
            });
        }
        from = to;
    }
    None
}
