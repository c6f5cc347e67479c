//! Maps that come with the program.

use super::{Drawing, ImportOptions, Map, MapError, parse_drawing};

/// The names that [`shipped`] knows.
pub const SHIPPED: &[&str] = &["hospital", "clinic"];

const HOSPITAL: &str = include_str!("../../maps/hospital.yaml");
const CLINIC: &str = include_str!("../../maps/clinic.yaml");

/// A map that comes with the program.
///
/// # Errors
/// [`MapError::NotShipped`] names those that do.
pub fn shipped(name: &str) -> Result<Map, MapError> {
    shipped_drawing(name)?.map.check(&format!("{name}.yaml"))
}

/// A map that comes with the program, as it is written.
///
/// # Errors
/// [`MapError::NotShipped`] names those that do.
pub fn shipped_drawing(name: &str) -> Result<Drawing, MapError> {
    match name {
        "hospital" => parse_drawing(HOSPITAL, "hospital.yaml", &ImportOptions::default()),
        "clinic" => parse_drawing(CLINIC, "clinic.yaml", &ImportOptions::default()),
        _ => Err(MapError::NotShipped { name: name.to_owned() }),
    }
}
