//! `geofan info --at`: the differential geometry of a manifold at one point.

use geofan_core::{
    Result,
    geodesic::check_point,
    manifold::{Curvature, Manifold},
};
use glam::{DMat3, DVec3};
use serde_json::{Value, json};
use std::fmt::Write;

/// Everything known at one point of the chart.
pub struct Place {
    u: DVec3,
    curvature: Curvature,
    frame: DMat3,
    /// `Ω(∂_k)` for each coordinate.
    connection: [DMat3; 3],
}

impl Place {
    /// Refuses a point outside the domain.
    pub fn new(manifold: &Manifold, u: DVec3) -> Result<Self> {
        check_point(manifold, "--at", u)?;
        Ok(Self {
            u,
            curvature: manifold.curvature(u)?,
            frame: manifold.standard_frame(u),
            connection: manifold.connection(u),
        })
    }

    /// Matrices by rows, but `frame` as three vectors; `christoffel[k][i][j]` is Γ^k_ij,
    /// `connection[k]` is Ω(∂_k) in the standard frame, `riemann[a][b][c][d]` is R_abcd.
    pub fn as_json(&self) -> Value {
        let Curvature {
            metric,
            inverse,
            christoffel,
            riemann,
            ricci,
            scalar,
            ..
        } = &self.curvature;
        json!({
            "u": self.u.to_array(),
            "metric": rows(*metric),
            "inverse": rows(*inverse),
            "frame": self.frame.to_cols_array_2d(),
            "christoffel": christoffel,
            "connection": self.connection.map(rows),
            "riemann": riemann,
            "ricci": rows(*ricci),
            "scalar": scalar,
        })
    }

    /// The same in words; the Riemann tensor as its independent components.
    pub fn as_text(&self, names: &[String; 3]) -> String {
        let mut text = String::new();
        let mut matrix = |name: &str, rows| text += &block(name, rows);
        matrix("metric", rows(self.curvature.metric));
        matrix("inverse metric", rows(self.curvature.inverse));
        matrix("standard frame (columns)", rows(self.frame));
        for (name, gamma) in names.iter().zip(self.curvature.christoffel) {
            matrix(&format!("Christoffel symbols Γ^{name}_ij"), gamma);
        }
        for (name, omega) in names.iter().zip(self.connection) {
            let title = format!("connection Ω(∂_{name}) in the standard frame");
            matrix(&title, rows(omega));
        }
        text += &self.riemann(names);
        text += &block("Ricci curvature", rows(self.curvature.ricci));
        let _ = writeln!(text, "scalar curvature {}", self.curvature.scalar);
        text
    }

    /// R_abcd for the planes (x, y), (x, z), (y, z): six numbers give all.
    fn riemann(&self, names: &[String; 3]) -> String {
        let planes = [(0, 1), (0, 2), (1, 2)];
        let mut text = String::from("Riemann curvature R_abcd\n");
        for (i, (a, b)) in planes.into_iter().enumerate() {
            for (c, d) in &planes[i..] {
                let [a_, b_, c_, d_] = [a, b, *c, *d].map(|k| names[k].as_str());
                let value = self.curvature.riemann[a][b][*c][*d];
                let _ = writeln!(text, "  {a_} {b_} {c_} {d_} {value:>16.9e}");
            }
        }
        text
    }
}

fn rows(m: DMat3) -> [[f64; 3]; 3] {
    m.transpose().to_cols_array_2d()
}

fn block(name: &str, rows: [[f64; 3]; 3]) -> String {
    let mut text = format!("{name}\n");
    for row in rows {
        // No negative zeros.
        let [a, b, c] = row.map(|x| x + 0.0);
        let _ = writeln!(text, "  {a:>16.9e} {b:>16.9e} {c:>16.9e}");
    }
    text
}
