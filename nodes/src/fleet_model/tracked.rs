//! Maps that know which of their members may have changed since they were last drawn: a fleet of hundreds is drawn some times
//! in a second, and of most of it nothing new is heard in between.

use super::delta;
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::ops::Deref;

/// A map to be looked at as any other; whatever may change a member takes a note of it.
#[derive(Debug, Clone)]
pub(super) struct TrackedMap<K, V> {
    members: BTreeMap<K, V>,
    /// Those that may have changed, among them some that are gone; without a list it may be any. A list that grew longer than
    /// the members are is of no use: nobody may look for days.
    touched: Option<BTreeSet<K>>,
}

impl<K, V> Default for TrackedMap<K, V> {
    fn default() -> TrackedMap<K, V> {
        TrackedMap { members: BTreeMap::new(), touched: Some(BTreeSet::new()) }
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
        self.touch(name.clone());
        self.members.insert(name, value);
    }

    pub(super) fn remove(&mut self, name: &K) {
        self.touch(name.clone());
        self.members.remove(name);
    }

    /// A member, to be changed; made if it is not there.
    pub(super) fn get_or_insert_with(&mut self, name: K, make: impl FnOnce() -> V) -> &mut V {
        self.touch(name.clone());
        self.members.entry(name).or_insert_with(make)
    }

    /// A member, to be changed if it is there.
    pub(super) fn get_mut(&mut self, name: &K) -> Option<&mut V> {
        if self.members.contains_key(name) {
            self.touch(name.clone());
        }
        self.members.get_mut(name)
    }

    pub(super) fn retain(&mut self, mut keep: impl FnMut(&K, &V) -> bool) {
        let gone: Vec<K> =
            self.members.iter().filter(|(name, value)| !keep(name, value)).map(|(n, _)| n.clone()).collect();
        gone.iter().for_each(|name| self.remove(name));
    }

    /// Puts other members in the place of all there are.
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

    /// Keeps the last `most` in the order of their names.
    pub(super) fn keep_last(&mut self, most: usize) {
        while self.members.len() > most {
            let Some((first, _)) = self.members.pop_first() else { return };
            self.touch(first);
        }
    }

    /// Counts every member as changed.
    pub(super) fn mark_all_changed(&mut self) {
        self.touched = None;
    }

    fn touch(&mut self, name: K) {
        if let Some(touched) = &mut self.touched {
            touched.insert(name);
            if touched.len() > self.members.len() + 1 {
                self.touched = None;
            }
        }
    }
}

impl<K: Ord + Clone + Display, V: Serialize> TrackedMap<K, V> {
    /// Brings what was drawn up to date, and says what has changed, as a patch. From here on nothing counts as changed.
    pub(super) fn render_patch(&mut self, drawn: &mut Map<String, Value>) -> Option<Value> {
        let named = |name: &K| (name.to_string(), self.members.get(name));
        let due: BTreeMap<String, Option<&V>> = match self.touched.replace(BTreeSet::new()) {
            Some(touched) => touched.iter().map(named).collect(),
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
    fn only_what_was_touched_is_drawn_and_only_what_differs_is_told() {
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

        // Touched, and as before.
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
    fn what_was_drawn_of_others_becomes_what_there_is() {
        let mut tracked = TrackedMap::default();
        tracked.insert("ada", json!({ "x": 1, "y": 2 }));
        let Value::Object(mut drawn) = json!({ "ada": { "x": 1, "y": 3 }, "bob": {} }) else { return };
        tracked.mark_all_changed();
        assert_eq!(tracked.render_patch(&mut drawn), Some(json!({ "ada": { "y": 2 }, "bob": null })));
        assert_eq!(Value::Object(drawn), json!({ "ada": { "x": 1, "y": 2 } }));
    }

    #[test]
    fn no_more_is_noted_than_there_is_though_nobody_looks() {
        let mut tracked = TrackedMap::default();
        let mut drawn = Map::new();
        tracked.insert(0, json!(0));
        tracked.render_patch(&mut drawn);
        for number in 1..1000 {
            tracked.insert(number, json!(number));
            tracked.keep_last(10);
            assert!(tracked.touched.as_ref().is_none_or(|touched| touched.len() <= 11));
        }
        let patch = tracked.render_patch(&mut drawn).unwrap();
        assert_eq!((patch["0"].clone(), patch["999"].clone(), drawn.len()), (Value::Null, json!(999), 10));
        tracked.insert(1000, json!(0));
        assert_eq!(tracked.render_patch(&mut drawn), Some(json!({ "1000": 0 })), "from then on single ones again");
    }
}
