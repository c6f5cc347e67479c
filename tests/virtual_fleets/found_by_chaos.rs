//! What chaos found, each as the few steps that it takes. Every one of these did not hold once.

use consort_tests::chaos::{Order, Schedule, run};

/// Everything holds under this schedule.
fn holds(seed: u64, minutes: f64, schedule: &str) {
    let schedule: Schedule = serde_json::from_str(schedule).expect("a schedule");
    let outcome = run(&Order { seed, nodes: 7, minutes }, &schedule);
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
