//! OBJ texts as triangles, in one pass.
//!
//! In: the text. Out: [`Obj`]: its vertices, with colours in linear light, and its faces as triangles with single
//! vertices for what stands at their corners ([`Triangulated`]); or an error at the first line that makes the mesh
//! meaningless (a number that is not finite, an index that points nowhere).
//!
//! Exporters write much that means nothing, and it does not stop the reading: what is left out or mended is counted in
//! a [`Tally`], a line for each kind, however often it occurs. Faces are cut as they should be (see
//! [`super::polygon`]). A million triangles are read in a third of a second.
//!
//! What statements mean: *Advanced Visualizer Manual*, appendix B1, Wavefront Technologies, 1992. Of `v` lines:
//!
//! | numbers | meaning |
//! |---|---|
//! | 3 | position |
//! | 4 | position and weight: homogeneous coordinates, to be divided by the last |
//! | 6, 7 | position and red, green, blue, perhaps opacity |
//!
//! Colours are no part of the format's specification. MeshLab, Blender, Meshmixer and ZBrush write
//! them as a screen shows them (sRGB), in [0, 1] or as bytes; ZBrush in comments of its own, eight
//! hexadecimal digits a vertex: mask, red, green, blue.

use super::{
    formats::{PAINT, Statement, statements},
    polygon::Cutter,
    smoothing::{FLAT, SmoothingKey},
};
use crate::picture::srgb_decode;
use geofan_core::error::{Error, Result};
use glam::DVec3;
use std::{
    collections::{BTreeMap, HashMap},
    num::NonZero,
};

/// Vertex, texture coordinates and normal of a corner, counted from 1; 0 for none.
pub(super) type Corner = [u32; 3];

/// A face as the text has it.
#[derive(Debug, Clone, Copy)]
struct ObjFace {
    /// Where its corners end.
    end: usize,
    line: usize,
    /// Number of the name after `usemtl`, if it names any.
    material: Option<u32>,
    /// Smoothing group; `None` where the file has not named one.
    group: Option<u32>,
}

/// The contents of an OBJ text.
#[derive(Default)]
pub(super) struct Obj<'a> {
    /// Names after `usemtl`, each once, with comments that may be part of them.
    pub names: Vec<&'a str>,
    /// Their numbers.
    numbers: HashMap<&'a str, u32>,
    /// The text after each `mtllib`.
    pub libraries: Vec<&'a str>,
    /// Counts of what is left out.
    pub tally: Tally,
    /// Vertices, texture coordinates and normals so far.
    vertices: Vertices,
    counts: [usize; 3],
    /// The largest index used of each, and its line.
    largest: [(usize, usize); 3],
    corners: Vec<Corner>,
    faces: Vec<ObjFace>,
    material: Option<u32>,
    group: Option<u32>,
    coordinates: Vec<[f32; 2]>,
    normals: Vec<DVec3>,
}

/// The faces as triangles.
pub(super) struct Triangulated {
    /// The corners that differ, in the order in which triangles come to them: the vertices of the mesh.
    pub vertices: Vec<Corner>,
    /// Numbers of each triangle's corners among them.
    pub triangles: Vec<[u32; 3]>,
    /// Number of the name of each triangle's material.
    pub material_of: Vec<Option<u32>>,
    /// For each triangle, the normals it shares.
    pub smoothing: Vec<SmoothingKey>,
}

const KINDS: [&str; 3] = ["vertices", "texture coordinates", "normals"];

impl<'a> Obj<'a> {
    /// Reads the statements of the text that the user calls `name`.
    pub(super) fn of(name: &str, text: &'a str) -> Result<Self> {
        let mut obj = Self::default();
        for statement in statements(text) {
            let read = obj.statement(&statement);
            let line = statement.line;
            read.map_err(|message| Error::input(format!("{name}:{line}"), message))?;
        }
        for (kind, (index, line)) in obj.largest.into_iter().enumerate() {
            if index > obj.counts[kind] {
                let (count, what) = (obj.counts[kind], KINDS[kind]);
                let message = format!("index {index}, but the file has {count} {what}");
                return Err(Error::input(format!("{name}:{line}"), message));
            }
        }
        Ok(obj)
    }

    fn statement(&mut self, statement: &Statement<'a>) -> Result<(), String> {
        let &Statement {
            line,
            key,
            whole,
            rest,
        } = statement;
        match key {
            "v" => {
                self.counts[0] += 1;
                self.vertices.add(rest, line, &mut self.tally)?;
            }
            "vt" => self.coordinate(rest)?,
            "vn" => self.normal(rest)?,
            // `fo` is what faces were called before version 3.
            "f" | "fo" => self.face(rest, line)?,
            "s" => self.group = Some(smoothing_group(rest)),
            "usemtl" => self.material = self.name(whole),
            "mtllib" if !whole.is_empty() => self.libraries.push(whole),
            PAINT => self.vertices.paint(whole),
            key => self.tally.leave_out(key, line),
        }
        Ok(())
    }

    fn coordinate(&mut self, words: &str) -> Result<(), String> {
        // The third number is for textures that fill space.
        let mut given = [0.0; 2];
        let mut count = 0;
        for word in words.split_whitespace() {
            let number = number(word)?;
            if let Some(place) = given.get_mut(count) {
                *place = if number.is_finite() { number } else { 0.0 };
            }
            count += 1;
        }
        if count == 0 {
            return Err(String::from("texture coordinates need a number at least"));
        }
        self.counts[1] += 1;
        self.coordinates.push(given.map(|x| x as f32));
        Ok(())
    }

    fn normal(&mut self, words: &str) -> Result<(), String> {
        let mut given = [0.0; 3];
        let mut count = 0;
        for (place, word) in given.iter_mut().zip(words.split_whitespace()) {
            *place = number(word)?;
            count += 1;
        }
        if count < 3 {
            return Err(String::from("a normal needs three numbers"));
        }
        self.counts[2] += 1;
        self.normals.push(DVec3::from_array(given));
        Ok(())
    }

    fn face(&mut self, words: &str, line: usize) -> Result<(), String> {
        let first = self.corners.len();
        for word in words.split_whitespace() {
            let corner = self.corner(word, line)?;
            self.corners.push(corner);
        }
        match self.corners.len() - first {
            0 => return Err(String::from("a face without corners")),
            1 | 2 => {
                self.corners.truncate(first);
                self.tally.slivers += 1;
                return Ok(());
            }
            _ => {}
        }
        // A face whose corners have normals in part has none: they would not fit together.
        if self.corners[first..].iter().any(|c| c[2] == 0) {
            self.corners[first..].iter_mut().for_each(|c| c[2] = 0);
        }
        self.faces.push(ObjFace {
            end: self.corners.len(),
            line,
            material: self.material,
            group: self.group,
        });
        Ok(())
    }

    fn corner(&mut self, word: &str, line: usize) -> Result<Corner, String> {
        let mut corner = [0; 3];
        for (kind, word) in word.split('/').enumerate() {
            if kind == 3 {
                return Err(String::from("a corner has more than three indices"));
            }
            if !word.is_empty() {
                corner[kind] = self.index(kind, word, line)?;
            }
        }
        match corner[0] {
            0 => Err(String::from("a corner has no vertex")),
            _ => Ok(corner),
        }
    }

    /// Returns an index counted from 1, whichever way it is written.
    fn index(&mut self, kind: usize, word: &str, line: usize) -> Result<u32, String> {
        let index: i64 = word
            .parse()
            .map_err(|_| format!("`{word}` is not an index"))?;
        let known = self.counts[kind];
        let back = usize::try_from(index.unsigned_abs()).unwrap_or(usize::MAX);
        let found = match index {
            0 => return Err(String::from("index 0, but indices start at 1")),
            1.. => back,
            _ if back > known => {
                let what = KINDS[kind];
                let message = format!("index {index}, but only {known} {what} come before");
                return Err(message);
            }
            _ => known + 1 - back,
        };
        // Later lines may still define it, so the comparison waits for the end.
        if found > self.largest[kind].0 {
            self.largest[kind] = (found, line);
        }
        // What does not fit is too large for any file, and refused at its end.
        Ok(u32::try_from(found).unwrap_or(u32::MAX))
    }

    /// Returns the number of a material's name; none where the name is empty, as Blender writes it.
    fn name(&mut self, name: &'a str) -> Option<u32> {
        if name.is_empty() {
            return None;
        }
        let next = self.names.len() as u32;
        let number = *self.numbers.entry(name).or_insert(next);
        if number == next {
            self.names.push(name);
        }
        Some(number)
    }

    /// Returns linear red, green, blue and opacity of every vertex, if any has a colour.
    pub(super) fn colours(&mut self) -> Vec<[f32; 4]> {
        self.vertices.colours(&mut self.tally)
    }

    /// Returns the position of a corner.
    pub(super) fn position(&self, corner: Corner) -> DVec3 {
        self.vertices.position(corner[0])
    }

    /// Returns the texture coordinates of a corner; zero where it has none.
    pub(super) fn uv(&self, corner: Corner) -> [f32; 2] {
        let number = (corner[1] as usize).checked_sub(1);
        number.map_or([0.0; 2], |number| self.coordinates[number])
    }

    /// Returns the normal of a corner as it is written; zero where it has none.
    pub(super) fn normal_of(&self, corner: Corner) -> DVec3 {
        let number = (corner[2] as usize).checked_sub(1);
        number.map_or(DVec3::ZERO, |number| self.normals[number])
    }

    /// Cuts the faces into triangles.
    pub(super) fn triangulated(&mut self) -> Triangulated {
        let mut made = Triangulated {
            vertices: Vec::with_capacity(self.counts[0]),
            triangles: Vec::with_capacity(self.faces.len()),
            material_of: Vec::with_capacity(self.faces.len()),
            smoothing: Vec::with_capacity(self.faces.len()),
        };
        let mut numbers = CornerNumbers::new(self.counts[0]);
        let mut cutter = Cutter::default();
        let (mut points, mut triangles) = (Vec::new(), Vec::new());
        let mut begin = 0;
        for (number, face) in self.faces.iter().enumerate() {
            let corners = &self.corners[begin..face.end];
            begin = face.end;
            points.clear();
            points.extend(corners.iter().map(|c| self.vertices.position(c[0])));
            if !cutter.cut(&points, &mut triangles) {
                self.tally.cross(face.line);
            }
            for triangle in &triangles {
                let vertex = |k: u32| numbers.of(corners[k as usize], &mut made.vertices);
                made.triangles.push(triangle.map(vertex));
                made.material_of.push(face.material);
                made.smoothing.push(SmoothingKey {
                    face: number as u32,
                    group: face.group,
                });
            }
        }
        made
    }
}

/// Numbers of corners in the order in which they are met.
struct CornerNumbers {
    /// For each vertex of the text, the number of the first corner met that is there.
    first: Vec<Option<NonZero<u32>>>,
    /// Those of other corners.
    others: HashMap<Corner, NonZero<u32>>,
}

impl CornerNumbers {
    fn new(vertices: usize) -> Self {
        Self {
            first: vec![None; vertices],
            others: HashMap::new(),
        }
    }

    /// Returns the number of a corner in the list `met`, to which it is added unless it is there.
    fn of(&mut self, corner: Corner, met: &mut Vec<Corner>) -> u32 {
        let next = NonZero::<u32>::MIN.saturating_add(met.len() as u32);
        let first = self.first[corner[0] as usize - 1].get_or_insert(next);
        let number = match met.get(first.get() as usize - 1) {
            Some(there) if *there != corner => *self.others.entry(corner).or_insert(next),
            _ => *first,
        };
        if number == next {
            met.push(corner);
        }
        number.get() - 1
    }
}

fn smoothing_group(words: &str) -> u32 {
    match words.split_whitespace().next() {
        None | Some("off") => FLAT,
        Some(number) => number.parse().unwrap_or(1),
    }
}

/// Red, green and blue as a screen shows them, and opacity.
type Colour = [f32; 4];

const WHITE: Colour = [1.0; 4];

/// Vertices as they come.
#[derive(Default)]
pub(super) struct Vertices {
    positions: Vec<DVec3>,
    /// One a vertex as long as any has a colour; white where there is none.
    colours: Vec<Colour>,
    /// From comments of ZBrush.
    painted: Vec<Colour>,
}

impl Vertices {
    /// Adds the vertex with these words, which stand in line `line`.
    pub(super) fn add(
        &mut self,
        words: &str,
        line: usize,
        tally: &mut Tally,
    ) -> Result<(), String> {
        let (numbers, count) = numbers(words)?;
        let [x, y, z, w, ..] = numbers;
        let mut position = DVec3::new(x, y, z);
        let mut colour = None;
        match count {
            0..3 => return Err(String::from("a vertex needs three numbers")),
            3 => {}
            4 if w == 0.0 => return Err(String::from("a vertex of weight 0 lies nowhere")),
            4 => position /= w,
            6 | 7 => {
                colour = Some([3, 4, 5, 6].map(|i| if i < count { numbers[i] as f32 } else { 1.0 }))
            }
            _ => tally.odd_vertex(line),
        }
        self.positions.push(position);
        if colour.is_some() || !self.colours.is_empty() {
            self.colours.resize(self.positions.len() - 1, WHITE);
            self.colours.push(colour.unwrap_or(WHITE));
        }
        Ok(())
    }

    /// Adds the colours in a comment of ZBrush, after its `#MRGB`.
    pub(super) fn paint(&mut self, digits: &str) {
        let digits = digits.trim().as_bytes().chunks_exact(8);
        let byte = |two: &[u8]| {
            let two = std::str::from_utf8(two).ok();
            let two = two.filter(|two| !two.starts_with('+'));
            two.and_then(|two| u8::from_str_radix(two, 16).ok())
        };
        for eight in digits {
            let [red, green, blue] = [2, 4, 6].map(|i| byte(&eight[i..i + 2]).unwrap_or(255));
            let colour = [red, green, blue].map(|c| f32::from(c) / 255.0);
            self.painted.push([colour[0], colour[1], colour[2], 1.0]);
        }
    }

    /// Returns the position of the vertex `index`, counted from 1.
    pub(super) fn position(&self, index: u32) -> DVec3 {
        self.positions[index as usize - 1]
    }

    /// Returns linear red, green, blue and opacity of every vertex, if any has a colour.
    pub(super) fn colours(&self, tally: &mut Tally) -> Vec<[f32; 4]> {
        let mut colours = self.colours.clone();
        if colours.is_empty() && !self.painted.is_empty() {
            tally.unpainted = self.positions.len().saturating_sub(self.painted.len());
            colours.clone_from(&self.painted);
            colours.resize(self.positions.len(), WHITE);
        }
        let most = colours
            .iter()
            .flat_map(|c| &c[..3])
            .fold(0.0_f32, |a, b| a.max(*b));
        let full = if most > 1.0 { 255.0 } else { 1.0 };
        let opaque = colours.iter().fold(0.0_f32, |a, c| a.max(c[3]));
        let full_alpha = if opaque > 1.0 { 255.0 } else { 1.0 };
        let linear = |[r, g, b, a]: [f32; 4]| {
            let [r, g, b] = [r, g, b].map(|x| srgb_decode((x / full).clamp(0.0, 1.0)));
            [r, g, b, (a / full_alpha).clamp(0.0, 1.0)]
        };
        colours.into_iter().map(linear).collect()
    }
}

/// Reads up to eight numbers, and counts the words: eight if one after the third is no number.
fn numbers(words: &str) -> Result<([f64; 8], usize), String> {
    let mut numbers = [0.0; 8];
    let mut count = 0;
    for word in words.split_whitespace().take(8) {
        match finite_number(word) {
            Ok(x) => numbers[count] = x,
            Err(message) if count < 3 => return Err(message),
            Err(_) => return Ok((numbers, 8)),
        }
        count += 1;
    }
    Ok((numbers, count))
}

/// Returns the number that a word is.
pub(super) fn number(word: &str) -> Result<f64, String> {
    word.parse().map_err(|_| match word.contains(',') {
        true => format!("`{word}` is not a number; decimals are written with a point"),
        false => format!("`{word}` is not a number"),
    })
}

fn finite_number(word: &str) -> Result<f64, String> {
    let found = number(word)?;
    match found.is_finite() {
        true => Ok(found),
        false => Err(format!("`{word}` is not a finite number")),
    }
}

/// Counts of what the user should know although the mesh is usable.
#[derive(Default)]
pub(super) struct Tally {
    /// Faces of fewer than three corners.
    pub slivers: usize,
    /// Vertices that a painted mesh has no colour for.
    pub unpainted: usize,
    /// Number and first line of each kind of statement that is left out.
    left_out: BTreeMap<&'static str, (usize, usize)>,
    /// Faces that cross themselves: their number, and the first.
    crossing: (usize, usize),
    /// Vertices with words that mean nothing: their number, and the first.
    odd_vertices: (usize, usize),
}

/// Statements with a meaning that is lost, and what they are.
const MEANT: &[(&str, &str)] = &[
    ("p", "points"),
    ("l", "lines"),
    ("curv", FREE_FORM),
    ("curv2", FREE_FORM),
    ("surf", FREE_FORM),
    ("call", "other files (`call`)"),
    ("csh", "commands (`csh`)"),
];

const FREE_FORM: &str = "curves and free-form surfaces";

impl Tally {
    /// Notes a statement that is not read; most of those mean nothing for a picture.
    pub(super) fn leave_out(&mut self, key: &str, line: usize) {
        if let Some((_, what)) = MEANT.iter().find(|(known, _)| *known == key) {
            count(self.left_out.entry(what).or_default(), line);
        }
    }

    /// Notes a face that crosses itself.
    pub(super) fn cross(&mut self, line: usize) {
        count(&mut self.crossing, line);
    }

    /// Notes a vertex with words that mean nothing.
    pub(super) fn odd_vertex(&mut self, line: usize) {
        count(&mut self.odd_vertices, line);
    }

    /// Tells whether there are surfaces that could be exported as faces.
    pub(super) fn has_free_form(&self) -> bool {
        self.left_out.contains_key(FREE_FORM)
    }

    /// Returns what to say about the text that the user calls `name`.
    pub(super) fn warnings(&self, name: &str) -> Vec<String> {
        let mut warnings = Vec::new();
        for (what, (count, line)) in &self.left_out {
            warnings.push(format!(
                "{name}:{line}: {count} {what} left out; faces alone are drawn"
            ));
        }
        let mut say = |(count, line): (usize, usize), text: &str| {
            if count > 0 {
                warnings.push(format!("{name}:{line}: {count} {text}"));
            }
        };
        say(
            self.crossing,
            "faces cross themselves, from this line on; their inside is a guess: divide them",
        );
        say(
            self.odd_vertices,
            "vertices have words that mean nothing, from this line on; their positions are used",
        );
        if self.slivers > 0 {
            let count = self.slivers;
            warnings.push(format!(
                "{name}: {count} faces of fewer than three corners left out"
            ));
        }
        if self.unpainted > 0 {
            let count = self.unpainted;
            warnings.push(format!(
                "{name}: {count} vertices have no colour in its #MRGB lines"
            ));
        }
        warnings
    }
}

/// Counts one more of a kind, in line `line`.
fn count((number, first): &mut (usize, usize), line: usize) {
    if *number == 0 {
        *first = line;
    }
    *number += 1;
}
