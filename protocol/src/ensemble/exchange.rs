//! Exchange of knowledge within an ensemble: its members send each other the values that it lists.
//!
//! ```text
//!  membership (from gossip) ──▶ KnowledgeExchange ──▶ Subscribe, Unsubscribe
//!  own attributes and readings ─▶      │      └─────▶ Publish ──▶ wire/ensemble/{ensemble}/{robot}
//!  values of another member ────▶ latest values by robot, with their age
//! ```
//!
//! The records of robots do not contain the listed attributes.
//!
//! A node that is not a member subscribes to nothing and stores nothing. Each node evaluates the
//! membership by itself, so a member may miss values until it has the record of a new member, and
//! receives those of a former member until that member has noticed.

use crate::bounds;
use crate::ids::{NodeId, RobotId};
use crate::knowledge::Attributes;
use crate::scalar::{NamedScalarsError, Scalar, check_named_scalars};
use crate::schema::inline_schema;
use crate::units::NodeTime;
use schemars::json_schema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::Duration;

/// Maximum number of values of a kind that a robot sends to the members of an ensemble.
const VALUES_MAX: usize = 64;

/// Minimum interval of publications of a member. Raised: fewer messages, and older values.
const PUBLISH_INTERVAL: Duration = Duration::from_secs(1);

/// Interval of publications while no value changes. A publication may be lost, so this is also the
/// maximum time until a member has all values. Raised: fewer messages.
const REFRESH_INTERVAL: Duration = Duration::from_secs(5);

/// Maximum age of a value that a robot uses, and time without a state of the driver after which a robot
/// sends no readings. More than two intervals, because a publication may be lost. Raised: robots use older
/// values.
pub const VALUE_AGE_MAX: Duration = REFRESH_INTERVAL.saturating_mul(3);

/// A value that the members of an ensemble exchange, as `attributes.owner` or `readings.dust_g`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ExchangedValue {
    /// Attribute of the robot.
    Attribute(String),
    /// Reading of its driver.
    Reading(String),
}

/// Error: a text does not name an exchanged value.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no value that members exchange; write attributes.NAME or readings.NAME")]
pub struct ExchangedValueError {
    /// The text.
    text: String,
}

inline_schema!(
    ExchangedValue,
    json_schema!({ "type": "string", "pattern": "^(attributes|readings)\\.[A-Za-z_][A-Za-z0-9_]*$" })
);

impl TryFrom<String> for ExchangedValue {
    type Error = ExchangedValueError;

    fn try_from(text: String) -> Result<ExchangedValue, ExchangedValueError> {
        let named = |name: &str| {
            let value = BTreeMap::from([(name.to_owned(), Scalar::Bool(true))]);
            check_named_scalars("value", &value, 1).is_ok().then(|| name.to_owned())
        };
        let attribute = text.strip_prefix("attributes.").and_then(named).map(ExchangedValue::Attribute);
        let reading = || text.strip_prefix("readings.").and_then(named).map(ExchangedValue::Reading);
        attribute.or_else(reading).ok_or_else(|| ExchangedValueError { text: text.chars().take(80).collect() })
    }
}

impl From<ExchangedValue> for String {
    fn from(value: ExchangedValue) -> String {
        value.to_string()
    }
}

impl fmt::Display for ExchangedValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ExchangedValue::Attribute(name) => write!(f, "attributes.{name}"),
            ExchangedValue::Reading(name) => write!(f, "readings.{name}"),
        }
    }
}

/// Values of a robot, as sent to the other members of an ensemble.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MemberValues {
    /// Attributes of the robot.
    #[serde(deserialize_with = "bounds::collection::<_, _, VALUES_MAX>")]
    pub attributes: BTreeMap<String, Scalar>,
    /// Latest readings of its driver.
    #[serde(deserialize_with = "bounds::collection::<_, _, VALUES_MAX>")]
    pub readings: BTreeMap<String, Scalar>,
}

impl MemberValues {
    /// Selects the values that an ensemble lists.
    pub fn select(
        listed: &BTreeSet<ExchangedValue>,
        attributes: &Attributes,
        readings: &BTreeMap<String, Scalar>,
    ) -> MemberValues {
        let attributes = attributes.iter().map(|(name, value)| (name.clone(), value.clone())).collect();
        let mut values = MemberValues { attributes, readings: readings.clone() };
        values.retain(listed);
        values
    }

    /// Returns a value.
    fn get(&self, value: &ExchangedValue) -> Option<&Scalar> {
        match value {
            ExchangedValue::Attribute(name) => self.attributes.get(name),
            ExchangedValue::Reading(name) => self.readings.get(name),
        }
    }

    /// Checks the names and the sizes of values of another node.
    ///
    /// # Errors
    /// The first problem.
    pub fn check(&self) -> Result<(), NamedScalarsError> {
        check_named_scalars("attribute", &self.attributes, VALUES_MAX)?;
        check_named_scalars("reading", &self.readings, VALUES_MAX)
    }

    /// Drops the values that an ensemble does not list.
    fn retain(&mut self, listed: &BTreeSet<ExchangedValue>) {
        self.attributes.retain(|name, _| listed.contains(&ExchangedValue::Attribute(name.clone())));
        self.readings.retain(|name, _| listed.contains(&ExchangedValue::Reading(name.clone())));
    }

    fn is_empty(&self) -> bool {
        self.attributes.is_empty() && self.readings.is_empty()
    }
}

/// Exchange of an ensemble, at a single node.
#[derive(Debug)]
pub struct KnowledgeExchange {
    listed: BTreeSet<ExchangedValue>,
    own: NodeId,
    /// Members of the ensemble; `None` while this node is not one of them.
    members: Option<BTreeSet<NodeId>>,
    published: Option<Publication>,
    /// Latest values of each member, with the time of their arrival.
    latest: BTreeMap<RobotId, (MemberValues, NodeTime)>,
}

/// Latest publication of the node.
#[derive(Debug)]
struct Publication {
    values: MemberValues,
    at: NodeTime,
    /// Members at that time.
    members: BTreeSet<NodeId>,
}

/// Effect for the caller to perform, in the order given.
#[derive(Debug, Clone, PartialEq)]
pub enum ExchangeAction {
    /// Subscribe to the values of the members.
    Subscribe,
    /// End the subscription.
    Unsubscribe,
    /// Publish these values of the node's robot.
    Publish(MemberValues),
}

impl KnowledgeExchange {
    /// Creates the exchange of an ensemble that lists these values. The node is not a member yet.
    pub fn new(listed: BTreeSet<ExchangedValue>, own: NodeId) -> KnowledgeExchange {
        KnowledgeExchange { listed, own, members: None, published: None, latest: BTreeMap::new() }
    }

    /// Returns the values that the ensemble lists.
    pub fn listed(&self) -> &BTreeSet<ExchangedValue> {
        &self.listed
    }

    /// Follows the membership and the values of the node's own robot; `None` without a robot. Called
    /// several times a second.
    pub fn update(
        &mut self,
        members: BTreeSet<NodeId>,
        own_values: Option<MemberValues>,
        now: NodeTime,
    ) -> Vec<ExchangeAction> {
        let was_member = self.members.is_some();
        if !members.contains(&self.own) {
            self.members = None;
            self.published = None;
            self.latest.clear();
            return if was_member { vec![ExchangeAction::Unsubscribe] } else { vec![] };
        }
        self.latest.retain(|robot, _| members.contains(&NodeId::from(robot.clone())));
        let mut actions = if was_member { vec![] } else { vec![ExchangeAction::Subscribe] };
        if let Some(values) = own_values
            && self.must_publish(&values, &members, now)
        {
            self.published = Some(Publication { values: values.clone(), at: now, members: members.clone() });
            self.latest.insert(RobotId::from(self.own.clone()), (values.clone(), now));
            actions.push(ExchangeAction::Publish(values));
        }
        self.members = Some(members);
        actions
    }

    /// Checks whether the values have changed, a member has joined, or the latest publication is old.
    fn must_publish(&self, values: &MemberValues, members: &BTreeSet<NodeId>, now: NodeTime) -> bool {
        let Some(Publication { values: published, at, members: known }) = &self.published else {
            return !values.is_empty();
        };
        let age = now.since(*at);
        let is_news = published != values || !members.is_subset(known);
        age >= REFRESH_INTERVAL || age >= PUBLISH_INTERVAL && is_news
    }

    /// Stores the values of another robot. A node that is not a member ignores them: its subscription
    /// is about to end.
    pub fn receive(&mut self, robot: RobotId, mut values: MemberValues, now: NodeTime) {
        if self.members.is_some() && NodeId::from(robot.clone()) != self.own {
            values.retain(&self.listed);
            self.latest.insert(robot, (values, now));
        }
    }

    /// Returns the latest values of each member, with their age; `None` if the node is not a member.
    /// The age counts from the arrival of the latest message, also if it changed nothing.
    pub fn latest(&self, now: NodeTime) -> Option<BTreeMap<RobotId, (MemberValues, Duration)>> {
        let members = self.members.as_ref()?;
        let of_members = self.latest.iter().filter(|(robot, _)| members.contains(&NodeId::from((*robot).clone())));
        Some(of_members.map(|(robot, (values, at))| (robot.clone(), (values.clone(), now.since(*at)))).collect())
    }

    /// Returns the latest value of a member for use by this node's robot. `None` if it is unknown: this
    /// node or the robot is not a member, the value has not arrived, or its message is older than 15 s.
    pub fn value(&self, robot: &RobotId, value: &ExchangedValue, now: NodeTime) -> Option<&Scalar> {
        let is_member = self.members.as_ref()?.contains(&NodeId::from(robot.clone()));
        let (values, at) = self.latest.get(robot)?;
        let is_usable = is_member && now.since(*at) <= VALUE_AGE_MAX;
        values.get(value).filter(|_| is_usable)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> NodeTime {
        NodeTime::at(Duration::from_millis(ms))
    }

    fn listed() -> BTreeSet<ExchangedValue> {
        ["attributes.section", "readings.dust_g"].map(|text| ExchangedValue::try_from(text.to_owned()).unwrap()).into()
    }

    fn members(names: &[&str]) -> BTreeSet<NodeId> {
        names.iter().map(|name| NodeId::new(*name).unwrap()).collect()
    }

    fn exchange() -> KnowledgeExchange {
        KnowledgeExchange::new(listed(), NodeId::new("ada").unwrap())
    }

    fn dust(grams: i64) -> MemberValues {
        let named = |name: &str, value| (name.to_owned(), value);
        let attributes =
            BTreeMap::from([named("section", Scalar::Text("icu".to_owned())), named("floor", Scalar::Integer(3))]);
        let readings = BTreeMap::from([named("dust_g", Scalar::Integer(grams)), named("lid", Scalar::Bool(true))]);
        MemberValues::select(&listed(), &Attributes::try_from(attributes).unwrap(), &readings)
    }

    #[test]
    fn only_the_listed_values_are_sent() {
        let values = dust(7);
        assert_eq!(values.attributes.keys().collect::<Vec<_>>(), ["section"]);
        assert_eq!(values.readings.keys().collect::<Vec<_>>(), ["dust_g"]);
    }

    #[test]
    fn a_text_that_names_no_value_is_rejected() {
        for text in ["battery", "readings.", "readings.a-b", "readings.1", "attributes", "Readings.dust_g"] {
            let error = ExchangedValue::try_from(text.to_owned()).unwrap_err().to_string();
            assert!(error.starts_with(&format!("`{text}` is no value that members exchange")), "{error}");
        }
        assert_eq!(
            listed().into_iter().map(String::from).collect::<Vec<_>>(),
            ["attributes.section", "readings.dust_g"]
        );
    }

    #[test]
    fn a_member_publishes_changes_at_most_once_a_second() {
        let mut ada = exchange();
        let both = || members(&["ada", "bob"]);
        let publish = |grams| vec![ExchangeAction::Publish(dust(grams))];
        assert_eq!(ada.update(members(&["bob"]), Some(dust(1)), at(0)), []);
        assert_eq!(ada.update(both(), Some(dust(1)), at(250)), [vec![ExchangeAction::Subscribe], publish(1)].concat());
        assert_eq!(ada.update(both(), Some(dust(2)), at(1_249)), []);
        assert_eq!(ada.update(both(), Some(dust(2)), at(1_250)), publish(2));
        assert_eq!(ada.update(both(), Some(dust(2)), at(6_249)), []);
        assert_eq!(ada.update(both(), Some(dust(2)), at(6_250)), publish(2), "it may have been lost");
        let with_cyd = || members(&["ada", "bob", "cyd"]);
        assert_eq!(ada.update(with_cyd(), Some(dust(2)), at(7_250)), publish(2), "cyd has joined");
        assert_eq!(ada.update(both(), Some(dust(2)), at(8_500)), [], "cyd has left");
        assert_eq!(ada.update(members(&["bob"]), Some(dust(3)), at(10_000)), [ExchangeAction::Unsubscribe]);
        assert_eq!(ada.update(members(&["bob"]), Some(dust(4)), at(20_000)), []);
    }

    #[test]
    fn a_member_without_values_publishes_nothing() {
        let mut ada = exchange();
        assert_eq!(ada.update(members(&["ada"]), Some(MemberValues::default()), at(0)), [ExchangeAction::Subscribe]);
        assert_eq!(ada.update(members(&["ada"]), None, at(9_000)), []);
    }

    #[test]
    fn a_node_stores_values_while_it_and_their_robot_are_members() {
        let (mut ada, bob) = (exchange(), RobotId::new("bob").unwrap());
        ada.receive(bob.clone(), dust(1), at(0));
        assert_eq!(ada.latest(at(0)), None);
        ada.update(members(&["ada", "bob"]), None, at(0));
        assert_eq!(ada.latest(at(0)), Some(BTreeMap::new()), "it was not a member");
        let mut more = dust(2);
        more.readings.insert("speed".to_owned(), Scalar::Integer(1));
        ada.receive(bob.clone(), more, at(100));
        ada.receive(RobotId::new("cyd").unwrap(), dust(3), at(100));
        let expected = BTreeMap::from([(bob.clone(), (dust(2), Duration::from_millis(400)))]);
        assert_eq!(ada.latest(at(500)), Some(expected), "cyd is not a member, and speed is not listed");
        ada.update(members(&["ada"]), None, at(600));
        assert_eq!(ada.latest(at(600)), Some(BTreeMap::new()));
        ada.receive(bob, dust(4), at(700));
        ada.update(members(&["bob"]), None, at(800));
        assert_eq!(ada.latest(at(800)), None);
    }

    #[test]
    fn a_robot_uses_recent_values_of_members() {
        let (mut ada, bob, cyd) = (exchange(), RobotId::new("bob").unwrap(), RobotId::new("cyd").unwrap());
        let value = |text: &str| ExchangedValue::try_from(text.to_owned()).unwrap();
        let (bag, section) = (value("readings.dust_g"), value("attributes.section"));
        assert_eq!(ada.value(&bob, &bag, at(0)), None, "it is not a member");
        ada.update(members(&["ada", "bob"]), None, at(0));
        assert_eq!(ada.value(&bob, &bag, at(0)), None, "nothing has arrived");
        ada.receive(bob.clone(), dust(1), at(100));
        ada.receive(cyd.clone(), dust(2), at(100));
        assert_eq!(ada.value(&bob, &bag, at(100)), Some(&Scalar::Integer(1)));
        assert_eq!(ada.value(&bob, &section, at(100)), Some(&Scalar::Text("icu".to_owned())));
        assert_eq!(ada.value(&bob, &value("readings.lid"), at(100)), None, "it is not listed");
        assert_eq!(ada.value(&cyd, &bag, at(100)), None, "cyd is not a member");
        assert_eq!(ada.value(&bob, &bag, at(15_100)), Some(&Scalar::Integer(1)));
        assert_eq!(ada.value(&bob, &bag, at(15_101)), None, "it is too old");
        ada.receive(bob.clone(), dust(3), at(15_200));
        assert_eq!(ada.value(&bob, &bag, at(15_200)), Some(&Scalar::Integer(3)));
        ada.update(members(&["bob"]), None, at(15_300));
        assert_eq!(ada.value(&bob, &bag, at(15_300)), None, "ada has left");
    }

    #[test]
    fn invalid_values_of_another_node_are_found() {
        let long = Scalar::Text("x".repeat(300));
        for values in [
            MemberValues {
                readings: BTreeMap::from([("a-b".to_owned(), Scalar::Bool(true))]),
                ..MemberValues::default()
            },
            MemberValues { attributes: BTreeMap::from([("a".to_owned(), long)]), ..MemberValues::default() },
        ] {
            assert!(values.check().is_err(), "{values:?}");
        }
        assert_eq!(dust(1).check(), Ok(()));
    }
}
