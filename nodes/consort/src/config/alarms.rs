//! Alarms in the fleet file.

use consort_protocol::ids::{AlarmId, PlaceId};
use consort_protocol::ledger::{AlarmPlan, AlarmResponse, MapPart, alarm_size_problem};
use consort_protocol::mission::Domain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// `[alarms.NAME]`: an alarm, which people raise with `consort alarm NAME`. While it lasts no robot takes a role, and
/// robots with roles keep them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AlarmConfig {
    /// What robots do: with `stop` they stand still, and with `assemble` they drive to assembly places.
    pub robots: AlarmResponse,
    /// Assembly places on the fleet's map, or zones of them: each robot drives to the nearest that it can reach. Only with
    /// `assemble`.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub places: BTreeSet<PlaceId>,
    /// Places, zones and lanes that no robot enters meanwhile, such as lifts: a place or a zone by its name, a lane by its
    /// two ends, as `["Lift A", ["Hall", "Yard"]]`. Default: none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub closes: Vec<PartConfig>,
}

/// A place or a zone, or a lane by its two ends.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "closes must be a list of places and lanes, as [\"Lift A\", [\"Hall\", \"Yard\"]]")]
pub enum PartConfig {
    /// A place or a zone.
    Place(PlaceId),
    /// A lane.
    Lane(PlaceId, PlaceId),
}

impl AlarmConfig {
    /// Returns the plan with the zones of the domain.
    fn plan(&self, domain: &Domain) -> AlarmPlan {
        let part = |part: &PartConfig| match part {
            PartConfig::Place(name) => MapPart::named(name, domain),
            PartConfig::Lane(a, b) => MapPart::of_lane(a.clone(), b.clone()),
        };
        let AlarmConfig { robots, places, closes } = self;
        let places = places.iter().flat_map(|name| MapPart::named(name, domain).pairs()).map(|(place, _)| place);
        AlarmPlan { robots: *robots, places: places.collect(), closes: closes.iter().map(part).collect() }
    }
}

/// Returns the plans of the alarms, with the zones of the domain. Places are checked if the map of the domain is known.
///
/// # Errors
/// All problems.
pub(crate) fn alarm_plans(
    alarms: &BTreeMap<AlarmId, AlarmConfig>,
    domain: &Domain,
) -> Result<BTreeMap<AlarmId, AlarmPlan>, Vec<String>> {
    let plans: BTreeMap<AlarmId, AlarmPlan> =
        alarms.iter().map(|(name, alarm)| (name.clone(), alarm.plan(domain))).collect();
    let of_alarm = |(name, plan): (&AlarmId, &AlarmPlan)| {
        plan.problems(domain).into_iter().map(|problem| format!("alarms.{name}: {problem}")).collect::<Vec<_>>()
    };
    let size = alarm_size_problem(plans.values()).map(|problem| format!("alarms: {problem}"));
    let problems: Vec<String> = plans.iter().flat_map(of_alarm).chain(size).collect();
    if problems.is_empty() { Ok(plans) } else { Err(problems) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn alarms(text: &str) -> BTreeMap<AlarmId, AlarmConfig> {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn an_alarm_names_places_and_lanes() {
        let file = "[fire]\nrobots = \"assemble\"\nplaces = [\"Dock\"]\ncloses = [\"Lift A\", [\"Yard\", \"Hall\"]]\n";
        let plans = alarm_plans(&alarms(file), &Domain::default()).unwrap();
        let closes = plans.values().flat_map(|plan| &plan.closes).map(MapPart::to_string);
        assert_eq!(closes.collect::<Vec<_>>(), ["Lift A", "Hall – Yard"]);
        assert_eq!(alarms(&toml::to_string(&alarms(file)).unwrap()), alarms(file), "it reads back the same");
        let wrong = toml::from_str::<BTreeMap<AlarmId, AlarmConfig>>("[fire]\nrobots = \"stop\"\ncloses = [7]\n");
        let wrong = wrong.unwrap_err().to_string();
        assert!(wrong.contains("closes must be a list of places and lanes, as "), "{wrong}");
    }

    #[test]
    fn an_alarm_names_zones() {
        let file = "[fire]\nrobots = \"assemble\"\nplaces = [\"Dock\", \"yards\"]\ncloses = [\"icu\"]\n";
        let places = |names: &[&str]| names.iter().map(|name| name.parse().unwrap()).collect::<BTreeSet<PlaceId>>();
        let zones = [("yards", places(&["Yard A", "Yard B"])), ("icu", places(&["IC Room 5"]))];
        let zones = zones.into_iter().map(|(name, places)| (name.parse().unwrap(), places)).collect();
        let plans = alarm_plans(&alarms(file), &Domain::default().with_zones(zones)).unwrap();
        let plan = plans.values().next().unwrap();
        assert_eq!(plan.places, places(&["Dock", "Yard A", "Yard B"]));
        assert_eq!(plan.closes.iter().map(MapPart::to_string).collect::<Vec<_>>(), ["zone icu"]);
    }

    #[test]
    fn problems_name_the_alarm() {
        let wrong = alarms("[fire]\nrobots = \"assemble\"\n[flood]\nrobots = \"stop\"\ncloses = [\"Celar\"]\n");
        let domain = Domain::default().with_places(["Cellar", "Dock"].map(|name| name.parse().unwrap()));
        let expected = [
            "alarms.fire: `robots = \"assemble\"` needs assembly places; name them in `places`",
            "alarms.flood: closes: there is no place Celar; allowed: Cellar, Dock; did you mean `Cellar`?",
        ];
        assert_eq!(alarm_plans(&wrong, &domain).unwrap_err(), expected);
    }
}
