//! Identity of a state: everything that decides about its future, with times relative to the present
//! and without the names of awards, goals and terms.

use super::robot::{Robot, server_time, useless_from};
use super::world::{Faults, World};
use super::{REACTION, ticks};
use crate::robot_driver::model_driver::GoalPhase;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::RolePhase;
use consort_protocol::message::ReportReply;
use std::hash::{Hash, Hasher};

/// Ticks after which a lease has expired for the coordinator, which checks just after the tick.
const EXPIRED: u64 = 6;

impl Hash for World {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        self.key().hash(hasher);
    }
}

impl PartialEq for World {
    fn eq(&self, other: &World) -> bool {
        self.key() == other.key()
    }
}

impl World {
    fn key(&self) -> Vec<u8> {
        let mut key = Vec::with_capacity(64);
        let Faults { crashes, suspensions, takeovers } = self.left;
        key.extend([crashes, suspensions, takeovers, self.awards.len() as u8, self.release.is_some().into()]);
        key.extend(self.awards.iter().map(|award| award.robot as u8));
        for node in [self.leader, 1 - self.leader] {
            self.add_session(node, &mut key);
        }
        for robot in &self.robots {
            self.add_node(robot, &mut key);
            self.add_report(robot, &mut key);
            self.add_driver(robot, &mut key);
        }
        key
    }

    /// Returns the number of an award, from 1; 0 for none.
    fn number(&self, epoch: Option<Epoch>) -> u8 {
        let number = |epoch| self.awards.iter().position(|award| award.epoch == epoch);
        epoch.and_then(number).map_or(0, |index| index as u8 + 1)
    }

    fn add_session(&self, node: usize, key: &mut Vec<u8>) {
        let Some(session) = &self.sessions[node] else { return key.push(u8::MAX) };
        let role = self.role(session.ledger());
        let phase = match role.phase {
            RolePhase::Open => 0,
            RolePhase::Awarded => 1,
            RolePhase::Active => 2,
            RolePhase::Ended => 3,
            RolePhase::Promised => 4,
        };
        let deposed = if node == self.leader { 0 } else { (self.tick - self.deposed_at).min(2) as u8 };
        key.extend([deposed, phase]);
        if let Some(holder) = &role.holder {
            let (age, renews) = session.contact(holder.epoch, &holder.robot, self.coordinator_time(node));
            let age = if node == self.leader { age.min(ticks(EXPIRED)).as_secs() } else { 0 };
            let incarnation = holder.incarnation.unwrap_or(0);
            key.extend([self.number(Some(holder.epoch)), incarnation as u8, age as u8, renews.into()]);
        }
    }

    fn add_node(&self, robot: &Robot, key: &mut Vec<u8>) {
        let (node, lease) = (&robot.node, &robot.node.lease);
        let held = lease.award().map(|award| award.epoch);
        let phase = match (held, lease.acts_until()) {
            (None, _) => 0,
            (Some(_), Some(until)) => 8 + until.since(node.now(self.tick)).as_secs() as u8,
            (Some(_), None) if lease.is_suspended() => 1,
            (Some(_), None) => 2 + (self.tick - node.received_at).min(4) as u8,
        };
        let resumed = node.resumed.filter(|epoch| Some(*epoch) == held);
        // Without another crash, the checkpoint is not read.
        let checkpoint = node.checkpoint.as_ref().filter(|_| self.left.crashes > 0).map(|award| award.epoch);
        let uncounted = if self.counts_suspension() { 0 } else { node.uncounted as u8 };
        key.extend([self.number(held), phase, self.number(checkpoint), self.number(resumed)]);
        key.extend([node.incarnation as u8, node.asleep.into(), uncounted, node.answers]);
    }

    fn add_report(&self, robot: &Robot, key: &mut Vec<u8>) {
        let Some(report) = &robot.report else { return key.push(u8::MAX) };
        let reply = match &report.reply {
            None => 0,
            Some(ReportReply::Renewed { .. }) => 1,
            Some(_) => 2,
        };
        let age =
            if report.incarnation == robot.node.incarnation { report.age(&robot.node, self.tick, 4) as u8 } else { 9 };
        key.extend([self.number(Some(report.epoch)), report.incarnation as u8]);
        key.extend([report.from_checkpoint.into(), age, reply]);
    }

    fn add_driver(&self, robot: &Robot, key: &mut Vec<u8>) {
        let remaining = |goal: u64| match robot.goal_phase(goal) {
            GoalPhase::Unknown => 100,
            GoalPhase::Ended => 101,
            GoalPhase::Until(stop) => stop.since(server_time(self.tick)).as_secs() as u8,
        };
        key.extend([robot.node.goal.map_or(u8::MAX, remaining)]);
        let until = robot.server.acts_until().map_or(0, |until| until.since(server_time(self.tick)).as_secs());
        key.extend([until as u8, robot.rest_at.saturating_sub(self.tick).min(REACTION + 1) as u8]);
        let Some(command) = &robot.command else { return key.push(u8::MAX) };
        let goal = command.request.as_ref().map_or(0, |request| request.goal().0);
        key.extend([remaining(goal), (robot.node.goal == Some(goal)).into()]);
        key.push(useless_from(command).saturating_sub(self.tick) as u8);
        if self.permits_late_commands() {
            key.push((self.tick - command.permit.state.sequence).min(11) as u8);
        }
    }
}
