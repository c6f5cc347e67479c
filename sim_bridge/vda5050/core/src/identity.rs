//! The identity of a vehicle, and its topics.

use serde_json::{Map, Value, json};
use std::fmt;
use std::str::FromStr;

/// A version of the protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Version {
    /// 2.0
    V2_0,
    /// 2.1
    V2_1,
    /// 3.0
    V3_0,
}

/// A text is no supported version.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("version {0:?} is not supported; allowed: \"2.0\", \"2.1\", \"3.0\"")]
pub struct VersionError(pub String);

impl Version {
    /// All versions.
    pub const ALL: [Version; 3] = [Version::V2_0, Version::V2_1, Version::V3_0];

    /// Returns the number that messages contain.
    pub fn number(self) -> &'static str {
        match self {
            Version::V2_0 => "2.0.0",
            Version::V2_1 => "2.1.0",
            Version::V3_0 => "3.0.0",
        }
    }

    /// Returns the level of topics that names the major version.
    pub fn topic_level(self) -> &'static str {
        match self {
            Version::V2_0 | Version::V2_1 => "v2",
            Version::V3_0 => "v3",
        }
    }
}

impl FromStr for Version {
    type Err = VersionError;

    fn from_str(text: &str) -> Result<Version, VersionError> {
        let is_meant = |version: &Version| version.number() == text || version.number() == format!("{text}.0");
        Version::ALL.into_iter().find(is_meant).ok_or_else(|| VersionError(text.to_owned()))
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.number())
    }
}

/// A topic of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// Orders to the vehicle.
    Order,
    /// Actions that the vehicle executes at once.
    InstantActions,
    /// State of the vehicle.
    State,
    /// Position of the vehicle, more often than the state.
    Visualization,
    /// Connection of the vehicle to the broker; retained.
    Connection,
    /// Properties of the vehicle.
    Factsheet,
}

impl Topic {
    /// All topics.
    pub const ALL: [Topic; 6] =
        [Topic::Order, Topic::InstantActions, Topic::State, Topic::Visualization, Topic::Connection, Topic::Factsheet];

    /// The topics that a vehicle publishes.
    pub const OF_VEHICLES: [Topic; 4] = [Topic::State, Topic::Visualization, Topic::Connection, Topic::Factsheet];

    /// The topics that fleet control publishes.
    pub const OF_FLEET_CONTROL: [Topic; 2] = [Topic::Order, Topic::InstantActions];

    /// Returns the last level of the topic.
    pub fn level(self) -> &'static str {
        match self {
            Topic::Order => "order",
            Topic::InstantActions => "instantActions",
            Topic::State => "state",
            Topic::Visualization => "visualization",
            Topic::Connection => "connection",
            Topic::Factsheet => "factsheet",
        }
    }
}

/// A vehicle on a broker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Vehicle {
    interface: String,
    version: Version,
    manufacturer: String,
    serial: String,
}

/// A name cannot be a level of a topic.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {name:?} cannot be a level of a topic; allowed is a text without `/`, `+`, `#` and NUL")]
pub struct IdentityError {
    /// Name of the field.
    pub field: &'static str,
    /// The name.
    pub name: String,
}

impl Vehicle {
    /// Creates the identity of a vehicle.
    ///
    /// # Errors
    /// A name cannot be a level of a topic.
    pub fn new(interface: &str, version: Version, manufacturer: &str, serial: &str) -> Result<Vehicle, IdentityError> {
        for (field, name) in [("interface", interface), ("manufacturer", manufacturer), ("serial", serial)] {
            if name.is_empty() || name.contains(['/', '+', '#', '\0']) {
                return Err(IdentityError { field, name: name.to_owned() });
            }
        }
        let [interface, manufacturer, serial] = [interface, manufacturer, serial].map(str::to_owned);
        Ok(Vehicle { interface, version, manufacturer, serial })
    }

    /// Returns the version of the vehicle's messages.
    pub fn version(&self) -> Version {
        self.version
    }

    /// Returns a topic of this vehicle. No other topics are subscribed to or published.
    pub fn topic(&self, topic: Topic) -> String {
        let Vehicle { interface, version, manufacturer, serial } = self;
        format!("{interface}/{}/{manufacturer}/{serial}/{}", version.topic_level(), topic.level())
    }

    /// Returns which topic of this vehicle a text is.
    pub fn topic_of(&self, text: &str) -> Option<Topic> {
        Topic::ALL.into_iter().find(|topic| self.topic(*topic) == text)
    }

    /// Returns a complete message: the header and the body, which is an object.
    pub fn message(&self, header_id: u32, timestamp: &str, body: Map<String, Value>) -> Value {
        let mut message = Map::new();
        message.insert("headerId".to_owned(), json!(header_id));
        message.insert("timestamp".to_owned(), json!(timestamp));
        message.insert("version".to_owned(), json!(self.version.number()));
        message.insert("manufacturer".to_owned(), json!(self.manufacturer));
        message.insert("serialNumber".to_owned(), json!(self.serial));
        message.extend(body);
        Value::Object(message)
    }

    /// Returns the name of the field by which a message belongs to another vehicle.
    pub(crate) fn foreign_field(&self, message: &Value) -> Option<&'static str> {
        let expected = [("manufacturer", &self.manufacturer), ("serialNumber", &self.serial)];
        let is_other =
            |(field, own): &(&str, &String)| message[*field].as_str().is_some_and(|name| name != own.as_str());
        expected.into_iter().find(is_other).map(|(field, _)| field)
    }
}

impl fmt::Display for Vehicle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.manufacturer, self.serial)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_name_the_major_version_and_the_vehicle() {
        let vehicle = Vehicle::new("uagv", Version::V3_0, "ACME", "7").unwrap();
        assert_eq!(vehicle.topic(Topic::InstantActions), "uagv/v3/ACME/7/instantActions");
        assert_eq!(vehicle.topic_of("uagv/v3/ACME/7/state"), Some(Topic::State));
        assert_eq!(vehicle.topic_of("uagv/v3/Other/7/state"), None);
        let error = Vehicle::new("uagv", Version::V2_0, "AC/ME", "7").unwrap_err();
        assert_eq!(error.field, "manufacturer");
    }

    #[test]
    fn versions_are_read_with_and_without_the_patch() {
        assert_eq!("2.1".parse(), Ok(Version::V2_1));
        assert_eq!("3.0.0".parse(), Ok(Version::V3_0));
        assert!("1.1".parse::<Version>().unwrap_err().to_string().contains("allowed: \"2.0\""));
    }
}
