//! Copy of the list of `view/missions` at an observer that reads it again and again: it asks for what has changed.
//!
//! ```text
//!  get view/missions?since=v ──▶ a node ──▶ the missions that have changed, part: { version: w, since: v, removed }
//!                                              │
//!  copy of version v ── complete() ────────────┴─▶ the view with all missions, and the copy of version w
//! ```
//!
//! A reply with all missions replaces the copy: of another node, of a node that has restarted, or the first.

use consort_protocol::view::ListPart;
use serde::Deserialize;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of missions in the copy: several times as many as a ledger contains. A longer list is not
/// copied, so it is read as a whole each time.
const MISSIONS_MAX: usize = 20_000;

/// Name of the list in the view.
const LIST: &str = "missions";

/// The missions of the latest reply, by id, with the version of the list.
#[derive(Debug, Default)]
pub(crate) struct MissionsCopy {
    version: Option<String>,
    missions: BTreeMap<String, Value>,
}

impl MissionsCopy {
    /// Returns the parameters of the next query, as part of its selector.
    pub(crate) fn parameters(&self) -> String {
        format!("?since={}", self.version.as_deref().unwrap_or_default())
    }

    /// Adds the missions that have not changed to a reply, and makes the result the copy. A reply that is no part of the
    /// list stays as it is.
    pub(crate) fn complete(&mut self, view: &mut Value) {
        let MissionsCopy { version, mut missions } = std::mem::take(self);
        let part = view.as_object_mut().and_then(|view| ListPart::deserialize(view.remove("part")?).ok());
        let list = view.get_mut(LIST).and_then(Value::as_array_mut);
        let (Some(part), Some(list)) = (part, list) else { return };
        match &part.since {
            None => missions.clear(),
            // The missions that it leaves out are not known.
            Some(_) if part.since != version => return,
            Some(_) => {
                let removed: BTreeSet<String> = part.removed.into_iter().collect();
                missions.retain(|mission, _| !removed.contains(mission));
            }
        }
        let id = |mission: &Value| mission["mission"].as_str().unwrap_or_default().to_owned();
        missions.extend(list.drain(..).map(|mission| (id(&mission), mission)));
        list.extend(missions.values().cloned());
        list.sort_by_key(|mission| mission["number"].as_u64());
        if missions.len() <= MISSIONS_MAX {
            *self = MissionsCopy { version: Some(part.version), missions };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// Returns missions by their numbers, each with a state.
    fn missions(states: &[(u64, &str)]) -> Value {
        let mission = |(number, state): &(u64, &str)| json!({ "mission": format!("m-{number}"), "number": number, "state": state });
        states.iter().map(mission).collect()
    }

    fn part(states: &[(u64, &str)], part: Value) -> Value {
        json!({ "seen_by": "s1", "missions": missions(states), "part": part })
    }

    fn completed(copy: &mut MissionsCopy, mut view: Value) -> Value {
        copy.complete(&mut view);
        view
    }

    fn whole(states: &[(u64, &str)]) -> Value {
        json!({ "seen_by": "s1", "missions": missions(states) })
    }

    #[test]
    fn changes_complete_the_copy_in_the_order_of_the_list() {
        let mut copy = MissionsCopy::default();
        assert_eq!(copy.parameters(), "?since=");
        let all = [(2, "running"), (9, "pending"), (10, "pending")];
        let first = completed(&mut copy, part(&all, json!({ "version": "s1.1" })));
        assert_eq!((first, copy.parameters()), (whole(&all), "?since=s1.1".to_owned()));
        let changes = json!({ "version": "s1.2", "since": "s1.1", "removed": ["m-2"] });
        let changed = completed(&mut copy, part(&[(9, "running"), (11, "pending")], changes));
        let now = [(9, "running"), (10, "pending"), (11, "pending")];
        assert_eq!((changed, copy.parameters()), (whole(&now), "?since=s1.2".to_owned()));
        let none = completed(&mut copy, part(&[], json!({ "version": "s1.2", "since": "s1.2" })));
        assert_eq!(none, whole(&now));
    }

    #[test]
    fn a_whole_list_replaces_the_copy() {
        let mut copy = MissionsCopy::default();
        completed(&mut copy, part(&[(1, "running"), (2, "pending")], json!({ "version": "s1.7" })));
        let other = completed(&mut copy, part(&[(2, "running")], json!({ "version": "s2.1", "since": null })));
        assert_eq!((other, copy.parameters()), (whole(&[(2, "running")]), "?since=s2.1".to_owned()));
    }

    #[test]
    fn a_reply_that_does_not_fit_the_copy_voids_it() {
        for reply in [
            part(&[(3, "running")], json!({ "version": "s1.9", "since": "s1.8" })),
            whole(&[(3, "running")]),
            json!({ "seen_by": "s1" }),
        ] {
            let mut copy = MissionsCopy::default();
            completed(&mut copy, part(&[(1, "running")], json!({ "version": "s1.7" })));
            let mut expected = reply.clone();
            expected.as_object_mut().unwrap().remove("part");
            assert_eq!((completed(&mut copy, reply), copy.parameters()), (expected, "?since=".to_owned()));
        }
    }
}
