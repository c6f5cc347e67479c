//! Applies events: to the log, and to the state of missions, robots and auctions.

use super::assignments;
use super::state::{LogEntry, MissionModel, TaskBar};
use super::{FleetModel, bounds};
use crate::event_text::{EventText, describe_event};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{MissionId, RoleId, TaskId};

impl FleetModel {
    /// Applies an event.
    pub fn apply_event(&mut self, event: &Event, now_ms: u64) {
        self.add_to_log(event);
        let (node, at) = (event.node.as_str(), event.at_ms);
        match &event.kind {
            EventKind::Elected { term, .. } => {
                if self.coordinator.as_ref().is_none_or(|known| known.term < *term) {
                    self.update_coordinator(&event.node, *term, now_ms, now_ms);
                    self.reachability.last_contact_ms = Some(now_ms);
                }
            }
            EventKind::Submitted { mission, parameters } => {
                let shown = self.mission(mission);
                if shown.submitted_ms == 0 {
                    shown.submitted_ms = at;
                }
                shown.parameters.clone_from(parameters);
            }
            EventKind::BidsRequested { mission, .. } => self.open_auction(mission.as_str()),
            EventKind::Bid { mission, bid } => self.add_bid(mission.as_str(), bid),
            EventKind::Closed { record, .. } => self.apply_auction_record(record),
            EventKind::Awarded { mission, holders, after_ms, .. } => {
                let shown = self.mission(mission);
                for (role, robot) in holders {
                    shown.holders.insert(role.to_string(), robot.to_string());
                    shown.start_assignment(role.as_str(), robot.as_str(), at);
                }
                shown.awarded_ms.get_or_insert(at);
                shown.award_after_ms = shown.award_after_ms.or(*after_ms);
            }
            EventKind::Mission { mission, state, submitted_at_ms } => {
                let shown = self.mission(mission);
                shown.submitted_ms = *submitted_at_ms;
                shown.apply_state(state, at);
            }
            EventKind::Progress { mission, done, steps } => {
                let shown = self.mission(mission);
                (shown.done, shown.steps) = (shown.done.max(*done as u64), *steps as u64);
            }
            EventKind::TaskBegan { mission, role, task } => {
                self.mission(mission).begin_task(role, task, node, at);
                self.set_task(node, Some((mission, task)));
            }
            EventKind::TaskEnded { mission, role, task } => {
                self.mission(mission).end_task(role, task, node, at, "done");
                self.set_task(node, None);
            }
            EventKind::TaskSkipped { mission, role, task } => {
                self.mission(mission).end_task(role, task, node, at, "skipped");
            }
            EventKind::TaskFailed { mission, role, task, .. } => {
                self.mission(mission).end_task(role, task, node, at, "failed");
                self.set_task(node, None);
            }
            EventKind::Alternative { mission, role, task, .. } => {
                self.mission(mission).end_task(role, task, node, at, "failed");
            }
            EventKind::Halted { mission, role, reason } => {
                let shown = self.mission(mission);
                shown.abort_tasks(role, node, at);
                if shown.is_assigned(role.as_str(), node) {
                    shown.end_assignment(role.as_str(), at, assignments::state_after(*reason));
                }
                self.set_task(node, None);
            }
            EventKind::Started { mission, role, .. } => self.mission(mission).start_assignment(role.as_str(), node, at),
            EventKind::Suspended { mission, role, .. } => {
                self.mission(mission).set_suspended(role.as_str(), node, true);
            }
            EventKind::Resumed { mission, role } => self.mission(mission).set_suspended(role.as_str(), node, false),
            EventKind::Released { mission, role, .. } => {
                self.mission(mission).end_assignment(role.as_str(), at, assignments::RELEASED);
            }
            EventKind::SteppedDown { .. }
            | EventKind::Foreign { .. }
            | EventKind::Voters { .. }
            | EventKind::ScheduleChanged { .. }
            | EventKind::PriorityChanged { .. }
            | EventKind::RoleOrdered { .. }
            | EventKind::RobotOrders { .. }
            | EventKind::AlarmChanged { .. }
            | EventKind::ClosureChanged { .. }
            | EventKind::ChargerLeased { .. }
            | EventKind::ChargerFreed { .. }
            | EventKind::DeviceLeased { .. }
            | EventKind::DeviceFreed { .. }
            | EventKind::OccurrenceSubmitted { .. }
            | EventKind::Joined { .. }
            | EventKind::Left { .. }
            | EventKind::Escalated { .. }
            | EventKind::QuestionAsked { .. }
            | EventKind::QuestionAnswered { .. }
            | EventKind::QuestionClosed { .. }
            | EventKind::Sent { .. }
            | EventKind::Received { .. }
            | EventKind::TaskRetried { .. }
            | EventKind::GaveUp { .. }
            | EventKind::LowCharge { .. }
            | EventKind::StaleSignal { .. } => {}
        }
    }

    fn mission(&mut self, id: &MissionId) -> &mut MissionModel {
        self.missions.get_or_insert_with(id.to_string(), || MissionModel {
            state: "pending".to_owned(),
            ..MissionModel::default()
        })
    }

    fn set_task(&mut self, robot: &str, at: Option<(&MissionId, &TaskId)>) {
        let Some(shown) = self.robots.get_mut(&robot.to_owned()) else { return };
        shown.task = at.map(|(_, task)| task.to_string());
        if let Some((mission, _)) = at {
            shown.mission = Some(mission.to_string());
        }
        self.update_route(robot);
    }

    fn add_to_log(&mut self, event: &Event) {
        let EventText { label, text, alarm } = describe_event(event);
        let robot = match &event.kind {
            EventKind::Bid { bid, .. } => Some(bid.robot.to_string()),
            EventKind::Joined { member, .. } | EventKind::Left { member, .. } => Some(member.to_string()),
            _ => self.robots.contains_key(event.node.as_str()).then(|| event.node.to_string()),
        };
        let logged = LogEntry {
            at_ms: event.at_ms,
            node: event.node.to_string(),
            kind: event.kind.as_str().to_owned(),
            label: label.to_owned(),
            text,
            mission: event.kind.mission().map(ToString::to_string),
            robot,
            alarm,
        };
        self.log_count += 1;
        self.log.insert(self.log_count, logged);
        self.log.keep_last(bounds::EVENTS);
    }
}

impl MissionModel {
    fn begin_task(&mut self, role: &RoleId, task: &TaskId, by: &str, at_ms: u64) {
        let open = |bar: &&mut TaskBar| bar.to_ms.is_none() && bar.role == role.as_str() && bar.task == task.as_str();
        for bar in self.bars.iter_mut().filter(open) {
            bar.to_ms = Some(at_ms);
            "aborted".clone_into(&mut bar.state);
        }
        let (role, task, state) = (role.to_string(), task.to_string(), "running".to_owned());
        self.bars.push(TaskBar { role, task, by: by.to_owned(), from_ms: at_ms, to_ms: None, state });
        if self.bars.len() > bounds::BARS {
            self.bars.remove(0);
        }
    }

    fn end_task(&mut self, role: &RoleId, task: &TaskId, by: &str, at_ms: u64, state: &str) {
        let open = |bar: &&mut TaskBar| bar.to_ms.is_none() && bar.role == role.as_str() && bar.task == task.as_str();
        match self.bars.iter_mut().rev().find(open) {
            Some(bar) => {
                bar.to_ms = Some(at_ms.max(bar.from_ms));
                state.clone_into(&mut bar.state);
            }
            // Its beginning was not received.
            None => {
                self.begin_task(role, task, by, at_ms);
                self.end_task(role, task, by, at_ms, state);
            }
        }
    }

    fn abort_tasks(&mut self, role: &RoleId, by: &str, at_ms: u64) {
        let open = |bar: &&mut TaskBar| bar.to_ms.is_none() && bar.role == role.as_str() && bar.by == by;
        for bar in self.bars.iter_mut().filter(open) {
            bar.to_ms = Some(at_ms);
            "aborted".clone_into(&mut bar.state);
        }
    }
}
