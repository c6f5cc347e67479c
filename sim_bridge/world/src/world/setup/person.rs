//! Setup of people, and their unrequested actions: cancel a mission, decline, walk away.

use super::error::SetupError;
use crate::world::names::{PersonName, SampleId};
use consort_protocol::ids::{PlaceId, RoleId};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A person at a place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PersonSetup {
    /// Name.
    pub name: PersonName,
    /// Role in missions.
    pub role: RoleId,
    /// Place of the person.
    pub place: PlaceId,
    /// Samples to hand over, in order.
    #[serde(default)]
    pub samples: Vec<SampleId>,
    /// True if the person, once these are handed over, has a new sample for every request. Default: false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub endless_samples: bool,
    /// True if the person comes to a robot that approaches somebody with this role at another place, unless
    /// another robot or a handover needs the person. Default: false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub on_call: bool,
    /// Unrequested actions of the person. Default: none, so the person waits and does every
    /// requested task.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub spontaneous_actions: Vec<SpontaneousAction>,
}

impl PersonSetup {
    /// Creates a person without samples who waits and does every requested task.
    pub fn new(name: &str, role: RoleId, place: PlaceId) -> PersonSetup {
        PersonSetup {
            name: PersonName::from(name),
            role,
            place,
            samples: vec![],
            endless_samples: false,
            on_call: false,
            spontaneous_actions: vec![],
        }
    }
}

/// An action that a person may take after a trigger.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpontaneousAction {
    /// Trigger. It is evaluated anew each time.
    pub trigger: PersonTrigger,
    /// Action.
    pub action: PersonAction,
    /// Delay after the trigger, in seconds of world time. Default: 0.
    #[serde(default)]
    pub after_s: f64,
    /// Probability of the action: 0 to 1. Default: 1.
    #[serde(default = "certain")]
    pub probability: f64,
    /// Time until the person returns after walking away, in seconds. Default: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub back_after_s: Option<f64>,
}

fn certain() -> f64 {
    1.0
}

/// Trigger of a person's action.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PersonTrigger {
    /// The world begins.
    Waiting,
    /// A robot has approached the person.
    Approached,
    /// The person has authenticated to a robot.
    Authenticated,
    /// The person starts a handover.
    HandingOver,
    /// The person has completed a handover.
    HandedOver,
}

/// An action of a person.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PersonAction {
    /// Cancels the mission for which the robot came, and hands nothing over.
    Cancels,
    /// Declines the handover.
    Declines,
    /// Leaves the place.
    WalksAway,
}

impl SpontaneousAction {
    /// An action that certainly follows its trigger at once.
    pub fn certain(trigger: PersonTrigger, action: PersonAction) -> SpontaneousAction {
        SpontaneousAction { trigger, action, after_s: 0.0, probability: certain(), back_after_s: None }
    }

    /// Checks the settings.
    pub(in crate::world) fn check(&self, subject: &str, errors: &mut Vec<SetupError>) {
        let subject = format!("{subject}: spontaneous action");
        let seconds = "a number of seconds, 0 or more";
        for (field, value) in [("after_s", Some(self.after_s)), ("back_after_s", self.back_after_s)] {
            if let Some(value) = value.filter(|value| !(0.0..=f64::MAX).contains(value)) {
                errors.push(SetupError::InvalidNumber { subject: subject.clone(), field, value, allowed: seconds });
            }
        }
        if !(0.0..=1.0).contains(&self.probability) {
            let (field, value, allowed) = ("probability", self.probability, "a number from 0 to 1");
            errors.push(SetupError::InvalidNumber { subject: subject.clone(), field, value, allowed });
        }
        let allowed = match (self.trigger, self.action) {
            (PersonTrigger::Waiting, PersonAction::Cancels) => {
                "approached, authenticated, handing_over or handed_over, which involve a robot"
            }
            (
                PersonTrigger::Waiting
                | PersonTrigger::Approached
                | PersonTrigger::Authenticated
                | PersonTrigger::HandedOver,
                PersonAction::Declines,
            ) => "handing_over, the only action that can be declined",
            _ => return,
        };
        errors.push(SetupError::InvalidTrigger { subject, allowed });
    }
}
