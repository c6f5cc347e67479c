//! Files that are read or written whole, or not at all.

use crate::config::Diagnostic;
use crate::exit::Failure;
use std::fs;
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Largest file of any kind that is read whole, in bytes.
pub(crate) const BYTES_MAX: u64 = 16 << 20;

/// Why a file was not read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FileReadError {
    /// The system does not give it, or it is no text.
    #[error("cannot be read: {0}")]
    Unreadable(#[from] io::Error),
    /// So many bytes are more than it may have.
    #[error("{0} bytes are more than the {1} allowed")]
    TooLarge(u64, u64),
    /// A pipe or a device, which does not say how long it is, gave more than it may have.
    #[error("it has more than the {0} bytes allowed")]
    StreamTooLarge(u64),
}

/// The text of a file of at most so many bytes.
///
/// # Errors
/// [`ReadError`], without the file's name; no more of it was read than is allowed.
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

/// Writes a file as a whole or not at all, with these rights: whoever reads it meanwhile finds what was there.
///
/// # Errors
/// [`Problem`] with the file and what the system says; what was there is as it was.
pub(crate) fn write_atomically(file: &Path, text: &str, mode: u32) -> Result<(), Diagnostic> {
    let unfinished = file.with_extension("new");
    let written = || {
        let mut options = fs::OpenOptions::new();
        // What a former attempt left may have been made with other rights.
        let _ = fs::remove_file(&unfinished);
        let mut to = options.write(true).create_new(true).mode(mode).open(&unfinished)?;
        to.write_all(text.as_bytes())?;
        to.sync_all()?;
        fs::rename(&unfinished, file)
    };
    written().map_err(|problem: io::Error| Diagnostic::for_file(file.display(), problem))
}

/// What somebody hears whose file is there already, where `--force` replaces it.
pub(crate) fn already_exists(file: &Path) -> Failure {
    Failure::Usage(format!("{}: this file is there already; --force replaces it", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_is_read_than_is_allowed_even_of_what_has_no_end() {
        let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml");
        let whole = read_text(&manifest, BYTES_MAX).expect("it is there");
        let bytes = whole.len() as u64;
        assert_eq!(read_text(&manifest, bytes).expect("it is just as large"), whole);
        let said = |file: &Path, max| read_text(file, max).expect_err("it is too large").to_string();
        assert_eq!(said(&manifest, bytes - 1), format!("{bytes} bytes are more than the {} allowed", bytes - 1));
        assert_eq!(said(Path::new("/dev/zero"), 100), "it has more than the 100 bytes allowed");
        let absent = said(Path::new("/nowhere"), 100);
        assert!(absent.starts_with("cannot be read: No such file"), "{absent}");
    }
}
