//! The unmanaged roles of missions under way, as far as the others' signals and people allow.

use super::actor::{AttendantMessage, AttendantSettings, AttendantState};
use super::asks::{Asked, Matter};
use crate::body::{PeopleAsk, PersonState};
use crate::bus::BusError;
use crate::robot::{Move, Outdated, OutdatedSignals, Sequencer, Talk, send_report};
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::event::Happening;
use consort_protocol::ids::{ClusterId, MissionId, RobotId, RoleId};
use consort_protocol::keys::{Key, PeopleCall};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Branch;
use consort_protocol::message::{FailureKind, Live, LivePlan, Report, ReportAnswer, Said, TaskFailure};
use consort_protocol::plan::LocalPlan;
use consort_skills::actions::{ActionError, GoalId, PersonAsk};
use ractor::ActorRef;
use std::time::Duration;
use tracing::{debug, warn};

/// Which role of which mission.
pub(super) type JobKey = (MissionId, RoleId);

/// One unmanaged role of a mission under way.
pub(super) struct Job {
    pub(super) cluster: Option<ClusterId>,
    pub(super) branch: Branch,
    pub(super) plan: LocalPlan,
    pub(super) sequencer: Sequencer,
    /// What the person is at.
    pub(super) ask: Option<Asked>,
    pub(super) failure: Option<TaskFailure>,
    /// What was said under awards no longer in force, so that each is told of once.
    pub(super) outdated: OutdatedSignals,
}

impl AttendantState {
    /// Puts down what is no longer under way, takes up what is new, and goes on with the rest as the coordinator knows it.
    pub(super) async fn follow_missions(
        &mut self,
        myself: &ActorRef<AttendantMessage>,
        Live { cluster, plans, .. }: Live,
    ) -> Result<(), BusError> {
        let live: Vec<_> = plans.iter().map(key_of).collect();
        for key in self.jobs.keys().filter(|key| !live.contains(key)).cloned().collect::<Vec<_>>() {
            self.put_down(myself, &key);
        }
        for live in plans {
            self.follow_role(myself, cluster, live).await?;
        }
        Ok(())
    }

    async fn follow_role(
        &mut self,
        myself: &ActorRef<AttendantMessage>,
        cluster: Option<ClusterId>,
        live: LivePlan,
    ) -> Result<(), BusError> {
        let key = key_of(&live);
        match self.jobs.get(&key) {
            // Said by a coordinator that has yet to learn of the recovery branch.
            Some(job) if job.cluster == cluster && live.branch < job.branch => return Ok(()),
            Some(job) if (job.cluster, job.branch) != (cluster, live.branch) || job.plan != live.plan => {
                self.put_down(myself, &key);
            }
            Some(_) | None => {}
        }
        if self.jobs.contains_key(&key) {
            self.keep_up(myself, &key, &live);
        } else {
            self.take_up(myself, &key, cluster, &live).await?;
        }
        if let Some(job) = self.jobs.get_mut(&key) {
            job.sequencer.set_vacant(&live.vacant);
            job.sequencer.hear_of(&live.told);
            self.advance(myself, &key).await;
        }
        Ok(())
    }

    /// Goes on with a role of which others' parts may have changed hands.
    fn keep_up(&mut self, myself: &ActorRef<AttendantMessage>, key: &JobKey, live: &LivePlan) {
        let Some(job) = self.jobs.get_mut(key) else { return };
        job.sequencer.set_known(&live.ended);
        if *job.sequencer.holders() == live.holders {
            return;
        }
        if job.sequencer.set_holders(live.holders.clone()) {
            ask_around(&self.talk, &mut self.tasks, myself, &key.0, &job.sequencer);
        }
        // Whoever was to be met is somebody else now: ask anew.
        if let Some(asked) = job.ask.take_if(|asked| asked.is_outdated(job.sequencer.holders())) {
            job.sequencer.break_off();
            self.dismiss(myself, asked.id());
        }
    }

    /// Begins with a role; one whose plan makes no sense is left alone.
    async fn take_up(
        &mut self,
        myself: &ActorRef<AttendantMessage>,
        key: &JobKey,
        cluster: Option<ClusterId>,
        live: &LivePlan,
    ) -> Result<(), BusError> {
        let (mission, role) = key;
        let sequencer = match Sequencer::new(live.plan.clone(), &live.ended, live.holders.clone()) {
            Ok(sequencer) => sequencer,
            Err(problem) => {
                warn!(%mission, %role, %problem, "a plan that cannot be taken up");
                return Ok(());
            }
        };
        self.talk.begin(mission, role, Epoch::default(), sequencer.said().clone()).await?;
        ask_around(&self.talk, &mut self.tasks, myself, mission, &sequencer);
        let job = Job {
            cluster,
            branch: live.branch,
            plan: live.plan.clone(),
            sequencer,
            ask: None,
            failure: None,
            outdated: OutdatedSignals::new(),
        };
        self.jobs.insert(key.clone(), job);
        Ok(())
    }

    /// Another role said something.
    pub(super) async fn hear(&mut self, myself: &ActorRef<AttendantMessage>, said: &Said) {
        for signal in &said.signals {
            let key = (said.mission.clone(), signal.to.clone());
            let Some(job) = self.jobs.get_mut(&key) else { continue };
            match job.sequencer.hear(signal, said.epoch) {
                Ok(true) => self.advance(myself, &key).await,
                Ok(false) => {}
                Err(Outdated { known }) => {
                    let told = self.talk.note_outdated(&mut job.outdated, said, signal, known);
                    told.into_iter().for_each(|what| self.settings.events.tell(what));
                }
            }
        }
    }

    /// A person has done what was asked, or cannot.
    pub(super) async fn person_ended(
        &mut self,
        myself: &ActorRef<AttendantMessage>,
        id: GoalId,
        result: Result<(), ActionError>,
    ) {
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

    /// Somebody has called off what is still wanted: this attendant itself, before it knew better, or another.
    pub(super) fn ask_again(&mut self, myself: &ActorRef<AttendantMessage>, id: GoalId) {
        let mut asks = self.jobs.values_mut().filter_map(|job| job.ask.as_mut());
        let Some(asked) = asks.find(|asked| asked.id() == id) else { return };
        asked.again();
        ask_person(&self.settings, &mut self.tasks, myself, asked.id(), Some(asked.ask()));
    }

    /// The ledger knows how far a role has come in this branch, or that there is no more to do.
    pub(super) async fn reported(
        &mut self,
        myself: &ActorRef<AttendantMessage>,
        key: &JobKey,
        branch: Branch,
        answer: ReportAnswer,
    ) {
        let Some(job) = self.jobs.get_mut(key).filter(|job| job.branch == branch) else { return };
        match answer {
            ReportAnswer::Ended { .. } => self.put_down(myself, key),
            ReportAnswer::Renewed { ended, told, .. } => {
                job.sequencer.set_known(&ended);
                job.sequencer.hear_of(&told);
                self.advance(myself, key).await;
            }
            ReportAnswer::NotCoordinator { .. } => {}
        }
    }

    /// Does whatever the plan has next, until it has to wait.
    async fn advance(&mut self, myself: &ActorRef<AttendantMessage>, key: &JobKey) {
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
    pub(super) fn report(&mut self, myself: &ActorRef<AttendantMessage>, key: &JobKey) {
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

    fn put_down(&mut self, myself: &ActorRef<AttendantMessage>, key: &JobKey) {
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

fn key_of(live: &LivePlan) -> JobKey {
    (live.mission.clone(), live.plan.role.clone())
}

/// Asks those from whom something is awaited what they have said.
pub(super) fn ask_around(
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

/// Asks for a thing, or calls it off.
pub(super) fn ask_person(
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
