//! The designs shipped with the program.

use super::Design;

/// Names and texts of the shipped designs.
pub const SHIPPED: &[(&str, &str)] = &[
    ("published", include_str!("../../designs/published.toml")),
    ("food", include_str!("../../designs/food.toml")),
    ("rounds", include_str!("../../designs/rounds.toml")),
];

/// Parses a shipped design; `None` for any other name.
pub fn shipped(name: &str) -> Option<Result<Design, toml::de::Error>> {
    SHIPPED.iter().find(|(known, _)| *known == name).map(|(_, text)| toml::from_str(text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_skills::workload::Workload;

    #[test]
    fn every_shipped_design_is_valid_and_has_its_name() {
        for (name, _) in SHIPPED {
            let design = shipped(name).unwrap().unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(design.name, *name);
            assert_eq!(design.validation_errors(&Workload::default()), Vec::<String>::new(), "{name}");
            let map = consort_world::map::shipped(&design.map).unwrap();
            for scenario in super::super::scenarios(&design) {
                assert_eq!(design.unknown_places(&scenario, &map), Vec::<String>::new(), "{name}");
            }
        }
    }
}
