//! Maps that come with the program.

use super::{Drawing, Map, MapError, Options, open};

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
        "hospital" => open(HOSPITAL, "hospital.yaml", &Options::default()),
        "clinic" => open(CLINIC, "clinic.yaml", &Options::default()),
        _ => Err(MapError::NotShipped { name: name.to_owned() }),
    }
}
