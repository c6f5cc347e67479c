//! Alarms: orders of people to all robots, as the fleet file declares them.

use super::map_part::MapPart;
use super::robot_order::{OrderRequest, RobotOrder};
use crate::codec;
use crate::ids::{AlarmId, PlaceId};
use crate::mission::Domain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of alarms in force. Raised: a snapshot may be too large for every replica.
const ALARMS_MAX: usize = 16;

/// Maximum encoded size of the plans of all alarms in bytes: a notice to a robot contains them all. Raised: a
/// notice may be too large for a message.
const PLANS_BYTES_MAX: usize = 4 * 1024;

/// Maximum encoded size of all alarms in bytes: their plans, their names, and the texts of their orders.
pub(super) const ALARMS_BYTES_MAX: usize = PLANS_BYTES_MAX + ALARMS_MAX * 1024;

/// Beginning of the text of an alarm.
const TEXT_PREFIX: &str = "under alarm ";

/// What robots do while an alarm lasts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AlarmResponse {
    /// They stand still.
    Stop,
    /// They drive to assembly places.
    Assemble,
}

/// Plan of an alarm, from the fleet file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AlarmPlan {
    /// What robots do.
    pub robots: AlarmResponse,
    /// Assembly places: each robot drives to the nearest that it can reach.
    pub places: BTreeSet<PlaceId>,
    /// Zones, places and lanes that no robot enters meanwhile.
    pub closes: BTreeSet<MapPart>,
}

/// An alarm in force.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Alarm {
    /// Its name.
    pub alarm: AlarmId,
    /// Its plan, as declared when it was raised.
    pub plan: AlarmPlan,
    /// Person, reason and start of the alarm; it has no end.
    pub order: RobotOrder,
}

/// Change of the alarms.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum AlarmChange {
    /// Raise an alarm. The latest order counts.
    Raise {
        /// The alarm.
        alarm: AlarmId,
        /// Its plan.
        plan: AlarmPlan,
        /// Reason, for people; may be empty.
        reason: String,
    },
    /// Clear an alarm, or all alarms.
    Clear {
        /// The alarm; `None` for all.
        alarm: Option<AlarmId>,
    },
}

impl AlarmPlan {
    /// Returns the problems of the plan. Places are checked if the map of the domain is known.
    pub fn problems(&self, domain: &Domain) -> Vec<String> {
        let mut problems = vec![];
        match (self.robots, self.places.is_empty()) {
            (AlarmResponse::Stop, false) => problems
                .push("`places` belong to `robots = \"assemble\"`; with `robots = \"stop\"` omit them".to_owned()),
            (AlarmResponse::Assemble, true) => {
                problems.push("`robots = \"assemble\"` needs assembly places; name them in `places`".to_owned());
            }
            (AlarmResponse::Stop, true) | (AlarmResponse::Assemble, false) => {}
        }
        for place in &self.places {
            let unknown = MapPart::Place(place.clone()).check(domain).err();
            problems.extend(unknown.map(|problem| format!("places: {problem}")));
            let closed = |part: &MapPart| match part {
                MapPart::Zone(zone) if zone.places.contains(place) => {
                    Some(format!("closes: {part} contains the assembly place {place}; name other places"))
                }
                MapPart::Place(closed) if closed == place => {
                    Some(format!("closes: {place} is an assembly place; name other places"))
                }
                MapPart::Zone(_) | MapPart::Place(_) | MapPart::Lane(..) => None,
            };
            problems.extend(self.closes.iter().filter_map(closed));
        }
        let closed = self.closes.iter().filter_map(|part| part.check(domain).err());
        problems.extend(closed.map(|problem| format!("closes: {problem}")));
        problems
    }

    /// Formats what the alarm demands, as `robots drive to the nearest of Dock, Yard; closed: Lift A`.
    pub fn text(&self) -> String {
        let AlarmPlan { robots, places, closes } = self;
        let names = |names: Vec<String>| names.join(", ");
        let robots = match robots {
            AlarmResponse::Stop => "robots stand still".to_owned(),
            AlarmResponse::Assemble => {
                format!("robots drive to the nearest of {}", names(places.iter().map(PlaceId::to_string).collect()))
            }
        };
        match closes.is_empty() {
            true => robots,
            false => format!("{robots}; closed: {}", names(closes.iter().map(MapPart::to_string).collect())),
        }
    }
}

impl Alarm {
    /// Formats the alarm, as `under alarm fire by Nia: smoke`.
    pub fn text(&self) -> String {
        let RobotOrder { by, .. } = &self.order;
        format!("{TEXT_PREFIX}{} by {by}{}", self.alarm, self.order.reason_text())
    }

    /// Checks whether a robot is out of service because of an alarm, by the problem that its record states. The record
    /// states it until the robot has received the all-clear.
    pub fn is_problem(problem: &str) -> bool {
        problem.starts_with(TEXT_PREFIX)
    }
}

impl OrderRequest<AlarmChange> {
    /// Changes the alarms.
    pub(super) fn change_alarms(&self, alarms: &mut BTreeMap<AlarmId, Alarm>) {
        match &self.change {
            AlarmChange::Raise { alarm, plan, reason } => {
                let order = self.order(None, reason);
                alarms.insert(alarm.clone(), Alarm { alarm: alarm.clone(), plan: plan.clone(), order });
            }
            AlarmChange::Clear { alarm: Some(alarm) } => {
                alarms.remove(alarm);
            }
            AlarmChange::Clear { alarm: None } => alarms.clear(),
        }
    }
}

/// Returns the problem of plans that are too many or too large to be in force together.
pub fn alarm_size_problem<'a>(plans: impl IntoIterator<Item = &'a AlarmPlan>) -> Option<String> {
    let sizes: Vec<usize> = plans.into_iter().map(codec::encoded_size).collect();
    let (count, bytes) = (sizes.len(), sizes.iter().sum::<usize>());
    if count > ALARMS_MAX {
        return Some(format!("there are {count} alarms, allowed are at most {ALARMS_MAX}"));
    }
    (bytes > PLANS_BYTES_MAX).then(|| {
        format!("the places and lanes of all alarms take {bytes} bytes, allowed are at most {PLANS_BYTES_MAX}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(name: &str) -> PlaceId {
        name.parse().unwrap()
    }

    fn plan(robots: AlarmResponse, places: &[&str], closes: &[MapPart]) -> AlarmPlan {
        let places = places.iter().map(|name| place(name)).collect();
        AlarmPlan { robots, places, closes: closes.iter().cloned().collect() }
    }

    /// A map W – Main – E with a zone of both ends.
    fn domain() -> Domain {
        let places = ["W", "Main", "E"].map(place);
        let lanes = [(place("W"), place("Main")), (place("Main"), place("E"))];
        let zones = BTreeMap::from([("ends".parse().unwrap(), ["W", "E"].map(place).into())]);
        Domain::default().with_places(places).with_lanes(lanes).with_zones(zones)
    }

    #[test]
    fn a_plan_names_places_of_the_map_and_fits_its_response() {
        use AlarmResponse::{Assemble, Stop};
        let closed = |name: &str| MapPart::Place(place(name));
        let lane = MapPart::of_lane(place("Main"), place("E"));
        let ends = MapPart::named(&place("ends"), &domain());
        for valid in [plan(Stop, &[], &[closed("E"), ends]), plan(Assemble, &["W", "Main"], &[lane])] {
            assert_eq!(valid.problems(&domain()), [] as [&str; 0], "{valid:?}");
        }
        let allowed = "allowed: ends, E, Main, W; did you mean `Main`?";
        for (invalid, problem) in [
            (plan(Stop, &["W"], &[]), "`places` belong to `robots = \"assemble\"`; with `robots = \"stop\"` omit them"),
            (plan(Assemble, &[], &[]), "`robots = \"assemble\"` needs assembly places; name them in `places`"),
            (plan(Assemble, &["Mainn"], &[]), format!("places: there is no place or zone Mainn; {allowed}").as_str()),
            (
                plan(Stop, &[], &[closed("Mainn")]),
                format!("closes: there is no place or zone Mainn; {allowed}").as_str(),
            ),
            (
                plan(Stop, &[], &[MapPart::of_lane(place("W"), place("E"))]),
                "closes: there is no lane E – W; the lanes of E lead to Main",
            ),
            (plan(Assemble, &["W"], &[closed("W")]), "closes: W is an assembly place; name other places"),
            (
                plan(Assemble, &["W"], &[MapPart::named(&place("ends"), &domain())]),
                "closes: zone ends contains the assembly place W; name other places",
            ),
        ] {
            assert_eq!(invalid.problems(&domain()), [problem]);
        }
        let unknown_map = plan(Assemble, &["X"], &[]);
        assert_eq!(unknown_map.problems(&Domain::default()), [] as [&str; 0], "the map is unknown");
    }

    #[test]
    fn declared_alarms_are_limited_in_number_and_size() {
        let small = plan(AlarmResponse::Stop, &[], &[]);
        assert_eq!(alarm_size_problem(vec![&small; ALARMS_MAX]), None);
        let problem = alarm_size_problem(vec![&small; ALARMS_MAX + 1]).unwrap();
        assert_eq!(problem, "there are 17 alarms, allowed are at most 16");
        let names: Vec<String> = (0..1000).map(|number| format!("Place {number}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let problem = alarm_size_problem([&plan(AlarmResponse::Assemble, &names, &[])]).unwrap();
        assert!(problem.ends_with("allowed are at most 4096"), "{problem}");
    }

    #[test]
    fn an_alarm_is_described_with_its_plan() {
        let order = RobotOrder { by: "Nia".to_owned(), reason: "smoke".to_owned(), since_ms: 1, until_ms: None };
        let closes = [MapPart::Place(place("Lift A"))];
        let alarm = |robots, places: &[&str], closes: &[MapPart]| Alarm {
            alarm: "fire".parse().unwrap(),
            plan: plan(robots, places, closes),
            order: order.clone(),
        };
        let fire = alarm(AlarmResponse::Assemble, &["Dock", "Yard"], &closes);
        assert_eq!(fire.text(), "under alarm fire by Nia: smoke");
        assert!(Alarm::is_problem(&fire.text()) && !Alarm::is_problem(&fire.order.hold_text()));
        assert_eq!(fire.plan.text(), "robots drive to the nearest of Dock, Yard; closed: Lift A");
        assert_eq!(alarm(AlarmResponse::Stop, &[], &[]).plan.text(), "robots stand still");
    }
}
