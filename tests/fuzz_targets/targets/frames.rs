//! Composite inputs of several frames.

/// Splits an input into frames. Each frame begins with a byte for its kind and two bytes for its
/// length. A truncated last frame contains the remaining bytes.
pub(super) fn frames(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let (&[kind, low, high], rest) = bytes.split_first_chunk::<3>()?;
        let length = usize::from(u16::from_le_bytes([low, high])).min(rest.len());
        let (piece, rest) = rest.split_at(length);
        bytes = rest;
        Some((kind, piece))
    })
}

/// Returns the input as text, if it is UTF-8.
pub(super) fn text(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}
