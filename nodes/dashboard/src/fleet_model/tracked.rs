//! Maps that track changed members since the last rendering: a fleet of hundreds is rendered
//! several times per second, and most of it is unchanged.

use super::delta;
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::ops::Deref;

/// A map that tracks changes; every access that may change a member marks it.
#[derive(Debug, Clone)]
pub(super) struct TrackedMap<K, V> {
    members: BTreeMap<K, V>,
    /// Members that may have changed or were removed; `None` if any may have changed. A list longer
    /// than the map is useless and is dropped: there may be no client for days.
    changed: Option<BTreeSet<K>>,
}

impl<K, V> Default for TrackedMap<K, V> {
    fn default() -> TrackedMap<K, V> {
        TrackedMap { members: BTreeMap::new(), changed: Some(BTreeSet::new()) }
    }
}

impl<K, V> Deref for TrackedMap<K, V> {
    type Target = BTreeMap<K, V>;

    fn deref(&self) -> &BTreeMap<K, V> {
        &self.members
    }
}

impl<K: Ord + Clone, V> TrackedMap<K, V> {
    pub(super) fn insert(&mut self, name: K, value: V) {
        self.mark_changed(name.clone());
        self.members.insert(name, value);
    }

    pub(super) fn remove(&mut self, name: &K) {
        self.mark_changed(name.clone());
        self.members.remove(name);
    }

    /// Returns a member for changing; created if missing.
    pub(super) fn get_or_insert_with(&mut self, name: K, make: impl FnOnce() -> V) -> &mut V {
        self.mark_changed(name.clone());
        self.members.entry(name).or_insert_with(make)
    }

    /// Returns an existing member for changing.
    pub(super) fn get_mut(&mut self, name: &K) -> Option<&mut V> {
        if self.members.contains_key(name) {
            self.mark_changed(name.clone());
        }
        self.members.get_mut(name)
    }

    pub(super) fn retain(&mut self, mut keep: impl FnMut(&K, &V) -> bool) {
        let gone: Vec<K> =
            self.members.iter().filter(|(name, value)| !keep(name, value)).map(|(n, _)| n.clone()).collect();
        gone.iter().for_each(|name| self.remove(name));
    }

    /// Replaces all members.
    pub(super) fn replace(&mut self, members: BTreeMap<K, V>)
    where
        V: PartialEq,
    {
        self.retain(|name, _| members.contains_key(name));
        for (name, value) in members {
            if self.members.get(&name) != Some(&value) {
                self.insert(name, value);
            }
        }
    }

    /// Keeps the last `most` members in the order of their names.
    pub(super) fn keep_last(&mut self, most: usize) {
        while self.members.len() > most {
            let Some((first, _)) = self.members.pop_first() else { return };
            self.mark_changed(first);
        }
    }

    /// Marks every member as changed.
    pub(super) fn mark_all_changed(&mut self) {
        self.changed = None;
    }

    fn mark_changed(&mut self, name: K) {
        if let Some(changed) = &mut self.changed {
            changed.insert(name);
            if changed.len() > self.members.len() + 1 {
                self.changed = None;
            }
        }
    }
}

impl<K: Ord + Clone + Display, V: Serialize> TrackedMap<K, V> {
    /// Updates the former rendering, and returns the changes as a patch. Afterwards no member
    /// counts as changed.
    pub(super) fn render_patch(&mut self, drawn: &mut Map<String, Value>) -> Option<Value> {
        let named = |name: &K| (name.to_string(), self.members.get(name));
        let due: BTreeMap<String, Option<&V>> = match self.changed.replace(BTreeSet::new()) {
            Some(changed) => changed.iter().map(named).collect(),
            None => drawn.keys().map(|name| (name.clone(), None)).chain(self.members.keys().map(named)).collect(),
        };
        let mut patch = Map::new();
        for (name, member) in due {
            let mut value = member.map_or(Value::Null, |member| serde_json::to_value(member).unwrap_or_default());
            delta::strip_nulls(&mut value);
            delta::replace_member(drawn, &mut patch, name, value);
        }
        (!patch.is_empty()).then_some(Value::Object(patch))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn only_changed_members_are_rendered_and_only_differences_sent() {
        let mut tracked = TrackedMap::default();
        let mut drawn = Map::new();
        tracked.insert("ada", json!({ "x": 1, "y": 2, "gone": null }));
        tracked.insert("bob", json!({ "x": 3 }));
        assert_eq!(tracked.render_patch(&mut drawn), Some(json!({ "ada": { "x": 1, "y": 2 }, "bob": { "x": 3 } })));
        assert_eq!(tracked.render_patch(&mut drawn), None);

        *tracked.get_mut(&"ada").unwrap() = json!({ "x": 1, "y": 5 });
        tracked.remove(&"bob");
        tracked.get_or_insert_with("cyd", || json!({}));
        assert!(tracked.get_mut(&"nobody").is_none());
        assert_eq!(tracked.render_patch(&mut drawn), Some(json!({ "ada": { "y": 5 }, "bob": null, "cyd": {} })));
        assert_eq!(Value::Object(drawn.clone()), json!({ "ada": { "x": 1, "y": 5 }, "cyd": {} }));

        // Marked, but unchanged.
        tracked.get_mut(&"ada");
        assert_eq!(tracked.render_patch(&mut drawn), None);
        tracked.replace([("ada", json!({ "x": 1, "y": 5 })), ("dot", json!(1))].into());
        assert_eq!(tracked.render_patch(&mut drawn), Some(json!({ "cyd": null, "dot": 1 })));
        tracked.keep_last(1);
        assert_eq!(tracked.render_patch(&mut drawn), Some(json!({ "ada": null })));
        tracked.mark_all_changed();
        assert_eq!(tracked.render_patch(&mut Map::new()), Some(json!({ "dot": 1 })));
    }

    #[test]
    fn a_rendering_of_another_map_is_brought_up_to_date() {
        let mut tracked = TrackedMap::default();
        tracked.insert("ada", json!({ "x": 1, "y": 2 }));
        let Value::Object(mut drawn) = json!({ "ada": { "x": 1, "y": 3 }, "bob": {} }) else { return };
        tracked.mark_all_changed();
        assert_eq!(tracked.render_patch(&mut drawn), Some(json!({ "ada": { "y": 2 }, "bob": null })));
        assert_eq!(Value::Object(drawn), json!({ "ada": { "x": 1, "y": 2 } }));
    }

    #[test]
    fn the_list_of_changes_is_bounded_without_rendering() {
        let mut tracked = TrackedMap::default();
        let mut drawn = Map::new();
        tracked.insert(0, json!(0));
        tracked.render_patch(&mut drawn);
        for number in 1..1000 {
            tracked.insert(number, json!(number));
            tracked.keep_last(10);
            assert!(tracked.changed.as_ref().is_none_or(|changed| changed.len() <= 11));
        }
        let patch = tracked.render_patch(&mut drawn).unwrap();
        assert_eq!((patch["0"].clone(), patch["999"].clone(), drawn.len()), (Value::Null, json!(999), 10));
        tracked.insert(1000, json!(0));
        assert_eq!(tracked.render_patch(&mut drawn), Some(json!({ "1000": 0 })), "afterwards single changes again");
    }
}
