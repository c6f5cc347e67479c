//! The ledger that survives its nodes: a state machine replicated by Raft (`openraft`), over our own bus.
//!
//! ```text
//!             propose, read, leadership                          the other voters
//!   actors ──────────────────────────────► Replica                      ▲
//!                                             │                         │ bus queries, one key per raft id
//!                                             ▼                         ▼
//!                  store ◄────────────── openraft core ──────────► network, serve
//!          (log, vote, snapshot;              │
//!           durable in a Journal)             └── told by `canvass` when to beat and when to stand
//! ```
//!
//! What is promised:
//! - What [`Replica::propose`] returned `Ok` for is in the ledger of every node that ever applies so far, at one and
//!   the same place, while a majority of the voters' journals survive.
//! - [`Leadership::is_me`] is true only on a node whose ledger holds everything committed before its reign, and which
//!   a majority acknowledged not longer ago than [`ReplicaSettings::quorum_silence_max`]. It is a belief about the
//!   recent past all the same: whatever acts outside the ledger carries the [`Reign`] or an [`Epoch`].
//! - Each term has one leader at most (openraft's `single-term-leader`), so the term of a [`Reign`] orders whoever acts
//!   outside the ledger, and the [`Epoch`] of an applied entry whatever was promised in it.
//! - A leader that leaves by [`Replica::hand_over`] has a successor within a few round trips.
//!
//! Why not a lock, a lease or gossip: see Ongaro and Ousterhout, *In search of an understandable consensus algorithm*,
//! 2014. When to stand for election is decided by `canvass`, not by openraft, which has neither pre-vote nor check
//! quorum.

mod election;
mod errors;
pub(crate) mod fuzz_api;
mod group_commit;
mod leadership_transfer;
mod leadership_view;
mod log_store;
mod network;
mod offline_recovery;
#[expect(clippy::module_inception, reason = "a module's main type has a file of its own, as elsewhere")]
mod replica;
mod runtime;
mod server;
mod settings;
mod storage;
mod types;

pub use errors::{BootstrapError, MemberError, ProposeError, StartError, TransferError};
pub use leadership_view::LeadershipView;
pub(crate) use log_store::with_repair_advice;
pub use log_store::{LogStore, MemoryLogStore, PersistentState, StoreIdentity};
pub use offline_recovery::{LogStoreContents, inspect_log_store, recover_as_only_voter, restore_as_only_voter};
pub use replica::Replica;
pub use runtime::{SeededRuntime, seed_elections};
pub use settings::{RaftSettings, RaftSettingsError};
pub use storage::ApplyObserver;
pub use types::{Epoch, LeaderId, Peer, RaftId, StateMachine};
