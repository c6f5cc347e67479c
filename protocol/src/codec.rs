//! The wire format: one version byte, then bincode. All of bincode that the project uses is in this file.
//!
//! Every message has a size limit ([`LIMIT`]), which also bounds what decoding may allocate (16 times that), and must be used
//! up exactly. Wire types are not recursive and skip no field: bincode does not describe itself. What a node stores for
//! itself (snapshots, log entries) has the same layout and a larger limit ([`RECORD_LIMIT`]); decoding one, too, may allocate
//! only in proportion to its length, since snapshots come from others.
//!
//! ```
//! use consort_protocol::codec::{self, CodecError};
//!
//! let mut bytes = codec::encode(&("IC Room 6", 0.9))?;
//! assert_eq!(codec::decode::<(String, f64)>(&bytes)?, ("IC Room 6".to_owned(), 0.9));
//! bytes[0] += 1;
//! assert!(matches!(codec::decode::<(String, f64)>(&bytes), Err(CodecError::Version { .. })));
//! # Ok::<(), CodecError>(())
//! ```

use bincode::config::{self, Config};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// First byte of every message whose layout has not changed since the first version of the wire ([`versions`](crate::versions)).
pub const FIRST_VERSION: u8 = 1;

/// A message whose layout has changed. The first byte says in which version of the wire its layout came; as long as a fleet writes
/// an earlier one, so is it written.
pub trait VersionedMessage: Serialize + DeserializeOwned + From<Self::Previous> {
    /// The version of the wire in which its layout came.
    const SINCE: u8;
    /// What it was before, since [`FIRST`].
    type Previous: Serialize + DeserializeOwned + From<Self>;
}

/// Largest message in bytes, version byte included.
pub const MESSAGE_BYTES_MAX: usize = 64 * 1024;

/// Largest stored record, in bytes. A guess: a mission takes some kilobytes, so this holds tens of thousands.
pub const RECORD_BYTES_MAX: usize = 256 * 1024 * 1024;

/// What decoding may take in memory, as a multiple of the largest message: bincode counts a number by its width there, and
/// the widest, of 16 bytes, may have been sent as one. With less, some of what may be sent could not be read.
const WIDENING: usize = 16;

/// Why bytes are not a message, or a value cannot become one. Nothing was changed.
#[derive(Debug, thiserror::Error)]
pub enum CodecError {
    /// Bytes from a node of another version, or not ours at all.
    #[error("wire version {found}, where {known} is read")]
    Version {
        /// The first byte found.
        found: u8,
        /// What could have been read.
        known: u8,
    },
    /// Nothing at all.
    #[error("empty message")]
    Empty,
    /// More than is allowed: for what is sent, the caller should have bounded it.
    #[error("message of {size} bytes, where {limit} are allowed")]
    TooLarge {
        /// Its size.
        size: usize,
        /// What is allowed.
        limit: usize,
    },
    /// Bytes behind the end of the message.
    #[error("{extra} bytes after the end of the message")]
    Trailing {
        /// How many.
        extra: usize,
    },
    /// Bytes that do not spell the expected message; ordinary only if somebody else writes on our keys.
    #[error("malformed message: {0}")]
    Malformed(String),
}

/// The message as bytes.
///
/// # Errors
/// [`CodecError::TooLarge`], and [`CodecError::Malformed`] for a value that cannot be told in bytes.
pub fn encode<T: Serialize>(message: &T) -> Result<Vec<u8>, CodecError> {
    encode_within(FIRST_VERSION, message, MESSAGE_BYTES_MAX)
}

/// The message as bytes, as a fleet that writes this version of the wire has them.
///
/// # Errors
/// As [`encode`].
pub fn encode_for_version<T: VersionedMessage>(wire: u8, message: T) -> Result<Vec<u8>, CodecError> {
    match wire >= T::SINCE {
        true => encode_within(T::SINCE, &message, MESSAGE_BYTES_MAX),
        false => encode_within(FIRST_VERSION, &T::Previous::from(message), MESSAGE_BYTES_MAX),
    }
}

/// The message that the bytes spell, be they of an earlier version.
///
/// # Errors
/// As [`decode`].
pub fn decode_any_version<T: VersionedMessage>(bytes: &[u8]) -> Result<T, CodecError> {
    match bytes.first() {
        Some(&FIRST) => decode::<T::Previous>(bytes).map(T::from),
        _ => decode_within(
            T::SINCE,
            bytes,
            MESSAGE_BYTES_MAX,
            config::standard().with_limit::<{ MESSAGE_BYTES_MAX * WIDENING }>(),
        ),
    }
}

/// The message that the bytes spell, all of them.
///
/// # Errors
/// [`CodecError`] says what is wrong; whatever the bytes are, this neither panics nor allocates beyond 16 times [`LIMIT`].
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CodecError> {
    decode_within(
        FIRST_VERSION,
        bytes,
        MESSAGE_BYTES_MAX,
        config::standard().with_limit::<{ MESSAGE_BYTES_MAX * WIDENING }>(),
    )
}

/// A record to be stored, as bytes.
///
/// # Errors
/// As [`encode`], beyond [`RECORD_LIMIT`].
pub fn encode_record<T: Serialize>(record: &T) -> Result<Vec<u8>, CodecError> {
    encode_within(FIRST_VERSION, record, RECORD_BYTES_MAX)
}

/// The stored record that the bytes spell, all of them.
///
/// # Errors
/// As [`decode`], beyond [`RECORD_LIMIT`].
pub fn decode_record<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CodecError> {
    // bincode's limit is a constant: the least of four that is enough for so many bytes.
    const SOME: usize = 1 << 20;
    const MANY: usize = 16 << 20;
    match bytes.len() {
        size if size <= MESSAGE_BYTES_MAX => decode_within(
            FIRST_VERSION,
            bytes,
            RECORD_BYTES_MAX,
            config::standard().with_limit::<{ MESSAGE_BYTES_MAX * WIDENING }>(),
        ),
        size if size <= SOME => decode_within(
            FIRST_VERSION,
            bytes,
            RECORD_BYTES_MAX,
            config::standard().with_limit::<{ SOME * WIDENING }>(),
        ),
        size if size <= MANY => decode_within(
            FIRST_VERSION,
            bytes,
            RECORD_BYTES_MAX,
            config::standard().with_limit::<{ MANY * WIDENING }>(),
        ),
        _ => decode_within(
            FIRST_VERSION,
            bytes,
            RECORD_BYTES_MAX,
            config::standard().with_limit::<{ RECORD_BYTES_MAX.saturating_mul(WIDENING) }>(),
        ),
    }
}

fn encode_within<T: Serialize>(layout: u8, value: &T, limit: usize) -> Result<Vec<u8>, CodecError> {
    let mut bytes = vec![layout];
    bincode::serde::encode_into_std_write(value, &mut bytes, config::standard())
        .map_err(|problem| CodecError::Malformed(problem.to_string()))?;
    match bytes.len() {
        size if size > limit => Err(CodecError::TooLarge { size, limit }),
        _ => Ok(bytes),
    }
}

fn decode_within<T: DeserializeOwned>(
    layout: u8,
    bytes: &[u8],
    limit: usize,
    config: impl Config,
) -> Result<T, CodecError> {
    if bytes.len() > limit {
        return Err(CodecError::TooLarge { size: bytes.len(), limit });
    }
    let (&version, body) = bytes.split_first().ok_or(CodecError::Empty)?;
    if version != layout {
        return Err(CodecError::Version { found: version, known: layout });
    }
    let (value, used) = bincode::serde::decode_from_slice(body, config)
        .map_err(|problem| CodecError::Malformed(problem.to_string()))?;
    match body.len() - used {
        0 => Ok(value),
        extra => Err(CodecError::Trailing { extra }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_used_up_exactly() {
        let mut bytes = encode(&("ada", 7u64)).unwrap();
        assert_eq!(decode::<(String, u64)>(&bytes).unwrap(), ("ada".to_owned(), 7));
        bytes.push(0);
        assert!(matches!(decode::<(String, u64)>(&bytes), Err(CodecError::Trailing { extra: 1 })));
    }

    #[test]
    fn another_version_is_named() {
        let mut bytes = encode(&1u8).unwrap();
        bytes[0] = 9;
        assert_eq!(decode::<u8>(&bytes).unwrap_err().to_string(), "wire version 9, where 1 is read");
        assert!(matches!(decode::<u8>(&[]), Err(CodecError::Empty)));
    }

    #[test]
    fn a_length_that_lies_allocates_nothing() {
        // A string said to be 2^60 bytes long.
        let bytes = [FIRST_VERSION, 253, 0, 0, 0, 0, 0, 0, 0, 16];
        assert!(matches!(decode::<String>(&bytes), Err(CodecError::Malformed(_))));
        assert!(matches!(decode::<Vec<u64>>(&bytes), Err(CodecError::Malformed(_))));
    }

    #[test]
    fn a_short_record_that_lies_takes_no_more_memory_than_a_message() {
        // A text said to be 2 MiB long, and one said to be 1 GiB long: neither is looked for.
        for lie in [2_u64 << 20, 1 << 30] {
            let mut bytes = vec![FIRST_VERSION, 253];
            bytes.extend(lie.to_le_bytes());
            let problem = decode_record::<String>(&bytes).unwrap_err().to_string();
            assert!(problem.contains("LimitExceeded"), "{problem}");
        }
        let long = vec!["a".to_owned(); 2 << 20];
        assert_eq!(decode_record::<Vec<String>>(&encode_record(&long).unwrap()).unwrap(), long);
    }

    #[test]
    fn all_that_may_be_sent_can_be_read() {
        // Numbers that are small are sent as one byte each.
        let narrow = vec![0_u128; MESSAGE_BYTES_MAX - 10];
        assert_eq!(decode::<Vec<u128>>(&encode(&narrow).unwrap()).unwrap(), narrow);
        let optional = vec![Some(7_u64); MESSAGE_BYTES_MAX / 2 - 10];
        assert_eq!(decode::<Vec<Option<u64>>>(&encode(&optional).unwrap()).unwrap(), optional);
        let words = vec!["a".to_owned(); MESSAGE_BYTES_MAX / 2 - 10];
        assert_eq!(decode::<Vec<String>>(&encode(&words).unwrap()).unwrap(), words);
    }

    #[test]
    fn what_is_too_large_is_not_sent() {
        let text = "x".repeat(MESSAGE_BYTES_MAX);
        assert!(encode(&text).is_err());
    }
}
