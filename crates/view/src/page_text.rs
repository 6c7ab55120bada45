//! Bytes as text for a page.
//!
//! In: bytes. Out: text that HTML carries unchanged, in one of two codes; `ui/unpack.js` undoes both.
//!
//! - Letters, for pages that lie in other texts, a notebook's: 91 letters, two for every 13 bits, the least bits first.
//!   They are all that can be printed but `"`, `&` and `<`, which HTML has a use for. A byte takes 1.23 letters, where
//!   base 64 takes 1.33.
//! - Code units, for pages that are files in UTF-16: two bytes are the number of one code unit, the first the lower
//!   half. Of all numbers a few are not carried unchanged; [`ESCAPE`] stands before those, and their highest bit is
//!   turned. Compressed bytes take up 1.03 bytes each.

/// Bits of two letters.
const BITS: u32 = 13;

/// The code unit before one that stands for another: the first for private use.
const ESCAPE: u16 = 0xE000;

/// The highest bit of a code unit. Turned, no code unit that is not carried unchanged remains one.
const TURNED: u16 = 0x8000;

/// What a file in UTF-16 begins with, the lower halves first. It goes before whatever a server tells of the encoding.
const BYTE_ORDER_MARK: [u8; 2] = [0xFF, 0xFE];

/// Writes bytes in letters.
pub fn in_letters(bytes: &[u8]) -> String {
    let letters: Vec<char> = ('!'..='~')
        .filter(|c| !['"', '&', '<'].contains(c))
        .collect();
    let mut text = String::with_capacity(bytes.len() / 4 * 5 + 8);
    let (mut held, mut count) = (0_u32, 0);
    let mut put = |two: usize| {
        text.push(letters[two % letters.len()]);
        text.push(letters[two / letters.len()]);
    };
    for byte in bytes {
        held |= u32::from(*byte) << count;
        count += 8;
        if count >= BITS {
            put((held & ((1 << BITS) - 1)) as usize);
            held >>= BITS;
            count -= BITS;
        }
    }
    if count > 0 {
        put(held as usize);
    }
    text
}

/// Writes bytes in code units of UTF-16. A single last byte is followed by a zero.
pub fn in_code_units(bytes: &[u8]) -> String {
    let units = bytes.chunks(2).flat_map(|two| {
        let unit = u16::from_le_bytes([two[0], *two.get(1).unwrap_or(&0)]);
        match is_carried(unit) {
            true => [Some(unit), None],
            false => [Some(ESCAPE), Some(unit ^ TURNED)],
        }
    });
    char::decode_utf16(units.flatten())
        .map(|c| c.expect("no half of a pair is carried"))
        .collect()
}

/// Tells whether a code unit comes through HTML in UTF-16 as it is: halves of pairs, the zero, line ends that are
/// made equal, what may end a script, and the mark itself do not.
fn is_carried(unit: u16) -> bool {
    let is_half = (0xD800..0xE000).contains(&unit);
    !is_half && ![0, u16::from(b'\r'), u16::from(b'<'), ESCAPE].contains(&unit)
}

/// Encodes a page as a file in UTF-16.
pub fn utf16_file(text: &str) -> Vec<u8> {
    let units = text.encode_utf16().flat_map(u16::to_le_bytes);
    BYTE_ORDER_MARK.into_iter().chain(units).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Undoes [`in_letters`], as the page does.
    fn bytes_of_letters(text: &str) -> Vec<u8> {
        let letters: Vec<char> = ('!'..='~')
            .filter(|c| !['"', '&', '<'].contains(c))
            .collect();
        let values: Vec<usize> = text
            .chars()
            .map(|c| letters.iter().position(|l| *l == c).unwrap())
            .collect();
        let (mut held, mut count, mut bytes) = (0_usize, 0, Vec::new());
        for two in values.chunks_exact(2) {
            held |= (two[0] + 91 * two[1]) << count;
            count += 13;
            while count >= 8 {
                bytes.push(held as u8);
                held >>= 8;
                count -= 8;
            }
        }
        bytes.truncate(text.len() / 2 * 13 / 8);
        bytes
    }

    /// Undoes [`in_code_units`], as the page does.
    fn bytes_of_code_units(text: &str) -> Vec<u8> {
        let mut units = text.encode_utf16();
        let mut bytes = Vec::new();
        while let Some(unit) = units.next() {
            let meant = match unit == ESCAPE {
                true => units.next().unwrap() ^ TURNED,
                false => unit,
            };
            bytes.extend(meant.to_le_bytes());
        }
        bytes
    }

    #[test]
    fn bytes_come_back_with_at_most_one_more() {
        for length in 0..100_usize {
            let bytes: Vec<u8> = (0..length).map(|i| (i * 89 + length * 7) as u8).collect();
            for back in [
                bytes_of_letters(&in_letters(&bytes)),
                bytes_of_code_units(&in_code_units(&bytes)),
            ] {
                assert!(
                    back.starts_with(&bytes) && back.len() <= length + 1,
                    "{length}"
                );
            }
        }
    }

    #[test]
    fn every_pair_of_bytes_is_carried() {
        let bytes: Vec<u8> = (0..=u16::MAX).flat_map(u16::to_le_bytes).collect();
        let text = in_code_units(&bytes);
        assert!(!text.contains(['\0', '\r', '<']));
        assert_eq!(bytes_of_code_units(&text), bytes);
        let file = utf16_file(&text);
        assert_eq!(file.len(), 2 + 2 * (65536 + 2048 + 4));
    }
}
