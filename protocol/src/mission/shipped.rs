//! Missions that are shipped with the program.

use super::file::{Format, MissionTemplate};
use std::collections::BTreeMap;
use std::sync::OnceLock;

const FILES: [&str; 6] = [
    include_str!("../../missions/lab-samples.yaml"),
    include_str!("../../missions/lab-samples-watched.yaml"),
    include_str!("../../missions/bed-transfer.yaml"),
    include_str!("../../missions/ward-disinfection.yaml"),
    include_str!("../../missions/food-logistics.yaml"),
    include_str!("../../missions/vital-signs.yaml"),
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

#[cfg(test)]
mod tests {
    use super::super::Domain;
    use super::*;

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
            if let Err(errors) = template.instantiate(&BTreeMap::new(), &Domain::hospital()) {
                panic!("{errors}");
            }
        }
    }
}
