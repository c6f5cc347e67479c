//! The history of missions, as a table for spreadsheets.

use crate::fleet_model::{FleetModel, MissionModel};

const HEAD: [&str; 13] = [
    "mission",
    "state",
    "cause",
    "priority",
    "parameters",
    "roles",
    "steps_done",
    "steps",
    "submitted_at_ms",
    "awarded_at_ms",
    "ended_at_ms",
    "award_ms",
    "completion_ms",
];

/// Returns all known missions, in the order of submission.
pub(super) fn history(model: &FleetModel) -> String {
    let mut missions: Vec<_> = model.missions().iter().collect();
    missions.sort_by_key(|(id, mission)| (mission.number, (*id).clone()));
    let mut table = csv::Writer::from_writer(vec![]);
    let rows = missions.into_iter().map(|(id, mission)| row(id, mission));
    for row in std::iter::once(HEAD.map(str::to_owned)).chain(rows) {
        // Rows of equal length are written to memory: this cannot fail.
        let _ = table.write_record(&row);
    }
    table.into_inner().map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default()
}

fn row(id: &str, mission: &MissionModel) -> [String; 13] {
    let pairs = |pairs: &std::collections::BTreeMap<String, String>| {
        pairs.iter().map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join("; ")
    };
    let number = |number: Option<u64>| number.map_or_else(String::new, |number| number.to_string());
    let completion_ms = mission.ended_ms.map(|ended| ended.saturating_sub(mission.submitted_ms));
    [
        escape_formula(id),
        escape_formula(&mission.state),
        escape_formula(mission.cause.as_deref().unwrap_or("")),
        mission.priority.to_string(),
        escape_formula(&pairs(&mission.parameters)),
        escape_formula(&pairs(&mission.holders)),
        mission.done.to_string(),
        mission.steps.to_string(),
        mission.submitted_ms.to_string(),
        number(mission.awarded_ms),
        number(mission.ended_ms),
        mission.award_after_ms.map_or_else(String::new, |ms| format!("{ms:.1}")),
        number(completion_ms),
    ]
}

/// Escapes a text so that no spreadsheet takes it for a formula.
fn escape_formula(text: &str) -> String {
    match text.starts_with(['=', '+', '-', '@', '\t', '\r']) {
        true => format!("'{text}"),
        false => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet_model::FloorPlan;
    use consort_protocol::keys::Key;
    use serde_json::json;

    #[test]
    fn each_mission_is_a_row_and_no_text_is_a_formula() {
        let mut model = FleetModel::new("ward", "s1", FloorPlan::default(), 0);
        let canceled = json!({ "canceled": { "by": "=1+1, \"me\"" } });
        let entry = |id: &str, detail: serde_json::Value| {
            json!({ "mission": id, "detail": detail, "parameters": { "room": "=A1" }, "holders": { "r1": "ada" },
                "done": 3, "steps": 7, "submitted_at_ms": 1000, "priority": 5 })
        };
        let list = json!({ "missions": [entry("z-1", json!("running")), entry("a-2", canceled)] });
        model.apply_view(&Key::ViewMissions, &list, 2000);
        let text = history(&model);
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows.len(), 3);
        assert_eq!(rows[0], HEAD.join(","));
        assert_eq!(rows[1], "z-1,running,,5,room==A1,r1=ada,3,7,1000,,,,");
        assert_eq!(rows[2], "a-2,canceled,\"by =1+1, \"\"me\"\"\",5,room==A1,r1=ada,3,7,1000,,,,");
        assert_eq!(escape_formula("=SUM(A1)"), "'=SUM(A1)");
    }
}
