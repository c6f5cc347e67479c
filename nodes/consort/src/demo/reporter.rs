//! Reports the demo: a timeline with progress bars for people, or a line of JSON for each event.

use super::events::{DemoEvent, TimedEvent};
use super::scenario::DemoScenario;
use crate::exit::Failure;
use crate::output;
use consort_dashboard::event_text::{EventText, describe_event};
use consort_protocol::auction::{AuctionEntry, AuctionRecord, BidVerdict};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{MissionId, RoleId, TaskId};
use consort_text::count;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::time::Duration;

/// Width of a progress bar in characters.
const BAR: usize = 20;

/// Reports the events of the demo.
pub(super) struct DemoReporter {
    json: bool,
    bars: Option<MultiProgress>,
    missions: BTreeMap<MissionId, ProgressBar>,
    scenario: String,
}

impl DemoReporter {
    /// Creates a reporter with JSON or text output.
    pub(super) fn new(json: bool, scenario: &DemoScenario) -> DemoReporter {
        let bars = (!json && std::io::stderr().is_terminal()).then(MultiProgress::new);
        let mobile = scenario.robots.iter().filter(|robot| robot.speed_mps.is_some());
        let words = mobile.map(|robot| {
            let speed = robot.speed_mps.map_or_else(|| "-".to_owned(), |speed| format!("{speed:.2}"));
            let (name, place, charge) = (&robot.name, &robot.place, robot.battery.percent());
            let skills = count(robot.skills.len(), "skill", "skills");
            format!("           {name:10} {place:12} {speed}  charge {charge}  {skills}")
        });
        DemoReporter { json, bars, missions: BTreeMap::new(), scenario: words.collect::<Vec<_>>().join("\n") }
    }

    /// Reports the start of the demo.
    pub(super) fn begin(&self, introduction: &str) -> Result<(), Failure> {
        if self.json {
            return self.print_json(&DemoEvent::Started { fleet: introduction.to_owned() });
        }
        self.print(format!("Consort demo: {introduction}\n{}", self.scenario))
    }

    /// Reports an event of the fleet.
    pub(super) fn event(&mut self, at: Duration, event: &Event) -> Result<(), Failure> {
        if self.json {
            return self.print_json(&TimedEvent { event, t_s: seconds(at) });
        }
        let node = &event.node;
        let task = |role: &RoleId, text: String| self.print_timed(at, "task", format!("{node:10} {role:8} {text}"));
        match &event.kind {
            EventKind::Closed { record, .. } => self.closed(at, record),
            EventKind::Progress { mission, done, steps } => self.progress(at, mission, *done, *steps),
            EventKind::TaskBegan { role, task: id, .. } => task(role, format!("{id} …")),
            EventKind::TaskEnded { role, task: id, .. } => task(role, format!("{id} done")),
            EventKind::TaskSkipped { role, task: id, .. } => task(role, format!("{id} skipped")),
            EventKind::TaskFailed { role, task: id, cause, .. } => task(role, format!("{id} FAILED: {cause}")),
            EventKind::TaskRetried { role, task: id, attempt, cause, .. } => {
                let times = count(*attempt, "time", "times");
                task(role, format!("{id} failed {times}, once more: {cause}"))
            }
            EventKind::Alternative { role, task: id, tasks, cause, .. } => {
                let tasks = tasks.iter().map(TaskId::as_str).collect::<Vec<_>>().join(", ");
                task(role, format!("{tasks} instead of {id}: {cause}"))
            }
            // The close of the auction reports all bids with their verdicts.
            EventKind::Bid { .. } => Ok(()),
            _ => {
                let EventText { label, text, .. } = describe_event(event);
                self.print_timed(at, label, text)
            }
        }
    }

    /// Reports an action of the demo itself.
    pub(super) fn demo_event(&self, at: Duration, label: &str, text: &str, event: DemoEvent) -> Result<(), Failure> {
        if self.json {
            return self.print_json(&TimedEvent { event, t_s: seconds(at) });
        }
        self.print_timed(at, label, text.to_owned())
    }

    /// Reports the result.
    pub(super) fn summary(&self, rows: &[Vec<String>], words: &[String], summary: DemoEvent) -> Result<(), Failure> {
        for bar in self.missions.values() {
            bar.finish_and_clear();
        }
        if self.json {
            return self.print_json(&summary);
        }
        self.print(format!("\n{}\n", output::table(rows)))?;
        words.iter().try_for_each(|line| self.print(line.clone()))
    }

    fn closed(&self, at: Duration, record: &AuctionRecord) -> Result<(), Failure> {
        let mission = &record.auction.mission;
        for entry in &record.entries {
            let AuctionEntry { role, robot, verdict, .. } = entry;
            let price = |time: f64, energy: f64, remaining: f64| {
                let (energy, remaining) = (energy * 100.0, remaining * 100.0);
                format!("{time:.1} s, {energy:.1} % of its charge, {remaining:.1} % left")
            };
            let (label, text) = match verdict {
                BidVerdict::Viable { time, energy, remaining } => {
                    let chosen = record.chosen.get(role) == Some(robot);
                    let mark = if chosen { "  <- chosen" } else { "" };
                    ("bid", format!("{robot:10} {role:8} {}{mark}", price(time.get(), *energy, *remaining)))
                }
                BidVerdict::Unviable { time, energy, remaining, why } => {
                    let price = price(time.get(), *energy, *remaining);
                    ("unviable", format!("{robot:10} {role:8} {price}: {why}"))
                }
                BidVerdict::Refused { reason } => ("refusal", format!("{robot:10} {role:8} {reason}")),
                BidVerdict::NotAsked { reason, .. } => {
                    let robots = count(entry.robots().count(), "robot", "robots");
                    ("not asked", format!("{robots:10} {role:8} {reason}"))
                }
            };
            self.print_timed(at, label, text)?;
        }
        match &record.failure {
            Some(failure) => self.print_timed(at, "no award", format!("{mission}: {failure}")),
            None => Ok(()),
        }
    }

    fn progress(&mut self, at: Duration, mission: &MissionId, done: usize, steps: usize) -> Result<(), Failure> {
        if let Some(bars) = &self.bars {
            let bar = self.missions.entry(mission.clone()).or_insert_with(|| {
                let style = ProgressStyle::with_template("  {msg:20} [{bar:40}] {pos}/{len} steps");
                let bar = ProgressBar::new(steps as u64).with_style(style.expect("the template is sound"));
                bars.add(bar.with_message(mission.to_string()))
            });
            bar.set_position(done as u64);
            return Ok(());
        }
        let filled = done * BAR / steps.max(1);
        let bar: String = (0..BAR).map(|index| if index < filled { '#' } else { '.' }).collect();
        self.print_timed(at, "progress", format!("{mission} [{bar}] {done}/{steps}"))
    }

    fn print_timed(&self, at: Duration, label: &str, text: String) -> Result<(), Failure> {
        self.print(format!("{:8.3}   {label:11} {text}", seconds(at)))
    }

    fn print_json(&self, line: &impl Serialize) -> Result<(), Failure> {
        self.print(serde_json::to_string(line).expect("events are plain data"))
    }

    fn print(&self, text: String) -> Result<(), Failure> {
        match &self.bars {
            Some(bars) => bars.suspend(|| output::line(text)),
            None => output::line(text),
        }
    }
}

fn seconds(at: Duration) -> f64 {
    (at.as_secs_f64() * 1000.0).round() / 1000.0
}
