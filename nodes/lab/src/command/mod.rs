//! The commands, each in its own file with its flags and a function `run`.

pub(crate) mod allocate;
pub(crate) mod bench;
pub(crate) mod chaos;
pub(crate) mod check;
mod energy;
pub(crate) mod experiment;
mod legs;
mod named_value;
pub(crate) mod png;
pub mod schema;
mod shift;
pub(crate) mod soak;
pub mod test;
mod workload_flags;
