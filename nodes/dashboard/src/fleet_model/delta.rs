//! The difference of two JSON values, as a JSON merge patch (RFC 7396): equal members are left out,
//! objects are compared by member, everything else is replaced, and null removes a member. So nulls
//! cannot be sent as values; `strip_nulls` removes them beforehand.

use serde_json::{Map, Value};

/// Returns the patch from `before` to `after`; `None` if nothing has changed. Neither contains
/// nulls.
pub fn between(before: &Value, after: &Value) -> Option<Value> {
    match (before, after) {
        (Value::Object(before), Value::Object(after)) => {
            let mut patch = Map::new();
            for name in before.keys().filter(|name| !after.contains_key(*name)) {
                patch.insert(name.clone(), Value::Null);
            }
            for (name, now) in after {
                let change = before.get(name).map_or_else(|| Some(now.clone()), |was| between(was, now));
                if let Some(change) = change {
                    patch.insert(name.clone(), change);
                }
            }
            (!patch.is_empty()).then_some(Value::Object(patch))
        }
        _ => (before != after).then(|| after.clone()),
    }
}

/// Replaces a member of `drawn`, or removes it if the value is null, and adds the change to
/// `patch`.
pub(crate) fn replace_member(
    drawn: &mut Map<String, Value>,
    patch: &mut Map<String, Value>,
    name: String,
    value: Value,
) {
    if value.is_null() {
        if drawn.remove(&name).is_some() {
            patch.insert(name, Value::Null);
        }
        return;
    }
    let change = match drawn.get(&name) {
        Some(before) => between(before, &value),
        None => Some(value.clone()),
    };
    if let Some(change) = change {
        drawn.insert(name.clone(), value);
        patch.insert(name, change);
    }
}

/// Applies a patch to a value.
pub fn apply(value: &mut Value, patch: &Value) {
    let Value::Object(changes) = patch else {
        *value = patch.clone();
        return;
    };
    if !value.is_object() {
        *value = Value::Object(Map::new());
    }
    let Value::Object(members) = value else { return };
    for (name, change) in changes {
        if change.is_null() {
            members.remove(name);
        } else {
            apply(members.entry(name.clone()).or_insert(Value::Null), change);
        }
    }
}

/// Removes null members of objects, at any depth. Nulls in lists stay: lists are replaced as a
/// whole.
pub(crate) fn strip_nulls(value: &mut Value) {
    match value {
        Value::Object(members) => {
            members.retain(|_, member| !member.is_null());
            members.values_mut().for_each(strip_nulls);
        }
        Value::Array(items) => items.iter_mut().for_each(strip_nulls),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_patch_holds_what_has_changed_and_nothing_else() {
        let before =
            json!({ "robots": { "ada": { "x": 1.0, "y": 2.0 }, "bob": { "x": 3.0 } }, "log": { "1": "a" }, "l": [1] });
        let after = json!({ "robots": { "ada": { "x": 1.5, "y": 2.0 }, "cyd": { "x": 4.0 } }, "log": { "1": "a" }, "l": [1, 2] });
        let patch = between(&before, &after).unwrap();
        assert_eq!(patch, json!({ "robots": { "ada": { "x": 1.5 }, "bob": null, "cyd": { "x": 4.0 } }, "l": [1, 2] }));
        let mut value = before;
        apply(&mut value, &patch);
        assert_eq!(value, after);
        assert_eq!(between(&value, &after), None);
    }

    #[test]
    fn an_object_replaces_other_values_and_is_replaced_by_them() {
        for (before, after) in [
            (json!({ "a": 1 }), json!({ "a": { "b": 2 } })),
            (json!({ "a": { "b": 2 } }), json!({ "a": 1 })),
            (json!({ "a": { "b": 2 } }), json!({ "a": {} })),
            (json!({ "a": {} }), json!({})),
        ] {
            let mut value = before.clone();
            apply(&mut value, &between(&before, &after).unwrap());
            assert_eq!(value, after);
        }
    }

    #[test]
    fn nulls_are_removed_at_any_depth() {
        let mut value = json!({ "a": null, "b": { "c": null, "d": [ { "e": null, "f": 1 } ] } });
        strip_nulls(&mut value);
        assert_eq!(value, json!({ "b": { "d": [ { "f": 1 } ] } }));
    }
}
