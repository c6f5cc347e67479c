//! Missions that are shipped with the program.

use consort_protocol::mission::{Format, MissionTemplate};
use std::collections::BTreeMap;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::hospital;
    use consort_protocol::ids::PlaceId;

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
