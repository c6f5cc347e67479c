//! Parts of the simulator that the program itself adds, in a setup.

use std::any::Any;
use std::fmt;

/// The [`SimulatorExtension`](crate::extend::SimulatorExtension) of a program, if it has one. The setup does not know the
/// type, because the systems of the extension read the setup.
#[derive(Clone, Copy, Default)]
pub struct ProgramParts(pub(crate) Option<&'static (dyn Any + Send + Sync)>);

impl PartialEq for ProgramParts {
    fn eq(&self, other: &ProgramParts) -> bool {
        match (self.0, other.0) {
            (Some(one), Some(other)) => std::ptr::addr_eq(one, other),
            (one, other) => one.is_none() && other.is_none(),
        }
    }
}

impl fmt::Debug for ProgramParts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() { "of the program" } else { "none" })
    }
}
