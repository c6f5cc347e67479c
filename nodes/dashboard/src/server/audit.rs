//! The audit trail as JSON lines.

use serde_json::Value;

/// Returns the entries of `view/audit` with all their fields, a line for each, in their order.
pub(super) fn json_lines(view: &Value) -> String {
    let entries = view["entries"].as_array().into_iter().flatten();
    entries.map(|entry| format!("{entry}\n")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn each_entry_is_a_line_with_all_its_fields() {
        let entry = |number: u64| json!({ "number": number, "by": "Nia", "details": "a\nspill", "later_field": true });
        let text = json_lines(&json!({ "seen_by": "ada", "entries": [entry(7), entry(8)] }));
        let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(lines, [entry(7), entry(8)]);
        assert_eq!(json_lines(&json!({ "entries": [] })), "");
    }
}
