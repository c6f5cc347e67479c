use super::*;
use proptest::prelude::*;

const DEAD: Duration = Duration::from_secs(10);
const LONG: Duration = Duration::from_secs(3600);

fn member(number: u64) -> Member {
    let node = NodeId::new(format!("n{number}")).unwrap();
    Member { node, health: MemberHealth::Healthy { since: LONG }, preferred: true, leaving: false, lag: Some(0) }
}

fn silent(number: u64, seconds: u64) -> Member {
    Member { health: MemberHealth::Unresponsive { since: Duration::from_secs(seconds) }, ..member(number) }
}

fn mobile(number: u64) -> Member {
    Member { preferred: false, ..member(number) }
}

fn leaving(number: u64) -> Member {
    Member { leaving: true, ..member(number) }
}

fn numbered(members: Vec<(u64, Member)>) -> BTreeMap<RaftId, Member> {
    members.into_iter().map(|(number, member)| (RaftId(number), member)).collect()
}

fn fleet(voters: Vec<(u64, Member)>, learners: Vec<(u64, Member)>, candidates: Vec<(u64, Member)>) -> AutopilotInput {
    AutopilotInput {
        me: RaftId(1),
        target_voters: 5,
        dead_after: DEAD,
        settle_time: DEAD,
        unchanged_for: LONG,
        since_transfer: None,
        voters: numbered(voters),
        pending_voters: None,
        learners: numbered(learners),
        candidates: numbered(candidates),
    }
}

fn healthy(numbers: impl IntoIterator<Item = u64>) -> Vec<(u64, Member)> {
    numbers.into_iter().map(|number| (number, member(number))).collect()
}

/// Formats the action without its reason.
fn summary(action: Option<AutopilotAction>) -> String {
    let list = |voters: &BTreeSet<RaftId>| voters.iter().map(|id| id.0.to_string()).collect::<Vec<_>>().join(" ");
    match action {
        None => "nothing".to_owned(),
        Some(AutopilotAction::AddLearner { id, .. }) => format!("add learner {}", id.0),
        Some(AutopilotAction::SetVoters { voters, .. }) => format!("voters {}", list(&voters)),
        Some(AutopilotAction::RemoveLearner { id, .. }) => format!("remove learner {}", id.0),
        Some(AutopilotAction::TransferLeadership { to, .. }) => {
            format!("transfer to {}", to.iter().map(NodeId::as_str).collect::<Vec<_>>().join(" "))
        }
    }
}

fn with(mut voters: Vec<(u64, Member)>, number: u64, replacement: Member) -> Vec<(u64, Member)> {
    voters.retain(|(known, _)| *known != number);
    voters.push((number, replacement));
    voters
}

#[test]
fn a_dead_voter_is_replaced_by_a_learner() {
    let voters = with(healthy(1..=5), 3, silent(3, 11));
    assert_eq!(summary(decide(&fleet(voters.clone(), vec![], healthy([6, 7])))), "add learner 6");
    let behind = Member { lag: Some(1000), ..member(6) };
    assert_eq!(summary(decide(&fleet(voters.clone(), vec![(6, behind)], healthy([7])))), "nothing");
    assert_eq!(summary(decide(&fleet(voters.clone(), healthy([6]), healthy([7])))), "voters 1 2 4 5 6");
    let action = decide(&fleet(voters, healthy([6]), vec![])).unwrap();
    assert_eq!(action.reason(), "n3 silent for 11.0 s: n6 replaces it");
}

#[test]
fn a_voter_that_is_silent_for_a_moment_is_not_replaced() {
    let voters = with(healthy(1..=5), 3, silent(3, 9));
    assert_eq!(summary(decide(&fleet(voters, vec![], healthy([6])))), "nothing");
}

#[test]
fn a_member_with_a_lost_store_is_replaced_at_once() {
    let lost = Member { health: MemberHealth::Replaced, ..member(3) };
    let input = fleet(
        with(healthy(1..=3), 3, lost),
        vec![],
        vec![(9, Member { node: NodeId::new("n3").unwrap(), ..member(9) })],
    );
    assert_eq!(summary(decide(&input)), "add learner 9");
}

#[test]
fn without_a_replacement_dead_voters_are_removed() {
    let voters = with(healthy(1..=5), 3, silent(3, 11));
    assert_eq!(summary(decide(&fleet(voters, vec![], vec![]))), "voters 1 2 4 5");
    let three = with(with(with(healthy(1..=5), 3, silent(3, 11)), 4, silent(4, 11)), 5, silent(5, 11));
    assert_eq!(summary(decide(&fleet(three, healthy([6]), healthy([7])))), "nothing");
}

#[test]
fn a_removal_that_loses_the_quorum_is_not_made() {
    // Three of five reply. Without the leaving voter, two of four would.
    let voters = with(with(with(healthy(1..=5), 3, silent(3, 2)), 4, silent(4, 2)), 5, leaving(5));
    assert_eq!(summary(decide(&fleet(voters, vec![], vec![]))), "nothing");
}

#[test]
fn dead_voters_are_replaced_separately() {
    let voters = with(with(healthy(1..=5), 3, silent(3, 11)), 4, silent(4, 12));
    assert_eq!(summary(decide(&fleet(voters, healthy([6, 7]), vec![]))), "voters 1 2 4 5 6");
}

#[test]
fn a_leaving_voter_is_replaced_or_removed() {
    let voters = with(healthy(1..=3), 2, leaving(2));
    assert_eq!(summary(decide(&fleet(voters.clone(), healthy([4]), vec![]))), "voters 1 3 4");
    assert_eq!(summary(decide(&fleet(voters, vec![], vec![]))), "voters 1 3");
}

#[test]
fn the_only_voter_that_leaves_gets_a_transfer_target() {
    assert_eq!(summary(decide(&fleet(vec![(1, leaving(1))], vec![], healthy([2])))), "add learner 2");
    assert_eq!(summary(decide(&fleet(vec![(1, leaving(1))], healthy([2]), vec![]))), "voters 1 2");
    assert_eq!(summary(decide(&fleet(vec![(1, leaving(1))], vec![], vec![]))), "nothing");
}

#[test]
fn voters_grow_to_an_odd_number() {
    assert_eq!(summary(decide(&fleet(healthy([1]), vec![], healthy([2])))), "nothing");
    assert_eq!(summary(decide(&fleet(healthy([1]), vec![], healthy([2, 3])))), "add learner 2");
    assert_eq!(summary(decide(&fleet(healthy([1]), healthy([2]), healthy([3])))), "add learner 3");
    assert_eq!(summary(decide(&fleet(healthy([1]), healthy([2, 3]), vec![]))), "voters 1 2 3");
    assert_eq!(summary(decide(&fleet(healthy(1..=4), healthy([5]), vec![]))), "voters 1 2 3 4 5");
    assert_eq!(summary(decide(&fleet(healthy(1..=5), vec![], healthy([6, 7])))), "nothing");
}

#[test]
fn voters_above_the_target_are_removed_separately() {
    let input = AutopilotInput { target_voters: 3, ..fleet(with(healthy(1..=5), 2, mobile(2)), vec![], vec![]) };
    assert_eq!(summary(decide(&input)), "voters 1 3 4 5");
}

#[test]
fn a_stationary_node_replaces_a_mobile_voter_after_settling() {
    let voters = with(healthy(1..=3), 2, mobile(2));
    let input = AutopilotInput { target_voters: 3, ..fleet(voters, vec![], healthy([4])) };
    assert_eq!(summary(decide(&input)), "add learner 4");
    let input = AutopilotInput { candidates: BTreeMap::new(), learners: numbered(healthy([4])), ..input };
    assert_eq!(summary(decide(&input)), "voters 1 3 4");
    assert_eq!(summary(decide(&AutopilotInput { unchanged_for: Duration::ZERO, ..input.clone() })), "nothing");
    let fresh = Member { health: MemberHealth::Healthy { since: Duration::from_secs(1) }, ..member(4) };
    assert_eq!(summary(decide(&AutopilotInput { learners: numbered(vec![(4, fresh)]), ..input })), "nothing");
}

#[test]
fn learners_without_a_purpose_are_removed() {
    assert_eq!(summary(decide(&fleet(healthy(1..=5), healthy([6]), vec![]))), "remove learner 6");
    assert_eq!(summary(decide(&fleet(healthy(1..=3), vec![(6, silent(6, 11))], vec![]))), "remove learner 6");
}

#[test]
fn a_change_begun_by_a_dead_leader_is_completed() {
    let mut input = fleet(healthy(1..=6), vec![], healthy([7]));
    input.pending_voters = Some([1, 2, 4, 5, 6].map(RaftId).into());
    assert_eq!(summary(decide(&input)), "voters 1 2 4 5 6");
}

fn any_member(number: u64) -> impl Strategy<Value = Member> {
    let health = prop_oneof![
        4 => (0u64..30).prop_map(|s| MemberHealth::Healthy { since: Duration::from_secs(s) }),
        1 => (0u64..30).prop_map(|s| MemberHealth::Unresponsive { since: Duration::from_secs(s) }),
        1 => Just(MemberHealth::Replaced),
    ];
    let lag = prop_oneof![4 => Just(Some(0)), 1 => Just(None), 1 => Just(Some(500u64))];
    (health, any::<bool>(), prop::bool::weighted(0.1), lag).prop_map(move |(health, fixed, leaving, lag)| Member {
        health,
        preferred: fixed,
        leaving,
        lag,
        ..member(number)
    })
}

fn any_input() -> impl Strategy<Value = AutopilotInput> {
    let places = prop::collection::vec(0u8..3, 1..12);
    places.prop_flat_map(|places| {
        let members: Vec<_> = (1u64..).take(places.len()).map(any_member).collect();
        (Just(places), members, 1usize..6, any::<bool>()).prop_map(|(places, members, half, quiet)| {
            let mut input = fleet(vec![], vec![], vec![]);
            input.target_voters = half * 2 - 1;
            input.unchanged_for = if quiet { LONG } else { Duration::ZERO };
            for (number, (place, mut member)) in (1u64..).zip(places.into_iter().zip(members)) {
                let id = RaftId(number);
                match place {
                    _ if number == 1 => {
                        member.health = MemberHealth::Healthy { since: LONG };
                        input.voters.insert(id, member);
                    }
                    0 => drop(input.voters.insert(id, member)),
                    1 => drop(input.learners.insert(id, member)),
                    _ => drop(input.candidates.insert(id, member)),
                }
            }
            input
        })
    })
}

/// Returns the fleet after the action.
fn after(input: &AutopilotInput, action: &AutopilotAction) -> AutopilotInput {
    let mut next = input.clone();
    match action {
        AutopilotAction::AddLearner { id, .. } => {
            let member = next.candidates.remove(id).expect("the id of a candidate");
            next.learners.insert(*id, member);
        }
        AutopilotAction::SetVoters { voters, .. } => {
            let (mut all, former) = (next.voters.clone(), next.voters.len());
            all.append(&mut next.learners);
            for (id, member) in all {
                if voters.contains(&id) {
                    next.voters.insert(id, member);
                } else if next.voters.remove(&id).is_some() {
                    next.candidates.insert(id, member);
                } else {
                    next.learners.insert(id, member);
                }
            }
            assert!(former > 0);
        }
        AutopilotAction::RemoveLearner { id, .. } => {
            let member = next.learners.remove(id).expect("the id of a learner");
            next.candidates.insert(*id, member);
        }
        AutopilotAction::TransferLeadership { to, .. } => {
            let successor = next.voters.iter().find(|(_, member)| to.contains(&member.node));
            next.me = *successor.expect("a voter").0;
        }
    }
    next
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn no_action_endangers_the_quorum(input in any_input()) {
        let Some(action) = decide(&input) else { return Ok(()) };
        let AutopilotAction::SetVoters { voters, .. } = &action else { return Ok(()) };
        let is_healthy = |id: &RaftId| {
            let member = input.voters.get(id).or_else(|| input.learners.get(id));
            member.is_some_and(|member| matches!(member.health, MemberHealth::Healthy { .. }))
        };
        let now: BTreeSet<RaftId> = input.voters.keys().copied().collect();
        for set in [&now, voters] {
            let live = set.iter().filter(|id| is_healthy(id)).count();
            prop_assert!(live * 2 > set.len(), "{live} of {} members are healthy: {action:?}", set.len());
        }
        // The leader stays, every new voter was a learner, and at most a single voter is removed.
        prop_assert!(voters.contains(&input.me));
        prop_assert!(voters.iter().all(|id| now.contains(id) || input.learners.contains_key(id)));
        let removed: Vec<_> = now.difference(voters).collect();
        prop_assert!(removed.len() <= 1, "{action:?}");
        // A healthy voter that is not leaving is removed only for a preferred voter, or because
        // there are too many.
        for id in removed {
            let former = &input.voters[id];
            if former.is_available() && voters.len() <= input.target_voters.min(now.len() - 1) {
                prop_assert!(now.len() > input.target_voters, "{action:?}");
            }
            if former.is_available() && voters.len() == now.len() {
                let better = voters.difference(&now).all(|id| input.learners[id].preferred);
                prop_assert!(!former.preferred && better, "{action:?}");
            }
        }
    }

    #[test]
    fn a_quiet_fleet_comes_to_rest(input in any_input()) {
        let mut input = input;
        let mut actions = vec![];
        for _ in 0..60 {
            let Some(action) = decide(&input) else { return Ok(()) };
            actions.push(summary(Some(action.clone())));
            input = after(&input, &action);
        }
        prop_assert!(false, "the actions do not end: {actions:?}");
    }
}

#[test]
fn a_mobile_leader_transfers_to_stable_stationary_voters() {
    let recent = |number| Member { health: MemberHealth::Healthy { since: DEAD / 2 }, ..member(number) };
    let behind = |number| Member { lag: Some(LAG_MAX + 1), ..member(number) };
    let without_reply = |number| Member { lag: None, ..member(number) };
    let fleet_of = |voters: Vec<(u64, Member)>| fleet(voters, vec![], vec![]);
    let input = fleet_of(vec![(1, mobile(1)), (2, member(2)), (3, mobile(3)), (4, member(4)), (5, recent(5))]);
    let action = decide(&input).unwrap();
    let reason = "n1 moves or runs on a battery, unlike n2, n4: leadership is transferred";
    assert_eq!(action.reason(), reason);
    assert_eq!(summary(Some(action)), "transfer to n2 n4");

    for others in [
        [mobile(2), mobile(3)],
        [recent(2), mobile(3)],
        [behind(2), mobile(3)],
        [without_reply(2), mobile(3)],
        [leaving(2), leaving(3)],
        [silent(2, 1), mobile(3)],
    ] {
        let [second, third] = others.clone();
        let input = fleet_of(vec![(1, mobile(1)), (2, second), (3, third)]);
        let summary = summary(decide(&input));
        assert!(!summary.starts_with("transfer"), "{others:?}: {summary}");
    }
    assert_eq!(summary(decide(&fleet_of(healthy(1..=3)))), "nothing", "a stationary leader keeps the leadership");
}

#[test]
fn a_mobile_leader_transfers_at_most_every_five_minutes() {
    let voters = vec![(1, mobile(1)), (2, member(2)), (3, member(3))];
    let settled = fleet(voters, vec![], vec![]);
    let after = |ago| AutopilotInput { since_transfer: Some(Duration::from_secs(ago)), ..settled.clone() };
    assert_eq!(summary(decide(&after(299))), "nothing");
    assert_eq!(summary(decide(&after(300))), "transfer to n2 n3");
    assert_eq!(summary(decide(&AutopilotInput { unchanged_for: DEAD / 2, ..settled.clone() })), "nothing");
    // Any other due action comes first.
    let busy = AutopilotInput {
        voters: numbered(vec![(1, mobile(1)), (2, member(2)), (3, silent(3, 11))]),
        ..settled.clone()
    };
    assert!(summary(decide(&busy)).starts_with("voters"), "{:?}", decide(&busy));
}
