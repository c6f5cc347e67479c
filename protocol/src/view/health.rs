//! View of the health of a fleet.

use super::readable;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Health of a fleet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HealthView {
    /// Level of the most severe finding.
    pub level: HealthLevel,
    /// Findings, the most severe first. Without a problem, a single finding confirms this.
    #[serde(default, deserialize_with = "readable")]
    pub findings: Vec<HealthFinding>,
}

/// Severity of a health finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum HealthLevel {
    /// No problem.
    Ok,
    /// The fleet continues to work; an operator should check.
    Warning,
    /// A function has stopped until an operator intervenes.
    Error,
}

/// Finding of the health check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HealthFinding {
    /// Severity.
    pub level: HealthLevel,
    /// Subject: `coordinator`, `quorum`, `cluster`, `node`, `robot`, `device`, `domain`, `mission`, `alarm`,
    /// `ledger` or `fleet`.
    #[serde(default)]
    pub about: String,
    /// Id of the node, robot, device, domain, mission or alarm, if the finding concerns any.
    #[serde(default)]
    pub name: Option<String>,
    /// Description for people.
    // Recordings of earlier releases use the name `says`.
    #[serde(default, alias = "says")]
    pub text: String,
}
