//! Requests of people that hold robots, release them, or take them out of service.

use super::api::{ApiError, ApiHandler, not_committed};
use super::submission::rfc3339_ms;
use consort_protocol::api::{
    HOLD_S, HOLD_S_MAX, HoldRequest, MaintenanceAction, MaintenanceRequest, OrdersReply, ReleaseRequest,
    RobotSelection, RobotZone, SelectionCondition, parse_request,
};
use consort_protocol::ensemble::{Eligibility, Ensembles};
use consort_protocol::ids::{NodeId, PlaceId, RequestId, RobotId, ZoneId};
use consort_protocol::keys::ApiCall;
use consort_protocol::knowledge::{KnownRecord, RobotKnowledge};
use consort_protocol::ledger::{Command, CommandOutcome, Ledger, OrderChange, OrderRequest};
use consort_text::shorten;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum size of the list of robots in an error, in bytes.
const NAMES_BYTES_MAX: usize = 400;

impl ApiHandler {
    /// Holds robots.
    pub(super) async fn hold(&self, payload: &[u8]) -> Result<OrdersReply, ApiError> {
        let HoldRequest { robots, for_s, reason, by, request } = parse_request(ApiCall::Hold, payload)?;
        let seconds = for_s.unwrap_or(HOLD_S);
        if !(1..=HOLD_S_MAX).contains(&seconds) {
            return Err(format!("for_s is {seconds}; allowed are 1 to {HOLD_S_MAX}").into());
        }
        let until_ms = self.time_ms()?.saturating_add(u64::from(seconds) * 1000);
        self.order(&robots, OrderChange::Hold { until_ms, reason }, by, request).await
    }

    /// Releases held robots.
    pub(super) async fn release(&self, payload: &[u8]) -> Result<OrdersReply, ApiError> {
        let ReleaseRequest { robots, by, request } = parse_request(ApiCall::Release, payload)?;
        self.order(&robots, OrderChange::Release, by, request).await
    }

    /// Takes robots out of service, or returns them to service.
    pub(super) async fn maintenance(&self, payload: &[u8]) -> Result<OrdersReply, ApiError> {
        let MaintenanceRequest { robots, action, until, reason, by, request } =
            parse_request(ApiCall::Maintenance, payload)?;
        let change = match action {
            MaintenanceAction::Begin if reason.trim().is_empty() => {
                return Err("the action `begin` needs a `reason`".to_owned().into());
            }
            MaintenanceAction::Begin => OrderChange::Maintain { until_ms: self.end_ms(until)?, reason },
            MaintenanceAction::End if until.is_some() || !reason.is_empty() => {
                return Err("`until` and `reason` belong to the action `begin`".to_owned().into());
            }
            MaintenanceAction::End => OrderChange::EndMaintenance,
        };
        self.order(&robots, change, by, request).await
    }

    /// Returns the end of an order in milliseconds since 1970.
    pub(super) fn end_ms(&self, until: Option<String>) -> Result<Option<u64>, ApiError> {
        let Some(until) = until else { return Ok(None) };
        let now_ms = self.time_ms()?;
        match rfc3339_ms(&until).filter(|until_ms| *until_ms > now_ms) {
            Some(until_ms) => Ok(Some(until_ms)),
            None => Err(format!(
                "until is {until:?}; allowed is a date and time in the future, in RFC 3339, such as \
                 2026-12-31T18:00:00+01:00"
            )
            .into()),
        }
    }

    /// Commits a change of the orders to robots, and returns their orders.
    async fn order(
        &self,
        selection: &RobotSelection,
        change: OrderChange,
        by: Option<String>,
        request: Option<RequestId>,
    ) -> Result<OrdersReply, ApiError> {
        let robots = self.selected(selection)?;
        let command = Command::OrderRobots { robots: robots.clone(), order: self.order_request(change, by, request)? };
        self.commit_order(command).await?;
        Ok(self.replica.read(|ledger| {
            let orders = |robot: RobotId| {
                let orders = ledger.orders_of(&robot).cloned().unwrap_or_default();
                (robot, orders)
            };
            OrdersReply { robots: robots.into_iter().map(orders).collect() }
        }))
    }

    /// Returns the id of a request, if it has one. Without a given id it is that of the signature: a client that repeats its
    /// request signs it again, and a copy by an attacker has the given id, too.
    pub(super) fn request_id(&self, request: Option<RequestId>) -> Result<Option<RequestId>, ApiError> {
        let signed = self.requester.as_ref().map(|requester| RequestId::new(requester.request.clone())).transpose();
        Ok(request.or(signed.map_err(|problem| problem.to_string())?))
    }

    /// Returns the request of a person for a change.
    pub(super) fn order_request<Change>(
        &self,
        change: Change,
        by: Option<String>,
        request: Option<RequestId>,
    ) -> Result<OrderRequest<Change>, ApiError> {
        Ok(OrderRequest {
            change,
            by: self.responsible(by),
            at_ms: self.time_ms()?,
            request: self.request_id(request)?,
        })
    }

    /// Commits a change of orders.
    pub(super) async fn commit_order(&self, command: Command) -> Result<(), ApiError> {
        match self.propose(command).await {
            Ok(CommandOutcome::Refused(refused)) => {
                // A new ledger gets its version right after its creation.
                let may_retry = self.replica.read(Ledger::wire).is_none();
                Err(ApiError { text: refused.to_string(), may_retry })
            }
            Ok(_) => Ok(()),
            Err(problem) => Err(not_committed(&problem)),
        }
    }

    /// Returns the robots of a request: robots with a known record, with orders, and with leases of devices.
    pub(super) fn selected(&self, selection: &RobotSelection) -> Result<BTreeSet<RobotId>, ApiError> {
        let known: BTreeMap<RobotId, RobotKnowledge> = self.knowledge.read(|base| {
            let record = |(node, stored): (&NodeId, &KnownRecord)| {
                Some((RobotId::from(node.clone()), stored.knowledge().robot.clone()?))
            };
            base.iter().filter_map(record).collect()
        });
        select(selection, &known, self.replica.read(without_record), &self.ensembles, self.domain.zones())
    }
}

/// Returns the robots that may be ordered without a record: robots with orders, and robots with leases of devices. A lost
/// robot keeps the lease of a lift until a person takes it out of service, when its record is forgotten.
fn without_record(ledger: &Ledger) -> BTreeSet<RobotId> {
    let ordered = ledger.robot_orders().map(|(robot, _)| robot.clone());
    ordered.chain(ledger.device_leases().into_values().map(|lease| lease.robot)).collect()
}

/// Selects robots. `known` are the robots with a record, and `ordered` the [robots without](without_record). A condition uses no
/// private attribute of the ensembles, which records lack. `zones` are those of the fleet.
fn select(
    selection: &RobotSelection,
    known: &BTreeMap<RobotId, RobotKnowledge>,
    ordered: BTreeSet<RobotId>,
    ensembles: &Ensembles,
    zones: &BTreeMap<ZoneId, BTreeSet<PlaceId>>,
) -> Result<BTreeSet<RobotId>, ApiError> {
    if let RobotSelection::Where(SelectionCondition { condition }) = selection
        && let Ok(compiled) = Eligibility::compile(condition)
        && let Some((ensemble, attribute)) = ensembles.private_attribute_of(&compiled)
    {
        return Err(format!(
            "where: `attributes.{attribute}` in the `exchange` of ensemble {ensemble} is private to its members; \
             use other attributes, each as `robot.attributes.NAME`, or name the robots"
        )
        .into());
    }
    let robots = selection.among(known, zones).map_err(|problem| problem.to_string())?;
    let all = || -> BTreeSet<RobotId> { known.keys().cloned().chain(ordered.iter().cloned()).collect() };
    match selection {
        RobotSelection::All(_) if all().is_empty() => Err("the coordinator knows no robots".to_owned().into()),
        RobotSelection::All(_) => Ok(all()),
        RobotSelection::Named(names) if names.is_empty() => Err("robots is empty; name a robot".to_owned().into()),
        RobotSelection::Named(names) => match names.iter().find(|name| !all().contains(*name)) {
            None => Ok(names.clone()),
            Some(unknown) => {
                let known = all().iter().map(RobotId::as_str).collect::<Vec<_>>().join(", ");
                Err(format!("there is no robot {unknown}; there are {}", shorten(&known, NAMES_BYTES_MAX)).into())
            }
        },
        RobotSelection::Where(SelectionCondition { condition }) if robots.is_empty() => {
            Err(format!("no robot meets `{condition}`").into())
        }
        RobotSelection::Zone(RobotZone { zone }) if robots.is_empty() => {
            Err(format!("no robot is in zone {zone}").into())
        }
        RobotSelection::Where(_) | RobotSelection::Zone(_) => Ok(robots),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::test_values::idle_robot;
    use consort_protocol::api::AllRobots;
    use consort_protocol::ensemble::{EnsembleSpec, ExchangedValue};
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::Resource;
    use serde_json::json;

    fn known() -> BTreeMap<RobotId, RobotKnowledge> {
        let robot = |section: &str| RobotKnowledge {
            attributes: serde_json::from_value(json!({ "section": section })).unwrap(),
            ..idle_robot()
        };
        [("ada", "icu"), ("bob", "er")].map(|(name, section)| (name.parse().unwrap(), robot(section))).into()
    }

    fn selected(selection: RobotSelection) -> Result<Vec<String>, String> {
        let code = ExchangedValue::try_from("attributes.code".to_owned()).unwrap();
        let icu = EnsembleSpec::with_any_skill_of("icu".parse().unwrap(), BTreeSet::new());
        let ensembles = Ensembles::compile(vec![EnsembleSpec { exchange: [code].into(), ..icu }]).unwrap();
        let zone = |name: &str, place: PlaceId| -> (ZoneId, _) { (name.parse().unwrap(), BTreeSet::from([place])) };
        let zones = BTreeMap::from([zone("here", idle_robot().place), zone("empty", "Nowhere".parse().unwrap())]);
        let robots = select(&selection, &known(), BTreeSet::from(["cyd".parse().unwrap()]), &ensembles, &zones);
        let names = |robots: BTreeSet<RobotId>| robots.iter().map(RobotId::to_string).collect();
        robots.map(names).map_err(|error| error.text)
    }

    fn condition(text: &str) -> RobotSelection {
        RobotSelection::Where(SelectionCondition { condition: text.to_owned() })
    }

    fn zone(name: &str) -> RobotSelection {
        RobotSelection::Zone(RobotZone { zone: name.parse().unwrap() })
    }

    fn named(names: &[&str]) -> RobotSelection {
        RobotSelection::Named(names.iter().map(|name| name.parse().unwrap()).collect())
    }

    #[test]
    fn a_robot_with_the_lease_of_a_device_may_be_ordered_without_a_record() {
        let (mut ledger, ada) = (Ledger::default(), "ada".parse::<RobotId>().unwrap());
        let resource = Resource::Device("lift".parse().unwrap());
        let lease = Command::LeaseResource { resource, robot: ada.clone(), at_ms: 0 };
        for (index, command) in (1..).zip([Command::first_wire_version(3), lease]) {
            assert_eq!(ledger.apply(Epoch { term: 1, index }, command), CommandOutcome::Done);
        }
        assert_eq!(without_record(&ledger), BTreeSet::from([ada]));
    }

    #[test]
    fn robots_are_selected_by_name_by_a_condition_by_a_zone_or_all() {
        let names = |names: &[&str]| Ok(names.iter().map(|name| (*name).to_owned()).collect());
        assert_eq!(selected(named(&["bob"])), names(&["bob"]));
        assert_eq!(selected(named(&["cyd"])), names(&["cyd"]), "it has orders and no record");
        assert_eq!(selected(RobotSelection::All(AllRobots::All)), names(&["ada", "bob", "cyd"]));
        assert_eq!(selected(condition(r#"robot.attributes.section == "icu""#)), names(&["ada"]));
        assert_eq!(selected(zone("here")), names(&["ada", "bob"]), "a robot without a record is nowhere");
    }

    #[test]
    fn a_selection_of_no_robot_is_an_error() {
        assert_eq!(selected(named(&["ada", "eve"])).unwrap_err(), "there is no robot eve; there are ada, bob, cyd");
        assert_eq!(selected(named(&[])).unwrap_err(), "robots is empty; name a robot");
        let none = selected(condition(r#"robot.attributes.section == "lab""#)).unwrap_err();
        assert_eq!(none, r#"no robot meets `robot.attributes.section == "lab"`"#);
        assert!(selected(condition("robot.wheels > 3")).unwrap_err().starts_with("where: "));
        assert_eq!(selected(zone("empty")).unwrap_err(), "no robot is in zone empty");
        let unknown = "there is no zone hera in the fleet file; allowed: empty, here; did you mean `here`?";
        assert_eq!(selected(zone("hera")).unwrap_err(), unknown);
        let private = selected(condition(r#"!has(robot.attributes.code) || robot.attributes.section == "icu""#));
        assert_eq!(
            private.unwrap_err(),
            "where: `attributes.code` in the `exchange` of ensemble icu is private to its members; use other attributes, \
             each as `robot.attributes.NAME`, or name the robots"
        );
    }
}
