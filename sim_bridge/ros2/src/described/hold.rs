//! A goal that lasts until its cancel, as that of a door or a lift: a message is repeated, and the
//! state of the device on a topic tells whether it is ready.

use super::description::{Hold, Via};
use super::execution::{Execution, RobotGoal, end_of_call, is_same, requested, within};
use super::path::FieldPath;
use super::session::End;
use super::template::{self, Scope, fill};
use crate::mapping::seconds_now;
use consort_driver::DriverMessage;
use consort_protocol::scalar::Scalar;
use consort_skills::actions::{GoalId, JsonObject};
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::sync::mpsc::unbounded_channel;
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior, interval};
use tracing::warn;

/// Values of fields.
type Fields = Vec<(FieldPath, Value)>;

/// Whether a device is ready or released, from the messages about its state.
#[derive(Debug)]
struct DeviceState {
    /// Values of the messages about this device.
    of: Fields,
    ready: Fields,
    released: Fields,
    stale_after: Duration,
    /// Time of the latest state with which it is ready.
    ready_at: Option<Instant>,
    is_released: bool,
}

impl DeviceState {
    fn new(hold: &Hold, scope: &Scope<'_>) -> Result<DeviceState, String> {
        let fields = |entries: &BTreeMap<String, Value>| -> Result<Fields, String> {
            let value = |(path, value): (&String, &Value)| -> Result<(FieldPath, Value), String> {
                let path = FieldPath::parse(path).map_err(|problem| problem.to_string())?;
                let value = template::value(value, scope).map_err(|problem| problem.to_string())?;
                // A value that is missing equals no field.
                Ok((path, value.unwrap_or_default()))
            };
            entries.iter().map(value).collect()
        };
        Ok(DeviceState {
            of: fields(&hold.of)?,
            ready: fields(&hold.ready)?,
            released: fields(&hold.released)?,
            stale_after: Duration::from_secs_f64(hold.stale_s),
            ready_at: None,
            is_released: hold.released.is_empty(),
        })
    }

    /// Handles a message about the state of a device.
    fn handle(&mut self, message: &Value, now: Instant) {
        let fits = |fields: &Fields| {
            fields.iter().all(|(path, expected)| path.get(message).is_some_and(|value| is_same(value, expected)))
        };
        if fits(&self.of) {
            self.ready_at = fits(&self.ready).then_some(now);
            self.is_released = fits(&self.released);
        }
    }

    fn is_ready(&self, now: Instant) -> bool {
        self.ready_at.is_some_and(|at| now.duration_since(at) < self.stale_after)
    }
}

fn feedback(id: GoalId, is_ready: bool) -> DriverMessage {
    DriverMessage::Feedback {
        id,
        distance_remaining_m: None,
        time_remaining_s: None,
        values: BTreeMap::from([("ready".to_owned(), Scalar::Bool(is_ready))]),
    }
}

impl Execution {
    /// Executes a goal that lasts until `stop` becomes true.
    pub(super) async fn hold(
        &self,
        hold: &Hold,
        topic: &str,
        goal: &RobotGoal,
        mut stop: watch::Receiver<bool>,
    ) -> End {
        let topic = self.graph.resolve(topic);
        let mut state = match DeviceState::new(hold, &self.scope(goal)) {
            Ok(state) => state,
            Err(problem) => return End::aborted("unknown", problem),
        };
        let (sender, mut states) = unbounded_channel();
        let state_topic = self.graph.resolve(&hold.topic);
        let _subscription = match self.graph.subscribe(&state_topic, &hold.type_name, 0, sender).await {
            Ok(subscription) => subscription,
            Err(problem) => return End::aborted("failed", problem.to_string()),
        };
        let mut repeat = interval(Duration::from_secs_f64(hold.repeat_s));
        repeat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (mut reported, mut is_readable) = (None, true);
        // The end of the wait for the release, and whether its message was sent.
        let (mut release_limit, mut was_sent) = (None, false);
        loop {
            tokio::select! {
                () = requested(&mut stop), if release_limit.is_none() => {
                    release_limit = Some(Instant::now() + within(&goal.mapping));
                    repeat.reset_immediately();
                }
                _ = repeat.tick() => {
                    let message = if release_limit.is_some() { &hold.release } else { &goal.mapping.send };
                    if let Err(end) = self.publish_filled(&topic, message, goal).await {
                        return end;
                    }
                    was_sent = release_limit.is_some();
                }
                Some(received) = states.recv() => match received.message {
                    Ok(message) => state.handle(&message, Instant::now()),
                    Err(problem) if is_readable => {
                        is_readable = false;
                        warn!(topic = state_topic, problem, "unreadable states are ignored");
                    }
                    Err(_) => {}
                },
            }
            let now = Instant::now();
            if was_sent && (state.is_released || release_limit.is_some_and(|limit| limit <= now)) {
                return End::canceled();
            }
            // A device that is being released is no longer ready for a robot.
            let is_ready = state.is_ready(now) && release_limit.is_none();
            if reported != Some(is_ready) {
                reported = Some(is_ready);
                // Without its receiver the driver is ending.
                let _ = goal.feedback.send((goal.id, feedback(goal.id, is_ready)));
            }
        }
    }

    /// Publishes a template of a goal with the time of this moment.
    async fn publish_filled(&self, topic: &str, template: &Value, goal: &RobotGoal) -> Result<(), End> {
        self.publish_template(topic, &goal.mapping.type_name, template, &self.scope(goal)).await
    }

    async fn publish_template(
        &self,
        topic: &str,
        type_name: &str,
        template: &Value,
        scope: &Scope<'_>,
    ) -> Result<(), End> {
        let message = fill(&self.types, type_name, template, scope);
        let message = message.map_err(|problem| End::aborted("unknown", problem.to_string()))?;
        self.graph.publish(topic, type_name, &message).await.map_err(|problem| end_of_call(&problem))
    }

    /// Sends the messages at the end of goals that last until their cancel, without a goal.
    pub(super) async fn release_all(&self) {
        let parameters = JsonObject::new();
        let scope = Scope {
            parameters: &parameters,
            tables: &self.description.tables,
            robot: &self.robot,
            frame: self.description.frame(),
            now: seconds_now(),
        };
        for mapping in self.description.actions.values() {
            let (Some(Via::Topic(topic)), Some(hold)) = (mapping.via(), &mapping.hold) else { continue };
            let topic = self.graph.resolve(topic);
            if let Err(end) = self.publish_template(&topic, &mapping.type_name, &hold.release, &scope).await {
                warn!(topic, cause = end.message, "the device was not released");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::described::description::load;
    use serde_json::json;

    fn lift(parameters: Value) -> DeviceState {
        let lift = load("rmf_lift").unwrap();
        let tables = [("floor".to_owned(), [("Hall".to_owned(), json!("L1"))].into())].into();
        let parameters = parameters.as_object().unwrap();
        let scope = Scope { parameters, tables: &tables, robot: "lift-a", frame: "map", now: (5, 6) };
        DeviceState::new(lift.actions["serve"].hold.as_ref().unwrap(), &scope).unwrap()
    }

    fn state(lift: &str, floor: &str, session: &str) -> Value {
        json!({"lift_name": lift, "current_floor": floor, "door_state": 2, "current_mode": 2, "session_id": session})
    }

    #[test]
    fn a_lift_is_ready_at_the_floor_of_the_place_while_it_says_so() {
        let (mut lift, start) = (lift(json!({"place": "Hall"})), Instant::now());
        let own = "consort/lift-a";
        for other in [state("lift-a", "L2", own), state("lift-b", "L1", own), state("lift-a", "L1", "rmf")] {
            lift.handle(&other, start);
            assert!(!lift.is_ready(start), "{other}");
        }
        lift.handle(&state("lift-a", "L1", own), start);
        lift.handle(&state("lift-b", "L2", ""), start);
        assert!(lift.is_ready(start + Duration::from_millis(4_999)));
        assert!(!lift.is_ready(start + Duration::from_secs(5)), "its state is old");
        assert!(!lift.is_released);
        lift.handle(&state("lift-a", "L1", ""), start);
        assert!(lift.is_released && !lift.is_ready(start));
    }

    #[test]
    fn a_lift_is_never_ready_at_a_place_without_a_floor() {
        let (mut lift, start) = (lift(json!({"place": "Roof"})), Instant::now());
        lift.handle(&state("lift-a", "", "consort/lift-a"), start);
        assert!(!lift.is_ready(start));
    }
}
