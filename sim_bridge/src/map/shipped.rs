//! Maps that come with the program.

use super::{Map, MapError, read};

/// The names that [`shipped`] knows.
pub const SHIPPED: &[&str] = &["hospital"];

const HOSPITAL: &str = include_str!("../../maps/hospital.yaml");

/// A map that comes with the program.
///
/// # Errors
/// [`MapError::NotShipped`] names those that do.
pub fn shipped(name: &str) -> Result<Map, MapError> {
    match name {
        "hospital" => read(HOSPITAL, "hospital.yaml"),
        _ => Err(MapError::NotShipped { name: name.to_owned() }),
    }
}
