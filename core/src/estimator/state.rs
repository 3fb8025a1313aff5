//! What a stream remembers as bytes and back: a version, a check sum, and the fields as postcard writes them.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Changes with every change of what is remembered.
const VERSION: u16 = 6;
const HEAD: usize = 10;

/// Why bytes are no state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StateError {
    /// They are cut short or changed.
    Damaged,
    /// They are of another version.
    OtherVersion(u16),
    /// They are of a stream with other settings.
    OtherSettings,
}

/// A state as bytes; equal states give equal bytes.
pub fn to_bytes<T: Serialize>(state: &T) -> Result<Vec<u8>, StateError> {
    let body = postcard::to_stdvec(state).map_err(|_| StateError::Damaged)?;
    let mut bytes = Vec::with_capacity(HEAD + body.len());
    bytes.extend_from_slice(&VERSION.to_le_bytes());
    bytes.extend_from_slice(&check_sum(&body).to_le_bytes());
    bytes.extend_from_slice(&body);
    Ok(bytes)
}

/// The state that [`to_bytes`] made bytes of.
pub fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, StateError> {
    let (head, body) = bytes.split_at_checked(HEAD).ok_or(StateError::Damaged)?;
    let version = u16::from_le_bytes([head[0], head[1]]);
    if version != VERSION {
        return Err(StateError::OtherVersion(version));
    }
    if head[2..] != check_sum(body).to_le_bytes() {
        return Err(StateError::Damaged);
    }
    match postcard::take_from_bytes(body) {
        Ok((state, [])) => Ok(state),
        Ok(_) | Err(_) => Err(StateError::Damaged),
    }
}

/// FNV-1a over words of eight bytes, with the length.
fn check_sum(body: &[u8]) -> u64 {
    let start = 0xcbf2_9ce4_8422_2325 ^ body.len() as u64;
    body.chunks(8).fold(start, |sum, chunk| {
        let mut word = [0; 8];
        word[..chunk.len()].copy_from_slice(chunk);
        (sum ^ u64::from_le_bytes(word)).wrapping_mul(0x0100_0000_01b3).rotate_left(29)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_state_comes_back(values in prop::collection::vec(any::<f64>(), 0..50), text in any::<Option<u32>>()) {
            let bytes = to_bytes(&(values.clone(), text)).unwrap();
            let (back, other): (Vec<f64>, Option<u32>) = from_bytes(&bytes).unwrap();
            prop_assert!(back.iter().zip(&values).all(|(a, b)| a.to_bits() == b.to_bits()) && other == text);
        }

        #[test]
        fn changed_or_cut_bytes_are_an_error(at in 0usize..40, flip in 1u8..=255) {
            let bytes = to_bytes(&vec![1.5f64, 2.5, 3.5, 4.5]).unwrap();
            prop_assert!(from_bytes::<Vec<f64>>(&bytes[..at]).is_err());
            let mut changed = bytes.clone();
            let place = at % bytes.len();
            changed[place] ^= flip;
            prop_assert!(from_bytes::<Vec<f64>>(&changed).is_err());
        }
    }

    #[test]
    fn another_version_is_named() {
        let mut bytes = to_bytes(&1u8).unwrap();
        bytes[0] = 77;
        assert_eq!(from_bytes::<u8>(&bytes), Err(StateError::OtherVersion(77)));
    }
}
