//! The published scenarios on the published map: the same inputs give the same assignments.

use crate::skip::skip;
use consort_evaluation::design::shipped;
use consort_evaluation::policy::Policy;
use consort_evaluation::published_format;
use consort_evaluation::travel::{MeasuredLegs, TravelModel, TravelSettings};
use consort_skills::workload::Workload;
use consort_tests::experiment::{ExperimentSetup, run, trials};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Returns a file of the published evaluation; skips the test if the material is not installed.
fn published_file(file: &str) -> Option<String> {
    let folder = std::env::var_os("CONSORT_REFERENCE")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/reference"), PathBuf::from);
    let found = std::fs::read_to_string(folder.join("mission_control").join(file)).ok();
    if found.is_none() {
        skip("no published evaluation (CONSORT_REFERENCE names the folder that contains it)");
    }
    found
}

#[test]
fn the_fleet_assigns_the_published_robots() {
    let (Some(scenarios), Some(map), Some(bids)) =
        (published_file("scenarios_81.json"), published_file("hospital_map.json"), published_file("bids_27.jsonl"))
    else {
        return;
    };
    let selected: BTreeMap<String, String> = bids
        .lines()
        .map(|line| {
            let bid: Value = serde_json::from_str(line).unwrap();
            (bid["code"].as_str().unwrap().to_owned(), bid["selected"]["worker"].as_str().unwrap().to_owned())
        })
        .collect();
    let mut design = shipped("published").unwrap().unwrap();
    design.policies = vec![Policy::Consort, Policy::MissionControl];
    design.repetitions = 1;
    // Only the assignment is compared.
    design.limits.sim_s = 5.0;
    let mut chosen = published_format::scenarios(&scenarios, &design).unwrap();
    chosen.retain(|scenario| selected.contains_key(&scenario.code));
    assert_eq!(chosen.len(), 27);
    let map = published_format::published_map(&map, "hospital_map.json").unwrap();
    let setup = ExperimentSetup::new(
        design,
        chosen,
        map,
        TravelModel::Kinematic(TravelSettings::default()),
        None,
        Workload::default(),
    )
    .unwrap();
    for outcome in run(&setup, &trials(&setup), 2, |_| ()) {
        let row = outcome.row;
        let robot = row.robots.split(' ').find_map(|pair| pair.strip_prefix("r1=")).unwrap_or_default().to_owned();
        assert_eq!(robot, selected[&row.scenario], "{row:?}");
    }
}

#[test]
fn the_published_legs_are_read() {
    let Some(legs) = published_file("nav_legs.csv") else { return };
    let legs = MeasuredLegs::read(legs.as_bytes()).unwrap();
    assert_eq!(TravelModel::Empirical(legs).describe(), "empirical, 2162 drives on 21 pairs of places");
}
