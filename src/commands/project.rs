//! `geofan project`: where a point of the space is in a picture.
//!
//! In: a scene, one of its cameras, a chart point. Out: the point to first order in its distance, and its images:
//! every geodesic by which the camera sees it, whatever stands in between.

use crate::terminal::{self, CommonArgs, Outcome, values};
use geofan_core::{Error, Result, geodesic::check_point, manifold::Manifold};
use geofan_light::{Connection, LightFan};
use geofan_render::{Stage, View, local::projection, usual_size};
use glam::DVec3;
use serde_json::{Value, json};
use std::{fmt::Write, path::PathBuf};

/// Options of `geofan project`.
#[derive(Debug, clap::Args)]
pub struct ProjectArgs {
    /// The scene file
    scene: PathBuf,
    /// The point, in the chart's coordinates
    #[arg(long, value_name = "A,B,C", allow_hyphen_values = true, value_parser = values::vector)]
    point: DVec3,
    /// The camera: the name of one of the scene's views [default: its main camera]
    #[arg(long, value_name = "NAME")]
    view: Option<String>,
    /// Picture size [default: 1280x720, or what suits the projection]
    #[arg(long, value_name = "WxH", value_parser = values::picture_size)]
    size: Option<(usize, usize)>,
    /// Arc length up to which images are looked for [default: the manifold file's]
    #[arg(long, value_name = "L", value_parser = values::length)]
    length: Option<f64>,
    /// Local tolerance of geodesics
    #[arg(long, value_name = "T", default_value = "1e-11", value_parser = values::tolerance)]
    tolerance: f64,
    /// Replace a parameter of the manifold; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = values::setting)]
    set: Vec<(String, f64)>,
}

/// The box about the point for which rays are spread finely, as a share of its distance in the chart.
const NEIGHBOURHOOD: f64 = 0.25;

/// A point's places in a picture.
struct Projected {
    view: View,
    length: f64,
    /// In the camera's axes (right, up, backwards), to first order.
    local: DVec3,
    images: Vec<PointImage>,
}

/// An image of the point.
struct PointImage {
    connection: Connection,
    /// Set if it shows left for right.
    mirrored: bool,
}

impl PointImage {
    /// Takes the image that a geodesic of `manifold`, perhaps the cover of a glued space, brings.
    fn of(manifold: &Manifold, connection: Connection) -> Self {
        let gluing = manifold
            .gluing_below()
            .filter(|_| manifold.gluing().is_none());
        let reversed = gluing.is_some_and(|gluing| {
            let found = gluing.locate(connection.u);
            found.is_some_and(|(_, word)| gluing.reverses(&word))
        });
        Self {
            connection,
            mirrored: (connection.area < 0.0) != reversed,
        }
    }
}

/// Finds the point and prints where it is.
pub fn run(args: &ProjectArgs, common: &CommonArgs) -> Result<Outcome> {
    let projected = project(args)?;
    match common.json {
        true => terminal::print_json(&projected.as_json())?,
        false => terminal::print(&projected.as_text())?,
    }
    Ok(Outcome::Done)
}

fn project(args: &ProjectArgs) -> Result<Projected> {
    let stage = Stage::load(&args.scene, &args.set)?;
    let name = args.view.as_deref();
    let size = args.size.unwrap_or(usual_size(&stage.camera(name)?.lens));
    let view = stage.view_of(name, size)?;
    if !view.is_central() {
        let message = "parallel rays do not start at one point, and this takes images along geodesics from the camera; `geofan render` draws them";
        return Err(Error::input("the camera", message));
    }
    // Of a glued space the cover: the point has an image in every copy.
    let manifold = stage.world.manifold.developed();
    check_point(&manifold, "--point", args.point)?;
    if args.point == view.u {
        return Err(Error::input("--point", "is where the camera is"));
    }
    let length = manifold.length_or(args.length)?;
    let margin = DVec3::splat(NEIGHBOURHOOD * (args.point - view.u).length());
    let region = (args.point - margin, args.point + margin);
    let fan = LightFan::new(&manifold, view.u, length, region);
    let (found, _) = fan.connections(&[args.point], args.tolerance);
    let images = found.into_iter();
    let images = images.map(|(_, connection)| PointImage::of(&manifold, connection));
    let images = images.collect();
    Ok(Projected {
        local: projection(&stage.world, &view, args.point),
        images,
        length,
        view,
    })
}

impl Projected {
    /// The point of the picture in a direction of the standard frame, where it has one.
    fn pixel(&self, direction: DVec3) -> Option<[f64; 2]> {
        self.view.pixel(direction).map(|(x, y)| [x, y])
    }

    /// The first-order place in the picture.
    fn local_pixel(&self) -> Option<[f64; 2]> {
        self.view.pixel_of(self.local).map(|(x, y)| [x, y])
    }

    fn as_json(&self) -> Value {
        let image = |PointImage {
                         connection: image,
                         mirrored,
                     }: &PointImage| {
            json!({
                "direction": image.direction.to_array(),
                "distance": image.s,
                "area": image.area.abs(),
                "mirrored": mirrored,
                "pixel": self.pixel(image.direction),
                "u": image.u.to_array(),
                "v": image.v.to_array(),
            })
        };
        json!({
            "camera": self.view.u.to_array(),
            "size": [self.view.size.0, self.view.size.1],
            "local": { "p": self.local.to_array(), "pixel": self.local_pixel() },
            "length": self.length,
            "images": self.images.iter().map(image).collect::<Vec<_>>(),
        })
    }

    fn as_text(&self) -> String {
        let p = self.local;
        let mut text = format!(
            "local  right {:.9}, up {:.9}, ahead {:.9}, {}\n",
            p.x,
            p.y,
            -p.z,
            place(self.local_pixel())
        );
        let _ = writeln!(
            text,
            "images up to length {}: {}",
            self.length,
            self.images.len()
        );
        for PointImage {
            connection: image,
            mirrored,
        } in &self.images
        {
            let d = image.direction;
            let side = if *mirrored { ", mirrored" } else { "" };
            let _ = writeln!(
                text,
                "  distance {:.9}, area {:.9}, direction ({:.9}, {:.9}, {:.9}), {}{side}",
                image.s,
                image.area.abs(),
                d.x,
                d.y,
                d.z,
                place(self.pixel(d))
            );
        }
        text
    }
}

/// Says where a pixel is.
fn place(pixel: Option<[f64; 2]>) -> String {
    match pixel {
        Some([x, y]) => format!("pixel ({x:.3}, {y:.3})"),
        None => "no place in the picture".into(),
    }
}
