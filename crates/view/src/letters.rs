//! Bytes as text for a page.
//!
//! In: bytes. Out: text of 91 letters, two for every 13 bits, the least bits first; `ui/unpack.js` undoes that. The
//! letters are all that can be printed but `"`, `&` and `<`, which HTML has a use for. A byte takes 1.23 letters,
//! where base 64 takes 1.33.

/// Bits of two letters.
const BITS: u32 = 13;

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

#[cfg(test)]
mod tests {
    use super::*;

    /// Undoes [`in_letters`], as the page does.
    fn bytes_of(text: &str) -> Vec<u8> {
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

    #[test]
    fn bytes_come_back_with_at_most_one_more() {
        for length in 0..100_usize {
            let bytes: Vec<u8> = (0..length).map(|i| (i * 89 + length * 7) as u8).collect();
            let back = bytes_of(&in_letters(&bytes));
            assert!(
                back.starts_with(&bytes) && back.len() <= length + 1,
                "{length}"
            );
        }
    }
}
