//! The goals that a driver server tracks, as a value: which commands start and cancel a goal, and
//! when a robot must stop.

use super::messages::{DriverCommand, GoalRequest, Permit};
use super::state_order::StateStamp;
use consort_protocol::ids::RobotId;
use consort_protocol::lease::stop_at;
use consort_protocol::units::NodeTime;
use consort_skills::actions::{Goal, GoalId};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Number of latest goals per robot in a published state.
const GOALS_PUBLISHED: usize = 8;

/// Time for which the send times of states are kept. A client that has received no state for so long
/// does not know what its robot does.
const STATES_KEPT: Duration = Duration::from_secs(10);

/// Latest goals of the robots of a driver server.
#[derive(Debug, Clone)]
pub(super) struct GoalTable {
    client_timeout: Duration,
    robots: BTreeMap<RobotId, VecDeque<TrackedGoal>>,
    /// Send times of the latest states.
    sent_states: VecDeque<(StateStamp, NodeTime)>,
    /// Instant of the earliest scheduled wake-up.
    next_wake: Option<NodeTime>,
}

#[derive(Debug, Clone)]
struct TrackedGoal {
    id: GoalId,
    /// The robot stops at this time; `None` for a goal that has ended or was stopped.
    stop_at: Option<NodeTime>,
}

/// Effect of a command on the robot.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum CommandEffect {
    /// Start this goal.
    Start(GoalId, Goal),
    /// Cancel this goal.
    Cancel(GoalId),
    /// No goal starts or ends.
    None,
}

/// A command was refused. Nothing was changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum CommandError {
    #[error("no driver of {robot} here; available: {available}")]
    UnknownRobot { robot: RobotId, available: String },
    #[error(
        "goal {} of {robot} is not started: its permission of {keep_for_ms} ms after state {} has run out, or \
         the state is not known here; repeat the command with a later state", goal.0, state.sequence
    )]
    NotPermitted { robot: RobotId, goal: GoalId, state: StateStamp, keep_for_ms: u64 },
}

impl GoalTable {
    pub(super) fn new(client_timeout: Duration) -> GoalTable {
        GoalTable { client_timeout, robots: BTreeMap::new(), sent_states: VecDeque::new(), next_wake: None }
    }

    /// Adds a robot. It may still execute goals that clients sent to a previous server; they continue
    /// for the client timeout.
    pub(super) fn add_robot(&mut self, robot: RobotId, goals: Vec<GoalId>, now: NodeTime) {
        let (stop_at, tracked) = (Some(now + self.client_timeout), self.robots.entry(robot).or_default());
        goals.into_iter().for_each(|id| track(tracked, TrackedGoal { id, stop_at }));
    }

    /// Returns the robots.
    pub(super) fn robots(&self) -> impl Iterator<Item = &RobotId> {
        self.robots.keys()
    }

    /// Returns the latest goals of a robot, in the order of their commands.
    pub(super) fn goals(&self, robot: &RobotId) -> Option<impl Iterator<Item = GoalId>> {
        self.robots.get(robot).map(|goals| goals.iter().map(|goal| goal.id))
    }

    /// Returns the goals of a robot with the times at which the robot stops.
    pub(super) fn stop_times(&self, robot: &RobotId) -> impl Iterator<Item = (GoalId, Option<NodeTime>)> {
        self.robots.get(robot).into_iter().flatten().map(|goal| (goal.id, goal.stop_at))
    }

    /// Records that a state is sent.
    pub(super) fn record_state(&mut self, state: StateStamp, now: NodeTime) {
        self.sent_states.push_back((state, now));
        while self.sent_states.front().is_some_and(|(_, sent)| now.since(*sent) > STATES_KEPT) {
            self.sent_states.pop_front();
        }
    }

    /// Receives a command. It extends the permission of the goals that it names, and of no others: a
    /// goal that the backend will refuse does not let the current goal continue.
    pub(super) fn receive(
        &mut self,
        robot: &RobotId,
        command: DriverCommand,
        now: NodeTime,
    ) -> Result<CommandEffect, CommandError> {
        let stop_at = self.stop_time(&command.permit, now);
        let Some(goals) = self.robots.get_mut(robot) else {
            let available = self.robots.keys().map(RobotId::as_str).collect::<Vec<_>>().join(", ");
            return Err(CommandError::UnknownRobot { robot: robot.clone(), available });
        };
        let permit = command.permit;
        for goal in goals.iter_mut().filter(|goal| goal.stop_at.is_some() && permit.goals.contains(&goal.id)) {
            goal.stop_at = goal.stop_at.max(stop_at);
        }
        let is_known = |id: GoalId| goals.iter().any(|goal| goal.id == id);
        match command.request {
            Some(GoalRequest::Start { id, goal }) if !is_known(id) => {
                if stop_at.is_none() {
                    let Permit { state, keep_for_ms, .. } = permit;
                    return Err(CommandError::NotPermitted { robot: robot.clone(), goal: id, state, keep_for_ms });
                }
                track(goals, TrackedGoal { id, stop_at });
                Ok(CommandEffect::Start(id, goal))
            }
            // Canceled before its start arrived: the late start must have no effect.
            Some(GoalRequest::Cancel { id }) if !is_known(id) => {
                track(goals, TrackedGoal { id, stop_at: None });
                Ok(CommandEffect::None)
            }
            Some(GoalRequest::Cancel { id }) => Ok(CommandEffect::Cancel(id)),
            Some(GoalRequest::Start { .. }) | None => Ok(CommandEffect::None),
        }
    }

    /// Returns the time until which a command lets its goals continue; `None` if it has passed, or
    /// the state in the permit is unknown.
    fn stop_time(&self, permit: &Permit, now: NodeTime) -> Option<NodeTime> {
        let (_, sent) = self.sent_states.iter().rev().find(|(state, _)| *state == permit.state)?;
        stop_at(Duration::from_millis(permit.keep_for_ms), self.client_timeout, *sent, now)
    }

    /// Records the end of a goal.
    pub(super) fn end(&mut self, robot: &RobotId, id: GoalId) {
        let goals = self.robots.get_mut(robot).into_iter().flatten();
        goals.filter(|goal| goal.id == id).for_each(|goal| goal.stop_at = None);
    }

    /// Takes the goals whose permission has run out by now: their robots must stop.
    pub(super) fn take_expired(&mut self, now: NodeTime) -> Vec<(RobotId, GoalId)> {
        let mut expired = vec![];
        for (robot, goals) in &mut self.robots {
            for goal in goals.iter_mut() {
                if goal.stop_at.take_if(|stop| *stop <= now).is_some() {
                    expired.push((robot.clone(), goal.id));
                }
            }
        }
        if self.next_wake.is_some_and(|wake| wake <= now) {
            self.next_wake = None;
        }
        expired
    }

    /// Returns the instant of the next stop, if no wake-up is scheduled until then; the caller
    /// schedules it.
    pub(super) fn schedule_wake(&mut self) -> Option<NodeTime> {
        let next_stop = self.robots.values().flatten().filter_map(|goal| goal.stop_at).min()?;
        if self.next_wake.is_some_and(|wake| wake <= next_stop) {
            return None;
        }
        self.next_wake = Some(next_stop);
        self.next_wake
    }
}

/// Adds a goal. The oldest goal that has ended is forgotten; a goal in progress is kept.
fn track(goals: &mut VecDeque<TrackedGoal>, goal: TrackedGoal) {
    goals.push_back(goal);
    if goals.len() > GOALS_PUBLISHED {
        let oldest_ended = goals.iter().position(|goal| goal.stop_at.is_none()).unwrap_or(0);
        goals.remove(oldest_ended);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::units::Seconds;
    use consort_skills::actions::Wait;

    const CLIENT_TIMEOUT: Duration = Duration::from_secs(3);

    fn at(ms: u64) -> NodeTime {
        NodeTime::at(Duration::from_millis(ms))
    }

    fn ada() -> RobotId {
        "ada".parse().unwrap()
    }

    fn wait() -> Goal {
        Goal::from(Wait { time: Seconds::ZERO })
    }

    fn start(id: u64) -> Option<GoalRequest> {
        Some(GoalRequest::Start { id: GoalId(id), goal: wait() })
    }

    fn stamp(sequence: u64) -> StateStamp {
        StateStamp { boot: 3, sequence }
    }

    /// A table with the state 1, sent at 0.
    fn table() -> GoalTable {
        let mut table = GoalTable::new(CLIENT_TIMEOUT);
        table.add_robot(ada(), vec![], at(0));
        table.record_state(stamp(1), at(0));
        table
    }

    fn permit(goals: &[u64], keep_for_ms: u64) -> Permit {
        Permit { goals: goals.iter().map(|id| GoalId(*id)).collect(), state: stamp(1), keep_for_ms }
    }

    fn receive(
        table: &mut GoalTable,
        request: Option<GoalRequest>,
        permit: Permit,
        ms: u64,
    ) -> Result<CommandEffect, CommandError> {
        table.receive(&ada(), DriverCommand { request, permit }, at(ms))
    }

    fn stops(table: &GoalTable) -> Vec<Option<NodeTime>> {
        table.stop_times(&ada()).map(|(_, stop_at)| stop_at).collect()
    }

    #[test]
    fn a_goal_stops_at_the_end_of_its_permission() {
        let mut table = table();
        let started = receive(&mut table, start(5), permit(&[], 900), 100);
        assert_eq!(started, Ok(CommandEffect::Start(GoalId(5), wait())));
        assert_eq!((table.schedule_wake(), table.schedule_wake()), (Some(at(900)), None));
        assert_eq!(receive(&mut table, None, permit(&[5], 1_000), 800), Ok(CommandEffect::None));
        assert_eq!(receive(&mut table, None, permit(&[5], 950), 850), Ok(CommandEffect::None), "overtaken");
        assert_eq!((table.take_expired(at(900)), table.schedule_wake()), (vec![], Some(at(1_000))));
        assert_eq!(table.take_expired(at(1_000)), [(ada(), GoalId(5))]);
        assert_eq!(receive(&mut table, None, permit(&[5], 5_000), 1_100), Ok(CommandEffect::None));
        assert_eq!(stops(&table), [None], "a stopped goal does not continue");
    }

    #[test]
    fn a_permission_never_outlasts_the_client_timeout() {
        let mut table = table();
        receive(&mut table, start(5), permit(&[], 60_000), 100).unwrap();
        assert_eq!(stops(&table), [Some(at(3_100))]);
    }

    #[test]
    fn a_start_that_arrives_after_its_permission_is_refused() {
        let mut table = table();
        let not_permitted =
            |state, keep_for_ms| Err(CommandError::NotPermitted { robot: ada(), goal: GoalId(5), state, keep_for_ms });
        assert_eq!(receive(&mut table, start(5), permit(&[], 900), 900), not_permitted(stamp(1), 900));
        let of_another_server = Permit { goals: vec![], state: StateStamp { boot: 4, sequence: 1 }, keep_for_ms: 900 };
        assert_eq!(
            receive(&mut table, start(5), of_another_server, 100),
            not_permitted(StateStamp { boot: 4, sequence: 1 }, 900)
        );
        table.record_state(stamp(2), at(20_000));
        assert_eq!(receive(&mut table, start(5), permit(&[], 30_000), 20_000), not_permitted(stamp(1), 30_000));
        assert_eq!(stops(&table), []);
    }

    #[test]
    fn a_command_for_another_goal_is_no_sign_of_life() {
        let mut table = table();
        receive(&mut table, start(5), permit(&[], 3_000), 0).unwrap();
        receive(&mut table, start(6), permit(&[], 9_000), 1_000).unwrap();
        table.end(&ada(), GoalId(6)); // busy
        receive(&mut table, None, permit(&[6], 9_000), 1_500).unwrap();
        receive(&mut table, Some(GoalRequest::Cancel { id: GoalId(6) }), Permit::default(), 2_100).unwrap();
        assert_eq!(stops(&table), [Some(at(3_000)), None]);
    }

    #[test]
    fn refused_goals_do_not_displace_a_goal_in_progress() {
        let mut table = table();
        receive(&mut table, start(5), permit(&[], 3_000), 0).unwrap();
        for id in 6..40 {
            receive(&mut table, start(id), permit(&[], 3_000), 100).unwrap();
            table.end(&ada(), GoalId(id));
        }
        let goals: Vec<_> = table.goals(&ada()).unwrap().collect();
        assert_eq!((goals[0], goals.len()), (GoalId(5), GOALS_PUBLISHED));
        assert_eq!(table.take_expired(at(3_000)), [(ada(), GoalId(5))]);
    }

    #[test]
    fn a_goal_of_a_previous_server_continues_for_the_client_timeout() {
        let mut table = GoalTable::new(CLIENT_TIMEOUT);
        table.add_robot(ada(), vec![GoalId(3)], at(50));
        assert_eq!((table.take_expired(at(3_049)), table.schedule_wake()), (vec![], Some(at(3_050))));
        assert_eq!(table.take_expired(at(3_050)), [(ada(), GoalId(3))]);
    }

    #[test]
    fn a_cancel_that_overtakes_its_start_cancels_it() {
        let mut table = table();
        let cancel = || Some(GoalRequest::Cancel { id: GoalId(5) });
        assert_eq!(receive(&mut table, cancel(), permit(&[], 900), 0), Ok(CommandEffect::None));
        assert_eq!(receive(&mut table, start(5), permit(&[], 900), 1), Ok(CommandEffect::None));
        assert_eq!(receive(&mut table, cancel(), permit(&[], 900), 2), Ok(CommandEffect::Cancel(GoalId(5))));
    }
}
