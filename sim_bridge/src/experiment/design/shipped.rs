//! Designs that come with the program.

use super::Design;

/// Their names, and their texts.
pub const SHIPPED: &[(&str, &str)] = &[
    ("published", include_str!("../../../designs/published.toml")),
    ("food", include_str!("../../../designs/food.toml")),
    ("rounds", include_str!("../../../designs/rounds.toml")),
];

/// The text of a shipped design, and what reads it; `None` for a name that is not shipped.
pub fn shipped(name: &str) -> Option<Result<Design, toml::de::Error>> {
    SHIPPED.iter().find(|(known, _)| *known == name).map(|(_, text)| toml::from_str(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_design_is_sound_and_bears_its_name() {
        for (name, _) in SHIPPED {
            let design = shipped(name).unwrap().unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(design.name, *name);
            assert_eq!(design.validation_errors(), Vec::<String>::new(), "{name}");
            let map = crate::map::shipped(&design.map).unwrap();
            for scenario in super::super::scenarios(&design) {
                assert_eq!(design.unknown_places(&scenario, &map), Vec::<String>::new(), "{name}");
            }
        }
    }
}
