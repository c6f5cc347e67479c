//! Inputs and outputs of the gossiper.

use crate::record_store::RecordTooLarge;
use crate::swim::SwimError;
use bytes::Bytes;
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::{Knowledge, Motion, MotionUpdate};
use consort_protocol::message::{Exchange, RecordUpdate};

/// A change of the own knowledge.
pub(crate) type Change = Box<dyn FnOnce(&mut Knowledge) + Send>;

/// An input of the state machine.
#[expect(clippy::large_enum_variant, reason = "a single event exists at a time")]
pub(crate) enum Event {
    /// The node's own knowledge changes.
    KnowledgeChanged(Change),
    /// The robot of the node moves, or its charge changes.
    MotionChanged(Motion),
    /// A node published the motion of its robot.
    MotionPublished(NodeId, MotionUpdate),
    /// A node published an update of its record.
    Published(NodeId, RecordUpdate),
    /// A packet of failure detection arrived.
    Packet(Bytes),
    /// A node's presence token appeared or vanished.
    Token(NodeId, bool),
    /// A peer compares digests with this node.
    RequestReceived(Exchange),
    /// A peer replied in this round, or no reply arrived.
    ReplyReceived(u64, Option<Exchange>),
    /// The time last returned by [`Gossiper::next_due`](super::Gossiper::next_due) has come.
    TimerFired,
    /// The fleet writes another wire version. The own record is published again, in full.
    VersionRaised,
}

/// An effect for the caller to perform, in the order given.
#[expect(clippy::large_enum_variant, reason = "few actions exist at a time")]
#[derive(Debug, PartialEq)]
pub(crate) enum Action {
    /// Publish an update of the own record.
    Publish(RecordUpdate),
    /// Publish the motion of the own robot, or the confirmation of the own record.
    PublishMotion(MotionUpdate),
    /// Send a packet to a node.
    Send(NodeId, Bytes),
    /// Compare digests with a peer, and return its reply as [`Event::ReplyReceived`] with the same
    /// number.
    SendRequest(u64, NodeId, Exchange),
    /// Reply to [`Event::RequestReceived`].
    SendReply(Exchange),
}

/// The event is rejected. No action of it is performed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum GossipError {
    /// The change of the own record is too large.
    #[error(transparent)]
    RecordTooLarge(#[from] RecordTooLarge),
    /// Another node claims a stamp of this node that would exhaust its own stamps. It is forged.
    #[error("rejected a stamp of this node with the impossible incarnation {0}")]
    ImpossibleIncarnation(u64),
    /// The failure detector rejects a packet or an operation.
    #[error(transparent)]
    Swim(#[from] SwimError),
}
