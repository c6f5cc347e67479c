//! Driver client and driver server for the model check: their decisions about permissions, without
//! the actors, the bus and the robot around them.

use super::CLIENT_TIMEOUT;
use super::goal_table::{CommandEffect, GoalTable};
use super::goal_tracker::GoalTracker;
use super::messages::{DriverCommand, DriverState, GoalRequest};
use super::state_order::StateStamp;
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, NodeTime, Seconds, WorldTime};
use consort_skills::actions::{Goal, GoalId, Telemetry, Wait};
use std::collections::BTreeMap;
use std::time::Duration;

/// Driver server of a robot.
#[derive(Debug, Clone)]
pub(crate) struct ModelServer {
    robot: RobotId,
    table: GoalTable,
}

/// State of a goal at the driver server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum GoalPhase {
    /// The start has not arrived.
    Unknown,
    /// The goal has ended or was stopped.
    Ended,
    /// The robot acts until this time.
    Until(NodeTime),
}

fn stamp(sequence: u64) -> StateStamp {
    StateStamp { boot: 1, sequence }
}

impl ModelServer {
    pub(crate) fn new(robot: RobotId, now: NodeTime) -> ModelServer {
        let mut table = GoalTable::new(CLIENT_TIMEOUT);
        table.add_robot(robot.clone(), vec![], now);
        ModelServer { robot, table }
    }

    /// Sends the state `sequence`, and returns whether a robot had to stop.
    pub(crate) fn tick(&mut self, sequence: u64, now: NodeTime) -> bool {
        self.table.record_state(stamp(sequence), now);
        !self.table.take_expired(now).is_empty()
    }

    /// Receives a command, and returns whether a goal has started.
    pub(crate) fn receive(&mut self, command: DriverCommand, now: NodeTime) -> bool {
        matches!(self.table.receive(&self.robot, command, now), Ok(CommandEffect::Start(..)))
    }

    /// Returns the state of a goal.
    pub(crate) fn phase(&self, goal: u64) -> GoalPhase {
        match self.table.stop_times(&self.robot).find(|(id, _)| id.0 == goal) {
            None => GoalPhase::Unknown,
            Some((_, stop_at)) => stop_at.map_or(GoalPhase::Ended, GoalPhase::Until),
        }
    }

    /// Returns the time until which the robot acts; `None` without a goal in progress.
    pub(crate) fn acts_until(&self) -> Option<NodeTime> {
        self.table.stop_times(&self.robot).filter_map(|(_, stop_at)| stop_at).max()
    }
}

/// Returns the command that starts `goal`, or repeats its start, if the robot may act until `until`.
/// The body is at rest `cancel_within` after the cancel of the goal. The client has received the state
/// `sequence` at `received`.
pub(crate) fn start_command(
    robot: &RobotId,
    (goal, cancel_within): (u64, Duration),
    (sequence, received): (u64, NodeTime),
    until: Option<NodeTime>,
    now: NodeTime,
) -> DriverCommand {
    let wait = Goal::from(Wait { time: Seconds::ZERO });
    let cancel_times = BTreeMap::from([(wait.action.clone(), cancel_within)]);
    let mut tracker = GoalTracker::new(goal).with_cancel_times(&cancel_times);
    let telemetry = Telemetry {
        time: WorldTime::ZERO,
        pose: Pose::default(),
        place: "Dock".parse().expect("a place"),
        battery: BatteryShare::FULL,
        able: true,
        closed: vec![],
        readings: BTreeMap::new(),
    };
    let state =
        DriverState { robot: robot.clone(), stamp: stamp(sequence), telemetry, goals: vec![], completed: vec![] };
    tracker.apply_state(state, received);
    tracker.allow_until(until);
    tracker.start_goal(wait.clone());
    let request = Some(GoalRequest::Start { id: GoalId(goal), goal: wait });
    tracker.command(request, now)
}
