//! What roles of one mission say to one another, robot to robot (no coordinator on the way).
//!
//! A signal is published once when it is said. Whoever misses it asks: the teller answers with all it has said for as
//! long as it remembers the mission. Both are idempotent.

use crate::bus::{BusError, Delivery, Encoding, SharedBus};
use crate::reply;
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::lease::Epoch;
use consort_protocol::message::SignalHistory;
use consort_protocol::plan::Signal;
use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;
use tokio::sync::watch;
use tracing::{debug, warn};

/// Roles that were put down of which a node still answers what it said.
const REMEMBERED: usize = 16;

/// One node's part in the talk of its missions.
pub(crate) struct SignalExchange {
    bus: SharedBus,
    keys: Keys,
    /// Those of roles that were put down in the order in which they were.
    tellers: VecDeque<Teller>,
    /// Signals under awards no longer in force, counted since the start.
    outdated: u64,
}

/// What a role was told under awards no longer in force.
pub(crate) type StaleSignals = BTreeSet<(Signal, Epoch)>;

struct Teller {
    mission: MissionId,
    role: RoleId,
    said: watch::Sender<SignalHistory>,
    /// The role was put down: it says no more, and is forgotten in its turn.
    put_down: bool,
    _serving: Tasks,
}

impl SignalExchange {
    pub(crate) fn new(bus: SharedBus, keys: Keys) -> SignalExchange {
        SignalExchange { bus, keys, tellers: VecDeque::new(), outdated: 0 }
    }

    /// Begins to answer for a role, with what it has said already.
    pub(crate) async fn start_role(
        &mut self,
        mission: &MissionId,
        role: &RoleId,
        epoch: Epoch,
        said: BTreeSet<Signal>,
    ) -> Result<(), BusError> {
        self.tellers.retain(|teller| teller.mission != *mission || teller.role != *role);
        let mut queries = self.bus.serve(&self.keys.write(&Key::SignalHistory(mission.clone(), role.clone()))).await?;
        let (said, latest) = watch::channel(SignalHistory { mission: mission.clone(), epoch, signals: said });
        let mut serving = Tasks::default();
        serving.spawn(async move {
            while let Some(query) = queries.recv().await {
                let said = latest.borrow().clone();
                reply::wire(&query, &query.key, &said).await;
            }
        });
        let (mission, role) = (mission.clone(), role.clone());
        self.tellers.push_back(Teller { mission, role, said, put_down: false, _serving: serving });
        Ok(())
    }

    /// A role says no more. What it has said is still answered, until later ones have taken its place.
    pub(crate) fn end_role(&mut self, mission: &MissionId, role: &RoleId) {
        let Some(at) = self.tellers.iter().position(|t| t.mission == *mission && t.role == *role) else { return };
        if let Some(teller) = self.tellers.remove(at) {
            self.tellers.push_back(Teller { put_down: true, ..teller });
        }
        if self.tellers.iter().filter(|teller| teller.put_down).count() > REMEMBERED
            && let Some(oldest) = self.tellers.iter().position(|teller| teller.put_down)
        {
            self.tellers.remove(oldest);
        }
    }

    /// Says something in a role that was begun.
    pub(crate) async fn send(&self, mission: &MissionId, signal: &Signal) {
        let Some(teller) = self.tellers.iter().find(|t| t.mission == *mission && t.role == signal.from) else { return };
        teller.said.send_modify(|said| {
            said.signals.insert(signal.clone());
        });
        let said = SignalHistory { signals: BTreeSet::from([signal.clone()]), ..teller.said.borrow().clone() };
        let bytes = Bytes::from(codec::encode(&said).expect("one signal fits a message"));
        let key = self.keys.write(&Key::Signal(mission.clone(), signal.to.clone()));
        if let Err(problem) = self.bus.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await {
            debug!(%problem, "a signal was not published; who waits for it will ask");
        }
    }

    /// A signal was heard that its teller said under an award no longer in force: counted, and what there is to tell of it when
    /// its hearer hears it for the first time.
    pub(crate) fn record_stale(
        &mut self,
        heard: &mut StaleSignals,
        said: &SignalHistory,
        signal: &Signal,
        known: Epoch,
    ) -> Option<EventKind> {
        self.outdated += 1;
        let (mission, epoch, count) = (said.mission.clone(), said.epoch, self.outdated);
        let first = heard.insert((signal.clone(), epoch));
        first.then(|| EventKind::Outdated { mission, signal: signal.clone(), epoch, known, count })
    }

    /// Asks those from whom something is awaited what they have said; each answer is handed to `tell`.
    pub(crate) fn query_history(
        &self,
        mission: &MissionId,
        awaited: &BTreeSet<Signal>,
        tasks: &mut Tasks,
        tell: impl Fn(SignalHistory) + Send + Clone + 'static,
    ) {
        let tellers: BTreeSet<&RoleId> = awaited.iter().map(|signal| &signal.from).collect();
        for role in tellers {
            let key = self.keys.write(&Key::SignalHistory(mission.clone(), role.clone()));
            let (bus, tell) = (self.bus.clone(), tell.clone());
            tasks.spawn(async move {
                let Ok(mut replies) = bus.query(&key, Bytes::new(), Duration::from_millis(500)).await else { return };
                while let Some(reply) = replies.recv().await {
                    match reply.payload.map(|bytes| codec::decode::<SignalHistory>(&bytes)) {
                        Ok(Ok(said)) => tell(said),
                        Ok(Err(problem)) => warn!(key, %problem, "an answer that cannot be read"),
                        Err(problem) => debug!(key, problem, "no answer"),
                    }
                }
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::{Bus, LinkModel, VirtualNetwork};
    use consort_protocol::ids::{FleetId, NodeId, TaskId};
    use consort_protocol::plan::SignalKind;
    use std::sync::Arc;

    /// What the nurse of a mission answers to have said; `None` if nobody answers for her.
    async fn said(bus: &dyn Bus, keys: &Keys, mission: &MissionId) -> Option<usize> {
        let key = keys.write(&Key::SignalHistory(mission.clone(), RoleId::new("nurse").unwrap()));
        let mut replies = bus.query(&key, Bytes::new(), Duration::from_millis(500)).await.unwrap();
        let bytes = replies.recv().await?.payload.unwrap();
        Some(codec::decode::<SignalHistory>(&bytes).unwrap().signals.len())
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn only_roles_that_were_put_down_are_forgotten() {
        let network = VirtualNetwork::new(1, LinkModel::steady(Duration::from_millis(1)));
        let bus = network.bus(NodeId::new("ward").unwrap());
        let other = network.bus(NodeId::new("amber").unwrap());
        let keys = Keys::new(&FleetId::new("fleet").unwrap());
        let mut talk = SignalExchange::new(Arc::new(bus), keys.clone());
        let nurse = RoleId::new("nurse").unwrap();
        let missions: Vec<_> =
            (0..2 * REMEMBERED + 3).map(|number| MissionId::new(format!("mission-{number:02}")).unwrap()).collect();
        for mission in &missions {
            talk.start_role(mission, &nurse, Epoch::default(), BTreeSet::new()).await.unwrap();
        }
        for mission in &missions {
            let (task, to) = (TaskId::new("deposit").unwrap(), RoleId::new("r1").unwrap());
            talk.send(mission, &Signal { kind: SignalKind::Done, task, from: nurse.clone(), to }).await;
            assert_eq!(said(&other, &keys, mission).await, Some(1), "{mission} is under way");
        }
        let (over, under_way) = missions.split_at(REMEMBERED + 2);
        // Not in the order in which they began.
        for mission in over.iter().rev() {
            talk.end_role(mission, &nurse);
        }
        for mission in under_way.iter().chain(&over[..REMEMBERED]) {
            assert_eq!(said(&other, &keys, mission).await, Some(1), "{mission} is under way, or was lately");
        }
        for mission in &over[REMEMBERED..] {
            assert_eq!(said(&other, &keys, mission).await, None, "{mission} was put down first");
        }
    }
}
