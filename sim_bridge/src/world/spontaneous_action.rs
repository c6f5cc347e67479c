//! What people may do that nobody asked them to: call a mission off, decline, walk away.

use super::setup::SetupError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Something that a person may do once things have come so far.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpontaneousAction {
    /// When it may come over her; each time anew.
    pub at: PersonTrigger,
    /// What she does then.
    pub does: PersonAction,
    /// How long after, in seconds of world time. By default at once.
    #[serde(default)]
    pub after_s: f64,
    /// How likely it is: 0 to 1. By default it is certain.
    #[serde(default = "certain")]
    pub probability: f64,
    /// How long she stays away, in seconds, if she walks away. By default for ever.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub back_after_s: Option<f64>,
}

fn certain() -> f64 {
    1.0
}

/// When something may come over a person.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PersonTrigger {
    /// The world begins.
    Waiting,
    /// A robot has approached her.
    Approached,
    /// She has proved to a robot who she is.
    Authenticated,
    /// She begins to hand something over.
    HandingOver,
    /// She has handed something over.
    HandedOver,
}

/// What a person may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PersonAction {
    /// She calls the mission off for which the robot came, and hands it nothing.
    Cancels,
    /// She does not do what she is about to do for the robot.
    Declines,
    /// She leaves her place.
    WalksAway,
}

impl SpontaneousAction {
    /// Something that is certain to come over her at once.
    pub fn certain(at: PersonTrigger, does: PersonAction) -> SpontaneousAction {
        SpontaneousAction { at, does, after_s: 0.0, probability: certain(), back_after_s: None }
    }

    /// All that is wrong with it.
    pub(super) fn check(&self, who: &str, problems: &mut Vec<SetupError>) {
        let who = format!("{who}: mood");
        let seconds = "a number of seconds, 0 or more";
        for (field, value) in [("after_s", Some(self.after_s)), ("back_after_s", self.back_after_s)] {
            if let Some(value) = value.filter(|value| !(0.0..=f64::MAX).contains(value)) {
                problems.push(SetupError::InvalidNumber { who: who.clone(), field, value, allowed: seconds });
            }
        }
        if !(0.0..=1.0).contains(&self.probability) {
            let (field, value, allowed) = ("probability", self.probability, "a number from 0 to 1");
            problems.push(SetupError::InvalidNumber { who: who.clone(), field, value, allowed });
        }
        let allowed = match (self.at, self.does) {
            (PersonTrigger::Waiting, PersonAction::Cancels) => {
                "approached, authenticated, handing_over or handed_over, when there is a robot"
            }
            (
                PersonTrigger::Waiting
                | PersonTrigger::Approached
                | PersonTrigger::Authenticated
                | PersonTrigger::HandedOver,
                PersonAction::Declines,
            ) => "handing_over: there is nothing else to decline",
            _ => return,
        };
        problems.push(SetupError::InvalidTrigger { who, allowed });
    }
}
