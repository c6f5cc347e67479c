//! The robot actor: mailbox, timers and bus around the values that decide.

use super::bidder::{Bidder, Circumstance};
use super::sequencer::{Move, Sequencer};
use super::skill_runner::{Run, RunnerMessage, SkillOutcome, SkillRunner};
use super::talk::Talk;
use crate::answer;
use crate::body::Body;
use crate::bus::{BusError, Query, Sample, SharedBus};
use crate::clock::Clock;
use crate::events::Events;
use crate::gossip::{GossipHandle, SharedKnowledge};
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::auction::CallForBids;
use consort_protocol::codec;
use consort_protocol::ensemble::Ensemble;
use consort_protocol::event::Happening;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId, TaskId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::{Availability, Worker};
use consort_protocol::lease::{Action, Award, Ending, Epoch, Event, LeaseTerms, Tenure};
use consort_protocol::message::{AwardAnswer, AwardNotice, Beacon, Report, ReportAnswer, Said, TaskFailure};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::StepIndex;
use consort_protocol::units::NodeTime;
use consort_skills::actions::RobotActions;
use consort_skills::descriptor::Estimator;
use consort_skills::library::{SkillContext, SkillLibrary};
use ractor::{Actor, ActorProcessingErr, ActorRef, RpcReplyPort, SupervisionEvent};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use tracing::{debug, info, warn};

/// How a robot works.
pub struct RobotSettings {
    /// Its name.
    pub robot: RobotId,
    /// Which life of its node this is.
    pub incarnation: u64,
    /// What it says of itself before its body has reported.
    pub worker: Worker,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// The node's clock.
    pub clock: Clock,
    /// Where it tells what happens.
    pub events: Events,
    /// Where its knowledge of itself goes.
    pub gossip: GossipHandle,
    /// What the node has heard.
    pub knowledge: SharedKnowledge,
    /// The ensemble it may be a member of.
    pub ensemble: Arc<Ensemble>,
    /// How long awards last.
    pub terms: LeaseTerms,
    /// Prices its work.
    pub estimator: Arc<Estimator>,
    /// Carries its work out.
    pub library: Arc<SkillLibrary>,
    /// Its body.
    pub body: Body,
    /// How often properties are sensed and leases looked after. Default 250 ms; knowledge is told once a second at least.
    pub beat: Duration,
    /// How often a running skill is ticked while nothing is heard from the body. Default 100 ms.
    pub tick: Duration,
}

/// To a robot.
pub enum RobotMessage {
    /// Time to look after everything.
    Beat,
    /// The coordinator says that it is there.
    Beacon(Sample),
    /// The coordinator asks for bids.
    Call(Query),
    /// The coordinator tells of an award, or of its end.
    Notice(Query),
    /// A report was answered, or not.
    Reported {
        /// When it had been sent.
        sent: NodeTime,
        /// What was answered.
        answer: Option<ReportAnswer>,
    },
    /// A skill ended.
    SkillEnded {
        /// Which start of a skill it was.
        run: u64,
        /// The step it was for.
        step: StepIndex,
        /// How.
        outcome: SkillOutcome,
    },
    /// Another role of the mission said something.
    Signal(Sample),
    /// Another role answered what it has said.
    Said(Said),
    /// The robot is to leave the fleet for good: it takes nothing new, and gives up what it holds. Answered once it holds
    /// nothing (true), or when the time allowed has passed (false); whoever asked then ends the node. A node that is only
    /// stopped for a while is not told to leave: its robot goes on with its role when it is back in time.
    Leave {
        /// How long the coordinator may take to say that the role is put down: lease and grace will do.
        within: Duration,
        /// Whether the robot holds nothing now.
        done: RpcReplyPort<bool>,
    },
}

/// The actor.
pub struct Robot;

/// State of [`Robot`].
pub struct RobotState {
    settings: RobotSettings,
    bidder: Bidder,
    worker: Worker,
    sensed_at: NodeTime,
    tenure: Tenure,
    job: Option<Job>,
    talk: Talk,
    coordinator: Option<Beacon>,
    reporting: bool,
    report_again: bool,
    reported_at: NodeTime,
    asked_at: NodeTime,
    runs: u64,
    tasks: Tasks,
}

/// The plan under way.
struct Job {
    mission: MissionId,
    role: RoleId,
    epoch: Epoch,
    sequencer: Sequencer,
    runner: Option<(u64, StepIndex, ActorRef<RunnerMessage>)>,
    failure: Option<TaskFailure>,
    _hearing: Tasks,
}

#[ractor::async_trait]
impl Actor for Robot {
    type Msg = RobotMessage;
    type State = RobotState;
    type Arguments = RobotSettings;

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        settings: RobotSettings,
    ) -> Result<Self::State, ActorProcessingErr> {
        let RobotSettings { robot, keys, bus, .. } = &settings;
        let mut tasks = Tasks::default();
        tasks.forward(bus.subscribe(&keys.write(&Key::Beacon)).await?, &myself, RobotMessage::Beacon);
        tasks.forward(bus.serve(&keys.write(&Key::Bid(robot.clone()))).await?, &myself, RobotMessage::Call);
        tasks.forward(bus.serve(&keys.write(&Key::Award(robot.clone()))).await?, &myself, RobotMessage::Notice);
        let (mut changes, to) = (settings.body.changes(), myself.clone());
        let beat = settings.beat;
        tasks.spawn(async move {
            // The first report of the body is worth telling at once; later ones can wait for the beat.
            let _ = changes.changed().await;
            while to.cast(RobotMessage::Beat).is_ok() {
                tokio::time::sleep(beat).await;
            }
        });
        let now = settings.clock.now();
        Ok(RobotState {
            bidder: Bidder::new(robot.clone(), Arc::clone(&settings.estimator)),
            worker: settings.worker.clone(),
            sensed_at: now,
            tenure: Tenure::new(robot.clone(), settings.terms),
            job: None,
            talk: Talk::new(bus.clone(), keys.clone()),
            coordinator: None,
            reporting: false,
            report_again: false,
            reported_at: now,
            asked_at: now,
            runs: 0,
            tasks,
            settings,
        })
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        match message {
            RobotMessage::Beat => state.beat(&myself).await?,
            RobotMessage::Beacon(sample) => state.follow_coordinator(&myself, &sample),
            RobotMessage::Call(query) => state.bid(&query).await,
            RobotMessage::Notice(query) => state.notice(&myself, &query).await?,
            RobotMessage::Reported { sent, answer } => state.reported(&myself, sent, answer).await?,
            RobotMessage::SkillEnded { run, step, outcome } => state.skill_ended(&myself, run, step, outcome).await?,
            RobotMessage::Signal(sample) => match codec::decode::<Said>(&sample.payload) {
                Ok(said) => state.hear(&myself, &said).await?,
                Err(problem) => warn!(key = sample.key, %problem, "a signal that cannot be read"),
            },
            RobotMessage::Said(said) => state.hear(&myself, &said).await?,
            RobotMessage::Leave { done, .. } => {
                // Whoever asked may have gone.
                let _ = done.send(state.job.is_none());
            }
        }
        Ok(())
    }

    async fn handle_supervisor_evt(
        &self,
        myself: ActorRef<Self::Msg>,
        event: SupervisionEvent,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        if let SupervisionEvent::ActorFailed(who, problem) = event {
            let of_job = state.job.as_ref().and_then(|job| job.runner.as_ref());
            if let Some((run, step, _)) = of_job.filter(|(_, _, runner)| runner.get_id() == who.get_id()) {
                let (run, step) = (*run, *step);
                state.settings.body.stop();
                let outcome = SkillOutcome::Failed(format!("the skill crashed: {problem}"));
                state.skill_ended(&myself, run, step, outcome).await?;
            }
        }
        Ok(())
    }
}

impl RobotState {
    async fn beat(&mut self, myself: &ActorRef<RobotMessage>) -> Result<(), ActorProcessingErr> {
        let now = self.settings.clock.now();
        self.sense(now);
        let actions = self.tenure.handle(Event::Tick, now);
        self.perform(myself, actions).await?;
        if now.since(self.reported_at) >= self.settings.terms.lease / 4 {
            self.report(myself);
        }
        self.ask_around(myself, now);
        self.advance(myself).await
    }

    /// Properties sensing (thesis, Listing 3.1): takes in what the body reports and lets others know.
    fn sense(&mut self, now: NodeTime) {
        self.settings.body.refresh();
        let holding = self.tenure.award().map(|award| Availability::Holding {
            mission: award.mission.clone(),
            role: award.role.clone(),
            suspended: self.tenure.is_suspended(),
        });
        let mut worker = self.worker.clone();
        let mut problem = Some("its body does not answer".to_owned());
        if let Some(report) = self.settings.body.telemetry() {
            worker.place = report.place.clone();
            worker.pose = report.pose;
            worker.battery = report.battery;
            problem = (!report.able).then(|| "its battery is too low to move".to_owned());
        }
        worker.availability = match (problem, holding) {
            (_, Some(holding)) => holding,
            (Some(problem), None) => Availability::OutOfService { problem },
            (None, None) => Availability::Free,
        };
        let changed = worker.availability != self.worker.availability || worker.place != self.worker.place;
        self.worker = worker;
        if changed || now.since(self.sensed_at) >= Duration::from_secs(1) {
            self.sensed_at = now;
            let worker = self.worker.clone();
            if self.settings.gossip.update_with(move |knowledge| knowledge.worker = Some(worker)).is_err() {
                debug!(robot = %self.settings.robot, "gossip has stopped");
            }
        }
    }

    fn follow_coordinator(&mut self, myself: &ActorRef<RobotMessage>, sample: &Sample) {
        match codec::decode::<Beacon>(&sample.payload) {
            Ok(beacon) => {
                let known = self.coordinator.as_ref().map(|known| (known.term, known.node.clone()));
                if known.as_ref().is_some_and(|(term, _)| beacon.term < *term) {
                    return; // one that does not know that it no longer coordinates
                }
                let new = known != Some((beacon.term, beacon.node.clone()));
                self.coordinator = Some(beacon);
                if new {
                    self.report(myself);
                }
            }
            Err(problem) => warn!(%problem, "a beacon that cannot be read"),
        }
    }

    async fn bid(&mut self, query: &Query) {
        let Some(call) = answer::read::<CallForBids>(query).await else { return };
        let now = self.settings.clock.now();
        self.sense(now);
        let me = NodeId::from(self.settings.robot.clone());
        let coordinator = self.coordinator.as_ref().map_or_else(|| me.clone(), |beacon| beacon.node.clone());
        let membership =
            self.settings.knowledge.read(|base| self.settings.ensemble.judge(&me, &coordinator, base, now));
        let age_ms = self.settings.body.telemetry_age_ms();
        let circumstance = Circumstance { worker: &self.worker, age_ms, membership };
        let tender = self.bidder.tender(&call, &circumstance);
        let key = self.settings.keys.write(&Key::Bid(self.settings.robot.clone()));
        answer::wire(query, &key, &tender).await;
    }

    async fn notice(&mut self, myself: &ActorRef<RobotMessage>, query: &Query) -> Result<(), ActorProcessingErr> {
        let Some(notice) = answer::read::<AwardNotice>(query).await else { return Ok(()) };
        let now = self.settings.clock.now();
        let (said, event) = match notice {
            AwardNotice::Awarded(award) => match self.tenure.consider(&award) {
                Ok(()) => (AwardAnswer::Heard, Some(Event::Heard(award))),
                Err(why) => (AwardAnswer::Declined(why), None),
            },
            AwardNotice::Revoked { epoch, reason } => (AwardAnswer::Heard, Some(Event::Revoked { epoch, reason })),
        };
        let key = self.settings.keys.write(&Key::Award(self.settings.robot.clone()));
        answer::wire(query, &key, &said).await;
        if let Some(event) = event {
            let actions = self.tenure.handle(event, now);
            self.perform(myself, actions).await?;
        }
        Ok(())
    }

    async fn reported(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        sent: NodeTime,
        answer: Option<ReportAnswer>,
    ) -> Result<(), ActorProcessingErr> {
        self.reporting = false;
        let now = self.settings.clock.now();
        let actions = match answer {
            Some(ReportAnswer::Renewed { epoch, ended, holders }) => {
                if let Some(job) = self.job.as_mut().filter(|job| job.epoch == epoch) {
                    job.sequencer.set_holders(holders);
                }
                self.tenure.handle(Event::Renewed { epoch, sent, ended }, now)
            }
            Some(ReportAnswer::Ended { epoch, reason: Ending::Over }) => {
                self.put_down(epoch, Ending::Over);
                self.tenure.handle(Event::Settled { epoch }, now)
            }
            Some(ReportAnswer::Ended { epoch, reason }) => self.tenure.handle(Event::Revoked { epoch, reason }, now),
            Some(ReportAnswer::NotCoordinator { coordinator }) => {
                debug!(robot = %self.settings.robot, ?coordinator, "reported to one who does not coordinate");
                vec![]
            }
            None => vec![],
        };
        self.perform(myself, actions).await?;
        if std::mem::take(&mut self.report_again) {
            self.report(myself);
        }
        self.advance(myself).await
    }

    async fn skill_ended(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        run: u64,
        step: StepIndex,
        outcome: SkillOutcome,
    ) -> Result<(), ActorProcessingErr> {
        let Some(job) = self.job.as_mut() else { return Ok(()) };
        if job.runner.as_ref().is_none_or(|(current, _, _)| *current != run) {
            return Ok(()); // one that was halted meanwhile
        }
        job.runner = None;
        let (mission, role) = (job.mission.clone(), job.role.clone());
        let Some(task) = job.sequencer.at().cloned() else { return Ok(()) };
        match outcome {
            SkillOutcome::Succeeded => {
                job.sequencer.end(step);
                self.settings.events.tell(Happening::TaskEnded { mission, role, task });
            }
            SkillOutcome::Failed(cause) => {
                warn!(robot = %self.settings.robot, %mission, %task, cause, "task failed");
                job.failure = Some(TaskFailure { task: task.clone(), cause: cause.clone() });
                self.settings.events.tell(Happening::TaskFailed { mission, role, task, cause });
            }
        }
        self.report(myself);
        self.advance(myself).await
    }

    async fn hear(&mut self, myself: &ActorRef<RobotMessage>, said: &Said) -> Result<(), ActorProcessingErr> {
        let Some(job) = self.job.as_mut().filter(|job| job.mission == said.mission) else { return Ok(()) };
        let mut news = false;
        for signal in said.signals.iter().filter(|signal| signal.to == job.role) {
            news |= job.sequencer.hear(signal);
        }
        if news { self.advance(myself).await } else { Ok(()) }
    }

    async fn perform(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        actions: Vec<Action>,
    ) -> Result<(), ActorProcessingErr> {
        for action in actions {
            match action {
                Action::Report => self.report(myself),
                Action::Start(award, ended) => self.start(myself, *award, &ended).await?,
                Action::Suspend => self.suspend(),
                Action::Resume => self.resume(),
                Action::Halt(reason) => {
                    if let Some(epoch) = self.job.as_ref().map(|job| job.epoch) {
                        self.put_down(epoch, reason);
                    }
                }
            }
        }
        let now = self.settings.clock.now();
        self.sense(now);
        self.advance(myself).await
    }

    async fn start(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        award: Award,
        ended: &BTreeSet<StepIndex>,
    ) -> Result<(), BusError> {
        let Award { mission, role, epoch, plan, holders, .. } = award;
        info!(robot = %self.settings.robot, %mission, %role, %epoch, "begins");
        let first = plan.tasks().next().map(|(task, _)| task.clone());
        let taken_up = Sequencer::new(plan.clone(), ended, holders.clone());
        let failure =
            taken_up.as_ref().err().and_then(|problem| Some(TaskFailure { task: first?, cause: problem.to_string() }));
        let Ok(sequencer) = taken_up.or_else(|_| Sequencer::new(plan, &BTreeSet::new(), holders)) else {
            return Ok(());
        };
        let mut hearing = Tasks::default();
        let signals = self.settings.keys.write(&Key::Signal(mission.clone(), role.clone()));
        hearing.forward(self.settings.bus.subscribe(&signals).await?, myself, RobotMessage::Signal);
        self.talk.begin(&mission, &role, epoch, sequencer.said().clone()).await?;
        self.settings.events.tell(Happening::Started { mission: mission.clone(), role: role.clone(), epoch });
        self.job = Some(Job { mission, role, epoch, sequencer, runner: None, failure, _hearing: hearing });
        // Whoever spoke before this robot listened is asked.
        self.ask(myself);
        Ok(())
    }

    fn suspend(&mut self) {
        self.halt_skill();
        if let Some(job) = &self.job {
            warn!(robot = %self.settings.robot, mission = %job.mission, "lease ran out: suspended");
            let (mission, role) = (job.mission.clone(), job.role.clone());
            self.settings.events.tell(Happening::Suspended { mission, role });
        }
    }

    fn resume(&mut self) {
        if let Some(job) = &self.job {
            let (mission, role) = (job.mission.clone(), job.role.clone());
            self.settings.events.tell(Happening::Resumed { mission, role });
        }
    }

    /// Stops and forgets the plan held under `epoch`. What was said in it can still be asked for.
    fn put_down(&mut self, epoch: Epoch, reason: Ending) {
        if self.job.as_ref().is_none_or(|job| job.epoch != epoch) {
            return;
        }
        self.halt_skill();
        if let Some(job) = self.job.take() {
            info!(robot = %self.settings.robot, mission = %job.mission, ?reason, "puts its role down");
            let (mission, role) = (job.mission, job.role);
            self.settings.events.tell(Happening::Halted { mission, role, reason });
        }
    }

    fn halt_skill(&mut self) {
        let Some(job) = &mut self.job else { return };
        job.sequencer.break_off();
        if let Some((_, _, runner)) = job.runner.take() {
            // One that has just ended by itself needs no halting.
            let _ = runner.cast(RunnerMessage::Halt);
        }
    }

    /// The sequencing process: as many steps as can be taken now.
    async fn advance(&mut self, myself: &ActorRef<RobotMessage>) -> Result<(), ActorProcessingErr> {
        let mut moved = false;
        while self.tenure.may_act(self.settings.clock.now()) {
            let Some(job) = self.job.as_mut().filter(|job| job.failure.is_none()) else { break };
            let Some(next) = job.sequencer.next_move() else { break };
            moved = true;
            let mission = job.mission.clone();
            match next {
                Move::Perform { step, task, spec } => self.begin_task(myself, step, &task, &spec).await?,
                Move::Tell(signal) => {
                    self.talk.say(&mission, &signal).await;
                    self.settings.events.tell(Happening::Sent { mission, signal });
                }
                Move::Heard(signal) => self.settings.events.tell(Happening::Heard { mission, signal }),
            }
        }
        if moved {
            self.report(myself);
        }
        Ok(())
    }

    async fn begin_task(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        step: StepIndex,
        task: &TaskId,
        spec: &TaskSpec,
    ) -> Result<(), ActorProcessingErr> {
        let Some(job) = self.job.as_mut() else { return Ok(()) };
        let (mission, role) = (job.mission.clone(), job.role.clone());
        self.settings.events.tell(Happening::TaskBegan { mission, role, task: task.clone() });
        self.runs += 1;
        let run = self.runs;
        let context = SkillContext { holders: job.sequencer.holders().clone() };
        let to = myself.clone();
        let ended = move |outcome| {
            // A robot that has stopped needs no outcome.
            let _ = to.cast(RobotMessage::SkillEnded { run, step, outcome });
        };
        match self.settings.library.load(spec, &context) {
            Ok(skill) => {
                let (body, period) = (self.settings.body.clone(), self.settings.tick);
                let run_it = Run { skill, body, period, done: Box::new(ended) };
                let (runner, _) = Actor::spawn_linked(None, SkillRunner, run_it, myself.get_cell()).await?;
                job.runner = Some((run, step, runner));
            }
            Err(problem) => {
                job.failure = Some(TaskFailure { task: task.clone(), cause: problem.to_string() });
                self.report(myself);
            }
        }
        Ok(())
    }

    /// Reports to the coordinator; one report at a time, and another at once if there was news meanwhile.
    fn report(&mut self, myself: &ActorRef<RobotMessage>) {
        let (Some(award), Some(beacon)) = (self.tenure.award(), &self.coordinator) else { return };
        if self.reporting {
            self.report_again = true;
            return;
        }
        let job = self.job.as_ref().filter(|job| job.epoch == award.epoch);
        let report = Report {
            robot: self.settings.robot.clone(),
            incarnation: self.settings.incarnation,
            mission: award.mission.clone(),
            role: award.role.clone(),
            epoch: award.epoch,
            ended: job.map(|job| job.sequencer.ended().clone()).unwrap_or_default(),
            at: job.and_then(|job| job.sequencer.at().cloned()),
            failure: job.and_then(|job| job.failure.clone()),
        };
        let key = self.settings.keys.write(&Key::Report(beacon.node.clone()));
        self.reporting = true;
        let sent = self.settings.clock.now();
        self.reported_at = sent;
        let (bus, limit, to) = (self.settings.bus.clone(), self.settings.terms.lease / 4, myself.clone());
        self.tasks.spawn(async move {
            let answer = ask(bus, &key, &report, limit).await;
            // A robot that has stopped needs no answer.
            let _ = to.cast(RobotMessage::Reported { sent, answer });
        });
    }

    /// Every now and then, asks those from whom a signal is awaited: it may have been lost.
    fn ask_around(&mut self, myself: &ActorRef<RobotMessage>, now: NodeTime) {
        if now.since(self.asked_at) >= Duration::from_secs(1) {
            self.asked_at = now;
            self.ask(myself);
        }
    }

    fn ask(&mut self, myself: &ActorRef<RobotMessage>) {
        let Some(job) = &self.job else { return };
        let to = myself.clone();
        self.talk.ask(&job.mission, &job.sequencer.awaiting(), &mut self.tasks, move |said| {
            // A robot that has stopped needs no answer.
            let _ = to.cast(RobotMessage::Said(said));
        });
    }
}

/// Asks one coordinator.
pub(crate) async fn ask(bus: SharedBus, key: &str, report: &Report, limit: Duration) -> Option<ReportAnswer> {
    let bytes = Bytes::from(codec::encode(report).expect("a report fits a message"));
    let mut replies = bus.query(key, bytes, limit).await.ok()?;
    match codec::decode(&replies.recv().await?.payload.ok()?) {
        Ok(answer) => Some(answer),
        Err(problem) => {
            warn!(%problem, "an answer to a report that cannot be read");
            None
        }
    }
}
