//! The commands, each in its own file with its flags and a function `run`.

pub mod bench;
pub mod chaos;
pub mod check;
pub mod experiment;
pub mod schema;
pub mod test;
