use super::*;

#[test]
fn a_released_award_counts_only_if_it_was_confirmed() {
    let mut log = Log::of(&fetch_parcel());
    let first = log.award_with_energy(&[("r1", "amber", 0.25), ("lab_arm", "arm", 0.5)]);
    assert_eq!(log.energy(), 0.75);
    log.lose("r1", first, false);
    assert_eq!(log.energy(), 0.5, "amber has not started");
    let second = log.award_with_energy(&[("r1", "birch", 0.125)]);
    log.confirm(&["r1"], second);
    assert_eq!(log.energy(), 0.625);
    log.lose("r1", second, false);
    assert_eq!(log.energy(), 0.625, "birch may have used its estimate");
    log.award_with_energy(&[("r1", "cedar", 0.25)]);
    assert_eq!(log.energy(), 0.875);
}

#[test]
fn a_completed_mission_keeps_the_energy_of_its_awards() {
    let mut log = Log::of(&MissionTemplate::parse(RELAY, Format::Json).unwrap());
    let epoch = log.award_with_energy(&[("a", "amber", 0.25), ("b", "birch", 0.5)]);
    log.confirm(&["a", "b"], epoch);
    for name in ["a", "b"] {
        let steps = StepIndex::try_from(log.entry().plan(&role(name)).unwrap().steps.len()).unwrap();
        log.ended(name, epoch, 0..steps);
    }
    assert_eq!((&log.entry().state, log.energy()), (&MissionState::Completed, 0.75));
}

#[test]
fn estimates_that_are_no_energies_are_bounded() {
    let mut log = Log::of(&fetch_parcel());
    log.award_with_energy(&[("r1", "amber", -1.0), ("lab_arm", "arm", 0.5)]);
    assert_eq!(log.energy(), 0.5);
    for estimate in [f64::NAN, f64::INFINITY, 1e300] {
        let mut log = Log::of(&fetch_parcel());
        log.award_with_energy(&[("r1", "amber", estimate), ("lab_arm", "arm", estimate)]);
        assert!(log.energy().is_finite() && log.energy() > 1e8, "{estimate}: {}", log.energy());
    }
}
