//! The dialog about an order, on the last lines of the terminal: a state machine that takes keys and returns the order
//! that the user has confirmed.
//!
//! ```text
//! key ──▶ [field, such as a name] ──▶ … ──▶ [last field] ──▶ "Hold ada? …" ── y ──▶ Order
//!                  Esc leaves the dialog at any time
//! ```

mod effect;
mod kind;

use super::order::{NamedPart, Order, only};
use super::{Panel, panels};
use consort_dashboard::fleet_model::{FleetModel, MissionModel};
use consort_protocol::api::{
    AllRobots, CLOSE_S_MAX, HOLD_S_MAX, RobotSelection, RobotZone, SPEED_LIMIT_MIN_MPS, ScheduleAction,
    SelectionCondition,
};
use consort_protocol::ensemble::Eligibility;
use consort_protocol::ids::{AlarmId, MissionId, NameError, RobotId, RoleId, ScheduleId, ZoneId};
use consort_protocol::ledger::Priority;
use consort_protocol::units::MetresPerSecond;
use kind::{Field, Kind};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use std::collections::BTreeSet;

/// Maximum number of characters of a field.
const CHARS_MAX: usize = 200;

/// Word for all robots, and for all active missions.
const ALL: &str = "all";

/// Part of the dialog.
#[derive(Debug)]
enum Stage {
    /// The user enters the field with this number.
    Field(usize),
    /// The user confirms the order. It stays as shown, also if the fleet changes meanwhile.
    Confirmation(Order),
}

/// Reason why there is no order. The dialog goes on.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum Problem {
    /// The list is empty.
    #[error("no {0} is selected")]
    NoSelection(&'static str),
    /// It cannot be changed any more.
    #[error("{0} has ended")]
    Ended(String),
    /// There is nothing to open, to raise or to clear.
    #[error("{0}")]
    NoChoice(&'static str),
    /// The schedule is in the wanted state.
    #[error("the schedule {schedule} is {state}")]
    NoChange { schedule: String, state: &'static str },
    /// Not a priority.
    #[error("a priority is a whole number from -100 to 100")]
    NoPriority,
    /// Not a speed limit.
    #[error("a speed limit is a number of {SPEED_LIMIT_MIN_MPS} or more; close a part that no robot may enter")]
    NoSpeed,
    /// Not a time until the end, in minutes.
    #[error("the minutes are a whole number from 1 to {max}")]
    NoMinutes { max: u32 },
    /// Neither yes nor no.
    #[error("enter yes or no")]
    NoAnswer,
    /// Neither all robots, nor a zone, nor a condition.
    #[error("{text:?} is no zone, and no condition: {problem}")]
    NoGroup { text: String, problem: String },
    /// The text is empty, or no active mission has it.
    #[error("no active mission has this text")]
    NoMission,
    /// Other orders need none.
    #[error("maintenance needs a reason")]
    NoReason,
    /// Not a name of its kind.
    #[error(transparent)]
    Name(#[from] NameError),
}

/// Result of a key press.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// The dialog goes on.
    Open,
    /// The user has left the dialog.
    Left,
    /// The user has confirmed the order.
    Confirmed(Order),
}

/// A dialog about an order.
#[derive(Debug)]
pub(super) struct Dialog {
    kind: Kind,
    /// The selected robot, mission or schedule; empty if the order is about none of them.
    selected: String,
    /// The texts of the fields of the kind, in their order.
    texts: Vec<String>,
    stage: Stage,
    problem: Option<Problem>,
}

impl Dialog {
    /// Opens the dialog of a key; `None` if the key has none. `row` is the selected row of the panel with the focus.
    pub(super) fn of_key(
        key: KeyEvent,
        (focus, row): (Panel, usize),
        model: &FleetModel,
    ) -> Option<Result<Dialog, Problem>> {
        Some(Dialog::open(Kind::of_key(key, focus)?, row, model))
    }

    fn open(kind: Kind, row: usize, model: &FleetModel) -> Result<Dialog, Problem> {
        let selected = selected(kind, row, model)?;
        let choices = kind.choices(&selected, model);
        if let Some(problem) = no_choice(kind, model).filter(|_| choices.is_empty()) {
            return Err(Problem::NoChoice(problem));
        }
        let texts = kind.fields().iter().map(|field| kind.proposal(*field, &choices)).collect();
        let mut dialog = Dialog { kind, selected, texts, stage: Stage::Field(0), problem: None };
        if dialog.texts.is_empty() {
            dialog.stage = Stage::Confirmation(dialog.order(model)?);
        }
        Ok(dialog)
    }

    /// Handles a key press. The user sends the order with `y`; any other key leaves its confirmation.
    pub(super) fn handle_key(&mut self, key: KeyEvent, model: &FleetModel) -> Outcome {
        self.problem = None;
        let at = match &self.stage {
            _ if key.code == KeyCode::Esc => return Outcome::Left,
            Stage::Field(at) => *at,
            Stage::Confirmation(order) if matches!(key.code, KeyCode::Char('y' | 'Y')) => {
                return Outcome::Confirmed(order.clone());
            }
            Stage::Confirmation(_) => return Outcome::Left,
        };
        self.edit(at, key, model);
        Outcome::Open
    }

    /// Changes the text of a field, or continues with the next.
    fn edit(&mut self, at: usize, key: KeyEvent, model: &FleetModel) {
        let text = &mut self.texts[at];
        match key.code {
            KeyCode::Enter => match self.order(model) {
                Ok(order) if at + 1 == self.texts.len() => self.stage = Stage::Confirmation(order),
                Ok(_) => self.stage = Stage::Field(at + 1),
                Err(problem) => self.problem = Some(problem),
            },
            KeyCode::Backspace => {
                text.pop();
            }
            KeyCode::Char(letter)
                if !key.modifiers.contains(KeyModifiers::CONTROL) && text.chars().count() < CHARS_MAX =>
            {
                text.push(letter);
            }
            _ => {}
        }
    }

    /// Returns the text of a field without the space around it; nothing if the kind lacks the field.
    fn text_of(&self, field: Field) -> &str {
        let mut texts = self.kind.fields().iter().zip(&self.texts);
        texts.find(|(other, _)| **other == field).map(|(_, text)| text.trim()).unwrap_or_default()
    }

    /// Returns the order as far as it is given.
    fn order(&self, model: &FleetModel) -> Result<Order, Problem> {
        let reason = self.text_of(Field::Reason).to_owned();
        let robot = || RobotId::new(self.selected.as_str());
        let mission = || MissionId::new(self.selected.as_str());
        let schedule = |action| -> Result<Order, Problem> {
            Ok(Order::ChangeSchedule { schedule: ScheduleId::new(self.selected.as_str())?, action })
        };
        Ok(match self.kind {
            Kind::Hold => Order::Hold { robots: only(robot()?), for_s: self.for_s(HOLD_S_MAX)?, reason },
            Kind::Release => Order::Release(only(robot()?)),
            Kind::HoldGroup => Order::Hold { robots: self.group(model)?, for_s: self.for_s(HOLD_S_MAX)?, reason },
            Kind::ReleaseGroup => Order::Release(self.group(model)?),
            Kind::BeginMaintenance if reason.is_empty() => return Err(Problem::NoReason),
            Kind::BeginMaintenance => {
                let until = Some(self.text_of(Field::Until)).filter(|until| !until.is_empty());
                Order::BeginMaintenance { robot: robot()?, until: until.map(str::to_owned), reason }
            }
            Kind::EndMaintenance => Order::EndMaintenance(robot()?),
            Kind::Cancel => Order::Cancel(mission()?),
            Kind::CancelAll => Order::CancelAll(self.active_missions(model)?),
            Kind::SetPriority => {
                let number = self.text_of(Field::Priority).parse().map_err(|_| Problem::NoPriority)?;
                let priority = Priority::new(number).map_err(|_| Problem::NoPriority)?;
                Order::SetPriority { mission: mission()?, priority }
            }
            Kind::Reassign => {
                let (role, to) = (RoleId::new(self.text_of(Field::Role))?, self.robot()?);
                Order::Reassign { mission: mission()?, role, to, repeat: self.repeat()? }
            }
            Kind::Pin => {
                let (role, robot) = (RoleId::new(self.text_of(Field::Role))?, self.robot()?);
                Order::Pin { mission: mission()?, role, robot }
            }
            Kind::Close => Order::Close { part: self.part()?, for_s: self.for_s(CLOSE_S_MAX)?, reason },
            Kind::Open => Order::Open(match model.closures().get(self.text_of(Field::Part)) {
                Some(closure) => NamedPart::of(&closure.part)?,
                None => self.part()?,
            }),
            Kind::Limit => {
                let (part, speed, for_s) = (self.part()?, self.speed()?, self.for_s(CLOSE_S_MAX)?);
                Order::Limit { part, speed, for_s, reason }
            }
            Kind::ClearLimit => Order::ClearLimit(match model.speed_limits().get(self.text_of(Field::Part)) {
                Some(limit) => NamedPart::of(&limit.part)?,
                None => self.part()?,
            }),
            Kind::RaiseAlarm => Order::RaiseAlarm { alarm: AlarmId::new(self.text_of(Field::Alarm))?, reason },
            Kind::ClearAlarm => Order::ClearAlarm(AlarmId::new(self.text_of(Field::Alarm))?),
            Kind::PauseSchedule => schedule(ScheduleAction::Pause)?,
            Kind::ResumeSchedule => schedule(ScheduleAction::Resume)?,
            Kind::RemoveSchedule => schedule(ScheduleAction::Remove)?,
        })
    }

    /// Returns the robots of an order to several: all, those in a zone, or those that meet a condition.
    fn group(&self, model: &FleetModel) -> Result<RobotSelection, Problem> {
        let text = self.text_of(Field::Group);
        let is_zone = || model.zones().keys().any(|zone| zone.as_str() == text);
        let zone = text.strip_prefix("zone ").or_else(|| is_zone().then_some(text));
        match zone {
            _ if text == ALL => Ok(RobotSelection::All(AllRobots::All)),
            Some(zone) => Ok(RobotSelection::Zone(RobotZone { zone: ZoneId::new(zone.trim())? })),
            None => match Eligibility::compile(text) {
                Ok(_) => Ok(RobotSelection::Where(SelectionCondition { condition: text.to_owned() })),
                Err(problem) => Err(Problem::NoGroup { text: text.to_owned(), problem }),
            },
        }
    }

    /// Returns the active missions with the text in their ids, parameters or robots; upper and lower case are alike.
    fn active_missions(&self, model: &FleetModel) -> Result<BTreeSet<MissionId>, Problem> {
        let wanted = self.text_of(Field::Filter).to_lowercase();
        let has_text = |id: &String, mission: &MissionModel| {
            let mut texts = [id].into_iter().chain(mission.parameters.values()).chain(mission.holders.values());
            texts.any(|text| text.to_lowercase().contains(&wanted))
        };
        let is_meant = |(id, mission): &(&String, &MissionModel)| {
            !mission.ended && (wanted == ALL || !wanted.is_empty() && has_text(id, mission))
        };
        let missions = model.missions().iter().filter(is_meant).map(|(id, _)| MissionId::new(id.as_str()));
        let missions = missions.collect::<Result<BTreeSet<MissionId>, NameError>>()?;
        if missions.is_empty() { Err(Problem::NoMission) } else { Ok(missions) }
    }

    /// Returns the entered robot; `None` if the field is empty.
    fn robot(&self) -> Result<Option<RobotId>, NameError> {
        Some(self.text_of(Field::Robot)).filter(|name| !name.is_empty()).map(RobotId::new).transpose()
    }

    fn repeat(&self) -> Result<bool, Problem> {
        match self.text_of(Field::Repeat) {
            "" | "no" | "n" => Ok(false),
            "yes" | "y" => Ok(true),
            _ => Err(Problem::NoAnswer),
        }
    }

    fn part(&self) -> Result<NamedPart, NameError> {
        NamedPart::parse(self.text_of(Field::Part))
    }

    fn speed(&self) -> Result<MetresPerSecond, Problem> {
        let speed = self.text_of(Field::Speed).parse::<f64>().ok().and_then(|speed| MetresPerSecond::new(speed).ok());
        speed.filter(|speed| speed.get() >= SPEED_LIMIT_MIN_MPS).ok_or(Problem::NoSpeed)
    }

    /// Returns the seconds of the entered minutes, at most `max_s`; `None` if the field is empty.
    fn for_s(&self, max_s: u32) -> Result<Option<u32>, Problem> {
        let (text, max) = (self.text_of(Field::Minutes), max_s / 60);
        if text.is_empty() {
            return Ok(None);
        }
        let minutes = text.parse::<u32>().ok().filter(|minutes| (1..=max).contains(minutes));
        minutes.map(|minutes| Some(minutes * 60)).ok_or(Problem::NoMinutes { max })
    }

    /// Returns the text of the dialog: what it asks for, and what the user has entered.
    pub(super) fn text(&self, model: &FleetModel) -> String {
        let asked = match &self.stage {
            Stage::Field(at) => {
                let label = self.kind.label(self.kind.fields()[*at], &self.selected, model);
                format!(" {label}: {}▏  Enter continues, Esc leaves", self.texts[*at])
            }
            Stage::Confirmation(order) => {
                format!(" {}  y sends it, any other key leaves", effect::question(order, model))
            }
        };
        match &self.problem {
            Some(problem) => format!("{asked}\n {problem}"),
            None => asked,
        }
    }
}

/// Returns what the order is about: the robot, the mission or the schedule in a row; empty for other orders.
fn selected(kind: Kind, row: usize, model: &FleetModel) -> Result<String, Problem> {
    match kind {
        Kind::Hold | Kind::Release | Kind::BeginMaintenance | Kind::EndMaintenance => {
            model.robots().keys().nth(row).cloned().ok_or(Problem::NoSelection("robot"))
        }
        Kind::Cancel | Kind::SetPriority | Kind::Reassign | Kind::Pin => {
            match panels::latest_missions(model).get(row) {
                Some((id, mission)) if mission.ended => Err(Problem::Ended((*id).clone())),
                Some((id, _)) => Ok((*id).clone()),
                None => Err(Problem::NoSelection("mission")),
            }
        }
        Kind::PauseSchedule | Kind::ResumeSchedule | Kind::RemoveSchedule => {
            let (name, schedule) = model.schedules().iter().nth(row).ok_or(Problem::NoSelection("schedule"))?;
            let no_change = |state| Err(Problem::NoChange { schedule: name.clone(), state });
            match (kind, &schedule.view.pause) {
                (Kind::PauseSchedule, Some(_)) => no_change("paused already"),
                (Kind::ResumeSchedule, None) => no_change("not paused"),
                _ => Ok(name.clone()),
            }
        }
        _ => Ok(String::new()),
    }
}

/// Describes why the user has no choice; `None` if an order does not depend on a choice.
fn no_choice(kind: Kind, model: &FleetModel) -> Option<&'static str> {
    match kind {
        Kind::Open if !model.knows_orders() => Some("the closures are unknown to this node"),
        Kind::Open => Some("nothing is closed"),
        Kind::ClearLimit if !model.knows_orders() => Some("the speed limits are unknown to this node"),
        Kind::ClearLimit => Some("no speed is limited"),
        Kind::RaiseAlarm => Some("the fleet file declares no alarms"),
        Kind::ClearAlarm if !model.knows_orders() => Some("the alarms are unknown to this node"),
        Kind::ClearAlarm => Some("no alarm is in force"),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
