//! Gossip: distributes each node's record to all other nodes, and detects failures at each node.
//!
//! ```text
//!            publish wire/knowledge/{me}: the record after a change, else a refresh at every heartbeat
//!   Gossip ─────────────────────────────────────────────────────────────────────────────▶ all
//!   Gossip ◀── query wire/gossip/{peer}: sums, digests where they differ, and records ───▶ one peer, each round
//!   Gossip ◀── publish wire/swim/{node}: probes, suspicions, verdicts (SWIM) ────────────▶ a few
//!   Gossip ── publish wire/motion/{me}: heartbeats and the motion of the robot, in a large fleet ────────▶ subscribers
//!   Gossip ──▶ token alive/node/{me}; ◀── alive/node/*
//! ```
//!
//! Guarantees and their limits:
//! - A record has a single writer, its owner. It reaches every node that is connected to the owner
//!   by a chain of exchanges, including nodes that never exchange messages with the owner:
//!   anti-entropy (Demers et al. 1987) forwards records of third nodes.
//! - A verdict of another node counts only if this node has missed answers of the suspect, too; any other verdict makes
//!   it query the suspect. In a closed fleet a packet counts only from its author. So the key of a node declares no
//!   other node down.
//! - SWIM alone decides which nodes are alive. An appearing token or a received record leads to an
//!   announcement. A vanishing token leads to a query and, without a reply, to a suspicion that the
//!   node can refute. So a token accelerates the verdict and never decides it.
//! - A node that was declared down wrongly is notified by the next node that it reaches, and
//!   rejoins under a new identity. A restarted node rejoins as a later incarnation. If its clock
//!   went back meanwhile, the digest of the first node that it exchanges with contains its last
//!   stamp, and it continues from there.
//! - Records of nodes that have not been alive for `forget_after` are removed. They are not
//!   forwarded before that either, so that no exchange restores the record of a dead node. Later
//!   incarnations are accepted.
//! - An unchanged record costs little. The whole record is repeated for ten seconds after a change
//!   or after a node joined. Then its owner publishes a refresh of some twenty bytes, and a node
//!   that missed the record queries the owner in its next round. Two nodes compare sums over
//!   classes of owners first, and exchange digests only of the classes that differ. In a large
//!   fleet heartbeats are rarer: a node receives at most some twenty a second, until every owner is
//!   down to one in `renew`.
//! - In a large fleet (`scoped` of the settings) a node receives what it uses. A record goes to all
//!   nodes, once, when it changes. A node that missed it receives it by anti-entropy, and a newcomer
//!   receives all records from a peer. Place, pose and charge of robots and the heartbeats go to
//!   `wire/motion/*`. Stations, members of the ledger's cluster and watchers subscribe to it. Motion
//!   counts for one version of the record, has no proof, and is not forwarded. A record contains the
//!   motion at the time of its latest change. Versions are not renewed, so nodes with equal records
//!   have equal sums, and a subscriber without a path to the owner sees no heartbeat of it.
//! - A subscriber has the motion of each robot at most 8 s after it has subscribed: the longest
//!   interval of heartbeats is 5.5 s, and one is left out shortly after another update. From then on
//!   its records are at most 8 s old. A pose is at most 1 s old or within the dead band
//!   ([`Motion`](consort_protocol::knowledge::Motion)), unless an update was lost. Ensembles are
//!   evaluated on these records. At nodes that do not subscribe, ages count from the latest change.
//! - A suspicion goes to all members at once, or to ten of them in a large fleet. There greetings
//!   are delayed at random.
//! - In a large fleet nodes that receive heartbeats detect failures, and all others only answer their probes. Heartbeats
//!   keep the lease of a node with each of them. When it has missed heartbeats for three intervals, it queries the node,
//!   directly and through three others, and without an answer it suspects the node. So a dead node whose token does not
//!   vanish is declared down within 20 s at any size; five nodes are queried each second.
//! - The age of a record counts from the last message of the owner, or from the first copy of this
//!   version received from another node. The owner renews the version every few seconds, so both
//!   show whether the owner still publishes.
//! - A dead node is declared down within 2 s if its token vanished, and within 6 s otherwise
//!   (fleets of 3 and of 10; large fleets as above). The bus of a node that does not relay reports a vanished token 1.5 s
//!   later: its own relay may have failed. From then on it receives no calls for bids, and its record is not
//!   forwarded. It leaves the ensemble once its record is stale, and its record is removed after
//!   `forget_after`, 30 s.
//! - A seed determines the run: the agenda is ordered, randomness is passed in, and time is
//!   tokio's.
//!
//! # Links that deliver in one direction only
//!
//! *A receives from B, and B does not receive from A.* On the virtual bus such a cut drops all
//! messages that cross it. Zenoh over TCP does not stay in this state for long: without
//! acknowledgements a connection ends in both directions after its lease, and routers use another
//! route if there is one. The following holds wherever messages are lost in a single direction.
//!
//! - *A third node reaches both.* A does not answer B's probe; three other nodes probe A for B and
//!   forward the answer. Both stay alive in the view of all nodes. A's record reaches B by
//!   anti-entropy, at most a `renew` and some rounds old.
//! - *No node receives from A; A receives from all.* Within some seconds A is down in the view of
//!   all nodes, once. A receives their messages and never an answer. It becomes locally unhealthy,
//!   suspects the other nodes, and declares none of them down. As a robot, A is no member of the
//!   ensemble and receives no tasks; its reports do not arrive, so its lease expires and it
//!   suspends its role, and the coordinator reassigns the role after the grace period. As a voter,
//!   A receives vote requests but its votes do not arrive; it cannot replace a leader, since its
//!   own vote requests do not arrive. As the coordinator, its heartbeats do not arrive, the voters
//!   elect another leader, and A steps down when it receives the later term; it renews no lease
//!   after half the grace period without acknowledgements.
//! - *A receives from no node; all receive from A.* A answers no probe and is down in the view of
//!   all nodes within some seconds; its published record is still accepted, so people see its
//!   position. All nodes are down in A's view. As a robot, A receives no call for bids and no reply
//!   to its reports, suspends, and is replaced as above. As a voter, A receives no heartbeat,
//!   starts a pre-vote, receives no reply, and does not campaign; so it increases no term. As the
//!   coordinator, A receives no reply of a voter, so it stops its heartbeats after
//!   `check_quorum_timeout` (`raft`); the voters detect this and elect another leader.
//! - *A single node receives from A, or A receives from a single node.* In the first case all nodes
//!   stay alive in all views. In the second case A declares other nodes down wrongly now and then,
//!   as their answers arrive late. Every node doubles the suspicion timeout of such a node after
//!   each rejoin, up to 16 s (20 nodes: 14 rejoins in the first two minutes, 4 and 7 in the next
//!   two; before these rules 100 each).
//! - *No node of one half receives from the other half.* Each half declares the other down.
//!
//! Reasons for the convergence:
//! - A node with fewer than half of its recent probes answered is locally unhealthy. It defers
//!   verdicts on nodes that still send messages.
//! - A node sends a suspicion to all nodes at once.
//! - Before a verdict, a node with some unanswered probes queries the view of all members.
//! - The suspicion timeout grows with every rejoin.
//!
//! `actors/gossip/tests/gossip.rs` tests each case.
//!
//! `gossiper` makes the decisions, with `record_store` (stored records), `exchange` (content of a
//! message) and `swim` (failure detection) beneath it; `actor` performs them, with `inbox`
//! (decoding), `outbox` and `alarm`.

mod actor;
mod alarm;
mod exchange;
mod gossiper;
mod handle;
#[cfg(feature = "test-util")]
mod harness;
mod inbox;
mod outbox;
mod record_store;
mod settings;
mod shared;
mod swim;

pub use actor::GossipStart;
pub use handle::{GossipHandle, GossipStopped};
#[cfg(feature = "test-util")]
pub use harness::{GossipHarness, GossipInput, InputError};
pub use settings::Settings;
pub use shared::{GossipCounters, MemberStatus, SharedKnowledge};
#[cfg(feature = "test-util")]
pub use swim::packet_about;
