//! The attendant's mailbox: whom it hears, what it asks for, and what people call off.

use super::asks::{Dismissals, Words};
use super::jobs::{Job, JobKey, ask_around, ask_person};
use crate::body::{PersonState, PersonWord};
use crate::bus::{Sample, SharedBus};
use crate::events::Events;
use crate::robot::Talk;
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::{ApiCall, Key, Keys, PeopleCall};
use consort_protocol::ledger::Branch;
use consort_protocol::message::{Beacon, Live, ReportAnswer, Said};
use consort_skills::actions::GoalId;
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::collections::BTreeMap;
use std::time::Duration;
use tracing::{debug, warn};

/// How long the coordinator may take to write down that a mission was called off.
const CANCEL_LIMIT: Duration = Duration::from_secs(2);

/// How an attendant works.
pub struct AttendantSettings {
    /// The node it lives on.
    pub node: NodeId,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// Where it tells what happens.
    pub events: Events,
    /// How often it looks after everything; what is heard is acted on at once. Default 1 s.
    pub beat: Duration,
}

/// To an attendant.
pub enum AttendantMessage {
    /// Time to look after everything.
    Beat,
    /// The coordinator says that it is there.
    Beacon(Sample),
    /// Missions under way have changed.
    Changed(Sample),
    /// The missions under way, as a coordinator has them, and which question that answers.
    Live(u64, Live),
    /// A role of some mission said something.
    Signal(Sample),
    /// A role answered what it has said.
    Said(Said),
    /// A person has ended something.
    Done(Sample),
    /// The host of people answered to an ask.
    Asked(GoalId, PersonState),
    /// A report of this branch's plan was answered.
    Reported(MissionId, RoleId, Branch, ReportAnswer),
}

/// The actor.
pub struct Attendant;

/// State of [`Attendant`].
pub struct AttendantState {
    pub(super) settings: AttendantSettings,
    pub(super) coordinator: Option<Beacon>,
    pub(super) jobs: BTreeMap<JobKey, Job>,
    /// How often the coordinator was asked which missions are under way, and which of these questions is the latest of which
    /// the answer was taken: answers may overtake one another.
    looks: u64,
    seen: u64,
    pub(super) dismissals: Dismissals,
    /// Missions that people called off, and who did: asked of the coordinator until they are no longer under way.
    called_off: BTreeMap<MissionId, String>,
    words: Words,
    pub(super) talk: Talk,
    pub(super) tasks: Tasks,
}

#[ractor::async_trait]
impl Actor for Attendant {
    type Msg = AttendantMessage;
    type State = AttendantState;
    type Arguments = AttendantSettings;

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        settings: AttendantSettings,
    ) -> Result<Self::State, ActorProcessingErr> {
        let AttendantSettings { keys, bus, .. } = &settings;
        let mut tasks = Tasks::default();
        tasks.forward(bus.subscribe(&keys.write(&Key::Beacon)).await?, &myself, AttendantMessage::Beacon);
        tasks.forward(bus.subscribe(&keys.write(&Key::Changed)).await?, &myself, AttendantMessage::Changed);
        tasks.forward(bus.subscribe(&keys.any_signal()).await?, &myself, AttendantMessage::Signal);
        let done = keys.write(&Key::People(PeopleCall::Done));
        tasks.forward(bus.subscribe(&done).await?, &myself, AttendantMessage::Done);
        tasks.beat(settings.beat, &myself, || AttendantMessage::Beat);
        let (bus, keys) = (bus.clone(), keys.clone());
        Ok(AttendantState {
            settings,
            coordinator: None,
            jobs: BTreeMap::new(),
            looks: 0,
            seen: 0,
            dismissals: Dismissals::default(),
            called_off: BTreeMap::new(),
            words: Words::default(),
            talk: Talk::new(bus, keys),
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
            AttendantMessage::Beat => state.beat(&myself).await,
            AttendantMessage::Beacon(sample) => state.follow_coordinator(&myself, &sample),
            AttendantMessage::Changed(_) => state.look(&myself),
            AttendantMessage::Live(look, live) => {
                if look > state.seen {
                    state.seen = look;
                    state.follow_missions(&myself, live).await?;
                }
            }
            AttendantMessage::Signal(sample) => match codec::decode::<Said>(&sample.payload) {
                Ok(said) => state.hear(&myself, &said).await,
                Err(problem) => warn!(key = sample.key, %problem, "a signal that cannot be read"),
            },
            AttendantMessage::Said(said) => state.hear(&myself, &said).await,
            AttendantMessage::Done(sample) => match codec::decode::<PersonWord>(&sample.payload) {
                Ok(PersonWord::Done { id, result }) => state.person_ended(&myself, id, result).await,
                Ok(PersonWord::CallOff { by, role, robot, said_ms }) => state.call_off(&by, &role, &robot, said_ms),
                Err(problem) => warn!(%problem, "a person's word that cannot be read"),
            },
            AttendantMessage::Asked(_, PersonState::Asked) => {}
            AttendantMessage::Asked(id, PersonState::Ended(result)) => {
                state.dismissals.answered(id);
                state.person_ended(&myself, id, result).await;
            }
            AttendantMessage::Asked(id, PersonState::Dismissed) => {
                state.dismissals.answered(id);
                state.ask_again(&myself, id);
            }
            AttendantMessage::Reported(mission, role, branch, answer) => {
                state.reported(&myself, &(mission, role), branch, answer).await;
            }
        }
        Ok(())
    }
}

impl AttendantState {
    async fn beat(&mut self, myself: &ActorRef<AttendantMessage>) {
        self.look(myself);
        for ((mission, _), job) in &self.jobs {
            ask_around(&self.talk, &mut self.tasks, myself, mission, &job.sequencer);
            if let Some(asked) = &job.ask {
                ask_person(&self.settings, &mut self.tasks, myself, asked.id(), Some(asked.ask()));
            }
        }
        let jobs = &self.jobs;
        self.called_off.retain(|mission, _| jobs.keys().any(|(live, _)| live == mission));
        for (mission, by) in self.called_off.clone() {
            self.withdraw(mission, by);
        }
        for id in self.dismissals.open() {
            ask_person(&self.settings, &mut self.tasks, myself, id, None);
        }
        for key in self.jobs.keys().cloned().collect::<Vec<_>>() {
            self.report(myself, &key);
        }
    }

    fn follow_coordinator(&mut self, myself: &ActorRef<AttendantMessage>, sample: &Sample) {
        let Ok(beacon) = codec::decode::<Beacon>(&sample.payload) else { return };
        if !beacon.follows(self.coordinator.as_ref()) {
            return;
        }
        let new = beacon.is_of_another_reign(self.coordinator.as_ref());
        self.coordinator = Some(beacon);
        if new {
            self.look(myself);
        }
    }

    /// Asks the coordinator which missions are under way.
    fn look(&mut self, myself: &ActorRef<AttendantMessage>) {
        let Some(beacon) = &self.coordinator else { return };
        let key = self.settings.keys.write(&Key::Live(beacon.node.clone()));
        let (bus, to) = (self.settings.bus.clone(), myself.clone());
        self.looks += 1;
        let look = self.looks;
        self.tasks.spawn(async move {
            match live(bus, &key).await {
                // An attendant that has stopped needs no answer.
                Some(live) => drop(to.cast(AttendantMessage::Live(look, live))),
                None => debug!(key, "not told in full what is under way; the next beat asks again"),
            }
        });
    }

    /// Somebody calls off the mission for which a robot came to them: whichever it is in which the robot and they have a part.
    fn call_off(&mut self, by: &str, role: &RoleId, robot: &RobotId, said_ms: u64) {
        let theirs = |((_, plays), job): &(&JobKey, &Job)| {
            plays == role && job.sequencer.holders().values().any(|holding| holding.robot == *robot)
        };
        let Some(mission) = self.jobs.iter().find(theirs).map(|((mission, _), _)| mission.clone()) else { return };
        if self.words.is_news(by, robot, said_ms) {
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
async fn live(bus: SharedBus, key: &str) -> Option<Live> {
    let mut replies = bus.query(key, Bytes::new(), Duration::from_millis(500)).await.ok()?;
    let mut parts: Vec<Live> = vec![];
    while let Some(reply) = replies.recv().await {
        parts.push(codec::decode(&reply.payload.ok()?).ok()?);
    }
    Live::whole(parts)
}
