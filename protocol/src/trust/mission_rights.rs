//! Missions that a person may submit.

use crate::ids::{NameError, PersonId, TaskId};
use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

/// Maximum number of names. Raised: a token, which contains the certificate, may no longer fit a cookie.
const NAMES_MAX: usize = 16;

/// Missions that a person with the scope `submit` may submit or schedule. By default all.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum MissionRights {
    /// Missions by name, and mission files.
    #[default]
    All,
    /// Missions with these names, as the coordinator defines them. The name in a mission file proves nothing, so
    /// files are not among them.
    Named(BTreeSet<TaskId>),
}

/// Error: a text is not a list of missions.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MissionRightsError {
    /// A name is invalid.
    #[error(transparent)]
    Name(#[from] NameError),
    /// There are too many names.
    #[error("{found} missions are named; at most {max} are allowed", max = NAMES_MAX)]
    TooMany {
        /// Number of names.
        found: usize,
    },
}

/// A person may not submit a mission.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{person} may not submit {mission}: the right `missions` of the certificate allows {allowed}, by name")]
pub struct MissionNotPermitted {
    person: PersonId,
    mission: String,
    allowed: MissionRights,
}

impl MissionRights {
    /// Checks whether the mission with this name may be submitted.
    pub fn permits(&self, name: &str) -> bool {
        match self {
            MissionRights::All => true,
            MissionRights::Named(names) => names.iter().any(|known| known.as_str() == name),
        }
    }

    /// Checks whether `person`, who has these rights, may submit a mission: the mission that the request
    /// names, or a mission file without a name.
    ///
    /// # Errors
    /// [`MissionNotPermitted`].
    pub fn check(&self, person: &PersonId, name: Option<&str>) -> Result<(), MissionNotPermitted> {
        let is_permitted = name.map_or(*self == MissionRights::All, |name| self.permits(name));
        if is_permitted {
            return Ok(());
        }
        let mission = name.map_or_else(|| "a mission file".to_owned(), |name| format!("{name:?}"));
        Err(MissionNotPermitted { person: person.clone(), mission, allowed: self.clone() })
    }
}

impl fmt::Display for MissionRights {
    /// Writes the rights for people.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            MissionRights::All => f.write_str("all"),
            MissionRights::Named(names) if names.is_empty() => f.write_str("none"),
            MissionRights::Named(names) => {
                f.write_str(&names.iter().map(TaskId::as_str).collect::<Vec<_>>().join(", "))
            }
        }
    }
}

impl FromStr for MissionRights {
    type Err = MissionRightsError;

    /// Reads names with commas between them, or `*` for all.
    fn from_str(text: &str) -> Result<MissionRights, MissionRightsError> {
        if text == "*" {
            return Ok(MissionRights::All);
        }
        let names = text.split(',').filter(|name| !name.is_empty()).map(str::parse::<TaskId>);
        let names = names.collect::<Result<BTreeSet<_>, _>>()?;
        match names.len() > NAMES_MAX {
            true => Err(MissionRightsError::TooMany { found: names.len() }),
            false => Ok(MissionRights::Named(names)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(rights: &str, name: Option<&str>) -> Option<String> {
        let rights: MissionRights = rights.parse().unwrap();
        rights.check(&"kim".parse().unwrap(), name).err().map(|error| error.to_string())
    }

    #[test]
    fn a_mission_that_is_not_named_is_refused_with_what_is_allowed() {
        assert_eq!(error("*", Some("rounds")), None);
        assert_eq!(error("*", None), None);
        assert_eq!(error("deliveries,rounds", Some("rounds")), None);
        let allowed = "the right `missions` of the certificate allows deliveries, rounds, by name";
        let refused = error("deliveries,rounds", Some("bed-transfer")).unwrap();
        assert_eq!(refused, format!("kim may not submit \"bed-transfer\": {allowed}"));
        let refused = error("deliveries,rounds", None).unwrap();
        assert_eq!(refused, format!("kim may not submit a mission file: {allowed}"));
        assert!(error("", Some("rounds")).unwrap().ends_with("allows none, by name"));
    }

    #[test]
    fn the_number_of_names_is_limited() {
        let names = (0..=NAMES_MAX).map(|number| format!("m{number}")).collect::<Vec<_>>().join(",");
        let refused = names.parse::<MissionRights>().unwrap_err().to_string();
        assert_eq!(refused, "17 missions are named; at most 16 are allowed");
        assert!("a b".parse::<MissionRights>().is_err(), "a name is a slug");
    }
}
