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
        Goal { action, parameters, repeatable: true, hands_over: Some(false) }
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
mod tests {
    use super::*;
    use consort_protocol::devices::DeviceKind;
    use consort_protocol::units::{Metres, Seconds};
    use consort_skills::actions::{ActionError, ErrorCode, Feedback};
    use std::collections::{BTreeMap, BTreeSet};

    fn at(ms: u64) -> NodeTime {
        NodeTime::at(Duration::from_millis(ms))
    }

    fn control() -> DeviceControl {
        let device = Device {
            name: "door".parse().unwrap(),
            kind: DeviceKind::Door,
            host: "station".parse().unwrap(),
            lanes: BTreeSet::new(),
            places: BTreeSet::new(),
            silent_after: Duration::from_secs(5),
            in_alarm: AlarmPosition::Closed,
        };
        DeviceControl::new(device, 100)
    }

    fn input(lease: Option<u64>, is_ready: Option<bool>) -> HostInput {
        let feedback = |is_ready| Feedback {
            values: BTreeMap::from([(READY.to_owned(), Scalar::Bool(is_ready))]),
            ..Feedback::remaining(Metres::ZERO, Seconds::ZERO)
        };
        let status = is_ready.map(|is_ready| GoalStatus::Executing(feedback(is_ready)));
        let claim = lease.map(|lease| (lease, None));
        HostInput { claim, is_robot_lost: false, is_alarm: false, responds: true, status }
    }

    #[test]
    fn a_device_serves_the_latest_lease_and_confirms_it() {
        let mut control = control();
        assert_eq!(
            control.step(&input(None, None), at(0)).1,
            DeviceReport { state: DeviceState::Idle, lease: None, place: None }
        );
        let (actions, report) = control.step(&input(Some(7), None), at(100));
        assert!(matches!(&actions[..], [HostAction::Start(GoalId(100), goal)] if goal.action.as_str() == "serve"));
        assert_eq!(report, DeviceReport { state: DeviceState::Preparing, lease: Some(7), place: None });
        assert_eq!(control.step(&input(Some(7), Some(false)), at(200)).1.state, DeviceState::Preparing);
        let (actions, report) = control.step(&input(Some(7), Some(true)), at(300));
        assert_eq!((actions, report.state), (vec![HostAction::Permit(GoalId(100))], DeviceState::Ready));
        let (actions, report) = control.step(&input(Some(9), Some(true)), at(400));
        assert_eq!(actions, [HostAction::Cancel(GoalId(100))], "it closes before it opens for another robot");
        assert_eq!(report, DeviceReport { state: DeviceState::Preparing, lease: Some(7), place: None });
        let canceled = HostInput { status: Some(GoalStatus::Canceled), ..input(Some(9), None) };
        assert!(matches!(&control.step(&canceled, at(500)).0[..], [HostAction::Start(GoalId(101), _)]));
    }

    #[test]
    fn a_lift_is_asked_for_the_stop_that_the_robot_needs() {
        let (mut control, place) = (control(), "L1".parse::<PlaceId>().unwrap());
        let (actions, report) =
            control.step(&HostInput { claim: Some((7, Some(place.clone()))), ..input(None, None) }, at(0));
        let [HostAction::Start(_, goal)] = &actions[..] else { panic!("{actions:?}") };
        assert_eq!((&goal.parameters["place"], report.place), (&Value::from("L1"), Some(place)));
        let next = HostInput { claim: Some((7, Some("L2".parse().unwrap()))), ..input(None, Some(true)) };
        let alarm = HostInput { is_alarm: true, ..next };
        assert_eq!(control.step(&alarm, at(100)).0, [HostAction::Cancel(GoalId(100))]);
        let canceled = HostInput { status: Some(GoalStatus::Canceled), ..alarm };
        let (actions, _) = control.step(&canceled, at(200));
        let [HostAction::Start(_, goal)] = &actions[..] else { panic!("{actions:?}") };
        assert_eq!(goal.parameters["place"], Value::from("L2"), "the robot inside leaves before the alarm counts");
    }

    #[test]
    fn a_canceled_goal_confirms_nothing_and_must_end() {
        let mut control = control();
        let at_stop = |name: &str| HostInput { claim: Some((7, name.parse().ok())), ..input(None, Some(true)) };
        control.step(&HostInput { status: None, ..at_stop("L0") }, at(0));
        assert_eq!(control.step(&at_stop("L0"), at(200)).1.state, DeviceState::Ready);
        assert_eq!(control.step(&at_stop("L1"), at(400)).0, [HostAction::Cancel(GoalId(100))]);
        let (actions, report) = control.step(&at_stop("L0"), at(600));
        assert_eq!((actions, report.state), (vec![HostAction::Cancel(GoalId(100))], DeviceState::Preparing));
        assert_eq!(control.step(&at_stop("L0"), at(60_399)).1.state, DeviceState::Preparing);
        assert_eq!(control.step(&at_stop("L0"), at(60_400)).1.state, DeviceState::Silent);
    }

    #[test]
    fn a_driver_that_is_silent_or_does_not_confirm_is_reported() {
        let mut away = control();
        let silent = HostInput { responds: false, ..HostInput::default() };
        assert_eq!(away.step(&silent, at(0)).1.state, DeviceState::Idle);
        assert_eq!(away.step(&silent, at(5_000)).1.state, DeviceState::Silent);
        assert_eq!(away.step(&input(None, None), at(5_100)).1.state, DeviceState::Idle);
        let mut stuck = control();
        stuck.step(&input(Some(7), None), at(0));
        assert_eq!(stuck.step(&input(Some(7), Some(false)), at(4_999)).1.state, DeviceState::Preparing);
        assert_eq!(stuck.step(&input(Some(7), Some(false)), at(5_000)).1.state, DeviceState::Silent);
        assert_eq!(stuck.step(&input(None, Some(false)), at(9_999)).0, [HostAction::Permit(GoalId(100))]);
        assert_eq!(stuck.step(&input(None, Some(false)), at(10_000)).0, [HostAction::Cancel(GoalId(100))]);
        let canceled = HostInput { status: Some(GoalStatus::Canceled), ..input(None, None) };
        assert_eq!(stuck.step(&canceled, at(11_000)).1.state, DeviceState::Silent, "for a while");
        assert_eq!(stuck.step(&input(None, None), at(75_000)).1.state, DeviceState::Idle);
    }

    #[test]
    fn a_device_that_fails_with_a_robot_inside_reports_its_lease() {
        let mut control = control();
        control.step(&input(Some(7), None), at(0));
        control.step(&input(Some(7), Some(true)), at(100));
        let jammed = ActionError::rejected(ErrorCode::Unknown, "the door is jammed".to_owned());
        let aborted = HostInput { status: Some(GoalStatus::Aborted(jammed)), ..input(Some(7), None) };
        let inside = DeviceReport { state: DeviceState::Silent, lease: Some(7), place: None };
        assert_eq!(control.step(&aborted, at(200)), (vec![], inside.clone()));
        assert_eq!(control.step(&input(Some(7), None), at(400)).1, inside);
        assert_eq!(control.step(&input(None, None), at(600)).1.lease, None, "the robot has left");
    }

    #[test]
    fn a_device_with_a_lost_robot_is_blocked_until_it_is_safe_or_the_robot_returns() {
        let lost = |input: HostInput| HostInput { is_robot_lost: true, ..input };
        for returns in [true, false] {
            let mut control = control();
            control.step(&input(Some(7), None), at(0));
            assert_eq!(control.step(&input(Some(7), Some(true)), at(100)).1.state, DeviceState::Ready);
            let (actions, report) = control.step(&lost(input(Some(7), Some(true))), at(200));
            assert_eq!(actions, [HostAction::Permit(GoalId(100))], "it stays open");
            assert_eq!(report, DeviceReport { state: DeviceState::Blocked, lease: Some(7), place: None });
            if returns {
                assert_eq!(control.step(&input(Some(7), Some(true)), at(300)).1.state, DeviceState::Ready);
                continue;
            }
            // A person ends the lease.
            assert_eq!(control.step(&input(None, Some(true)), at(400)).1.state, DeviceState::Blocked);
            assert_eq!(control.step(&input(None, Some(true)), at(5_300)).0, [HostAction::Cancel(GoalId(100))]);
            assert_eq!(control.step(&input(Some(9), Some(false)), at(6_000)).1.state, DeviceState::Blocked);
            let canceled = HostInput { status: Some(GoalStatus::Canceled), ..input(None, None) };
            assert_eq!(control.step(&canceled, at(7_000)).1.state, DeviceState::Idle, "the driver has closed it");
        }
        // The node of the device has restarted.
        let mut control = control();
        assert_eq!(control.step(&lost(input(None, None)), at(0)).1.state, DeviceState::Blocked);
        assert_eq!(control.step(&input(None, None), at(100)).1.state, DeviceState::Idle);
    }

    #[test]
    fn an_alarm_counts_once_the_served_robot_has_left() {
        let mut control = control();
        let alarm = |input: HostInput| HostInput { is_alarm: true, ..input };
        control.step(&input(Some(7), None), at(0));
        assert_eq!(control.step(&alarm(input(Some(7), Some(true))), at(100)).1.state, DeviceState::Ready);
        let (actions, report) = control.step(&alarm(input(None, Some(true))), at(5_000));
        assert_eq!(
            (actions, report.state),
            (vec![HostAction::Permit(GoalId(100))], DeviceState::Ready),
            "it may return"
        );
        assert_eq!(control.step(&alarm(input(None, Some(true))), at(5_100)).0, [HostAction::Cancel(GoalId(100))]);
        let canceled = HostInput { status: Some(GoalStatus::Canceled), ..input(Some(8), None) };
        let (actions, _) = control.step(&alarm(canceled), at(5_300));
        let [HostAction::Start(_, goal)] = &actions[..] else { panic!("{actions:?}") };
        assert_eq!((goal.action.as_str(), &goal.parameters["position"]), ("alarm", &Value::from("closed")));
        assert_eq!(control.step(&alarm(input(Some(8), Some(true))), at(5_400)).1.state, DeviceState::Alarm);
    }
}
