//! Bugs found by chaos, each reduced to a minimal schedule. Each schedule violated an invariant
//! once.

use consort_skills::workload::Workload;
use consort_tests::chaos::{RunConfig, Schedule, run};

/// Asserts that all invariants hold under this schedule.
fn holds(seed: u64, minutes: f64, schedule: &str) {
    holds_in(seed, minutes, false, schedule);
}

/// Asserts the same for a closed fleet.
fn holds_closed(seed: u64, minutes: f64, schedule: &str) {
    holds_in(seed, minutes, true, schedule);
}

fn holds_in(seed: u64, minutes: f64, closed: bool, schedule: &str) {
    let schedule: Schedule = serde_json::from_str(schedule).expect("a schedule");
    let outcome =
        run(&RunConfig { seed, nodes: 7, minutes, closed, mutant: None, workload: Workload::default() }, &schedule);
    if let Some(violation) = outcome.violation {
        let events = violation.events_before.join("\n");
        panic!("seed {seed}: {}: {}\n{events}\n{schedule}", violation.invariant, violation.reason);
    }
}

/// The nurse had put her sample into the drawer when all nodes crashed at once, before any ledger
/// contained the step. The role began again, and a second robot waited forever for a sample that
/// the nurse no longer had.
#[test]
fn a_sample_is_not_requested_again_after_a_blackout() {
    holds(
        23,
        3.0,
        r#"{"steps": [
            {"at_ms": 22590, "action": "submit", "request": "r0", "room": "IC Room 6"},
            {"at_ms": 121475, "action": "submit", "request": "r1", "room": "PC Room 1"},
            {"at_ms": 122460, "action": "slow_disk", "node": "clove", "write_ms": 126, "for_ms": 2803},
            {"at_ms": 122463, "action": "slow_disk", "node": "lab-arm", "write_ms": 135, "for_ms": 2800},
            {"at_ms": 123579, "action": "slow_disk", "node": "aster", "write_ms": 291, "for_ms": 1684},
            {"at_ms": 125163, "action": "blackout", "disk": "torn", "for_ms": 102}
        ]}"#,
    );
}

/// The arm had taken the sample and was about to send the signal, when the ledger already contained
/// all of its steps. Its role ended before its slow disk had written the checkpoint. The pending
/// signal was dropped, and the carrier waited for it forever.
#[test]
fn a_signal_from_a_slow_disk_arrives_after_the_role_has_ended() {
    holds(
        16,
        3.0,
        r#"{"steps": [
            {"at_ms": 43267, "action": "slow_disk", "node": "lab-arm", "write_ms": 170, "for_ms": 38103},
            {"at_ms": 58694, "action": "submit", "request": "r3", "room": "PC Room 5", "priority": 0}
        ]}"#,
    );
}

/// All nodes crashed right after a client received an acknowledgement. The coordinator came back in
/// its previous leader session and counted itself caught up before it had applied its own log. It
/// then replied to queries that there is no such mission.
#[test]
fn a_coordinator_in_its_old_session_has_all_acknowledged_missions() {
    holds(
        165,
        3.0,
        r#"{"steps": [
            {"at_ms": 40631, "action": "weather", "loss": 0.34, "duplication": 0.0, "reordering": 0.0, "delay_ms": 3, "for_ms": 2679},
            {"at_ms": 46398, "action": "slow_disk", "node": "aster", "write_ms": 125, "for_ms": 782},
            {"at_ms": 46756, "action": "submit", "request": "r3", "room": "PC Room 5"},
            {"at_ms": 47080, "action": "blackout", "disk": "torn", "for_ms": 7293},
            {"at_ms": 57009, "action": "slow_disk", "node": "aster", "write_ms": 131, "for_ms": 6050},
            {"at_ms": 58795, "action": "slow_disk", "node": "lab-arm", "write_ms": 126, "for_ms": 4264},
            {"at_ms": 62733, "action": "submit", "request": "r1", "room": "PC Room 1"},
            {"at_ms": 62959, "action": "blackout", "disk": "torn", "for_ms": 189}
        ]}"#,
    );
}

/// The robot reached its driver for a tenth of a second, in which a drive began again. It gave its
/// role back when it could no longer stop that drive. Another robot began while the first simulated
/// robot still moved.
#[test]
fn a_role_is_returned_only_once_the_robot_is_at_rest() {
    holds(
        5,
        5.0,
        r#"{"steps": [
            {"at_ms": 11175, "action": "submit", "request": "r2", "mission": "lab-samples-watched", "room": "IC Room 2", "priority": -10},
            {"at_ms": 17028, "action": "partition", "groups": [["clove", "aster", "lab-arm", "hazel", "garnet", "basil", "client"], ["indigo", "world"]], "for_ms": 28705},
            {"at_ms": 19174, "action": "submit", "request": "r1", "mission": "lab-samples-watched", "room": "PC Room 1", "priority": 10},
            {"at_ms": 50353, "action": "submit", "request": "r3", "unnamed": true, "mission": "lab-samples", "room": "PC Room 5", "priority": -10},
            {"at_ms": 53487, "action": "submit", "request": "r4", "unnamed": true, "mission": "lab-samples", "room": "IC Room 4", "priority": 10},
            {"at_ms": 55709, "action": "partition", "groups": [["aster", "basil", "clove", "garnet", "hazel", "lab-arm", "client"], ["indigo", "world"]], "for_ms": 18310},
            {"at_ms": 61402, "action": "submit", "request": "r5", "mission": "lab-samples-watched", "room": "PC Room 2", "priority": 10},
            {"at_ms": 92405, "action": "submit", "request": "r0", "mission": "lab-samples", "room": "IC Room 6", "priority": 10},
            {"at_ms": 98155, "action": "partition", "groups": [["indigo", "hazel", "basil"], ["world"], ["clove", "garnet", "lab-arm", "aster", "client"]], "for_ms": 34959},
            {"at_ms": 134599, "action": "partition", "groups": [["indigo", "clove", "garnet", "basil", "aster", "lab-arm", "client"], ["world", "hazel"]], "for_ms": 6094},
            {"at_ms": 140551, "action": "partition", "groups": [["aster", "lab-arm", "basil", "garnet", "indigo", "clove", "client"], ["hazel", "world"]], "for_ms": 2490},
            {"at_ms": 146595, "action": "partition", "groups": [["clove", "indigo", "garnet", "lab-arm", "basil", "aster", "client"], ["hazel", "world"]], "for_ms": 32012},
            {"at_ms": 171232, "action": "partition", "groups": [["world", "basil", "clove", "garnet"], ["aster", "hazel", "indigo", "lab-arm", "client"]], "for_ms": 108}
        ]}"#,
    );
}

/// The nurse continued after a signal in the ledger, at the instant at which all voters crashed.
/// The invariant read the ledgers of running voters only, and found no sender.
#[test]
fn a_signal_in_the_ledger_counts_as_sent_without_running_voters() {
    holds(
        41,
        5.0,
        r#"{"steps": [
            {"at_ms": 9077, "action": "slow_disk", "node": "aster", "write_ms": 88, "for_ms": 3175},
            {"at_ms": 10290, "action": "slow_disk", "node": "clove", "write_ms": 112, "for_ms": 1962},
            {"at_ms": 12068, "action": "submit", "request": "r0", "mission": "lab-samples-watched", "room": "IC Room 6", "priority": -10},
            {"at_ms": 12152, "action": "blackout", "disk": "torn", "for_ms": 10000},
            {"at_ms": 19030, "action": "submit", "request": "r4", "mission": "lab-samples-watched", "room": "IC Room 4", "priority": 0},
            {"at_ms": 53918, "action": "slow_disk", "node": "garnet", "write_ms": 207, "for_ms": 5666},
            {"at_ms": 56393, "action": "slow_disk", "node": "clove", "write_ms": 146, "for_ms": 3191},
            {"at_ms": 56913, "action": "slow_disk", "node": "lab-arm", "write_ms": 51, "for_ms": 2671},
            {"at_ms": 58740, "action": "slow_disk", "node": "basil", "write_ms": 45, "for_ms": 844},
            {"at_ms": 59206, "action": "submit", "request": "r3", "mission": "lab-samples", "room": "PC Room 5", "priority": -10},
            {"at_ms": 59484, "action": "blackout", "disk": "torn", "for_ms": 2353},
            {"at_ms": 85172, "action": "blackout", "disk": "torn", "for_ms": 6356},
            {"at_ms": 89196, "action": "slow_disk", "node": "garnet", "write_ms": 171, "for_ms": 2721},
            {"at_ms": 91817, "action": "blackout", "disk": "torn", "for_ms": 10000},
            {"at_ms": 97253, "action": "submit", "request": "r1", "mission": "lab-samples", "room": "PC Room 1", "priority": 0},
            {"at_ms": 100544, "action": "slow_disk", "node": "clove", "write_ms": 100, "for_ms": 4645},
            {"at_ms": 102386, "action": "cancel", "request": "r2"},
            {"at_ms": 103399, "action": "slow_disk", "node": "garnet", "write_ms": 261, "for_ms": 1790},
            {"at_ms": 104931, "action": "submit", "request": "r2", "mission": "lab-samples", "room": "IC Room 2", "priority": 10},
            {"at_ms": 105089, "action": "blackout", "disk": "torn", "for_ms": 142}
        ]}"#,
    );
}

/// The coordinator, a mobile robot, transferred its leadership to a station. The transfer was a task
/// of the leader session, which ended with the resignation, so the task was aborted while it waited
/// for a voter with the whole log. The node had resigned and went on as leader of openraft, and the
/// fleet had no coordinator any more.
#[test]
fn a_transfer_of_leadership_outlives_the_leader_session() {
    holds(
        71110,
        5.0,
        r#"{"steps": [
            {"at_ms": 61896, "action": "crash", "node": "aster", "disk": "torn", "for_ms": 404},
            {"at_ms": 92215, "action": "submit", "request": "r0", "room": "IC Room 6"}
        ]}"#,
    );
}

/// A leader without a quorum suspends its appends for most of the time only. Those that it sent announced its
/// last commit to a follower in its part of the partition, which then called its old copy recent.
#[test]
fn a_leader_without_a_quorum_announces_no_commit() {
    holds(
        1,
        3.0,
        r#"{"steps": [
            {"at_ms": 35367, "action": "partition", "groups": [["clove", "lab-arm", "basil", "hazel", "indigo", "world", "client"], ["aster", "garnet"]], "for_ms": 8000},
            {"at_ms": 43367, "action": "crash", "node": "basil", "disk": "damaged", "for_ms": 125},
            {"at_ms": 43367, "action": "partition", "groups": [["basil", "aster", "garnet", "hazel", "indigo", "world", "client"], ["clove", "lab-arm"]], "for_ms": 3750}
        ]}"#,
    );
}

/// Two missions waited for each other's robots without end. The ledger still contained the refusal that
/// the arm had sent while its driver did not reply, so the coordinator found no circular wait.
#[test]
fn missions_that_wait_for_each_other_end_after_a_robot_has_failed() {
    holds(
        2712,
        2.0,
        r#"{"steps": [
            {"at_ms": 30079, "action": "remove", "node": "garnet"},
            {"at_ms": 39079, "action": "submit", "request": "w0", "mission": "lab-samples", "room": "IC Room 3", "priority": 20},
            {"at_ms": 40579, "action": "crash", "node": "lab-arm", "disk": "kept", "for_ms": 8500},
            {"at_ms": 42079, "action": "submit", "request": "w1", "mission": "lab-samples", "room": "PC Room 7", "priority": 30},
            {"at_ms": 48552, "action": "partition", "groups": [["aster", "basil", "clove", "hazel", "indigo", "lab-arm", "client"], ["garnet", "world"]], "for_ms": 10567},
            {"at_ms": 54577, "action": "skill", "robot": "indigo", "how": "hangs", "times": 3}
        ]}"#,
    );
}

/// The bus of the driver server's node was blocked. The server waited for it, and did not notice that the
/// permission of a goal had run out, so the body moved on after the role had passed to another robot.
#[test]
fn a_body_stops_in_time_although_the_bus_of_its_driver_is_blocked() {
    holds(
        3021,
        2.0,
        r#"{"steps": [
            {"at_ms": 18376, "action": "submit", "request": "r1", "mission": "lab-samples", "room": "PC Room 1", "priority": 0},
            {"at_ms": 19978, "action": "block", "node": "world", "for_ms": 8078},
            {"at_ms": 22313, "action": "crash", "node": "carrier of r1", "disk": "kept", "for_ms": 5427}
        ]}"#,
    );
}

/// The only replica that had applied the end of a mission was killed before the robot halted. The check
/// asked the replicas that were left.
#[test]
fn a_role_that_ended_on_a_killed_replica_has_ended() {
    holds_closed(
        4363,
        2.0,
        r#"{"steps": [
            {"at_ms": 17698, "action": "partition", "groups": [["clove", "basil", "garnet", "hazel", "indigo", "world", "client"], ["aster", "lab-arm"]], "for_ms": 8000},
            {"at_ms": 25698, "action": "partition", "groups": [["garnet", "aster", "lab-arm", "hazel", "indigo", "world", "client"], ["clove", "basil"]], "for_ms": 15000},
            {"at_ms": 42620, "action": "remove", "node": "garnet"},
            {"at_ms": 54620, "action": "submit", "request": "w1", "mission": "lab-samples", "room": "PC Room 7", "priority": 30},
            {"at_ms": 64712, "action": "remove", "node": "carrier of w1"}
        ], "world_speed": 2}"#,
    );
}

/// The coordinator stepped down between the commit of a nurse's wait and its event. The check did not
/// know that the ledger executes the roles of people.
#[test]
fn a_wait_of_a_person_that_the_ledger_contains_has_ended() {
    holds_closed(
        4808,
        2.0,
        r#"{"steps": [
            {"at_ms": 5265, "action": "submit", "request": "r0", "mission": "lab-samples-watched", "room": "IC Room 6", "priority": 0},
            {"at_ms": 8275, "action": "crash", "node": "carrier of r0", "disk": "kept", "for_ms": 24219},
            {"at_ms": 13944, "action": "weather", "loss": 0.0, "duplication": 0.0, "reordering": 0.0, "delay_ms": 229, "for_ms": 23309}
        ]}"#,
    );
}

/// The leader stepped down while it replaced a voter, was elected again, and completed the change without an event
/// before it replaced another voter. The check took both for a single change.
#[test]
fn an_interrupted_change_of_voters_precedes_the_next() {
    holds_closed(
        1234,
        2.0,
        r#"{"steps": [
            {"at_ms": 5179, "action": "partition", "groups": [["clove", "indigo", "aster", "lab-arm", "basil", "hazel", "client"], ["garnet", "world"]], "for_ms": 5769},
            {"at_ms": 9253, "action": "submit", "request": "r0", "mission": "lab-samples-watched", "room": "IC Room 6", "priority": 0},
            {"at_ms": 9736, "action": "partition", "groups": [["aster", "basil", "clove", "garnet", "hazel", "indigo", "lab-arm", "client"], ["carrier of r0", "world"]], "for_ms": 1297},
            {"at_ms": 10629, "action": "crash", "node": "carrier of r0", "disk": "kept", "for_ms": 19366},
            {"at_ms": 14646, "action": "slow_disk", "node": "garnet", "write_ms": 148, "for_ms": 3336},
            {"at_ms": 17882, "action": "crash", "node": "garnet", "disk": "torn", "for_ms": 162},
            {"at_ms": 36468, "action": "slow_disk", "node": "lab-arm", "write_ms": 144, "for_ms": 125},
            {"at_ms": 37551, "action": "hostile", "role": "voter", "for_ms": 11771},
            {"at_ms": 40377, "action": "crash", "node": "lab-arm", "disk": "torn", "for_ms": 12816},
            {"at_ms": 45348, "action": "weather", "loss": 0.23, "duplication": 0.0, "reordering": 0.0, "delay_ms": 3, "for_ms": 11611},
            {"at_ms": 51367, "action": "crash", "node": "clove", "disk": "damaged", "for_ms": 614},
            {"at_ms": 52216, "action": "submit", "request": "r1", "mission": "lab-samples", "room": "PC Room 1", "priority": 0}
        ]}"#,
    );
}

/// The only arm had failed in two missions, each of which held a carrier. The carriers refused the arm's role of the
/// other mission as busy, although they lacked the skill, so no round counted as hopeless, and both missions waited
/// without end.
#[test]
fn a_busy_robot_without_the_skill_refuses_for_good() {
    holds_closed(
        2607,
        2.0,
        r#"{"steps": [
            {"at_ms": 5933, "action": "skill", "robot": "lab-arm", "how": "fails", "times": 3},
            {"at_ms": 8386, "action": "skill", "robot": "lab-arm", "how": "panics", "times": 1},
            {"at_ms": 29640, "action": "submit", "request": "r0", "mission": "lab-samples", "room": "IC Room 6", "priority": -10},
            {"at_ms": 34760, "action": "submit", "request": "r2", "mission": "lab-samples", "room": "IC Room 2", "priority": 0}
        ]}"#,
    );
}
