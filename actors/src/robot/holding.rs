//! Holding a role: awards, reports and their answers, putting down, leaving.

use super::actor::{RobotMessage, RobotState};
use super::job::Job;
use super::ladder::{Ladder, Setback};
use super::pen::{Pen, Telling};
use super::sequencer::Sequencer;
use super::talk::OutdatedSignals;
use crate::answer;
use crate::bus::{BusError, Query, SharedBus};
use crate::tasks::Tasks;
use bytes::Bytes;
use consort_protocol::codec;
use consort_protocol::event::Happening;
use consort_protocol::keys::Key;
use consort_protocol::lease::{Action, Award, Declined, Ending, Epoch, Event};
use consort_protocol::ledger::Branch;
use consort_protocol::message::{AwardAnswer, AwardNotice, FailureKind, Report, ReportAnswer, TaskFailure};
use consort_protocol::plan::StepIndex;
use consort_protocol::units::NodeTime;
use consort_skills::actions::RobotActions;
use ractor::{ActorProcessingErr, ActorRef, RpcReplyPort};
use std::collections::BTreeSet;
use std::time::Duration;
use tracing::{debug, info, warn};

impl RobotState {
    pub(super) async fn notice(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        query: &Query,
    ) -> Result<(), ActorProcessingErr> {
        let Some(notice) = answer::read::<AwardNotice>(query).await else { return Ok(()) };
        let now = self.settings.clock.now();
        let (said, event) = match notice {
            AwardNotice::Awarded(_) if self.leaving.is_some() => (AwardAnswer::Declined(Declined::Leaving), None),
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

    pub(super) async fn reported(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        sent: NodeTime,
        answer: Option<ReportAnswer>,
    ) -> Result<(), ActorProcessingErr> {
        self.reporting = false;
        let now = self.settings.clock.now();
        let actions = match answer {
            Some(ReportAnswer::Renewed { epoch, ended, holders, told }) => {
                if let Some(job) = self.job.as_mut().filter(|job| job.award.epoch == epoch) {
                    job.sequencer.set_known(&ended);
                    let changed = job.sequencer.set_holders(holders.clone());
                    job.sequencer.hear_of(&told);
                    if changed {
                        self.ask(myself);
                    }
                }
                self.heard_holders = Some((epoch, holders));
                self.tenure.handle(Event::Renewed { epoch, sent, ended }, now)
            }
            Some(ReportAnswer::Ended { epoch, reason: Ending::Over, .. }) => {
                // Nobody takes over: what the ledger counts as said is said now, whether or not the disk has it.
                let job = self.job.as_mut().filter(|job| job.award.epoch == epoch);
                let untold = job.map(|job| std::mem::take(&mut job.pen).abandon());
                self.speak(untold.unwrap_or_default()).await;
                self.put_down(epoch, Ending::Over);
                self.tenure.handle(Event::Settled { epoch }, now)
            }
            Some(ReportAnswer::Ended { epoch, reason, .. }) => {
                self.tenure.handle(Event::Revoked { epoch, reason }, now)
            }
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

    pub(super) async fn perform(
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
                    let held = self.job.as_ref().map(|job| job.award.epoch);
                    let recalled = self.recalled.as_ref().map(|page| page.award.epoch);
                    if let Some(epoch) = held.or(recalled) {
                        self.put_down(epoch, reason);
                    }
                }
            }
        }
        if self.tenure.award().is_none() {
            self.answer_leave(true);
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
        let Award { mission, role, epoch, plan, .. } = award.clone();
        let holders = self.heard_holders.take().filter(|(of, _)| *of == epoch);
        let holders = holders.map_or_else(|| award.holders.clone(), |(_, holders)| holders);
        let recalled = self.recalled.take().filter(|page| page.award.epoch == epoch);
        info!(robot = %self.settings.robot, %mission, %role, %epoch, resumes = recalled.is_some(), "begins");
        let begins = match recalled.is_some() {
            true => Happening::Resumed { mission: mission.clone(), role: role.clone() },
            false => Happening::Started { mission: mission.clone(), role: role.clone(), epoch },
        };
        let up_to_date = recalled.as_ref().filter(|page| !page.lacks_a_task(ended));
        let first_goal = up_to_date.map_or_else(|| self.settings.body.next_goal(), |page| page.first_goal);
        let on_record = recalled.is_some();
        let (own, detours) = recalled.map(|page| (page.ended, page.detours)).unwrap_or_default();
        let taken_up = Sequencer::resume(plan.clone(), ended, &own, detours, holders.clone());
        let failure = taken_up.as_ref().err().map(|problem| TaskFailure {
            task: None,
            cause: problem.to_string(),
            kind: FailureKind::Plan,
        });
        let Ok(sequencer) = taken_up.or_else(|_| Sequencer::new(plan, &BTreeSet::new(), holders)) else {
            return Ok(());
        };
        let mut hearing = Tasks::default();
        let signals = self.settings.keys.write(&Key::Signal(mission.clone(), role.clone()));
        hearing.forward(self.settings.bus.subscribe(&signals).await?, myself, RobotMessage::Signal);
        self.talk.begin(&mission, &role, epoch, sequencer.said().clone()).await?;
        self.tell(begins);
        let mut pen = Pen::default();
        pen.soil();
        self.job = Some(Job {
            award,
            sequencer,
            ladder: Ladder::default(),
            pen,
            attempt: None,
            rests_until: NodeTime::ZERO,
            on_record,
            surrender: None,
            first_goal,
            told_of_charge: false,
            outdated: OutdatedSignals::new(),
            _hearing: hearing,
        });
        if let Some(failure) = failure {
            self.give_up(failure);
        }
        // Whoever spoke before this robot listened is asked.
        self.ask(myself);
        Ok(())
    }

    fn suspend(&mut self) {
        let Some(job) = self.job.as_mut() else { return };
        job.stop();
        job.sequencer.break_off();
        warn!(robot = %self.settings.robot, mission = %job.award.mission, "lease ran out: suspended");
        let (mission, role) = job.of();
        self.tell(Happening::Suspended { mission, role });
    }

    fn resume(&mut self) {
        if let Some((mission, role)) = self.job.as_ref().map(Job::of) {
            self.tell(Happening::Resumed { mission, role });
        }
    }

    /// Stops and forgets the plan held under `epoch`, or recalled from a former life. What was said in it can still be
    /// asked for.
    fn put_down(&mut self, epoch: Epoch, reason: Ending) {
        if let Some(mut job) = self.job.take_if(|job| job.award.epoch == epoch) {
            job.stop();
            self.talk.put_down(&job.award.mission, &job.award.role);
            // What has happened has happened; what was not said yet is said by whoever takes over.
            let untold = job.pen.abandon();
            let happened = untold.into_iter().filter_map(|telling| match telling {
                Telling::Event(what) => Some(what),
                Telling::Signal(_) => None,
            });
            happened.for_each(|what| self.tell(what));
            self.halted(&job.award, reason);
        }
        if let Some(page) = self.recalled.take_if(|page| page.award.epoch == epoch) {
            self.halted(&page.award, reason);
        }
    }

    fn halted(&self, award: &Award, reason: Ending) {
        info!(robot = %self.settings.robot, mission = %award.mission, ?reason, "puts its role down");
        let (mission, role) = (award.mission.clone(), award.role.clone());
        self.tell(Happening::Halted { mission, role, reason });
    }

    /// Reports to the coordinator; one report at a time, and another at once if there was news meanwhile.
    pub(super) fn report(&mut self, myself: &ActorRef<RobotMessage>) {
        let (Some(award), Some(beacon)) = (self.tenure.award(), &self.coordinator) else { return };
        if self.reporting {
            self.report_again = true;
            return;
        }
        let leaving = || TaskFailure { task: None, cause: LEAVES.to_owned(), kind: FailureKind::Leaving };
        let (at_rest, sent) = (self.settings.body.is_at_rest(), self.settings.clock.now());
        let job = self.job.as_mut().filter(|job| job.award.epoch == award.epoch);
        let failure = match job.and_then(|job| job.surrender.as_mut()) {
            Some(surrender) => surrender.tell(at_rest, sent),
            None => self.leaving.is_some().then(leaving),
        };
        let job = self.job.as_ref().filter(|job| job.award.epoch == award.epoch);
        let recalled = self.recalled.as_ref().filter(|page| page.award.epoch == award.epoch);
        let ended = job.map(|job| job.sequencer.ended()).or_else(|| recalled.map(|page| &page.ended));
        let report = Report {
            robot: self.settings.robot.clone(),
            incarnation: self.settings.incarnation,
            mission: award.mission.clone(),
            role: award.role.clone(),
            epoch: award.epoch,
            branch: Branch::default(),
            ended: ended.cloned().unwrap_or_default(),
            at: job.and_then(|job| job.sequencer.at().cloned()),
            place: self.settings.body.telemetry().map(|report| report.place.clone()),
            resumes: self.resumes == Some(award.epoch),
            failure,
        };
        let key = self.settings.keys.write(&Key::Report(beacon.node.clone()));
        self.reporting = true;
        self.reported_at = sent;
        let (bus, limit, to) = (self.settings.bus.clone(), self.settings.terms.lease / 4, myself.clone());
        self.tasks.spawn(async move {
            let answer = send_report(bus, &key, &report, limit).await;
            // A robot that has stopped needs no answer.
            let _ = to.cast(RobotMessage::Reported { sent, answer });
        });
    }

    /// Takes nothing new, and gives up what is held.
    pub(super) async fn leave(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        within: Duration,
        done: RpcReplyPort<bool>,
    ) -> Result<(), ActorProcessingErr> {
        self.leaving.get_or_insert_default().push(done);
        self.tasks.after(within, myself, RobotMessage::Overdue);
        if self.job.as_ref().is_some_and(|job| job.surrender.is_none()) {
            let (kind, cause) = (FailureKind::Leaving, LEAVES.to_owned());
            self.set_back(myself, Setback { kind, cause, lasting: true }).await?;
        }
        self.report(myself);
        self.perform(myself, vec![]).await
    }

    /// Answers those who wait for the robot to have left.
    pub(super) fn answer_leave(&mut self, free: bool) {
        for done in self.leaving.iter_mut().flat_map(std::mem::take) {
            // Whoever no longer waits needs no answer.
            let _ = done.send(free);
        }
    }
}

const LEAVES: &str = "it leaves the fleet";

/// Reports to one coordinator, and gives its answer.
pub(crate) async fn send_report(bus: SharedBus, key: &str, report: &Report, limit: Duration) -> Option<ReportAnswer> {
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
