//! The wire format: one version byte, then bincode. All of bincode that the project uses is in this file.
//!
//! Every message has a size limit ([`LIMIT`]), which also bounds what decoding may allocate, and must be used up
//! exactly. Wire types are not recursive and skip no field: bincode does not describe itself.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// First byte of every message. A change that older nodes cannot read raises it.
pub const VERSION: u8 = 1;

/// Largest message in bytes, version byte included.
pub const LIMIT: usize = 64 * 1024;

/// Why bytes are not a message, or a value cannot become one. Nothing was changed.
#[derive(Debug, thiserror::Error)]
pub enum CodecError {
    /// Bytes from a node of another version, or not ours at all.
    #[error("wire version {found}, where this node speaks {VERSION}")]
    Version {
        /// The first byte found.
        found: u8,
    },
    /// Nothing at all.
    #[error("empty message")]
    Empty,
    /// More than fits a message: for what is sent, the caller should have bounded it.
    #[error("message of {size} bytes, where {LIMIT} are allowed")]
    TooLarge {
        /// Its size, or the least that it would have had.
        size: usize,
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

fn config() -> impl bincode::config::Config {
    bincode::config::standard().with_limit::<LIMIT>()
}

/// The message as bytes.
///
/// # Errors
/// [`CodecError::TooLarge`], and [`CodecError::Malformed`] for a value that cannot be told in bytes.
pub fn encode<T: Serialize>(message: &T) -> Result<Vec<u8>, CodecError> {
    let body = bincode::serde::encode_to_vec(message, config()).map_err(|e| CodecError::Malformed(e.to_string()))?;
    let size = body.len() + 1;
    if size > LIMIT {
        return Err(CodecError::TooLarge { size });
    }
    let mut bytes = Vec::with_capacity(size);
    bytes.push(VERSION);
    bytes.extend(body);
    Ok(bytes)
}

/// The message that the bytes spell, all of them.
///
/// # Errors
/// [`CodecError`] says what is wrong; whatever the bytes are, this neither panics nor allocates beyond [`LIMIT`].
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CodecError> {
    if bytes.len() > LIMIT {
        return Err(CodecError::TooLarge { size: bytes.len() });
    }
    let (&version, body) = bytes.split_first().ok_or(CodecError::Empty)?;
    if version != VERSION {
        return Err(CodecError::Version { found: version });
    }
    let (message, used) =
        bincode::serde::decode_from_slice(body, config()).map_err(|e| CodecError::Malformed(e.to_string()))?;
    match body.len() - used {
        0 => Ok(message),
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
        assert_eq!(decode::<u8>(&bytes).unwrap_err().to_string(), "wire version 9, where this node speaks 1");
        assert!(matches!(decode::<u8>(&[]), Err(CodecError::Empty)));
    }

    #[test]
    fn a_length_that_lies_allocates_nothing() {
        // A string said to be 2^60 bytes long.
        let bytes = [VERSION, 253, 0, 0, 0, 0, 0, 0, 0, 16];
        assert!(matches!(decode::<String>(&bytes), Err(CodecError::Malformed(_))));
        assert!(matches!(decode::<Vec<u64>>(&bytes), Err(CodecError::Malformed(_))));
    }

    #[test]
    fn what_is_too_large_is_not_sent() {
        let text = "x".repeat(LIMIT);
        assert!(encode(&text).is_err());
    }
}
