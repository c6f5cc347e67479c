//! Maps that come with the program.

use super::{Drawing, Map, MapError, Options, open};

/// The names that [`shipped`] knows.
pub const SHIPPED: &[&str] = &["hospital"];

const HOSPITAL: &str = include_str!("../../maps/hospital.yaml");

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
        _ => Err(MapError::NotShipped { name: name.to_owned() }),
    }
}
