//! Effects of orders: what they change, and the robots, roles and missions that they affect.

use crate::tui::listed;
use crate::tui::order::{NamedPart, Order};
use consort_dashboard::fleet_model::{FleetModel, RobotModel};
use consort_protocol::api::{HOLD_S, RobotSelection, ScheduleAction};
use consort_protocol::ids::{MissionId, RobotId, RoleId, ZoneId};
use consort_protocol::ledger::RolePhase;
use consort_text::count;

/// Returns the question before an order is sent: the order and its effect.
pub(super) fn question(order: &Order, model: &FleetModel) -> String {
    format!("{}? {}", capitalized(&order.to_string()), effect(order, model))
}

fn effect(order: &Order, model: &FleetModel) -> String {
    match order {
        Order::Hold { robots: RobotSelection::Named(robots), for_s, .. } => {
            let (minutes, roles) = (for_s.unwrap_or(HOLD_S) / 60, roles_of(robots, model));
            format!("It stands still at once for {minutes} min, and keeps {roles}. This is not an emergency stop.")
        }
        Order::Hold { robots, for_s, .. } => {
            let (minutes, robots) = (for_s.unwrap_or(HOLD_S) / 60, members_text(robots, model, |_| true));
            format!(
                "They stand still at once for {minutes} min, and keep their roles: {robots}. This is not an emergency \
                 stop."
            )
        }
        Order::Release(RobotSelection::Named(robots)) => format!("It continues {}.", roles_of(robots, model)),
        Order::Release(robots) => {
            let held = members_text(robots, model, |robot| robot.orders.hold.is_some());
            format!("Held robots continue their roles: {held}.")
        }
        Order::BeginMaintenance { robot, until, .. } => {
            let until = until.as_ref().map(|until| format!(" until {until}")).unwrap_or_default();
            format!("It completes {}, and gets no other{until}.", role_of(model, robot.as_str()))
        }
        Order::EndMaintenance(_) => "It gets roles again.".to_owned(),
        Order::Cancel(mission) => match holders([mission], model) {
            robots if robots.is_empty() => "No robot has a role of it.".to_owned(),
            robots => format!("Its robots stop safely: {}.", listed(robots)),
        },
        Order::CancelAll(missions) => {
            let number = count(missions.len(), "mission", "missions");
            match holders(missions, model) {
                robots if robots.is_empty() => format!("{number}, without a robot."),
                robots => format!("{number}; robots stop safely: {}.", listed(robots)),
            }
        }
        Order::SetPriority { .. } => "Roles that robots hold stay with them.".to_owned(),
        Order::Reassign { mission, role, to, repeat } => {
            let to = to.as_ref().map_or("another robot", RobotId::as_str);
            let repeat = if *repeat { " Tasks of it that have ended are repeated." } else { "" };
            format!("{}{repeat}", reassign_effect(held_by(mission, role, model), to))
        }
        Order::Pin { robot: Some(robot), .. } => {
            format!("No other robot gets it from now on, also after a loss of {robot}.")
        }
        Order::Pin { mission, role, robot: None } => {
            let order = model.missions().get(mission.as_str()).and_then(|mission| mission.orders.get(role.as_str()));
            let order = order.map(|order| format!("It is {order}. ")).unwrap_or_default();
            format!("{order}Any robot may get it.")
        }
        Order::Close { part, for_s, .. } => format!(
            "No robot enters it{}; there or on the way: {}. This is not a safety function.",
            length_text(*for_s),
            robots_at(model, part)
        ),
        Order::Open(_) => "Robots may enter it again.".to_owned(),
        Order::Limit { part, for_s, .. } => format!(
            "Robots drive no faster there{}; there or on the way: {}. Of several limits the lowest holds. This is not a \
             safety function.",
            length_text(*for_s),
            robots_at(model, part)
        ),
        Order::ClearLimit(_) => "Robots drive at their own speed there, or at that of other limits.".to_owned(),
        Order::RaiseAlarm { alarm, .. } => {
            let plan = model.declared_alarms().get(alarm.as_str());
            let plan = plan.map_or("It is not in the fleet file".to_owned(), |plan| capitalized(&plan.text()));
            let held = model.robots().values().filter(|robot| robot.mission.is_some()).count();
            let waiting = model.missions().values().filter(|mission| !mission.ended).count();
            let roles = count(held, "robot suspends its role", "robots suspend their roles");
            let missions = count(waiting, "mission waits", "missions wait");
            format!("{plan}; {roles}, {missions}. This is not a safety function.")
        }
        Order::ClearAlarm(_) if model.alarms().len() > 1 => "Robots still obey the other alarms.".to_owned(),
        Order::ClearAlarm(_) => "Robots continue their roles.".to_owned(),
        Order::ChangeSchedule { action, .. } => match action {
            ScheduleAction::Add => "Its occurrences are submitted.".to_owned(),
            ScheduleAction::Pause => "Its occurrences are left out until it is resumed.".to_owned(),
            ScheduleAction::Resume => {
                "Its next occurrences are submitted; what it missed in the pause is left out.".to_owned()
            }
            ScheduleAction::Remove => "Its missions go on.".to_owned(),
        },
    }
}

/// Describes the role that a robot holds.
fn role_of(model: &FleetModel, robot: &str) -> String {
    let held = model.robots().get(robot).and_then(|robot| Some((robot.role.as_ref()?, robot.mission.as_ref()?)));
    held.map_or("no role".to_owned(), |(role, mission)| format!("{role} of {mission}"))
}

fn roles_of<'a>(robots: impl IntoIterator<Item = &'a RobotId>, model: &FleetModel) -> String {
    listed(robots.into_iter().map(|robot| role_of(model, robot.as_str())))
}

/// Lists the robots of a selection that meet a condition, with the number of their roles.
fn members_text(selection: &RobotSelection, model: &FleetModel, is_meant: impl Fn(&RobotModel) -> bool) -> String {
    // The coordinator rejects an unknown zone.
    let selected = model.selected(selection).unwrap_or_default();
    let robots = selected.iter().filter_map(|name| Some((name, model.robots().get(name.as_str())?)));
    let (names, robots): (Vec<&RobotId>, Vec<&RobotModel>) = robots.filter(|(_, robot)| is_meant(robot)).unzip();
    let held = robots.into_iter().filter(|robot| robot.mission.is_some()).count();
    match names.as_slice() {
        [] => "no robot now".to_owned(),
        names => format!("{}, with {}", listed(names), count(held, "role", "roles")),
    }
}

/// Returns the robots with roles of missions, each once.
fn holders<'a, 'm>(missions: impl IntoIterator<Item = &'a MissionId>, model: &'m FleetModel) -> Vec<&'m str> {
    let missions = missions.into_iter().filter_map(|mission| model.missions().get(mission.as_str()));
    let mut robots: Vec<&str> = missions.flat_map(|mission| mission.holders.values().map(String::as_str)).collect();
    robots.sort_unstable();
    robots.dedup();
    robots
}

/// Returns the robot of a role, and whether the role is only promised to it.
fn held_by<'m>(mission: &MissionId, role: &RoleId, model: &'m FleetModel) -> Option<(&'m str, bool)> {
    let role = model.missions().get(mission.as_str())?.roles.get(role.as_str())?;
    Some((role.holder.as_deref()?, role.phase == RolePhase::Promised))
}

fn reassign_effect(held_by: Option<(&str, bool)>, to: &str) -> String {
    match held_by {
        None => format!("No robot has it yet; {to} gets it."),
        Some((holder, true)) => format!("{holder} does not get it, and {to} starts it from its beginning."),
        Some((holder, false)) => format!(
            "{holder} returns it at rest, and {to} starts it from its beginning. It stays with {holder} if that has an \
             item in it, or if other roles have acted on its work."
        ),
    }
}

fn length_text(for_s: Option<u32>) -> String {
    for_s.map(|seconds| format!(" for {} min", seconds / 60)).unwrap_or_default()
}

/// Lists the robots that are at a place, in a zone or on a lane, or on their way through it.
fn robots_at(model: &FleetModel, part: &NamedPart) -> String {
    let is_affected = |robot: &RobotModel| {
        let ahead: Vec<&str> = std::iter::once(&robot.place).chain(&robot.route).map(String::as_str).collect();
        match part {
            NamedPart::PlaceOrZone(name) => match model.zones().get(&ZoneId::from(name.clone())) {
                Some(zone) => zone.iter().any(|within| ahead.contains(&within.as_str())),
                None => ahead.contains(&name.as_str()),
            },
            NamedPart::Lane(a, b) => {
                let (a, b) = (a.as_str(), b.as_str());
                ahead.windows(2).any(|leg| leg == [a, b] || leg == [b, a])
            }
        }
    };
    let robots = model.robots().iter().filter(|(_, robot)| is_affected(robot));
    let names: Vec<&String> = robots.map(|(name, _)| name).collect();
    if names.is_empty() { "no robot".to_owned() } else { listed(names) }
}

fn capitalized(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}
