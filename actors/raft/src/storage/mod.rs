//! Storage of openraft over a [`LogStore`](crate::log_store::LogStore): the log, cached in memory,
//! and the state machine with its snapshots.

mod blocks;
mod load;
mod log_cache;
mod received_snapshot;
mod records;
mod snapshot_id;
mod state_machine;

pub(crate) use blocks::{Block, blocks_of};
pub(crate) use load::{load_state, open};
pub(crate) use received_snapshot::{PartError, ReceivedSnapshot};
#[cfg(feature = "test-util")]
pub(crate) use records::decode_record;
pub(crate) use records::{SnapshotError, StoredSnapshot, encode_record};
pub(crate) use snapshot_id::{has_checksum, snapshot_id};
pub use state_machine::ApplyObserver;
pub(crate) use state_machine::{AppliedState, StateMachineStore, compute, compute_apart};
