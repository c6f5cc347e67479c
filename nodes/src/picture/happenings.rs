//! What happens, taken in: into the log, and where it changes what is shown.

use super::parts::{Bar, Logged, MissionShown};
use super::tenures;
use super::{Picture, bounds};
use crate::words::{Words, words};
use consort_protocol::event::{Event, Happening};
use consort_protocol::ids::{MissionId, RoleId, TaskId};

impl Picture {
    /// Takes in an event.
    pub fn take_event(&mut self, event: &Event, now_ms: u64) {
        self.enter(event);
        let (node, at) = (event.node.as_str(), event.at_ms);
        match &event.what {
            Happening::Elected { term, .. } => {
                if self.coordinator.as_ref().is_none_or(|known| known.term < *term) {
                    self.note_coordinator(&event.node, *term, now_ms, now_ms);
                    self.reach.heard_ms = Some(now_ms);
                }
            }
            Happening::Submitted { mission, parameters } => {
                let shown = self.mission(mission);
                if shown.submitted_ms == 0 {
                    shown.submitted_ms = at;
                }
                shown.parameters.clone_from(parameters);
            }
            Happening::Called { mission, .. } => self.open_auction(mission.as_str()),
            Happening::Bid { mission, bid } => self.take_bid(mission.as_str(), bid),
            Happening::Closed { record, .. } => self.take_record(record),
            Happening::Awarded { mission, holders, after_ms, .. } => {
                let shown = self.mission(mission);
                for (role, robot) in holders {
                    shown.holders.insert(role.to_string(), robot.to_string());
                    shown.take_up(role.as_str(), robot.as_str(), at);
                }
                shown.awarded_ms.get_or_insert(at);
                shown.award_after_ms = shown.award_after_ms.or(*after_ms);
            }
            Happening::Mission { mission, state, submitted_at_ms } => {
                let shown = self.mission(mission);
                shown.submitted_ms = *submitted_at_ms;
                shown.take_state(state, at);
            }
            Happening::Progress { mission, done, steps } => {
                let shown = self.mission(mission);
                (shown.done, shown.steps) = (shown.done.max(*done as u64), *steps as u64);
            }
            Happening::TaskBegan { mission, role, task } => {
                self.mission(mission).begin(role, task, node, at);
                self.at_task(node, Some((mission, task)));
            }
            Happening::TaskEnded { mission, role, task } => {
                self.mission(mission).end(role, task, node, at, "done");
                self.at_task(node, None);
            }
            Happening::TaskFailed { mission, role, task, .. } => {
                self.mission(mission).end(role, task, node, at, "failed");
                self.at_task(node, None);
            }
            Happening::Alternative { mission, role, task, .. } => {
                self.mission(mission).end(role, task, node, at, "failed");
            }
            Happening::Halted { mission, role, reason } => {
                let shown = self.mission(mission);
                shown.break_off(role, node, at);
                if shown.has(role.as_str(), node) {
                    shown.put_down(role.as_str(), at, tenures::word_of(*reason));
                }
                self.at_task(node, None);
            }
            Happening::Started { mission, role, .. } => self.mission(mission).take_up(role.as_str(), node, at),
            Happening::Suspended { mission, role } => self.mission(mission).pause(role.as_str(), node, true),
            Happening::Resumed { mission, role } => self.mission(mission).pause(role.as_str(), node, false),
            Happening::Released { mission, role, .. } => {
                self.mission(mission).put_down(role.as_str(), at, tenures::GIVEN_UP);
            }
            Happening::SteppedDown { .. }
            | Happening::Foreign { .. }
            | Happening::Voters { .. }
            | Happening::Joined { .. }
            | Happening::Left { .. }
            | Happening::Sent { .. }
            | Happening::Heard { .. }
            | Happening::TaskRetried { .. }
            | Happening::GaveUp { .. }
            | Happening::ChargeShort { .. }
            | Happening::Outdated { .. } => {}
        }
    }

    fn mission(&mut self, id: &MissionId) -> &mut MissionShown {
        self.missions.entry_or(id.to_string(), || MissionShown {
            state: "pending".to_owned(),
            branch: "main".to_owned(),
            ..MissionShown::default()
        })
    }

    fn at_task(&mut self, robot: &str, at: Option<(&MissionId, &TaskId)>) {
        let Some(shown) = self.robots.change(&robot.to_owned()) else { return };
        shown.task = at.map(|(_, task)| task.to_string());
        if let Some((mission, _)) = at {
            shown.mission = Some(mission.to_string());
        }
        self.lay_route(robot);
    }

    fn enter(&mut self, event: &Event) {
        let Words { word, text, alarm } = words(event);
        let robot = match &event.what {
            Happening::Bid { bid, .. } => Some(bid.robot.to_string()),
            Happening::Joined { member, .. } | Happening::Left { member, .. } => Some(member.to_string()),
            _ => self.robots.contains_key(event.node.as_str()).then(|| event.node.to_string()),
        };
        let logged = Logged {
            at_ms: event.at_ms,
            node: event.node.to_string(),
            kind: event.what.word().to_owned(),
            word: word.to_owned(),
            text,
            mission: event.what.mission().map(ToString::to_string),
            robot,
            alarm,
        };
        self.logged += 1;
        self.log.insert(self.logged, logged);
        self.log.keep_last(bounds::EVENTS);
    }
}

impl MissionShown {
    fn begin(&mut self, role: &RoleId, task: &TaskId, by: &str, at_ms: u64) {
        let open = |bar: &&mut Bar| bar.to_ms.is_none() && bar.role == role.as_str() && bar.task == task.as_str();
        for bar in self.bars.iter_mut().filter(open) {
            bar.to_ms = Some(at_ms);
            "broken off".clone_into(&mut bar.state);
        }
        let (role, task, state) = (role.to_string(), task.to_string(), "running".to_owned());
        self.bars.push(Bar { role, task, by: by.to_owned(), from_ms: at_ms, to_ms: None, state });
        if self.bars.len() > bounds::BARS {
            self.bars.remove(0);
        }
    }

    fn end(&mut self, role: &RoleId, task: &TaskId, by: &str, at_ms: u64, word: &str) {
        let open = |bar: &&mut Bar| bar.to_ms.is_none() && bar.role == role.as_str() && bar.task == task.as_str();
        match self.bars.iter_mut().rev().find(open) {
            Some(bar) => {
                bar.to_ms = Some(at_ms.max(bar.from_ms));
                word.clone_into(&mut bar.state);
            }
            // Its beginning was not heard.
            None => {
                self.begin(role, task, by, at_ms);
                self.end(role, task, by, at_ms, word);
            }
        }
    }

    fn break_off(&mut self, role: &RoleId, by: &str, at_ms: u64) {
        let open = |bar: &&mut Bar| bar.to_ms.is_none() && bar.role == role.as_str() && bar.by == by;
        for bar in self.bars.iter_mut().filter(open) {
            bar.to_ms = Some(at_ms);
            "broken off".clone_into(&mut bar.state);
        }
    }
}
