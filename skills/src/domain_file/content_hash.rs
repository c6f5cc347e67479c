//! The hash of a domain's content.

use super::form::{DomainForm, ParameterForm};
use consort_protocol::mission::DomainHash;
use siphasher::sip::SipHasher13;
use std::collections::BTreeMap;
use std::hash::Hasher;

/// Returns the hash of a domain and of the texts of its trees. It is the same on every machine.
/// Descriptions, units, and the order and layout of the file do not count.
pub(super) fn content_hash(form: &DomainForm, trees: &BTreeMap<String, String>) -> DomainHash {
    let content = serde_json::to_string(&without_texts(form.clone())).expect("a domain has a JSON form");
    let used: BTreeMap<&str, &str> =
        form.tree_files().filter_map(|name| trees.get(name).map(|text| (name, text.as_str()))).collect();
    let mut hasher = SipHasher13::new();
    for text in [content.as_str()].into_iter().chain(used.into_values()) {
        hasher.write_u64(text.len() as u64);
        hasher.write(text.as_bytes());
    }
    DomainHash(hasher.finish())
}

/// Returns the domain without texts for people.
fn without_texts(mut form: DomainForm) -> DomainForm {
    let strip = |values: &mut BTreeMap<String, ParameterForm>| {
        for value in values.values_mut() {
            value.description.clear();
            value.unit.clear();
        }
    };
    form.description.clear();
    for reading in form.readings.values_mut() {
        reading.value.description.clear();
        reading.value.unit.clear();
    }
    for action in form.actions.values_mut() {
        action.description.clear();
        strip(&mut action.parameters);
        strip(&mut action.results);
        strip(&mut action.feedback);
    }
    for task in form.tasks.values_mut() {
        task.description.clear();
        strip(&mut task.parameters);
        strip(&mut task.results);
    }
    form
}
