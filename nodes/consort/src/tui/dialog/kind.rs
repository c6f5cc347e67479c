//! Kinds of orders: their keys, the fields that they ask for, and the labels of these.

use crate::tui::{Panel, listed};
use consort_dashboard::fleet_model::FleetModel;
use consort_protocol::ledger::RolePhase;
use consort_protocol::mission::RoleKind;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// Kind of an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Hold,
    Release,
    BeginMaintenance,
    EndMaintenance,
    HoldGroup,
    ReleaseGroup,
    Cancel,
    CancelAll,
    SetPriority,
    Reassign,
    Pin,
    Close,
    Open,
    Limit,
    ClearLimit,
    RaiseAlarm,
    ClearAlarm,
    PauseSchedule,
    ResumeSchedule,
    RemoveSchedule,
}

/// What the user enters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Field {
    /// All robots, those in a zone, or those that meet a condition.
    Group,
    /// A text in missions.
    Filter,
    Priority,
    Role,
    /// A robot, or nothing.
    Robot,
    /// Whether tasks that have ended may be repeated.
    Repeat,
    /// A place, a zone or a lane.
    Part,
    Speed,
    Alarm,
    Reason,
    /// Number of minutes after which the order ends.
    Minutes,
    /// Time at which the order ends.
    Until,
}

/// Speed limit that is proposed, in metres per second.
const SPEED: &str = "0.3";

impl Kind {
    /// Returns the order of a key. Orders about robots, missions and schedules need the focus on their panels.
    pub(super) fn of_key(key: KeyEvent, focus: Panel) -> Option<Kind> {
        if key.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT) {
            return None;
        }
        match (key.code, focus) {
            (KeyCode::Char('h'), Panel::Robots) => Some(Kind::Hold),
            (KeyCode::Char('r'), Panel::Robots) => Some(Kind::Release),
            (KeyCode::Char('m'), Panel::Robots) => Some(Kind::BeginMaintenance),
            (KeyCode::Char('e'), Panel::Robots) => Some(Kind::EndMaintenance),
            (KeyCode::Char('x'), Panel::Missions) => Some(Kind::Cancel),
            (KeyCode::Char('X'), Panel::Missions) => Some(Kind::CancelAll),
            (KeyCode::Char('p'), Panel::Missions) => Some(Kind::SetPriority),
            (KeyCode::Char('r'), Panel::Missions) => Some(Kind::Reassign),
            (KeyCode::Char('n'), Panel::Missions) => Some(Kind::Pin),
            (KeyCode::Char('p'), Panel::Schedules) => Some(Kind::PauseSchedule),
            (KeyCode::Char('r'), Panel::Schedules) => Some(Kind::ResumeSchedule),
            (KeyCode::Char('x'), Panel::Schedules) => Some(Kind::RemoveSchedule),
            (KeyCode::Char('H'), _) => Some(Kind::HoldGroup),
            (KeyCode::Char('R'), _) => Some(Kind::ReleaseGroup),
            (KeyCode::Char('c'), _) => Some(Kind::Close),
            (KeyCode::Char('o'), _) => Some(Kind::Open),
            (KeyCode::Char('l'), _) => Some(Kind::Limit),
            (KeyCode::Char('L'), _) => Some(Kind::ClearLimit),
            (KeyCode::Char('a'), _) => Some(Kind::RaiseAlarm),
            (KeyCode::Char('A'), _) => Some(Kind::ClearAlarm),
            _ => None,
        }
    }

    /// Returns the fields, in the order in which the user enters them. Each Enter checks the whole order, so a field must
    /// be valid with its [proposal](Kind::proposal) once the user has entered the fields before it.
    pub(super) fn fields(self) -> &'static [Field] {
        match self {
            Kind::Hold => &[Field::Reason, Field::Minutes],
            Kind::HoldGroup => &[Field::Group, Field::Reason, Field::Minutes],
            Kind::ReleaseGroup => &[Field::Group],
            Kind::BeginMaintenance => &[Field::Reason, Field::Until],
            Kind::CancelAll => &[Field::Filter],
            Kind::SetPriority => &[Field::Priority],
            Kind::Reassign => &[Field::Role, Field::Robot, Field::Repeat],
            Kind::Pin => &[Field::Role, Field::Robot],
            Kind::Close => &[Field::Part, Field::Reason, Field::Minutes],
            Kind::Limit => &[Field::Part, Field::Speed, Field::Reason, Field::Minutes],
            Kind::Open | Kind::ClearLimit => &[Field::Part],
            Kind::RaiseAlarm => &[Field::Alarm, Field::Reason],
            Kind::ClearAlarm => &[Field::Alarm],
            Kind::Release
            | Kind::EndMaintenance
            | Kind::Cancel
            | Kind::PauseSchedule
            | Kind::ResumeSchedule
            | Kind::RemoveSchedule => &[],
        }
    }

    /// Returns the names from which the user chooses. `selected` is the selected mission of an order about a role.
    pub(super) fn choices(self, selected: &str, model: &FleetModel) -> Vec<String> {
        match self {
            Kind::Open => model.closures().keys().cloned().collect(),
            Kind::ClearLimit => model.speed_limits().keys().cloned().collect(),
            Kind::RaiseAlarm => model.declared_alarms().keys().cloned().collect(),
            Kind::ClearAlarm => model.alarms().keys().cloned().collect(),
            Kind::Reassign | Kind::Pin => open_roles(selected, model),
            _ => vec![],
        }
    }

    /// Returns the text that is in a field at first: the only choice, or a usual value.
    pub(super) fn proposal(self, field: Field, choices: &[String]) -> String {
        match (field, choices) {
            (Field::Part | Field::Alarm | Field::Role, [only]) => only.clone(),
            (Field::Speed, _) => SPEED.to_owned(),
            _ => String::new(),
        }
    }

    /// Returns the label of a field.
    pub(super) fn label(self, field: Field, selected: &str, model: &FleetModel) -> String {
        let choose = |text| with_names(text, self.choices(selected, model));
        match (field, self) {
            (Field::Group, _) => {
                let verb = if self == Kind::HoldGroup { "hold" } else { "release" };
                format!("Robots to {verb}: all, {}, or a condition", with_names("a zone", model.zones().keys()))
            }
            (Field::Filter, _) => "Missions to cancel: a text in their names, parameters or robots, or all".to_owned(),
            (Field::Priority, _) => format!("Priority of {selected}, -100 to 100"),
            (Field::Role, Kind::Pin) => choose("Role to pin, or to unpin"),
            (Field::Role, _) => choose("Role to reassign"),
            (Field::Robot, Kind::Pin) => "Only robot that may get it (nothing: any)".to_owned(),
            (Field::Robot, _) => "Robot that gets it (nothing: any other)".to_owned(),
            (Field::Repeat, _) => "May tasks of it that have ended be repeated? yes or no (nothing: no)".to_owned(),
            (Field::Part, Kind::Open) => choose("Place, zone or lane to open"),
            (Field::Part, Kind::ClearLimit) => choose("Place, zone or lane with the limit to clear"),
            (Field::Part, Kind::Limit) => "Place, zone or lane (A -- B) with the limit".to_owned(),
            (Field::Part, _) => "Place, zone or lane (A -- B) to close".to_owned(),
            (Field::Speed, _) => "Highest speed in metres per second".to_owned(),
            (Field::Alarm, Kind::RaiseAlarm) => choose("Alarm to raise"),
            (Field::Alarm, _) => choose("Alarm to clear"),
            (Field::Reason, _) => "Reason".to_owned(),
            (Field::Minutes, Kind::Hold | Kind::HoldGroup) => "Minutes until it ends (nothing: 10)".to_owned(),
            (Field::Minutes, _) => "Minutes until it ends (nothing: no end)".to_owned(),
            (Field::Until, _) => "Its end, as 2026-12-31T18:00:00+01:00 (nothing: no end)".to_owned(),
        }
    }
}

/// Adds the names to choose from to a label. The roles of a mission are unknown until its own view has arrived.
fn with_names(text: &str, names: impl IntoIterator<Item: ToString>) -> String {
    let names = listed(names);
    if names.is_empty() { text.to_owned() } else { format!("{text} ({names})") }
}

/// Returns the roles of robots in a mission that have not ended.
fn open_roles(mission: &str, model: &FleetModel) -> Vec<String> {
    let roles = model.missions().get(mission).into_iter().flat_map(|mission| &mission.roles);
    let open = roles.filter(|(_, role)| role.kind == RoleKind::Managed && role.phase != RolePhase::Ended);
    open.map(|(name, _)| name.clone()).collect()
}
