//! Material of the published evaluation, which is not in the repository.

use super::skip::skip;
use std::path::{Path, PathBuf};

/// Returns the folder of the published evaluation; skips the test if it is not installed.
pub(crate) fn reference() -> Option<PathBuf> {
    let default = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference");
    let folder = std::env::var_os("CONSORT_REFERENCE").map_or_else(default, PathBuf::from);
    let folder = folder.join("mission_control");
    if folder.join("bids_27.jsonl").is_file() {
        return Some(folder);
    }
    skip("no published evaluation (CONSORT_REFERENCE names the folder that contains it)");
    None
}
