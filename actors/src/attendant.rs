//! The attendant: speaks for those who play unmanaged roles, since they take no orders from the fleet.
//!
//! It follows the missions under way, runs each unmanaged role's local plan as far as the others' signals allow, asks the
//! host of people to do the tasks in it, and tells the others when they have been done. One attendant in a fleet is
//! enough, two do no harm: asks and signals have names of their own and repeating them changes nothing.

use crate::body::{PeopleAsk, PersonDone, PersonState};
use crate::bus::{BusError, Sample, SharedBus};
use crate::events::Events;
use crate::robot::{Move, Outdated, Sequencer, Spot, Talk, ask as send_report};
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::event::Happening;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId, TaskId};
use consort_protocol::keys::{Key, Keys, PeopleCall};
use consort_protocol::lease::Epoch;
use consort_protocol::message::{Beacon, FailureKind, LivePlan, Report, ReportAnswer, Said, TaskFailure};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{LocalPlan, Signal};
use consort_skills::actions::{ActionError, GoalId, PersonAsk};
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tracing::{debug, warn};

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
    /// The missions under way, as a coordinator has them; `None` if it did not answer in full.
    Live(Option<Vec<LivePlan>>),
    /// A role of some mission said something.
    Signal(Sample),
    /// A role answered what it has said.
    Said(Said),
    /// A person has ended something.
    Done(Sample),
    /// The host of people answered to an ask.
    Asked(GoalId, PersonState),
    /// A report was answered.
    Reported(MissionId, RoleId, ReportAnswer),
}

/// The actor.
pub struct Attendant;

/// State of [`Attendant`].
pub struct AttendantState {
    settings: AttendantSettings,
    coordinator: Option<Beacon>,
    jobs: BTreeMap<(MissionId, RoleId), Job>,
    talk: Talk,
    /// Signals under awards no longer in force, counted since the start.
    outdated: u64,
    tasks: Tasks,
}

/// One unmanaged role of a mission under way.
struct Job {
    /// Another one under the same name is that of the mission's recovery branch.
    plan: LocalPlan,
    sequencer: Sequencer,
    /// What the person is at.
    ask: Option<(GoalId, Spot, PersonAsk)>,
    failure: Option<TaskFailure>,
    /// What was said under awards no longer in force, so that each is told of once.
    outdated: BTreeSet<(Signal, Epoch)>,
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
            talk: Talk::new(bus, keys),
            outdated: 0,
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
            AttendantMessage::Live(plans) => {
                if let Some(plans) = plans {
                    state.follow_missions(&myself, plans).await?;
                }
            }
            AttendantMessage::Signal(sample) => match codec::decode::<Said>(&sample.payload) {
                Ok(said) => state.hear(&myself, &said).await,
                Err(problem) => warn!(key = sample.key, %problem, "a signal that cannot be read"),
            },
            AttendantMessage::Said(said) => state.hear(&myself, &said).await,
            AttendantMessage::Done(sample) => match codec::decode::<PersonDone>(&sample.payload) {
                Ok(done) => state.person_ended(&myself, done.id, done.result).await,
                Err(problem) => warn!(%problem, "a person's word that cannot be read"),
            },
            AttendantMessage::Asked(_, PersonState::Asked) => {}
            AttendantMessage::Asked(id, PersonState::Ended(result)) => state.person_ended(&myself, id, result).await,
            AttendantMessage::Reported(mission, role, answer) => {
                let key = (mission, role);
                match answer {
                    ReportAnswer::Ended { .. } => state.put_down(&key),
                    ReportAnswer::Renewed { ended, told, .. } => {
                        if let Some(job) = state.jobs.get_mut(&key) {
                            job.sequencer.set_known(&ended);
                            job.sequencer.hear_of(&told);
                            state.advance(&myself, &key).await;
                        }
                    }
                    ReportAnswer::NotCoordinator { .. } => {}
                }
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
            if let Some((id, _, ask)) = &job.ask {
                ask_person(&self.settings, &mut self.tasks, myself, *id, Some(ask.clone()));
            }
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
        let new = self.coordinator.as_ref().map(|known| (known.term, &known.node)) != Some((beacon.term, &beacon.node));
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
        self.tasks.spawn(async move {
            let plans = live(bus, &key).await;
            // An attendant that has stopped needs no answer.
            let _ = to.cast(AttendantMessage::Live(plans));
        });
    }

    async fn follow_missions(
        &mut self,
        myself: &ActorRef<AttendantMessage>,
        plans: Vec<LivePlan>,
    ) -> Result<(), BusError> {
        let live: Vec<_> = plans.iter().map(|live| (live.mission.clone(), live.plan.role.clone())).collect();
        for key in self.jobs.keys().filter(|key| !live.contains(key)).cloned().collect::<Vec<_>>() {
            self.put_down(&key);
        }
        for LivePlan { mission, plan, ended, holders, told } in plans {
            let key = (mission.clone(), plan.role.clone());
            if self.jobs.get(&key).is_some_and(|job| job.plan != plan) {
                self.put_down(&key);
            }
            if let Some(job) = self.jobs.get_mut(&key) {
                job.sequencer.set_known(&ended);
                if *job.sequencer.holders() != holders {
                    let robots = job.sequencer.robots();
                    if job.sequencer.set_holders(holders) {
                        ask_around(&self.talk, &mut self.tasks, myself, &mission, &job.sequencer);
                    }
                    // Whoever was to be met is somebody else now: ask anew.
                    if robots != job.sequencer.robots()
                        && let Some((id, _, _)) = job.ask.take()
                    {
                        job.sequencer.break_off();
                        ask_person(&self.settings, &mut self.tasks, myself, id, None);
                    }
                }
            } else {
                let role = plan.role.clone();
                let sequencer = match Sequencer::new(plan.clone(), &ended, holders) {
                    Ok(sequencer) => sequencer,
                    Err(problem) => {
                        warn!(%mission, %role, %problem, "a plan that cannot be taken up");
                        continue;
                    }
                };
                self.talk.begin(&mission, &role, Epoch::default(), sequencer.said().clone()).await?;
                ask_around(&self.talk, &mut self.tasks, myself, &mission, &sequencer);
                let job = Job { plan, sequencer, ask: None, failure: None, outdated: BTreeSet::new() };
                self.jobs.insert(key.clone(), job);
            }
            if let Some(job) = self.jobs.get_mut(&key) {
                job.sequencer.hear_of(&told);
            }
            self.advance(myself, &key).await;
        }
        Ok(())
    }

    async fn hear(&mut self, myself: &ActorRef<AttendantMessage>, said: &Said) {
        for signal in &said.signals {
            let key = (said.mission.clone(), signal.to.clone());
            let Some(job) = self.jobs.get_mut(&key) else { continue };
            match job.sequencer.hear(signal, said.epoch) {
                Ok(true) => self.advance(myself, &key).await,
                Ok(false) => {}
                Err(Outdated { known }) => {
                    self.outdated += 1;
                    if job.outdated.insert((signal.clone(), said.epoch)) {
                        let (mission, signal) = (said.mission.clone(), signal.clone());
                        let (epoch, count) = (said.epoch, self.outdated);
                        self.settings.events.tell(Happening::Outdated { mission, signal, epoch, known, count });
                    }
                }
            }
        }
    }

    async fn person_ended(&mut self, myself: &ActorRef<AttendantMessage>, id: GoalId, result: Result<(), ActionError>) {
        let asked = self.jobs.iter().find(|(_, job)| job.ask.as_ref().is_some_and(|(ask, _, _)| *ask == id));
        let Some(key) = asked.map(|(key, _)| key.clone()) else { return };
        let Some(job) = self.jobs.get_mut(&key) else { return };
        let (Some((_, spot, _)), Some(task)) = (job.ask.take(), job.sequencer.at().cloned()) else { return };
        let (mission, role) = key.clone();
        match result {
            Ok(()) => {
                job.sequencer.end(spot);
                self.settings.events.tell(Happening::TaskEnded { mission, role, task });
            }
            Err(problem) => {
                let cause = problem.to_string();
                let (failed, kind) = (Some(task.clone()), FailureKind::Task);
                job.failure = Some(TaskFailure { task: failed, cause: cause.clone(), kind });
                self.settings.events.tell(Happening::TaskFailed { mission, role, task, cause });
            }
        }
        self.report(myself, &key);
        self.advance(myself, &key).await;
    }

    async fn advance(&mut self, myself: &ActorRef<AttendantMessage>, key: &(MissionId, RoleId)) {
        let (mission, role) = key;
        let mut moved = false;
        while let Some(job) = self.jobs.get_mut(key).filter(|job| job.failure.is_none()) {
            let Some(next) = job.sequencer.next_move() else { break };
            moved = true;
            match next {
                Move::Perform { spot, task, spec } => {
                    let holders = job.sequencer.robots();
                    let ask = PersonAsk { role: role.clone(), task: spec.clone(), holders };
                    let id = ask_id(mission, role, &task, &spec, &ask.holders);
                    job.ask = Some((id, spot, ask.clone()));
                    let (mission, role) = (mission.clone(), role.clone());
                    self.settings.events.tell(Happening::TaskBegan { mission, role, task });
                    ask_person(&self.settings, &mut self.tasks, myself, id, Some(ask));
                }
                Move::Tell(signal) => {
                    self.talk.say(mission, &signal).await;
                    self.settings.events.tell(Happening::Sent { mission: mission.clone(), signal });
                }
                Move::Heard(signal) => {
                    self.settings.events.tell(Happening::Heard { mission: mission.clone(), signal });
                }
            }
        }
        if moved {
            self.report(myself, key);
        }
    }

    /// Lets the ledger know how far the role has come.
    fn report(&mut self, myself: &ActorRef<AttendantMessage>, key: &(MissionId, RoleId)) {
        let (Some(job), Some(beacon)) = (self.jobs.get(key), &self.coordinator) else { return };
        if job.sequencer.ended().is_empty() && job.failure.is_none() {
            return; // nothing that the ledger does not know
        }
        let (mission, role) = key.clone();
        let report = Report {
            robot: RobotId::from(self.settings.node.clone()),
            incarnation: 0,
            mission: mission.clone(),
            role: role.clone(),
            epoch: Epoch::default(),
            ended: job.sequencer.ended().clone(),
            at: job.sequencer.at().cloned(),
            place: None,
            resumes: false,
            failure: job.failure.clone(),
        };
        let to_node = self.settings.keys.write(&Key::Report(beacon.node.clone()));
        let (bus, limit, to) = (self.settings.bus.clone(), self.settings.beat, myself.clone());
        self.tasks.spawn(async move {
            match send_report(bus, &to_node, &report, limit).await {
                // An attendant that has stopped needs no answer.
                Some(answer) => drop(to.cast(AttendantMessage::Reported(mission, role, answer))),
                None => debug!(%mission, %role, "a report was not answered; the next beat repeats it"),
            }
        });
    }

    fn put_down(&mut self, key: &(MissionId, RoleId)) {
        if let Some((id, _, _)) = self.jobs.remove(key).and_then(|job| job.ask) {
            let ask = PeopleAsk { id, ask: None };
            let (bus, people) = (self.settings.bus.clone(), self.settings.keys.write(&Key::People(PeopleCall::Ask)));
            self.tasks.spawn(async move {
                let bytes = Bytes::from(codec::encode(&ask).expect("a dismissal fits a message"));
                if let Err(problem) = bus.query(&people, bytes, Duration::from_millis(500)).await {
                    debug!(%problem, "a person was not dismissed");
                }
            });
        }
    }
}

/// Asks those from whom something is awaited what they have said.
fn ask_around(
    talk: &Talk,
    tasks: &mut Tasks,
    myself: &ActorRef<AttendantMessage>,
    mission: &MissionId,
    sequencer: &Sequencer,
) {
    let to = myself.clone();
    talk.ask(mission, &sequencer.awaiting(), tasks, move |said| {
        // An attendant that has stopped needs no answer.
        let _ = to.cast(AttendantMessage::Said(said));
    });
}

fn ask_person(
    settings: &AttendantSettings,
    tasks: &mut Tasks,
    myself: &ActorRef<AttendantMessage>,
    id: GoalId,
    ask: Option<PersonAsk>,
) {
    let bytes = match codec::encode(&PeopleAsk { id, ask }) {
        Ok(bytes) => Bytes::from(bytes),
        Err(problem) => return warn!(%problem, "an ask does not fit a message"),
    };
    let (bus, key, to) = (settings.bus.clone(), settings.keys.write(&Key::People(PeopleCall::Ask)), myself.clone());
    tasks.spawn(async move {
        let Ok(mut replies) = bus.query(&key, bytes, Duration::from_millis(500)).await else { return };
        while let Some(reply) = replies.recv().await {
            match reply.payload.map(|bytes| codec::decode::<PersonState>(&bytes)) {
                // An attendant that has stopped needs no answer.
                Ok(Ok(state)) => drop(to.cast(AttendantMessage::Asked(id, state))),
                other => debug!(?other, "an ask was not answered"),
            }
        }
    });
}

async fn live(bus: SharedBus, key: &str) -> Option<Vec<LivePlan>> {
    let mut replies = bus.query(key, Bytes::new(), Duration::from_millis(500)).await.ok()?;
    let mut plans: Option<Vec<LivePlan>> = None;
    while let Some(reply) = replies.recv().await {
        let chunk: Vec<LivePlan> = codec::decode(&reply.payload.ok()?).ok()?;
        plans.get_or_insert_default().extend(chunk);
    }
    plans
}

/// The same ask has the same id on every attendant: FNV-1a (Fowler, Noll, Vo) over what it is about.
fn ask_id(
    mission: &MissionId,
    role: &RoleId,
    task: &TaskId,
    spec: &TaskSpec,
    holders: &BTreeMap<RoleId, RobotId>,
) -> GoalId {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    let text = format!("{mission}/{role}/{task}/{}/{holders:?}", spec.task_type);
    for byte in text.bytes() {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    }
    GoalId(hash)
}
