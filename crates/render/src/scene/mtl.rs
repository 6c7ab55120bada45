//! Material libraries (MTL), and materials with the textures that they name.
//!
//! In: the text. Out: an [`Entry`] for each material, and a warning for every line that makes no
//! sense. A damaged library never stops a mesh from loading.
//!
//! `tobj` parses the text, but panics on a colour of fewer than three numbers, gives up the whole
//! file at the first bad number, and knows one spelling of each word; so each line is checked and
//! mended before `tobj` sees it. What statements mean: *Advanced Visualizer Manual*, *MTL material
//! format*, Wavefront Technologies, 1995.
//!
//! In: an [`Entry`]. Out: a [`Material`] in linear light, with a warning for what of it is
//! not drawn. A texture that cannot be read leaves the material without it.

use super::{
    formats::{Statement, located, statements, without_comment},
    material::{Mapping, Material, OpacityMap, Texture, TextureMap, Wrap},
};
use crate::picture::{self, LayerValues, Picture, srgb_encode};
use ndarray::{Array2, Axis};
use std::{
    collections::{BTreeSet, HashMap},
    path::{Path, PathBuf},
    sync::Arc,
};

/// A material as its library has it.
#[derive(Debug)]
pub(super) struct Entry {
    /// The file that it is in.
    pub library: String,
    /// The material as `tobj` has read it.
    pub material: tobj::Material,
    /// Statements with a meaning that is not drawn, in the spelling of the file.
    pub left_out: BTreeSet<String>,
}

/// Returns the materials of the library that the user calls `name`, in order.
pub(super) fn entries(name: &str, text: &str, warnings: &mut Vec<String>) -> Vec<Entry> {
    let mut mended = Mended::default();
    for statement in statements(text) {
        let known = mended.add(&statement).is_some();
        let Statement {
            line, key, whole, ..
        } = statement;
        let written = format!("{key} {whole}");
        let written = written.trim_end();
        if !known {
            warnings.push(format!("{name}:{line}: ignored `{written}`"));
        } else if is_too_bright(key, whole) {
            warnings.push(format!(
                "{name}:{line}: `{written}` gives back more light than comes: numbers from 0 to 1 do not"
            ));
        }
    }
    let (materials, _) = match tobj::load_mtl_buf(&mut mended.text.as_bytes()) {
        Ok(read) => read,
        Err(error) => {
            warnings.push(format!("materials left out: {name}: {error}"));
            return Vec::new();
        }
    };
    let entry = |(material, left_out)| Entry {
        library: name.to_owned(),
        material,
        left_out,
    };
    materials
        .into_iter()
        .zip(mended.left_out)
        .map(entry)
        .collect()
}

/// Tells whether a surface of this colour gives back more light than comes.
fn is_too_bright(key: &str, rest: &str) -> bool {
    let numbers = rest.split_whitespace().map_while(|x| x.parse::<f64>().ok());
    ["kd", "ks"].contains(&key.to_ascii_lowercase().as_str()) && numbers.fold(0.0, f64::max) > 1.0
}

/// A text that `tobj` reads all of.
#[derive(Default)]
struct Mended {
    text: String,
    /// Words left out, of each material so far.
    left_out: Vec<BTreeSet<String>>,
    /// Set if the present material has a `d`, which counts more than its `Tr`.
    dissolved: bool,
}

/// Statements that change how a surface looks in ways that are not drawn.
const NOT_DRAWN: &[&str] = &[
    "tf", "map_ka", "map_ks", "map_ns", "map_tr", "map_bump", "bump", "norm", "map_kn", "disp",
    "map_disp", "decal", "refl", "map_refl", "pr", "map_pr", "pm", "map_pm", "ps", "map_ps", "pc",
    "pcr", "aniso", "anisor",
];

impl Mended {
    /// Adds a statement; `None` if it makes no sense.
    fn add(&mut self, statement: &Statement<'_>) -> Option<()> {
        let &Statement {
            key, whole, rest, ..
        } = statement;
        let lower = key.to_ascii_lowercase();
        if lower == "newmtl" {
            (!whole.is_empty()).then_some(())?;
            self.left_out.push(BTreeSet::new());
            self.dissolved = false;
        }
        // What stands before the first material belongs to none.
        let Some(left_out) = self.left_out.last_mut() else {
            return Some(());
        };
        if NOT_DRAWN.contains(&lower.as_str()) && !is_nothing(&lower, rest) {
            left_out.insert(key.to_owned());
        }
        let line = line(&lower, whole, rest)?;
        if lower == "tr" && self.dissolved {
            return Some(());
        }
        self.dissolved |= lower == "d";
        self.text.push_str(&line);
        self.text.push('\n');
        Some(())
    }
}

/// Returns a statement as `tobj` can read it, empty if it is none of its business; `None` if it makes no sense.
fn line(key: &str, whole: &str, rest: &str) -> Option<String> {
    let number = || not_negative(rest.split_whitespace().next()?);
    Some(match key {
        "newmtl" => format!("newmtl {whole}"),
        "kd" | "ks" | "ke" => {
            let [r, g, b] = colour(rest)?;
            format!("{} {r} {g} {b}", capitalised(key))
        }
        "ns" | "ni" => format!("{} {}", capitalised(key), number()?),
        "illum" => format!("illum {}", number()?.min(255.0) as u8),
        // `-halo` may stand before the number.
        "d" => {
            let last = not_negative(rest.split_whitespace().last()?)?;
            format!("d {}", last.min(1.0))
        }
        "tr" => format!("d {}", 1.0 - number()?.min(1.0)),
        "map_kd" | "map_ke" | "map_d" => {
            (!whole.is_empty()).then_some(())?;
            let of = match key {
                "map_d" => String::from("d"),
                _ => capitalised(&key[4..]),
            };
            format!("map_{of} {whole}")
        }
        _ => String::new(),
    })
}

/// Returns the key as `tobj` knows it.
fn capitalised(key: &str) -> String {
    let (first, rest) = key.split_at(1);
    first.to_ascii_uppercase() + rest
}

/// Tells whether a statement says what is so without it.
fn is_nothing(key: &str, words: &str) -> bool {
    let numbers: Vec<f32> = words
        .split_whitespace()
        .filter_map(|w| w.parse().ok())
        .collect();
    let all = |value: f32| !numbers.is_empty() && numbers.iter().all(|x| *x == value);
    match key {
        "tf" => all(1.0) || all(0.0),
        "pr" | "pm" | "ps" | "pc" | "pcr" | "aniso" | "anisor" => all(0.0),
        _ => words.is_empty(),
    }
}

/// Reads red, green and blue: given, or a grey, or by CIE's X, Y and Z. Curves of a spectrum are not read.
fn colour(words: &str) -> Option<[f32; 3]> {
    let xyz = words
        .strip_prefix("xyz")
        .filter(|rest| rest.starts_with(char::is_whitespace));
    let numbers = xyz.unwrap_or(words).split_whitespace();
    let given: Option<Vec<f32>> = numbers.map(not_negative).collect();
    let three = match given?.as_slice() {
        [grey] => [*grey; 3],
        // A fourth is opacity in the hands of those who write one.
        [r, g, b] | [r, g, b, _] => [*r, *g, *b],
        _ => return None,
    };
    Some(if xyz.is_some() {
        from_xyz(three)
    } else {
        three
    })
}

/// Computes linear light with Rec. 709 primaries and a D65 white (IEC 61966-2-1).
fn from_xyz([x, y, z]: [f32; 3]) -> [f32; 3] {
    let rows = [
        [3.240_97, -1.537_383_2, -0.498_610_76],
        [-0.969_243_6, 1.875_967_5, 0.041_555_06],
        [0.055_630_08, -0.203_976_96, 1.056_971_5],
    ];
    rows.map(|[a, b, c]: [f32; 3]| (a * x + b * y + c * z).max(0.0))
}

fn not_negative(word: &str) -> Option<f32> {
    let number = word.parse().ok();
    number.filter(|x: &f32| x.is_finite() && *x >= 0.0)
}

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
    /// Set if its file has code values, not light.
    is_coded: bool,
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
        let loaded = match picture::read_with_coding(&path) {
            Ok((picture, is_coded)) => Loaded::of(picture, is_coded),
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
    /// Takes a picture, from a file with code values or one with light; `None` if it has no pixel.
    pub(super) fn of(picture: Picture, is_coded: bool) -> Option<Self> {
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
            is_coded,
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
        let value = |light: f32| match self.is_coded {
            true => srgb_encode(light),
            false => light,
        };
        let number = |rgb: ndarray::ArrayView1<'_, f32>| {
            (0..3).map(|c| weights[c] * value(rgb[c])).sum::<f32>()
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
                let beside = match word.eq_ignore_ascii_case("on") {
                    true => Wrap::Clamp,
                    false => Wrap::Repeat,
                };
                mapping.wrap = [beside; 2];
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

    fn read(text: &str) -> (Vec<Entry>, Vec<String>) {
        let mut warnings = Vec::new();
        (entries("a.mtl", text, &mut warnings), warnings)
    }

    #[test]
    fn lines_that_make_no_sense_are_named_and_the_others_count() {
        let text = "newmtl a\nKd 0.5\nKs 1 2\nNs x\n\td -halo 0.3\nKe nan 0 0\nnewmtl\nillum\n";
        let (entries, warnings) = read(text);
        let [Entry { material, .. }] = entries.as_slice() else {
            panic!("{entries:?}")
        };
        assert_eq!(
            (material.diffuse, material.specular),
            (Some([0.5; 3]), None)
        );
        assert_eq!(
            material.dissolve,
            Some(0.3_f32.to_string().parse().unwrap())
        );
        let known = [
            "3: ignored `Ks 1 2`",
            "4: ignored `Ns x`",
            "6: ignored `Ke nan 0 0`",
            "7: ignored `newmtl`",
            "8: ignored `illum`",
        ];
        assert_eq!(warnings, known.map(|w| format!("a.mtl:{w}")));
    }

    #[test]
    fn colours_that_give_back_more_than_comes_are_told() {
        let (_, warnings) = read("newmtl a\nKd 255 10 0\nKe 9 9 9\nks 1 1 1.5\n");
        let lines: Vec<_> = warnings.iter().map(|w| &w[..7]).collect();
        assert_eq!(lines, ["a.mtl:2", "a.mtl:4"]);
    }

    #[test]
    fn words_in_any_capitals_and_comments_behind_numbers_are_read() {
        let (entries, warnings) =
            read("NEWMTL a b\nKD 1 0 0 # red\nmap_KD my wood.png\nMAP_D m.png\nillum 4.0\n");
        assert!(warnings.is_empty(), "{warnings:?}");
        let material = &entries[0].material;
        assert_eq!(material.name, "a b");
        assert_eq!(material.diffuse, Some([1.0, 0.0, 0.0]));
        assert_eq!(material.diffuse_texture.as_deref(), Some("my wood.png"));
        assert_eq!(material.dissolve_texture.as_deref(), Some("m.png"));
        assert_eq!(material.illumination_model, Some(4));
    }

    #[test]
    fn dissolve_counts_more_than_transparency_in_either_order() {
        for (text, known) in [
            ("d 0.25\nTr 0.5", 0.25),
            ("Tr 0.5\nd 0.25", 0.25),
            ("Tr 0.75", 0.25),
        ] {
            let (entries, _) = read(&format!("newmtl a\n{text}\n"));
            assert_eq!(entries[0].material.dissolve, Some(known), "{text}");
        }
    }

    #[test]
    fn what_is_not_drawn_is_noted_once_for_each_material() {
        let text = "newmtl a\nTf 1 1 1\nmap_Bump b.png\nmap_Bump c.png\nrefl -type sphere s.png\n\
                    Pr 0.0\nPm 1.0\nKa 1 1 1\nnewmtl b\n";
        let (entries, _) = read(text);
        let of =
            |i: usize| -> Vec<&str> { entries[i].left_out.iter().map(String::as_str).collect() };
        assert_eq!((of(0), of(1)), (vec!["Pm", "map_Bump", "refl"], vec![]));
    }

    #[test]
    fn colours_by_xyz_become_red_green_and_blue() {
        let (entries, _) = read("newmtl white\nKd xyz 0.95047 1 1.08883\n");
        let white = entries[0].material.diffuse.unwrap();
        assert!(white.iter().all(|x| (x - 1.0).abs() < 1e-3), "{white:?}");
    }

    #[test]
    fn options_stand_before_names_which_may_hold_spaces() {
        let map =
            Map::of("-blendu off -s 2 3 1 -o 0.5 -clamp on -imfchan g -mm 0.1 2 my  wood 2.png");
        assert_eq!(map.name, "my  wood 2.png");
        let known = Mapping {
            cross: [0.0; 2],
            scale: [2.0, 3.0],
            offset: [0.5, 0.0],
            wrap: [Wrap::Clamp; 2],
            nearest: false,
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
