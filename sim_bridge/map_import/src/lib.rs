//! Reads map files of any form; the ending of the file's name gives the form ([`MapFormat`]).
//!
//! Maps of our own form are YAML or JSON (see [`consort_world::map`]). Three foreign forms are
//! imported: drawings of diagrams.net (`.drawio`, `.xml`: see `drawio`), buildings of Open-RMF
//! (`.building.yaml`: see `rmf`) and layouts of vehicles in the Layout Interchange Format
//! (`.lif`: see `lif`). A [`Drawing`] holds the map, and the content of the file that
//! is not part of a map. Reading a file reports *all* its errors, each with the file and the
//! position.

mod drawing;
pub(crate) mod drawio;
mod lanes;
pub(crate) mod lif;
mod read;
mod read_error;
pub(crate) mod rmf;
mod settings;
#[cfg(test)]
mod tests;

pub use consort_world::map::render::DrawnItem;
pub use drawing::{Drawing, DrawnObject, DrawnPerson, DrawnRobot};
pub use read::{ImportDiagnostic, ImportError, load, parse, read};
pub use settings::{ImportOptions, MapFormat};
