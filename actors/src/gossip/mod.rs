//! Gossip: what a node says of itself reaches all others, and each judges for itself who is alive.
//!
//! ```text
//!            publish wire/knowledge/{me}: at once on a change, and again at every beat
//!   Gossip ─────────────────────────────────────────────────────────────────────────────▶ all
//!   Gossip ◀── query wire/gossip/{peer}: digests, and the records that the other lacks ──▶ one peer, each round
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
//! - A node that hears all but is heard by none is judged down by all; one that is heard but hears nobody is too, since
//!   it answers no probe, though its published record is still taken in and stays confirmed. A link cut between two
//!   nodes, in one direction or both, harms neither as long as third ones reach both: those probe in their stead.
//! - Whoever was judged down wrongly learns of it when somebody is reached, and comes back under a new identity.
//! - Records of nodes that have not been alive for `forget_after` are forgotten, and not handed on before that, so
//!   that nobody brings the dead back. Later incarnations are welcome.
//! - An age counts from when this node last heard the owner, or first heard this version from others. As the owner renews
//!   the version every few seconds, either way tells whether it still speaks.
//! - One seed gives one run: the agenda is ordered, chance is handed in, and time is tokio's.
//!
//! `gossiper` decides, with `memory` (which records are kept), `exchange` (what fits a message) and `swim` (who is
//! alive) beneath it; `actor` carries out.

mod actor;
mod exchange;
mod gossiper;
mod memory;
mod settings;
mod shared;
mod swim;

pub use actor::{Gossip, GossipHandle, Start, Stopped};
pub use settings::Settings;
pub use shared::{Counters, SharedKnowledge, Status};
