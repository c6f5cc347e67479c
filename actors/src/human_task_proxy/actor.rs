//! The attendant's mailbox: whom it hears, what it asks for, and what people call off.

use super::requests::{PendingCancellations, RecentCancelOrders};
use super::roles::{ProxyRole, RoleKey, query_signals, send_person_request};
use crate::bus::{Sample, SharedBus};
use crate::events::EventPublisher;
use crate::robot::SignalExchange;
use crate::robot_driver::{PersonEvent, PersonRequestState};
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::{ApiCall, Key, Keys, PeopleCall};
use consort_protocol::ledger::Branch;
use consort_protocol::message::{ActiveMissions, Beacon, ReportReply, SignalHistory};
use consort_skills::actions::GoalId;
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::collections::BTreeMap;
use std::time::Duration;
use tracing::{debug, warn};

/// How long the coordinator may take to write down that a mission was called off.
const CANCEL_LIMIT: Duration = Duration::from_secs(2);

/// How an attendant works.
pub struct HumanTaskProxySettings {
    /// The node it lives on.
    pub node: NodeId,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// Where it tells what happens.
    pub events: EventPublisher,
    /// How often it looks after everything; what is heard is acted on at once. Default 1 s.
    pub tick_interval: Duration,
}

/// To an attendant.
pub enum HumanTaskProxyMessage {
    /// Time to look after everything.
    Tick,
    /// The coordinator says that it is there.
    Beacon(Sample),
    /// Missions under way have changed.
    MissionsChanged(Sample),
    /// The missions under way, as a coordinator has them, and which question that answers.
    ActiveMissions(u64, ActiveMissions),
    /// A role of some mission said something.
    Signal(Sample),
    /// A role answered what it has said.
    SignalHistory(SignalHistory),
    /// A person has ended something.
    PersonEvent(Sample),
    /// The host of people answered to an ask.
    RequestReplied(GoalId, PersonRequestState),
    /// A report of this branch's plan was answered.
    ReportReplied(MissionId, RoleId, Branch, ReportReply),
}

/// The actor.
pub struct HumanTaskProxy;

/// State of [`Attendant`].
pub struct HumanTaskProxyState {
    pub(super) settings: HumanTaskProxySettings,
    pub(super) coordinator: Option<Beacon>,
    pub(super) roles: BTreeMap<RoleKey, ProxyRole>,
    /// How often the coordinator was asked which missions are under way, and which of these questions is the latest of which
    /// the answer was taken: answers may overtake one another.
    looks: u64,
    seen: u64,
    pub(super) cancellations: PendingCancellations,
    /// Missions that people called off, and who did: asked of the coordinator until they are no longer under way.
    called_off: BTreeMap<MissionId, String>,
    words: RecentCancelOrders,
    pub(super) signals: SignalExchange,
    pub(super) tasks: Tasks,
}

#[ractor::async_trait]
impl Actor for HumanTaskProxy {
    type Msg = HumanTaskProxyMessage;
    type State = HumanTaskProxyState;
    type Arguments = HumanTaskProxySettings;

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        settings: HumanTaskProxySettings,
    ) -> Result<Self::State, ActorProcessingErr> {
        let HumanTaskProxySettings { keys, bus, .. } = &settings;
        let mut tasks = Tasks::default();
        tasks.forward(bus.subscribe(&keys.write(&Key::Beacon)).await?, &myself, HumanTaskProxyMessage::Beacon);
        tasks.forward(
            bus.subscribe(&keys.write(&Key::Changed)).await?,
            &myself,
            HumanTaskProxyMessage::MissionsChanged,
        );
        tasks.forward(bus.subscribe(&keys.any_signal()).await?, &myself, HumanTaskProxyMessage::Signal);
        let done = keys.write(&Key::People(PeopleCall::Done));
        tasks.forward(bus.subscribe(&done).await?, &myself, HumanTaskProxyMessage::PersonEvent);
        tasks.send_every(settings.tick_interval, &myself, || HumanTaskProxyMessage::Tick);
        let (bus, keys) = (bus.clone(), keys.clone());
        Ok(HumanTaskProxyState {
            settings,
            coordinator: None,
            roles: BTreeMap::new(),
            looks: 0,
            seen: 0,
            cancellations: PendingCancellations::default(),
            called_off: BTreeMap::new(),
            words: RecentCancelOrders::default(),
            signals: SignalExchange::new(bus, keys),
            tasks,
        })
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        match message {
            HumanTaskProxyMessage::Tick => state.beat(&myself).await,
            HumanTaskProxyMessage::Beacon(sample) => state.follow_coordinator(&myself, &sample),
            HumanTaskProxyMessage::MissionsChanged(_) => state.look(&myself),
            HumanTaskProxyMessage::ActiveMissions(look, live) => {
                if look > state.seen {
                    state.seen = look;
                    state.update_missions(&myself, live).await?;
                }
            }
            HumanTaskProxyMessage::Signal(sample) => match codec::decode::<SignalHistory>(&sample.payload) {
                Ok(said) => state.receive_signals(&myself, &said).await,
                Err(problem) => warn!(key = sample.key, %problem, "a signal that cannot be read"),
            },
            HumanTaskProxyMessage::SignalHistory(said) => state.receive_signals(&myself, &said).await,
            HumanTaskProxyMessage::PersonEvent(sample) => match codec::decode::<PersonEvent>(&sample.payload) {
                Ok(PersonEvent::RequestEnded { id, result }) => state.handle_request_ended(&myself, id, result).await,
                Ok(PersonEvent::CancelMission { by, role, robot, at_ms: said_ms }) => {
                    state.call_off(&by, &role, &robot, said_ms)
                }
                Err(problem) => warn!(%problem, "a person's word that cannot be read"),
            },
            HumanTaskProxyMessage::RequestReplied(_, PersonRequestState::Requested) => {}
            HumanTaskProxyMessage::RequestReplied(id, PersonRequestState::Ended(result)) => {
                state.cancellations.confirm(id);
                state.handle_request_ended(&myself, id, result).await;
            }
            HumanTaskProxyMessage::RequestReplied(id, PersonRequestState::Canceled) => {
                state.cancellations.confirm(id);
                state.renew_request(&myself, id);
            }
            HumanTaskProxyMessage::ReportReplied(mission, role, branch, answer) => {
                state.handle_report_reply(&myself, &(mission, role), branch, answer).await;
            }
        }
        Ok(())
    }
}

impl HumanTaskProxyState {
    async fn beat(&mut self, myself: &ActorRef<HumanTaskProxyMessage>) {
        self.look(myself);
        for ((mission, _), job) in &self.roles {
            query_signals(&self.signals, &mut self.tasks, myself, mission, &job.sequencer);
            if let Some(asked) = &job.request {
                send_person_request(&self.settings, &mut self.tasks, myself, asked.id(), Some(asked.request()));
            }
        }
        let jobs = &self.roles;
        self.called_off.retain(|mission, _| jobs.keys().any(|(live, _)| live == mission));
        for (mission, by) in self.called_off.clone() {
            self.withdraw(mission, by);
        }
        for id in self.cancellations.pending() {
            send_person_request(&self.settings, &mut self.tasks, myself, id, None);
        }
        for key in self.roles.keys().cloned().collect::<Vec<_>>() {
            self.report(myself, &key);
        }
    }

    fn follow_coordinator(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, sample: &Sample) {
        let Ok(beacon) = codec::decode::<Beacon>(&sample.payload) else { return };
        if !beacon.supersedes(self.coordinator.as_ref()) {
            return;
        }
        let new = beacon.is_other_leader_session(self.coordinator.as_ref());
        self.coordinator = Some(beacon);
        if new {
            self.look(myself);
        }
    }

    /// Asks the coordinator which missions are under way.
    fn look(&mut self, myself: &ActorRef<HumanTaskProxyMessage>) {
        let Some(beacon) = &self.coordinator else { return };
        let key = self.settings.keys.write(&Key::ActiveMissions(beacon.node.clone()));
        let (bus, to) = (self.settings.bus.clone(), myself.clone());
        self.looks += 1;
        let look = self.looks;
        self.tasks.spawn(async move {
            match live(bus, &key).await {
                // An attendant that has stopped needs no answer.
                Some(live) => drop(to.cast(HumanTaskProxyMessage::ActiveMissions(look, live))),
                None => debug!(key, "not told in full what is under way; the next beat asks again"),
            }
        });
    }

    /// Somebody calls off the mission for which a robot came to them: whichever it is in which the robot and they have a part.
    fn call_off(&mut self, by: &str, role: &RoleId, robot: &RobotId, said_ms: u64) {
        let theirs = |((_, plays), job): &(&RoleKey, &ProxyRole)| {
            plays == role && job.sequencer.holders().values().any(|holding| holding.robot == *robot)
        };
        let Some(mission) = self.roles.iter().find(theirs).map(|((mission, _), _)| mission.clone()) else { return };
        if self.words.is_new(by, robot, said_ms) {
            self.called_off.insert(mission.clone(), by.to_owned());
            self.withdraw(mission, by.to_owned());
        }
    }

    /// Asks the coordinator to cancel a mission, as any client would. Each beat repeats it while the mission is under way.
    fn withdraw(&mut self, mission: MissionId, by: String) {
        let request = serde_json::json!({ "mission": mission, "by": by }).to_string();
        let (bus, key) = (self.settings.bus.clone(), self.settings.keys.write(&Key::Api(ApiCall::Cancel)));
        self.tasks.spawn(async move {
            let Ok(mut replies) = bus.query(&key, Bytes::from(request), CANCEL_LIMIT).await else { return };
            while let Some(reply) = replies.recv().await {
                debug!(%mission, answered = reply.payload.is_ok(), "a cancel was answered");
            }
        });
    }
}

/// `None` if the answer did not come in full.
async fn live(bus: SharedBus, key: &str) -> Option<ActiveMissions> {
    let mut replies = bus.query(key, Bytes::new(), Duration::from_millis(500)).await.ok()?;
    let mut parts: Vec<ActiveMissions> = vec![];
    while let Some(reply) = replies.recv().await {
        parts.push(codec::decode(&reply.payload.ok()?).ok()?);
    }
    ActiveMissions::join(parts)
}
