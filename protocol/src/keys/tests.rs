use super::*;
use crate::ids::{FleetId, MissionId, NodeId, RobotId, RoleId};
use crate::trust::Fingerprint;

pub(super) fn all() -> Vec<Key> {
    let node = NodeId::new("lab-1").unwrap();
    let robot = RobotId::new("ada").unwrap();
    let mission = MissionId::new("vital-signs-3").unwrap();
    let role = RoleId::new("r1").unwrap();
    let mut keys = vec![
        Key::Certificate(Fingerprint([0xc0; 16])),
        Key::KnownCertificate(Fingerprint([0xc0; 16])),
        Key::Knowledge(node.clone()),
        Key::Motion(node.clone()),
        Key::Gossip(node.clone()),
        Key::Swim(node.clone()),
        Key::Bootstrap(node.clone()),
        Key::Beacon,
        Key::Bid(robot.clone()),
        Key::Award(robot.clone()),
        Key::Report(node.clone()),
        Key::Clock(node.clone()),
        Key::Leader(node.clone()),
        Key::Signal(mission.clone(), role.clone()),
        Key::SignalHistory(mission.clone(), role),
        Key::ViewFleet,
        Key::ViewRobot(robot.clone()),
        Key::ViewCoordinator,
        Key::ViewMissions,
        Key::ViewRequests,
        Key::ViewSchedules,
        Key::ViewAudit,
        Key::ViewMission(mission.clone()),
        Key::ViewAuctions,
        Key::ViewEnsembles,
        Key::ViewEnsemble("icu".parse().unwrap()),
        Key::Ensemble("icu".parse().unwrap(), robot.clone()),
        Key::ViewMap,
        Key::ViewHealth,
        Key::ViewWorld,
        Key::World,
        Key::Seen(node.clone(), Box::new(Key::ViewMission(mission))),
        Key::Seen(node.clone(), Box::new(Key::ViewHealth)),
        Key::Leave(node.clone()),
        Key::AliveRobot(robot.clone()),
        Key::AliveNode(node.clone()),
        Key::AliveCoordinator(7, node.clone()),
        Key::Events(node),
    ];
    keys.extend(RaftCall::ALL.iter().map(|call| Key::Raft(0x00ab_cdef, *call)));
    keys.extend(DriverCall::ALL.iter().map(|call| Key::Driver(robot.clone(), *call)));
    keys.extend(PeopleCall::ALL.iter().map(|call| Key::People(*call)));
    keys.extend(ApiCall::ALL.iter().flat_map(|call| [Key::Api(*call), Key::Help(*call)]));
    keys
}

#[test]
fn every_key_parses_to_the_value_that_was_formatted() {
    let keys = Keys::new(&FleetId::new("ward").unwrap());
    for key in all() {
        let text = keys.write(&key);
        assert!(text.starts_with("consort/ward/"), "{text}");
        assert_eq!(keys.read(&text).as_ref(), Some(&key), "{text}");
    }
}

#[test]
fn every_key_except_tokens_has_a_category() {
    let keys = Keys::new(&FleetId::new("ward").unwrap());
    let mut counted = std::collections::BTreeSet::new();
    for key in all() {
        let kind = KeyKind::of(&keys.write(&key));
        let token = matches!(key, Key::AliveRobot(_) | Key::AliveNode(_) | Key::AliveCoordinator(..));
        assert_eq!(kind == KeyKind::Other, token, "{key}");
        counted.insert(kind);
    }
    assert_eq!(counted.len(), KeyKind::ALL.len());
    assert_eq!(KeyKind::of(&keys.any_bid()), KeyKind::Bid);
    assert_eq!(KeyKind::of(&keys.any_driver_command()), KeyKind::DriverCommand);
    assert_eq!(KeyKind::of(&keys.any_driver_state()), KeyKind::DriverState);
    assert_eq!(KeyKind::of("consort"), KeyKind::Other);
}

#[test]
fn all_keys_are_formatted_differently() {
    let keys = Keys::new(&FleetId::new("ward").unwrap());
    let texts: std::collections::BTreeSet<String> = all().iter().map(|key| keys.write(key)).collect();
    assert_eq!(texts.len(), all().len());
}

#[test]
fn keys_about_missions_are_cluster_scoped() {
    let keys = Keys::new(&FleetId::new("ward").unwrap());
    let leader = keys.write(&Key::Leader(NodeId::new("lab-1").unwrap()));
    let of_ensemble = keys.any_of_ensemble(&"icu".parse().unwrap());
    for text in [keys.any_bid(), keys.any_signal(), of_ensemble, keys.write(&Key::Beacon), leader] {
        assert!(keys.is_cluster_scoped(&text), "{text}");
    }
    let warden = "consort/warden/wire/beacon".to_owned();
    for text in
        [keys.any_knowledge(), keys.any_motion(), keys.any_raft(7), keys.any_bootstrap(), keys.any_view(), warden]
    {
        assert!(!keys.is_cluster_scoped(&text), "{text}");
    }
}

#[test]
fn keys_outside_the_fleet_are_not_parsed() {
    let keys = Keys::new(&FleetId::new("ward").unwrap());
    for text in [
        "consort/warden/wire/beacon",
        "consort/ward",
        "consort/ward/",
        "consort/ward/wire/bid",
        "consort/ward/wire/bid/a*",
        "consort/ward/wire/raft/12/vote",
        "consort/ward/api/reboot",
        "consort/ward/api/reboot/help",
        "consort/ward/view/tea",
        "consort/ward/seen/lab-1",
        "consort/ward/seen/lab-1/seen/lab-1/fleet",
    ] {
        assert_eq!(keys.read(text), None, "{text}");
    }
}
