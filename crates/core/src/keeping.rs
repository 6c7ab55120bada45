//! Results of long work that are kept from one run of a program to the next, where the caller has a place for them.
//!
//! In: a key that everything which a result depends on is hashed into, and how to make it. Out: the result, made now or
//! read from what an earlier run kept ([`kept`]). Without the feature `files` nothing is kept.

#[cfg(feature = "files")]
use std::cell::RefCell;
use std::rc::Rc;

/// Names a result: equal for equal input.
pub type ResultKey = [u8; 32];

/// A place where results are kept.
pub trait ResultStore {
    /// Returns what is kept under `key`, undamaged.
    fn get(&self, key: &ResultKey) -> Option<Vec<u8>>;

    /// Keeps `bytes` under `key`, if it can.
    fn put(&self, key: &ResultKey, bytes: Vec<u8>);
}

#[cfg(feature = "files")]
thread_local! {
    /// Where this thread keeps results.
    static STORE: RefCell<Option<Rc<dyn ResultStore>>> = const { RefCell::new(None) };
}

/// Does `work`; results of what this thread does in it are kept in `store`.
#[cfg(feature = "files")]
pub fn with_store<T>(store: Rc<dyn ResultStore>, work: impl FnOnce() -> T) -> T {
    let before = STORE.replace(Some(store));
    let done = work();
    STORE.set(before);
    done
}

/// Returns where this thread keeps results.
fn store() -> Option<Rc<dyn ResultStore>> {
    #[cfg(feature = "files")]
    return STORE.with_borrow(Clone::clone);
    #[cfg(not(feature = "files"))]
    None
}

/// Says how a result is kept.
pub struct Keeping<K, R, W> {
    /// Makes its key.
    pub key: K,
    /// Reads it; `None` for bytes of anything else.
    pub read: R,
    /// Writes it; `None` where it is not to be kept.
    pub write: W,
}

/// Returns what `make` makes, or what it made in an earlier run with the same key.
///
/// # Errors
/// Those of `make`; nothing is kept of them.
pub fn kept<T, E>(
    keeping: Keeping<
        impl FnOnce() -> ResultKey,
        impl FnOnce(&[u8]) -> Option<T>,
        impl FnOnce(&T) -> Option<Vec<u8>>,
    >,
    make: impl FnOnce() -> Result<T, E>,
) -> Result<T, E> {
    let Some(store) = store() else {
        return make();
    };
    let key = (keeping.key)();
    if let Some(result) = store.get(&key).and_then(|bytes| (keeping.read)(&bytes)) {
        return Ok(result);
    }
    let result = make()?;
    if let Some(bytes) = (keeping.write)(&result) {
        store.put(&key, bytes);
    }
    Ok(result)
}

#[cfg(all(test, feature = "files"))]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    impl ResultStore for RefCell<BTreeMap<ResultKey, Vec<u8>>> {
        fn get(&self, key: &ResultKey) -> Option<Vec<u8>> {
            self.borrow().get(key).cloned()
        }

        fn put(&self, key: &ResultKey, bytes: Vec<u8>) {
            self.borrow_mut().insert(*key, bytes);
        }
    }

    /// Squares a small number, and tells whether it had to.
    fn square(x: u8) -> Result<(u8, bool), &'static str> {
        let mut made = false;
        let keeping = Keeping {
            key: || [x; 32],
            read: |bytes: &[u8]| match bytes {
                [square] => Some(*square),
                _ => None,
            },
            write: |square: &u8| (*square != 9).then(|| vec![*square]),
        };
        let square = kept(keeping, || {
            made = true;
            x.checked_mul(x).ok_or("too large")
        });
        square.map(|square| (square, made))
    }

    #[test]
    fn a_result_is_made_once_where_there_is_a_place_for_it() {
        let store = Rc::new(RefCell::new(BTreeMap::new()));
        let all = || [square(2), square(3), square(2), square(3), square(99)];
        let again = [Ok((4, true)), Ok((9, true))];
        assert_eq!(all()[2..4], again, "nothing is kept without a store");
        let with = with_store(store.clone(), all);
        let expected = [Ok((4, true)), Ok((9, true)), Ok((4, false)), Ok((9, true))];
        assert_eq!(with[..4], expected);
        assert_eq!(with[4], Err("too large"));
        assert_eq!(square(2), Ok((4, true)), "the store is gone");
        // What is not a square is made again.
        store.put(&[2; 32], vec![1, 2]);
        assert_eq!(with_store(store, || square(2)), Ok((4, true)));
    }
}
