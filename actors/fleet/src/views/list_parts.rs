//! Parts of the lists of views: what has changed since a version, and pages.
//!
//! ```text
//!  get view/fleet?since=                  ─▶ all nodes,                      part: { version: v, … }
//!  get view/fleet?since=v                 ─▶ the nodes that have changed,    part: { version: w, since: v, removed, … }
//!  get view/missions?limit=100            ─▶ the first missions,             part: { version: v, next: "107", … }
//!  get view/missions?limit=100;after=107  ─▶ the missions after number 107,  part: { version: v, next: null, … }
//! ```
//!
//! A version counts the changes of a list as far as requests have seen them, and belongs to a node since its start:
//! any other `since` gets the whole list. The age of a record is no change. A client that reads the changes page by
//! page keeps the version of the first page. A part of `view/fleet` has no `ensembles`: they are in `view/ensembles`.

use super::draw::json;
use consort_protocol::api::ErrorReply;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use consort_protocol::view::ListPart;
use serde_json::Value;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};

/// Maximum number of removed members that are remembered for each list.
const REMOVED_MAX: usize = 4096;

/// A request for a part of a list.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct PartRequest {
    since: Option<String>,
    limit: Option<String>,
    after: Option<String>,
}

impl PartRequest {
    /// Reads the parameters of a selector; `None` if they request no part. Other parameters are Zenoh's.
    pub(super) fn parse(parameters: &str) -> Option<PartRequest> {
        let mut request = PartRequest::default();
        for parameter in parameters.split(';') {
            let (name, value) = parameter.split_once('=').unwrap_or((parameter, ""));
            match name {
                "since" => request.since = Some(value.to_owned()),
                "limit" => request.limit = Some(value.to_owned()),
                "after" => request.after = Some(value.to_owned()),
                _ => {}
            }
        }
        (request != PartRequest::default()).then_some(request)
    }
}

/// The list of a view.
struct ListForm {
    /// Name of the list in the view.
    list: &'static str,
    /// Name of the key of a member.
    key: &'static str,
    /// Name of the number by which the members are ordered; without it they are ordered by their keys.
    number: Option<&'static str>,
}

/// Name of the age of a record, which changes all the time.
const AGE: &str = "age_ms";

/// Position of a member in the order of its list.
type Position = (u64, String);

impl ListForm {
    fn of(key: &Key) -> Option<ListForm> {
        match key {
            Key::Seen(_, view) => ListForm::of(view),
            Key::ViewFleet => Some(ListForm { list: "nodes", key: "node", number: None }),
            Key::ViewMissions => Some(ListForm { list: "missions", key: "mission", number: Some("number") }),
            _ => None,
        }
    }

    fn key_of(&self, member: &Value) -> String {
        member[self.key].as_str().unwrap_or_default().to_owned()
    }

    fn position_of(&self, member: &Value) -> Position {
        match self.number {
            Some(number) => (member[number].as_u64().unwrap_or_default(), String::new()),
            None => (0, self.key_of(member)),
        }
    }

    /// Reads the position in a parameter `after`.
    fn position_in(&self, after: &str) -> Option<Position> {
        match self.number {
            Some(_) => Some((after.parse().ok()?, String::new())),
            None => Some((0, after.to_owned())),
        }
    }

    /// Writes a position as a parameter `after`.
    fn after(&self, (number, key): Position) -> String {
        if self.number.is_some() { number.to_string() } else { key }
    }
}

/// Versions of the lists of a node's views.
#[derive(Debug)]
pub(super) struct ListParts {
    /// Begin of all versions of this node since its start.
    run: String,
    lists: BTreeMap<&'static str, VersionedList>,
}

impl ListParts {
    /// Creates the versions of a node that starts at a time in milliseconds since 1970.
    pub(super) fn new(node: &NodeId, start_ms: u64) -> ListParts {
        ListParts { run: format!("{node}.{start_ms:x}"), lists: BTreeMap::new() }
    }

    /// Reduces a view to the requested part of its list. A view without a list, and an error, stay as they are.
    pub(super) fn select(&mut self, key: &Key, view: &mut Value, request: &PartRequest) {
        let Some(form) = ListForm::of(key) else { return };
        let limit = match request.limit.as_deref().map(str::parse::<usize>) {
            None => usize::MAX,
            Some(Ok(limit @ 1..)) => limit,
            Some(_) => {
                *view = invalid("limit", request.limit.as_deref(), "a whole number from 1");
                return;
            }
        };
        let after = request.after.as_deref().map(|after| form.position_in(after));
        if after == Some(None) {
            *view = invalid("after", request.after.as_deref(), "the `next` of the page before");
            return;
        }
        let Some(members) = view.get_mut(form.list).and_then(Value::as_array_mut).map(std::mem::take) else { return };
        let list = self.lists.entry(form.list).or_default();
        list.update(members.iter().map(|member| (form.key_of(member), digest(member))).collect());
        let run = format!("{}.{}.", self.run, form.list);
        let since = request.since.as_deref().and_then(|since| since.strip_prefix(&run)?.parse::<u64>().ok());
        let since = since.filter(|since| list.knows(*since));
        let is_first_page = after.is_none();
        let after = after.flatten();
        let is_selected = |member: &Value| {
            since.is_none_or(|since| list.has_changed(&form.key_of(member), since))
                && after.as_ref().is_none_or(|after| form.position_of(member) > *after)
        };
        let mut selected: Vec<Value> = members.into_iter().filter(is_selected).collect();
        let has_next = selected.len() > limit;
        selected.truncate(limit);
        let next = selected.last().filter(|_| has_next).map(|last| form.after(form.position_of(last)));
        let part = ListPart {
            version: format!("{run}{}", list.version),
            since: request.since.clone().filter(|_| since.is_some()),
            removed: since.filter(|_| is_first_page).map(|since| list.removed_since(since)).unwrap_or_default(),
            next,
        };
        if let Value::Object(view) = view {
            view.insert(form.list.to_owned(), Value::Array(selected));
            view.insert("part".to_owned(), json(part));
            view.remove("ensembles");
        }
    }
}

fn invalid(name: &str, value: Option<&str>, allowed: &str) -> Value {
    json(ErrorReply::rejected(format!("{name} is {:?}, allowed is {allowed}", value.unwrap_or_default())))
}

/// Returns a digest of a member without its age.
fn digest(member: &Value) -> u64 {
    let mut hasher = DefaultHasher::new();
    for (name, value) in member.as_object().into_iter().flatten().filter(|(name, _)| *name != AGE) {
        (name, value.to_string()).hash(&mut hasher);
    }
    hasher.finish()
}

/// The members of a list with the versions in which they have changed.
#[derive(Debug, Default)]
struct VersionedList {
    version: u64,
    /// Digest of each member, and the version in which it changed last.
    members: BTreeMap<String, (u64, u64)>,
    /// Members that have left the list, and the version in which they did.
    removed: BTreeMap<String, u64>,
    /// Version since which all removed members are remembered.
    complete_since: u64,
}

impl VersionedList {
    /// Notes the current members with their digests.
    fn update(&mut self, digests: BTreeMap<String, u64>) {
        let next = self.version + 1;
        let gone: Vec<String> = self.members.keys().filter(|key| !digests.contains_key(*key)).cloned().collect();
        let mut is_changed = !gone.is_empty();
        for key in gone {
            self.members.remove(&key);
            self.removed.insert(key, next);
        }
        for (key, digest) in digests {
            if self.members.get(&key).is_none_or(|(known, _)| *known != digest) {
                is_changed = true;
                self.removed.remove(&key);
                self.members.insert(key, (digest, next));
            }
        }
        if is_changed {
            self.version = next;
        }
        while self.removed.len() > REMOVED_MAX {
            let first = self.removed.iter().min_by_key(|(_, version)| **version);
            let Some((key, version)) = first.map(|(key, version)| (key.clone(), *version)) else { return };
            self.removed.remove(&key);
            self.complete_since = version;
        }
    }

    /// Checks whether all changes since a version are known.
    fn knows(&self, version: u64) -> bool {
        (self.complete_since..=self.version).contains(&version)
    }

    fn has_changed(&self, key: &str, since: u64) -> bool {
        self.members.get(key).is_none_or(|(_, version)| *version > since)
    }

    fn removed_since(&self, since: u64) -> Vec<String> {
        self.removed.iter().filter(|(_, version)| **version > since).map(|(key, _)| key.clone()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json as value;

    fn parts(node: &str) -> ListParts {
        ListParts::new(&NodeId::new(node).unwrap(), 4096)
    }

    /// Returns a fleet view of nodes with their places and ages.
    fn fleet(nodes: &[(&str, &str, u64)]) -> Value {
        let node = |(node, place, age): &(&str, &str, u64)| value!({ "node": node, "place": place, "age_ms": age });
        value!({ "seen_by": "s1", "nodes": nodes.iter().map(node).collect::<Vec<_>>(), "ensembles": [{ "name": "ward" }] })
    }

    /// Returns the view of missions with these numbers.
    fn missions(numbers: impl IntoIterator<Item = u64>) -> Value {
        let mission = |number| value!({ "mission": format!("m-{number}"), "number": number });
        value!({ "missions": numbers.into_iter().map(mission).collect::<Vec<_>>() })
    }

    fn select(parts: &mut ListParts, key: &Key, view: &Value, parameters: &str) -> Value {
        let mut view = view.clone();
        parts.select(key, &mut view, &PartRequest::parse(parameters).unwrap());
        view
    }

    /// Returns the keys of the members of a list.
    fn keys(view: &Value, list: &str, key: &str) -> Vec<String> {
        let members = view[list].as_array().unwrap_or_else(|| panic!("{list} in {view}"));
        members.iter().map(|member| member[key].as_str().unwrap().to_owned()).collect()
    }

    fn since(view: &Value) -> String {
        format!("since={}", view["part"]["version"].as_str().unwrap_or_else(|| panic!("a version in {view}")))
    }

    #[test]
    fn a_reply_contains_the_members_that_have_changed_since_a_version() {
        let mut parts = parts("s1");
        let mut get = |nodes: &[(&str, &str, u64)], parameters: &str| {
            select(&mut parts, &Key::ViewFleet, &fleet(nodes), parameters)
        };
        let first = get(&[("ada", "A", 10), ("bob", "A", 10), ("cyd", "A", 10)], "since=");
        assert_eq!(keys(&first, "nodes", "node"), ["ada", "bob", "cyd"]);
        assert_eq!((&first["part"]["since"], &first["seen_by"]), (&Value::Null, &value!("s1")));
        assert!(first.get("ensembles").is_none(), "{first}");
        let aged = get(&[("ada", "A", 20), ("bob", "A", 20), ("cyd", "A", 20)], &since(&first));
        assert_eq!((keys(&aged, "nodes", "node"), since(&aged)), (vec![], since(&first)), "an age is no change");
        let moved = get(&[("ada", "A", 5), ("bob", "B", 5)], &since(&first));
        assert_eq!(keys(&moved, "nodes", "node"), ["bob"]);
        assert_eq!(moved["part"]["removed"], value!(["cyd"]));
        assert_eq!(moved["part"]["since"], first["part"]["version"]);
        let back = get(&[("ada", "A", 5), ("bob", "B", 5), ("cyd", "A", 5)], &since(&moved));
        assert_eq!((keys(&back, "nodes", "node"), &back["part"]["removed"]), (vec!["cyd".to_owned()], &value!([])));
        let late = get(&[("ada", "A", 5), ("bob", "B", 5), ("cyd", "A", 5)], &since(&first));
        assert_eq!(keys(&late, "nodes", "node"), ["bob", "cyd"]);
    }

    #[test]
    fn an_unknown_version_gets_the_whole_list() {
        let view = fleet(&[("ada", "A", 1)]);
        let other = select(&mut parts("s2"), &Key::ViewFleet, &view, "since=");
        let mut own = parts("s1");
        let listed = select(&mut own, &Key::ViewMissions, &missions([1]), "since=");
        let newer = format!("{}0", since(&select(&mut own, &Key::ViewFleet, &view, "since=")));
        for since in [since(&other), since(&listed), newer, "since=x".to_owned()] {
            let got = select(&mut own, &Key::ViewFleet, &view, &since);
            assert_eq!(
                (keys(&got, "nodes", "node"), &got["part"]["since"]),
                (vec!["ada".to_owned()], &Value::Null),
                "{since}"
            );
        }
    }

    #[test]
    fn forgotten_removals_make_earlier_versions_unknown() {
        let mut list = VersionedList::default();
        let members = |names: std::ops::Range<usize>| names.map(|name| (format!("{name:05}"), 0)).collect();
        list.update(members(0..REMOVED_MAX + 1));
        list.update(members(1..REMOVED_MAX + 1));
        assert!(list.knows(1));
        list.update(members(0..0));
        assert_eq!((list.knows(1), list.knows(2), list.removed.len()), (false, true, REMOVED_MAX));
        assert_eq!(list.removed_since(2).len(), REMOVED_MAX);
    }

    #[test]
    fn pages_add_up_to_the_list() {
        let (mut parts, all) = (parts("s1"), missions(1..=11));
        let key = Key::Seen(NodeId::new("s1").unwrap(), Box::new(Key::ViewMissions));
        let (mut found, mut after, mut pages) = (vec![], String::new(), 0);
        loop {
            let page = select(&mut parts, &key, &all, &format!("_time=[now(-1s)..];limit=4{after}"));
            found.extend(keys(&page, "missions", "mission"));
            pages += 1;
            match page["part"]["next"].as_str() {
                Some(next) => after = format!(";after={next}"),
                None => break,
            }
        }
        assert_eq!((found, pages), (keys(&all, "missions", "mission"), 3));
        let exact = select(&mut parts, &key, &all, "limit=11");
        assert_eq!(exact["part"]["next"], Value::Null, "no empty page follows");
    }

    #[test]
    fn invalid_parameters_are_named() {
        let (mut parts, all) = (parts("s1"), missions([1]));
        for (parameters, problem) in [
            ("limit=0", "limit is \"0\", allowed is a whole number from 1"),
            ("limit=all", "limit is \"all\", allowed is a whole number from 1"),
            ("after=m-1", "after is \"m-1\", allowed is the `next` of the page before"),
        ] {
            let got = select(&mut parts, &Key::ViewMissions, &all, parameters);
            assert_eq!(got, value!({ "error": problem }), "{parameters}");
        }
    }

    #[test]
    fn other_views_and_parameters_have_no_parts() {
        assert_eq!(["", "_time=[..]", "_anyke"].map(PartRequest::parse), [None, None, None]);
        let (mut parts, health, error) = (parts("s1"), value!({ "level": "ok" }), value!({ "error": "no voter" }));
        assert_eq!(select(&mut parts, &Key::ViewHealth, &health, "since="), health);
        assert_eq!(select(&mut parts, &Key::ViewMissions, &error, "since="), error);
    }
}
