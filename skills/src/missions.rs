//! Missions that a request names: those shipped with the program, and those of a fleet.

use consort_protocol::ids::TaskId;
use consort_protocol::mission::{Format, IhtnFields, MissionDocument, MissionTemplate, TemplateParameter};
use consort_text::AllowedNames;
use serde::Serialize;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::OnceLock;

const FILES: [&str; 6] = [
    include_str!("../missions/lab-samples.yaml"),
    include_str!("../missions/lab-samples-watched.yaml"),
    include_str!("../missions/bed-transfer.yaml"),
    include_str!("../missions/ward-disinfection.yaml"),
    include_str!("../missions/food-logistics.yaml"),
    include_str!("../missions/vital-signs.yaml"),
];

/// Returns the shipped missions, by name: `lab-samples` (the exemplar of the thesis),
/// `lab-samples-watched` (the same with a recovery branch), `bed-transfer` (two robots, a joint
/// task), `ward-disinfection` (unordered methods), `food-logistics` (an item handed over between
/// two robots) and `vital-signs` (rounds shared by two robots).
pub fn shipped() -> &'static BTreeMap<String, MissionTemplate> {
    static TEMPLATES: OnceLock<BTreeMap<String, MissionTemplate>> = OnceLock::new();
    TEMPLATES.get_or_init(|| {
        let read = |text: &&str| MissionTemplate::parse(text, Format::Yaml).expect("shipped missions are tested");
        FILES.iter().map(read).map(|template| (template.name().to_string(), template)).collect()
    })
}

/// Missions that a request names: the shipped missions, and the missions of a fleet.
#[derive(Debug, Clone, Default)]
pub struct NamedMissions {
    /// Missions of the fleet. None has the name of a shipped mission.
    of_fleet: BTreeMap<String, MissionDocument>,
}

/// A mission with this name exists. The missions are unchanged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NameTaken {
    /// A shipped mission has the name.
    #[error("it is the name of a shipped mission")]
    Shipped,
    /// A mission of the fleet has the name.
    #[error("another mission file of the fleet has this name")]
    OfFleet,
}

/// Reason for which a name and its fields denote no mission.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NamedMissionError {
    /// No mission has the name.
    #[error("the fleet has no mission {name:?}; {allowed}")]
    Unknown {
        /// The name.
        name: String,
        /// The names of the missions.
        allowed: AllowedNames,
    },
    /// The field would change the mission.
    #[error(
        "`{field}` belongs to a mission in the flat iHTN form that is given as a file; the mission {name:?} has its own \
         name and people"
    )]
    OnlyIhtnFile {
        /// The field.
        field: &'static str,
        /// The name.
        name: String,
    },
}

/// A mission in a list of those that a request may name.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct OfferedMission<'a> {
    /// Its name.
    pub mission: &'a TaskId,
    /// Its title for people; may be empty.
    pub title: &'a str,
    /// The parameters that a request provides.
    pub parameters: &'a BTreeMap<String, TemplateParameter>,
}

impl NamedMissions {
    /// Adds a mission of the fleet.
    ///
    /// # Errors
    /// [`NameTaken`]. So a name in a certificate stands for a single mission.
    pub fn add(&mut self, mission: MissionDocument) -> Result<(), NameTaken> {
        let name = mission.name().to_string();
        if shipped().contains_key(&name) {
            return Err(NameTaken::Shipped);
        }
        match self.of_fleet.entry(name) {
            Entry::Occupied(_) => Err(NameTaken::OfFleet),
            Entry::Vacant(free) => {
                free.insert(mission);
                Ok(())
            }
        }
    }

    /// Checks whether a mission has this name.
    pub fn contains(&self, name: &str) -> bool {
        self.of_fleet.contains_key(name) || shipped().contains_key(name)
    }

    /// Returns the mission with this name, as this program defines it. `fields` are those of a request.
    ///
    /// # Errors
    /// [`NamedMissionError`]: there is no such mission, or a field would change it.
    pub fn document(&self, name: &str, fields: &IhtnFields) -> Result<MissionDocument, NamedMissionError> {
        let of_fleet = self.of_fleet.get(name).cloned();
        let document = of_fleet.or_else(|| Some(MissionDocument::Template(Box::new(shipped().get(name)?.clone()))));
        let document = document.ok_or_else(|| NamedMissionError::Unknown {
            name: name.to_owned(),
            allowed: AllowedNames::suggest_for(name, self.offered().map(|offered| offered.mission)),
        })?;
        match fields.first_given() {
            Some(field) => Err(NamedMissionError::OnlyIhtnFile { field, name: name.to_owned() }),
            None => Ok(document),
        }
    }

    /// Returns all missions, those of the fleet first.
    pub fn offered(&self) -> impl Iterator<Item = OfferedMission<'_>> {
        let of_fleet = self.of_fleet.values().map(|document| OfferedMission {
            mission: document.name(),
            title: document.title(),
            parameters: document.parameters(),
        });
        let shipped = shipped().values().map(|template| OfferedMission {
            mission: template.name(),
            title: template.title(),
            parameters: template.parameters(),
        });
        of_fleet.chain(shipped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::hospital;
    use consort_protocol::ids::{PlaceId, RoleId};

    const VISIT: &str = r#"{
      "0": { "name": "visit", "type": "task", "parent": "-1", "agents": ["ada", "visitor"], "children": ["1"] },
      "1": { "name": "m-visit", "type": "method", "parent": "0", "agents": ["ada", "visitor"], "children": ["2"] },
      "2": { "name": "navto", "type": "action", "parent": "1", "agents": ["ada"], "locations": ["IC Room 6"] }
    }"#;

    fn document(text: &str, format: Format) -> MissionDocument {
        MissionDocument::parse(text, format, IhtnFields::default()).unwrap()
    }

    #[test]
    fn a_name_stands_for_a_single_mission() {
        let mut missions = NamedMissions::default();
        assert_eq!(missions.add(document(VISIT, Format::Json)), Ok(()));
        assert_eq!(missions.add(document(VISIT, Format::Json)), Err(NameTaken::OfFleet));
        assert_eq!(missions.add(document(FILES[0], Format::Yaml)), Err(NameTaken::Shipped));
        let names: Vec<&str> = missions.offered().map(|offered| offered.mission.as_str()).collect();
        assert_eq!(names[..2], ["visit", "bed-transfer"], "those of the fleet come first");
        assert_eq!(names.len(), 1 + FILES.len());
        assert!(missions.contains("visit") && missions.contains("vital-signs") && !missions.contains("dance"));
        let error = missions.document("visits", &IhtnFields::default()).unwrap_err().to_string();
        assert!(error.starts_with("the fleet has no mission \"visits\"; allowed: visit, bed-transfer, "), "{error}");
        assert!(error.ends_with("; did you mean `visit`?"), "{error}");
    }

    /// The people of a flat iHTN decide which roles robots take: another list is another mission.
    #[test]
    fn a_request_cannot_change_a_named_mission() {
        let mut missions = NamedMissions::default();
        missions.add(document(VISIT, Format::Json)).unwrap();
        assert!(missions.document("visit", &IhtnFields::default()).is_ok());
        let people = IhtnFields { people: [RoleId::new("ada").unwrap()].into(), ..IhtnFields::default() };
        let name = IhtnFields { name: Some(TaskId::new("tour").unwrap()), ..IhtnFields::default() };
        for (fields, field) in [(people, "people"), (name, "name")] {
            for mission in ["visit", "vital-signs"] {
                let refused = missions.document(mission, &fields).unwrap_err();
                assert_eq!(refused, NamedMissionError::OnlyIhtnFile { field, name: mission.to_owned() });
            }
        }
    }

    #[test]
    fn every_shipped_mission_is_valid_with_its_defaults() {
        let names: Vec<&str> = shipped().keys().map(String::as_str).collect();
        assert_eq!(
            names,
            [
                "bed-transfer",
                "food-logistics",
                "lab-samples",
                "lab-samples-watched",
                "vital-signs",
                "ward-disinfection"
            ]
        );
        for template in shipped().values() {
            assert!(!template.title().is_empty());
            if let Err(errors) = template.instantiate(&BTreeMap::new(), &hospital()) {
                panic!("{errors}");
            }
        }
    }

    /// An alert without an answer is escalated; then the mission fails, which frees its robots.
    #[test]
    fn a_fever_alerts_the_nurse_and_then_the_head_nurse() {
        let mission = shipped()["vital-signs"].instantiate(&BTreeMap::new(), &hospital()).unwrap();
        let of_nurse = mission.elementary().into_iter().filter(|(_, spec)| spec.names(&RoleId::new("nurse").unwrap()));
        let mut alerts = 0;
        for (task, spec) in of_nurse {
            let escalation = spec.escalation.as_deref().unwrap();
            assert_eq!((spec.task_type.as_str(), escalation.to.as_str()), ("alert", "head_nurse"), "{task}");
            assert_eq!(spec.parameters["level"], "urgent", "{task}");
            assert!(spec.patience_s.is_some_and(|patience_s| escalation.after_s < patience_s), "{task}");
            assert!(spec.conditions.iter().any(|condition| condition.contains("temperature_c > 38.0")), "{task}");
            alerts += 1;
        }
        assert_eq!(alerts, 4);
    }

    /// The place of a loss is known only after the loss.
    #[test]
    fn recovery_branches_are_valid_on_a_map() {
        let mut recovered = 0;
        for mission in shipped().values() {
            let everywhere = mission.parameters().values().filter_map(|parameter| parameter.default.clone());
            let fixed = ["Laboratory", "Dock", "Kitchen", "Nurse Station"].map(str::to_owned).into_iter();
            let places = fixed.chain(everywhere).filter_map(|name| PlaceId::new(name).ok());
            let domain = hospital().with_places(places);
            let (_, recovery) = mission
                .instantiate_with_recovery(&BTreeMap::new(), &domain)
                .unwrap_or_else(|problems| panic!("{problems}"));
            recovered += usize::from(recovery.is_some());
        }
        assert!(recovered > 0, "a shipped mission has a recovery branch");
    }
}
