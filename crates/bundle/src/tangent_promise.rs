//! The promise of a table about tangents, and its bytes in a plan.
//!
//! In: what is promised of points. Out: what is promised of tangents, as the 99th percentile of their sky
//! error, mrad. Its first byte is that of the plain flag (0 or 1) that a plan without a promise of its own
//! has; a promise of its own follows a 2.

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{Error, SeqAccess, Visitor},
};
use std::fmt;

/// Says what a table promises of tangents, and with them of transported frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TangentPromise {
    /// Nothing.
    None,
    /// As much as of points.
    AsPoints,
    /// Its own 99th percentile of the sky error, mrad.
    Own(f64),
}

impl TangentPromise {
    /// Returns the promise in mrad where `points` is that of points.
    pub fn mrad(self, points: f64) -> Option<f64> {
        match self {
            Self::None => None,
            Self::AsPoints => Some(points),
            Self::Own(own) => Some(own),
        }
    }
}

impl Serialize for TangentPromise {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::None => 0_u8.serialize(serializer),
            Self::AsPoints => 1_u8.serialize(serializer),
            Self::Own(own) => (2_u8, own).serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for TangentPromise {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(2, TangentPromiseVisitor)
    }
}

/// Reads the byte, and the number behind a 2.
struct TangentPromiseVisitor;

impl<'de> Visitor<'de> for TangentPromiseVisitor {
    type Value = TangentPromise;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("0, 1, or 2 and a number")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<TangentPromise, A::Error> {
        let missing = |place| A::Error::invalid_length(place, &self);
        match seq.next_element::<u8>()?.ok_or_else(|| missing(0))? {
            0 => Ok(TangentPromise::None),
            1 => Ok(TangentPromise::AsPoints),
            2 => {
                let own = seq.next_element()?.ok_or_else(|| missing(1))?;
                Ok(TangentPromise::Own(own))
            }
            other => Err(A::Error::custom(format!(
                "{other} is no promise of tangents"
            ))),
        }
    }
}
