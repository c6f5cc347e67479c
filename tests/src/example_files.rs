//! The example files of nodes, for changes.

use toml::Table;

/// Returns an example file.
///
/// # Panics
/// If there is no example of this kind.
pub fn example(kind: &str) -> Table {
    let text = match kind {
        "fleet" => include_str!("../../examples/fleet.toml"),
        "station" => include_str!("../../examples/station.toml"),
        "world" => include_str!("../../examples/world.toml"),
        "robot" => include_str!("../../examples/robot.toml"),
        "arm" => include_str!("../../examples/arm.toml"),
        other => panic!("there is no example of a {other}"),
    };
    let mut table: Table = text.parse().expect("the examples are TOML");
    // The tests count the delivered samples, so there must be no other items.
    table.remove("object");
    // The calibration of the example is in another file, which the folder of a test does not contain.
    table.remove("calibration");
    table
}
