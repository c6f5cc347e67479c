use super::*;
use consort_protocol::auction::{AuctionEntry, AuctionId, AuctionRecord};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Branch, Command, CommandOutcome, Submission};
use consort_protocol::mission::{Format, MissionTemplate};
use consort_protocol::plan::divide_and_check;
use consort_skills::domain::hospital;

fn node(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn healthy() -> HealthInputs {
    let voters = ["a", "b", "c"].map(|name| (node(name), true)).to_vec();
    let coordinator = Some((node("a"), 3));
    HealthInputs {
        coordinator,
        coordinator_age_ms: Some(0),
        voters,
        alive: 7,
        knows_missions: true,
        ..HealthInputs::default()
    }
}

fn texts(inputs: &HealthInputs) -> Vec<(HealthLevel, String)> {
    health(inputs).findings.into_iter().map(|finding| (finding.level, finding.text)).collect()
}

#[test]
fn a_healthy_fleet_has_a_single_positive_finding() {
    let text = "a coordinates in term 3; 3 of 3 voters reachable; 7 nodes are alive".to_owned();
    assert_eq!(texts(&healthy()), [(HealthLevel::Ok, text)]);
}

#[test]
fn lost_voters_are_a_warning_until_the_quorum_is_lost() {
    let mut inputs = healthy();
    inputs.voters[1].1 = false;
    let text = "2 of 3 voters reachable, without b; 0 more may be lost".to_owned();
    assert_eq!(texts(&inputs), [(HealthLevel::Warning, text)]);
    inputs.voters[2].1 = false;
    inputs.coordinator = None;
    inputs.coordinator_age_ms = Some(2500);
    assert_eq!(
        texts(&inputs),
        [
            (HealthLevel::Error, "no coordinator; the last beacon is 2.5 s old".to_owned()),
            (HealthLevel::Error, "no quorum: 1 of 3 voters reachable; lost are b, c".to_owned()),
        ]
    );
}

#[test]
fn nodes_with_differing_files_of_a_domain_are_named() {
    let domain = |name: &str| DomainId::new(name).unwrap();
    let nodes = |names: &[&str]| names.iter().map(|name| node(name)).collect::<BTreeSet<NodeId>>();
    let plants = DomainContents::from([
        (DomainHash(0x2a), nodes(&["birch"])),
        (DomainHash(0x1f00), nodes(&["a", "b", "c", "d", "e", "f", "g", "h", "i"])),
    ]);
    let equal = DomainContents::from([(DomainHash(7), nodes(&["a", "birch"]))]);
    let domains = BTreeMap::from([(domain("cleaning"), equal), (domain("plants"), plants)]);
    let text = "the files of the domain plants differ: 0000000000001f00 at a, b, c, d, e, f, g, h and 1 other; \
                000000000000002a at birch. Robots refuse tasks that were made with another content. Give all nodes the \
                same file, whose content `consort check FILE` prints, and restart them";
    let inputs = HealthInputs { domains, ..healthy() };
    assert_eq!(texts(&inputs), [(HealthLevel::Warning, text.to_owned())]);
    let finding = &health(&inputs).findings[0];
    assert_eq!((finding.about.as_str(), finding.name.as_deref()), ("domain", Some("plants")));
}

#[test]
fn missions_that_keep_others_waiting_are_named() {
    let set = |names: &[&str]| names.iter().map(|name| MissionId::new(*name).unwrap()).collect();
    let robots = BTreeSet::from([RobotId::new("lab-arm").unwrap(), RobotId::new("amber").unwrap()]);
    let request = PersonRequestId { mission: MissionId::new("m-1").unwrap(), number: 2 };
    let requests = vec![(request, RoleId::new("clerk").unwrap())];
    let one = Blocking { robots: robots.clone(), waiting: set(&["m-2"]), requests };
    let many = Blocking { robots, waiting: set(&["m-2", "m-4", "m-5"]), requests: vec![] };
    let blocking = [("m-1", one), ("m-3", many)].map(|(id, blocking)| (MissionId::new(id).unwrap(), blocking));
    let inputs = HealthInputs { blocking: blocking.into(), ..healthy() };
    let expected = [
        "m-1 holds amber, lab-arm, for which m-2 waits; it waits for the answer of clerk to m-1.2",
        "m-3 holds amber, lab-arm, for which 3 missions wait",
    ];
    assert_eq!(texts(&inputs), expected.map(|text| (HealthLevel::Warning, text.to_owned())));
}

#[test]
fn a_busy_robot_counts_for_the_mission_that_holds_it_now() {
    const MISSION: &str = r#"{"mission": "rest", "roles": {"r1": {"kind": "managed"}},
        "root": {"task": "wait", "type": "wait", "roles": ["r1"], "parameters": {"seconds": "5"}}}"#;
    let (mut ledger, mut index) = (Ledger::default(), 0);
    let mut apply = |ledger: &mut Ledger, command| {
        index += 1;
        let outcome = ledger.apply(Epoch { term: 1, index }, command);
        assert!(!matches!(outcome, CommandOutcome::Refused(_)), "{outcome:?}");
    };
    for request in ["a", "b", "c"] {
        let mission = MissionTemplate::parse(MISSION, Format::Json).unwrap();
        let mission = mission.instantiate(&BTreeMap::new(), &hospital()).unwrap();
        let division = divide_and_check(&mission).unwrap();
        let submission = Submission::of(request.parse().unwrap(), mission, division);
        apply(&mut ledger, Command::Submit(Box::new(submission)));
    }
    let [first, second, waiting] = ["rest-1", "rest-2", "rest-3"].map(|id| MissionId::new(id).unwrap());
    let (role, amber): (RoleId, RobotId) = ("r1".parse().unwrap(), "amber".parse().unwrap());
    let record = |mission: &MissionId| AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
    let award = |mission: &MissionId| {
        let (mission, auction, holders) = (mission.clone(), record(mission), [(role.clone(), amber.clone())].into());
        Command::Award { mission, branch: Branch::Main, holders, auction }
    };
    let cancel = |mission: &MissionId| {
        let (mission, by, places) = (mission.clone(), "Nia".to_owned(), BTreeMap::new());
        Command::Cancel { mission, by, places, at_ms: 1 }
    };
    let blocking = |ledger: &Ledger| {
        let of_mission = |(mission, found): (MissionId, Blocking)| (mission, found.robots, found.waiting);
        Blocking::of(ledger).into_iter().map(of_mission).collect::<Vec<_>>()
    };
    let blocked_by = |mission: &MissionId| {
        vec![(mission.clone(), BTreeSet::from([amber.clone()]), BTreeSet::from([waiting.clone()]))]
    };
    apply(&mut ledger, award(&first));
    let reason = RefusalReason::Busy { mission: first.clone(), role: role.clone() };
    let (robot, verdict, parts) = (amber.clone(), BidVerdict::Refused { reason }, vec![]);
    let entries = vec![AuctionEntry { role: role.clone(), robot, verdict, parts }];
    let failure = Some("no viable bid for r1".to_owned());
    let auction = AuctionRecord { entries, failure, ..record(&waiting) };
    apply(&mut ledger, Command::Defer { mission: waiting.clone(), branch: Branch::Main, auction });
    assert_eq!(blocking(&ledger), blocked_by(&first));
    apply(&mut ledger, cancel(&first));
    assert!(blocking(&ledger).is_empty());
    apply(&mut ledger, award(&second));
    assert_eq!(blocking(&ledger), blocked_by(&second));
}

#[test]
fn the_most_severe_finding_comes_first() {
    let mut inputs = healthy();
    inputs.unreachable = vec![(node("d"), "down", 9000)];
    inputs.alarms = vec![("fire".parse().unwrap(), "under alarm fire by Nia: smoke".to_owned())];
    inputs.out_of_service = vec![(node("e"), "its battery is empty".to_owned())];
    inputs.held = vec![("g".parse().unwrap(), "held by Nia: a spill".to_owned())];
    inputs.suspended = vec![(node("f"), "r1 of m-1".to_owned())];
    inputs.pending = vec![("m-2".to_owned(), "no viable bid for r1".to_owned())];
    inputs.needs_intervention = vec![("m-3".to_owned(), "g was lost with the parcel".to_owned())];
    inputs.foreign = vec![(ClusterId(0xff), node("z"))];
    let health = health(&inputs);
    let levels: Vec<(HealthLevel, &str)> =
        health.findings.iter().map(|finding| (finding.level, finding.about.as_str())).collect();
    use HealthLevel::{Error, Warning};
    let expected = [
        (Error, "cluster"),
        (Error, "alarm"),
        (Error, "mission"),
        (Warning, "node"),
        (Warning, "robot"),
        (Warning, "robot"),
        (Warning, "robot"),
        (Warning, "mission"),
    ];
    assert_eq!(levels, expected);
    let text: Vec<String> = texts(&inputs).into_iter().map(|(_, text)| text).skip(1).take(6).collect();
    assert_eq!(
        text,
        [
            "the fleet is under alarm fire by Nia: smoke",
            "m-3 needs intervention: g was lost with the parcel",
            "d is down; last contact 9.0 s ago",
            "e is out of service: its battery is empty",
            "g is held by Nia: a spill",
            "f is suspended as r1 of m-1: its lease was not renewed",
        ]
    );
}
