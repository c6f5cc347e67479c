//! Wire format: a version byte, then bincode. All uses of bincode in the project are in this file.
//!
//! Every message has a size limit ([`MESSAGE_BYTES_MAX`]). The limit also bounds the memory that
//! decoding may allocate (16 times the limit). All bytes must be used. Wire types are not recursive
//! and skip no field, since bincode is not self-describing. Data that a node stores for itself
//! (snapshots, log entries) has the same layout and a larger limit ([`RECORD_BYTES_MAX`]). Decoding
//! it may also allocate only in proportion to its length, since snapshots come from other nodes.
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

/// First byte of every message with a layout that has not changed since the first wire version
/// ([`versions`](crate::versions)).
pub const FIRST_VERSION: u8 = 1;

/// First byte of every stored record. Version 2 adds the results of tasks; a store of releases up to 0.2.0
/// has version 1 and is not read.
pub const RECORD_VERSION: u8 = 2;

/// Message with a layout that has changed. The first byte is the wire version in which its layout
/// was introduced. While a fleet writes an earlier version, the message is written in the earlier
/// layout.
pub trait VersionedMessage: Serialize + DeserializeOwned + From<Self::Previous> {
    /// Wire version in which the layout was introduced.
    const SINCE: u8;
    /// Earlier layout, since [`FIRST_VERSION`].
    type Previous: Serialize + DeserializeOwned + From<Self>;
}

/// Maximum size of a message in bytes, including the version byte.
pub const MESSAGE_BYTES_MAX: usize = 64 * 1024;

/// Maximum size of a stored record, in bytes. A guess: a mission takes some kilobytes, so a record
/// has room for tens of thousands of missions.
pub const RECORD_BYTES_MAX: usize = 256 * 1024 * 1024;

/// Memory that decoding may allocate, as a multiple of the largest message. bincode counts a number
/// by its width in memory, and the widest number, of 16 bytes, may have been sent as a single byte.
/// With a smaller factor some valid messages could not be decoded.
const WIDENING: usize = 16;

/// Error: bytes are not a message, or a value cannot be encoded. Nothing was changed.
#[derive(Debug, thiserror::Error)]
pub enum CodecError {
    /// The bytes come from a node of another version, or from another program.
    #[error("wire version {found}; this decoder reads version {known}")]
    Version {
        /// First byte found.
        found: u8,
        /// Version that this decoder reads.
        known: u8,
    },
    /// There are no bytes.
    #[error("empty message")]
    Empty,
    /// The message is larger than allowed. The sender should have bounded its size.
    #[error("message of {size} bytes; at most {limit} are allowed")]
    TooLarge {
        /// Size of the message.
        size: usize,
        /// Maximum size.
        limit: usize,
    },
    /// There are bytes after the end of the message.
    #[error("{extra} bytes after the end of the message")]
    Trailing {
        /// Number of extra bytes.
        extra: usize,
    },
    /// The bytes do not encode the expected message; common only if another program writes on our
    /// keys.
    #[error("malformed message: {0}")]
    Malformed(String),
}

/// Encodes a message.
///
/// # Errors
/// [`CodecError::TooLarge`], and [`CodecError::Malformed`] for a value that cannot be encoded.
pub fn encode<T: Serialize>(message: &T) -> Result<Vec<u8>, CodecError> {
    encode_within(FIRST_VERSION, message, MESSAGE_BYTES_MAX)
}

/// Returns the size of an encoded value in bytes; the largest number if it cannot be encoded as a
/// message.
pub(crate) fn encoded_size<T: Serialize>(value: &T) -> usize {
    encode(value).map_or(usize::MAX, |bytes| bytes.len())
}

/// Encodes a message in the layout of a fleet that writes this wire version.
///
/// # Errors
/// Same as [`encode`].
pub fn encode_for_version<T: VersionedMessage>(wire: u8, message: T) -> Result<Vec<u8>, CodecError> {
    match wire >= T::SINCE {
        true => encode_within(T::SINCE, &message, MESSAGE_BYTES_MAX),
        false => encode_within(FIRST_VERSION, &T::Previous::from(message), MESSAGE_BYTES_MAX),
    }
}

/// Decodes a message in its current or its earlier layout.
///
/// # Errors
/// Same as [`decode`].
pub fn decode_any_version<T: VersionedMessage>(bytes: &[u8]) -> Result<T, CodecError> {
    match bytes.first() {
        Some(&FIRST_VERSION) => decode::<T::Previous>(bytes).map(T::from),
        _ => decode_within(
            T::SINCE,
            bytes,
            MESSAGE_BYTES_MAX,
            config::standard().with_limit::<{ MESSAGE_BYTES_MAX * WIDENING }>(),
        ),
    }
}

/// Decodes a message; all bytes must be used.
///
/// # Errors
/// [`CodecError`]; for any bytes this neither panics nor allocates more than 16 times
/// [`MESSAGE_BYTES_MAX`].
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CodecError> {
    decode_within(
        FIRST_VERSION,
        bytes,
        MESSAGE_BYTES_MAX,
        config::standard().with_limit::<{ MESSAGE_BYTES_MAX * WIDENING }>(),
    )
}

/// Encodes a record to be stored.
///
/// # Errors
/// Same as [`encode`], beyond [`RECORD_BYTES_MAX`].
pub fn encode_record<T: Serialize>(record: &T) -> Result<Vec<u8>, CodecError> {
    encode_within(RECORD_VERSION, record, RECORD_BYTES_MAX)
}

/// Decodes a stored record; all bytes must be used.
///
/// # Errors
/// Same as [`decode`], beyond [`RECORD_BYTES_MAX`].
pub fn decode_record<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CodecError> {
    // The limit of bincode is a constant. This selects the smallest of four that is sufficient for
    // the number of bytes.
    const SOME: usize = 1 << 20;
    const MANY: usize = 16 << 20;
    match bytes.len() {
        size if size <= MESSAGE_BYTES_MAX => decode_within(
            RECORD_VERSION,
            bytes,
            RECORD_BYTES_MAX,
            config::standard().with_limit::<{ MESSAGE_BYTES_MAX * WIDENING }>(),
        ),
        size if size <= SOME => decode_within(
            RECORD_VERSION,
            bytes,
            RECORD_BYTES_MAX,
            config::standard().with_limit::<{ SOME * WIDENING }>(),
        ),
        size if size <= MANY => decode_within(
            RECORD_VERSION,
            bytes,
            RECORD_BYTES_MAX,
            config::standard().with_limit::<{ MANY * WIDENING }>(),
        ),
        _ => decode_within(
            RECORD_VERSION,
            bytes,
            RECORD_BYTES_MAX,
            config::standard().with_limit::<{ RECORD_BYTES_MAX.saturating_mul(WIDENING) }>(),
        ),
    }
}

fn encode_within<T: Serialize>(layout: u8, value: &T, limit: usize) -> Result<Vec<u8>, CodecError> {
    let mut bytes = vec![layout];
    bincode::serde::encode_into_std_write(value, &mut bytes, config::standard())
        .map_err(|error| CodecError::Malformed(error.to_string()))?;
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
    let (value, used) =
        bincode::serde::decode_from_slice(body, config).map_err(|error| CodecError::Malformed(error.to_string()))?;
    match body.len() - used {
        0 => Ok(value),
        extra => Err(CodecError::Trailing { extra }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extra_bytes_after_a_message_are_rejected() {
        let mut bytes = encode(&("ada", 7u64)).unwrap();
        assert_eq!(decode::<(String, u64)>(&bytes).unwrap(), ("ada".to_owned(), 7));
        bytes.push(0);
        assert!(matches!(decode::<(String, u64)>(&bytes), Err(CodecError::Trailing { extra: 1 })));
    }

    #[test]
    fn another_version_is_rejected_with_its_number() {
        let mut bytes = encode(&1u8).unwrap();
        bytes[0] = 9;
        assert_eq!(decode::<u8>(&bytes).unwrap_err().to_string(), "wire version 9; this decoder reads version 1");
        assert!(matches!(decode::<u8>(&[]), Err(CodecError::Empty)));
    }

    #[test]
    fn a_false_length_allocates_nothing() {
        // A string with a stated length of 2^60 bytes.
        let bytes = [FIRST_VERSION, 253, 0, 0, 0, 0, 0, 0, 0, 16];
        assert!(matches!(decode::<String>(&bytes), Err(CodecError::Malformed(_))));
        assert!(matches!(decode::<Vec<u64>>(&bytes), Err(CodecError::Malformed(_))));
    }

    #[test]
    fn a_false_length_in_a_short_record_is_bounded_like_a_message() {
        // Texts with a stated length of 2 MiB and of 1 GiB: neither is allocated.
        for false_length in [2_u64 << 20, 1 << 30] {
            let mut bytes = vec![RECORD_VERSION, 253];
            bytes.extend(false_length.to_le_bytes());
            let error = decode_record::<String>(&bytes).unwrap_err().to_string();
            assert!(error.contains("LimitExceeded"), "{error}");
        }
        let long = vec!["a".to_owned(); 2 << 20];
        assert_eq!(decode_record::<Vec<String>>(&encode_record(&long).unwrap()).unwrap(), long);
    }

    #[test]
    fn every_message_within_the_limit_can_be_decoded() {
        // Small numbers are encoded as a single byte each.
        let narrow = vec![0_u128; MESSAGE_BYTES_MAX - 10];
        assert_eq!(decode::<Vec<u128>>(&encode(&narrow).unwrap()).unwrap(), narrow);
        let optional = vec![Some(7_u64); MESSAGE_BYTES_MAX / 2 - 10];
        assert_eq!(decode::<Vec<Option<u64>>>(&encode(&optional).unwrap()).unwrap(), optional);
        let words = vec!["a".to_owned(); MESSAGE_BYTES_MAX / 2 - 10];
        assert_eq!(decode::<Vec<String>>(&encode(&words).unwrap()).unwrap(), words);
    }

    #[test]
    fn a_message_above_the_limit_is_rejected() {
        let text = "x".repeat(MESSAGE_BYTES_MAX);
        assert!(encode(&text).is_err());
    }
}
