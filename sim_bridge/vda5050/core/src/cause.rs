//! Errors of vehicles as causes of failed goals.

use std::collections::BTreeMap;
use std::fmt;

/// Level of an error of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ErrorLevel {
    /// The vehicle continues.
    Warning,
    /// The vehicle continues, but needs attention soon; since version 3.0.
    Urgent,
    /// The vehicle cannot continue its order; since version 3.0.
    Critical,
    /// The vehicle needs a person.
    Fatal,
}

impl ErrorLevel {
    /// Checks whether the error ends an order.
    pub fn ends_orders(self) -> bool {
        self >= ErrorLevel::Critical
    }
}

/// An error of a vehicle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VehicleError {
    /// Type, for example `noRouteError`.
    pub kind: String,
    /// Level.
    pub level: ErrorLevel,
    /// Description for people.
    pub description: String,
    /// What the error refers to, for example `orderId` and an id.
    pub references: Vec<(String, String)>,
}

impl VehicleError {
    /// Checks whether the error refers to an order or an action with this id.
    pub fn refers_to(&self, id: &str) -> bool {
        self.references.iter().any(|(_, value)| value == id)
    }

    /// Returns the type in small letters: `noRouteError` of version 2 and `NO_ROUTE_ERROR` of version 3
    /// are equal then.
    pub(crate) fn kind_letters(&self) -> String {
        self.kind.chars().filter(char::is_ascii_alphanumeric).map(|letter| letter.to_ascii_lowercase()).collect()
    }
}

impl fmt::Display for VehicleError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({:?})", self.kind, self.level)?;
        if self.description.is_empty() { Ok(()) } else { write!(f, ": {}", self.description) }
    }
}

/// Class of a cause: it decides whether the robot, another robot, or no robot tries again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CauseClass {
    /// The robot failed; another may succeed.
    Robot,
    /// A condition does not hold; the robot may succeed later.
    Precondition,
    /// The failure is temporary; the robot tries again.
    Transient,
    /// No robot can do it.
    Task,
}

/// Cause of the failure of a goal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cause {
    /// Standard code of the driver protocol, or a code that the domain declares.
    pub code: String,
    /// Class of a standard code; a domain declares the class of its own codes.
    pub class: Option<CauseClass>,
    /// Cause for people.
    pub message: String,
}

impl Cause {
    /// Creates a cause with the class of its code.
    pub fn new(code: &str, message: impl Into<String>) -> Cause {
        Cause { code: code.to_owned(), class: class_of(code), message: message.into() }
    }
}

/// Returns the class of a standard code of the driver protocol.
pub fn class_of(code: &str) -> Option<CauseClass> {
    match code {
        "not_authenticated" => Some(CauseClass::Task),
        "busy" => Some(CauseClass::Transient),
        "too_heavy" => Some(CauseClass::Precondition),
        "unknown" | "no_route" | "blocked" | "out_of_reach" | "container_state" | "battery_low" | "timed_out"
        | "charger" | "failed" => Some(CauseClass::Robot),
        _ => None,
    }
}

/// Words in the types of errors, in small letters, and the codes of the causes. The first match counts.
const WORDS: [(&str, &str); 13] = [
    ("noroute", "no_route"),
    ("unreachable", "no_route"),
    ("startnode", "no_route"),
    ("otherorder", "busy"),
    ("robotnotavailable", "busy"),
    ("battery", "battery_low"),
    ("obstacle", "blocked"),
    ("blocked", "blocked"),
    ("fieldviolation", "blocked"),
    ("heavy", "too_heavy"),
    ("charg", "charger"),
    ("timeout", "timed_out"),
    ("unknownmap", "unknown"),
];

/// Codes of the types of errors.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CauseTable {
    /// Codes of the driver's file, by the type of the error.
    pub by_type: BTreeMap<String, String>,
}

impl CauseTable {
    /// Returns the cause for an error of a vehicle.
    pub fn cause(&self, error: &VehicleError) -> Cause {
        let known = self.by_type.get(&error.kind).map(String::as_str);
        let letters = error.kind_letters();
        let guessed = || WORDS.iter().find(|(word, _)| letters.contains(word)).map(|(_, code)| *code);
        Cause::new(known.or_else(guessed).unwrap_or("failed"), error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(kind: &str) -> VehicleError {
        VehicleError {
            kind: kind.to_owned(),
            level: ErrorLevel::Fatal,
            description: "x".to_owned(),
            references: vec![],
        }
    }

    #[test]
    fn errors_become_causes_with_their_class() {
        let table = CauseTable { by_type: BTreeMap::from([("liftJam".to_owned(), "lift_jammed".to_owned())]) };
        let cause = table.cause(&error("noRouteError"));
        assert_eq!((cause.code.as_str(), cause.class), ("no_route", Some(CauseClass::Robot)));
        assert_eq!(cause.message, "noRouteError (Fatal): x");
        assert_eq!(table.cause(&error("batteryLowError")).code, "battery_low");
        let predefined = ["NO_ROUTE_TO_TARGET", "NODE_UNREACHABLE", "START_NODE_OUT_OF_RANGE", "OTHER_ORDER_ACTIVE"];
        assert_eq!(predefined.map(|kind| table.cause(&error(kind)).code), ["no_route", "no_route", "no_route", "busy"]);
        assert_eq!(table.cause(&error("gripper")).code, "failed");
        // The domain declares the class of its own codes.
        let own = table.cause(&error("liftJam"));
        assert_eq!((own.code.as_str(), own.class), ("lift_jammed", None));
        assert!(ErrorLevel::Critical.ends_orders() && !ErrorLevel::Urgent.ends_orders());
    }
}
