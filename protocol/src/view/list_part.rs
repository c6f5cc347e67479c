//! Part of the list of a view.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Part of the nodes of `view/fleet`, or of the missions of `view/missions`, that a reply contains. A reply has it
/// as `part` if the selector of the query has the parameter `since`, `limit` or `after`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ListPart {
    /// Version of the list, for `since` of a later query.
    pub version: String,
    /// `since` of the query; null if the reply also contains members that have not changed since then, because the
    /// query has no `since`, or the replying node does not know that version.
    #[serde(default)]
    pub since: Option<String>,
    /// Keys of the members that have left the list since then.
    #[serde(default)]
    pub removed: Vec<String>,
    /// `after` of the query for the next page; null if this is the last page.
    #[serde(default)]
    pub next: Option<String>,
}
