//! Intervals and timeouts of a node's gossip.

use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::timing::Timing;
use std::num::{NonZeroU8, NonZeroUsize};
use std::time::Duration;

/// Maximum number of members that a node of a large fleet notifies or asks about a suspect. A suspicion spreads from them by
/// gossip. 10: in a fleet that loses 5 % of its messages all of them are lost with a probability of 10⁻¹³.
const CONFIDANTS_MAX: usize = 10;

/// Settings of a node's gossip. [`Settings::new`] gives defaults for a local network; all nodes of
/// a fleet should agree.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// Fleet of the node.
    pub fleet: FleetId,
    /// Name of the node.
    pub node: NodeId,
    /// Increases at each start of the node: records of a later incarnation replace those of an
    /// earlier incarnation.
    pub incarnation: u64,
    /// Interval at which the node confirms its record. Longer in a fleet with more than twenty
    /// nodes per second of this interval, up to `renew`. Raised: less traffic (each heartbeat
    /// reaches all nodes), older knowledge. 1 s is a guess well below the 10 s after which
    /// knowledge is usually stale.
    pub heartbeat: Duration,
    /// Interval at which an unchanged record gets a new version. A node that receives the owner's
    /// record only through other nodes cannot infer from an equal version that the owner still
    /// publishes it; from a new version it can. Raised: less data for anti-entropy, and such nodes
    /// overestimate the age of their knowledge. 5 s: half of the usual bound on staleness.
    pub renew: Duration,
    /// Interval at which the node compares digests with a random peer. Raised: less traffic, slower
    /// repair.
    pub round: Duration,
    /// Timeout of a peer's reply. Queries take some milliseconds (measured over Zenoh: p99 4.6 ms
    /// with 10 processes); the rest is for busy robots. Below `round`, so that rounds do not pile
    /// up.
    pub reply_timeout: Duration,
    /// Interval between probes of a random member. Raised: less traffic, slower detection. 500 ms
    /// is half of memberlist's value for a LAN, since a vanished robot holds a role.
    pub probe_period: Duration,
    /// Time for a probed member to answer before other members are asked to probe it too. Raised:
    /// fewer needless indirect probes, and less time for them within the period. 150 ms allows for
    /// wireless links.
    pub probe_rtt: Duration,
    /// Time for a suspect to refute a suspicion. Raised: fewer members are declared down wrongly,
    /// and failures are detected later. 2 s are four probe periods, as in memberlist for fleets of
    /// up to ten nodes; the suspicion is sent to the suspect some ten times in between.
    pub suspicion: Duration,
    /// Suspicion timeout of a suspect with a vanished presence token and no answer: two signs
    /// instead of a single sign.
    pub suspicion_when_vanished: Duration,
    /// Time for which a node must have been down, or never up, before its record is removed.
    /// Raised: people see a robot's last position for longer. A guess.
    pub forget_after: Duration,
    /// The fleet is large, so that nodes receive what they use: heartbeats and motion go to the nodes that
    /// [receive motion](Settings::receives_motion), all others receive records when they change.
    pub scoped: bool,
    /// The node receives the motion of robots and the heartbeats of a large fleet, from its start on.
    pub receives_motion: bool,
}

impl Settings {
    /// Returns the defaults for a local network: those of [`Timing::Lan`].
    pub fn new(fleet: FleetId, node: NodeId, incarnation: u64) -> Settings {
        Settings {
            fleet,
            node,
            incarnation,
            heartbeat: Duration::from_secs(1),
            renew: Duration::from_secs(5),
            round: Duration::from_secs(1),
            reply_timeout: Duration::from_millis(500),
            probe_period: Duration::from_millis(500),
            probe_rtt: Duration::from_millis(150),
            suspicion: Duration::from_secs(2),
            suspicion_when_vanished: Duration::from_secs(1),
            forget_after: Duration::from_secs(30),
            scoped: false,
            receives_motion: true,
        }
    }

    /// Returns these settings with the times of a preset.
    #[must_use]
    pub fn with_timing(self, timing: Timing) -> Settings {
        let times = timing.parameters();
        Settings {
            heartbeat: times.gossip_refresh,
            round: times.anti_entropy_interval,
            reply_timeout: times.anti_entropy_interval / 2,
            probe_period: times.probe_period,
            probe_rtt: times.probe_timeout,
            suspicion: times.suspicion_timeout,
            suspicion_when_vanished: times.suspicion_timeout / 2,
            ..self
        }
    }

    /// Returns the time for a node with a vanished token to answer before it is suspected: two
    /// round trips.
    pub(super) fn token_probe_timeout(&self) -> Duration {
        self.probe_rtt * 2
    }

    /// Returns the maximum number of members that this node notifies or asks about a suspect at once: all in a small fleet.
    pub(super) fn confidants_max(&self) -> usize {
        if self.scoped { CONFIDANTS_MAX } else { usize::MAX }
    }

    /// Returns the settings of the failure detector.
    pub(super) fn swim(&self) -> foca::Config {
        let one = NonZeroUsize::MIN;
        let three = one.saturating_add(2);
        foca::Config {
            probe_period: self.probe_period.max(Duration::from_millis(2)),
            // It must be shorter than the period, otherwise no probe ever completes.
            probe_rtt: self
                .probe_rtt
                .clamp(Duration::from_millis(1), self.probe_period.max(Duration::from_millis(2)) / 2),
            num_indirect_probes: three,
            // foca advises 5 for small and 15 for very large fleets.
            max_transmissions: NonZeroU8::MIN.saturating_add(9),
            suspect_to_down_after: self.suspicion.max(Duration::from_millis(1)),
            // A node that was declared down wrongly or restarts rejoins under a new identity. This
            // delay prevents other nodes from restoring the old identity. foca advises hours.
            remove_down_after: Some(Duration::from_secs(3600)),
            // The bus fragments messages by itself. Enough to send a new node a hundred members at
            // once.
            max_packet_size: three.saturating_add(4093),
            // Notifies a node that was cut off that it must rejoin.
            notify_down_members: true,
            periodic_announce: Some(foca::PeriodicParams { frequency: Duration::from_secs(10), num_members: one }),
            // The gossiper announces itself to absent nodes, even if no member is left.
            periodic_announce_to_down_members: None,
            // Sent only while there are updates of members. foca advises 200 ms on a LAN.
            periodic_gossip: Some(foca::PeriodicParams { frequency: Duration::from_millis(200), num_members: three }),
        }
    }
}
