//! Lists of numbers in bytes that compress well.
//!
//! In: numbers, column by column, as files of meshes have them. Out: bytes, and the same numbers again.
//!
//! Most such numbers were written with a few decimals: they are whole numbers over a power of ten, and are found to be
//! so. Others keep all of their bits. Layout of a list, little-endian: what the whole numbers are (u8: the
//! decimals, with [`ROUNDED`] if they are rounded to single precision afterwards; [`SINGLE`], [`DOUBLE`]: the bits of
//! a number, in its order), then for each column how many differences
//! were taken (u8), the bytes of what is left (u8), and those bytes: the highest of all rows first. What is left has
//! its sign in its lowest bit.

/// Whole numbers over a power of ten are rounded to single precision.
const ROUNDED: u8 = 0x40;

/// Whole numbers are the bits of single-precision numbers.
const SINGLE: u8 = 0x80;

/// Whole numbers are the bits of numbers in double precision.
const DOUBLE: u8 = 0x81;

/// Most decimals that are tried: more are not written by hand or by programs that round.
const MOST_DECIMALS: u8 = 9;

/// Most differences that are tried.
const MOST_DIFFERENCES: u8 = 2;

/// Writes a list to `bytes`, `columns` of equal length.
pub(super) fn put(bytes: &mut Vec<u8>, columns: &[Vec<f64>]) {
    let all = || columns.iter().flatten();
    let single = all().all(|x| f64::from(*x as f32).to_bits() == x.to_bits());
    let exact = (0..=MOST_DECIMALS).find(|d| all().all(|x| over_ten(*x, *d).is_some()));
    let rounded = |d: &u8| all().all(|x| rounded_over_ten(*x, *d).is_some());
    let kind = match (exact, single) {
        (Some(decimals), _) => decimals,
        (None, false) => DOUBLE,
        (None, true) => {
            let decimals = (0..=MOST_DECIMALS).find(rounded);
            decimals.map_or(SINGLE, |decimals| decimals | ROUNDED)
        }
    };
    bytes.push(kind);
    for column in columns {
        let whole: Vec<i64> = column.iter().map(|x| whole(*x, kind)).collect();
        put_whole(bytes, &whole);
    }
}

/// Reads a list of so many columns and rows.
pub(super) fn take(bytes: &mut &[u8], columns: usize, rows: usize) -> Option<Vec<Vec<f64>>> {
    let kind = *bytes.split_off_first()?;
    let number = |n: i64| number(n, kind);
    (0..columns)
        .map(|_| take_whole(bytes, rows)?.into_iter().map(number).collect())
        .collect()
}

/// Returns the whole number that `x` is times a power of ten, if it is exactly that one over the power.
pub(super) fn over_ten(x: f64, decimals: u8) -> Option<i64> {
    let power = 10_f64.powi(decimals.into());
    let n = (x * power).round();
    (n.abs() < 1e15 && n / power == x).then_some(n as i64)
}

/// Returns the whole number that is `x` over a power of ten, rounded to single precision.
fn rounded_over_ten(x: f64, decimals: u8) -> Option<i64> {
    let power = 10_f64.powi(decimals.into());
    let n = (x * power).round();
    (n.abs() < 1e15 && f64::from((n / power) as f32) == x).then_some(n as i64)
}

fn whole(x: f64, kind: u8) -> i64 {
    match kind {
        SINGLE => i64::from(in_order(i64::from((x as f32).to_bits().cast_signed()), 31) as i32),
        DOUBLE => in_order(x.to_bits().cast_signed(), 63),
        kind if kind & ROUNDED != 0 => rounded_over_ten(x, kind ^ ROUNDED).unwrap_or_default(),
        decimals => over_ten(x, decimals).unwrap_or_default(),
    }
}

fn number(n: i64, kind: u8) -> Option<f64> {
    Some(match kind {
        SINGLE => f64::from(f32::from_bits(
            (in_order(i64::from(i32::try_from(n).ok()?), 31) as i32).cast_unsigned(),
        )),
        DOUBLE => f64::from_bits(in_order(n, 63).cast_unsigned()),
        kind if kind & !ROUNDED <= MOST_DECIMALS => {
            let x = n as f64 / 10_f64.powi((kind & !ROUNDED).into());
            if kind & ROUNDED == 0 {
                x
            } else {
                f64::from(x as f32)
            }
        }
        _ => return None,
    })
}

/// Brings bits of a number into its order, and back: those of negative ones count down.
fn in_order(bits: i64, size: u32) -> i64 {
    bits ^ ((bits >> 63) & ((1_i64 << (size - 1) << 1).wrapping_sub(1)))
}

/// Writes whole numbers, all of them.
pub(super) fn put_whole(bytes: &mut Vec<u8>, whole: &[i64]) {
    let cost = |left: &[i64]| -> u32 { left.iter().map(|x| 64 - signed(*x).leading_zeros()).sum() };
    let mut best = (0, whole.to_vec());
    let mut left = best.1.clone();
    for order in 1..=MOST_DIFFERENCES {
        for i in (1..left.len()).rev() {
            left[i] = left[i].wrapping_sub(left[i - 1]);
        }
        if cost(&left) < cost(&best.1) {
            best = (order, left.clone());
        }
    }
    let left: Vec<u64> = best.1.iter().map(|x| signed(*x)).collect();
    let largest = left.iter().copied().max().unwrap_or(0);
    // A byte a row at least: who reads them can trust that there are as many.
    let width = (64 - largest.leading_zeros()).div_ceil(8).max(1);
    bytes.extend([best.0, width as u8]);
    for k in (0..width).rev() {
        bytes.extend(left.iter().map(|x| (x >> (8 * k)) as u8));
    }
}

/// Reads so many whole numbers.
pub(super) fn take_whole(bytes: &mut &[u8], rows: usize) -> Option<Vec<i64>> {
    let [order, width] = take_chunk(bytes)?;
    let width = usize::from(width);
    let planes = bytes.split_off(..width.checked_mul(rows)?)?;
    if !(1..=8).contains(&width) || order > MOST_DIFFERENCES {
        return None;
    }
    let part =
        |i: usize| (0..width).fold(0, |sum: u64, k| sum << 8 | u64::from(planes[k * rows + i]));
    let mut whole: Vec<i64> = (0..rows).map(|i| unsigned(part(i))).collect();
    for _ in 0..order {
        for i in 1..rows {
            whole[i] = whole[i].wrapping_add(whole[i - 1]);
        }
    }
    Some(whole)
}

/// Reads so many bytes.
pub(crate) fn take_chunk<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (chunk, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    Some(*chunk)
}

/// Puts the sign into the lowest bit.
fn signed(x: i64) -> u64 {
    ((x << 1) ^ (x >> 63)).cast_unsigned()
}

/// Undoes [`signed`].
fn unsigned(x: u64) -> i64 {
    (x >> 1).cast_signed() ^ -((x & 1).cast_signed())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn back(columns: &[Vec<f64>]) -> (Vec<Vec<f64>>, usize) {
        let mut bytes = Vec::new();
        put(&mut bytes, columns);
        for length in 0..bytes.len() {
            let mut cut = &bytes[..length];
            assert_eq!(take(&mut cut, columns.len(), columns[0].len()), None);
        }
        let mut rest = bytes.as_slice();
        let found = take(&mut rest, columns.len(), columns[0].len()).unwrap();
        assert!(rest.is_empty());
        (found, bytes.len())
    }

    #[test]
    fn numbers_come_back_with_all_their_bits() {
        let decimals: Vec<f64> = (0..50).map(|i| f64::from(i * i) * 0.01 - 3.0).collect();
        let written: Vec<f64> = decimals
            .iter()
            .map(|x| format!("{x:.3}").parse().unwrap())
            .collect();
        let (found, few) = back(std::slice::from_ref(&written));
        assert_eq!(found, [written]);
        let (found, more) = back(std::slice::from_ref(&decimals));
        assert_eq!(found, [decimals]);
        assert!(few < more, "{few} {more}");
        let odd = vec![
            1e-310,
            -1.0 / 3.0,
            1e300,
            f64::MAX,
            f64::MIN,
            f64::INFINITY,
            -f64::EPSILON,
            2.0,
        ];
        let texture: Vec<f64> = (0..50)
            .map(|i| f64::from((f64::from(i) / 1000.0) as f32))
            .collect();
        let (found, size) = back(std::slice::from_ref(&texture));
        assert_eq!(found, [texture]);
        assert!(size < 110, "{size}");
        let single: Vec<f64> = odd.iter().map(|x| f64::from(*x as f32)).collect();
        for list in [odd, single] {
            assert_eq!(back(std::slice::from_ref(&list)).0, [list]);
        }
    }

    #[test]
    fn a_straight_line_takes_a_byte_a_number() {
        let line: Vec<f64> = (0..1000).map(|i| f64::from(i) * 1000.0 + 7.0).collect();
        let (found, size) = back(std::slice::from_ref(&line));
        assert_eq!(found, [line]);
        assert!(size < 3000, "{size}");
    }
}
