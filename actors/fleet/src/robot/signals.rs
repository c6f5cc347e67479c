//! Signals between the roles of robots in a mission, from robot to robot without the coordinator. The
//! coordinator sends those of people.
//!
//! A signal is published once, when it is sent. A node that has missed it sends a query: the sender
//! replies with the role's complete signal history while it still stores the mission. Both
//! operations are idempotent.

use bytes::Bytes;
use consort_bus::reply;
use consort_bus::tasks::Tasks;
use consort_bus::{Author, Delivery, Encoding, Reply, Sample, SharedBus};
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::lease::Epoch;
use consort_protocol::message::SignalHistory;
use consort_protocol::plan::Signal;
use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tracing::{debug, warn};

/// Number of ended roles for which a node still replies with the signal history.
const ENDED_ROLES_KEPT: usize = 16;

/// Maximum number of signals that wait to be published. Further signals are not published; their
/// receivers query the history.
const OUTBOX: usize = 64;

/// Signal exchange of a single node for all its missions. Its calls return at once, even while the
/// bus is blocked: the actor that calls it must be able to suspend its robot.
pub(crate) struct SignalExchange {
    bus: SharedBus,
    keys: Keys,
    /// Roles that send signals. Ended roles are in the order in which they ended.
    senders: VecDeque<RoleSender>,
    /// Number of stale signals received since the start.
    stale_count: u64,
    /// Signals to be published, with their keys.
    outbox: mpsc::Sender<(String, Bytes)>,
    _publishing: Tasks,
}

/// Signals of a role, as received from a node.
pub(crate) struct ReceivedSignals {
    pub(crate) history: SignalHistory,
    pub(crate) author: Author,
}

impl ReceivedSignals {
    /// Decodes a published signal. Logs a malformed signal and returns `None`.
    pub(crate) fn of(sample: Sample) -> Option<ReceivedSignals> {
        match codec::decode(&sample.payload) {
            Ok(history) => Some(ReceivedSignals { history, author: sample.author }),
            Err(problem) => {
                warn!(key = sample.key, %problem, "signal cannot be decoded");
                None
            }
        }
    }
}

/// Signals received under awards that are no longer in force.
pub(crate) type StaleSignals = BTreeSet<(Signal, Epoch)>;

struct RoleSender {
    mission: MissionId,
    role: RoleId,
    history: watch::Sender<SignalHistory>,
    /// The role has ended: it sends no more signals and will be removed.
    ended: bool,
    _serving: Tasks,
}

impl SignalExchange {
    pub(crate) fn new(bus: SharedBus, keys: Keys) -> SignalExchange {
        let (outbox, outgoing) = mpsc::channel(OUTBOX);
        let mut publishing = Tasks::default();
        publishing.spawn(publish_all(bus.clone(), outgoing));
        SignalExchange { bus, keys, senders: VecDeque::new(), stale_count: 0, outbox, _publishing: publishing }
    }

    /// Starts to serve the signal history of a role, beginning with the signals already sent.
    pub(crate) fn start_role(&mut self, mission: &MissionId, role: &RoleId, epoch: Epoch, history: BTreeSet<Signal>) {
        self.senders.retain(|sender| sender.mission != *mission || sender.role != *role);
        let key = self.keys.write(&Key::SignalHistory(mission.clone(), role.clone()));
        let (history, latest) = watch::channel(SignalHistory { mission: mission.clone(), epoch, signals: history });
        let (bus, mut serving) = (self.bus.clone(), Tasks::default());
        serving.spawn(async move {
            let mut queries = match bus.serve(&key).await {
                Ok(queries) => queries,
                Err(problem) => return warn!(key, %problem, "signal history is not served"),
            };
            while let Some(query) = queries.recv().await {
                let history = latest.borrow().clone();
                reply::wire(&query, &query.key, &history).await;
            }
        });
        let (mission, role) = (mission.clone(), role.clone());
        self.senders.push_back(RoleSender { mission, role, history, ended: false, _serving: serving });
    }

    /// Ends a role. Its signal history is still served until later roles replace it.
    pub(crate) fn end_role(&mut self, mission: &MissionId, role: &RoleId) {
        let Some(at) = self.senders.iter().position(|t| t.mission == *mission && t.role == *role) else { return };
        if let Some(sender) = self.senders.remove(at) {
            self.senders.push_back(RoleSender { ended: true, ..sender });
        }
        if self.senders.iter().filter(|sender| sender.ended).count() > ENDED_ROLES_KEPT
            && let Some(oldest) = self.senders.iter().position(|sender| sender.ended)
        {
            self.senders.remove(oldest);
        }
    }

    /// Sends a signal of a started role.
    pub(crate) fn send(&self, mission: &MissionId, signal: &Signal) {
        let Some(sender) = self.senders.iter().find(|t| t.mission == *mission && t.role == signal.from) else { return };
        sender.history.send_modify(|history| {
            history.signals.insert(signal.clone());
        });
        let history = SignalHistory { signals: BTreeSet::from([signal.clone()]), ..sender.history.borrow().clone() };
        let bytes = Bytes::from(codec::encode(&history).expect("a signal fits a message"));
        let key = self.keys.write(&Key::Signal(mission.clone(), signal.to.clone()));
        if self.outbox.try_send((key, bytes)).is_err() {
            debug!("signal was not published; its receiver will query it");
        }
    }

    /// Counts a signal that was sent under an award no longer in force. Returns an event when the
    /// receiver gets it for the first time.
    pub(crate) fn record_stale(
        &mut self,
        received: &mut StaleSignals,
        history: &SignalHistory,
        signal: &Signal,
        known: Epoch,
    ) -> Option<EventKind> {
        self.stale_count += 1;
        let (mission, epoch, count) = (history.mission.clone(), history.epoch, self.stale_count);
        let first = received.insert((signal.clone(), epoch));
        first.then(|| EventKind::StaleSignal { mission, signal: signal.clone(), epoch, known, count })
    }

    /// Queries the signal histories of all roles with an awaited signal. Each history is passed to
    /// `deliver`.
    pub(crate) fn query_history(
        &self,
        mission: &MissionId,
        awaited: &BTreeSet<Signal>,
        tasks: &mut Tasks,
        deliver: impl Fn(ReceivedSignals) + Send + Clone + 'static,
    ) {
        let senders: BTreeSet<&RoleId> = awaited.iter().map(|signal| &signal.from).collect();
        for role in senders {
            let key = self.keys.write(&Key::SignalHistory(mission.clone(), role.clone()));
            let (bus, deliver) = (self.bus.clone(), deliver.clone());
            tasks.spawn(async move {
                let Ok(mut replies) = bus.query(&key, Bytes::new(), Duration::from_millis(500)).await else { return };
                while let Some(reply) = replies.recv().await {
                    let Reply { payload, author, .. } = reply;
                    match payload.map(|bytes| codec::decode(&bytes)) {
                        Ok(Ok(history)) => deliver(ReceivedSignals { history, author }),
                        Ok(Err(problem)) => warn!(key, %problem, "reply cannot be decoded"),
                        Err(refused) => debug!(key, problem = refused.0, "no reply"),
                    }
                }
            });
        }
    }
}

/// Publishes signals in their order.
async fn publish_all(bus: SharedBus, mut outgoing: mpsc::Receiver<(String, Bytes)>) {
    while let Some((key, bytes)) = outgoing.recv().await {
        if let Err(problem) = bus.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await {
            debug!(%problem, "signal was not published; its receiver will query it");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_bus::{Bus, LinkModel, VirtualNetwork};
    use consort_protocol::ids::{FleetId, NodeId, TaskId};
    use consort_protocol::plan::SignalKind;
    use std::sync::Arc;

    /// Returns the size of the clerk's signal history in a mission; `None` without a reply.
    async fn history_size(bus: &dyn Bus, keys: &Keys, mission: &MissionId) -> Option<usize> {
        let key = keys.write(&Key::SignalHistory(mission.clone(), RoleId::new("clerk").unwrap()));
        let mut replies = bus.query(&key, Bytes::new(), Duration::from_millis(500)).await.unwrap();
        let bytes = replies.recv().await?.payload.unwrap();
        Some(codec::decode::<SignalHistory>(&bytes).unwrap().signals.len())
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn only_the_histories_of_ended_roles_are_removed() {
        let network = VirtualNetwork::new(1, LinkModel::steady(Duration::from_millis(1)));
        let bus = network.bus(NodeId::new("ward").unwrap());
        let other = network.bus(NodeId::new("amber").unwrap());
        let keys = Keys::new(&FleetId::new("fleet").unwrap());
        let mut exchange = SignalExchange::new(Arc::new(bus), keys.clone());
        let clerk = RoleId::new("clerk").unwrap();
        let missions: Vec<_> = (0..2 * ENDED_ROLES_KEPT + 3)
            .map(|number| MissionId::new(format!("mission-{number:02}")).unwrap())
            .collect();
        for mission in &missions {
            exchange.start_role(mission, &clerk, Epoch::default(), BTreeSet::new());
            // The service is declared in the background.
            while history_size(&other, &keys, mission).await.is_none() {}
        }
        for mission in &missions {
            let (task, to) = (TaskId::new("deposit").unwrap(), RoleId::new("r1").unwrap());
            exchange.send(mission, &Signal { kind: SignalKind::Done, task, from: clerk.clone(), to });
            assert_eq!(history_size(&other, &keys, mission).await, Some(1), "{mission} is active");
        }
        let (ended_missions, active) = missions.split_at(ENDED_ROLES_KEPT + 2);
        // The order differs from the order in which the roles started.
        for mission in ended_missions.iter().rev() {
            exchange.end_role(mission, &clerk);
        }
        for mission in active.iter().chain(&ended_missions[..ENDED_ROLES_KEPT]) {
            assert_eq!(history_size(&other, &keys, mission).await, Some(1), "{mission} is active or ended lately");
        }
        for mission in &ended_missions[ENDED_ROLES_KEPT..] {
            assert_eq!(history_size(&other, &keys, mission).await, None, "{mission} ended first");
        }
    }
}
