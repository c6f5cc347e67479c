//! The robot actor obeys alarms: it drives to an assembly place, and back to its plan after the alarm.

use super::state::RobotState;
use crate::robot::active_plan::ActivePlan;
use crate::robot::alarm_drive::AlarmDestination;
use crate::robot::own_tasks::drive_to;
use crate::robot::skill_runner::SkillOutcome;
use consort_protocol::ids::PlaceId;
use consort_protocol::units::NodeTime;
use ractor::{ActorId, ActorProcessingErr};
use std::collections::BTreeSet;
use tracing::{info, warn};

impl RobotState {
    /// Drives to an assembly place if an alarm demands it.
    pub(super) async fn obey_alarm(&mut self, now: NodeTime) -> Result<(), ActorProcessingErr> {
        self.end_obsolete_drive(now);
        let (world, silent_for) = (self.driver.world_time(), self.driver.silent_for());
        if let Some(problem) = self.alarm_drive.check_timer(world, silent_for) {
            self.fail_alarm_drive(&problem, now);
        }
        if self.alarm_drive.is_driving() {
            self.update_permission();
        }
        let Some(places) = self.assembly_places(now).cloned() else {
            self.alarm_drive.end_assembly();
            return Ok(());
        };
        let (estimator, context) = (&self.settings.pricing.estimator, self.driver.estimate_context());
        let Some(place) = self.alarm_drive.next_place(&places, estimator, &context, now) else { return Ok(()) };
        if let (Some(active), Some(left)) = (self.execution.continuing_plan(), self.driver.place()) {
            active.leave(left);
            self.write_checkpoint();
        }
        self.start_alarm_drive(AlarmDestination::Assembly(place), now).await
    }

    /// Starts a drive because of an alarm.
    pub(super) async fn start_alarm_drive(
        &mut self,
        to: AlarmDestination,
        now: NodeTime,
    ) -> Result<(), ActorProcessingErr> {
        info!(robot = %self.settings.robot, ?to, "drives because of an alarm");
        let task = drive_to(to.place());
        self.alarm_drive.begin(to);
        match self.start_own_task(&task).await? {
            Ok(task) => {
                self.alarm_drive.set_running(task);
                self.update_permission();
            }
            Err(problem) => self.fail_alarm_drive(&problem, now),
        }
        Ok(())
    }

    /// Ends a drive to a place where the robot is no longer expected.
    pub(super) fn end_obsolete_drive(&mut self, now: NodeTime) {
        let may_return = self.lease.may_act(now) && !self.orders.is_held(now);
        let active = self.execution.plan.as_ref().filter(|active| may_return && !active.is_releasing());
        let back = active.and_then(ActivePlan::place_left);
        if self.alarm_drive.is_obsolete(self.assembly_places(now), back) {
            self.alarm_drive.stop();
            self.driver.stop();
        }
    }

    /// Returns the places to one of which the robot has to drive now. A robot with a role drives as long as its lease
    /// lasts.
    fn assembly_places(&self, now: NodeTime) -> Option<&BTreeSet<PlaceId>> {
        let may_drive = match self.lease.award() {
            Some(_) => {
                let active = self.execution.plan.as_ref();
                self.lease.may_act(now) && active.is_some_and(|active| !active.is_releasing())
            }
            // People may be at work at a robot in maintenance.
            None => !self.orders.is_in_maintenance(now),
        };
        self.orders.assembly_places(now).filter(|_| may_drive && self.driver.telemetry().is_some())
    }

    /// Handles the end of a skill. Returns the outcome if the skill was no drive because of an alarm.
    pub(super) fn end_alarm_drive(&mut self, run: u64, outcome: SkillOutcome) -> Option<SkillOutcome> {
        if !self.alarm_drive.is_run(run) {
            return Some(outcome);
        }
        match outcome {
            SkillOutcome::Succeeded(_) => {
                let to = self.alarm_drive.succeed();
                info!(robot = %self.settings.robot, ?to, "has arrived because of an alarm");
                if let (Some(AlarmDestination::Return(_)), Some(active)) = (to, &mut self.execution.plan) {
                    active.set_returned();
                }
                self.update_permission();
            }
            SkillOutcome::Failed { cause, .. } => self.fail_alarm_drive(&cause, self.now()),
        }
        None
    }

    /// Handles the crash of a skill. Returns true if the skill was a drive because of an alarm.
    pub(super) fn crash_alarm_drive(&mut self, actor: ActorId, problem: &str) -> bool {
        let crashed = self.alarm_drive.is_executed_by(actor);
        if crashed {
            self.fail_alarm_drive(problem, self.now());
        }
        crashed
    }

    fn fail_alarm_drive(&mut self, problem: &str, now: NodeTime) {
        warn!(robot = %self.settings.robot, problem, "drive because of an alarm failed");
        self.alarm_drive.fail(now);
        self.driver.stop();
        self.update_permission();
    }
}
