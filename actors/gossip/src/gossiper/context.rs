//! State that all parts of the gossiper share, and the context in which they handle an event.

use super::agenda::{Agenda, ScheduledTimer};
use super::event::Action;
use crate::record_store::RecordStore;
use crate::settings::Settings;
use crate::shared::{GossipState, MemberStatus};
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::Motion;
use consort_protocol::message::RecordUpdate;
use consort_protocol::units::NodeTime;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// Time for which the whole record is repeated after a change, or after a node joined. Then only
/// refreshes are published; a node that missed the record queries it. Raised: more traffic, and
/// fewer queries. 10 s: as many repetitions as needed on a link that loses half of all messages.
const FULL_RECORD_PERIOD: Duration = Duration::from_secs(10);

/// Extension of the heartbeat interval per node, once there are too many nodes for the shortest
/// interval. 50 ms: a node receives at most 20 heartbeats a second, until the interval reaches its
/// maximum.
const INTERVAL_PER_NODE: Duration = Duration::from_millis(50);

/// State that all parts of the gossiper share.
pub(super) struct Core {
    pub(super) settings: Settings,
    pub(super) records: RecordStore,
    pub(super) agenda: Agenda,
    pub(super) rng: ChaCha8Rng,
    /// End of the period in which the whole record is repeated.
    pub(super) full_record_until: NodeTime,
    /// Time of the last publication of the own record.
    pub(super) last_published: NodeTime,
    /// True if readable state has changed.
    pub(super) changed: bool,
}

/// Context in which an event is handled.
pub(super) struct Context<'a> {
    pub(super) core: &'a mut Core,
    /// State that the other actors of the node read.
    pub(super) state: &'a mut GossipState,
    pub(super) now: NodeTime,
    /// Actions collected for the caller.
    pub(super) actions: Vec<Action>,
}

impl<'a> Context<'a> {
    /// Creates the context of an event.
    pub(super) fn new(core: &'a mut Core, state: &'a mut GossipState, now: NodeTime) -> Context<'a> {
        Context { core, state, now, actions: vec![] }
    }

    /// Schedules a timer after a delay.
    pub(super) fn set_timer(&mut self, delay: Duration, timer: ScheduledTimer) {
        self.core.agenda.at(self.now + delay, timer);
    }

    /// Sets the status of a node.
    pub(super) fn set_status(&mut self, node: NodeId, status: MemberStatus) {
        self.state.status.insert(node, status);
        self.core.changed = true;
    }

    /// Publishes the whole own record, and starts to repeat it.
    pub(super) fn publish(&mut self) {
        self.repeat_full_record();
        let record = RecordUpdate::Record(self.core.records.own().clone());
        self.push_update(Action::Publish(record));
    }

    /// Publishes the motion of the own robot.
    pub(super) fn move_robot(&mut self, motion: Motion) {
        let update = self.core.records.move_robot(motion, self.state);
        self.push_update(Action::PublishMotion(update));
        self.core.changed = true;
    }

    /// Starts the period in which the whole record is repeated.
    pub(super) fn repeat_full_record(&mut self) {
        self.core.full_record_until = self.now + FULL_RECORD_PERIOD;
    }

    /// Publishes the own record again, or a refresh of it. In a large fleet a node that missed the record receives it by
    /// anti-entropy, or queries the owner after a heartbeat.
    fn republish(&mut self) {
        let action = if self.core.settings.scoped {
            Action::PublishMotion(self.core.records.motion_update())
        } else if self.now < self.core.full_record_until {
            Action::Publish(RecordUpdate::Record(self.core.records.own().clone()))
        } else {
            Action::Publish(self.core.records.refresh())
        };
        self.push_update(action);
    }

    fn push_update(&mut self, action: Action) {
        self.core.last_published = self.now;
        self.state.counters.published += 1;
        self.actions.push(action);
    }

    /// Publishes the heartbeat and schedules the next.
    pub(super) fn heartbeat(&mut self) {
        let interval = self.heartbeat_interval();
        let Settings { renew, scoped, .. } = self.core.settings;
        // Equal versions let two nodes of a large fleet compare their records by sums.
        let renew = if scoped { Duration::MAX } else { renew };
        self.core.records.repeat(renew, interval, self.state, self.now);
        // A change published a moment ago counts as a heartbeat.
        if self.now.since(self.core.last_published) * 2 > interval {
            self.republish();
        }
        self.set_timer_jittered(interval, ScheduledTimer::Heartbeat);
    }

    /// Checks whether this node probes no others: in a large fleet nodes that receive heartbeats detect failures.
    pub(super) fn leaves_detection_to_others(&self) -> bool {
        self.core.settings.scoped && !self.state.receives_motion
    }

    /// Returns the heartbeat interval. It is longer in a large fleet, to limit the messages that
    /// each node receives.
    pub(super) fn heartbeat_interval(&self) -> Duration {
        self.extended_interval().max(self.core.settings.heartbeat)
    }

    /// Returns the delay of a greeting: random in a large fleet, since all nodes see a newcomer at once. Most of them hear of
    /// it from others meanwhile. A newcomer itself, which knows few nodes, greets them soon.
    pub(super) fn greeting_delay(&mut self) -> Duration {
        if !self.core.settings.scoped {
            return Duration::ZERO;
        }
        let delay_max = self.extended_interval();
        self.core.random_up_to(delay_max)
    }

    /// Returns an interval for messages that each node receives from all others.
    fn extended_interval(&self) -> Duration {
        let alive = self.state.status.values().filter(|status| status.is_alive()).count();
        let extended = INTERVAL_PER_NODE.saturating_mul(u32::try_from(alive).unwrap_or(u32::MAX));
        // For any fleet size the age of received records stays within the interval of version
        // renewal.
        extended.min(self.core.settings.renew)
    }

    /// Schedules a timer after `delay` with a random deviation of up to a tenth. Never at once, or
    /// the agenda would not end.
    pub(super) fn set_timer_jittered(&mut self, delay: Duration, timer: ScheduledTimer) {
        let factor = self.core.rng.random_range(0.9..1.1);
        self.set_timer(delay.mul_f64(factor).max(Duration::from_millis(1)), timer);
    }
}

impl Core {
    /// Returns a random time between zero and `time`.
    pub(super) fn random_up_to(&mut self, time: Duration) -> Duration {
        time.mul_f64(self.rng.random_range(0.0..1.0))
    }
}
