//! The file that keeps sums over passes.
//!
//! In: a [`PassAccumulator`]. Out: a checkpoint from which the accumulation goes on. Little-endian: the magic, a key
//! (32 bytes) of everything that decides the passes, width, height and number of passes (8 bytes each), six f64 a
//! pixel (sums of radiance and of its squares, red, green, blue), and a checksum (XXH3, 8 bytes) of all before.

use super::PassAccumulator;
use geofan_core::{
    error::{Error, Result},
    files::write_atomically,
    reading::read_file,
};
use glam::DVec3;
use std::{io::Write, path::Path};
use xxhash_rust::xxh3::xxh3_64;

const MAGIC: &[u8; 16] = b"geofan passes1\r\n";
const HEAD: usize = 16 + 32 + 24;

impl PassAccumulator {
    /// Writes the checkpoint; `key` is everything that decides the passes.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path, key: &[u8; 32]) -> Result<()> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend_from_slice(key);
        let head = [self.size.0 as u64, self.size.1 as u64, self.passes];
        bytes.extend(head.iter().flat_map(|n| n.to_le_bytes()));
        let numbers = self.sums.iter().flatten().flat_map(|v| v.to_array());
        bytes.extend(numbers.flat_map(f64::to_le_bytes));
        bytes.extend(xxh3_64(&bytes).to_le_bytes());
        write_atomically(path, |out| out.write_all(&bytes))
    }

    /// Reads the checkpoint of [`PassAccumulator::save`].
    ///
    /// # Errors
    /// It cannot be read, is damaged, or belongs to another picture.
    pub fn load(path: &Path, key: &[u8; 32], size: (usize, usize)) -> Result<Self> {
        let bytes = read_file(path, MAGIC, u64::MAX)?;
        let complain = |message: &str| Error::input(path.display().to_string(), message);
        let damaged = || complain("is damaged; remove it and start again");
        let (body, sum) = bytes.split_last_chunk::<8>().ok_or_else(damaged)?;
        let whole = u64::from_le_bytes(*sum) == xxh3_64(body) && body.starts_with(MAGIC);
        if !whole || body.len() < HEAD {
            return Err(damaged());
        }
        let word = |at: usize| -> [u8; 8] { std::array::from_fn(|i| body[at + i]) };
        let number = |at: usize| u64::from_le_bytes(word(at));
        if body[16..48] != key[..] || (number(48), number(56)) != (size.0 as u64, size.1 as u64) {
            return Err(complain(
                "was begun for another picture: the scene, the camera, --size, --seed, --bounces, --length or --tolerance differ",
            ));
        }
        if (body.len() - HEAD) as u64 != 48 * (size.0 * size.1) as u64 {
            return Err(damaged());
        }
        let vector =
            |at: usize| DVec3::from_array([0, 8, 16].map(|k| f64::from_le_bytes(word(at + k))));
        let pixel = |i: usize| [vector(HEAD + 48 * i), vector(HEAD + 48 * i + 24)];
        Ok(Self {
            size,
            sums: (0..size.0 * size.1).map(pixel).collect(),
            passes: number(64),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::passes::tests::sums;
    use super::*;

    #[test]
    fn a_checkpoint_comes_back_and_no_other_or_damaged_one_does() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.passes");
        sums().save(&path, &[1; 32]).unwrap();
        assert_eq!(
            PassAccumulator::load(&path, &[1; 32], (2, 1)).unwrap(),
            sums()
        );
        assert_eq!(
            PassAccumulator::load(&path, &[2; 32], (2, 1))
                .unwrap_err()
                .exit_code(),
            2
        );
        assert!(PassAccumulator::load(&path, &[1; 32], (1, 2)).is_err());
        let bytes = std::fs::read(&path).unwrap();
        for i in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[i] ^= 16;
            std::fs::write(&path, &damaged).unwrap();
            assert!(PassAccumulator::load(&path, &[1; 32], (2, 1)).is_err());
        }
        for length in 0..bytes.len() {
            std::fs::write(&path, &bytes[..length]).unwrap();
            assert!(PassAccumulator::load(&path, &[1; 32], (2, 1)).is_err());
        }
    }
}
