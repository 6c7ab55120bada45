//! Materials of surfaces.

use super::{OpacityMap, TextureMap};

/// The optical properties of a surface: reflection, transmission, emission.
#[derive(Debug, Clone)]
pub struct Material {
    /// Its name in the MTL file.
    pub name: String,
    /// Diffuse reflectance (`Kd`), linear.
    pub kd: [f32; 3],
    /// Specular reflectance (`Ks`), linear.
    pub ks: [f32; 3],
    /// Phong exponent of the specular part (`Ns`).
    pub ns: f32,
    /// Radiance given off (`Ke`), linear.
    pub ke: [f32; 3],
    /// Opacity (`d`): 1 solid, 0 not there.
    pub dissolve: f32,
    /// Index of refraction (`Ni`).
    pub ni: f32,
    /// The illumination model's number (`illum`): 2 matt and glossy, 3 to 5 mirror, 6 and 7 glass.
    pub illumination: u8,
    /// Texture that multiplies `kd` (`map_Kd`).
    pub map_kd: Option<TextureMap>,
    /// Opacity that multiplies `dissolve`: `map_d`, else what `map_Kd` has beside its colours.
    pub map_d: Option<OpacityMap>,
    /// Texture that multiplies `ke` (`map_Ke`).
    pub map_ke: Option<TextureMap>,
}

impl Default for Material {
    /// Returns a matt light grey.
    fn default() -> Self {
        Self {
            name: String::from("default grey"),
            kd: [0.7; 3],
            ks: [0.0; 3],
            ns: 10.0,
            ke: [0.0; 3],
            dissolve: 1.0,
            ni: 1.5,
            illumination: 2,
            map_kd: None,
            map_d: None,
            map_ke: None,
        }
    }
}

impl Material {
    /// Tells whether it may let light through unturned.
    pub fn is_clear(&self) -> bool {
        self.dissolve < 1.0 || self.map_d.is_some()
    }

    /// Tells whether a texture says what it looks like.
    pub fn is_textured(&self) -> bool {
        self.map_kd.is_some() || self.map_ke.is_some()
    }

    /// Tells whether it turns light that goes through it (`illum` 6 and 7).
    pub fn is_glass(&self) -> bool {
        matches!(self.illumination, 6 | 7)
    }

    /// Returns the most that it stops of the light that does not turn: glass says by `d` that it is clear, not
    /// that it is not there.
    pub fn solid(&self) -> f32 {
        if self.is_glass() { 1.0 } else { self.dissolve }
    }
}
