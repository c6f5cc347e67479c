//! What roles of one mission say to one another, robot to robot (no coordinator on the way).
//!
//! A signal is published once when it is said. Whoever misses it asks: the teller answers with all it has said for as
//! long as it remembers the mission. Both are idempotent.

use crate::answer;
use crate::bus::{BusError, Delivery, Encoding, SharedBus};
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::lease::Epoch;
use consort_protocol::message::Said;
use consort_protocol::plan::Signal;
use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;
use tokio::sync::watch;
use tracing::{debug, warn};

/// Missions of which a node still answers what it said.
const REMEMBERED: usize = 16;

/// One node's part in the talk of its missions.
pub(crate) struct Talk {
    bus: SharedBus,
    keys: Keys,
    /// Latest last.
    tellers: VecDeque<Teller>,
}

struct Teller {
    mission: MissionId,
    role: RoleId,
    said: watch::Sender<Said>,
    _serving: Tasks,
}

impl Talk {
    pub(crate) fn new(bus: SharedBus, keys: Keys) -> Talk {
        Talk { bus, keys, tellers: VecDeque::new() }
    }

    /// Begins to answer for a role, with what it has said already.
    pub(crate) async fn begin(
        &mut self,
        mission: &MissionId,
        role: &RoleId,
        epoch: Epoch,
        said: BTreeSet<Signal>,
    ) -> Result<(), BusError> {
        self.tellers.retain(|teller| teller.mission != *mission || teller.role != *role);
        let mut queries = self.bus.serve(&self.keys.write(&Key::Said(mission.clone(), role.clone()))).await?;
        let (said, latest) = watch::channel(Said { mission: mission.clone(), epoch, signals: said });
        let mut serving = Tasks::default();
        serving.spawn(async move {
            while let Some(query) = queries.recv().await {
                let said = latest.borrow().clone();
                answer::wire(&query, &query.key, &said).await;
            }
        });
        self.tellers.push_back(Teller { mission: mission.clone(), role: role.clone(), said, _serving: serving });
        while self.tellers.len() > REMEMBERED {
            self.tellers.pop_front();
        }
        Ok(())
    }

    /// Says something in a role that was begun.
    pub(crate) async fn say(&self, mission: &MissionId, signal: &Signal) {
        let Some(teller) = self.tellers.iter().find(|t| t.mission == *mission && t.role == signal.from) else { return };
        teller.said.send_modify(|said| {
            said.signals.insert(signal.clone());
        });
        let said = Said { signals: BTreeSet::from([signal.clone()]), ..teller.said.borrow().clone() };
        let bytes = Bytes::from(codec::encode(&said).expect("one signal fits a message"));
        let key = self.keys.write(&Key::Signal(mission.clone(), signal.to.clone()));
        if let Err(problem) = self.bus.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await {
            debug!(%problem, "a signal was not published; who waits for it will ask");
        }
    }

    /// Asks those from whom something is awaited what they have said; each answer is handed to `tell`.
    pub(crate) fn ask(
        &self,
        mission: &MissionId,
        awaited: &BTreeSet<Signal>,
        tasks: &mut Tasks,
        tell: impl Fn(Said) + Send + Clone + 'static,
    ) {
        let tellers: BTreeSet<&RoleId> = awaited.iter().map(|signal| &signal.from).collect();
        for role in tellers {
            let key = self.keys.write(&Key::Said(mission.clone(), role.clone()));
            let (bus, tell) = (self.bus.clone(), tell.clone());
            tasks.spawn(async move {
                let Ok(mut replies) = bus.query(&key, Bytes::new(), Duration::from_millis(500)).await else { return };
                while let Some(reply) = replies.recv().await {
                    match reply.payload.map(|bytes| codec::decode::<Said>(&bytes)) {
                        Ok(Ok(said)) => tell(said),
                        Ok(Err(problem)) => warn!(key, %problem, "an answer that cannot be read"),
                        Err(problem) => debug!(key, problem, "no answer"),
                    }
                }
            });
        }
    }
}
