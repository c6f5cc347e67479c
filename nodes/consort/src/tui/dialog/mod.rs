//! The dialog about an order, on the last lines of the terminal: a state machine that takes keys and returns the order
//! that the user has confirmed.
//!
//! ```text
//! key ──▶ [a name or number] ──▶ [a reason] ──▶ "Hold ada? …" ── y ──▶ Order
//!                  Esc leaves the dialog at any time
//! ```

use super::order::Order;
use super::{Panel, panels};
use consort_dashboard::fleet_model::FleetModel;
use consort_protocol::ids::{AlarmId, MissionId, NameError, PlaceId, RobotId};
use consort_protocol::ledger::{MapPart, Priority};
use consort_text::count;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// Maximum number of characters of a field.
const CHARS_MAX: usize = 200;

/// Kind of an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Hold,
    Release,
    BeginMaintenance,
    EndMaintenance,
    Cancel,
    SetPriority,
    Close,
    Open,
    RaiseAlarm,
    ClearAlarm,
}

/// What the dialog asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// A name or a number.
    Argument,
    /// A reason.
    Reason,
    /// The confirmation.
    Confirmation,
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
    /// Not a priority.
    #[error("a priority is a whole number from -100 to 100")]
    NoPriority,
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
    /// The selected robot or mission; empty if the order is about neither.
    selected: String,
    /// The name or number.
    argument: String,
    reason: String,
    stage: Stage,
    problem: Option<Problem>,
}

impl Kind {
    /// Returns the order of a key. Orders about robots and missions need the focus on their panels.
    fn of_key(key: KeyEvent, focus: Panel) -> Option<Kind> {
        if key.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT) {
            return None;
        }
        match (key.code, focus) {
            (KeyCode::Char('h'), Panel::Robots) => Some(Kind::Hold),
            (KeyCode::Char('r'), Panel::Robots) => Some(Kind::Release),
            (KeyCode::Char('m'), Panel::Robots) => Some(Kind::BeginMaintenance),
            (KeyCode::Char('e'), Panel::Robots) => Some(Kind::EndMaintenance),
            (KeyCode::Char('x'), Panel::Missions) => Some(Kind::Cancel),
            (KeyCode::Char('p'), Panel::Missions) => Some(Kind::SetPriority),
            (KeyCode::Char('c'), _) => Some(Kind::Close),
            (KeyCode::Char('o'), _) => Some(Kind::Open),
            (KeyCode::Char('a'), _) => Some(Kind::RaiseAlarm),
            (KeyCode::Char('A'), _) => Some(Kind::ClearAlarm),
            _ => None,
        }
    }

    fn first_stage(self) -> Stage {
        match self {
            Kind::SetPriority | Kind::Close | Kind::Open | Kind::RaiseAlarm | Kind::ClearAlarm => Stage::Argument,
            _ => self.stage_after_argument(),
        }
    }

    fn stage_after_argument(self) -> Stage {
        match self {
            Kind::Hold | Kind::BeginMaintenance | Kind::Close | Kind::RaiseAlarm => Stage::Reason,
            _ => Stage::Confirmation,
        }
    }

    /// Returns the names from which the user chooses.
    fn choices(self, model: &FleetModel) -> Vec<String> {
        match self {
            Kind::Open => model.closures().keys().cloned().collect(),
            Kind::RaiseAlarm => model.declared_alarms().keys().cloned().collect(),
            Kind::ClearAlarm => model.alarms().keys().cloned().collect(),
            _ => vec![],
        }
    }
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
        let choices = kind.choices(model);
        let no_choice = |text| if choices.is_empty() { Err(Problem::NoChoice(text)) } else { Ok(String::new()) };
        let selected = match kind {
            Kind::Hold | Kind::Release | Kind::BeginMaintenance | Kind::EndMaintenance => {
                model.robots().keys().nth(row).cloned().ok_or(Problem::NoSelection("robot"))?
            }
            Kind::Cancel | Kind::SetPriority => match panels::latest_missions(model).get(row) {
                Some((id, mission)) if mission.ended => return Err(Problem::Ended((*id).clone())),
                Some((id, _)) => (*id).clone(),
                None => return Err(Problem::NoSelection("mission")),
            },
            Kind::Close => String::new(),
            Kind::Open if !model.knows_orders() => no_choice("the closures are unknown to this node")?,
            Kind::Open => no_choice("nothing is closed")?,
            Kind::RaiseAlarm => no_choice("the fleet file declares no alarms")?,
            Kind::ClearAlarm if !model.knows_orders() => no_choice("the alarms are unknown to this node")?,
            Kind::ClearAlarm => no_choice("no alarm is in force")?,
        };
        let argument = match <[String; 1]>::try_from(choices) {
            Ok([only]) => only,
            Err(_) => String::new(),
        };
        let stage = kind.first_stage();
        Ok(Dialog { kind, selected, argument, reason: String::new(), stage, problem: None })
    }

    /// Handles a key press.
    pub(super) fn handle_key(&mut self, key: KeyEvent, model: &FleetModel) -> Outcome {
        self.problem = None;
        if key.code == KeyCode::Esc {
            return Outcome::Left;
        }
        let field = match self.stage {
            Stage::Argument => &mut self.argument,
            Stage::Reason => &mut self.reason,
            Stage::Confirmation => return self.confirm(key, model),
        };
        match key.code {
            KeyCode::Enter => self.next_stage(model),
            KeyCode::Backspace => {
                field.pop();
            }
            KeyCode::Char(letter)
                if !key.modifiers.contains(KeyModifiers::CONTROL) && field.chars().count() < CHARS_MAX =>
            {
                field.push(letter);
            }
            _ => {}
        }
        Outcome::Open
    }

    /// Sends the order with `y`; any other key leaves the dialog.
    fn confirm(&mut self, key: KeyEvent, model: &FleetModel) -> Outcome {
        if !matches!(key.code, KeyCode::Char('y' | 'Y')) {
            return Outcome::Left;
        }
        match self.order(model) {
            Ok(order) => Outcome::Confirmed(order),
            Err(problem) => {
                self.problem = Some(problem);
                Outcome::Open
            }
        }
    }

    fn next_stage(&mut self, model: &FleetModel) {
        let next = match self.stage {
            Stage::Argument => self.kind.stage_after_argument(),
            Stage::Reason | Stage::Confirmation => Stage::Confirmation,
        };
        match self.order(model) {
            Ok(_) => self.stage = next,
            Err(problem) => self.problem = Some(problem),
        }
    }

    /// Returns the order as far as it is given.
    fn order(&self, model: &FleetModel) -> Result<Order, Problem> {
        let (argument, reason) = (self.argument.trim(), self.reason.trim().to_owned());
        let robot = || RobotId::new(self.selected.as_str());
        let mission = || MissionId::new(self.selected.as_str());
        Ok(match self.kind {
            Kind::Hold => Order::Hold { robot: robot()?, reason },
            Kind::Release => Order::Release(robot()?),
            Kind::BeginMaintenance if reason.is_empty() => return Err(Problem::NoReason),
            Kind::BeginMaintenance => Order::BeginMaintenance { robot: robot()?, reason },
            Kind::EndMaintenance => Order::EndMaintenance(robot()?),
            Kind::Cancel => Order::Cancel(mission()?),
            Kind::SetPriority => {
                let number = argument.parse().map_err(|_| Problem::NoPriority)?;
                let priority = Priority::new(number).map_err(|_| Problem::NoPriority)?;
                Order::SetPriority { mission: mission()?, priority }
            }
            Kind::Close => Order::Close { place: PlaceId::new(zone_or_place(argument))?, reason },
            Kind::Open => match model.closures().get(argument).map(|closure| &closure.part) {
                Some(MapPart::Lane(a, b)) => Order::OpenLane(a.clone(), b.clone()),
                Some(MapPart::Zone(_) | MapPart::Place(_)) | None => {
                    Order::OpenPlace(PlaceId::new(zone_or_place(argument))?)
                }
            },
            Kind::RaiseAlarm => Order::RaiseAlarm { alarm: AlarmId::new(argument)?, reason },
            Kind::ClearAlarm => Order::ClearAlarm(AlarmId::new(argument)?),
        })
    }

    /// Returns the text of the dialog: what it asks for, and what the user has entered.
    pub(super) fn text(&self, model: &FleetModel) -> String {
        let asked = match self.stage {
            Stage::Argument => {
                format!(" {}: {}▏  Enter continues, Esc leaves", self.argument_label(model), self.argument)
            }
            Stage::Reason => format!(" Reason: {}▏  Enter continues, Esc leaves", self.reason),
            Stage::Confirmation => format!(" {}  y sends it, any other key leaves", self.question(model)),
        };
        match &self.problem {
            Some(problem) => format!("{asked}\n {problem}"),
            None => asked,
        }
    }

    fn argument_label(&self, model: &FleetModel) -> String {
        let label = match self.kind {
            Kind::SetPriority => return format!("Priority of {}, -100 to 100", self.selected),
            Kind::Open => "Place, zone or lane to open",
            Kind::RaiseAlarm => "Alarm to raise",
            Kind::ClearAlarm => "Alarm to clear",
            _ => return "Place or zone to close".to_owned(),
        };
        format!("{label} ({})", self.kind.choices(model).join(", "))
    }

    /// Returns the question before the order is sent: its effect, and what it affects.
    fn question(&self, model: &FleetModel) -> String {
        let order = match self.order(model) {
            Ok(order) => capitalized(&order.to_string()),
            Err(problem) => return problem.to_string(),
        };
        let role = || role_of(model, &self.selected);
        let effect = match self.kind {
            Kind::Hold => {
                let role = role();
                format!("It stands still at once for 10 min, and keeps {role}. This is not an emergency stop.")
            }
            Kind::Release => format!("It continues {}.", role()),
            Kind::BeginMaintenance => format!("It completes {}, and gets no other.", role()),
            Kind::EndMaintenance => "It gets roles again.".to_owned(),
            Kind::Cancel => {
                let holders = model.missions().get(&self.selected).map(|mission| &mission.holders);
                let robots: Vec<&str> = holders.into_iter().flatten().map(|(_, robot)| robot.as_str()).collect();
                if robots.is_empty() {
                    "No robot has a role of it.".to_owned()
                } else {
                    format!("Its robots stop safely: {}.", robots.join(", "))
                }
            }
            Kind::SetPriority => "Roles that robots hold stay with them.".to_owned(),
            Kind::Close => {
                let affected = robots_at(model, self.argument.trim());
                format!("No robot enters it; there or on the way: {affected}. This is not a safety function.")
            }
            Kind::Open => "Robots may enter it again.".to_owned(),
            Kind::RaiseAlarm => {
                let plan = model.declared_alarms().get(self.argument.trim());
                let plan = plan.map_or("It is not in the fleet file".to_owned(), |plan| capitalized(&plan.text()));
                let held = model.robots().values().filter(|robot| robot.mission.is_some()).count();
                let waiting = model.missions().values().filter(|mission| !mission.ended).count();
                let roles = count(held, "robot suspends its role", "robots suspend their roles");
                let missions = count(waiting, "mission waits", "missions wait");
                format!("{plan}; {roles}, {missions}. This is not a safety function.")
            }
            Kind::ClearAlarm if model.alarms().len() > 1 => "Robots still obey the other alarms.".to_owned(),
            Kind::ClearAlarm => "Robots continue their roles.".to_owned(),
        };
        format!("{order}? {effect}")
    }
}

/// Returns the name of a place or zone without the word before that of a zone.
fn zone_or_place(text: &str) -> &str {
    text.strip_prefix("zone ").unwrap_or(text)
}

/// Describes the role that a robot holds.
fn role_of(model: &FleetModel, robot: &str) -> String {
    let held = model.robots().get(robot).and_then(|robot| Some((robot.role.as_ref()?, robot.mission.as_ref()?)));
    held.map_or("no role".to_owned(), |(role, mission)| format!("{role} of {mission}"))
}

/// Lists the robots that are at a place or in a zone, or on their way through it.
fn robots_at(model: &FleetModel, name: &str) -> String {
    let name = zone_or_place(name);
    let is_within = |place: &String| match model.zones().get(name) {
        Some(zone) => zone.iter().any(|within| within.as_str() == place),
        None => place == name,
    };
    let robots = model.robots().iter().filter(|(_, robot)| robot.route.iter().chain([&robot.place]).any(is_within));
    let names: Vec<&str> = robots.map(|(name, _)| name.as_str()).collect();
    if names.is_empty() { "no robot".to_owned() } else { names.join(", ") }
}

fn capitalized(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

#[cfg(test)]
mod tests;
