//! Several things in one input.

/// The pieces of an input: each has a byte that says what it is, and its length in two bytes before it. A last one that is cut
/// short is as long as there are bytes.
pub(super) fn frames(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let (&[kind, low, high], rest) = bytes.split_first_chunk::<3>()?;
        let length = usize::from(u16::from_le_bytes([low, high])).min(rest.len());
        let (piece, rest) = rest.split_at(length);
        bytes = rest;
        Some((kind, piece))
    })
}

/// A text, if it is one.
pub(super) fn text(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}
