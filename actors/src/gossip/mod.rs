//! Gossip: what a node says of itself reaches all others, and each judges for itself who is alive.
//!
//! ```text
//!            publish wire/knowledge/{me}: the record on a change, and that it still holds at every beat
//!   Gossip ─────────────────────────────────────────────────────────────────────────────▶ all
//!   Gossip ◀── query wire/gossip/{peer}: sums, digests where they differ, and records ───▶ one peer, each round
//!   Gossip ◀── publish wire/swim/{node}: probes, suspicions, verdicts (SWIM) ────────────▶ a few
//!   Gossip ──▶ token alive/node/{me}; ◀── alive/node/*
//! ```
//!
//! What is promised, and what is not:
//! - A record has one writer, its owner. It reaches every node that some chain of exchanges leads to, also one which the
//!   owner never meets: anti-entropy (Demers et al. 1987) hands on third parties' records.
//! - SWIM alone says who is alive. A token that appears and a voice that is heard lead to a greeting; a token that
//!   vanishes leads to a question, and without an answer to a suspicion that everybody may refute. So a token hastens
//!   the verdict and never makes it.
//! - Whoever was judged down wrongly learns of it when somebody is reached, and comes back under a new identity. One that
//!   starts again comes back as a later incarnation; if its clock went back meanwhile, the digest of whomever it meets
//!   tells it how far it was, and it goes on from there.
//! - Records of nodes that have not been alive for `forget_after` are forgotten, and not handed on before that, so
//!   that nobody brings the dead back. Later incarnations are welcome.
//! - What does not change costs little. A record is repeated whole for ten seconds after a change, or after somebody
//!   came; then its owner says in some twenty bytes that it still holds, and whoever missed it asks the owner in its next
//!   round. Two nodes that compare begin with sums over classes of owners and speak of the classes that differ. In a large
//!   fleet beats are rarer, so that a node hears some twenty a second at most until every owner is down to one in `renew`.
//! - An age counts from when this node last heard the owner, or first heard this version from others. As the owner renews
//!   the version every few seconds, either way tells whether it still speaks.
//! - Who is gone: with a token that vanished down within 2 s, without within 6 s (fleets of 3 and of 10); from then on not
//!   asked for bids and not handed on; no member of an ensemble once its record is stale, and forgotten after
//!   `forget_after`, 30 s.
//! - One seed gives one run: the agenda is ordered, chance is handed in, and time is tokio's.
//!
//! # Links that carry one way only
//!
//! *A hears B, and B does not hear A.* On the virtual bus such a cut holds back whatever crosses it. Zenoh over TCP knows
//! no such state for long: without acknowledgements a connection dies in both directions after its lease, and routers
//! go another way round if there is one. What follows holds wherever messages do get lost in one direction.
//!
//! - *Some third node reaches both.* B's probe of A is not answered; three others probe A for B and forward the answer.
//!   Both stay alive to all. A's record reaches B by anti-entropy, at most a `renew` and some rounds old.
//! - *Nobody hears A; A hears all.* A is down to all within some seconds, once. A hears them speak and is never answered:
//!   it doubts itself, suspects them, and judges nobody down. What A is as a robot: no member of the ensemble, asked for
//!   nothing; its reports are not heard, so its lease runs out and it suspends its role, and the coordinator gives the role
//!   to another after the grace. As a voter: it is asked and its vote is not heard; it cannot unseat a leader, since
//!   nobody hears it ask for votes. As the coordinator: its heartbeats are not heard, the voters elect another, and it
//!   steps down when it hears of the later term; it renews no lease after half the grace without acknowledgements.
//! - *A hears nobody; all hear A.* A answers no probe and is down to all within some seconds; its published record is still
//!   taken in, so people see where it is. All are down to A. As a robot: it hears no call and no answer to its reports,
//!   suspends, and is replaced as above. As a voter: it hears no heartbeat, asks whether others would vote for it, hears no
//!   answer, and does not stand; so it raises no term. As the coordinator: no voter's answer reaches it, so it falls silent
//!   after `quorum_silence_max` (`replica`), the voters miss it and elect another.
//! - *One node alone hears A, or is all that A hears.* All stay alive to all in the first case. In the second, A wrongs
//!   others now and then, as it hears late of their answers: each is given twice as long by everybody whenever it comes
//!   back, up to 16 s (20 nodes: 14 returns in the first two minutes, 4 and 7 in the next ones; before these rules 100 each).
//! - *Half of the nodes are heard by nobody of the other half.* To each half the other is down.
//!
//! Why it settles: a node doubts itself while fewer than half of its own last probes were answered, and then puts verdicts on
//! those off whom it hears speak; whoever suspects tells everybody at once; before a verdict, a node with some probes
//! unanswered asks everybody whom they believe alive; and patience grows with every return.
//! `actors/tests/gossip.rs` holds each case to it.
//!
//! `gossiper` decides, with `memory` (which records are kept), `exchange` (what fits a message) and `swim` (who is
//! alive) beneath it; `actor` carries out.

mod actor;
mod exchange;
mod gossiper;
mod harness;
mod record_signer;
mod record_store;
mod settings;
mod shared;
mod swim;

pub use actor::{Gossip, GossipHandle, GossipStart, GossipStopped};
pub use harness::{GossipHarness, GossipInput};
pub use record_signer::{ProofStatus, RecordSigner, SharedRecordSigner};
pub use settings::Settings;
pub use shared::{GossipCounters, MemberStatus, SharedKnowledge};
