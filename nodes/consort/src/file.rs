//! Reads and writes whole files.

use crate::diagnostic::Diagnostic;
use crate::exit::Failure;
use std::fs;
use std::io::{self, Read};
use std::path::Path;

/// Maximum size of a file that is read whole, in bytes.
pub(crate) const BYTES_MAX: u64 = 16 << 20;

/// Reason why a file was not read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FileReadError {
    /// The system refuses it, or it is not text.
    #[error("cannot be read: {0}")]
    Unreadable(#[from] io::Error),
    /// The file is larger than allowed.
    #[error("{0} bytes are more than the {1} allowed")]
    TooLarge(u64, u64),
    /// A pipe or a device, which has no size in advance, gave more than allowed.
    #[error("it has more than the {0} bytes allowed")]
    StreamTooLarge(u64),
}

/// Reads a text file of at most `bytes_max` bytes.
///
/// # Errors
/// [`FileReadError`], without the file's name. Nothing beyond the limit was read.
pub(crate) fn read_text(file: &Path, bytes_max: u64) -> Result<String, FileReadError> {
    let file = fs::File::open(file)?;
    let bytes = file.metadata()?.len();
    if bytes > bytes_max {
        return Err(FileReadError::TooLarge(bytes, bytes_max));
    }
    let mut read = vec![];
    if file.take(bytes_max + 1).read_to_end(&mut read)? as u64 > bytes_max {
        return Err(FileReadError::StreamTooLarge(bytes_max));
    }
    let no_text = |_| io::Error::new(io::ErrorKind::InvalidData, "stream did not contain valid UTF-8");
    Ok(String::from_utf8(read).map_err(no_text)?)
}

/// Writes a file atomically, with these permissions: a concurrent reader finds the former content.
///
/// # Errors
/// [`Diagnostic`] with the file and the system's message; the former content is unchanged.
pub(crate) fn write_atomically(file: &Path, text: &str, mode: u32) -> Result<(), Diagnostic> {
    let written = consort_bus::trust::write_atomically(file, text.as_bytes(), mode);
    written.map_err(|problem| Diagnostic::for_file(file.display(), problem))
}

/// Returns the error for an existing file that `--force` would replace.
pub(crate) fn already_exists(file: &Path) -> Failure {
    Failure::Usage(format!("{}: this file exists already; --force replaces it", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reading_stops_at_the_limit_even_for_endless_files() {
        let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml");
        let whole = read_text(&manifest, BYTES_MAX).expect("it is there");
        let bytes = whole.len() as u64;
        assert_eq!(read_text(&manifest, bytes).expect("it is just as large"), whole);
        let error_of = |file: &Path, max| read_text(file, max).expect_err("it is too large").to_string();
        assert_eq!(error_of(&manifest, bytes - 1), format!("{bytes} bytes are more than the {} allowed", bytes - 1));
        assert_eq!(error_of(Path::new("/dev/zero"), 100), "it has more than the 100 bytes allowed");
        let absent = error_of(Path::new("/nowhere"), 100);
        assert!(absent.starts_with("cannot be read: No such file"), "{absent}");
    }
}
