//! Requests of people that raise alarms, and clear them.

use super::api::{ApiError, ApiHandler};
use consort_protocol::api::{AlarmAction, AlarmRequest, AlarmsReply, parse_request};
use consort_protocol::ids::AlarmId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{AlarmChange, AlarmPlan, Command};
use consort_text::AllowedNames;
use std::collections::{BTreeMap, BTreeSet};

impl ApiHandler {
    /// Raises or clears alarms.
    pub(super) async fn alarm(&self, payload: &[u8]) -> Result<AlarmsReply, ApiError> {
        let AlarmRequest { action, alarm, reason, by, request } = parse_request(ApiCall::Alarm, payload)?;
        let change = match action {
            AlarmAction::Raise => raise(alarm, reason, &self.alarms)?,
            AlarmAction::Clear if !reason.is_empty() => {
                return Err("`reason` belongs to the action `raise`".to_owned().into());
            }
            AlarmAction::Clear => {
                let raised: BTreeSet<AlarmId> =
                    self.replica.read(|ledger| ledger.alarms().map(|alarm| alarm.alarm.clone()).collect());
                clear(alarm, &raised, &self.alarms)?
            }
        };
        self.commit_order(Command::ChangeAlarms { order: self.order_request(change, by, request)? }).await?;
        Ok(AlarmsReply { alarms: self.replica.read(|ledger| ledger.alarms().cloned().collect()) })
    }
}

/// Returns the change that raises an alarm of the fleet file.
fn raise(
    alarm: Option<AlarmId>,
    reason: String,
    declared: &BTreeMap<AlarmId, AlarmPlan>,
) -> Result<AlarmChange, String> {
    let Some(alarm) = alarm else { return Err("the action `raise` needs an `alarm`".to_owned()) };
    match declared.get(&alarm) {
        Some(plan) => Ok(AlarmChange::Raise { plan: plan.clone(), alarm, reason }),
        None => Err(unknown(&alarm, declared.keys())),
    }
}

/// Returns the change that clears an alarm, or all alarms. An alarm in force may be missing in the present fleet file.
fn clear(
    alarm: Option<AlarmId>,
    raised: &BTreeSet<AlarmId>,
    declared: &BTreeMap<AlarmId, AlarmPlan>,
) -> Result<AlarmChange, String> {
    let known: BTreeSet<&AlarmId> = declared.keys().chain(raised).collect();
    if let Some(name) = alarm.as_ref().filter(|name| !known.contains(name)) {
        return Err(unknown(name, known));
    }
    Ok(AlarmChange::Clear { alarm })
}

fn unknown<'a>(alarm: &AlarmId, known: impl IntoIterator<Item = &'a AlarmId>) -> String {
    let mut known = known.into_iter().peekable();
    if known.peek().is_none() {
        return format!("there is no alarm {alarm}; the fleet file declares no alarms, as [alarms.{alarm}]");
    }
    format!("there is no alarm {alarm}; {}", AllowedNames::suggest_for(alarm.as_str(), known))
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ledger::AlarmResponse;

    fn alarm(name: &str) -> AlarmId {
        name.parse().unwrap()
    }

    fn plan() -> AlarmPlan {
        AlarmPlan { robots: AlarmResponse::Stop, places: BTreeSet::new(), closes: BTreeSet::new() }
    }

    fn declared(names: &[&str]) -> BTreeMap<AlarmId, AlarmPlan> {
        names.iter().map(|name| (alarm(name), plan())).collect()
    }

    #[test]
    fn an_alarm_is_raised_with_the_plan_of_the_fleet_file() {
        let declared = declared(&["fire", "flood"]);
        let change = raise(Some(alarm("fire")), "smoke".to_owned(), &declared);
        let expected = AlarmChange::Raise { alarm: alarm("fire"), plan: plan(), reason: "smoke".to_owned() };
        assert_eq!(change, Ok(expected));
        assert_eq!(raise(None, String::new(), &declared), Err("the action `raise` needs an `alarm`".to_owned()));
    }

    #[test]
    fn declared_alarms_and_those_in_force_are_cleared() {
        let raised = BTreeSet::from([alarm("fire"), alarm("old")]);
        let cleared = |name: Option<&str>| clear(name.map(alarm), &raised, &declared(&["fire", "flood"]));
        let change = |name: Option<&str>| Ok(AlarmChange::Clear { alarm: name.map(alarm) });
        for name in [None, Some("fire"), Some("flood"), Some("old")] {
            assert_eq!(cleared(name), change(name));
        }
        let unknown = "there is no alarm fir; allowed: fire, flood, old; did you mean `fire`?";
        assert_eq!(cleared(Some("fir")), Err(unknown.to_owned()));
    }

    #[test]
    fn an_unknown_alarm_is_rejected_with_those_that_exist() {
        let error = |names: &[&str]| raise(Some(alarm("fier")), String::new(), &declared(names)).unwrap_err();
        assert_eq!(error(&["fire", "flood"]), "there is no alarm fier; allowed: fire, flood; did you mean `fire`?");
        assert_eq!(error(&[]), "there is no alarm fier; the fleet file declares no alarms, as [alarms.fier]");
    }
}
