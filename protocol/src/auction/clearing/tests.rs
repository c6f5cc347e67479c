use super::*;
use crate::auction::{AuctionId, BidRefusal, Objective, Timelines};
use crate::codec;
use crate::ids::{EnsembleId, MissionId, PlaceId};
use crate::ledger::{Branch, Command};
use crate::plan::LocalPlan;
use crate::units::{BatteryShare, EnergyLimit};

fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

fn invited(names: &[&str]) -> Invitation {
    Invitation { robots: names.iter().map(|name| robot(name)).collect(), preferred: vec![] }
}

fn role() -> RoleId {
    RoleId::new("r1").unwrap()
}

fn call() -> CallForBids {
    CallForBids {
        auction: AuctionId { mission: MissionId::new("m-1").unwrap(), term: 3, round: 1 },
        ensembles: vec![],
        roles: BTreeMap::from([(role(), LocalPlan::of(role(), vec![]))]),
        eligible: BTreeMap::new(),
        spread: BTreeSet::new(),
        timelines: Timelines::default(),
    }
}

static NO_EXCLUDED: BTreeMap<RoleId, BTreeMap<RobotId, String>> = BTreeMap::new();

fn context<'a>(
    invitation: &'a Invitation,
    taken: &'a BTreeMap<RobotId, RefusalReason>,
    excluded: &'a BTreeMap<RoleId, BTreeMap<RobotId, String>>,
) -> AuctionContext<'a> {
    static LIMITS: std::sync::LazyLock<BidLimits> = std::sync::LazyLock::new(BidLimits::default);
    AuctionContext {
        invitation,
        unavailable: taken,
        excluded,
        limits: &LIMITS,
        energy: None,
        promises: None,
        window_ms: 200,
        at_ms: 0,
    }
}

fn bids(name: &str, time: f64, remaining: f64) -> BidResponse {
    bids_with_energy(name, time, remaining, 0.1)
}

fn bids_with_energy(name: &str, time: f64, remaining: f64, energy: f64) -> BidResponse {
    let bid = Bid {
        robot: robot(name),
        role: role(),
        time: Seconds::new(time).unwrap(),
        energy,
        remaining,
        useful_charge: BatteryShare::new(0.08).unwrap(),
        from: PlaceId::new("dock").unwrap(),
        age_ms: 0,
        parts: vec![],
        present: None,
        planned: None,
    };
    BidResponse { robot: robot(name), auction: call().auction, replies: vec![RoleReply::Bid(bid)] }
}

#[test]
fn the_record_contains_every_robot_with_its_reason() {
    let expected = invited(&["ada", "bob", "cyd", "dan", "eve", "fay"]);
    let taken_by = RefusalReason::Busy { mission: MissionId::new("m-0").unwrap(), role: role() };
    let taken = BTreeMap::from([(robot("bob"), taken_by)]);
    let context = context(&expected, &taken, &NO_EXCLUDED);
    let busy = RefusalReason::Busy { mission: MissionId::new("m-7").unwrap(), role: role() };
    let refusal = BidRefusal { robot: robot("dan"), role: role(), reason: busy.clone() };
    let refuses =
        BidResponse { robot: robot("dan"), auction: call().auction, replies: vec![RoleReply::Refusal(refusal)] };
    let responses =
        [bids("ada", 9.0, 0.5), bids("bob", 1.0, 0.5), bids("cyd", 2.0, 0.06), refuses, bids("eve", 8.0, 0.5)];
    let outcome = clear_auction(&call(), &responses, &context);

    assert_eq!(outcome.holders, Some(BTreeMap::from([(role(), robot("eve"))])));
    let texts: Vec<String> = outcome
        .record
        .entries
        .iter()
        .map(|entry| match &entry.verdict {
            BidVerdict::Viable { time, .. } => format!("{}: {time:.0}", entry.robot),
            BidVerdict::Unviable { why, .. } => format!("{}: {why}", entry.robot),
            BidVerdict::Refused { reason } => format!("{}: {reason}", entry.robot),
            BidVerdict::NotAsked { reason, .. } => format!("{}: {reason}", entry.robot),
        })
        .collect();
    assert_eq!(
        texts,
        [
            "ada: 9 s",
            "bob: busy as r1 of m-0",
            "cyd: 6.0 % charge left is not above 8.0 %",
            "dan: busy as r1 of m-7",
            "eve: 8 s",
            "fay: no reply within 200 ms",
        ]
    );
}

#[test]
fn the_objective_decides_between_time_and_energy() {
    let invitation = invited(&["ada", "bob"]);
    let responses = [bids_with_energy("ada", 9.0, 0.5, 0.2), bids_with_energy("bob", 12.0, 0.5, 0.1)];
    let winner = |objective| {
        let call = CallForBids { timelines: Timelines { objective, ..Timelines::default() }, ..call() };
        let outcome = clear_auction(&call, &responses, &context(&invitation, &BTreeMap::new(), &NO_EXCLUDED));
        outcome.holders.unwrap()[&role()].to_string()
    };
    let weighted = |battery_s| Objective::Weighted { battery_s: Seconds::new(battery_s).unwrap() };
    assert_eq!([Objective::EarliestEnd, Objective::LeastEnergy].map(winner), ["ada", "bob"]);
    assert_eq!([weighted(20.0), weighted(40.0)].map(winner), ["ada", "bob"], "0.1 of a battery or 3 s");
}

#[test]
fn a_record_with_long_refusals_fits_an_award() {
    let names: Vec<String> = (0..200).map(|number| format!("robot-{number}")).collect();
    let refusal = |(number, name): (usize, &String)| {
        let problem = "no route; ".repeat(if number == 0 { 6000 } else { 30 });
        let reason = RefusalReason::OutOfService { problem };
        let refusal = RoleReply::Refusal(BidRefusal { robot: robot(name), role: role(), reason });
        BidResponse { robot: robot(name), auction: call().auction, replies: vec![refusal] }
    };
    let mut responses: Vec<BidResponse> = names.iter().enumerate().map(refusal).collect();
    responses.push(bids("zoe", 9.0, 0.5));
    let nobody = Invitation::default();
    let outcome = clear_auction(&call(), &responses, &context(&nobody, &BTreeMap::new(), &NO_EXCLUDED));
    let AuctionOutcome { holders: Some(holders), record: auction, .. } = outcome else { panic!("no holder") };
    assert_eq!((auction.entries.len() + auction.omitted as usize, auction.entries[0].robot.as_str()), (201, "zoe"));
    assert!(auction.entries.len() > 80, "{} replies are recorded", auction.entries.len());
    let mission = call().auction.mission;
    let award = Command::Award { mission, branch: Branch::Main, holders, auction: auction.clone() };
    assert!(codec::encode(&award).unwrap().len() < codec::MESSAGE_BYTES_MAX * 3 / 4);
    let mut again = auction.clone();
    again.limit();
    assert_eq!(again, auction, "replicas shorten it no further");
}

/// Assigns each role to the last candidate.
#[derive(Debug)]
struct Last;

impl Allocator for Last {
    fn allocate(&self, input: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError> {
        let bidders: Vec<&str> = input.bids.iter().map(|bid| bid.robot.as_str()).collect();
        assert_eq!((bidders, input.viable.len()), (vec!["cyd", "eve"], 1));
        let last = |robots: &BTreeSet<RobotId>| robots.last().cloned().ok_or(AssignmentError::NoRobotLeft);
        input.candidates.iter().map(|(role, robots)| Ok((role.clone(), last(robots)?))).collect()
    }
}

#[test]
fn another_allocator_may_use_robots_that_lack_skills_or_charge() {
    let expected = invited(&["bob", "cyd", "dan", "eve", "fay", "gil"]);
    let busy = RefusalReason::Busy { mission: MissionId::new("m-0").unwrap(), role: role() };
    let taken = BTreeMap::from([(robot("fay"), busy)]);
    let excluded = BTreeMap::from([(role(), BTreeMap::from([(robot("gil"), "lost its way".to_owned())]))]);
    let reason = RefusalReason::MissingSkills { skills: vec![] };
    let refusal = RoleReply::Refusal(BidRefusal { robot: robot("dan"), role: role(), reason });
    let lacks = BidResponse { robot: robot("dan"), auction: call().auction, replies: vec![refusal] };
    let responses =
        [bids("eve", 9.0, 0.5), bids("cyd", 2.0, 0.01), lacks, bids("fay", 1.0, 0.5), bids("gil", 1.0, 0.5)];
    let context = context(&expected, &taken, &excluded);
    let by_last = clear_auction_with(&call(), &responses, &context, &Last);
    assert_eq!(by_last.holders, Some(BTreeMap::from([(role(), robot("eve"))])));
    let alone = clear_auction_with(&call(), &responses[1..3], &context, &AnyLast);
    assert_eq!(alone.holders, Some(BTreeMap::from([(role(), robot("dan"))])));
}

#[derive(Debug)]
struct AnyLast;

impl Allocator for AnyLast {
    fn allocate(&self, input: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError> {
        Ok(input.candidates.iter().filter_map(|(role, robots)| Some((role.clone(), robots.last()?.clone()))).collect())
    }
}

#[test]
fn a_role_is_unfillable_when_one_robot_failed_and_the_others_refuse() {
    let (expected, taken) = (invited(&["ada", "bob"]), BTreeMap::new());
    let excluded = BTreeMap::from([(role(), BTreeMap::from([(robot("ada"), "lost its way".to_owned())]))]);
    let context = context(&expected, &taken, &excluded);
    let outcome = clear_auction(&call(), &[bids("ada", 1.0, 0.5), bids("bob", 9.0, 0.5)], &context);
    assert_eq!(outcome.holders, Some(BTreeMap::from([(role(), robot("bob"))])));
    let texts = |verdict: &BidVerdict| match verdict {
        BidVerdict::Refused { reason } => reason.to_string(),
        other => format!("{other:?}"),
    };
    assert_eq!(texts(&outcome.record.entries[0].verdict), "failed at it before: lost its way");
    assert!(outcome.unfillable.is_empty());

    let silent = clear_auction(&call(), &[bids("ada", 1.0, 0.5)], &context);
    assert_eq!((silent.holders, silent.unfillable), (None, BTreeSet::new()), "bob may still reply");
    let lacks = RefusalReason::MissingSkills { skills: vec![] };
    let refusal = BidRefusal { robot: robot("bob"), role: role(), reason: lacks };
    let refuses =
        BidResponse { robot: robot("bob"), auction: call().auction, replies: vec![RoleReply::Refusal(refusal)] };
    let outcome = clear_auction(&call(), &[bids("ada", 1.0, 0.5), refuses], &context);
    assert_eq!((outcome.holders, outcome.unfillable), (None, [role()].into()));
}

fn budget(limit: f64, used: f64) -> Option<EnergyBudget> {
    let (limit, used) = (EnergyLimit::new(limit).unwrap(), Energy::new(used).unwrap());
    Some(EnergyBudget { limit, used })
}

#[test]
fn the_fastest_robot_within_the_bound_on_energy_gets_the_role() {
    let expected = invited(&["ada", "bob"]);
    let (unavailable, responses) =
        (BTreeMap::new(), [bids_with_energy("ada", 5.0, 0.4, 0.5), bids_with_energy("bob", 9.0, 0.4, 0.25)]);
    for (energy, winner) in [
        (None, Some("ada")),
        (budget(0.5, 0.0), Some("ada")),
        (budget(0.5, 0.125), Some("bob")),
        (budget(0.375, 0.125), Some("bob")),
        (budget(0.25, 0.125), None),
    ] {
        let context = AuctionContext { energy, ..context(&expected, &unavailable, &NO_EXCLUDED) };
        let outcome = clear_auction(&call(), &responses, &context);
        assert_eq!(outcome.holders, winner.map(|winner| BTreeMap::from([(role(), robot(winner))])), "{energy:?}");
        assert_eq!(outcome.energy_exceeded.is_some(), winner.is_none(), "{energy:?}");
        assert_eq!(outcome.record.failure, outcome.energy_exceeded.map(|excess| excess.to_string()));
    }
}

#[test]
fn a_bound_on_energy_is_hopeless_only_without_other_robots() {
    let (busy, only) = (invited(&["ada", "bob"]), invited(&["ada"]));
    let unavailable = BTreeMap::new();
    let ada = || bids_with_energy("ada", 5.0, 0.4, 0.5);
    let excess = |invitation, responses: &[BidResponse]| {
        let energy = budget(0.3, 0.05);
        let context = AuctionContext { energy, ..context(invitation, &unavailable, &NO_EXCLUDED) };
        let outcome = clear_auction(&call(), responses, &context);
        assert_eq!(outcome.holders, None);
        (outcome.energy_exceeded.is_some(), outcome.record.failure.unwrap())
    };
    let problem = "the mission would exceed its bound on energy, energy_max 0.300: the open roles need at least 0.500 of a \
         full battery (ada as r1), and earlier awards were estimated at 0.050";
    assert_eq!(excess(&only, &[ada()]), (true, problem.to_owned()));
    assert_eq!(excess(&busy, &[ada()]), (false, problem.to_owned()), "bob may still reply");
    let charging = bids_with_energy("bob", 9.0, 0.01, 0.1);
    assert_eq!(excess(&busy, &[ada(), charging]), (false, problem.to_owned()), "bob may be charged");
    let lacks = RefusalReason::MissingSkills { skills: vec![] };
    let refusal = RoleReply::Refusal(BidRefusal { robot: robot("bob"), role: role(), reason: lacks });
    let refuses = BidResponse { robot: robot("bob"), auction: call().auction, replies: vec![refusal] };
    assert_eq!(excess(&busy, &[ada(), refuses]), (true, problem.to_owned()));
    // Without any robot, the bound is not the reason.
    assert_eq!(excess(&Invitation::default(), &[]), (false, "no viable bid for r1".to_owned()));
}

/// A call for the iterations `r1` and `r2` of a spread loop.
fn spread_call() -> CallForBids {
    let roles = [role(), RoleId::new("r2").unwrap()];
    let plans = roles.iter().map(|role| (role.clone(), LocalPlan::of(role.clone(), vec![]))).collect();
    CallForBids { roles: plans, spread: roles.into(), ..call() }
}

/// Bids of a robot for both iterations.
fn bids_for_both(name: &str, energy: f64) -> BidResponse {
    let of_role = |role: &str| match bids_with_energy(name, 9.0, 0.5, energy).replies.remove(0) {
        RoleReply::Bid(bid) => RoleReply::Bid(Bid { role: role.parse().unwrap(), ..bid }),
        refusal => refusal,
    };
    BidResponse { robot: robot(name), auction: call().auction, replies: vec![of_role("r1"), of_role("r2")] }
}

#[test]
fn roles_of_a_spread_loop_stay_open_without_robots_or_energy_for_them() {
    let expected = invited(&["ada", "bob"]);
    let unavailable = BTreeMap::new();
    let cleared = |responses: &[BidResponse], energy| {
        let context = AuctionContext { energy, ..context(&expected, &unavailable, &NO_EXCLUDED) };
        clear_auction(&spread_call(), responses, &context)
    };
    let filled = |outcome: &AuctionOutcome| outcome.holders.as_ref().map_or(0, BTreeMap::len);
    let (ada, bob) = (bids_for_both("ada", 0.1), bids_for_both("bob", 0.1));
    assert_eq!(filled(&cleared(&[ada.clone(), bob.clone()], None)), 2);
    assert_eq!(filled(&cleared(std::slice::from_ref(&ada), None)), 1);
    assert_eq!(filled(&cleared(&[], None)), 0);
    assert_eq!(filled(&cleared(&[ada.clone(), bob.clone()], budget(0.2, 0.0))), 2);
    assert_eq!(filled(&cleared(&[ada.clone(), bob.clone()], budget(0.15, 0.0))), 1);
    let exceeded = cleared(&[ada, bob], budget(0.15, 0.1));
    assert_eq!((filled(&exceeded), exceeded.energy_exceeded.is_some()), (0, true));
}

#[test]
fn a_robot_of_the_same_mission_may_get_the_next_iteration_of_a_spread_loop() {
    let expected = invited(&["ada", "bob"]);
    let unavailable = BTreeMap::new();
    let failed = BTreeMap::from([(role(), BTreeMap::from([(robot("ada"), "stuck".to_owned())]))]);
    let reason = RefusalReason::Busy { mission: call().auction.mission, role: RoleId::new("r2").unwrap() };
    let refusal = BidRefusal { robot: robot("bob"), role: role(), reason };
    let refuses =
        BidResponse { robot: robot("bob"), auction: call().auction, replies: vec![RoleReply::Refusal(refusal)] };
    let context = context(&expected, &unavailable, &failed);
    let one = CallForBids { spread: [role()].into(), ..call() };
    let responses = [bids("ada", 9.0, 0.5), refuses];
    assert_eq!(clear_auction(&one, &responses, &context).unfillable, BTreeSet::new());
    assert_eq!(clear_auction(&call(), &responses, &context).unfillable, [role()].into());
}

#[test]
fn the_chosen_bid_stays_in_a_record_of_many_bids() {
    let names: Vec<String> = (100..500).map(|number| format!("robot-{number}")).collect();
    let mut responses: Vec<BidResponse> = names.iter().map(|name| bids(name, 9.0, 0.5)).collect();
    responses.push(bids_with_energy("zoe", 1.0, 0.5, 0.25));
    let outcome = clear_auction(&call(), &responses, &context(&Invitation::default(), &BTreeMap::new(), &NO_EXCLUDED));
    assert!(outcome.record.omitted > 0);
    assert_eq!(outcome.record.estimate_of(&role(), &robot("zoe")).energy, Energy::new(0.25).unwrap());
}

#[test]
fn the_parts_of_the_winner_and_closest_bids_are_kept_within_the_limit() {
    let part = |step: u32| BidPart {
        step,
        label: "x".repeat(40),
        skill: crate::ids::TaskType::new("navigation").unwrap(),
        time: Seconds::new(1.0).unwrap(),
        energy: 0.001,
    };
    let responses: Vec<BidResponse> = (0..20)
        .map(|number| {
            // The last bidder is the fastest within the limits; the first bidder would run out
            // of charge.
            let remaining = if number == 0 { 0.01 } else { 0.5 };
            let mut response = bids(&format!("robot-{number:02}"), 100.0 - f64::from(number), remaining);
            let RoleReply::Bid(bid) = &mut response.replies[0] else { panic!("the reply is a bid") };
            bid.parts = (0..12).map(part).collect();
            response
        })
        .collect();
    let robots = responses.iter().map(|response| response.robot.clone()).collect();
    let expected = Invitation { robots, ..Invitation::default() };
    let taken = BTreeMap::new();
    let record = clear_auction(&call(), &responses, &context(&expected, &taken, &NO_EXCLUDED)).record;
    let kept: Vec<&str> =
        record.entries.iter().filter(|entry| !entry.parts.is_empty()).map(|entry| entry.robot.as_str()).collect();
    // 12 parts of 74 bytes: nine bids fit into 8 KiB.
    let closest: Vec<String> = (11..20).map(|number| format!("robot-{number}")).collect();
    assert_eq!(kept, closest);
    assert!(
        record.entries.iter().all(|entry| [0, 12].contains(&entry.parts.len())),
        "the parts of a bid are kept completely or not at all"
    );
}

#[test]
fn a_reply_to_another_call_or_for_another_robot_does_not_count() {
    let expected = Invitation::default();
    let taken = BTreeMap::new();
    let context = context(&expected, &taken, &NO_EXCLUDED);
    let mut old = bids("ada", 1.0, 0.5);
    old.auction.round = 9;
    let mut forged = bids("bob", 1.0, 0.5);
    forged.robot = robot("mal");
    let outcome = clear_auction(&call(), &[old, forged], &context);
    assert_eq!(outcome.holders, None);
    assert_eq!(outcome.record.failure.as_deref(), Some("no viable bid for r1"));
}

#[test]
fn members_of_the_ensembles_named_first_come_first() {
    let group = |ensemble: &str, names: &[&str]| {
        (EnsembleId::new(ensemble).unwrap(), names.iter().map(|name| robot(name)).collect::<BTreeSet<_>>())
    };
    let preferred = vec![group("icu", &["ada", "bob"]), group("floor", &["cyd"])];
    let invitation = Invitation { preferred, ..invited(&["ada", "bob", "cyd", "dan"]) };
    let holder = |times: &[(&str, f64, f64)]| {
        let taken = BTreeMap::new();
        let context = context(&invitation, &taken, &NO_EXCLUDED);
        let responses: Vec<_> = times.iter().map(|(name, time, charge)| bids(name, *time, *charge)).collect();
        let outcome = clear_auction(&call(), &responses, &context);
        let refusals = outcome.record.entries.iter().filter_map(|entry| match &entry.verdict {
            BidVerdict::Refused { reason: reason @ RefusalReason::NotPreferred { .. } } => {
                Some(format!("{}: {reason}", entry.robot))
            }
            _ => None,
        });
        (outcome.holders.map(|holders| holders[&role()].to_string()), refusals.collect::<Vec<_>>())
    };
    let dan = ("dan", 1.0, 0.5);
    let (chosen, refusals) = holder(&[("ada", 9.0, 0.5), ("bob", 8.0, 0.5), ("cyd", 2.0, 0.5), dan]);
    assert_eq!(chosen.as_deref(), Some("bob"));
    assert_eq!(refusals, ["cyd: members of icu come first", "dan: members of icu come first"]);
    // No member of the first ensemble has enough charge.
    let (chosen, refusals) = holder(&[("ada", 9.0, 0.01), ("cyd", 2.0, 0.5), dan]);
    assert_eq!(chosen.as_deref(), Some("cyd"));
    assert_eq!(refusals, ["dan: members of floor come first"]);
    let (chosen, refusals) = holder(&[("ada", 9.0, 0.01), dan]);
    assert_eq!((chosen.as_deref(), refusals), (Some("dan"), vec![]));
    assert_eq!(holder(&[]), (None, vec![]));
}
