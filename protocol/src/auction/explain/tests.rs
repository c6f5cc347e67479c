use super::*;
use crate::auction::{AuctionId, ChargingStop, PlannedRole, RoleOfMission, RoleSpan, ViabilityError};
use crate::units::{BatteryShare, Energy};

fn slug<T: std::str::FromStr<Err: std::fmt::Debug>>(text: &str) -> T {
    text.parse().unwrap()
}

fn bid(role: &str, robot: &str, seconds: f64) -> AuctionEntry {
    let verdict = BidVerdict::Viable { time: Seconds::new(seconds).unwrap(), energy: 0.06, remaining: 0.84 };
    AuctionEntry { role: slug(role), robot: slug(robot), verdict, parts: vec![] }
}

/// A bid with these steps: a drive of `seconds`, which uses 0.001 of the charge per second, a
/// wait, and 60 s with the clerk.
fn drives(robot: &str, seconds: f64) -> AuctionEntry {
    let part = |step, label: &str, skill, seconds| BidPart {
        step,
        label: label.to_owned(),
        skill: slug(skill),
        time: Seconds::new(seconds).unwrap(),
        energy: seconds / 1000.0,
    };
    let parts = vec![
        part(0, "navto_room", "navigation", seconds),
        part(1, "done:greet:r2:r1", "wait_message", 0.0),
        part(2, "done:deposit:clerk:r1", "wait_message", 2.0),
        part(3, "ready:deposit:r1:clerk", "send_message", 2.0),
        part(4, "authenticate_clerk", "authenticate_person", 60.0),
    ];
    AuctionEntry { parts, ..bid("r1", robot, seconds + 64.0) }
}

fn refusal(role: &str, robot: &str, reason: RefusalReason) -> AuctionEntry {
    AuctionEntry { role: slug(role), robot: slug(robot), verdict: BidVerdict::Refused { reason }, parts: vec![] }
}

fn record(entries: Vec<AuctionEntry>, chosen: &[(&str, &str)], failure: Option<&str>) -> AuctionRecord {
    AuctionRecord {
        auction: AuctionId { mission: slug("vital-signs-1"), term: 2, round: 3 },
        at_ms: 7,
        entries,
        omitted: 0,
        chosen: chosen.iter().map(|(role, robot)| (slug(role), slug(robot))).collect(),
        promised: BTreeMap::new(),
        failure: failure.map(str::to_owned),
        planned: BTreeMap::new(),
    }
}

fn words(explanation: &Explanation) -> Vec<String> {
    let of = |role: &RoleExplanation| {
        let robots = role.robots.iter().map(|robot| format!("  {}", robot.why)).collect::<Vec<_>>();
        std::iter::once(format!("{}: {}", role.role, role.why)).chain(robots).collect::<Vec<_>>()
    };
    explanation.roles.iter().flat_map(of).collect()
}

#[test]
fn the_fastest_wins_and_every_other_robot_has_a_reason() {
    let unviable = BidVerdict::Unviable {
        time: Seconds::new(90.0).unwrap(),
        energy: 0.107,
        remaining: 0.023,
        why: ViabilityError::LowCharge { remaining: 0.023, floor: BatteryShare::new(0.08).unwrap() },
    };
    let entries = vec![
        refusal("r1", "amber", RefusalReason::NotMember { why: "logistics: too far".to_owned() }),
        bid("r1", "birch", 99.7),
        bid("r1", "cedar", 176.9),
        refusal("r1", "dune", RefusalReason::MissingSkills { skills: vec![slug("navigation")] }),
        AuctionEntry { role: slug("r1"), robot: slug("ember"), verdict: unviable, parts: vec![] },
        bid("r1", "flint", 160.3),
        refusal("r1", "gorse", RefusalReason::Busy { mission: slug("m-2"), role: slug("r1") }),
        refusal("r1", "hazel", RefusalReason::Silent { window_ms: 200 }),
    ];
    let explained = explain(&record(entries, &[("r1", "birch")], None));
    assert_eq!(
        words(&explained),
        [
            "r1: birch gets the role with 99.7 s, 6.0 % of its charge, 84.0 % left: the fastest of 3 bids, 60.6 s before \
             flint",
            "  birch bid 99.7 s, 6.0 % of its charge, 84.0 % left, and gets the role",
            "  flint bid 160.3 s, 6.0 % of its charge, 84.0 % left: outbid, 60.6 s more than birch",
            "  cedar bid 176.9 s, 6.0 % of its charge, 84.0 % left: outbid, 77.2 s more than birch",
            "  dune lacks navigation",
            "  gorse is busy as r1 of m-2",
            "  amber is not a member of logistics: too far",
            "  hazel was invited and did not reply within 200 ms",
            "  ember bid 90.0 s, 10.7 % of its charge, 2.3 % left: outside the limits, 2.3 % charge left is not above \
             8.0 %",
        ]
    );
    let outcomes: Vec<RobotOutcome> = explained.roles[0].robots.iter().map(|robot| robot.outcome).collect();
    use RobotOutcome::{NotMember, Outbid, Refused, Silent, Won};
    assert_eq!(outcomes, [Won, Outbid, Outbid, Refused, Refused, NotMember, Silent, RobotOutcome::Unviable]);
}

#[test]
fn a_record_that_omits_replies_states_the_least_number_of_bids() {
    let entries = vec![bid("r1", "birch", 99.7), bid("r1", "flint", 160.3)];
    let record = AuctionRecord { omitted: 4, ..record(entries, &[("r1", "birch")], None) };
    let words = words(&explain(&record));
    assert!(words[0].ends_with("the fastest of at least 2 bids, 60.6 s before flint"), "{words:?}");
}

#[test]
fn a_promise_is_explained_with_its_position() {
    let mut record = record(vec![bid("r1", "birch", 60.0)], &[("r1", "birch")], None);
    let seconds = |value: f64| Seconds::new(value).unwrap();
    record.promised.insert(slug("r1"), seconds(20.0));
    let role = |record: &AuctionRecord| words(&explain(record)).remove(0);
    let bid = "60.0 s, 6.0 % of its charge, 84.0 % left: there is no other viable bid";
    assert_eq!(role(&record), format!("r1: birch gets the role in about 20 s with {bid}"));

    let span = RoleSpan { from: None, to: None, time: seconds(40.0), energy: Energy::ZERO };
    let next = RoleOfMission { mission: slug("vital-signs-7"), role: slug("r2") };
    let delay = seconds(12.0);
    let planned = PlannedRole { before: Some(next), delay, ..PlannedRole::alone(span, seconds(20.0)) };
    record.planned.insert(slug("r1"), planned);
    let position = "(before r2 of vital-signs-7, which it delays by 12 s)";
    assert_eq!(role(&record), format!("r1: birch gets the role in about 20 s {position} with {bid}"));

    let share = |value: f64| BatteryShare::new(value).unwrap();
    let stop = ChargingStop { charger: slug("dock"), time: seconds(15.0), until: share(0.42), remaining: share(0.2) };
    let span = RoleSpan { from: None, to: None, time: seconds(40.0), energy: Energy::ZERO };
    let planned = PlannedRole { charging: Some(stop), ..PlannedRole::alone(span, seconds(20.0)) };
    record.planned.insert(slug("r1"), planned);
    let stop = ", after charging at dock until it has 42.0 %";
    assert_eq!(role(&record), format!("r1: birch gets the role in about 20 s{stop} with {bid}"));
}

#[test]
fn an_explanation_lists_steps_and_the_largest_difference() {
    let entries = vec![drives("birch", 37.04), drives("flint", 92.1), bid("r1", "cedar", 103.0)];
    let explained = explain(&record(entries, &[("r1", "birch")], None));
    let [birch, cedar, flint] = &explained.roles[0].robots[..] else { panic!("three robots") };
    let steps = "navto_room 37.0 s 3.7 %, wait for clerk 2.0 s 0.2 %, signal to clerk 2.0 s 0.2 %, authenticate_clerk \
                 60.0 s 6.0 %";
    assert_eq!(birch.parts_text().as_deref(), Some(steps));
    assert!(cedar.why.ends_with(": outbid, 2.0 s more than birch"), "{}", cedar.why);
    assert_eq!(cedar.parts_text(), None);
    let most = ": outbid, 55.1 s more than birch, mostly in navto_room (55.1 s more)";
    assert!(flint.why.ends_with(most), "{}", flint.why);
    let seen = serde_json::to_value(birch).unwrap();
    assert_eq!(seen["parts"][0]["skill"], "navigation", "{seen}");
    let seen = serde_json::to_value(explained.without_parts()).unwrap();
    assert_eq!(seen["roles"][0]["robots"][0].get("parts"), None, "{seen}");
}

#[test]
fn a_faster_robot_with_another_role_is_named() {
    let entries = vec![bid("a", "ada", 10.0), bid("a", "bob", 12.0), bid("b", "ada", 11.0), bid("b", "bob", 30.0)];
    let explained = explain(&record(entries, &[("a", "bob"), ("b", "ada")], None));
    assert_eq!(
        words(&explained),
        [
            "a: bob gets the role with 12.0 s, 6.0 % of its charge, 84.0 % left: ada would be faster, but gets b, which \
             minimises the total time of all roles",
            "  bob bid 12.0 s, 6.0 % of its charge, 84.0 % left, and gets the role",
            "  ada bid 10.0 s, 6.0 % of its charge, 84.0 % left; it gets b of this mission instead",
            "b: ada gets the role with 11.0 s, 6.0 % of its charge, 84.0 % left: the fastest of 2 bids, 19.0 s before bob",
            "  ada bid 11.0 s, 6.0 % of its charge, 84.0 % left, and gets the role",
            "  bob bid 30.0 s, 6.0 % of its charge, 84.0 % left; it gets a of this mission instead",
        ]
    );
}

#[test]
fn an_auction_without_assignment_states_the_missing_bid() {
    let entries = vec![
        bid("a", "ada", 10.0),
        refusal("b", "ada", RefusalReason::OutOfService { problem: "no charge".to_owned() }),
    ];
    let explained = explain(&record(entries, &[], Some("no viable bid for b")));
    assert_eq!(
        words(&explained),
        [
            "a: a is not assigned: no viable bid for b; 1 bid is within the limits, but a mission is filled completely or not at all",
            "  ada bid 10.0 s, 6.0 % of its charge, 84.0 % left, but the role is not assigned",
            "b: b is not assigned: no viable bid for b; 1 robot was considered",
            "  ada is out of service: no charge",
        ]
    );
}

#[test]
fn robots_that_were_not_asked_have_the_reason_of_their_group() {
    let not_asked = |robot: &str, reason, cost_min, others: &[&str]| {
        let others = others.iter().copied().map(slug).collect();
        let verdict = BidVerdict::NotAsked { reason, cost_min, others };
        AuctionEntry { role: slug("r1"), robot: slug(robot), verdict, parts: vec![] }
    };
    let skills = vec![slug("navigation")];
    let entries = vec![
        bid("r1", "ada", 40.0),
        not_asked("cyd", NotAskedReason::NotNeeded, 41.0, &["dan"]),
        not_asked("bob", NotAskedReason::MissingSkills { skills }, 0.0, &[]),
    ];
    let explanation = explain(&record(entries, &[("r1", "ada")], None));
    let unneeded =
        "was not asked: by its record its bid could not have changed the result, since it would cost at least 41.0 s";
    assert_eq!(
        words(&explanation),
        [
            "r1: ada gets the role with 40.0 s, 6.0 % of its charge, 84.0 % left: no other robot that was asked has a \
             viable bid"
                .to_owned(),
            "  ada bid 40.0 s, 6.0 % of its charge, 84.0 % left, and gets the role".to_owned(),
            "  bob was not asked: by its record it lacks navigation".to_owned(),
            format!("  cyd {unneeded}"),
            format!("  dan {unneeded}"),
        ]
    );
    let outcomes = explanation.roles[0].robots.iter().map(|robot| robot.outcome).collect::<Vec<_>>();
    assert_eq!(outcomes[1..], [RobotOutcome::NotAsked; 3]);
}
