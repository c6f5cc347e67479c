//! Batteries that people swap.

use crate::support::{answer, open_request};
use consort_fleet::node::NodeSettings;
use consort_fleet::robot::BatterySwap;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::mission::{Format, IhtnFields, MissionDocument};
use consort_protocol::yaml;
use consort_skills::actions::RobotBackend as _;
use consort_skills::domain_file::DomainFile;
use consort_skills::missions::NamedMissions;
use consort_tests::{ChargingSetup, Fleet, RobotSpec, for_each_seed, slug};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

const SOON: Duration = Duration::from_secs(60);

const DOMAIN: &str = include_str!("../../examples/battery-swap/domain.yaml");
const TREE: &str = include_str!("../../examples/battery-swap/swap_battery.xml");
const MISSION: &str = include_str!("../../examples/battery-swap/mission.yaml");

/// The coordinator dies while a person is asked. The swap is requested once.
#[test]
fn a_person_swaps_the_battery_of_a_robot_with_low_charge_once() {
    for_each_seed([951, 952], async |seed| {
        let trees = BTreeMap::from([("swap_battery.xml".to_owned(), TREE.to_owned())]);
        let domain = DomainFile::check(yaml::parse(DOMAIN).expect("YAML"), &trees, &[]);
        let mut missions = NamedMissions::default();
        let mission = MissionDocument::parse(MISSION, Format::Yaml, IhtnFields::default()).expect("a mission");
        missions.add(mission).expect("no other has its name");
        let missions = Arc::new(missions);
        let mut charging = ChargingSetup::new(&[], 0.4, 1440.0);
        charging.settings.swap = Some(BatterySwap { mission: "battery-swap".to_owned(), eligible: None });
        let adjust = Box::new(move |node: &mut NodeSettings| node.fleet.missions = Arc::clone(&missions));
        let robots = vec![RobotSpec::carrier("fern", "PC Room 8").with_charge(0.3).with_skills(&[
            "navigation",
            "operate_drawer",
            "swap_battery",
        ])];
        let stations = ["aster", "basil", "clove"];
        let setup = (charging, domain.expect("a valid domain"));
        let mut fleet = Fleet::hospital_with_charging_domain(seed, robots, &stations, setup, adjust).await;
        fleet.wait_for_coordinator().await;
        let asked = open_request(&fleet, "a request", |request| request["role"] == "porter").await;
        if fleet.kill_coordinator().await.as_str() == "fern" {
            fleet.restart("fern").await;
        }
        fleet.wait_for_coordinator().await;
        let done =
            json!({ "request": asked["request"], "answer": "done", "results": { "answer": "done" }, "by": "Nia" });
        answer(&fleet, &done).await;
        let charge = |fleet: &Fleet| fleet.world.telemetry(&slug("fern")).expect("a robot").battery.get();
        fleet.wait_until("a full battery", SOON, |fleet| charge(fleet) > 0.95).await;
        let requested = |fleet: &Fleet| {
            let missions = fleet.events().into_iter().filter_map(|event| match event {
                EventKind::Mission { mission, .. } => Some(mission),
                _ => None,
            });
            missions.collect::<BTreeSet<MissionId>>().len()
        };
        assert_eq!(requested(&fleet), 1, "seed {seed}\n{}", fleet.event_log_text());
        fleet.assert_never("another swap", Duration::from_secs(90), |fleet| requested(fleet) > 1).await;
    });
}
