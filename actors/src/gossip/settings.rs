//! How often a node speaks, how long it waits, and when it gives another up.

use crate::timing::Timing;
use consort_protocol::ids::{FleetId, NodeId};
use std::num::{NonZeroU8, NonZeroUsize};
use std::time::Duration;

/// Settings of a node's gossip. [`Settings::new`] gives defaults for a local network; all nodes of a fleet should agree.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// The fleet it belongs to.
    pub fleet: FleetId,
    /// Its own name.
    pub node: NodeId,
    /// Grows each time the node starts: what an earlier life said gives way to what this one says.
    pub incarnation: u64,
    /// How often the node says that its record is still current; less often in a fleet of more than twenty nodes for each
    /// second, down to once in `renew`. Raised: less traffic (each beat reaches all nodes), older knowledge. 1 s is a guess
    /// well below the 10 s after which knowledge is usually stale.
    pub heartbeat: Duration,
    /// How often the record gets a new version although nothing changed. Nodes that hear the owner only through others
    /// cannot tell by an equal version that it still speaks; by a new one they can. Raised: less for anti-entropy to carry
    /// to such nodes, and they believe their knowledge older than it is. 5 s: half of the usual bound on staleness.
    pub renew: Duration,
    /// How often the node compares digests with a peer chosen at random. Raised: less traffic, slower repair.
    pub round: Duration,
    /// How long a peer may take to answer. Queries take some milliseconds (measured over Zenoh: p99 4.6 ms with 10
    /// processes); the rest is for busy robots. Below `round`, so that rounds do not pile up.
    pub reply_timeout: Duration,
    /// How often a random member is probed. Raised: less traffic, slower detection. 500 ms is half of what memberlist uses
    /// on a LAN, since a robot that vanished holds a role.
    pub probe_period: Duration,
    /// How long a probed member may take to answer before others are asked to probe it too. Raised: fewer needless
    /// indirect probes, and less of the period is left for them. 150 ms allows for wireless links.
    pub probe_rtt: Duration,
    /// How long a suspect has to say that it is alive. Raised: fewer members are wrongly judged down, and the dead are
    /// noticed later. 2 s are four probe periods, as in memberlist for fleets of up to ten nodes; news of the suspicion
    /// reaches the suspect some ten times in between.
    pub suspicion: Duration,
    /// The same for a suspect whose presence token vanished and who does not answer: two signs instead of one.
    pub suspicion_when_vanished: Duration,
    /// How long a node must have been down, or never have been up, until its record is forgotten. Raised: people see for
    /// longer where a robot was last. A guess.
    pub forget_after: Duration,
}

impl Settings {
    /// Defaults for a local network: those of [`Timing::Lan`].
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
        }
    }

    /// The same with the times of a preset.
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

    /// How long a node whose token vanished has to answer before it is suspected: two round trips.
    pub(super) fn token_probe_timeout(&self) -> Duration {
        self.probe_rtt * 2
    }

    /// The failure detector's settings.
    pub(super) fn swim(&self) -> foca::Config {
        let one = NonZeroUsize::MIN;
        let three = one.saturating_add(2);
        foca::Config {
            probe_period: self.probe_period.max(Duration::from_millis(2)),
            // It must be shorter than the period, or no probe ever completes.
            probe_rtt: self
                .probe_rtt
                .clamp(Duration::from_millis(1), self.probe_period.max(Duration::from_millis(2)) / 2),
            num_indirect_probes: three,
            // foca advises 5 for small and 15 for very large fleets.
            max_transmissions: NonZeroU8::MIN.saturating_add(9),
            suspect_to_down_after: self.suspicion.max(Duration::from_millis(1)),
            // A node that is judged down wrongly or starts again comes back under a new identity; this keeps others from
            // bringing back the old one. foca advises hours.
            remove_down_after: Some(Duration::from_secs(3600)),
            // The bus fragments by itself. Enough to tell a newcomer of a hundred members at once.
            max_packet_size: three.saturating_add(4093),
            // So that a node which was cut off learns that it must rejoin.
            notify_down_members: true,
            periodic_announce: Some(foca::PeriodicParams { frequency: Duration::from_secs(10), num_members: one }),
            // We greet the absent ourselves, also when nobody is left.
            periodic_announce_to_down_members: None,
            // Sent only while there is news of members. foca advises 200 ms on a LAN.
            periodic_gossip: Some(foca::PeriodicParams { frequency: Duration::from_millis(200), num_members: three }),
        }
    }
}
