//! The maps shipped with the program.

use super::{Drawing, ImportOptions, Map, MapError, parse_drawing};

/// Names of the shipped maps.
pub const SHIPPED: &[&str] = &["hospital", "clinic"];

const HOSPITAL: &str = include_str!("../../maps/hospital.yaml");
const CLINIC: &str = include_str!("../../maps/clinic.yaml");

/// Returns a shipped map.
///
/// # Errors
/// [`MapError::NotShipped`] lists the shipped maps.
pub fn shipped(name: &str) -> Result<Map, MapError> {
    shipped_drawing(name)?.map.check(&format!("{name}.yaml"))
}

/// Returns a shipped map as it is written.
///
/// # Errors
/// [`MapError::NotShipped`] lists the shipped maps.
pub fn shipped_drawing(name: &str) -> Result<Drawing, MapError> {
    match name {
        "hospital" => parse_drawing(HOSPITAL, "hospital.yaml", &ImportOptions::default()),
        "clinic" => parse_drawing(CLINIC, "clinic.yaml", &ImportOptions::default()),
        _ => Err(MapError::NotShipped { name: name.to_owned() }),
    }
}
