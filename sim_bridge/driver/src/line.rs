//! Lines of a driver, of bounded length.

use tokio::io::{AsyncBufRead, AsyncBufReadExt as _};

/// Greatest length of a line in bytes. A longer line is skipped.
pub const LINE_BYTES_MAX: usize = 64 << 10;

/// A line that was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum ReadLine {
    /// The line without its end; invalid UTF-8 is replaced.
    Text(String),
    /// A line longer than [`LINE_BYTES_MAX`].
    TooLong,
    /// The end of the stream.
    End,
}

/// Reads the next line. A failed read counts as the end of the stream.
pub(crate) async fn next_line(reader: &mut (impl AsyncBufRead + Unpin)) -> ReadLine {
    let (mut line, mut is_too_long) = (vec![], false);
    loop {
        let Ok(available) = reader.fill_buf().await else { return ReadLine::End };
        if available.is_empty() {
            let is_end = line.is_empty() && !is_too_long;
            return if is_end { ReadLine::End } else { finish(&line, is_too_long) };
        }
        let (part, has_end) = match available.iter().position(|byte| *byte == b'\n') {
            Some(end) => (&available[..end], true),
            None => (available, false),
        };
        is_too_long |= line.len() + part.len() > LINE_BYTES_MAX;
        if !is_too_long {
            line.extend_from_slice(part);
        }
        let consumed = part.len() + usize::from(has_end);
        reader.consume(consumed);
        if has_end {
            return finish(&line, is_too_long);
        }
    }
}

fn finish(line: &[u8], is_too_long: bool) -> ReadLine {
    if is_too_long { ReadLine::TooLong } else { ReadLine::Text(String::from_utf8_lossy(line).into_owned()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn long_lines_are_skipped_and_their_memory_is_bounded() {
        let mut input = vec![b'x'; LINE_BYTES_MAX];
        input.extend(b"\n");
        input.extend(vec![b'y'; LINE_BYTES_MAX + 1]);
        input.extend(b"\nshort\n\nlast");
        let mut reader = tokio::io::BufReader::with_capacity(100, &input[..]);
        assert_eq!(next_line(&mut reader).await, ReadLine::Text("x".repeat(LINE_BYTES_MAX)));
        assert_eq!(next_line(&mut reader).await, ReadLine::TooLong);
        for text in ["short", "", "last"] {
            assert_eq!(next_line(&mut reader).await, ReadLine::Text(text.to_owned()));
        }
        assert_eq!(next_line(&mut reader).await, ReadLine::End);
    }
}
