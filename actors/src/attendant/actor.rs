//! The attendant: speaks for those who play unmanaged roles, since they take no orders from the fleet.
//!
//! It follows the missions under way, runs each unmanaged role's local plan as far as the others' signals allow, asks the
//! host of people to do the tasks in it, and tells the others when they have been done. One attendant in a fleet is
//! enough, two do no harm: asks and signals have names of their own and repeating them changes nothing.
//!
//! It remembers nothing beyond its life. What it had asked is asked again by the next one, under the same id, if it is still
//! wanted; else nobody repeats it, and the host of people withdraws it.

mod asks;

use self::asks::{Asked, Dismissals, Matter, Words};
use crate::body::{PeopleAsk, PersonState, PersonWord};
use crate::bus::{BusError, Sample, SharedBus};
use crate::events::Events;
use crate::robot::{Move, Outdated, Sequencer, Talk, ask as send_report};
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::event::Happening;
use consort_protocol::ids::{ClusterId, MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::{ApiCall, Key, Keys, PeopleCall};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Branch;
use consort_protocol::message::{Beacon, FailureKind, Live, LivePlan, Report, ReportAnswer, Said, TaskFailure};
use consort_protocol::plan::{LocalPlan, Signal};
use consort_skills::actions::{ActionError, GoalId, PersonAsk};
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::collections::{BTreeMap, BTreeSet};
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
    settings: AttendantSettings,
    coordinator: Option<Beacon>,
    jobs: BTreeMap<(MissionId, RoleId), Job>,
    /// How often the coordinator was asked which missions are under way, and which of these questions is the latest of which
    /// the answer was taken: answers may overtake one another.
    looks: u64,
    seen: u64,
    dismissals: Dismissals,
    /// Missions that people called off, and who did: asked of the coordinator until they are no longer under way.
    called_off: BTreeMap<MissionId, String>,
    words: Words,
    talk: Talk,
    /// Signals under awards no longer in force, counted since the start.
    outdated: u64,
    tasks: Tasks,
}

/// One unmanaged role of a mission under way.
struct Job {
    cluster: Option<ClusterId>,
    branch: Branch,
    plan: LocalPlan,
    sequencer: Sequencer,
    /// What the person is at.
    ask: Option<Asked>,
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
            looks: 0,
            seen: 0,
            dismissals: Dismissals::default(),
            called_off: BTreeMap::new(),
            words: Words::default(),
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
                let key = (mission, role);
                let Some(job) = state.jobs.get_mut(&key).filter(|job| job.branch == branch) else { return Ok(()) };
                match answer {
                    ReportAnswer::Ended { .. } => state.put_down(&myself, &key),
                    ReportAnswer::Renewed { ended, told, .. } => {
                        job.sequencer.set_known(&ended);
                        job.sequencer.hear_of(&told);
                        state.advance(&myself, &key).await;
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

    async fn follow_missions(
        &mut self,
        myself: &ActorRef<AttendantMessage>,
        Live { cluster, plans, .. }: Live,
    ) -> Result<(), BusError> {
        let live: Vec<_> = plans.iter().map(|live| (live.mission.clone(), live.plan.role.clone())).collect();
        for key in self.jobs.keys().filter(|key| !live.contains(key)).cloned().collect::<Vec<_>>() {
            self.put_down(myself, &key);
        }
        for LivePlan { mission, branch, plan, ended, holders, vacant, told } in plans {
            let key = (mission.clone(), plan.role.clone());
            match self.jobs.get(&key) {
                // Said by a coordinator that has yet to learn of the recovery branch.
                Some(job) if job.cluster == cluster && branch < job.branch => continue,
                Some(job) if (job.cluster, job.branch) != (cluster, branch) || job.plan != plan => {
                    self.put_down(myself, &key);
                }
                Some(_) | None => {}
            }
            if let Some(job) = self.jobs.get_mut(&key) {
                job.sequencer.set_known(&ended);
                if *job.sequencer.holders() != holders {
                    if job.sequencer.set_holders(holders) {
                        ask_around(&self.talk, &mut self.tasks, myself, &mission, &job.sequencer);
                    }
                    // Whoever was to be met is somebody else now: ask anew.
                    if let Some(asked) = job.ask.take_if(|asked| asked.is_outdated(job.sequencer.holders())) {
                        job.sequencer.break_off();
                        self.dismiss(myself, asked.id());
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
                let outdated = BTreeSet::new();
                let job = Job { cluster, branch, plan, sequencer, ask: None, failure: None, outdated };
                self.jobs.insert(key.clone(), job);
            }
            if let Some(job) = self.jobs.get_mut(&key) {
                job.sequencer.set_vacant(&vacant);
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
        let asked = self.jobs.iter().find(|(_, job)| job.ask.as_ref().is_some_and(|asked| asked.id() == id));
        let Some(key) = asked.map(|(key, _)| key.clone()) else { return };
        let Some(job) = self.jobs.get_mut(&key) else { return };
        let (Some(Asked { spot, .. }), Some(task)) = (job.ask.take(), job.sequencer.at().cloned()) else { return };
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

    /// Somebody calls off the mission for which a robot came to them: whichever it is in which the robot and they have a part.
    fn call_off(&mut self, by: &str, role: &RoleId, robot: &RobotId, said_ms: u64) {
        let theirs = |((_, plays), job): &(&(MissionId, RoleId), &Job)| {
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

    /// Somebody has called off what is still wanted: this attendant itself, before it knew better, or another.
    fn ask_again(&mut self, myself: &ActorRef<AttendantMessage>, id: GoalId) {
        let mut asks = self.jobs.values_mut().filter_map(|job| job.ask.as_mut());
        let Some(asked) = asks.find(|asked| asked.id() == id) else { return };
        asked.again();
        ask_person(&self.settings, &mut self.tasks, myself, asked.id(), Some(asked.ask()));
    }

    async fn advance(&mut self, myself: &ActorRef<AttendantMessage>, key: &(MissionId, RoleId)) {
        let (mission, role) = key;
        let mut moved = false;
        while let Some(job) = self.jobs.get_mut(key).filter(|job| job.failure.is_none()) {
            let Some(next) = job.sequencer.next_move() else { break };
            moved = true;
            match next {
                Move::Perform { spot, task, spec } => {
                    let (cluster, branch, holders) = (job.cluster, job.branch, job.sequencer.holders().clone());
                    let (mission, role) = (mission.clone(), role.clone());
                    let began =
                        Happening::TaskBegan { mission: mission.clone(), role: role.clone(), task: task.clone() };
                    let asked = Asked::first(spot, Matter { cluster, mission, branch, role, task, spec, holders });
                    self.settings.events.tell(began);
                    ask_person(&self.settings, &mut self.tasks, myself, asked.id(), Some(asked.ask()));
                    job.ask = Some(asked);
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
            branch: job.branch,
            ended: job.sequencer.ended().clone(),
            at: job.sequencer.at().cloned(),
            place: None,
            resumes: false,
            failure: job.failure.clone(),
        };
        let to_node = self.settings.keys.write(&Key::Report(beacon.node.clone()));
        let (bus, limit, to, branch) = (self.settings.bus.clone(), self.settings.beat, myself.clone(), job.branch);
        self.tasks.spawn(async move {
            match send_report(bus, &to_node, &report, limit).await {
                // An attendant that has stopped needs no answer.
                Some(answer) => drop(to.cast(AttendantMessage::Reported(mission, role, branch, answer))),
                None => debug!(%mission, %role, "a report was not answered; the next beat repeats it"),
            }
        });
    }

    fn put_down(&mut self, myself: &ActorRef<AttendantMessage>, key: &(MissionId, RoleId)) {
        let Some(job) = self.jobs.remove(key) else { return };
        self.talk.put_down(&key.0, &key.1);
        if let Some(asked) = job.ask {
            self.dismiss(myself, asked.id());
        }
    }

    /// Calls an ask off. Each beat repeats it until it is answered, lest somebody serve it in the next mission.
    fn dismiss(&mut self, myself: &ActorRef<AttendantMessage>, id: GoalId) {
        self.dismissals.add(id);
        ask_person(&self.settings, &mut self.tasks, myself, id, None);
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

/// `None` if the answer did not come in full.
async fn live(bus: SharedBus, key: &str) -> Option<Live> {
    let mut replies = bus.query(key, Bytes::new(), Duration::from_millis(500)).await.ok()?;
    let mut parts: Vec<Live> = vec![];
    while let Some(reply) = replies.recv().await {
        parts.push(codec::decode(&reply.payload.ok()?).ok()?);
    }
    Live::whole(parts)
}
