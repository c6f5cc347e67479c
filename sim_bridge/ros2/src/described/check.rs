//! Checks of a description without a robot: names, types, templates and paths.

use super::description::{ActionMapping, Hold, RobotDescription, Tables, Via};
use super::path::FieldPath;
use super::template;
use crate::dynamic::types::TypeRegistry;
use consort_protocol::ids::ActionName;
use serde_json::Value;

/// Values of the feedback that are no declared values.
pub(super) const STANDARD_FEEDBACK: [&str; 3] = ["distance_remaining_m", "time_remaining_s", "pose"];

/// Returns the problems of a description, each with its place.
pub fn problems(robot: &RobotDescription, types: &TypeRegistry) -> Vec<String> {
    let mut check = Check { types, tables: &robot.tables, problems: vec![] };
    check.namespace(robot);
    check.pose(robot);
    if let Some(charge) = &robot.charge {
        check.field("charge", &charge.type_name, &charge.field);
    }
    for (name, reading) in &robot.readings {
        check.field(&format!("readings.{name}"), &reading.type_name, &reading.field);
    }
    for (name, action) in &robot.actions {
        check.action(name, action);
    }
    check.problems
}

/// Returns the types that are not known and must be described by a node.
pub fn unknown_types(robot: &RobotDescription, types: &TypeRegistry) -> Vec<String> {
    let actions = robot.actions.values().flat_map(|action| {
        let until = action.until.as_ref().map(|until| until.type_name.clone());
        let hold = action.hold.as_ref().map(|hold| hold.type_name.clone());
        [Some(action.type_name.clone()), until, hold].into_iter().flatten()
    });
    let readings = robot.readings.values().map(|reading| reading.type_name.clone());
    let charge = robot.charge.iter().map(|charge| charge.type_name.clone());
    let pose = robot.pose.iter().filter_map(|pose| pose.type_name.clone());
    let mut unknown: Vec<String> = actions.chain(readings).chain(charge).chain(pose).collect();
    unknown.retain(|name| !types.defines(name));
    unknown.sort();
    unknown.dedup();
    unknown
}

struct Check<'a> {
    types: &'a TypeRegistry,
    tables: &'a Tables,
    problems: Vec<String>,
}

impl Check<'_> {
    fn add(&mut self, place: &str, problem: impl std::fmt::Display) {
        self.problems.push(format!("{place}: {problem}"));
    }

    fn namespace(&mut self, robot: &RobotDescription) {
        let valid = |letter: char| letter.is_ascii_alphanumeric() || letter == '_' || letter == '/';
        if !robot.namespace.chars().all(valid) {
            self.add(
                "namespace",
                format!("{:?} is no name of ROS 2; allowed: letters, digits, _ and /", robot.namespace),
            );
        }
    }

    fn pose(&mut self, robot: &RobotDescription) {
        let Some(pose) = &robot.pose else { return };
        match (&pose.topic, &pose.type_name, &pose.tf) {
            (Some(_), Some(type_name), None) => {
                let field = pose.field.as_deref().unwrap_or("pose.pose");
                self.field("pose", type_name, &format!("{field}.position.x"));
            }
            (None, None, Some(_)) => {}
            _ => self.add("pose", "allowed is either `topic` with `type`, or `tf`"),
        }
    }

    fn field(&mut self, place: &str, type_name: &str, path: &str) {
        self.type_name(place, type_name, "msg");
        let checked = FieldPath::parse(path).and_then(|path| path.check(self.types, type_name));
        if let Err(problem) = checked {
            self.add(&format!("{place}.field"), problem);
        }
    }

    fn type_name(&mut self, place: &str, name: &str, kind: &str) {
        let parts: Vec<&str> = name.split('/').collect();
        if parts.len() != 3 || parts[1] != kind || parts.iter().any(|part| part.is_empty()) {
            self.add(&format!("{place}.type"), format!("{name:?} is no type; allowed is package/{kind}/Name"));
        }
    }

    fn action(&mut self, name: &str, action: &ActionMapping) {
        let place = format!("actions.{name}");
        if let Err(problem) = name.parse::<ActionName>() {
            self.add(&place, problem);
        }
        let Some(via) = action.via() else {
            return self.add(&place, "allowed is exactly one of `action`, `service` and `topic`");
        };
        let kind = match via {
            Via::Action(_) => "action",
            Via::Service(_) => "srv",
            Via::Topic(_) => "msg",
        };
        self.type_name(&place, &action.type_name, kind);
        self.template(&action.sent_type(), &action.send, &format!("{place}.send"));
        match action.result_type() {
            Some(result) => {
                let entries = action.results.iter().map(|(name, path)| (format!("results.{name}"), path));
                let single = [("succeeded", &action.succeeded), ("error_code", &action.error_code)];
                let single = single.into_iter().chain([("error_message", &action.error_message)]);
                let single = single.filter_map(|(key, path)| Some((key.to_owned(), path.as_ref()?)));
                for (key, path) in entries.chain(single) {
                    self.path(&format!("{place}.{key}"), path, &result);
                }
            }
            None if !action.results.is_empty() || action.succeeded.is_some() => {
                self.add(&place, "a topic has no result; allowed is `until`");
            }
            None => {}
        }
        if matches!(via, Via::Action(_)) {
            for (key, path) in &action.feedback {
                let feedback = format!("{}_Feedback", action.type_name);
                self.path(&format!("{place}.feedback.{key}"), path, &feedback);
            }
            if action.until.is_some() {
                self.add(&place, "an action has a result; `until` is for services and topics");
            }
        } else if !action.feedback.is_empty() {
            self.add(&place, "only an action has feedback");
        }
        if let Some(until) = &action.until {
            self.field(&format!("{place}.until"), &until.type_name, &until.field);
            self.template("", &until.equals, &format!("{place}.until.equals"));
        }
        if let Some(hold) = &action.hold {
            self.hold(&place, action, hold);
        }
        if action.within_s.is_some_and(|seconds| !(seconds > 0.0 && seconds <= 3600.0)) {
            self.add(&format!("{place}.within_s"), "allowed is a number of seconds from 0 to 3600");
        }
        if matches!(action.send, Value::Array(_) | Value::Bool(_) | Value::Number(_)) {
            self.add(&format!("{place}.send"), "allowed is the message by its fields");
        }
    }

    fn hold(&mut self, place: &str, action: &ActionMapping, hold: &Hold) {
        let place = format!("{place}.hold");
        if !matches!(action.via(), Some(Via::Topic(_))) || action.until.is_some() {
            self.add(&place, "only the goal of a `topic` without `until` can last until its cancel");
        }
        self.type_name(&place, &hold.type_name, "msg");
        self.template(&action.sent_type(), &hold.release, &format!("{place}.release"));
        for (key, values) in [("of", &hold.of), ("ready", &hold.ready), ("released", &hold.released)] {
            for (path, value) in values {
                let place = format!("{place}.{key}.{path}");
                self.path(&place, path, &hold.type_name);
                self.template("", value, &place);
            }
        }
        for (key, seconds) in [("repeat_s", hold.repeat_s), ("stale_s", hold.stale_s)] {
            if !(0.1..=3600.0).contains(&seconds) {
                self.add(&format!("{place}.{key}"), "allowed is a number of seconds from 0.1 to 3600");
            }
        }
    }

    fn template(&mut self, message: &str, template: &Value, place: &str) {
        if let Err(problem) = template::check(self.types, self.tables, message, template, place) {
            self.problems.push(problem.to_string());
        }
    }

    fn path(&mut self, place: &str, path: &str, message: &str) {
        if let Err(problem) = FieldPath::parse(path).and_then(|path| path.check(self.types, message)) {
            self.add(place, problem);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::description::{SHIPPED, load};
    use super::*;

    #[test]
    fn the_shipped_descriptions_have_no_problems() {
        let types = TypeRegistry::shipped();
        for (name, _) in SHIPPED {
            let robot = load(name).unwrap();
            assert_eq!(problems(&robot, &types), Vec::<String>::new(), "{name}");
            assert_eq!(unknown_types(&robot, &types), Vec::<String>::new(), "{name}");
        }
    }

    #[test]
    fn problems_name_the_place_and_what_is_allowed() {
        let text = "
namespace: a b
pose: { topic: odom }
charge: { topic: battery, field: percent }
readings:
  stop: { topic: stop, type: std_msgs/Bool, field: data }
actions:
  spin: { action: spin, type: nav2_msgs/action/Spin, send: { yaw: '${angle_rad}' }, results: { turned: angle } }
  blink: { topic: light, service: light, type: std_msgs/msg/Bool }
  'two words': { topic: light, type: std_msgs/msg/Bool, within_s: 0 }
  open: { service: open, type: std_srvs/srv/Trigger, hold: { release: { data: 1 }, topic: state, type: std_msgs/msg/Bool, ready: { open: true }, stale_s: 0 } }
  close: { topic: light, type: std_msgs/msg/Bool, send: { data: '${value[position]}' } }
";
        let robot: RobotDescription = serde_saphyr::from_str(text).unwrap();
        let problems = problems(&robot, &TypeRegistry::shipped());
        for part in [
            "namespace: \"a b\" is no name of ROS 2",
            "pose: allowed is either `topic` with `type`, or `tf`",
            "charge.field: sensor_msgs/msg/BatteryState has no field \"percent\"; allowed: header, voltage",
            "readings.stop.type: \"std_msgs/Bool\" is no type; allowed is package/msg/Name",
            "actions.blink: allowed is exactly one of `action`, `service` and `topic`",
            "actions.spin.send.yaw: nav2_msgs/action/Spin_Goal has no such field; allowed: target_yaw, time_allowance",
            "actions.spin.results.turned: nav2_msgs/action/Spin_Result has no field \"angle\"",
            "actions.two words.within_s: allowed is a number of seconds",
            "actions.open.hold: only the goal of a `topic`",
            "actions.open.hold.release.data: std_srvs/srv/Trigger_Request has no such field",
            "actions.open.hold.ready.open: std_msgs/msg/Bool has no field \"open\"",
            "actions.open.hold.stale_s: allowed is a number of seconds from 0.1",
            "actions.close.send.data: there is no table \"value\"",
        ] {
            assert!(problems.iter().any(|problem| problem.starts_with(part)), "{part}: {problems:#?}");
        }
    }
}
