//! Declaration of ensembles.

use super::exchange::ExchangedValue;
use crate::ids::{EnsembleId, TaskType};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Declaration of an ensemble in the fleet file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EnsembleSpec {
    /// Name of the ensemble.
    pub name: EnsembleId,
    /// Skills that the ensemble's missions need, for use in the conditions.
    #[serde(default)]
    pub skills: BTreeSet<TaskType>,
    /// Conditions on a member, all of which must hold.
    pub membership: Vec<String>,
    /// Conditions on the coordinator. While any of them is false, the ensemble has no members.
    /// Empty: any coordinator is accepted.
    #[serde(default)]
    pub coordinator: Vec<String>,
    /// Maximum age of knowledge, in milliseconds. Raised: nodes remain members for longer after
    /// contact was lost.
    pub stale_after_ms: u64,
    /// Values that its members send each other and no other node, as `attributes.owner` or
    /// `readings.dust_g`. The conditions of ensembles use none of these attributes. Default: none.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub exchange: BTreeSet<ExchangedValue>,
}

impl EnsembleSpec {
    /// Creates the ensemble of the thesis (Listing 3.1): robots with at least 1 of the given
    /// skills.
    pub fn with_any_skill_of(name: EnsembleId, skills: BTreeSet<TaskType>) -> EnsembleSpec {
        EnsembleSpec {
            name,
            skills,
            membership: vec!["member.robot".to_owned(), "member.skills.exists(s, s in ensemble.skills)".to_owned()],
            coordinator: vec![],
            stale_after_ms: 10_000,
            exchange: BTreeSet::new(),
        }
    }
}
