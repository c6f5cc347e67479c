//! Names. Each kind of name has its own type, checked once where the name enters the program.
//!
//! Names that become part of a key expression ([`RobotId`], [`MissionId`], …) are *slugs*: 1 to 64
//! characters of `A–Z a–z 0–9 _ . -`. So a name contains no `/`, no `*` and no other character with
//! a meaning in Zenoh. Place names are *labels*, as written on a map (`IC Room 6`): 1 to 64
//! characters without control characters.

use crate::schema::inline_schema;
use schemars::{Schema, json_schema};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

/// Error: a text is not a valid name of its kind. Common in hand-written files; nothing was
/// changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{text:?} cannot name {article} {kind}: {problem}; allowed are 1 to {max} {allowed}",
    max = MAX_CHARS,
    article = article(.kind)
)]
pub struct NameError {
    /// Kind of name, as text.
    pub kind: &'static str,
    /// Text as given.
    pub text: String,
    /// Description of the problem.
    pub problem: String,
    /// Allowed characters.
    pub allowed: &'static str,
}

/// Maximum length of a name, in characters.
pub const MAX_CHARS: usize = 64;

fn article(kind: &str) -> &'static str {
    if kind.starts_with(['a', 'e', 'i', 'o', 'u']) { "an" } else { "a" }
}

const SLUG: &str = "characters of A-Z, a-z, 0-9, `_`, `.` and `-`";
const LABEL: &str = "characters except control characters, without space at either end";

fn check(kind: &'static str, text: &str, allowed: &'static str) -> Result<(), NameError> {
    let reject = |problem: String| Err(NameError { kind, text: text.to_owned(), problem, allowed });
    let length = text.chars().count();
    if length == 0 {
        return reject("it is empty".to_owned());
    }
    if length > MAX_CHARS {
        return reject(format!("it has {length} characters"));
    }
    let slug = allowed == SLUG;
    let invalid = |c: &char| if slug { !(c.is_ascii_alphanumeric() || "_.-".contains(*c)) } else { c.is_control() };
    if let Some(c) = text.chars().find(invalid) {
        return reject(format!("it contains {c:?}"));
    }
    if !slug && text.trim() != text {
        return reject("it begins or ends with space".to_owned());
    }
    Ok(())
}

/// Returns the JSON Schema of the texts that [`check`] accepts.
fn schema(allowed: &'static str) -> Schema {
    match allowed {
        SLUG => json_schema!({ "type": "string", "pattern": "^[A-Za-z0-9_.-]{1,64}$" }),
        _ => json_schema!({ "type": "string", "minLength": 1, "maxLength": MAX_CHARS }),
    }
}

macro_rules! names {
    ($($(#[$doc:meta])* $name:ident, $kind:literal, $allowed:expr;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(try_from = "String", into = "String")]
        // Shared, since names are copied far more often than created: for every bid, step and
        // record.
        pub struct $name(Arc<str>);

        impl $name {
            /// Checks `text` and creates a name from it.
            ///
            /// # Errors
            /// [`NameError`] states the problem and the allowed characters.
            pub fn new(text: impl Into<String>) -> Result<Self, NameError> {
                let text = text.into();
                check($kind, &text, $allowed)?;
                Ok(Self(text.into()))
            }

            /// Returns the name as text.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        inline_schema!($name, schema($allowed));

        impl TryFrom<String> for $name {
            type Error = NameError;
            fn try_from(text: String) -> Result<Self, NameError> {
                Self::new(text)
            }
        }

        impl std::str::FromStr for $name {
            type Err = NameError;
            fn from_str(text: &str) -> Result<Self, NameError> {
                check($kind, text, $allowed)?;
                Ok(Self(text.into()))
            }
        }

        impl From<$name> for String {
            fn from(name: $name) -> String {
                name.0.as_ref().to_owned()
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(&self.0)
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{}({:?})", stringify!($name), self.0)
            }
        }
    )*};
}

names! {
    /// Fleet: all nodes that share a ledger. First segment of every key after `consort/`.
    FleetId, "fleet", SLUG;
    /// Node: a process, or a set of actors on the virtual bus. A robot's node has the name of the
    /// robot.
    NodeId, "node", SLUG;
    /// Robot, as named in missions and by people.
    RobotId, "robot", SLUG;
    /// Mission in the ledger.
    MissionId, "mission", SLUG;
    /// Person, or program that a person is responsible for, as named in certificates and tokens.
    PersonId, "person", SLUG;
    /// Identifier of a request, chosen by the client, so that a repeated request is executed once.
    RequestId, "request", SLUG;
    /// Schedule of a mission, named by a person.
    ScheduleId, "schedule", SLUG;
    /// Alarm, as named in the fleet file (`fire`).
    AlarmId, "alarm", SLUG;
    /// Device of the building, as named in the fleet file (`front-door`).
    DeviceId, "device", SLUG;
    /// Role within a mission (`r1`, `lab_arm`, `clerk`).
    RoleId, "role", SLUG;
    /// Task within a mission; unique in its tree.
    TaskId, "task", SLUG;
    /// Type of task (`navigation`, `wait`); also the name of the skill that executes it.
    TaskType, "task type", SLUG;
    /// Name of an action that drivers of robots perform, such as `navigate_to_pose`.
    ActionName, "action", SLUG;
    /// Name of a domain: a file of actions and task types.
    DomainId, "domain", SLUG;
    /// Item that is handed over in a mission (`parcel`).
    ItemId, "item", SLUG;
    /// Ensemble, as named in the fleet file.
    EnsembleId, "ensemble", SLUG;
    /// Place on the map, as people write it (`IC Room 6`).
    PlaceId, "place", LABEL;
    /// Zone, as named in the fleet file: a name for several places.
    ZoneId, "zone", LABEL;
}

impl RequestId {
    /// Creates the id of a request that is named by no one: a UUID of version 7 (RFC 9562), from
    /// the time in milliseconds since 1970 and random bits.
    pub fn generate(created_ms: u64, random: u128) -> RequestId {
        let time = u128::from(created_ms & 0xffff_ffff_ffff) << 80;
        let bits = time | (7 << 76) | (random & (0xfff << 64)) | (2 << 62) | (random & ((1 << 62) - 1));
        let hex = format!("{bits:032x}");
        let text = [&hex[..8], &hex[8..12], &hex[12..16], &hex[16..20], &hex[20..]].join("-");
        RequestId(text.into())
    }

    /// Returns the time at which the id was created, in milliseconds since 1970, if it is a UUID of
    /// version 7.
    pub fn created_ms(&self) -> Option<u64> {
        let text = self.as_str();
        let fits = |(at, byte): (usize, u8)| match at {
            8 | 13 | 18 | 23 => byte == b'-',
            14 => byte == b'7',
            19 => b"89abAB".contains(&byte),
            _ => byte.is_ascii_hexdigit(),
        };
        let is_uuid = text.len() == 36 && text.bytes().enumerate().all(fits);
        is_uuid.then(|| u64::from_str_radix(&[&text[..8], &text[9..13]].concat(), 16).ok()).flatten()
    }
}

/// Identifier of a fleet's ledger, drawn at its creation. Two ledgers that were created separately
/// under the same fleet name have different ids, and must not merge.
///
/// Displayed, and written in JSON, as 16 hexadecimal digits; in bincode it takes 8 bytes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ClusterId(pub u64);

inline_schema!(ClusterId, json_schema!({ "type": "string", "pattern": "^[0-9a-fA-F]{16}$" }));

impl fmt::Display for ClusterId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

impl fmt::Debug for ClusterId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ClusterId({self})")
    }
}

impl std::str::FromStr for ClusterId {
    type Err = NameError;
    fn from_str(text: &str) -> Result<Self, NameError> {
        let digits = text.len() == 16 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
        let number = u64::from_str_radix(text, 16).ok().filter(|_| digits);
        number.map(ClusterId).ok_or_else(|| NameError {
            kind: "cluster",
            text: text.to_owned(),
            problem: "it is not a number of 16 hexadecimal digits".to_owned(),
            allowed: "hexadecimal digits; exactly 16 are required",
        })
    }
}

impl Serialize for ClusterId {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() { serializer.collect_str(self) } else { serializer.serialize_u64(self.0) }
    }
}

impl<'de> Deserialize<'de> for ClusterId {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
        } else {
            u64::deserialize(deserializer).map(ClusterId)
        }
    }
}

impl From<PlaceId> for ZoneId {
    /// Requests name places and zones alike.
    fn from(place: PlaceId) -> ZoneId {
        ZoneId(place.0)
    }
}

impl From<RobotId> for NodeId {
    /// A robot's node has the name of the robot.
    fn from(robot: RobotId) -> NodeId {
        NodeId(robot.0)
    }
}

impl From<NodeId> for RobotId {
    /// A robot's node has the name of the robot.
    fn from(node: NodeId) -> RobotId {
        RobotId(node.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slug_contains_no_character_with_a_meaning_in_zenoh() {
        for text in ["", "a/b", "a*", "a b", "$x", "ä", &"x".repeat(65)] {
            assert!(RobotId::new(text).is_err(), "{text:?}");
        }
        let error = RobotId::new("a/b").unwrap_err().to_string();
        assert_eq!(
            error,
            "\"a/b\" cannot name a robot: it contains '/'; allowed are 1 to 64 characters of A-Z, a-z, 0-9, `_`, `.` and `-`"
        );
    }

    #[test]
    fn a_generated_request_id_contains_its_time() {
        // The example of RFC 9562, A.6.
        let example = RequestId::generate(0x017f_22e2_79b0, 0xcc3 << 64 | 0x18c4_dc0c_0c07_398f);
        assert_eq!(example.as_str(), "017f22e2-79b0-7cc3-98c4-dc0c0c07398f");
        assert_eq!(example.created_ms(), Some(1_645_557_742_000));
        for other in ["order-7", "017f22e2-79b0-4cc3-98c4-dc0c0c07398f", "017f22e2-79b0-7cc3-98c4-dc0c0c07398g"] {
            assert_eq!(RequestId::new(other).unwrap().created_ms(), None, "{other}");
        }
    }

    #[test]
    fn a_place_name_is_a_label() {
        assert_eq!(PlaceId::new("IC Room 6").unwrap().as_str(), "IC Room 6");
        assert!(PlaceId::new(" IC Room 6").is_err());
        assert!(PlaceId::new("IC\nRoom").is_err());
    }

    #[test]
    fn a_cluster_id_is_written_in_hexadecimal_digits() {
        let cluster = ClusterId(0xab);
        let json = serde_json::to_string(&cluster).unwrap();
        assert_eq!(json, "\"00000000000000ab\"");
        assert_eq!(serde_json::from_str::<ClusterId>(&json).unwrap(), cluster);
        for text in ["", "ab", "+0000000000000ab", "00000000000000ag", "00000000000000ab0"] {
            assert!(text.parse::<ClusterId>().is_err(), "{text:?}");
        }
    }

    #[test]
    fn names_are_checked_when_they_are_deserialized() {
        assert!(serde_json::from_str::<RobotId>("\"a/b\"").is_err());
    }
}
