//! What happens, taken in: into the log, and where it changes what is shown.

use super::parts::{Bar, Logged, MissionShown};
use super::{Picture, bounds, keep_last};
use consort_protocol::event::{Event, Happening};
use consort_protocol::ids::{MissionId, RoleId, TaskId};
use consort_protocol::plan::{Signal, SignalKind};
use std::fmt::Display;

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
            Happening::Halted { mission, role, .. } => {
                self.mission(mission).break_off(role, node, at);
                self.at_task(node, None);
            }
            Happening::SteppedDown { .. }
            | Happening::Foreign { .. }
            | Happening::Voters { .. }
            | Happening::Joined { .. }
            | Happening::Left { .. }
            | Happening::Released { .. }
            | Happening::Started { .. }
            | Happening::Sent { .. }
            | Happening::Heard { .. }
            | Happening::Suspended { .. }
            | Happening::Resumed { .. }
            | Happening::TaskRetried { .. }
            | Happening::GaveUp { .. }
            | Happening::ChargeShort { .. }
            | Happening::Outdated { .. } => {}
        }
    }

    fn mission(&mut self, id: &MissionId) -> &mut MissionShown {
        self.missions.entry(id.to_string()).or_insert_with(|| MissionShown {
            state: "pending".to_owned(),
            branch: "main".to_owned(),
            ..MissionShown::default()
        })
    }

    fn at_task(&mut self, robot: &str, at: Option<(&MissionId, &TaskId)>) {
        let Some(shown) = self.robots.get_mut(robot) else { return };
        shown.task = at.map(|(_, task)| task.to_string());
        if let Some((mission, _)) = at {
            shown.mission = Some(mission.to_string());
        }
        self.lay_route(robot);
    }

    fn enter(&mut self, event: &Event) {
        let (word, text, alarm) = words(event);
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
        keep_last(&mut self.log, bounds::EVENTS);
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

/// An event for people: its kind in a word, what happened, and whether somebody should look at it.
fn words(event: &Event) -> (&'static str, String, bool) {
    let node = &event.node;
    let calm = |word, text| (word, text, false);
    let alarm = |word, text| (word, text, true);
    match &event.what {
        Happening::Elected { term, voters } => {
            calm("elected", format!("{node} coordinates in term {term}; the ledger is kept by {}", joined(voters)))
        }
        Happening::SteppedDown { term } => alarm("stepped down", format!("{node} no longer coordinates (term {term})")),
        Happening::Foreign { foreign, member, .. } => {
            alarm("foreign", format!("{member} belongs to cluster {foreign}, which was founded apart"))
        }
        Happening::Voters { voters, reason } => {
            calm("voters", format!("{reason}; the ledger is kept by {}", joined(voters)))
        }
        Happening::Joined { ensemble, member } => calm("joined", format!("{member} is a member of {ensemble}")),
        Happening::Left { ensemble, member, reason } => {
            calm("left", format!("{member} is no member of {ensemble}: {reason}"))
        }
        Happening::Submitted { mission, parameters } => {
            let given: Vec<String> = parameters.iter().map(|(name, value)| format!("{name} = {value}")).collect();
            let with = if given.is_empty() { String::new() } else { format!(", {}", given.join(", ")) };
            calm("acknowledged", format!("{mission}{with}"))
        }
        Happening::Called { mission, roles, round, asked } => {
            calm("call for bids", format!("{mission}: {} asked of {asked} members, round {round}", joined(roles)))
        }
        Happening::Bid { mission, bid } => {
            let (energy, left) = (bid.energy * 100.0, bid.remaining * 100.0);
            let (robot, role, time) = (&bid.robot, &bid.role, bid.time);
            calm(
                "bid",
                format!("{robot} as {role} of {mission}: {time:.1}, {energy:.1} % of its charge, {left:.1} % left"),
            )
        }
        Happening::Closed { mission, record } => match &record.failure {
            None => {
                let chosen: Vec<String> =
                    record.chosen.iter().map(|(role, robot)| format!("{role}: {robot}")).collect();
                calm("auction closed", format!("{mission}: {}", chosen.join(", ")))
            }
            Some(failure) => alarm("no award", format!("{mission}: {failure}")),
        },
        Happening::Awarded { mission, holders, epoch, after_ms } => {
            let given: Vec<String> = holders.iter().map(|(role, robot)| format!("{role} to {robot}")).collect();
            let after = after_ms.map_or_else(String::new, |ms| format!(", {ms:.1} ms after the request"));
            calm("award", format!("{mission}: {} (epoch {epoch}){after}", given.join(", ")))
        }
        Happening::Released { mission, role, cause } => alarm("released", format!("{role} of {mission}: {cause}")),
        Happening::Mission { mission, state, .. } => {
            let word = state.word().replace('_', " ");
            let told = (state.is_end() && state.word() != "completed", format!("{mission} is {word}"));
            ("mission", told.1, told.0)
        }
        Happening::Progress { mission, done, steps } => calm("progress", format!("{mission}: {done} of {steps} steps")),
        Happening::Started { mission, role, epoch } => {
            calm("begins", format!("{node} as {role} of {mission} (epoch {epoch})"))
        }
        Happening::TaskBegan { mission, role, task } => {
            calm("task begins", format!("{task}: {node} as {role} of {mission}"))
        }
        Happening::TaskEnded { mission, role, task } => {
            calm("task done", format!("{task}: {node} as {role} of {mission}"))
        }
        Happening::TaskFailed { mission, role, task, cause } => {
            alarm("task failed", format!("{task}: {node} as {role} of {mission}: {cause}"))
        }
        Happening::Sent { signal, .. } => calm("signal sent", said(signal)),
        Happening::Heard { signal, .. } => calm("signal heard", said(signal)),
        Happening::Suspended { mission, role } => {
            alarm("suspended", format!("{node} as {role} of {mission}: its lease ran out"))
        }
        Happening::Resumed { mission, role } => calm("resumed", format!("{node} as {role} of {mission}")),
        Happening::Halted { mission, role, reason } => {
            calm("ends", format!("{node} as {role} of {mission}: {}", format!("{reason:?}").to_lowercase()))
        }
        Happening::TaskRetried { role, task, attempt, cause, .. } => {
            calm("task again", format!("{task}: {node} as {role} after {attempt} attempts: {cause}"))
        }
        Happening::Alternative { role, task, tasks, cause, .. } => {
            calm("another way", format!("{node} as {role}: {} instead of {task}: {cause}", joined(tasks)))
        }
        Happening::GaveUp { mission, role, cause, .. } => {
            alarm("gives up", format!("{node} as {role} of {mission}: {cause}"))
        }
        Happening::ChargeShort { mission, role, cause } => {
            alarm("charge short", format!("{node} goes on as {role} of {mission} all the same: {cause}"))
        }
        Happening::Outdated { signal, epoch, known, .. } => {
            calm("outdated", format!("{node} does not listen to {} of epoch {epoch}: now it is {known}", said(signal)))
        }
    }
}

fn joined<T: Display>(names: &[T]) -> String {
    names.iter().map(T::to_string).collect::<Vec<_>>().join(", ")
}

fn said(signal: &Signal) -> String {
    let Signal { kind, task, from, to } = signal;
    match kind {
        SignalKind::Done => format!("{from} to {to}: {task} is done"),
        SignalKind::Ready => format!("{from} to {to}: ready for {task}"),
    }
}
