//! Material libraries (MTL).
//!
//! In: the text. Out: an [`Entry`] for each material, and a warning for every line that makes no
//! sense. A damaged library never stops a mesh from loading.
//!
//! `tobj` parses the text, but panics on a colour of fewer than three numbers, gives up the whole
//! file at the first bad number, and knows one spelling of each word; so each line is checked and
//! mended before `tobj` sees it. What statements mean: *Advanced Visualizer Manual*, *MTL material
//! format*, Wavefront Technologies, 1995.

use super::text::{Statement, statements};
use std::collections::BTreeSet;

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
        if mended.add(&statement).is_none() {
            let Statement {
                line, key, whole, ..
            } = statement;
            warnings.push(format!(
                "{name}:{line}: ignored `{}`",
                format!("{key} {whole}").trim_end()
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
        let lower = key.to_lowercase();
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
    first.to_uppercase() + rest
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
}
