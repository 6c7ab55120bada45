//! Values written on the command line, as clap value parsers.
//!
//! In: one argument's text. Out: the value, or one line that says how to write it. Directions come
//! out at unit length.

use geofan_bundle::LENGTHS;
use geofan_core::geodesic::{TOLERANCES, unit};
use geofan_expr::{
    Graph,
    parse::{Scope, parse},
};
use glam::DVec3;

/// Reads three finite numbers, `a,b,c`.
///
/// # Errors
/// A message for the user.
pub fn vector(text: &str) -> Result<DVec3, String> {
    let parts: Vec<&str> = text.split(',').collect();
    let Ok(parts) = <[&str; 3]>::try_from(parts.as_slice()) else {
        let plural = if parts.len() == 1 { "" } else { "s" };
        return Err(format!(
            "three numbers a,b,c are needed, this is {} part{plural}",
            parts.len()
        ));
    };
    let mut vector = DVec3::ZERO;
    for (k, part) in parts.into_iter().enumerate() {
        vector[k] = number(part)?;
    }
    Ok(vector)
}

/// Reads a direction, `x,y,z` in the standard frame, and normalises it.
///
/// # Errors
/// A message for the user.
pub fn direction(text: &str) -> Result<DVec3, String> {
    let vector = vector(text)?;
    unit(vector).ok_or_else(|| "a direction must not be zero".into())
}

/// Reads a finite number.
///
/// # Errors
/// A message for the user.
pub fn number(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => Err(format!("`{}` is not finite", text.trim())),
        Err(_) => Err(format!("`{}` is not a number", text.trim())),
    }
}

/// Reads a number, or an expression of numbers such as `2*pi`.
///
/// # Errors
/// A message for the user.
pub fn constant(text: &str) -> Result<f64, String> {
    let mut graph = Graph::new();
    let parsed = parse(text, &Scope::default(), &mut graph);
    let parsed = parsed.map_err(|e| format!("`{}`: {e}", text.trim()))?;
    match graph.value(parsed.node) {
        Some(value) if value.is_finite() => Ok(value),
        _ => Err(format!("`{}` is not finite", text.trim())),
    }
}

/// Divides three expressions at the commas that stand in no bracket.
///
/// # Errors
/// A message for the user.
pub fn expressions(text: &str) -> Result<[String; 3], String> {
    let mut parts = vec![String::new()];
    let mut depth = 0_i32;
    for c in text.chars() {
        depth += i32::from(c == '(') - i32::from(c == ')');
        match c {
            ',' if depth == 0 => parts.push(String::new()),
            c => parts.last_mut().map_or((), |part| part.push(c)),
        }
    }
    let count = parts.len();
    parts
        .try_into()
        .map_err(|_| format!("three expressions are needed, separated by commas; this is {count}"))
}

/// Reads a finite number above zero.
///
/// # Errors
/// A message for the user.
pub fn positive(text: &str) -> Result<f64, String> {
    match number(text)? {
        value if value > 0.0 => Ok(value),
        value => Err(format!("{value} is not above zero")),
    }
}

/// Reads an arc length.
///
/// # Errors
/// A message for the user.
pub fn length(text: &str) -> Result<f64, String> {
    match positive(text)? {
        length if LENGTHS.contains(&length) => Ok(length),
        length => Err(format!(
            "{length:e} is no length between {:e} and {:e}",
            LENGTHS.start(),
            LENGTHS.end()
        )),
    }
}

/// Reads an integration tolerance.
///
/// # Errors
/// A message for the user.
pub fn tolerance(text: &str) -> Result<f64, String> {
    let value = number(text)?;
    if TOLERANCES.contains(&value) {
        return Ok(value);
    }
    Err(format!(
        "a tolerance lies between {:e} and {:e}",
        TOLERANCES.start(),
        TOLERANCES.end()
    ))
}

/// Reads a parameter of a manifold, `name=value`.
///
/// # Errors
/// A message for the user.
pub fn setting(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text
        .split_once('=')
        .ok_or("a setting is written name=value")?;
    match name.trim() {
        "" => Err("a name is missing before `=`".into()),
        name => Ok((name.to_string(), number(value)?)),
    }
}

/// Units of a size in bytes, longest first where one ends another.
const UNITS: [(&str, u64); 10] = [
    ("KiB", 1 << 10),
    ("MiB", 1 << 20),
    ("GiB", 1 << 30),
    ("TiB", 1 << 40),
    ("kB", 1_000),
    ("KB", 1_000),
    ("MB", 1_000_000),
    ("GB", 1_000_000_000),
    ("TB", 1_000_000_000_000),
    ("B", 1),
];

/// Reads a number of bytes: `1000000`, `512KiB`, `1.5MiB`, `4MB`.
///
/// # Errors
/// A message for the user.
pub fn bytes(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let unit = UNITS.iter().find_map(|(name, size)| {
        let digits = text.strip_suffix(name)?;
        Some((digits.trim_end(), *size))
    });
    let (digits, size) = unit.unwrap_or((text, 1));
    let wrong = || format!("`{text}` is not a size: write 1000000, 512KiB or 4MiB");
    if !digits.bytes().all(|b| b.is_ascii_digit() || b == b'.') {
        return Err(wrong());
    }
    if let Ok(whole) = digits.parse::<u64>() {
        let product = whole.checked_mul(size);
        return product.ok_or(format!("`{text}` is too large a size"));
    }
    let value = digits.parse::<f64>().map_err(|_| wrong())? * size as f64;
    if value < u64::MAX as f64 {
        Ok(value.round() as u64)
    } else {
        Err(format!("`{text}` is too large a size"))
    }
}

/// The most pixels of a picture: a gibibyte for one layer of f32, more than any format stores well.
const MOST_PIXELS: usize = 1 << 28;

/// Reads a picture size, `1280x720`: columns and rows.
///
/// # Errors
/// A message for the user.
pub fn picture_size(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("`{text}` is not a picture size: write 1280x720");
    let (width, height) = text.split_once(['x', 'X', '×']).ok_or_else(wrong)?;
    let side = |text: &str| text.trim().parse::<usize>().map_err(|_| wrong());
    let (width, height) = (side(width)?, side(height)?);
    match width.checked_mul(height) {
        Some(0) => Err("a picture needs at least one pixel".into()),
        Some(pixels) if pixels <= MOST_PIXELS => Ok((width, height)),
        _ => Err(format!("a picture has at most {MOST_PIXELS} pixels")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_are_three_finite_numbers() {
        assert_eq!(vector("-1, 2e-3,.5"), Ok(DVec3::new(-1.0, 2e-3, 0.5)));
        assert!(vector("1,2").unwrap_err().contains("2 parts"));
        assert!(vector("1,2,nan").unwrap_err().contains("not finite"));
        assert!(vector("1,2,inf").unwrap_err().contains("not finite"));
        assert!(vector("1,2,").unwrap_err().contains("not a number"));
    }

    #[test]
    fn directions_have_unit_length_whatever_their_size() {
        for scale in ["3e-300,0,4e-300", "3,0,4", "3e300,0,4e300"] {
            assert!((direction(scale).unwrap() - DVec3::new(0.6, 0.0, 0.8)).length() < 1e-15);
        }
        assert!(direction("0,0,-0").is_err());
    }

    #[test]
    fn settings_are_a_name_and_a_number() {
        assert_eq!(setting("a=-0.5"), Ok(("a".into(), -0.5)));
        assert!(setting("a").is_err());
        assert!(setting("=1").is_err());
        assert!(setting("a=b").unwrap_err().contains("`b`"));
    }

    #[test]
    fn sizes_have_binary_and_decimal_units() {
        assert_eq!(bytes("1000000"), Ok(1_000_000));
        assert_eq!(bytes("512KiB"), Ok(524_288));
        assert_eq!(bytes("1.5 MiB"), Ok(1_572_864));
        assert_eq!(bytes("4MB"), Ok(4_000_000));
        assert_eq!(bytes("18446744073709551615"), Ok(u64::MAX));
        for wrong in ["", "MiB", "-1", "4 apples", "1e3", "inf", "1.2.3"] {
            assert!(bytes(wrong).unwrap_err().contains("not a size"), "{wrong}");
        }
        for large in ["18446744073709551616", "99999999TiB", "99999999.5TiB"] {
            assert!(bytes(large).unwrap_err().contains("too large"), "{large}");
        }
    }

    #[test]
    fn picture_sizes_are_columns_by_rows() {
        assert_eq!(picture_size("1280x720"), Ok((1280, 720)));
        for wrong in [
            "1280",
            "0x5",
            "-1x5",
            "axb",
            "99999999x99999999",
            "9999999999999x9999999999",
        ] {
            assert!(picture_size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn lengths_and_tolerances_have_ranges() {
        assert_eq!(positive("2.5"), Ok(2.5));
        assert!(positive("0").is_err() && positive("-1").is_err() && positive("inf").is_err());
        assert_eq!(tolerance("1e-14"), Ok(1e-14));
        assert!(tolerance("1e-15").is_err() && tolerance("0.2").is_err());
    }
}
