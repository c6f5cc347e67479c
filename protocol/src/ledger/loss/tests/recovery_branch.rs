use super::*;

/// The mission `fetch-parcel`, with a helper that drives to the carrier if it is lost.
fn with_recovery() -> MissionTemplate {
    let text = FETCH_PARCEL.replace("roles:\n  clerk", "roles:\n  helper: { kind: managed }\n  clerk")
        + "recovery: { task: go_and_look, type: navigation, roles: [helper], parameters: { to: \"${lost.place}\" } }\n";
    MissionTemplate::parse(&text, Format::Yaml).unwrap()
}

#[test]
fn the_robot_with_the_item_may_take_part_in_the_recovery() {
    let mut log = Log::of(&with_recovery());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.lose("r1", epoch(2), false);
    assert!(matches!(log.award(&[("helper", "amber")]), CommandOutcome::Awarded { .. }));
}

#[test]
fn a_mission_continues_with_its_recovery_branch() {
    let mut log = Log::of(&with_recovery());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.lose("r1", epoch(2), false);
    let entry = log.entry();
    assert_eq!((entry.branch, &entry.state), (Branch::Recovery, &MissionState::Pending));
    assert_eq!(entry.open_roles(), [role("helper")].into());
    let (_, spec) = entry.plan(&role("helper")).unwrap().tasks().next().unwrap();
    assert_eq!(spec.parameters["to"], "IC Room 6");
    assert!(log.0.held_by(&robot("arm")).is_none(), "the other robots are free");
    let arm = RoleHolder { robot: robot("arm"), epoch: epoch(2) };
    assert_eq!(entry.former_holders, [arm], "and may still be acting");

    // The robot with the parcel gets no other role meanwhile, in case it returns.
    let recovering = log.2.clone();
    log.2 = log.submit("next", &fetch_parcel());
    let full = log.award(&[("r1", "amber"), ("lab_arm", "arm")]);
    assert!(matches!(full, CommandOutcome::Refused(CommandError::CarriesItem { .. })), "{full:?}");
    log.2 = recovering;

    let then = log.hold(&[("helper", "birch")]);
    assert_eq!(log.entry().former_holders, []);
    log.ended("helper", then, 0..1);
    let (cause, items) = log.intervention();
    assert_eq!(cause, "the recovery branch was completed; the parcel is with amber at IC Room 6");
    assert_eq!(items, [("amber", Some(&place()), true)]);
}

#[test]
fn the_recovery_branch_counts_the_energy_of_the_main_branch() {
    let mut log = Log::of(&with_recovery());
    let first = log.award_with_energy(&[("r1", "amber", 0.25), ("lab_arm", "arm", 0.5)]);
    log.confirm(&["r1", "lab_arm"], first);
    log.ended("r1", first, 0..8);
    log.lose("r1", first, false);
    assert_eq!((log.entry().branch, log.energy()), (Branch::Recovery, 0.75));
    log.award_with_energy(&[("helper", "birch", 0.125)]);
    assert_eq!(log.energy(), 0.875);
}

#[test]
fn a_robot_lost_in_the_recovery_branch_without_an_item_is_replaced() {
    let mut log = Log::of(&with_recovery());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.lose("r1", epoch(2), false);
    let then = log.hold(&[("helper", "birch")]);
    log.lose("helper", then, false);
    let entry = log.entry();
    assert_eq!((entry.branch, &entry.state), (Branch::Recovery, &MissionState::Pending));
    assert_eq!(entry.open_roles(), [role("helper")].into());
    assert_eq!((log.custodians(), entry.release_count), (vec!["amber!".to_owned()], 2), "the parcel is where it was");
    // After the last release the mission needs a person, and the first loss is still recorded.
    for name in ["cedar", "dogwood", "elm"] {
        let then = log.hold(&[("helper", name)]);
        log.lose("helper", then, true);
    }
    let (cause, items) = log.intervention();
    assert!(cause.starts_with("its roles were given up 5 times: silent for 7 s (r1); "), "{cause}");
    assert!(cause.ends_with("; the parcel is with amber at IC Room 6"), "{cause}");
    assert_eq!(items, [("amber", Some(&place()), true)]);
}

#[test]
fn a_robot_lost_with_the_item_in_the_recovery_needs_intervention() {
    let text = FETCH_PARCEL.to_owned()
        + "recovery: { task: hand_over, type: wait, roles: [lab_arm], parameters: { seconds: \"5\" }, acquires: { parcel: lab_arm } }\n";
    let mut log = Log::of(&MissionTemplate::parse(&text, Format::Yaml).unwrap());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.lose("r1", epoch(2), false);
    let then = log.hold(&[("lab_arm", "arm")]);
    log.lose("lab_arm", then, false);
    let (cause, items) = log.intervention();
    assert_eq!(cause, "arm was lost as lab_arm and may have the parcel: silent for 7 s");
    assert_eq!(items, [("amber", Some(&place()), false), ("arm", Some(&place()), false)]);
}

#[test]
fn a_branch_that_needs_an_unknown_place_is_not_taken() {
    let mut log = Log::of(&with_recovery());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    let (mission, role, cause) = (log.2.clone(), role("r1"), "silent".to_owned());
    log.apply(Command::Release {
        mission,
        role,
        epoch: epoch(2),
        cause,
        class: None,
        moved_nothing: false,
        place: None,
        gave_way: false,
    });
    assert_eq!(log.intervention().1, [("amber", None, true)]);
}

#[test]
fn an_item_released_by_the_recovery_branch_needs_no_intervention() {
    let text = FETCH_PARCEL.to_owned()
        + "recovery: { task: hand_over, type: wait, roles: [clerk, lab_arm], parameters: { seconds: \"5\" }, releases: [parcel] }\n";
    let mut log = Log::of(&MissionTemplate::parse(&text, Format::Yaml).unwrap());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.lose("r1", epoch(2), false);
    let then = log.hold(&[("lab_arm", "arm")]);
    log.ended("clerk", Epoch::default(), 0..3);
    log.ended("lab_arm", then, 0..3);
    assert_eq!(log.entry().state, MissionState::Completed);
}

#[test]
fn progress_of_a_person_does_not_count_in_the_recovery_branch() {
    // The clerk has as many steps in the branch as in the mission, and moves the same parcel.
    let text = FETCH_PARCEL.to_owned()
        + "recovery: { task: hand_over, type: wait, roles: [clerk, lab_arm], parameters: { seconds: \"5\" }, releases: [parcel] }\n";
    let mut log = Log::of(&MissionTemplate::parse(&text, Format::Yaml).unwrap());
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.ended("clerk", Epoch::default(), 0..2);
    log.lose("r1", epoch(2), false);
    let before = log.0.clone();
    let late = log.ended_in(Branch::Main, "clerk", Epoch::default(), 0..3);
    let refused =
        CommandOutcome::Refused(CommandError::WrongBranch { mission: log.2.clone(), taken: Branch::Recovery });
    assert_eq!(late, refused);
    let (mission, cause, places) = (log.2.clone(), "the clerk has no parcel".to_owned(), BTreeMap::new());
    let (branch, class) = (Some(Branch::Main), CauseClass::Task);
    let late = log.apply(Command::Fail { mission, cause, branch, places, class });
    assert_eq!(late, refused);
    assert_eq!(log.0, before, "the ledger must be unchanged");
    assert_eq!(log.ended_in(Branch::Recovery, "clerk", Epoch::default(), 0..1), CommandOutcome::Done);
    assert_eq!(log.entry().roles[&role("clerk")].ended, [0].into());
}

#[test]
fn an_auction_of_a_branch_has_no_effect_in_the_other_branch() {
    // Both branches need an arm; the arm of the mission is lost while an arm is sought for it.
    let text = FETCH_PARCEL.to_owned()
        + "recovery: { task: hand_over, type: wait, roles: [lab_arm], parameters: { seconds: \"5\" } }\n";
    let mut log = Log::of(&MissionTemplate::parse(&text, Format::Yaml).unwrap());
    let auction = |log: &Log, branch| {
        let (mission, auction, places) = (log.2.clone(), log.record(), BTreeMap::new());
        let cause = "no robot is left for lab_arm".to_owned();
        [
            Command::Award {
                mission: mission.clone(),
                branch,
                holders: [(role("lab_arm"), robot("other"))].into(),
                auction: auction.clone(),
            },
            Command::Defer { mission: mission.clone(), branch, auction },
            Command::Fail { mission, cause, branch: Some(branch), places, class: CauseClass::Robot },
        ]
    };
    let expect_rejected = |log: &mut Log, branch, executed| {
        let before = log.0.clone();
        for command in auction(log, branch) {
            let refused =
                CommandOutcome::Refused(CommandError::WrongBranch { mission: log.2.clone(), taken: executed });
            assert_eq!(log.apply(command.clone()), refused, "{command:?}");
            assert_eq!(log.0, before, "the ledger must be unchanged");
        }
    };
    log.hold(&[("r1", "amber"), ("lab_arm", "arm")]);
    log.ended("r1", epoch(2), 0..8);
    log.ended("clerk", Epoch::default(), 0..2);
    log.lose("lab_arm", epoch(2), false);
    assert_eq!(log.entry().open_roles(), [role("lab_arm")].into());
    expect_rejected(&mut log, Branch::Recovery, Branch::Main);

    log.lose("r1", epoch(2), false);
    assert_eq!((log.entry().branch, log.entry().open_roles()), (Branch::Recovery, [role("lab_arm")].into()));
    expect_rejected(&mut log, Branch::Main, Branch::Recovery);
    let [award, defer, fail] = auction(&log, Branch::Recovery);
    for command in [defer, award, fail] {
        let outcome = log.apply(command);
        assert!(!matches!(outcome, CommandOutcome::Refused(_)), "{outcome:?}");
    }
    assert_eq!(log.entry().state.as_str(), "needs_intervention");
}
