//! What is refused or warned of where objects and lamps are placed.
//!
//! In: a scene and its manifold, and what is placed. Out: nothing, or a complaint with the place in the scene's text;
//! or warnings of what no camera can see.

use super::{
    scene::{ObjectEntry, Points, SceneFile},
    world::PointLight,
};
use geofan_core::{
    diagnostic::Diagnostic,
    error::{Error, Result},
    geodesic::check_point,
    manifold::Manifold,
};
use glam::DVec3;

/// Refuses a place outside the domain, or where the chart breaks down or all but does.
pub(super) fn check_place(
    scene: &SceneFile,
    manifold: &Manifold,
    object: &ObjectEntry,
) -> Result<()> {
    let refused = |message: String, hint: &str| -> Result<()> {
        let place = object.at_span.clone();
        Err(Diagnostic::new(&scene.source, place, message)
            .with_hint(hint)
            .into())
    };
    if let Err(fault) = check_point(manifold, "the object", object.at) {
        let hint = "see [domain] in the manifold file, or move it from where the chart breaks down";
        return refused(fault.to_string(), hint);
    }
    if is_near_singular(manifold, object.at) {
        let message =
            "the object: the chart is all but singular there, so directions are lost to rounding";
        let hint = "move it away, or describe the space in other coordinates";
        return refused(message.into(), hint);
    }
    Ok(())
}

/// Refuses an object of which a part lies nowhere or which goes round and round the space: both
/// come of a place where the chart is all but singular.
pub(super) fn check_extent(
    scene: &SceneFile,
    manifold: &Manifold,
    object: &ObjectEntry,
    vertices: &Points,
) -> Result<()> {
    let refused = |message: String| -> Result<()> {
        Err(
            Diagnostic::new(&scene.source, object.at_span.clone(), message)
                .with_hint("make it smaller, or move it from where the chart breaks down")
                .into(),
        )
    };
    if vertices.iter().any(|(u, _)| !u.is_finite()) {
        return refused(String::from(
            "a part of the object has no place in the chart",
        ));
    }
    let times = times_around(manifold, vertices);
    let copies: f64 = times.iter().map(|times| times + 1.0).product();
    let k = DVec3::from_array(times).max_position();
    if copies > MOST_COPIES {
        let (times, name) = (times[k], &manifold.coordinates[k]);
        return refused(format!(
            "the object goes {times:.0} times around in `{name}`"
        ));
    }
    Ok(())
}

/// Computes how many times an object goes around the space in each glued coordinate; 0 in the others.
fn times_around(manifold: &Manifold, vertices: &Points) -> [f64; 3] {
    [0, 1, 2].map(|k| {
        let all = vertices.iter().map(|(u, _)| u[k]);
        let (least, most) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| {
            (a.min(x), b.max(x))
        });
        let period = manifold.domain.period(k);
        period.map_or(0.0, |period| ((most - least) / period).max(0.0))
    })
}

/// Complains about an object that cannot be placed.
pub(super) fn unreachable(scene: &SceneFile, object: &ObjectEntry) -> Error {
    Diagnostic::new(
        &scene.source,
        object.span.clone(),
        "the geodesics that place this object leave the manifold",
    )
    .with_hint("make it smaller or move it away from the edge of the domain")
    .into()
}

/// Warns of an object that moves along a path in a scene with `redshift`, which only `velocity` tells.
pub(super) fn unshifted(scene: &SceneFile, object: &ObjectEntry) -> Option<String> {
    let untold = scene.redshift && object.path.is_some() && object.velocity.is_none();
    let name = object.mesh.display();
    untold.then(|| {
        format!("{name} moves along its path, but its light has the frequencies of a body at rest: `velocity` beside `path` tells how fast it is")
    })
}

/// Refuses that light takes time where that is not known.
pub(super) fn check_delay(scene: &SceneFile, manifold: &Manifold) -> Result<()> {
    let Some(span) = &scene.delay else {
        return Ok(());
    };
    let refused = |message: &str, hint: &str| {
        let complaint = Diagnostic::new(&scene.source, span.clone(), message);
        Err(complaint.with_hint(hint).into())
    };
    if manifold.has_drift() {
        let message = "`delay`: in a space with `drift` time is not the arc length of paths";
        return refused(
            message,
            "take it away: objects are then shown as they are at one time",
        );
    }
    if !scene.lights.is_empty() {
        let message = "`delay`: the light of lamps is not followed in time";
        return refused(
            message,
            "take the lamps away (`Ke` in a material glows), or `delay`",
        );
    }
    Ok(())
}

/// Warns of lamps beyond an exit.
pub(super) fn lamps_out_of_sight(manifold: &Manifold, lamps: &[PointLight]) -> Vec<String> {
    let numbered = lamps.iter().enumerate();
    let warning = |(k, lamp): (usize, &PointLight)| {
        let name = format!("light {}", k + 1);
        out_of_sight(manifold, &name, [lamp.u].into_iter(), || false)
    };
    numbered.filter_map(warning).collect()
}

/// The most corners of an object that are looked at, evenly chosen: a part beyond an exit that falls between
/// them is too small to be missed.
const CORNERS: usize = 4096;

/// Warns of what is beyond an exit, where no path of a camera gets: how much of the thing at these `points`. Where that is all
/// of them, `may_reach` is asked whether something between them is on this side; then nothing is warned of.
pub(super) fn out_of_sight(
    manifold: &Manifold,
    name: &str,
    points: impl ExactSizeIterator<Item = DVec3>,
    may_reach: impl FnOnce() -> bool,
) -> Option<String> {
    let stride = points.len().div_ceil(CORNERS).max(1);
    let chosen = points.step_by(stride);
    let (mut looked_at, mut beyond, mut first) = (0, 0, None);
    for u in chosen {
        looked_at += 1;
        if let Some((exit, value)) = manifold.domain.exit_beyond(manifold.domain.wrap(u)) {
            beyond += 1;
            first.get_or_insert((exit, value, u));
        }
    }
    let (exit, value, u) = first?;
    if beyond == looked_at && may_reach() {
        return None;
    }
    let part = match beyond == looked_at {
        true if looked_at == 1 => "it".into(),
        true => "every corner of it".into(),
        false => format!(
            "{:.1} % of its corners",
            100.0 * beyond as f64 / looked_at as f64
        ),
    };
    let [x, y, z] = &manifold.coordinates;
    Some(format!(
        "{name}: {part} lies beyond the exit `{}`, where paths end before they get there: its `when` is {} at {x} = {}, {y} = {}, {z} = {}; move it to this side of the exit",
        manifold.exits[exit].name,
        short(value),
        short(u.x),
        short(u.y),
        short(u.z)
    ))
}

/// Writes a number with six decimals, or with a power of ten where that is long.
fn short(x: f64) -> String {
    match x.abs() < 1e9 {
        true => format!("{x:.6}"),
        false => format!("{x:.6e}"),
    }
}

/// The most triangles in which a place on this side of an exit is looked for, the largest of an object: others go hardly
/// farther than their corners.
const TRIANGLES: usize = 256;

/// Tells whether a part of one of the triangles between `vertices` is on this side of all exits.
pub(super) fn any_reaches(manifold: &Manifold, vertices: &Points, triangles: &[[u32; 3]]) -> bool {
    let corners = |t: &[u32; 3]| t.map(|i| vertices[i as usize].0);
    let size = |[p, q, r]: [DVec3; 3]| (q - p).length().max((r - p).length());
    let mut sizes: Vec<f64> = triangles.iter().map(|t| size(corners(t))).collect();
    sizes.sort_by(f64::total_cmp);
    let least = sizes.get(sizes.len().saturating_sub(TRIANGLES));
    let least = least.copied().unwrap_or(0.0);
    let all = || triangles.iter().map(corners);
    let larger = all().filter(|t| size(*t) > least);
    let equal = all().filter(|t| size(*t) == least);
    let mut largest = larger.chain(equal).take(TRIANGLES);
    largest.any(|corners| reaches(manifold, corners))
}

/// Halvings of the steps by which [`reaches`] looks for the least value of an exit's formula in a triangle: what is left of
/// the first is a millionth.
const HALVINGS: usize = 20;

/// Steps of one size at most: along a valley of a long triangle there are many.
const STEPS: usize = 8;

/// Tells whether a part of a triangle is on this side of all exits, by going from its middle to where the value of the exit's
/// formula is less, by smaller and smaller steps.
fn reaches(manifold: &Manifold, [p, q, r]: [DVec3; 3]) -> bool {
    // Of weights of two corners outside the triangle nothing is known.
    let value = |[b, c]: [f64; 2]| match b >= 0.0 && c >= 0.0 && b + c <= 1.0 {
        true => {
            let u = manifold.domain.wrap(p * (1.0 - b - c) + q * b + r * c);
            manifold.domain.exit_beyond(u).map_or(0.0, |(_, v)| v)
        }
        false => f64::INFINITY,
    };
    let ways = [
        [1.0, 0.0],
        [0.0, 1.0],
        [1.0, -1.0],
        [-1.0, 0.0],
        [0.0, -1.0],
        [-1.0, 1.0],
    ];
    let mut at = [1.0 / 3.0; 2];
    let mut least = value(at);
    for halving in 0..HALVINGS {
        let step = 0.25 * 0.5_f64.powi(halving as i32);
        for _ in 0..STEPS {
            let next = ways.map(|[x, y]| [at[0] + x * step, at[1] + y * step]);
            let next = next.map(|at| (value(at), at));
            let Some((less, there)) = next.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)) else {
                break;
            };
            if !(less < least) {
                break;
            }
            (least, at) = (less, there);
        }
        if least <= 0.0 {
            return true;
        }
    }
    false
}

/// Most places that an object may have beside itself because it goes around the space: each costs
/// another search for what a ray meets.
const MOST_COPIES: f64 = 64.0;

/// Largest ratio of the lengths of a standard frame's axes: of sixteen digits, four are left for
/// directions.
const MOST_STRETCH: f64 = 1e12;

/// Tells whether the standard frame at `u` is so uneven that directions are lost.
fn is_near_singular(manifold: &Manifold, u: DVec3) -> bool {
    let frame = manifold.standard_frame(u);
    let lengths = [0, 1, 2].map(|k| frame.col(k).length());
    let [least, most] =
        [f64::min, f64::max].map(|of| lengths.into_iter().reduce(of).unwrap_or(1.0));
    !(most <= MOST_STRETCH * least)
}
