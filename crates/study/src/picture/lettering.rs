//! Lettering in pictures, with a small font of its own, and pictures joined under captions.
//!
//! In: a picture, a place, a text and a colour in linear light. Out: the picture with the text; or
//! several pictures as one, left to right, tops aligned, a caption strip over each.
//! Letters are 5 pixels wide and 9 high (7 above the base line, 2 below) in cells 6 wide, all times
//! a whole scale; characters that are not printable ASCII show as a question mark.

use geofan_render::picture::Picture;

/// Height of a line of text at scale 1, with the gap to the next one, pixels.
pub const LINE_HEIGHT: usize = 11;
/// Height of a capital letter or a digit at scale 1, pixels.
pub const CAPITAL_HEIGHT: usize = 7;

const CELL_WIDTH: usize = 6;
const LETTER_WIDTH: usize = 5;

/// Characters 32 to 126, each as its nine rows from the top, a row as one digit of base 32 whose
/// highest bit is the leftmost pixel.
#[rustfmt::skip]
const LETTERS: [&str; 95] = [
    "000000000", "444440400", "aaa000000", "aavavaa00", "4fke5u400", "op248j300", "cik8lid00",
    "444000000", "248884200", "842224800", "04lel4000", "044v44000", "00000cc48", "000v00000",
    "00000cc00", "01248g000", "ehjlphe00", "4c4444e00", "eh1248v00", "v2421he00", "26aiv2200",
    "vgu11he00", "68guhhe00", "v12488800", "ehhehhe00", "ehhf12c00", "0cc0cc000", "0cc0cc480",
    "248g84200", "00v0v0000", "842124800", "eh1240400", "ehnlmgf00", "ehhvhhh00", "uhhuhhu00",
    "ehggghe00", "sihhhis00", "vgguggv00", "vgguggg00", "ehgnhhf00", "hhhvhhh00", "e44444e00",
    "72222ic00", "hikokih00", "ggggggv00", "hrllhhh00", "hhpljhh00", "ehhhhhe00", "uhhuggg00",
    "ehhhlid00", "uhhukih00", "fgge11u00", "v44444400", "hhhhhhe00", "hhhhha400", "hhhllla00",
    "hha4ahh00", "hhha44400", "v1248gv00", "e88888e00", "0g8421000", "e22222e00", "4ah000000",
    "000000v00", "842000000", "00e1fhf00", "ggmphhu00", "00egghe00", "11djhhf00", "00ehvge00",
    "698s88800", "00fhhhf1e", "ggmphhh00", "40c444e00", "2062222ic", "ggikoki00", "c44444e00",
    "00qllhh00", "00mphhh00", "00ehhhe00", "00uhhhugg", "00fhhhf11", "00mpggg00", "00fge1u00",
    "88s889600", "00hhhjd00", "00hhha400", "00hhlla00", "00ha4ah00", "00hhhjd1e", "00v248v00",
    "244844200", "444444400", "844244800", "0008l2000",
];

/// Writes `text` with the top left corner of its first letter at (`x`, `y`), clipped to the
/// picture; `colour` is linear light.
pub fn draw(picture: &mut Picture, x: usize, y: usize, text: &str, colour: [f32; 3], scale: usize) {
    for (i, letter) in text.chars().enumerate() {
        let left = x + i * CELL_WIDTH * scale;
        for (column, row) in ink(letter) {
            let (x, y) = (left + column * scale, y + row * scale);
            picture.fill(x..x + scale, y..y + scale, colour);
        }
    }
}

/// Returns the width of `text` in pixels, without the gap after the last letter.
pub fn width(text: &str, scale: usize) -> usize {
    let cells = CELL_WIDTH * text.chars().count();
    cells.saturating_sub(CELL_WIDTH - LETTER_WIDTH) * scale
}

/// Returns the part of `text` that fits into `room` pixels, ending in two full stops if it was cut.
pub fn shortened(text: &str, room: usize, scale: usize) -> String {
    if width(text, scale) <= room {
        return text.to_string();
    }
    let cells = (room / scale + CELL_WIDTH - LETTER_WIDTH) / CELL_WIDTH;
    let kept = text.chars().take(cells.saturating_sub(2));
    kept.chain("..".chars()).take(cells).collect()
}

/// Returns the pixels (column, row) of a letter.
fn ink(letter: char) -> impl Iterator<Item = (usize, usize)> {
    let code = letter as usize;
    let code = if (32..127).contains(&code) {
        code
    } else {
        '?' as usize
    };
    let rows = LETTERS[code - 32].chars().enumerate();
    rows.flat_map(|(row, digit)| {
        let bits = digit.to_digit(32).unwrap_or(0);
        let columns = (0..LETTER_WIDTH).filter(move |column| bits << column & 16 != 0);
        columns.map(move |column| (column, row))
    })
}

/// Linear light around pictures.
pub(super) const PAPER: [f32; 3] = [0.9; 3];
/// Linear light of letters and lines.
pub(super) const INK: [f32; 3] = [0.01; 3];
/// Gap between pictures, pixels.
const GAP: usize = 4;

/// Joins pictures horizontally under captions; a caption too long for its picture is cut. Layers
/// are left out.
pub fn side_by_side(pictures: &[(&Picture, &str)]) -> Picture {
    let tallest = pictures.iter().map(|(picture, _)| picture.height()).max();
    let tallest = tallest.unwrap_or(0);
    let scale = lettering_scale(tallest);
    let margin = 3 * scale;
    let strip = LINE_HEIGHT * scale + 2 * margin;
    let widths: usize = pictures.iter().map(|(picture, _)| picture.width()).sum();
    let width = widths + GAP * pictures.len().saturating_sub(1);
    let mut joined = Picture::filled(width, strip + tallest, PAPER);
    let mut left = 0;
    for (picture, caption) in pictures {
        let room = picture.width().saturating_sub(2 * margin);
        let caption = shortened(caption, room, scale);
        draw(
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

/// Returns the scale of letters beside a picture of this height: letters smaller than 1/60 of the picture
/// are not legible once it is shrunk to a page, larger than 1/30 they take its room.
pub(super) fn lettering_scale(height: usize) -> usize {
    (height / 300).clamp(1, 6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_letter_has_nine_rows_and_looks_like_no_other() {
        for (i, letter) in LETTERS.iter().enumerate() {
            assert_eq!(letter.len(), 9, "{i}");
            assert!(letter.chars().all(|digit| digit.is_digit(32)), "{letter}");
            assert!(!LETTERS[..i].contains(letter), "{letter}");
            assert_eq!(ink(char::from(i as u8 + 32)).count() == 0, i == 0);
        }
    }

    #[test]
    fn text_stays_within_its_measured_width() {
        let mut picture = Picture::filled(100, 20, [0.0; 3]);
        draw(&mut picture, 0, 0, "MMMM", [1.0; 3], 2);
        let inked = |x: usize| (0..20).any(|y| picture.pixel(x, y) != [0.0; 3]);
        assert_eq!(
            (0..100).filter(|&x| inked(x)).max(),
            Some(width("MMMM", 2) - 1)
        );
        assert_eq!(width("", 3), 0);
    }

    #[test]
    fn text_beyond_the_border_and_foreign_letters_do_no_harm() {
        let mut picture = Picture::filled(10, 5, [0.0; 3]);
        draw(&mut picture, 7, 3, "long \u{3b1} text", [1.0; 3], 3);
        draw(&mut picture, 700, 300, "far away", [1.0; 3], 1);
        assert!(ink('\u{3b1}').eq(ink('?')));
    }

    #[test]
    fn a_text_that_does_not_fit_is_cut_and_says_so() {
        assert_eq!(shortened("table", 29, 1), "table");
        assert_eq!(shortened("table", 28, 1), "ta..");
        assert_eq!(shortened("table", 3, 1), "");
    }

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
