//! The side of the skills: telemetry and actions of a robot.

use super::goal::{Goal, GoalId, GoalResult, GoalStatus};
use crate::environment::SpeedLimits;
use consort_protocol::ensemble::ExchangedValue;
use consort_protocol::ids::{EnsembleId, PlaceId, RobotId};
use consort_protocol::ledger::PersonQuestion;
use consort_protocol::pose::Pose;
use consort_protocol::scalar::{Scalar, check_named_scalars};
use consort_protocol::units::{BatteryShare, MetresPerSecond, WorldTime};
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, de};
use std::collections::BTreeMap;

/// Maximum number of readings of a robot.
pub const READINGS_MAX: usize = 64;

/// State report of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Telemetry {
    /// Time, on the world's clock.
    pub time: WorldTime,
    /// Pose.
    pub pose: Pose,
    /// Current place, or the last place passed.
    pub place: PlaceId,
    /// State of charge.
    pub battery: BatteryShare,
    /// False if the robot cannot move: the battery has fallen below the stopping share, or its driver has no
    /// connection to it.
    pub able: bool,
    /// Lanes that the robot has found closed, or that were reported to it as closed: each once, by
    /// its two ends. The list is incomplete, and old entries expire, since a lane may be open
    /// again. A place twice is a closed place: the robot does not enter it.
    pub closed: Vec<(PlaceId, PlaceId)>,
    /// Latest value of each reading that the driver has published, by name: at most 64. A domain file
    /// declares them.
    #[serde(default, deserialize_with = "readings")]
    pub readings: BTreeMap<String, Scalar>,
}

/// Decodes readings within their limits.
fn readings<'de, D: Deserializer<'de>>(source: D) -> Result<BTreeMap<String, Scalar>, D::Error> {
    let readings = BTreeMap::deserialize(source)?;
    check_named_scalars("reading", &readings, READINGS_MAX).map_err(de::Error::custom)?;
    Ok(readings)
}

/// The actions of a robot, as its skills use them. Calls never block: results appear in
/// [`status`](RobotActions::status) later.
pub trait RobotActions {
    /// Sends a goal.
    fn send_goal(&mut self, goal: Goal) -> GoalId;

    /// Returns the status of a goal; `None` for a goal that was never sent, or ended long ago.
    fn status(&self, goal: GoalId) -> Option<GoalStatus>;

    /// Requests the cancelation of a goal. Its status becomes [`GoalStatus::Canceled`] when the
    /// robot stands still.
    fn cancel(&mut self, goal: GoalId);

    /// Returns the latest report of the robot; `None` before the first.
    fn telemetry(&self) -> Option<&Telemetry>;

    /// Returns the lanes and places that people have closed, as in [`Telemetry::closed`], which contains
    /// them, too.
    fn closed_by_people(&self) -> &[(PlaceId, PlaceId)] {
        &[]
    }

    /// Returns the closed lanes that people have not closed.
    fn found_closed(&self) -> Vec<(PlaceId, PlaceId)> {
        let closed = self.telemetry().into_iter().flat_map(|telemetry| &telemetry.closed);
        closed.filter(|lane| !self.closed_by_people().contains(lane)).cloned().collect()
    }

    /// Returns the average speed of the robot without limits; `None` if it does not drive, or is not known.
    fn speed(&self) -> Option<MetresPerSecond> {
        None
    }

    /// Returns the speed limits of people; `None` without any.
    fn speed_limits(&self) -> Option<&SpeedLimits> {
        None
    }

    /// Requests the way from a place to its neighbour from the devices of the building, and checks whether the robot may
    /// drive it now. `then` are the places after it on the route. Repeated at each tick until the robot arrives.
    fn request_way(&mut self, from: &PlaceId, to: &PlaceId, then: &[PlaceId]) -> bool {
        let _ = (from, to, then);
        true
    }

    /// Ends the request of a way: the robot has arrived.
    fn end_way(&mut self) {}

    /// Returns the newest value that a member of an ensemble has sent to the others. `None` if it is
    /// unknown: this robot is not a member, the value has not arrived, or it is too old.
    fn member_value(&self, ensemble: &EnsembleId, robot: &RobotId, value: &ExchangedValue) -> Option<Scalar> {
        let _ = (ensemble, robot, value);
        None
    }

    /// Asks people, or continues to wait for the answer to the same question. Returns what a person has
    /// answered, or the reason for which there is no answer; `None` while it is awaited. A robot asks one
    /// question at a time.
    fn ask_person(&mut self, question: &PersonQuestion) -> Option<Result<String, String>> {
        let _ = question;
        Some(Err("this robot cannot ask people".to_owned()))
    }

    /// Withdraws the open question, if there is an open question.
    fn withdraw_question(&mut self) {}

    /// Consumes a completion of this goal by an earlier attempt at the same task: an attempt that
    /// was interrupted, or ended by a crash of the robot program without receiving the result.
    /// Returns its result once for each completion, otherwise `None`. Called for goals that are not
    /// [repeatable](Goal::repeatable). An implementation without memory returns `None`.
    fn take_completed(&mut self, goal: &Goal) -> Option<GoalResult> {
        let _ = goal;
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::codec;

    fn telemetry(readings: impl IntoIterator<Item = (String, Scalar)>) -> Telemetry {
        Telemetry {
            time: WorldTime::from_secs(2.5),
            pose: Pose::new(1.0, 2.0, 0.0),
            place: "Dock".parse().unwrap(),
            battery: BatteryShare::FULL,
            able: true,
            closed: vec![],
            readings: readings.into_iter().collect(),
        }
    }

    #[test]
    fn readings_keep_their_type_in_messages_and_in_json() {
        let values = [Scalar::Bool(true), Scalar::Integer(-3), Scalar::Number(0.5), Scalar::Text("wet".to_owned())];
        let sent = telemetry(values.into_iter().enumerate().map(|(at, value)| (format!("reading_{at}"), value)));
        assert_eq!(codec::decode::<Telemetry>(&codec::encode(&sent).unwrap()).unwrap(), sent);
        let json = serde_json::to_value(&sent).unwrap();
        assert_eq!(serde_json::from_value::<Telemetry>(json.clone()).unwrap(), sent);
        // A recording of an earlier release has no readings.
        let mut earlier = json;
        earlier.as_object_mut().unwrap().remove("readings");
        assert_eq!(serde_json::from_value::<Telemetry>(earlier).unwrap(), telemetry([]));
    }

    #[test]
    fn readings_beyond_the_limits_are_malformed() {
        let many = (0..65).map(|number| (format!("r{number}"), Scalar::Bool(true)));
        let text = |size: usize| Scalar::Text("x".repeat(size));
        for (sent, part) in [
            (telemetry(many), "65 readings; at most 64 are allowed"),
            (telemetry([("note".to_owned(), text(257))]), "the reading `note` is a text of 257 bytes"),
            (telemetry([("2nd".to_owned(), text(1))]), "the reading `2nd` has an invalid name"),
        ] {
            let error = codec::decode::<Telemetry>(&codec::encode(&sent).unwrap()).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
