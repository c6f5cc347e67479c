//! Charging in the fleet file.

use consort_fleet::robot::{BatterySwap, ChargeThresholds, Charger, ChargingSettings};
use consort_protocol::charging_curve::ChargingCurve;
use consort_protocol::ensemble::Eligibility;
use consort_protocol::ids::PlaceId;
use consort_protocol::units::{BatteryShare, Watts};
use consort_skills::descriptor::MeasuredCharging;
use consort_skills::missions::NamedMissions;
use consort_text::AllowedNames;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// `[charging]`: free robots charge by themselves, and bid only for roles after which they can reach a
/// charger. Chargers are the places of kind `charger` on the fleet's map, and those listed here.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ChargingConfig {
    /// Charge below which a free robot goes to a charger, as a share. Higher: robots drive to chargers more often, and
    /// have more charge for long roles. Default 0.3.
    pub below: BatteryShare,
    /// Charge at which a robot has charged enough, as a share. Default 0.9.
    pub until: BatteryShare,
    /// Charge below which a free robot uses a charger that no other robot needs, as a share. Default: none, and robots
    /// charge only below `below`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub opportunistic: Option<BatteryShare>,
    /// Places to which free robots drive that have enough charge, a robot to each, so that they leave chargers and
    /// corridors free. Default: none, and idle robots stay where they are.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub parking: Vec<PlaceId>,
    /// Charging curve of the robots' batteries: the share of its full power with which a battery charges from each charge
    /// on. The simulator and the forecasts of robots use it; a curve of the `calibration` replaces it in the forecasts. Default:
    /// full power up to the end.
    #[serde(skip_serializing_if = "ChargingCurve::is_empty")]
    pub curve: ChargingCurve,
    /// Chargers at places that are not of kind `charger` on the map, and chargers with other settings than the
    /// defaults.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub charger: Vec<ChargerConfig>,
    /// Swaps of batteries by people, in place of chargers. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub swap: Option<SwapConfig>,
}

/// `[charging.swap]`: a person swaps the battery of a robot whose charge is less than `below`. Such robots use no chargers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SwapConfig {
    /// Name of the mission that brings the robot to the swap place, where it asks a person: a mission of the fleet with the
    /// parameter `robot`, its name.
    pub mission: String,
    /// Condition on the robots whose batteries are swapped, in CEL, as for chargers. Default: all robots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eligible: Option<String>,
}

/// `[[charging.charger]]`: a charger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ChargerConfig {
    /// Its place on the fleet's map.
    pub place: PlaceId,
    /// Its power, in watts: simulated robots with `capacity_wh` charge with it, and robots with `capacity_wh` in their
    /// files forecast with it how long they charge. Default: unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub power_w: Option<Watts>,
    /// Condition on the robots that may use it, in CEL, as `robot.attributes.plug == "a"` or `robot.name in ["ada"]`,
    /// evaluated when the robot's node starts. Default: all robots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eligible: Option<String>,
}

impl Default for ChargingConfig {
    fn default() -> Self {
        let share = |share| BatteryShare::new(share).expect("a default from 0 to 1");
        let (below, until) = (share(0.3), share(0.9));
        let curve = ChargingCurve::default();
        ChargingConfig { below, until, opportunistic: None, parking: vec![], curve, charger: vec![], swap: None }
    }
}

impl ChargingConfig {
    /// Returns the semantic problems, except for unknown places.
    pub(super) fn validate(&self) -> Vec<String> {
        let mut problems = vec![];
        let ChargingConfig { below, until, .. } = self;
        if below >= until {
            problems.push(format!(
                "charging.below is {}, allowed is less than charging.until, {}",
                below.get(),
                until.get()
            ));
        }
        if let Some(top_up) = self.opportunistic.filter(|top_up| !(below..=until).contains(&top_up)) {
            let (top_up, below, until) = (top_up.get(), below.get(), until.get());
            problems.push(format!(
                "charging.opportunistic is {top_up}, allowed is {below} (charging.below) to {until} (charging.until)"
            ));
        }
        let swap = self.swap.as_ref().and_then(|swap| swap.eligible.as_deref());
        if let Some(Err(problem)) = swap.map(Eligibility::compile) {
            problems.push(format!("charging.swap: eligible: {problem}"));
        }
        let mut seen = BTreeSet::new();
        let again = self.parking.iter().filter(|place| !seen.insert(*place));
        problems.extend(again.map(|place| format!("charging.parking {place}: is listed twice")));
        let mut seen = BTreeSet::new();
        for charger in &self.charger {
            let place = &charger.place;
            if !seen.insert(place) {
                problems.push(format!("charging.charger {place}: is declared twice"));
            }
            if let Some(Err(problem)) = charger.eligible.as_deref().map(Eligibility::compile) {
                problems.push(format!("charging.charger {place}: eligible: {problem}"));
            }
        }
        problems
    }

    /// Returns the chargers of the fleet: those of the file, and the other `chargers` of the map. `places` are all
    /// places of the map.
    ///
    /// # Errors
    /// Descriptions of unknown places, of the lack of any charger, or of a charger for parking.
    pub(crate) fn chargers<'a>(
        &self,
        chargers: impl IntoIterator<Item = &'a PlaceId>,
        places: &BTreeSet<&PlaceId>,
    ) -> Result<Vec<ChargerConfig>, Vec<String>> {
        let of_chargers = self.charger.iter().map(|charger| ("charging.charger: place", &charger.place));
        let of_parking = self.parking.iter().map(|place| ("charging.parking", place));
        let unknown = of_chargers.chain(of_parking).filter(|(_, place)| !places.contains(place));
        let problems: Vec<String> = unknown
            .map(|(key, place)| {
                let allowed = AllowedNames::suggest_for(place.as_str(), places.iter().copied());
                format!("{key}: {:?} is not on the fleet's map; {allowed}", place.as_str())
            })
            .collect();
        if !problems.is_empty() {
            return Err(problems);
        }
        let of_map = |place: &PlaceId| ChargerConfig { place: place.clone(), power_w: None, eligible: None };
        let mut all: BTreeMap<PlaceId, ChargerConfig> =
            chargers.into_iter().map(|place| (place.clone(), of_map(place))).collect();
        all.extend(self.charger.iter().map(|charger| (charger.place.clone(), charger.clone())));
        if all.is_empty() && self.swap.is_none() {
            let problem = "charging: the fleet has no charger; declare [[charging.charger]] with a place, or places of kind \
                           charger on the map";
            return Err(vec![problem.to_owned()]);
        }
        match self.parking.iter().find(|place| all.contains_key(*place)) {
            Some(charger) => Err(vec![format!("charging.parking: {charger} is a charger; name other places")]),
            None => Ok(all.into_values().collect()),
        }
    }

    /// Returns the settings of nodes, with these chargers. Forecasts use the charging that a calibration has measured, if any.
    pub(crate) fn settings(
        &self,
        chargers: Vec<ChargerConfig>,
        measured: Option<&MeasuredCharging>,
    ) -> ChargingSettings {
        let ChargingConfig { below, until, opportunistic, .. } = *self;
        let charger = |ChargerConfig { place, power_w, eligible }| Charger { place, eligible, power: power_w };
        ChargingSettings {
            thresholds: ChargeThresholds { below, until, opportunistic },
            chargers: chargers.into_iter().map(charger).collect(),
            parking: self.parking.iter().cloned().collect(),
            curve: measured.map_or(&self.curve, |measured| &measured.curve).clone(),
            gain: measured.map(|measured| measured.share_per_s),
            swap: self.swap.clone().map(|SwapConfig { mission, eligible }| BatterySwap { mission, eligible }),
        }
    }

    /// Returns the problem of the mission in which batteries are swapped, if any.
    pub(crate) fn swap_problem(&self, missions: &NamedMissions) -> Option<String> {
        let swap = &self.swap.as_ref()?.mission;
        match missions.offered().find(|offered| offered.mission.as_str() == swap) {
            Some(offered) if offered.parameters.contains_key("robot") => None,
            Some(_) => Some(format!("charging.swap.mission: the mission {swap:?} lacks the parameter `robot`")),
            None => {
                let allowed = AllowedNames::suggest_for(swap, missions.offered().map(|offered| offered.mission));
                Some(format!("charging.swap.mission: the fleet has no mission {swap:?}; {allowed}"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::units::SharePerSecond;
    use consort_skills::descriptor::Calibration;

    fn config(text: &str) -> ChargingConfig {
        toml::from_str(text).unwrap()
    }

    fn places(names: &[&str]) -> BTreeSet<PlaceId> {
        names.iter().map(|name| name.parse().unwrap()).collect()
    }

    #[test]
    fn thresholds_and_chargers_are_checked() {
        let charger = "[[charger]]\nplace = \"Dock\"\neligible = ";
        for (text, problems) in [
            ("".to_owned(), vec![]),
            ("below = 0.9".to_owned(), vec!["charging.below is 0.9, allowed is less than charging.until, 0.9"]),
            (
                "opportunistic = 0.2".to_owned(),
                vec!["charging.opportunistic is 0.2, allowed is 0.3 (charging.below) to 0.9 (charging.until)"],
            ),
            ("opportunistic = 0.9".to_owned(), vec![]),
            ("parking = ['Hall', 'Hall']".to_owned(), vec!["charging.parking Hall: is listed twice"]),
            (
                format!("{charger}'robot.name in [\"ada\"]'\n[[charger]]\nplace = \"Dock\""),
                vec!["charging.charger Dock: is declared twice"],
            ),
        ] {
            assert_eq!(config(&text).validate(), problems, "{text}");
        }
        let wrong = config(&format!("{charger}'robot.plug == 1'")).validate();
        assert!(wrong[0].starts_with("charging.charger Dock: eligible: "), "{wrong:?}");
    }

    #[test]
    fn the_mission_of_swaps_is_one_of_the_fleet_with_the_parameter_robot() {
        let problem = |mission: &str| {
            let config = config(&format!("[swap]\nmission = {mission:?}"));
            config.swap_problem(&NamedMissions::default()).unwrap()
        };
        assert_eq!(
            problem("lab-samples"),
            "charging.swap.mission: the mission \"lab-samples\" lacks the parameter `robot`"
        );
        let unknown = problem("lab-sample");
        assert!(unknown.starts_with("charging.swap.mission: the fleet has no mission \"lab-sample\"; "), "{unknown}");
        let wrong = config("[swap]\nmission = \"swap\"\neligible = 'robot.plug == 1'");
        assert!(wrong.validate()[0].starts_with("charging.swap: eligible: "), "{:?}", wrong.validate());
        assert_eq!(wrong.chargers(&BTreeSet::new(), &BTreeSet::new()).unwrap(), [], "no charger is needed");
    }

    #[test]
    fn a_charging_curve_is_checked_as_it_is_read() {
        let step = |above: f64, power: f64| format!("[[curve]]\nabove = {above}\npower = {power}\n");
        let curve = config(&(step(0.8, 0.5) + &step(0.9, 0.2))).curve;
        assert_eq!([0.7, 0.8, 0.95].map(|charge| curve.power_at(charge)), [1.0, 0.5, 0.2]);
        let problem = toml::from_str::<ChargingConfig>(&step(0.8, 1.5)).unwrap_err().to_string();
        assert!(problem.contains("power is 1.5, allowed is above 0 to 1"), "{problem}");
    }

    #[test]
    fn forecasts_use_the_measured_charging_of_a_calibration() {
        let config = config("[[curve]]\nabove = 0.8\npower = 0.5");
        let declared = config.settings(vec![], None);
        assert_eq!((declared.curve.power_at(0.9), declared.gain), (0.5, None));
        let measured: Calibration = toml::from_str(
            "quantile = 0.9\n[charging]\nshare_per_s = 0.0005\n[[charging.curve]]\nabove = 0.7\npower = 0.4",
        )
        .unwrap();
        let forecast = config.settings(vec![], measured.charging.as_ref());
        assert_eq!((forecast.curve.power_at(0.75), forecast.gain.map(SharePerSecond::get)), (0.4, Some(0.0005)));
    }

    #[test]
    fn chargers_of_the_file_replace_those_of_the_map() {
        let known = places(&["Dock", "Hall", "Station"]);
        let known = known.iter().collect();
        let of_map = places(&["Station"]);
        let file =
            config("[[charger]]\nplace = \"Dock\"\npower_w = 600.0\n[[charger]]\nplace = \"Station\"\npower_w = 300.0");
        let powers = |config: &ChargingConfig| {
            let chargers = config.chargers(&of_map, &known).unwrap().into_iter();
            chargers.map(|charger| (charger.place.to_string(), charger.power_w.map(Watts::get))).collect::<Vec<_>>()
        };
        assert_eq!(powers(&file), [("Dock".to_owned(), Some(600.0)), ("Station".to_owned(), Some(300.0))]);
        assert_eq!(powers(&config("")), [("Station".to_owned(), None)]);
    }

    #[test]
    fn chargers_and_parking_need_places_of_the_map() {
        let known = places(&["Dock", "Hall"]);
        let known = known.iter().collect();
        let problems = config("[[charger]]\nplace = \"Dok\"").chargers(&BTreeSet::new(), &known).unwrap_err();
        assert!(
            problems[0].starts_with("charging.charger: place: \"Dok\" is not on the fleet's map; "),
            "{problems:?}"
        );
        let problems = config("parking = ['Hal']").chargers(&places(&["Dock"]), &known).unwrap_err();
        assert!(problems[0].starts_with("charging.parking: \"Hal\" is not on the fleet's map; "), "{problems:?}");
        let problems = config("parking = ['Dock', 'Hall']").chargers(&places(&["Dock"]), &known).unwrap_err();
        assert_eq!(problems, ["charging.parking: Dock is a charger; name other places"]);
        let problems = config("").chargers(&BTreeSet::new(), &known).unwrap_err();
        assert!(problems[0].starts_with("charging: the fleet has no charger; "), "{problems:?}");
    }
}
