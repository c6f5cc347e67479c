//! Durable store: the promises of a node survive its process and a power failure.
//!
//! ```text
//!   DATA_DIR/ledger.redb   log, vote, snapshot, and the checkpoint of the robot
//!            ledger.seal   commit marker: owner of the ledger, and last write known to be on disk (see `commit_marker`)
//!            lock          held by the only process that may write
//!            damaged-N/    former files that were damaged (see `quarantine`)
//! ```
//!
//! Guarantees:
//! - When a write returns `Ok`, it is on disk; only the committed position may lag. Writes are
//!   carried out in the order of the calls, and concurrent writes share a single sync of the disk. A large snapshot is
//!   written in pieces, with other writes between them; a snapshot of the leader in few, large writes.
//! - After a failed write nothing more is written, since the content of the disk is then unknown.
//!   The replica stops for good.
//! - A read returns the written data, or an error that names the file and a possible repair: when
//!   the store is opened, pages are verified by their checksums, and the last write by the commit
//!   marker. A single case is left: damage to the very last write before a *power* failure, within
//!   `SETTLE_DELAY` of it, looks like an unfinished write.
//! - A directory that once contained a ledger is never treated as a new directory: the store that replaces a
//!   damaged store bootstraps no cluster.

mod commit_marker;
mod directory;
mod durable_store;
mod layout;
mod ledger_file;
mod open;
mod open_error;
mod quarantine;

pub use durable_store::DurableStore;
pub use layout::{COMMIT_MARKER_FILE, LEDGER_FILE, StoreOwner};
pub use open_error::{OpenError, REPAIR_ADVICE};
pub use quarantine::Quarantine;
#[cfg(feature = "test-util")]
pub use redb::StorageBackend;
