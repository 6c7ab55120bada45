//! Several pictures joined into one.
//!
//! In: pictures and their captions. Out: one picture, left to right, tops aligned, a caption strip
//! over each.

use crate::picture::lettering;
use geofan_render::picture::Picture;

/// Linear light of the strips and gaps.
const PAPER: [f32; 3] = [0.9; 3];
/// Linear light of the captions.
const INK: [f32; 3] = [0.01; 3];
/// Gap between pictures, pixels.
const GAP: usize = 4;

/// Joins pictures horizontally under captions; a caption too long for its picture is cut. Layers
/// are left out.
pub fn side_by_side(pictures: &[(&Picture, &str)]) -> Picture {
    let tallest = pictures.iter().map(|(picture, _)| picture.height()).max();
    let tallest = tallest.unwrap_or(0);
    let scale = lettering_scale(tallest);
    let margin = 3 * scale;
    let strip = lettering::LINE_HEIGHT * scale + 2 * margin;
    let widths: usize = pictures.iter().map(|(picture, _)| picture.width()).sum();
    let width = widths + GAP * pictures.len().saturating_sub(1);
    let mut joined = Picture::filled(width, strip + tallest, PAPER);
    let mut left = 0;
    for (picture, caption) in pictures {
        let room = picture.width().saturating_sub(2 * margin);
        let caption = lettering::shortened(caption, room, scale);
        lettering::draw(
            &mut joined,
            left + margin,
            margin + scale,
            &caption,
            INK,
            scale,
        );
        joined.paste(left, strip, picture);
        left += picture.width() + GAP;
    }
    joined
}

/// The scale of letters beside a picture of this height: letters smaller than 1/60 of the picture
/// are not legible once it is shrunk to a page, larger than 1/30 they take its room.
pub(super) fn lettering_scale(height: usize) -> usize {
    (height / 300).clamp(1, 6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joined_pictures_keep_their_pixels_under_a_strip() {
        let red = Picture::filled(30, 20, [1.0, 0.0, 0.0]);
        let blue = Picture::filled(10, 12, [0.0, 0.0, 1.0]);
        let joined = side_by_side(&[(&red, "red"), (&blue, "a caption too long")]);
        let strip = joined.height() - 20;
        assert_eq!(joined.width(), 30 + GAP + 10);
        assert_eq!(joined.pixel(29, strip), [1.0, 0.0, 0.0]);
        assert_eq!(joined.pixel(30, strip), PAPER);
        assert_eq!(joined.pixel(34, strip + 11), [0.0, 0.0, 1.0]);
        assert_eq!(joined.pixel(34, strip + 12), PAPER);
        assert!((0..30).any(|x| joined.pixel(x, strip / 2) == INK));
    }

    #[test]
    fn no_pictures_give_a_picture_without_columns() {
        assert_eq!(side_by_side(&[]).width(), 0);
    }
}
