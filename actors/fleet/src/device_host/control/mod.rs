//! A device as a value: which goal its driver has, and what its node reports.
//!
//! The driver performs two actions of the device domain. `serve` makes the device ready for a robot and keeps it ready while
//! the goal lasts; its feedback `ready` confirms. `alarm` does the same with the position of an alarm. The end of either is
//! a cancel. A driver whose node is gone stops to serve at the end of its permission, as a robot stops.

use consort_protocol::devices::{AlarmPosition, Device};
use consort_protocol::ids::{ActionName, PlaceId};
use consort_protocol::knowledge::{DeviceReport, DeviceState};
use consort_protocol::scalar::Scalar;
use consort_protocol::units::NodeTime;
use consort_skills::actions::{Goal, GoalId, GoalStatus, JsonObject};
use serde_json::Value;
use std::time::Duration;

/// Time for which a device that did not confirm counts as silent, so that robots drive other ways meanwhile. As long as a
/// robot avoids a place that it could not reach.
const FAILED_FOR: Duration = Duration::from_secs(60);

/// Time within which a driver must end a canceled goal, as the domain file of devices declares.
const CANCELED_WITHIN: Duration = Duration::from_secs(60);

/// Time for which a robot must lack its claim before the device closes behind it. Raised: doors stay open for longer. The first
/// record of a robot whose node has restarted between two places lacks the claim.
const UNCLAIMED_FOR: Duration = Duration::from_secs(5);

/// Name of the feedback with which a driver confirms.
const READY: &str = "ready";

/// Lease of a robot, and the guarded place at which it needs the device.
pub(super) type Served = (u64, Option<PlaceId>);

/// What a goal is for.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Purpose {
    /// A robot with this lease, at this guarded place.
    Serve(Served),
    /// An alarm.
    Alarm,
}

/// Goal of the driver.
#[derive(Debug)]
struct RunningGoal {
    id: GoalId,
    purpose: Purpose,
    /// Time since which it is not confirmed.
    unconfirmed_since: NodeTime,
    /// Time at which a robot last claimed its lease.
    claimed_at: NodeTime,
    /// Time of the cancel. What its driver has confirmed before no longer counts.
    canceled_at: Option<NodeTime>,
}

/// What a step depends on.
#[derive(Debug, Clone, Default)]
pub(super) struct HostInput {
    /// Latest lease that a robot claims, with the place.
    pub(super) claim: Option<Served>,
    /// True if the robot with the lease is down.
    pub(super) is_robot_lost: bool,
    /// True during an alarm.
    pub(super) is_alarm: bool,
    /// True if the driver responds.
    pub(super) responds: bool,
    /// Status of the goal.
    pub(super) status: Option<GoalStatus>,
}

/// Action for the driver.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum HostAction {
    /// Start a goal.
    Start(GoalId, Goal),
    /// Extend the permission of the goal.
    Permit(GoalId),
    /// Cancel a goal.
    Cancel(GoalId),
}

/// A device and its driver.
pub(super) struct DeviceControl {
    device: Device,
    next_goal: u64,
    goal: Option<RunningGoal>,
    /// Latest lease whose robot may have entered: the device has confirmed it.
    confirmed: Option<u64>,
    /// True from the loss of the robot with the lease until it returns, or until the driver has ended the goal.
    is_blocked: bool,
    silent_since: Option<NodeTime>,
    failed_until: Option<NodeTime>,
}

impl DeviceControl {
    pub(super) fn new(device: Device, first_goal: u64) -> DeviceControl {
        DeviceControl {
            device,
            next_goal: first_goal,
            goal: None,
            confirmed: None,
            is_blocked: false,
            silent_since: None,
            failed_until: None,
        }
    }

    /// Returns the goal whose status the next step needs.
    pub(super) fn goal(&self) -> Option<GoalId> {
        self.goal.as_ref().map(|goal| goal.id)
    }

    /// Returns the actions for the driver, and the report.
    pub(super) fn step(&mut self, input: &HostInput, now: NodeTime) -> (Vec<HostAction>, DeviceReport) {
        match input.responds {
            true => self.silent_since = None,
            false => _ = self.silent_since.get_or_insert(now),
        }
        self.failed_until.take_if(|until| *until <= now);
        if input.responds && input.status.is_none() {
            self.goal = None; // the driver has not received it, or has forgotten it
        }
        if input.status.as_ref().is_some_and(GoalStatus::is_final) {
            let was_canceled = matches!(input.status, Some(GoalStatus::Canceled));
            self.goal = None;
            if !was_canceled {
                self.failed_until = Some(now + FAILED_FOR);
            }
        }
        let claimed = input.claim.clone().map(Purpose::Serve);
        if let Some(goal) = self.goal.as_mut().filter(|goal| claimed.as_ref() == Some(&goal.purpose)) {
            goal.claimed_at = now;
        }
        let is_serving_other =
            |goal: &RunningGoal| goal.purpose != Purpose::Alarm && claimed.as_ref() != Some(&goal.purpose);
        self.is_blocked = input.is_robot_lost || self.is_blocked && self.goal.as_ref().is_some_and(is_serving_other);
        let is_canceled = self.goal.as_ref().is_some_and(|goal| goal.canceled_at.is_some());
        let is_ready = input.responds && !is_canceled && is_confirmed(input.status.as_ref());
        if let Some(RunningGoal { purpose: Purpose::Serve((lease, _)), .. }) = self.goal.as_ref().filter(|_| is_ready) {
            self.confirmed = Some(*lease);
        }
        let wanted = self.wanted(claimed, input.is_alarm, now);
        let mut actions = vec![];
        match (&mut self.goal, wanted.clone()) {
            (Some(goal), Some(purpose)) if goal.purpose == purpose && !is_canceled => {
                if is_ready {
                    goal.unconfirmed_since = now;
                }
                if now.since(goal.unconfirmed_since) >= self.device.silent_after {
                    self.failed_until = Some(now + FAILED_FOR);
                }
                actions.push(HostAction::Permit(goal.id));
            }
            (Some(goal), _) => {
                if now.since(*goal.canceled_at.get_or_insert(now)) >= CANCELED_WITHIN {
                    self.failed_until = Some(now + FAILED_FOR);
                }
                actions.push(HostAction::Cancel(goal.id));
            }
            (None, Some(purpose)) if self.failed_until.is_none() => {
                let id = GoalId(self.next_goal);
                self.next_goal += 1;
                actions.push(HostAction::Start(id, self.goal_of(&purpose)));
                self.goal =
                    Some(RunningGoal { id, purpose, unconfirmed_since: now, claimed_at: now, canceled_at: None });
            }
            (None, _) => {}
        }
        (actions, self.report(wanted.as_ref(), is_ready, now))
    }

    /// Returns the purpose of the goal that the driver should have. A robot that may be inside leaves before the alarm counts.
    fn wanted(&self, claimed: Option<Purpose>, is_alarm: bool, now: NodeTime) -> Option<Purpose> {
        let is_serving =
            |goal: &&RunningGoal| goal.purpose != Purpose::Alarm && now.since(goal.claimed_at) < UNCLAIMED_FOR;
        let serving = || self.goal.as_ref().filter(is_serving).map(|goal| goal.purpose.clone());
        let serve = claimed.or_else(serving);
        let is_served = matches!(&serve, Some(Purpose::Serve((lease, _))) if self.confirmed == Some(*lease));
        if is_alarm && !is_served { Some(Purpose::Alarm) } else { serve }
    }

    fn goal_of(&self, purpose: &Purpose) -> Goal {
        let (action, parameters) = match purpose {
            Purpose::Serve((_, place)) => {
                let place = place.iter().map(|place| ("place".to_owned(), Value::from(place.as_str())));
                ("serve", place.collect())
            }
            Purpose::Alarm => {
                let position = match self.device.in_alarm {
                    AlarmPosition::Open => "open",
                    AlarmPosition::Closed => "closed",
                    AlarmPosition::OutOfUse => "out_of_use",
                };
                ("alarm", JsonObject::from_iter([("position".to_owned(), Value::from(position))]))
            }
        };
        let action = ActionName::new(action).expect("the name of an action is a slug");
        Goal { action, parameters, repeatable: true, hands_over: Some(false), since: None }
    }

    fn report(&self, wanted: Option<&Purpose>, is_ready: bool, now: NodeTime) -> DeviceReport {
        let is_silent = self.silent_since.is_some_and(|since| now.since(since) >= self.device.silent_after);
        let goal = self.goal.as_ref().map(|goal| &goal.purpose);
        let is_wanted = goal == wanted;
        // A robot with the lease may be inside, also while the driver is silent, or has failed.
        let served = match (goal, wanted) {
            (Some(Purpose::Serve(served)), _) => Some(served.clone()),
            (None, Some(Purpose::Serve(served))) if self.confirmed == Some(served.0) => Some(served.clone()),
            _ => None,
        };
        let state = match goal {
            _ if is_silent || self.failed_until.is_some() => DeviceState::Silent,
            _ if self.is_blocked => DeviceState::Blocked,
            Some(Purpose::Serve(_)) if is_ready && is_wanted => DeviceState::Ready,
            Some(Purpose::Alarm) if is_ready && is_wanted => DeviceState::Alarm,
            Some(_) => DeviceState::Preparing,
            None => DeviceState::Idle,
        };
        let (lease, place) = served.map_or((None, None), |(lease, place)| (Some(lease), place));
        DeviceReport { state, lease, place }
    }
}

/// Checks whether the driver confirms a goal.
fn is_confirmed(status: Option<&GoalStatus>) -> bool {
    matches!(status, Some(GoalStatus::Executing(feedback)) if feedback.values.get(READY) == Some(&Scalar::Bool(true)))
}

#[cfg(test)]
mod tests;
