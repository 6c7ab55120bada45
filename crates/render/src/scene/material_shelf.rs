//! Materials, and the textures that MTL files name.
//!
//! In: an [`Entry`] of a library. Out: a [`Material`] in linear light, with a warning for what of it is
//! not drawn. A texture that cannot be read leaves the material without it.

use super::{
    libraries::located,
    material::Material,
    mtl::Entry,
    text::without_comment,
    texture::{Mapping, OpacityMap, Texture, TextureMap},
};
use crate::picture::{self, LayerValues, Picture, srgb_encode};
use ndarray::{Array2, Axis};
use std::{
    collections::{BTreeSet, HashMap},
    path::{Path, PathBuf},
    sync::Arc,
};

/// Reads textures, each file once.
#[derive(Default)]
pub(super) struct Shelf {
    loaded: HashMap<PathBuf, Option<Loaded>>,
}

/// A picture as colours and as opacity.
#[derive(Clone)]
pub(super) struct Loaded {
    pub picture: Arc<Picture>,
    pub texture: Arc<Texture>,
    /// Its own opacity, if that is not the same everywhere.
    pub alpha: Option<Arc<Array2<f32>>>,
}

/// The map of a material: its name and options.
struct Map<'a> {
    /// The text behind the options.
    name: &'a str,
    mapping: Mapping,
    /// The channel that is an opacity (`-imfchan`).
    channel: Option<char>,
}

impl Shelf {
    /// Returns the material of an entry; textures are looked for in `folders`, the library's first.
    pub(super) fn material(
        &mut self,
        entry: &Entry,
        folders: &[&Path],
        warnings: &mut Vec<String>,
    ) -> Material {
        let from = &entry.material;
        let grey = Material::default();
        let three = |c: Option<[f64; 3]>| c.map(|c| c.map(|x| x as f32));
        let one = |x: Option<f64>, otherwise: f32| x.map_or(otherwise, |x| x as f32);
        let (library, name) = (&entry.library, &from.name);
        let mut say = |text: &str| warnings.push(format!("{library}: material `{name}`: {text}"));
        if !entry.left_out.is_empty() {
            let all: Vec<&str> = entry.left_out.iter().map(String::as_str).collect();
            say(&format!("{} not drawn", all.join(", ")));
        }
        let map_kd = from.diffuse_texture.as_deref();
        let map_kd = map_kd.and_then(|map| self.read(map, folders, &mut say));
        let map_d = from.dissolve_texture.as_deref();
        let map_d = map_d.and_then(|map| self.read(map, folders, &mut say));
        let map_ke = from.unknown_param.get("map_Ke");
        let map_ke = map_ke.and_then(|map| self.read(map, folders, &mut say));
        let dark = if map_ke.is_some() { [1.0; 3] } else { grey.ke };
        let mut kd = three(from.diffuse);
        let shines = map_ke.is_some() || from.emissive.is_some_and(|ke| ke != [0.0; 3]);
        if map_kd.is_some() && kd == Some([0.0; 3]) && !shines {
            // Maya writes black for what a texture is to decide.
            say("its texture is used although Kd is black");
            kd = None;
        }
        let plain = if map_kd.is_some() { [1.0; 3] } else { grey.kd };
        let opacity = match (&map_d, &map_kd) {
            (Some((loaded, map)), _) => Some(loaded.opacity(map)),
            (None, Some((loaded, map))) => loaded.alpha_with(map),
            (None, None) => None,
        };
        let dissolve = one(from.dissolve, grey.dissolve);
        if dissolve == 0.0 && !matches!(from.illumination_model, Some(6 | 7)) {
            say("is not there at all (d 0 or Tr 1)");
        }
        Material {
            name: from.name.clone(),
            kd: kd.unwrap_or(plain),
            ks: three(from.specular).unwrap_or(grey.ks),
            ns: one(from.shininess, grey.ns),
            ke: three(from.emissive).unwrap_or(dark),
            dissolve,
            ni: one(from.optical_density, grey.ni),
            illumination: from.illumination_model.unwrap_or(grey.illumination),
            map_kd: map_kd.map(colours),
            map_d: opacity,
            map_ke: map_ke.map(colours),
        }
    }

    /// Returns a white material with the texture `name`, which is in `folder`, for the mesh `library`.
    pub(super) fn textured(
        &mut self,
        name: &str,
        (library, folder): (&str, &Path),
        warnings: &mut Vec<String>,
    ) -> Material {
        let entry = Entry {
            library: library.to_owned(),
            material: tobj::Material {
                name: name.to_owned(),
                diffuse: Some([1.0; 3]),
                diffuse_texture: Some(name.to_owned()),
                ..Default::default()
            },
            left_out: BTreeSet::new(),
        };
        self.material(&entry, &[folder], warnings)
    }

    /// Returns the picture that `map` names, with its options.
    fn read<'a>(
        &mut self,
        map: &'a str,
        folders: &[&Path],
        say: &mut dyn FnMut(&str),
    ) -> Option<(Loaded, Map<'a>)> {
        let map = Map::of(map);
        let bare = without_comment(map.name);
        let path = located(map.name, folders).or_else(|| located(bare, folders));
        let path = path.unwrap_or_else(|| folders[0].join(map.name.replace('\\', "/")));
        if let Some(known) = self.loaded.get(&path) {
            return known.clone().map(|loaded| (loaded, map));
        }
        let loaded = match picture::read(&path) {
            Ok(picture) => Loaded::of(picture),
            Err(error) => {
                say(&format!("texture left out: {error}"));
                None
            }
        };
        self.loaded.insert(path, loaded.clone());
        loaded.map(|loaded| (loaded, map))
    }
}

/// Returns a picture laid on a surface.
fn colours((loaded, map): (Loaded, Map<'_>)) -> TextureMap {
    TextureMap {
        texture: loaded.texture,
        mapping: map.mapping,
    }
}

impl Loaded {
    /// Takes a picture; `None` if it has no pixel.
    pub(super) fn of(picture: Picture) -> Option<Self> {
        let alpha = match picture.layer("A") {
            Some(LayerValues::Float(alpha)) => Some(alpha.clone()),
            _ => None,
        };
        // All of one kind says nothing: many programs leave it so by mistake.
        let says =
            |alpha: &Array2<f32>| alpha.iter().any(|a| *a < 1.0) && alpha.iter().any(|a| *a > 0.0);
        Some(Self {
            texture: Arc::new(Texture::new(picture.rgb.clone())?),
            alpha: alpha.filter(says).map(Arc::new),
            picture: Arc::new(picture),
        })
    }

    fn alpha_with(&self, map: &Map<'_>) -> Option<OpacityMap> {
        let values = self.alpha.clone()?;
        // `-mm` is about colours.
        let mapping = Mapping {
            range: Mapping::default().range,
            ..map.mapping
        };
        Some(OpacityMap { values, mapping })
    }

    /// Returns the opacity in a picture: what it has beside its colours, else its luminance, unless the
    /// options name a channel.
    fn opacity(&self, map: &Map<'_>) -> OpacityMap {
        let values = match (map.channel, &self.alpha) {
            (None | Some('m'), Some(alpha)) => alpha.clone(),
            (channel, _) => Arc::new(self.scalar(channel)),
        };
        OpacityMap {
            values,
            mapping: map.mapping,
        }
    }

    /// Returns a channel's numbers as the file has them, which are not light.
    fn scalar(&self, channel: Option<char>) -> Array2<f32> {
        let weights = match channel {
            Some('r') => [1.0, 0.0, 0.0],
            Some('g') => [0.0, 1.0, 0.0],
            Some('b') => [0.0, 0.0, 1.0],
            _ => [0.2126, 0.7152, 0.0722],
        };
        let number = |rgb: ndarray::ArrayView1<'_, f32>| {
            (0..3)
                .map(|c| weights[c] * srgb_encode(rgb[c]))
                .sum::<f32>()
        };
        self.picture.rgb.map_axis(Axis(2), number)
    }
}

impl<'a> Map<'a> {
    /// Parts the options from the name, which may hold spaces.
    fn of(text: &'a str) -> Self {
        let mut map = Self {
            name: text.trim(),
            mapping: Mapping::default(),
            channel: None,
        };
        while let Some((option, rest)) = map.name.split_once(char::is_whitespace) {
            let Some(rest) = map.option(option, rest.trim_start()) else {
                break;
            };
            map.name = rest;
        }
        map.name = map.name.trim_matches('"');
        map
    }

    /// Takes an option and its words; what is left, or `None` if it is none and the name begins.
    fn option(&mut self, option: &str, rest: &'a str) -> Option<&'a str> {
        let mapping = &mut self.mapping;
        match option {
            "-s" => {
                let (given, rest) = numbers::<3>(rest);
                let kept = mapping.scale;
                mapping.scale = [0, 1].map(|k| given[k].unwrap_or(kept[k]));
                Some(rest)
            }
            "-o" => {
                let (given, rest) = numbers::<3>(rest);
                let kept = mapping.offset;
                mapping.offset = [0, 1].map(|k| given[k].unwrap_or(kept[k]));
                Some(rest)
            }
            "-mm" => {
                let (given, rest) = numbers::<2>(rest);
                mapping.range = [0, 1].map(|k| given[k].unwrap_or(mapping.range[k]));
                Some(rest)
            }
            "-clamp" => {
                let (word, rest) = word(rest)?;
                mapping.clamp = word.eq_ignore_ascii_case("on");
                Some(rest)
            }
            "-imfchan" => {
                let (word, rest) = word(rest)?;
                self.channel = word.chars().next();
                Some(rest)
            }
            // How finely, how sharply, by which program: nothing that a picture here depends on.
            "-blendu" | "-blendv" | "-cc" | "-texres" | "-boost" | "-bm" | "-type" => {
                word(rest).map(|(_, rest)| rest)
            }
            // Turbulence moves a texture about at random.
            "-t" => Some(numbers::<3>(rest).1),
            _ => None,
        }
    }
}

/// Returns the first word, and what follows it; `None` if nothing does.
fn word(text: &str) -> Option<(&str, &str)> {
    let (word, rest) = text.split_once(char::is_whitespace)?;
    Some((word, rest.trim_start()))
}

/// As many numbers as there are, at most `N`, and what follows, which is never nothing.
fn numbers<const N: usize>(mut text: &str) -> ([Option<f32>; N], &str) {
    let mut found = [None; N];
    for slot in &mut found {
        let next = word(text).and_then(|(word, rest)| Some((word.parse().ok()?, rest)));
        let Some((number, rest)) = next.filter(|(number, _): &(f32, _)| number.is_finite()) else {
            break;
        };
        (*slot, text) = (Some(number), rest);
    }
    (found, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_stand_before_names_which_may_hold_spaces() {
        let map =
            Map::of("-blendu off -s 2 3 1 -o 0.5 -clamp on -imfchan g -mm 0.1 2 my  wood 2.png");
        assert_eq!(map.name, "my  wood 2.png");
        let known = Mapping {
            scale: [2.0, 3.0],
            offset: [0.5, 0.0],
            clamp: true,
            range: [0.1, 2.0],
        };
        assert_eq!((map.mapping, map.channel), (known, Some('g')));
    }

    #[test]
    fn names_that_look_like_options_or_numbers_stay_names() {
        for name in ["-wood.png", "7", "-s", "wood -s 2.png", "-odd name.png"] {
            assert_eq!(Map::of(name).name, name);
        }
        assert_eq!(Map::of("-s 2 2 2 7").name, "7");
        assert_eq!(Map::of("-s 2 7").name, "7");
        assert_eq!(Map::of("-bm 1 \"a b.png\"").name, "a b.png");
    }
}
