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

fn fleet(voters: Vec<(u64, Member)>, observers: Vec<(u64, Member)>, candidates: Vec<(u64, Member)>) -> AutopilotInput {
    AutopilotInput {
        me: RaftId(1),
        target_voters: 5,
        dead_after: DEAD,
        settle_time: DEAD,
        unchanged_for: LONG,
        since_transfer: None,
        voters: numbered(voters),
        pending_voters: None,
        learners: numbered(observers),
        candidates: numbered(candidates),
    }
}

fn well(numbers: impl IntoIterator<Item = u64>) -> Vec<(u64, Member)> {
    numbers.into_iter().map(|number| (number, member(number))).collect()
}

/// The change without its reason.
fn gist(change: Option<AutopilotAction>) -> String {
    let list = |voters: &BTreeSet<RaftId>| voters.iter().map(|id| id.0.to_string()).collect::<Vec<_>>().join(" ");
    match change {
        None => "nothing".to_owned(),
        Some(AutopilotAction::AddLearner { id, .. }) => format!("observe {}", id.0),
        Some(AutopilotAction::SetVoters { voters, .. }) => format!("vote {}", list(&voters)),
        Some(AutopilotAction::RemoveLearner { id, .. }) => format!("forget {}", id.0),
        Some(AutopilotAction::TransferLeadership { to, .. }) => {
            format!("hand over to {}", to.iter().map(NodeId::as_str).collect::<Vec<_>>().join(" "))
        }
    }
}

fn with(mut voters: Vec<(u64, Member)>, number: u64, instead: Member) -> Vec<(u64, Member)> {
    voters.retain(|(known, _)| *known != number);
    voters.push((number, instead));
    voters
}

#[test]
fn a_dead_voter_is_replaced_by_way_of_an_observer() {
    let voters = with(well(1..=5), 3, silent(3, 11));
    assert_eq!(gist(decide(&fleet(voters.clone(), vec![], well([6, 7])))), "observe 6");
    let behind = Member { lag: Some(1000), ..member(6) };
    assert_eq!(gist(decide(&fleet(voters.clone(), vec![(6, behind)], well([7])))), "nothing");
    assert_eq!(gist(decide(&fleet(voters.clone(), well([6]), well([7])))), "vote 1 2 4 5 6");
    let change = decide(&fleet(voters, well([6]), vec![])).unwrap();
    assert_eq!(change.reason(), "n3 silent for 11.0 s: n6 takes its place");
}

#[test]
fn one_that_was_silent_for_a_moment_is_not() {
    let voters = with(well(1..=5), 3, silent(3, 9));
    assert_eq!(gist(decide(&fleet(voters, vec![], well([6])))), "nothing");
}

#[test]
fn a_member_whose_store_is_lost_is_replaced_at_once_by_the_same_node_if_need_be() {
    let lost = Member { health: MemberHealth::Replaced, ..member(3) };
    let view =
        fleet(with(well(1..=3), 3, lost), vec![], vec![(9, Member { node: NodeId::new("n3").unwrap(), ..member(9) })]);
    assert_eq!(gist(decide(&view)), "observe 9");
}

#[test]
fn without_a_replacement_the_dead_are_removed_while_a_majority_answers() {
    let voters = with(well(1..=5), 3, silent(3, 11));
    assert_eq!(gist(decide(&fleet(voters, vec![], vec![]))), "vote 1 2 4 5");
    let three = with(with(with(well(1..=5), 3, silent(3, 11)), 4, silent(4, 11)), 5, silent(5, 11));
    assert_eq!(gist(decide(&fleet(three, well([6]), well([7])))), "nothing");
}

#[test]
fn a_removal_after_which_no_majority_would_answer_is_not_made() {
    // Three of five answer. Without the leaver, two of four would.
    let voters = with(with(with(well(1..=5), 3, silent(3, 2)), 4, silent(4, 2)), 5, leaving(5));
    assert_eq!(gist(decide(&fleet(voters, vec![], vec![]))), "nothing");
}

#[test]
fn the_dead_are_replaced_one_by_one() {
    let voters = with(with(well(1..=5), 3, silent(3, 11)), 4, silent(4, 12));
    assert_eq!(gist(decide(&fleet(voters, well([6, 7]), vec![]))), "vote 1 2 4 5 6");
}

#[test]
fn a_leaver_is_replaced_or_let_go() {
    let voters = with(well(1..=3), 2, leaving(2));
    assert_eq!(gist(decide(&fleet(voters.clone(), well([4]), vec![]))), "vote 1 3 4");
    assert_eq!(gist(decide(&fleet(voters, vec![], vec![]))), "vote 1 3");
}

#[test]
fn the_only_voter_that_leaves_gets_somebody_to_hand_over_to() {
    assert_eq!(gist(decide(&fleet(vec![(1, leaving(1))], vec![], well([2])))), "observe 2");
    assert_eq!(gist(decide(&fleet(vec![(1, leaving(1))], well([2]), vec![]))), "vote 1 2");
    assert_eq!(gist(decide(&fleet(vec![(1, leaving(1))], vec![], vec![]))), "nothing");
}

#[test]
fn voters_grow_to_an_odd_number() {
    assert_eq!(gist(decide(&fleet(well([1]), vec![], well([2])))), "nothing");
    assert_eq!(gist(decide(&fleet(well([1]), vec![], well([2, 3])))), "observe 2");
    assert_eq!(gist(decide(&fleet(well([1]), well([2]), well([3])))), "observe 3");
    assert_eq!(gist(decide(&fleet(well([1]), well([2, 3]), vec![]))), "vote 1 2 3");
    assert_eq!(gist(decide(&fleet(well(1..=4), well([5]), vec![]))), "vote 1 2 3 4 5");
    assert_eq!(gist(decide(&fleet(well(1..=5), vec![], well([6, 7])))), "nothing");
}

#[test]
fn more_than_are_aimed_at_go_one_by_one() {
    let view = AutopilotInput { target_voters: 3, ..fleet(with(well(1..=5), 2, mobile(2)), vec![], vec![]) };
    assert_eq!(gist(decide(&view)), "vote 1 3 4 5");
}

#[test]
fn one_that_stays_takes_the_place_of_one_that_moves_when_both_have_settled() {
    let voters = with(well(1..=3), 2, mobile(2));
    let view = AutopilotInput { target_voters: 3, ..fleet(voters, vec![], well([4])) };
    assert_eq!(gist(decide(&view)), "observe 4");
    let view = AutopilotInput { candidates: BTreeMap::new(), learners: numbered(well([4])), ..view };
    assert_eq!(gist(decide(&view)), "vote 1 3 4");
    assert_eq!(gist(decide(&AutopilotInput { unchanged_for: Duration::ZERO, ..view.clone() })), "nothing");
    let fresh = Member { health: MemberHealth::Healthy { since: Duration::from_secs(1) }, ..member(4) };
    assert_eq!(gist(decide(&AutopilotInput { learners: numbered(vec![(4, fresh)]), ..view })), "nothing");
}

#[test]
fn observers_that_nothing_is_planned_with_are_forgotten() {
    assert_eq!(gist(decide(&fleet(well(1..=5), well([6]), vec![]))), "forget 6");
    assert_eq!(gist(decide(&fleet(well(1..=3), vec![(6, silent(6, 11))], vec![]))), "forget 6");
}

#[test]
fn what_a_dead_leader_began_is_completed() {
    let mut view = fleet(well(1..=6), vec![], well([7]));
    view.pending_voters = Some([1, 2, 4, 5, 6].map(RaftId).into());
    assert_eq!(gist(decide(&view)), "vote 1 2 4 5 6");
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

fn any_view() -> impl Strategy<Value = AutopilotInput> {
    let places = prop::collection::vec(0u8..3, 1..12);
    places.prop_flat_map(|places| {
        let members: Vec<_> = (1u64..).take(places.len()).map(any_member).collect();
        (Just(places), members, 1usize..6, any::<bool>()).prop_map(|(places, members, half, quiet)| {
            let mut view = fleet(vec![], vec![], vec![]);
            view.target_voters = half * 2 - 1;
            view.unchanged_for = if quiet { LONG } else { Duration::ZERO };
            for (number, (place, mut member)) in (1u64..).zip(places.into_iter().zip(members)) {
                let id = RaftId(number);
                match place {
                    _ if number == 1 => {
                        member.health = MemberHealth::Healthy { since: LONG };
                        view.voters.insert(id, member);
                    }
                    0 => drop(view.voters.insert(id, member)),
                    1 => drop(view.learners.insert(id, member)),
                    _ => drop(view.candidates.insert(id, member)),
                }
            }
            view
        })
    })
}

/// What the fleet looks like after a change.
fn after(view: &AutopilotInput, change: &AutopilotAction) -> AutopilotInput {
    let mut next = view.clone();
    match change {
        AutopilotAction::AddLearner { id, .. } => {
            let member = next.candidates.remove(id).expect("a candidate");
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
            let member = next.learners.remove(id).expect("an observer");
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
    fn no_change_endangers_the_quorum(view in any_view()) {
        let Some(change) = decide(&view) else { return Ok(()) };
        let AutopilotAction::SetVoters { voters, .. } = &change else { return Ok(()) };
        let answers = |id: &RaftId| {
            let member = view.voters.get(id).or_else(|| view.learners.get(id));
            member.is_some_and(|member| matches!(member.health, MemberHealth::Healthy { .. }))
        };
        let now: BTreeSet<RaftId> = view.voters.keys().copied().collect();
        for set in [&now, voters] {
            let live = set.iter().filter(|id| answers(id)).count();
            prop_assert!(live * 2 > set.len(), "{live} of {} answer: {change:?}", set.len());
        }
        // The leader stays, nobody votes that was not replicated to, and those who go are few.
        prop_assert!(voters.contains(&view.me));
        prop_assert!(voters.iter().all(|id| now.contains(id) || view.learners.contains_key(id)));
        let removed: Vec<_> = now.difference(voters).collect();
        prop_assert!(removed.len() <= 1, "{change:?}");
        // One that answers and stays goes only for a better one, or because there are too many.
        for id in removed {
            let former = &view.voters[id];
            if former.fit() && voters.len() <= view.target_voters.min(now.len() - 1) {
                prop_assert!(now.len() > view.target_voters, "{change:?}");
            }
            if former.fit() && voters.len() == now.len() {
                let better = voters.difference(&now).all(|id| view.learners[id].preferred);
                prop_assert!(!former.preferred && better, "{change:?}");
            }
        }
    }

    #[test]
    fn a_quiet_fleet_comes_to_rest(view in any_view()) {
        let mut view = view;
        let mut seen = vec![];
        for _ in 0..60 {
            let Some(change) = decide(&view) else { return Ok(()) };
            seen.push(gist(Some(change.clone())));
            view = after(&view, &change);
        }
        prop_assert!(false, "it goes on and on: {seen:?}");
    }
}

#[test]
fn a_leader_that_moves_hands_over_to_voters_that_stay_once_they_have_been_there_for_long() {
    let recent = |number| Member { health: MemberHealth::Healthy { since: DEAD / 2 }, ..member(number) };
    let behind = |number| Member { lag: Some(LAG_MAX + 1), ..member(number) };
    let unheard = |number| Member { lag: None, ..member(number) };
    let among = |voters: Vec<(u64, Member)>| fleet(voters, vec![], vec![]);
    let view = among(vec![(1, mobile(1)), (2, member(2)), (3, mobile(3)), (4, member(4)), (5, recent(5))]);
    let change = decide(&view).unwrap();
    let reason = "n1 moves or runs on a battery, and n2, n4 does neither: the lead is handed over";
    assert_eq!(change.reason(), reason);
    assert_eq!(gist(Some(change)), "hand over to n2 n4");

    for others in [
        [mobile(2), mobile(3)],
        [recent(2), mobile(3)],
        [behind(2), mobile(3)],
        [unheard(2), mobile(3)],
        [leaving(2), leaving(3)],
        [silent(2, 1), mobile(3)],
    ] {
        let [one, other] = others.clone();
        let view = among(vec![(1, mobile(1)), (2, one), (3, other)]);
        let gist = gist(decide(&view));
        assert!(!gist.starts_with("hand over"), "{others:?}: {gist}");
    }
    assert_eq!(gist(decide(&among(well(1..=3)))), "nothing", "one that stays keeps the lead");
}

#[test]
fn a_leader_that_moves_hands_over_at_most_every_five_minutes_and_only_when_all_is_quiet() {
    let voters = vec![(1, mobile(1)), (2, member(2)), (3, member(3))];
    let calm = fleet(voters, vec![], vec![]);
    let after = |ago| AutopilotInput { since_transfer: Some(Duration::from_secs(ago)), ..calm.clone() };
    assert_eq!(gist(decide(&after(299))), "nothing");
    assert_eq!(gist(decide(&after(300))), "hand over to n2 n3");
    assert_eq!(gist(decide(&AutopilotInput { unchanged_for: DEAD / 2, ..calm.clone() })), "nothing");
    // Whatever is due besides comes first.
    let busy =
        AutopilotInput { voters: numbered(vec![(1, mobile(1)), (2, member(2)), (3, silent(3, 11))]), ..calm.clone() };
    assert!(gist(decide(&busy)).starts_with("vote"), "{:?}", decide(&busy));
}
