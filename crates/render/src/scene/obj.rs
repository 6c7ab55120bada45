//! OBJ texts brought into the form that `tobj` reads, in one pass.
//!
//! In: the text. Out: [`Obj`]: a text of vertices and triangles alone, and beside it what `tobj` has
//! no place for; or an error at the first line that makes the mesh meaningless (a number that is not
//! finite, an index that points nowhere).
//!
//! `tobj` fills polylines like faces, cuts faces into fans, repeats normals where only some corners
//! have them, refuses half of what exporters write, and gives no line with its errors. So it gets
//! triangles only (see [`super::polygon`]), with all three indices at every corner or at none, counted
//! from 1, and reads positions in double precision.
//!
//! What statements mean: *Advanced Visualizer Manual*, appendix B1, Wavefront Technologies, 1992.

use super::{
    polygon::{Cutter, Outline},
    smoothing::{FLAT, SmoothingKey},
    tally::Tally,
    text::{PAINT, Statement, statements},
    vertex::{Vertices, number},
};
use geofan_core::error::{Error, Result};
use std::{collections::HashMap, fmt::Write};

/// Vertex, texture coordinates and normal of a corner, counted from 1; 0 for none.
type Corner = [u32; 3];

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
    /// Lines of texture coordinates and of normals.
    coordinates: String,
    normals: String,
}

/// A text for `tobj`, and what each of its triangles is.
pub(super) struct Triangulated {
    /// Triangles of one group.
    pub text: String,
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
        let given: Vec<f64> = words
            .split_whitespace()
            .map(number)
            .collect::<Result<_, _>>()?;
        let finite = |x: Option<&f64>| x.copied().filter(|x| x.is_finite()).unwrap_or(0.0);
        if given.is_empty() {
            return Err(String::from("texture coordinates need a number at least"));
        }
        self.counts[1] += 1;
        // The third number is for textures that fill space.
        let (u, v) = (finite(given.first()), finite(given.get(1)));
        write(&mut self.coordinates, format_args!("vt {u} {v}\n"));
        Ok(())
    }

    fn normal(&mut self, words: &str) -> Result<(), String> {
        let given = words.split_whitespace().take(3).map(number);
        let given: Vec<f64> = given.collect::<Result<_, _>>()?;
        let [x, y, z] = given.as_slice() else {
            return Err(String::from("a normal needs three numbers"));
        };
        self.counts[2] += 1;
        write(&mut self.normals, format_args!("vn {x} {y} {z}\n"));
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

    /// Returns the text for `tobj`. Where vertices have colours, each carries its number in place of one.
    pub(super) fn triangulated(&mut self) -> Triangulated {
        let mut made = Triangulated {
            text: self.vertices.lines(),
            material_of: Vec::with_capacity(self.faces.len()),
            smoothing: Vec::with_capacity(self.faces.len()),
        };
        let used = |kind: usize| self.corners.iter().any(|c| c[kind] != 0);
        let columns = [used(1), used(2)];
        // One more of each, for corners that have none.
        if columns[0] {
            made.text += &std::mem::take(&mut self.coordinates);
            made.text += "vt 0 0\n";
        }
        if columns[1] {
            made.text += &std::mem::take(&mut self.normals);
            made.text += "vn 0 0 0\n";
        }
        self.cut_faces(columns, &mut made);
        made
    }

    fn cut_faces(&mut self, columns: [bool; 2], made: &mut Triangulated) {
        let mut cutter = Cutter::default();
        let (mut points, mut triangles) = (Vec::new(), Vec::new());
        let mut begin = 0;
        for (number, face) in self.faces.iter().enumerate() {
            let corners = &self.corners[begin..face.end];
            begin = face.end;
            points.clear();
            points.extend(corners.iter().map(|c| self.vertices.position(c[0])));
            if cutter.cut(&points, &mut triangles) == Outline::Crossing {
                self.tally.cross(face.line);
            }
            for triangle in &triangles {
                made.text.push('f');
                for corner in triangle {
                    self.write_corner(corners[*corner as usize], columns, &mut made.text);
                }
                made.text.push('\n');
                made.material_of.push(face.material);
                made.smoothing.push(SmoothingKey {
                    face: number as u32,
                    group: face.group,
                });
            }
        }
    }

    fn write_corner(&self, [v, vt, vn]: Corner, columns: [bool; 2], text: &mut String) {
        let or_last = |index: u32, count: usize| match index {
            0 => count + 1,
            _ => index as usize,
        };
        let (vt, vn) = (or_last(vt, self.counts[1]), or_last(vn, self.counts[2]));
        match columns {
            [false, false] => write(text, format_args!(" {v}")),
            [true, false] => write(text, format_args!(" {v}/{vt}")),
            [false, true] => write(text, format_args!(" {v}//{vn}")),
            [true, true] => write(text, format_args!(" {v}/{vt}/{vn}")),
        }
    }
}

/// Writes into a string, which cannot fail.
pub(super) fn write(text: &mut String, arguments: std::fmt::Arguments<'_>) {
    text.write_fmt(arguments).expect("strings take any text");
}

fn smoothing_group(words: &str) -> u32 {
    match words.split_whitespace().next() {
        None | Some("off") => FLAT,
        Some(number) => number.parse().unwrap_or(1),
    }
}
