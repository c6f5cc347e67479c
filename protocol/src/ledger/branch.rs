//! Branches of a mission.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Branch of a mission that is executed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Branch {
    /// The mission as requested.
    #[default]
    Main,
    /// The recovery branch, executed after a loss. A mission never returns from it to the main
    /// branch.
    Recovery,
}

impl Branch {
    /// Returns the name.
    pub fn as_str(self) -> &'static str {
        match self {
            Branch::Main => "main",
            Branch::Recovery => "recovery",
        }
    }
}
