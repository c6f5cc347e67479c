//! Views that come from the ledger, and the parts of the views of the fleet and of robots that do. A node without a
//! ledger takes them from a voter.

use consort_protocol::keys::Key;
use serde_json::Value;

/// Members of the view of a fleet, by the ledger.
const OF_FLEET: [&str; 4] = ["closures", "speed_limits", "alarms", "chargers"];

/// Members of the view of a node, by the ledger.
const OF_NODE: [&str; 3] = ["holds", "orders", "promised"];

/// Members of the view of a robot, by the ledger, besides those of its node.
const OF_ROBOT: [&str; 1] = ["ledger"];

/// Checks whether a view contains data of the ledger.
pub(super) fn is_of_ledger(key: &Key) -> bool {
    match key {
        Key::ViewMissions | Key::ViewRequests | Key::ViewSchedules | Key::ViewAudit | Key::ViewMission(_) => true,
        key => matches!(key, Key::ViewAuctions | Key::ViewHealth),
    }
}

/// Checks whether a part of a view contains data of the ledger.
pub(super) fn has_part_of_ledger(key: &Key) -> bool {
    matches!(key, Key::ViewFleet | Key::ViewRobot(_))
}

/// Checks whether a view shows that the node that drew it has a ledger. Any node draws the view of the health.
pub(super) fn shows_ledger(key: &Key, view: &Value) -> bool {
    match key {
        Key::ViewFleet => has_ledger_part(view),
        Key::ViewRobot(_) => view.get("ledger").is_some_and(|copy| !copy.is_null()),
        Key::ViewHealth => false,
        key => is_of_ledger(key),
    }
}

/// Checks whether the node that drew a view of the fleet had a ledger.
fn has_ledger_part(fleet: &Value) -> bool {
    fleet.get("closures").is_some_and(|closures| !closures.is_null())
}

/// Copies the part from the ledger into a view of a node without one. The rest, such as the contact with other nodes,
/// stays as that node sees it.
pub(super) fn copy_ledger_part(key: &Key, of_voter: &Value, own: &mut Value) {
    if let Key::ViewRobot(_) = key {
        copy(&OF_NODE, of_voter, own);
        copy(&OF_ROBOT, of_voter, own);
    } else {
        copy_fleet_part(of_voter, own);
    }
}

fn copy_fleet_part(of_voter: &Value, own: &mut Value) {
    copy(&OF_FLEET, of_voter, own);
    let Some(nodes) = own.get_mut("nodes").and_then(Value::as_array_mut) else { return };
    // Both lists are in the order of the names.
    let mut known = of_voter.get("nodes").and_then(Value::as_array).into_iter().flatten().peekable();
    let name = |node: &Value| node.get("node").and_then(Value::as_str).unwrap_or_default().to_owned();
    for node in nodes {
        let wanted = name(node);
        while known.next_if(|other| name(other) < wanted).is_some() {}
        if let Some(other) = known.next_if(|other| name(other) == wanted) {
            copy(&OF_NODE, other, node);
        }
    }
}

fn copy(members: &[&str], from: &Value, to: &mut Value) {
    let Some(to) = to.as_object_mut() else { return };
    for member in members {
        if let Some(value) = from.get(member) {
            to.insert((*member).to_owned(), value.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn fern() -> Key {
        Key::ViewRobot("fern".parse().unwrap())
    }

    #[test]
    fn the_views_of_a_former_voter_show_no_ledger() {
        let of_former_voter = [
            (Key::ViewFleet, json!({ "closures": null, "nodes": [] })),
            (Key::ViewFleet, json!({ "nodes": [] })),
            (Key::ViewHealth, json!({ "findings": [] })),
            (Key::ViewEnsembles, json!({ "ensembles": [] })),
            (fern(), json!({ "node": "fern" })),
        ];
        for (key, view) in of_former_voter {
            assert!(!shows_ledger(&key, &view), "{key}");
        }
        assert!(shows_ledger(&Key::ViewFleet, &json!({ "closures": [], "nodes": [] })));
        assert!(shows_ledger(&Key::ViewMissions, &json!({ "missions": [] })));
        assert!(shows_ledger(&fern(), &json!({ "node": "fern", "ledger": { "revision": 7 } })));
    }

    #[test]
    fn the_orders_of_a_robot_are_those_of_the_ledger() {
        let mut own = json!({ "node": "fern", "seen_by": "world", "age_ms": 3, "holds": null, "orders": {},
            "promised": [], "readings": { "pressure": 2 } });
        let voter = json!({ "node": "fern", "seen_by": "aster", "age_ms": 900, "holds": null,
            "orders": { "hold": { "by": "Nia" } }, "promised": [{ "mission": "m-1", "role": "r1" }],
            "readings": null, "ledger": { "revision": 7 } });
        let mut expected = own.clone();
        for member in ["orders", "promised", "ledger"] {
            expected[member] = voter[member].clone();
        }
        copy_ledger_part(&fern(), &voter, &mut own);
        assert_eq!(own, expected);
    }

    #[test]
    fn only_what_the_ledger_states_is_copied() {
        let node = |name: &str, age: u64, orders: Value| json!({ "node": name, "age_ms": age, "orders": orders });
        let held = json!({ "hold": { "by": "Nia" } });
        let voter = json!({
            "seen_by": "aster", "closures": [], "alarms": [{ "alarm": "fire" }],
            "nodes": [node("ada", 7, held.clone()), node("bob", 7, json!({})), node("dot", 7, held.clone())],
        });
        let none = json!({ "seen_by": "world", "closures": null, "alarms": null,
            "nodes": [node("ada", 1, json!({})), node("cyd", 1, json!({})), node("dot", 1, json!({}))] });
        assert!(has_ledger_part(&voter) && !has_ledger_part(&none));
        let mut own = none;
        copy_ledger_part(&Key::ViewFleet, &voter, &mut own);
        let expected = json!({ "seen_by": "world", "closures": [], "alarms": [{ "alarm": "fire" }],
            "nodes": [node("ada", 1, held.clone()), node("cyd", 1, json!({})), node("dot", 1, held)] });
        assert_eq!(own, expected);
    }
}
