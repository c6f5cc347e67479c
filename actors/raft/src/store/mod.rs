//! Storage of a node across restarts.

mod backup;
mod checkpoint_store;
mod durable;
mod node_store;
mod recover;
#[cfg(feature = "test-util")]
mod simulated_file;

pub use backup::{Backup, BackupError, restore};
pub use checkpoint_store::CheckpointStore;
#[cfg(feature = "test-util")]
pub use durable::StorageBackend;
pub use durable::{COMMIT_MARKER_FILE, DurableStore, LEDGER_FILE, OpenError, Quarantine, REPAIR_ADVICE, StoreOwner};
pub use node_store::NodeStore;
pub use recover::{inspect_ledger, recover};
#[cfg(feature = "test-util")]
pub use simulated_file::SimulatedFile;
