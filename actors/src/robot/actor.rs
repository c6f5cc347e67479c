//! The robot actor: mailbox, timers and bus around the values that decide.

use super::bidder::{Bidder, Circumstance};
use super::job::Job;
use super::ladder::Setback;
use super::page::Page;
use super::settings::RobotSettings;
use super::skill_runner::SkillOutcome;
use super::talk::Talk;
use crate::answer;
use crate::bus::{Query, Sample};
use crate::tasks::Tasks;
use consort_protocol::auction::CallForBids;
use consort_protocol::codec;
use consort_protocol::event::Happening;
use consort_protocol::ids::{NodeId, PlaceId, RoleId};
use consort_protocol::keys::Key;
use consort_protocol::knowledge::{Availability, Worker};
use consort_protocol::lease::{Epoch, Event, Holding, Tenure};
use consort_protocol::message::{Beacon, FailureKind, ReportAnswer, Said};
use consort_protocol::units::NodeTime;
use consort_skills::actions::RobotActions;
use ractor::{Actor, ActorProcessingErr, ActorRef, RpcReplyPort, SupervisionEvent};
use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::time::Duration;
use tracing::{debug, info, warn};

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
        /// How.
        outcome: SkillOutcome,
    },
    /// Another role of the mission said something.
    Signal(Sample),
    /// Another role answered what it has said.
    Said(Said),
    /// The notebook's page was written, or not.
    Written(io::Result<()>),
    /// The robot is to leave the fleet for good: it takes nothing new, and gives up what it holds. Answered once it holds
    /// nothing (true), or when the time allowed has passed (false); whoever asked then ends the node. A node that is only
    /// stopped for a while is not told to leave: its robot goes on with its role when it is back in time.
    Leave {
        /// How long the coordinator may take to say that the role is put down: lease and grace will do.
        within: Duration,
        /// Whether the robot holds nothing now.
        done: RpcReplyPort<bool>,
    },
    /// The time allowed for leaving has passed.
    Overdue,
}

/// The actor.
pub struct Robot;

/// State of [`Robot`].
pub struct RobotState {
    pub(super) settings: RobotSettings,
    bidder: Bidder,
    pub(super) worker: Worker,
    /// The worker as this life of the actor last told others of it.
    told: Option<Worker>,
    sensed_at: NodeTime,
    pub(super) tenure: Tenure,
    /// What a former life had written down, until the coordinator has spoken.
    pub(super) recalled: Option<Page>,
    /// The award that this life took up from a former one.
    pub(super) resumes: Option<Epoch>,
    /// Who holds the mission's roles, by the latest answer about this award.
    pub(super) heard_holders: Option<(Epoch, BTreeMap<RoleId, Holding>)>,
    pub(super) job: Option<Job>,
    pub(super) talk: Talk,
    pub(super) coordinator: Option<Beacon>,
    pub(super) reporting: bool,
    pub(super) report_again: bool,
    pub(super) reported_at: NodeTime,
    pub(super) asked_at: NodeTime,
    pub(super) priced_at: NodeTime,
    pub(super) runs: u64,
    /// Whether the notebook is being written.
    pub(super) writing: bool,
    /// Whether there is, or may be, a page in the notebook.
    pub(super) page_written: bool,
    /// Why the notebook could not be written the last time, if it could not.
    pub(super) notebook_problem: Option<String>,
    /// When it was tried.
    pub(super) notebook_tried_at: NodeTime,
    /// Those who wait for the robot to have left; `Some` from when it was told to.
    pub(super) leaving: Option<Vec<RpcReplyPort<bool>>>,
    pub(super) tasks: Tasks,
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
        let recalled = recall(&settings).await;
        let mut tasks = Tasks::default();
        tasks.forward(bus.subscribe(&keys.write(&Key::Beacon)).await?, &myself, RobotMessage::Beacon);
        tasks.forward(bus.serve(&keys.write(&Key::Bid(robot.clone()))).await?, &myself, RobotMessage::Call);
        tasks.forward(bus.serve(&keys.write(&Key::Award(robot.clone()))).await?, &myself, RobotMessage::Notice);
        let (mut changes, to) = (settings.body.changes(), myself.clone());
        let beat = settings.beat;
        tasks.spawn(async move {
            // The first report of the body is worth telling at once; later ones can wait for the beat. A robot whose body
            // says nothing has to look after its role all the same.
            let _ = tokio::time::timeout(Duration::from_secs(1), changes.changed()).await;
            while to.cast(RobotMessage::Beat).is_ok() {
                tokio::time::sleep(beat).await;
            }
        });
        let now = settings.clock.now();
        let tenure = match &recalled {
            Some(page) => Tenure::restore(robot.clone(), settings.terms, page.award.clone()),
            None => Tenure::new(robot.clone(), settings.terms),
        };
        let mut state = RobotState {
            bidder: Bidder::new(robot.clone(), Arc::clone(&settings.estimator)),
            worker: settings.worker.clone(),
            told: None,
            sensed_at: now,
            tenure,
            resumes: recalled.as_ref().map(|page| page.award.epoch),
            recalled,
            heard_holders: None,
            job: None,
            talk: Talk::new(bus.clone(), keys.clone()),
            coordinator: None,
            reporting: false,
            report_again: false,
            reported_at: now,
            asked_at: now,
            priced_at: now,
            runs: 0,
            writing: false,
            // Whatever stands there and is not taken up is torn out.
            page_written: true,
            notebook_problem: None,
            notebook_tried_at: now,
            leaving: None,
            tasks,
            settings,
        };
        if state.recalled.is_some() {
            state.sense(now);
        } else {
            state.write_down(&myself);
        }
        Ok(state)
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
            RobotMessage::SkillEnded { run, outcome } => state.skill_ended(&myself, run, outcome).await?,
            RobotMessage::Signal(sample) => match codec::decode::<Said>(&sample.payload) {
                Ok(said) => state.hear(&myself, &said).await?,
                Err(problem) => warn!(key = sample.key, %problem, "a signal that cannot be read"),
            },
            RobotMessage::Said(said) => state.hear(&myself, &said).await?,
            RobotMessage::Written(result) => state.written(&myself, result).await?,
            RobotMessage::Leave { within, done } => state.leave(&myself, within, done).await?,
            RobotMessage::Overdue => state.answer_leave(false),
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
            let of_job = state
                .job
                .as_mut()
                .filter(|job| job.attempt.as_ref().is_some_and(|attempt| attempt.runner.get_id() == who.get_id()));
            if let Some(job) = of_job {
                job.attempt = None;
                state.settings.body.stop();
                let cause = format!("the skill crashed: {problem}");
                state.set_back(&myself, Setback { kind: FailureKind::Crash, cause, lasting: false }).await?;
            }
        }
        Ok(())
    }
}

/// What a former life wrote down, if it can be read.
async fn recall(settings: &RobotSettings) -> Option<Page> {
    let robot = &settings.robot;
    let bytes = match settings.notebook.read().await {
        Ok(bytes) => bytes?,
        Err(problem) => {
            warn!(%robot, %problem, "its notebook cannot be read: it has forgotten whatever it held");
            return None;
        }
    };
    match Page::read(&bytes, robot) {
        Ok(page) => {
            info!(%robot, mission = %page.award.mission, role = %page.award.role, epoch = %page.award.epoch, "recalls");
            Some(page)
        }
        Err(problem) => {
            warn!(%robot, %problem, "a page of its notebook was torn out: it has forgotten whatever it held");
            None
        }
    }
}

/// Others hear of charge in steps of this size: a guess. Bids and the robot itself count with the exact one.
const CHARGE_TOLD: f64 = 0.02;

/// Whether others need to hear what a robot has become: an idle one loses a little charge every second, which changes
/// nobody's mind.
fn is_news(told: &Worker, now: &Worker) -> bool {
    let lost = (told.battery.get() - now.battery.get()).abs() >= CHARGE_TOLD;
    let useful = |worker: &Worker| worker.battery >= worker.useful_charge;
    lost || useful(told) != useful(now) || Worker { battery: told.battery, ..now.clone() } != *told
}

impl RobotState {
    async fn beat(&mut self, myself: &ActorRef<RobotMessage>) -> Result<(), ActorProcessingErr> {
        let now = self.settings.clock.now();
        self.sense(now);
        let actions = self.tenure.handle(Event::Tick, now);
        self.perform(myself, actions).await?;
        let held_up = self.job.as_ref().is_some_and(|job| job.surrender.is_none() && job.sequencer.awaits_ledger());
        let owes = self.job.as_ref().and_then(|job| job.surrender.as_ref());
        let owes = owes.is_some_and(|surrender| surrender.is_owed(self.settings.body.is_at_rest(), now));
        if held_up || owes || now.since(self.reported_at) >= self.settings.terms.lease / 4 {
            self.report(myself);
        }
        self.ask_around(myself, now);
        self.look_after_work(myself, now).await?;
        self.advance(myself).await
    }

    /// The ways that the body has found closed.
    pub(super) fn closed(&self) -> &[(PlaceId, PlaceId)] {
        self.settings.body.telemetry().map_or(&[], |report| &report.closed)
    }

    /// Properties sensing (thesis, Listing 3.1): takes in what the body reports and lets others know.
    pub(super) fn sense(&mut self, now: NodeTime) {
        self.settings.body.refresh();
        let holding = self.tenure.award().map(|award| Availability::Holding {
            mission: award.mission.clone(),
            role: award.role.clone(),
            suspended: self.tenure.is_suspended(),
        });
        let mut worker = self.worker.clone();
        let silent = || Some("its body does not answer".to_owned());
        let mut problem = silent();
        if let Some(report) = self.settings.body.telemetry() {
            worker.place = report.place.clone();
            worker.pose = report.pose;
            worker.battery = report.battery;
            problem = match () {
                () if !report.able => Some("its battery is too low to move".to_owned()),
                () if self.settings.body.silent_for() >= self.settings.patience.silence => silent(),
                () => None,
            };
        }
        if let Some(why) = &self.notebook_problem {
            // What it would hold it could not write down, and would have forgotten after a crash.
            problem = Some(format!("its notebook cannot be written: {why}"));
        }
        if self.leaving.is_some() {
            problem = Some("it leaves the fleet".to_owned());
        }
        worker.availability = match (problem, holding) {
            (_, Some(holding)) => holding,
            (Some(problem), None) => Availability::OutOfService { problem },
            (None, None) => Availability::Free,
        };
        self.worker = worker;
        let now_is = &self.worker;
        let urgent = |told: &Worker| told.availability != now_is.availability || told.place != now_is.place;
        let due = now.since(self.sensed_at) >= Duration::from_secs(1);
        if self.told.as_ref().is_none_or(|told| urgent(told) || due && is_news(told, now_is)) {
            self.sensed_at = now;
            let worker = self.worker.clone();
            self.told = Some(worker.clone());
            if self.settings.gossip.update_with(move |knowledge| knowledge.worker = Some(worker)).is_err() {
                debug!(robot = %self.settings.robot, "gossip has stopped");
            }
        }
    }

    fn follow_coordinator(&mut self, myself: &ActorRef<RobotMessage>, sample: &Sample) {
        match codec::decode::<Beacon>(&sample.payload) {
            Ok(beacon) => {
                if !beacon.follows(self.coordinator.as_ref()) {
                    return; // one that does not know that it no longer coordinates
                }
                let abroad = self.coordinator.as_ref().is_some_and(|known| beacon.is_abroad(known));
                let new = beacon.is_of_another_reign(self.coordinator.as_ref());
                if abroad {
                    info!(robot = %self.settings.robot, node = %beacon.node, "follows the coordinator of another cluster");
                    self.tenure.forget_latest();
                }
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
        let circumstance = Circumstance { worker: &self.worker, closed: self.closed(), age_ms, membership };
        let tender = self.bidder.tender(&call, &circumstance);
        let key = self.settings.keys.write(&Key::Bid(self.settings.robot.clone()));
        answer::wire(query, &key, &tender).await;
    }

    /// Something has happened to the plan under way.
    pub(super) fn tell(&self, what: Happening) {
        self.settings.events.tell(what);
    }
}
