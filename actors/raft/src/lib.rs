//! Replicated ledger: a state machine replicated by Raft (`openraft`) over the project's own bus.
//!
//! ```text
//!             propose, read, leadership                          other voters
//!   actors ──────────────────────────────► Replica                      ▲
//!                                             │                         │ bus queries, one key per raft id
//!                                             ▼                         ▼
//!                storage ◄────────────── openraft core ──────────► network, server
//!          (log, vote, snapshot;              ▲
//!           durable in a LogStore)            └── `election` triggers heartbeats and campaigns
//! ```
//!
//! Guarantees:
//! - A command for which [`Replica::propose`] returned `Ok` has the same position in the ledger of
//!   every node that applies up to that position, while a majority of the voters' log stores
//!   survive.
//! - [`LeadershipView::is_leader`] is true only on a node that has applied all entries committed
//!   before its term, and that a majority acknowledged within
//!   [`RaftSettings::check_quorum_timeout`]. It is still only a view of the recent past: an action
//!   outside the ledger carries the [`LeaderId`] or an [`Epoch`] as its fencing token.
//! - Each term has a single leader at most (openraft's `single-term-leader`). So the term of a
//!   [`LeaderId`] orders actions outside the ledger, and the [`Epoch`] of an applied entry orders
//!   the grants made by that entry.
//! - A leader that leaves by [`Replica::transfer_leadership`] has a successor within a few round
//!   trips. So has a leader whose process dies, if its node announces its presence.
//!
//! The reasons for Raft instead of a lock, a lease or gossip are in Ongaro and Ousterhout, *In
//! search of an understandable consensus algorithm*, 2014. The time of a campaign is decided by
//! `election`, not by openraft, which has neither pre-vote nor check-quorum.

mod acknowledgements;
mod election;
mod errors;
#[cfg(feature = "test-util")]
pub mod fuzz_api;
mod group_commit;
mod leader_contact;
mod leader_loss;
mod leadership_transfer;
mod leadership_view;
mod ledger;
mod log_store;
mod messages;
mod network;
mod offline_recovery;
mod replica;
mod runtime;
mod server;
mod settings;
mod staleness;
mod storage;
pub mod store;
mod types;

pub use errors::{BootstrapError, MemberError, ProposeError, StartError, TransferError};
pub use leadership_view::LeadershipView;
pub use log_store::{LogStore, MemoryLogStore, PersistentState, StoreIdentity};
pub use offline_recovery::{LogStoreContents, inspect_log_store, recover_as_only_voter};
pub use replica::Replica;
pub use settings::{LOG_ENTRIES_KEPT, RaftSettings, RaftSettingsError, SNAPSHOT_EVERY};
pub use storage::ApplyObserver;
pub use types::{Epoch, LeaderId, RaftId, StateMachine};
