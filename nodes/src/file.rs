//! Files that are there whole or not at all.

use crate::config::Problem;
use crate::exit::Failure;
use std::fs;
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Writes a file as a whole or not at all, with these rights: whoever reads it meanwhile finds what was there.
///
/// # Errors
/// [`Problem`] with the file and what the system says; what was there is as it was.
pub(crate) fn write_whole(file: &Path, text: &str, mode: u32) -> Result<(), Problem> {
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
    written().map_err(|problem: io::Error| Problem::of(file.display(), problem))
}

/// What somebody hears whose file is there already, where `--force` replaces it.
pub(crate) fn there_already(file: &Path) -> Failure {
    Failure::Usage(format!("{}: this file is there already; --force replaces it", file.display()))
}
