//! Descriptions of all calls on `api/**`, for clients.

use consort_protocol::api::{
    AlarmsReply, AnswerReply, CallHelp, CancelMissionsReply, ClosuresReply, ErrorReply, ExplainReply, HelpReply,
    LimitsReply, MissionChangeReply, OrdersReply, PriorityReply, ReassignReply, ScheduleReply, SubmitReply,
    UpgradeReply, example, payload_schema,
};
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::view::{
    AuditView, MissionView, MissionsView, RequestsView, SchedulesView, WithProvenance, schema_of,
};
use consort_raft::store::Backup;
use schemars::Schema;

/// Returns the descriptions of all calls on `api/**`, like `api/help`.
pub fn help() -> HelpReply {
    HelpReply { calls: ApiCall::ALL.iter().map(|call| call_help(*call)).collect() }
}

/// Returns the description of a call.
pub(crate) fn call_help(call: ApiCall) -> CallHelp {
    let info = Key::Api(call).info();
    CallHelp {
        call: call.as_str().to_owned(),
        key: info.pattern.to_owned(),
        what: info.what.to_owned(),
        answered_by: info.owner.to_owned(),
        example: example(call),
        payload_schema: payload_schema(call),
        answer_schema: reply_schema(call),
        error_schema: schema_of::<ErrorReply>(),
    }
}

fn reply_schema(call: ApiCall) -> Schema {
    match call {
        ApiCall::Submit => schema_of::<SubmitReply>(),
        ApiCall::Cancel | ApiCall::Resolve => schema_of::<MissionChangeReply>(),
        ApiCall::CancelMissions => schema_of::<CancelMissionsReply>(),
        ApiCall::Priority => schema_of::<PriorityReply>(),
        ApiCall::Reassign => schema_of::<ReassignReply>(),
        ApiCall::Answer => schema_of::<AnswerReply>(),
        ApiCall::Schedule => schema_of::<ScheduleReply>(),
        ApiCall::Hold | ApiCall::Release | ApiCall::Maintenance => schema_of::<OrdersReply>(),
        ApiCall::Close | ApiCall::Open => schema_of::<ClosuresReply>(),
        ApiCall::Limit => schema_of::<LimitsReply>(),
        ApiCall::Alarm => schema_of::<AlarmsReply>(),
        ApiCall::Schedules => schema_of::<WithProvenance<SchedulesView>>(),
        ApiCall::Audit => schema_of::<WithProvenance<AuditView>>(),
        ApiCall::Requests => schema_of::<WithProvenance<RequestsView>>(),
        ApiCall::Get => schema_of::<WithProvenance<MissionView>>(),
        ApiCall::List => schema_of::<WithProvenance<MissionsView>>(),
        ApiCall::Explain => schema_of::<WithProvenance<ExplainReply>>(),
        ApiCall::Help => schema_of::<HelpReply>(),
        ApiCall::Backup => schema_of::<Backup>(),
        ApiCall::Upgrade => schema_of::<UpgradeReply>(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    #[test]
    fn the_schemas_match_the_parsed_types() {
        let help = serde_json::to_value(help()).unwrap();
        let of = |call: &str| {
            let calls = help["calls"].as_array().unwrap();
            calls.iter().find(|help| help["call"] == call).unwrap().clone()
        };
        let submit = of("submit");
        let properties = submit["payload_schema"]["properties"].as_object().unwrap();
        let names: Vec<&str> = properties.keys().map(String::as_str).collect();
        assert_eq!(
            names,
            ["by", "deadline_s", "mission", "name", "not_before", "parameters", "people", "priority", "request"]
        );
        assert_eq!(submit["payload_schema"]["required"], json!(["mission"]));
        assert_eq!(submit["payload_schema"]["additionalProperties"], json!(false));
        assert_eq!(submit["answer_schema"]["required"], json!(["mission", "again"]));
        assert_eq!(of("help")["payload_schema"], Value::Null);
        assert_eq!(help["calls"].as_array().unwrap().len(), ApiCall::ALL.len());
    }
}
