//! How Raft's messages and records become bytes. Two functions, so that the format can be exchanged in one place.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// The layout of everything below. Another layout is another number.
const VERSION: u8 = 1;

/// Largest message between two nodes, in bytes; the bus carries more, but nothing of ours needs it.
pub(super) const FRAME_MAX: usize = 64 * 1024;

/// Largest snapshot or stored record, in bytes. A guess: a ledger entry is some hundred bytes, so this holds
/// hundreds of thousands of missions.
pub(super) const RECORD_MAX: usize = 256 * 1024 * 1024;

/// Why bytes are not a value, or a value gives no bytes.
#[derive(Debug, thiserror::Error)]
pub(super) enum CodecError {
    #[error("{size} bytes are more than the {max} allowed")]
    TooLarge { size: usize, max: usize },
    #[error("layout {found} is not {VERSION}, which this release reads")]
    Version { found: u8 },
    #[error("{0} bytes are left over after the value")]
    LeftOver(usize),
    #[error("nothing is there")]
    Empty,
    #[error("cannot encode: {0}")]
    Encode(#[from] bincode::error::EncodeError),
    #[error("cannot decode: {0}")]
    Decode(#[from] bincode::error::DecodeError),
}

/// The bytes of `value`, at most `max` of them.
pub(super) fn encode<T: Serialize>(value: &T, max: usize) -> Result<Vec<u8>, CodecError> {
    let mut bytes = vec![VERSION];
    bincode::serde::encode_into_std_write(value, &mut bytes, bincode::config::standard())?;
    if bytes.len() > max {
        return Err(CodecError::TooLarge { size: bytes.len(), max });
    }
    Ok(bytes)
}

/// The value whose bytes these are, all of them.
pub(super) fn decode<T: DeserializeOwned>(bytes: &[u8], max: usize) -> Result<T, CodecError> {
    if bytes.len() > max {
        return Err(CodecError::TooLarge { size: bytes.len(), max });
    }
    let (version, body) = bytes.split_first().ok_or(CodecError::Empty)?;
    if *version != VERSION {
        return Err(CodecError::Version { found: *version });
    }
    // The limit is what a value may claim to need, so that a forged length cannot make us allocate.
    let config = bincode::config::standard().with_limit::<RECORD_MAX>();
    let (value, read) = bincode::serde::decode_from_slice(body, config)?;
    if read != body.len() {
        return Err(CodecError::LeftOver(body.len() - read));
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_encoded_is_read_back_and_nothing_else_is() {
        let value = (7_u64, "ada".to_owned(), vec![1_u8, 2, 3]);
        let bytes = encode(&value, FRAME_MAX).unwrap();
        assert_eq!(decode::<(u64, String, Vec<u8>)>(&bytes, FRAME_MAX).unwrap(), value);
        assert!(decode::<(u64, String, Vec<u8>)>(&bytes[..bytes.len() - 1], FRAME_MAX).is_err());
        assert!(decode::<(u64, String, Vec<u8>)>(&[&bytes[..], &[0]].concat(), FRAME_MAX).is_err());
        assert!(decode::<(u64, String, Vec<u8>)>(&[&[9], &bytes[1..]].concat(), FRAME_MAX).is_err());
        assert!(decode::<(u64, String, Vec<u8>)>(&[], FRAME_MAX).is_err());
        assert!(matches!(encode(&value, 4), Err(CodecError::TooLarge { .. })));
    }
}
