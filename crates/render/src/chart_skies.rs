//! Skies that are looked up by components of the tangent which are no directions.
//!
//! In: a manifold, and the place of a camera. Out: a warning for each exit without a `direction` of its own
//! that rays from there leave through where the chart is far from Cartesian, with what to write instead.

use crate::world::World;
use geofan_core::{
    geodesic::{End, Path, Ray, Settings, paths},
    manifold::{Carried, Form, Manifold},
};
use glam::{DMat3, DVec3};

/// A unit step along one coordinate may be so many times longer than along another before the components of
/// a tangent are taken for no direction. Asymptotically flat charts that are far enough out stay below 1.2;
/// polar ones are beyond a radius of 10.
const MOST_STRETCHED: f64 = 10.0;

/// Local tolerance of the rays: they only tell where exits are.
const TOLERANCE: f64 = 1e-4;

/// Warns of exits whose sky a scene seen from `u` would look up by components that are no directions.
pub(crate) fn sky_warnings(world: &World, u: DVec3) -> Vec<String> {
    let manifold = &*world.manifold;
    if manifold.form == Form::Embedding {
        return Vec::new();
    }
    let mut warned = vec![false; manifold.exits.len()];
    let mut warnings = Vec::new();
    for (exit, at) in ends(manifold, u) {
        let stretch = stretch(manifold.metric(at));
        let is_right = world.skies[exit].is_none() || manifold.exits[exit].has_direction();
        if warned[exit] || is_right || !(stretch > MOST_STRETCHED) {
            continue;
        }
        warned[exit] = true;
        warnings.push(told(manifold, exit, stretch));
    }
    warnings
}

/// Finds exits and the points at which rays from `u`, along all axes and diagonals, leave through them.
fn ends(manifold: &Manifold, u: DVec3) -> Vec<(usize, DVec3)> {
    let Ok(length) = manifold.length_or(None) else {
        return Vec::new();
    };
    let sides = [-1.0, 0.0, 1.0];
    let directions = sides.iter().flat_map(|x| {
        let rest = sides
            .iter()
            .flat_map(|y| sides.iter().map(move |z| (*y, *z)));
        rest.map(|(y, z)| DVec3::new(*x, y, z))
    });
    let rays = directions.filter_map(|d| Some(Ray::new(manifold, u, d.try_normalize()?, length)));
    let settings = Settings {
        tolerance: TOLERANCE,
        carried: Carried::default(),
        events: true,
    };
    let end = |path: Path| match path.end {
        End::Exit(exit) => Some((exit, path.steps.last()?.position(path.length))),
        _ => None,
    };
    paths(manifold, settings, rays)
        .into_iter()
        .filter_map(end)
        .collect()
}

/// Returns how many times longer a unit step along one coordinate is than along another.
fn stretch(g: DMat3) -> f64 {
    let lengths = [g.x_axis.x, g.y_axis.y, g.z_axis.z].map(f64::sqrt);
    let [least, most] = [f64::min, f64::max].map(|of| lengths.into_iter().reduce(of));
    most.unwrap_or(1.0) / least.unwrap_or(1.0)
}

/// Words the warning.
fn told(manifold: &Manifold, exit: usize, stretch: f64) -> String {
    let (name, [r, t, f]) = (&manifold.exits[exit].name, &manifold.coordinates);
    format!(
        "the sky of the exit `{name}` is looked up by the components of the tangent along {r}, {t}, {f}, and there a step along one of them is {stretch:.0} times as long as along another, so they are no direction. Give the exit its `direction`: if {r}, {t}, {f} are a radius, the angle to an axis and the angle about it, `direction = [\"v{r}*sin({t})*cos({f}) + {r}*(v{t}*cos({t})*cos({f}) - v{f}*sin({t})*sin({f}))\", \"v{r}*sin({t})*sin({f}) + {r}*(v{t}*cos({t})*sin({f}) + v{f}*sin({t})*cos({f}))\", \"v{r}*cos({t}) - {r}*v{t}*sin({t})\"]`; or write the space in Cartesian coordinates with [pullback]"
    )
}
