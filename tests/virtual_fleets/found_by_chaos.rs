//! What chaos found, each as the few steps that it takes. Every one of these did not hold once.

use consort_tests::chaos::{RunConfig, Schedule, run};

/// Everything holds under this schedule.
fn holds(seed: u64, minutes: f64, schedule: &str) {
    let schedule: Schedule = serde_json::from_str(schedule).expect("a schedule");
    let outcome = run(&RunConfig { seed, nodes: 7, minutes, closed: false }, &schedule);
    if let Some(violation) = outcome.violation {
        let tale = violation.tale.join("\n");
        panic!("seed {seed}: {}: {}\n{tale}\n{schedule}", violation.invariant, violation.why);
    }
}

/// The nurse had put her sample into the drawer when all nodes went down at once, before any ledger had heard of it. The role
/// was begun anew, and a second robot waited for ever for a sample that the nurse no longer had.
#[test]
fn a_sample_handed_over_just_before_a_blackout_is_not_asked_for_again() {
    holds(
        23,
        3.0,
        r#"{"steps": [
            {"at_ms": 22590, "act": "submit", "request": "r0", "room": "IC Room 6"},
            {"at_ms": 121475, "act": "submit", "request": "r1", "room": "PC Room 1"},
            {"at_ms": 122460, "act": "slow_disk", "node": "clove", "write_ms": 126, "for_ms": 2803},
            {"at_ms": 122463, "act": "slow_disk", "node": "lab-arm", "write_ms": 135, "for_ms": 2800},
            {"at_ms": 123579, "act": "slow_disk", "node": "aster", "write_ms": 291, "for_ms": 1684},
            {"at_ms": 125163, "act": "blackout", "disk": "torn", "for_ms": 102}
        ]}"#,
    );
}

/// The arm had taken the sample and was about to say so, when the ledger already held all its steps: its role was over before
/// its slow disk had the page, what it was about to say was forgotten, and the carrier waited for it for ever.
#[test]
fn what_is_said_on_a_slow_disk_is_heard_although_the_role_is_over() {
    holds(
        16,
        3.0,
        r#"{"steps": [
            {"at_ms": 43267, "act": "slow_disk", "node": "lab-arm", "write_ms": 170, "for_ms": 38103},
            {"at_ms": 58694, "act": "submit", "request": "r3", "room": "PC Room 5", "priority": 0}
        ]}"#,
    );
}

/// All nodes went down right after a client had been acknowledged. The coordinator came back in its old reign, and counted
/// itself caught up before it had taken in what its own log held: who asked it then was told of no such mission.
#[test]
fn a_coordinator_that_comes_back_in_its_old_reign_knows_what_it_has_acknowledged() {
    holds(
        165,
        3.0,
        r#"{"steps": [
            {"at_ms": 40631, "act": "weather", "loss": 0.34, "duplication": 0.0, "reordering": 0.0, "delay_ms": 3, "for_ms": 2679},
            {"at_ms": 46398, "act": "slow_disk", "node": "aster", "write_ms": 125, "for_ms": 782},
            {"at_ms": 46756, "act": "submit", "request": "r3", "room": "PC Room 5"},
            {"at_ms": 47080, "act": "blackout", "disk": "torn", "for_ms": 7293},
            {"at_ms": 57009, "act": "slow_disk", "node": "aster", "write_ms": 131, "for_ms": 6050},
            {"at_ms": 58795, "act": "slow_disk", "node": "lab-arm", "write_ms": 126, "for_ms": 4264},
            {"at_ms": 62733, "act": "submit", "request": "r1", "room": "PC Room 1"},
            {"at_ms": 62959, "act": "blackout", "disk": "torn", "for_ms": 189}
        ]}"#,
    );
}

/// The robot reached its body for a tenth of a second, in which a drive began again, and gave its role back when it could no
/// longer stop it. Another robot began while the body of the first was still on its way.
#[test]
fn a_role_is_given_back_once_the_body_is_at_rest_or_can_be_taken_to_be() {
    holds(
        5,
        5.0,
        r#"{"steps": [
            {"at_ms": 11175, "act": "submit", "request": "r2", "mission": "lab-samples-watched", "room": "IC Room 2", "priority": -10},
            {"at_ms": 17028, "act": "partition", "groups": [["clove", "aster", "lab-arm", "hazel", "garnet", "basil", "client"], ["indigo", "world"]], "for_ms": 28705},
            {"at_ms": 19174, "act": "submit", "request": "r1", "mission": "lab-samples-watched", "room": "PC Room 1", "priority": 10},
            {"at_ms": 50353, "act": "submit", "request": "r3", "unnamed": true, "mission": "lab-samples", "room": "PC Room 5", "priority": -10},
            {"at_ms": 53487, "act": "submit", "request": "r4", "unnamed": true, "mission": "lab-samples", "room": "IC Room 4", "priority": 10},
            {"at_ms": 55709, "act": "partition", "groups": [["aster", "basil", "clove", "garnet", "hazel", "lab-arm", "client"], ["indigo", "world"]], "for_ms": 18310},
            {"at_ms": 61402, "act": "submit", "request": "r5", "mission": "lab-samples-watched", "room": "PC Room 2", "priority": 10},
            {"at_ms": 92405, "act": "submit", "request": "r0", "mission": "lab-samples", "room": "IC Room 6", "priority": 10},
            {"at_ms": 98155, "act": "partition", "groups": [["indigo", "hazel", "basil"], ["world"], ["clove", "garnet", "lab-arm", "aster", "client"]], "for_ms": 34959},
            {"at_ms": 134599, "act": "partition", "groups": [["indigo", "clove", "garnet", "basil", "aster", "lab-arm", "client"], ["world", "hazel"]], "for_ms": 6094},
            {"at_ms": 140551, "act": "partition", "groups": [["aster", "lab-arm", "basil", "garnet", "indigo", "clove", "client"], ["hazel", "world"]], "for_ms": 2490},
            {"at_ms": 146595, "act": "partition", "groups": [["clove", "indigo", "garnet", "lab-arm", "basil", "aster", "client"], ["hazel", "world"]], "for_ms": 32012},
            {"at_ms": 171232, "act": "partition", "groups": [["world", "basil", "clove", "garnet"], ["aster", "hazel", "indigo", "lab-arm", "client"]], "for_ms": 108}
        ]}"#,
    );
}

/// The nurse went on after what the ledger had been told, in the instant in which all who kept it went down: the check asked
/// them, and found that nobody had said it.
#[test]
fn what_the_ledger_was_told_was_said_though_nobody_who_keeps_it_is_left() {
    holds(
        41,
        5.0,
        r#"{"steps": [
            {"at_ms": 9077, "act": "slow_disk", "node": "aster", "write_ms": 88, "for_ms": 3175},
            {"at_ms": 10290, "act": "slow_disk", "node": "clove", "write_ms": 112, "for_ms": 1962},
            {"at_ms": 12068, "act": "submit", "request": "r0", "mission": "lab-samples-watched", "room": "IC Room 6", "priority": -10},
            {"at_ms": 12152, "act": "blackout", "disk": "torn", "for_ms": 10000},
            {"at_ms": 19030, "act": "submit", "request": "r4", "mission": "lab-samples-watched", "room": "IC Room 4", "priority": 0},
            {"at_ms": 53918, "act": "slow_disk", "node": "garnet", "write_ms": 207, "for_ms": 5666},
            {"at_ms": 56393, "act": "slow_disk", "node": "clove", "write_ms": 146, "for_ms": 3191},
            {"at_ms": 56913, "act": "slow_disk", "node": "lab-arm", "write_ms": 51, "for_ms": 2671},
            {"at_ms": 58740, "act": "slow_disk", "node": "basil", "write_ms": 45, "for_ms": 844},
            {"at_ms": 59206, "act": "submit", "request": "r3", "mission": "lab-samples", "room": "PC Room 5", "priority": -10},
            {"at_ms": 59484, "act": "blackout", "disk": "torn", "for_ms": 2353},
            {"at_ms": 85172, "act": "blackout", "disk": "torn", "for_ms": 6356},
            {"at_ms": 89196, "act": "slow_disk", "node": "garnet", "write_ms": 171, "for_ms": 2721},
            {"at_ms": 91817, "act": "blackout", "disk": "torn", "for_ms": 10000},
            {"at_ms": 97253, "act": "submit", "request": "r1", "mission": "lab-samples", "room": "PC Room 1", "priority": 0},
            {"at_ms": 100544, "act": "slow_disk", "node": "clove", "write_ms": 100, "for_ms": 4645},
            {"at_ms": 102386, "act": "cancel", "request": "r2"},
            {"at_ms": 103399, "act": "slow_disk", "node": "garnet", "write_ms": 261, "for_ms": 1790},
            {"at_ms": 104931, "act": "submit", "request": "r2", "mission": "lab-samples", "room": "IC Room 2", "priority": 10},
            {"at_ms": 105089, "act": "blackout", "disk": "torn", "for_ms": 142}
        ]}"#,
    );
}
