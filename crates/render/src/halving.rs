//! Pictures at half their size: what each pixel of the smaller one covers of the larger.
//!
//! In: the side of a picture, in pixels. Out: intervals of it, one for each of half as many pixels, rounded down, and the share
//! that each pixel has of one. Odd sides have no pixel left over: every part of a picture counts as much as any other.

/// Returns what number `i` of half as many pixels, one at least, covers of a row or column of `side`, from and to, in pixels.
pub(crate) fn covered(side: usize, i: usize) -> [f32; 2] {
    let border = |i: usize| ((i * side) as f64 / (side / 2).max(1) as f64) as f32;
    [border(i), border(i + 1)]
}

/// Lists the pixels between two places, each with its share of a measure that grows or falls along the side.
pub(crate) fn shares(
    [from, to]: [f32; 2],
    measure: impl Fn(f32) -> f32,
) -> impl Iterator<Item = (usize, f32)> {
    let whole = measure(to) - measure(from);
    (from as usize..to.ceil() as usize).map(move |k| {
        let [low, high] = [from.max(k as f32), to.min(k as f32 + 1.0)];
        (k, (measure(high) - measure(low)) / whole)
    })
}
