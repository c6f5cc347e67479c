//! Errors of the opening of a store.

use super::layout::{LEDGER_FILE, StoreOwner};
use super::ledger_file::LedgerFileError;
use std::io;
use std::path::{Path, PathBuf};

/// Advice for the operator of a damaged store.
pub const REPAIR_ADVICE: &str = "while a majority of the other voters is alive, move the data directory away, and the \
    node joins again as an empty member; if no majority is left, run `consort recover --from DATA_DIR` on the data \
    directory of a node with an undamaged store; restore a copy of this data directory only if it was made after the \
    last run of the node";

/// The store cannot be opened. The content of its files is unchanged, except that `redb` may have
/// repaired the effects of a crash and may have released unused space.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Expected when a node is started twice, or recovered while it runs.
    #[error("{}: another process uses this data directory; each node needs one of its own", .folder.display())]
    InUse {
        /// Data directory.
        folder: PathBuf,
    },
    /// There is no store, and none may be created.
    #[error("{}: there is no ledger in this directory (file {LEDGER_FILE})", .folder.display())]
    NotFound {
        /// Data directory.
        folder: PathBuf,
    },
    /// The store belongs to another node. A mistake in the configuration.
    #[error("{}: this is the store of {found}, not of {expected}; each node needs a data directory of its own", .file.display())]
    WrongOwner {
        /// The ledger's file.
        file: PathBuf,
        /// Owner of the store.
        found: StoreOwner,
        /// Node that tried to open it.
        expected: StoreOwner,
    },
    /// A file was removed or damaged.
    #[error("{}: {damage}; {REPAIR_ADVICE}", .file.display())]
    Damaged {
        /// Affected file.
        file: PathBuf,
        /// Kind of damage.
        damage: String,
    },
    /// The store was written by a later release.
    #[error("{}: its format is {found}, which this release cannot read; use the release that wrote it", .file.display())]
    Format {
        /// The ledger's file.
        file: PathBuf,
        /// Format of the file.
        found: u64,
    },
    /// Error of the operating system: permissions, a disk that is full or broken.
    #[error("{}: {error}", .path.display())]
    Io {
        /// File or directory that was to be read or written.
        path: PathBuf,
        /// Error of the operating system.
        error: io::Error,
    },
}

impl OpenError {
    pub(super) fn io(path: &Path, error: io::Error) -> OpenError {
        OpenError::Io { path: path.to_owned(), error }
    }

    pub(super) fn damaged(file: &Path, damage: impl Into<String>) -> OpenError {
        OpenError::Damaged { file: file.to_owned(), damage: damage.into() }
    }

    pub(super) fn of(file: &Path, error: LedgerFileError) -> OpenError {
        match error {
            LedgerFileError::Damaged(damage) => OpenError::damaged(file, format!("it is damaged: {damage}")),
            LedgerFileError::Format(found) => OpenError::Format { file: file.to_owned(), found },
            LedgerFileError::Io(error) => OpenError::io(file, error),
        }
    }
}
