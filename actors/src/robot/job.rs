//! The plan under way, as the robot holds it in its hands.

use super::ladder::Ladder;
use super::page::Page;
use super::patience::Stopwatch;
use super::pen::Pen;
use super::sequencer::{Sequencer, Spot};
use super::skill_runner::RunnerMessage;
use super::surrender::Surrender;
use super::talk::OutdatedSignals;
use crate::tasks::Tasks;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::lease::Award;
use consort_protocol::units::NodeTime;
use consort_skills::actions::GoalId;
use ractor::ActorRef;

/// The plan under way.
pub(super) struct Job {
    pub(super) award: Award,
    pub(super) sequencer: Sequencer,
    pub(super) ladder: Ladder,
    pub(super) pen: Pen,
    /// The task that is being done.
    pub(super) attempt: Option<Attempt>,
    /// Nothing is begun before: the robot stands still between two attempts.
    pub(super) rests_until: NodeTime,
    /// Whether the notebook has a page of this award: without one nothing is begun.
    pub(super) on_record: bool,
    /// Why the role cannot be carried to its end; from then on the robot only waits to put it down.
    pub(super) surrender: Option<Surrender>,
    /// The first goal of the body that belongs to the task under way, or to the next.
    pub(super) first_goal: GoalId,
    /// Whether it was told that the battery falls short.
    pub(super) told_of_charge: bool,
    /// What was said under awards no longer in force, so that each is told of once.
    pub(super) outdated: OutdatedSignals,
    pub(super) _hearing: Tasks,
}

/// A skill at work.
pub(super) struct Attempt {
    /// Which start of a skill it is.
    pub(super) run: u64,
    pub(super) spot: Spot,
    pub(super) runner: ActorRef<RunnerMessage>,
    pub(super) watch: Stopwatch,
}

impl Job {
    pub(super) fn of(&self) -> (MissionId, RoleId) {
        (self.award.mission.clone(), self.award.role.clone())
    }

    pub(super) fn page(&self) -> Page {
        let (ended, detours) = (self.sequencer.ended().clone(), self.sequencer.detours().clone());
        Page { award: self.award.clone(), ended, detours, first_goal: self.first_goal }
    }

    /// Stops the body safely, if it is at work.
    pub(super) fn stop(&mut self) {
        if let Some(attempt) = self.attempt.take() {
            // One that has just ended by itself needs no halting.
            let _ = attempt.runner.cast(RunnerMessage::Halt);
        }
    }
}
