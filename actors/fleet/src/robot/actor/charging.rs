//! The robot actor charges: it performs the decisions of [`ChargeControl`].

use super::state::RobotState;
use crate::charger_users::charger_users;
use crate::robot::charging::{ChargeControl, OtherRobot, Situation};
use crate::robot::skill_runner::SkillOutcome;
use consort_gossip::SharedKnowledge;
use consort_protocol::chargers::ChargerUser;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::knowledge::Availability;
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::NodeTime;
use ractor::{ActorId, ActorProcessingErr};
use tracing::{debug, info, warn};

impl RobotState {
    /// Decides whether the free robot charges, and performs the next task of that.
    pub(super) async fn charge(&mut self, now: NodeTime) -> Result<(), ActorProcessingErr> {
        if self.charging.is_none() || !self.orders.may_act_alone(now) {
            return Ok(());
        }
        let is_free = self.driver.worker().availability == Availability::Free && self.driver.telemetry().is_some();
        if !is_free || self.orders.reason_to_stay(now).is_some() {
            self.stop_charging();
            return Ok(());
        }
        let context = self.driver.estimate_context();
        let has_coordinator = self.lease.has_coordinator(now);
        let Some(control) = &mut self.charging else { return Ok(()) };
        control.set_has_coordinator(has_coordinator);
        let (robot, estimator) = (&self.settings.robot, &self.settings.pricing.estimator);
        let worker = self.driver.worker();
        let (place, battery) = (&worker.place, worker.battery);
        let no_current = control.check_current(battery, now);
        let lacked_charge = control.lacks_charge();
        let alone = Situation { robot, place, battery, lacked_charge, others: &[], now };
        let others = match control.depends_on_others(&alone) {
            true => other_robots(&self.settings.links.knowledge, robot),
            false => vec![],
        };
        let was_acting = control.is_acting();
        let changed =
            control.decide(&Situation { others: &others, ..alone }, estimator, &context) || no_current.is_some();
        if let Some(problem) = no_current {
            warn!(%robot, %problem, "cannot charge");
        }
        if changed {
            debug!(%robot, charging = ?control.published(), battery = %battery.percent(), "charging changes");
        }
        let task = control.next_task(&others, estimator, &context, now);
        if changed {
            if was_acting {
                self.driver.stop();
            }
            self.sense(now);
        }
        self.update_permission();
        match task {
            Some(task) => self.start_charging_task(&task, now).await,
            None => {
                self.check_charging_task(now);
                Ok(())
            }
        }
    }

    /// Receives the lease of a charger, by its position in the log.
    pub(super) fn receive_charger_lease(&mut self, charger: PlaceId, lease: u64, now: NodeTime) {
        if let Some(control) = &mut self.charging {
            control.receive_lease(charger, lease);
            self.sense(now);
        }
    }

    async fn start_charging_task(&mut self, task: &TaskSpec, now: NodeTime) -> Result<(), ActorProcessingErr> {
        match self.start_own_task(task).await? {
            Ok(task) => {
                if let Some(control) = &mut self.charging {
                    control.set_running(task);
                }
            }
            Err(problem) => self.fail_charging(&problem, now),
        }
        Ok(())
    }

    fn check_charging_task(&mut self, now: NodeTime) {
        let (world, silent_for) = (self.driver.world_time(), self.driver.silent_for());
        let problem = self.charging.as_mut().and_then(|control| control.check_timer(world, silent_for));
        if let Some(problem) = problem {
            self.fail_charging(&problem, now);
        }
    }

    /// Handles the end of a skill. Returns the outcome if the skill was not for charging.
    pub(super) fn end_charging_task(&mut self, run: u64, outcome: SkillOutcome) -> Option<SkillOutcome> {
        let ended = self.charging.as_mut().and_then(|control| control.take_task(run));
        if ended.is_none() {
            return Some(outcome);
        }
        let now = self.now();
        match outcome {
            SkillOutcome::Succeeded(_) => {
                self.charging.iter_mut().for_each(ChargeControl::task_succeeded);
                info!(robot = %self.settings.robot, "a task of charging has ended");
                self.sense(now);
                self.update_permission();
            }
            SkillOutcome::Failed { cause, .. } => self.fail_charging(&cause, now),
        }
        None
    }

    /// Handles the crash of a skill. Returns true if the skill was for charging.
    pub(super) fn crash_charging_task(&mut self, actor: ActorId, problem: &str) -> bool {
        let crashed = self.charging.as_mut().and_then(|control| control.take_task_of(actor)).is_some();
        if crashed {
            self.fail_charging(problem, self.now());
        }
        crashed
    }

    fn fail_charging(&mut self, problem: &str, now: NodeTime) {
        warn!(robot = %self.settings.robot, problem, "cannot charge");
        self.charging.iter_mut().for_each(|control| control.task_failed(now));
        self.driver.stop();
        self.update_permission();
        self.sense(now);
    }

    /// Ends charging: the robot has a role, or is out of service.
    pub(super) fn stop_charging(&mut self) {
        if self.charging.as_mut().is_some_and(ChargeControl::stop) {
            self.driver.stop();
            self.update_permission();
        }
    }
}

/// Returns the other robots. A robot that is down stands where it was, and claims no charger.
fn other_robots(knowledge: &SharedKnowledge, own: &RobotId) -> Vec<OtherRobot> {
    let others = charger_users(knowledge, &own.clone().into()).into_iter().filter(|user| user.robot != *own);
    others.map(|ChargerUser { robot, place, charging, .. }| OtherRobot { robot, place, charging }).collect()
}
