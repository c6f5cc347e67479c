//! Maps that come with the program.

use super::{Map, MapError, read};

/// The names that [`shipped`] knows.
pub const SHIPPED: &[&str] = &["hospital", "clinic"];

const HOSPITAL: &str = include_str!("../../maps/hospital.yaml");
const CLINIC: &str = include_str!("../../maps/clinic.yaml");

/// A map that comes with the program.
///
/// # Errors
/// [`MapError::NotShipped`] names those that do.
pub fn shipped(name: &str) -> Result<Map, MapError> {
    match name {
        "hospital" => read(HOSPITAL, "hospital.yaml"),
        "clinic" => read(CLINIC, "clinic.yaml"),
        _ => Err(MapError::NotShipped { name: name.to_owned() }),
    }
}
