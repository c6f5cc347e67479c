//! Configuration files of fleets and evaluations.

use super::frames::text;
use consort_evaluation::design;
use consort_evaluation::{results, travel};
use consort_lab::design_file::DesignFile;
use consort_nodes::config::{ConfigFile, FleetConfig, RobotConfig, StationConfig, WorldConfig, from_text, to_toml};
use consort_nodes::inputs;
use consort_protocol::mission::Domain;
use consort_skills::descriptor::{Calibration, DescriptorRegistry};
use consort_skills::extensions::Extensions;
use consort_tests::chaos::Schedule;

fn domain() -> Domain {
    Extensions::default().domain()
}

/// An accepted file can be printed and reads back as the same; an error contains the file and, if
/// there is one, the key.
fn survives<C: ConfigFile>(text: &str) -> Option<C> {
    match from_text::<C>(text, "a.toml", &domain()) {
        Ok(config) => {
            let once = to_toml(&config);
            let again: C = from_text(&once, "a.toml", &domain()).expect("what was printed can be read");
            assert_eq!(to_toml(&again), once, "it reads back as something else");
            Some(config)
        }
        Err(problems) => {
            assert!(!problems.0.is_empty() && problems.0.iter().all(|problem| problem.to_string().contains("a.toml")));
            None
        }
    }
}

pub(super) fn config(bytes: &[u8]) -> bool {
    let Some(text) = text(bytes) else { return false };
    let (fleet, robot) = (survives::<FleetConfig>(text).is_some(), survives::<RobotConfig>(text).is_some());
    let (station, world) = (survives::<StationConfig>(text).is_some(), survives::<WorldConfig>(text).is_some());
    fleet || robot || station || world
}

pub(super) fn design(bytes: &[u8]) -> bool {
    let Some(DesignFile(design)) = text(bytes).and_then(survives::<DesignFile>) else { return false };
    if design.trials() <= 1000 {
        let runs = design.policies.len() * design.treatments.len() * design.repetitions as usize;
        assert_eq!(design::scenarios(&design).len() * runs, design.trials());
    }
    true
}

pub(super) fn calibration(bytes: &[u8]) -> bool {
    let Some(learned) = text(bytes).and_then(survives::<Calibration>) else { return false };
    assert!(learned.margin_sds().is_finite(), "a reserve that is no number");
    std::sync::Arc::new(learned).correct(DescriptorRegistry::standard());
    true
}

pub(super) fn tables(bytes: &[u8]) -> bool {
    let mut read = false;
    if let Ok(rows) = results::read(bytes) {
        let mut once = vec![];
        results::write(&rows, &mut once).expect("rows that were read can be written");
        assert_eq!(results::read(&once[..]).expect("what was written can be read").len(), rows.len());
        read = !rows.is_empty();
    }
    match travel::MeasuredLegs::read(bytes) {
        Ok(_) => read = true,
        Err(problem) => assert!(!problem.to_string().is_empty()),
    }
    let Some(text) = text(bytes) else { return read };
    for file in ["a.toml", "a.json", "a.yaml"] {
        let workers = inputs::workers(text, file).map(|workers| !workers.is_empty());
        for found in [workers, inputs::scenarios(text, file).map(|scenarios| !scenarios.is_empty())] {
            match found {
                Ok(some) => read |= some,
                Err(problems) => assert!(problems.0.iter().all(|problem| problem.to_string().contains(file))),
            }
        }
    }
    if let Ok(schedule) = serde_json::from_str::<Schedule>(text) {
        let once = serde_json::to_string(&schedule).expect("a schedule");
        assert_eq!(serde_json::from_str::<Schedule>(&once).expect("what was written can be read"), schedule);
        read = true;
    }
    read
}
