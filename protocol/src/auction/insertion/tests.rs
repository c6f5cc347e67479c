use super::*;
use proptest::prelude::*;

const DISCHARGE: f64 = 0.001;

/// Places on a line, a metre apart, at a metre per second.
struct Line;

impl Travel<PlaceId> for Line {
    fn seconds(&self, from: &PlaceId, to: &PlaceId) -> f64 {
        let metre = |place: &PlaceId| place.as_str().parse::<f64>().unwrap();
        (metre(to) - metre(from)).abs()
    }
}

fn place(metre: u8) -> PlaceId {
    metre.to_string().parse().unwrap()
}

fn seconds(value: u8) -> Seconds {
    Seconds::new(f64::from(value)).unwrap()
}

fn span(from: u8, to: u8, time: u8) -> RoleSpan {
    let energy = Energy::of_share(DISCHARGE * f64::from(time));
    RoleSpan { from: Some(place(from)), to: Some(place(to)), time: seconds(time), energy }
}

/// Returns a role that takes this time in addition to the way from its first place to its last.
fn moving(from: u8, to: u8, time: u8) -> RoleSpan {
    span(from, to, time + from.abs_diff(to))
}

fn promise(number: usize, span: RoleSpan, slack: Option<u8>) -> PromisedRole {
    let mission = format!("m-{number}").parse().unwrap();
    let role = RoleOfMission { mission, role: "r1".parse().unwrap() };
    let (robot, release) = ("ada".parse().unwrap(), Seconds::ZERO);
    PromisedRole { robot, role, span, slack: slack.map(seconds), release, charges: false }
}

/// Returns the insertion for a robot that is free at metre 0 after 5 s.
fn insert(promised: &[PromisedRole], span: RoleSpan, objective: Objective) -> Option<RoleInsertion> {
    insert_within(promised, span, objective, None)
}

fn insert_within(
    promised: &[PromisedRole],
    span: RoleSpan,
    objective: Objective,
    ends_within: Option<Seconds>,
) -> Option<RoleInsertion> {
    let start = place(0);
    let discharge = SharePerSecond::new(DISCHARGE).unwrap();
    let (time, comes_first, release) = (seconds(5), false, Seconds::ZERO);
    let start = TimelineStart { place: &start, time, discharge, comes_first, ends_within, release };
    insert_role(start, &promised.iter().collect::<Vec<_>>(), span, objective, &Line)
}

/// Performs roles in their order. Returns the begin of each, the sum of the ends, and the energy.
fn perform(spans: &[RoleSpan]) -> (Vec<f64>, f64, f64) {
    let (mut at, mut now, mut ends, mut energy, mut begins) = (place(0), 5.0, 0.0, 0.0, vec![]);
    for span in spans {
        let way = Line.seconds(&at, span.from.as_ref().unwrap());
        begins.push(now + way);
        now += way + span.time.get();
        ends += now;
        energy += DISCHARGE * way + span.energy.get();
        at = span.to.clone().unwrap();
    }
    (begins, ends, energy)
}

fn position(promised: &[PromisedRole], found: &RoleInsertion) -> usize {
    let next = found.planned.before.as_ref();
    next.map_or(promised.len(), |next| promised.iter().position(|promised| promised.role == *next).unwrap())
}

proptest! {
    /// No position within the bounds on delays, and before roles of a lower priority, costs less, and the cost is the
    /// difference between the cost with the role and without.
    #[test]
    fn the_insertion_has_the_least_marginal_cost(
        promised in prop::collection::vec((0_u8..40, 0_u8..40, 0_u8..30, prop::option::of(0_u8..90)), 0..6),
        new in (0_u8..40, 0_u8..40, 0_u8..30),
        objective in prop_oneof![
            Just(Objective::EarliestEnd),
            Just(Objective::LeastEnergy),
            Just(Objective::Weighted { battery_s: Seconds::new(500.0).unwrap() }),
        ],
    ) {
        let mut promised = promised;
        promised.sort_by_key(|(.., slack)| slack.is_none());
        let last = promised.iter().filter(|(.., slack)| slack.is_some()).count();
        let promised: Vec<PromisedRole> = promised.into_iter().enumerate()
            .map(|(number, (from, to, time, slack))| promise(number, moving(from, to, time), slack)).collect();
        let new = moving(new.0, new.1, new.2);
        let spans: Vec<RoleSpan> = promised.iter().map(|promised| promised.span.clone()).collect();
        let (begins, ends, energy) = perform(&spans);
        let marginal_cost = |position: usize| {
            let mut order = spans.clone();
            order.insert(position, new.clone());
            let (mut later, ends_after, energy_after) = perform(&order);
            later.remove(position);
            let is_late = |((later, begin), promised): ((&f64, &f64), &PromisedRole)| {
                promised.slack.is_some_and(|slack| *later > begin + slack.get())
            };
            let breaks_promise = later.iter().zip(&begins).zip(&promised).any(is_late);
            (!breaks_promise).then(|| objective.cost(ends_after - ends, energy_after - energy))
        };
        let least = (0..=last).filter_map(marginal_cost).min_by(f64::total_cmp).expect("the last one");
        let found = insert(&promised, new.clone(), objective).expect("all places can be reached");
        let position = position(&promised, &found);
        let cost = marginal_cost(position);
        prop_assert!(cost.is_some(), "position {position} breaks a promise");
        prop_assert!((cost.unwrap() - least).abs() < 1e-6, "{cost:?} at {position}, {least} is possible");

        let PlannedRole { start, energy: promised_energy, detour_energy, delayed, .. } = found.planned;
        let way = Line.seconds(&found.from, new.from.as_ref().unwrap());
        let own_energy = DISCHARGE * way + new.energy.get();
        let end = start.get() + way + new.time.get();
        let bid = objective.cost(end + found.planned.delay_sum_s(), own_energy + detour_energy);
        prop_assert!((bid - least).abs() < 1e-6, "the bid costs {bid}, the least marginal cost is {least}");
        prop_assert_eq!(delayed as usize, promised.len() - position);
        let mut order = spans[..last].to_vec();
        order.insert(position, new);
        let in_all = perform(&order).2;
        prop_assert!((promised_energy.get() + own_energy - in_all).abs() < 1e-9);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// No role begins before its release, and no promise is delayed beyond its bound.
    #[test]
    fn an_insertion_keeps_releases_and_bounds(
        promised in prop::collection::vec((0_u8..40, 0_u8..30, 0_u8..90, 0_u8..90), 0..5),
        (to, release) in (0_u8..40, 0_u8..90),
    ) {
        let role = |(number, (place, time, slack, release)): (usize, (u8, u8, u8, u8))| {
            PromisedRole { release: seconds(release), ..promise(number, span(place, place, time), Some(slack)) }
        };
        let promised: Vec<PromisedRole> = promised.into_iter().enumerate().map(role).collect();
        let begins = |roles: &[(&RoleSpan, Seconds)]| {
            let (mut at, mut now, mut begins) = (place(0), 5.0_f64, vec![]);
            for (span, release) in roles {
                now = now.max(release.get());
                let leaves = now;
                now += Line.seconds(&at, span.from.as_ref().unwrap());
                begins.push((leaves, now));
                now += span.time.get();
                at = span.to.clone().unwrap();
            }
            begins
        };
        let mut roles: Vec<(&RoleSpan, Seconds)> = promised.iter().map(|role| (&role.span, role.release)).collect();
        let before = begins(&roles);
        let (free, discharge, new) = (place(0), SharePerSecond::new(DISCHARGE).unwrap(), span(to, to, 5));
        let (time, release) = (seconds(5), seconds(release));
        let start = TimelineStart { place: &free, time, discharge, comes_first: false, ends_within: None, release };
        let own: Vec<&PromisedRole> = promised.iter().collect();
        let found = insert_role(start, &own, new.clone(), Objective::EarliestEnd, &Line).expect("the last position");
        let position = position(&promised, &found);
        roles.insert(position, (&new, release));
        let mut after = begins(&roles);
        let (leaves, _) = after.remove(position);
        prop_assert!((found.planned.start.get() - leaves).abs() < 1e-9, "{found:?}, {leaves}");
        prop_assert!(leaves >= release.get());
        for (((_, later), (_, begin)), promised) in after.iter().zip(&before).zip(&promised) {
            let slack = promised.slack.unwrap().get();
            prop_assert!(later - begin <= slack + 1e-9, "{promised:?} is delayed by {} s", later - begin);
        }
    }
}

#[test]
fn a_role_fits_into_the_time_before_a_release() {
    // The robot would wait 60 s for the promised role.
    let waiting = PromisedRole { release: seconds(65), ..promise(1, span(30, 30, 10), Some(0)) };
    let found = insert(&[waiting], span(20, 20, 10), Objective::EarliestEnd).unwrap();
    let PlannedRole { start, delay, delayed, .. } = found.planned;
    assert_eq!((start, delay, delayed), (seconds(5), Seconds::ZERO, 1));
}

#[test]
fn a_role_on_the_way_comes_first() {
    let promised = [promise(1, span(30, 30, 10), Some(60)), promise(2, span(0, 0, 10), Some(60))];
    let found = insert(&promised, span(20, 20, 4), Objective::EarliestEnd).unwrap();
    assert_eq!((position(&promised, &found), found.from.as_str()), (0, "0"));
    assert_eq!(found.ends_at, Some(place(0)));
    let PlannedRole { start, delay, delayed, promised: all, .. } = found.planned;
    assert_eq!((start, delay, delayed, all), (seconds(5), seconds(4), 2, 2));
}

#[test]
fn a_promise_is_not_delayed_beyond_its_bound() {
    let position_with = |slack| {
        let promised = [promise(1, span(30, 30, 10), slack)];
        let found = insert(&promised, span(0, 0, 5), Objective::EarliestEnd).unwrap();
        (position(&promised, &found), found.from.as_str().to_owned())
    };
    let first = (0, "0".to_owned());
    assert_eq!([position_with(None), position_with(Some(5))], [first.clone(), first]);
    assert_eq!(position_with(Some(4)), (1, "30".to_owned()));
}

#[test]
fn the_objective_decides() {
    // The short role is nearer to the end of the long role, and earlier before it.
    let promised = [promise(1, span(30, 50, 60), Some(60))];
    let new = span(40, 40, 1);
    let earliest = insert(&promised, new.clone(), Objective::EarliestEnd).unwrap();
    let least = insert(&promised, new, Objective::LeastEnergy).unwrap();
    assert_eq!((position(&promised, &earliest), position(&promised, &least)), (0, 1));
}

#[test]
fn an_insertion_that_saves_nothing_comes_last() {
    let still = |time| RoleSpan { from: None, to: None, time, energy: Energy::ZERO };
    let third = Seconds::new(10.0 / 3.0).unwrap();
    let promised = [promise(1, still(third), Some(60)), promise(2, still(third), Some(60))];
    let found = insert(&promised, still(third), Objective::EarliestEnd).unwrap();
    assert_eq!(position(&promised, &found), 2);
}

#[test]
fn roles_without_a_drive_need_no_places() {
    let still = |time| RoleSpan { from: None, to: None, time: seconds(time), energy: Energy::ZERO };
    let promised = [promise(1, still(10), Some(60)), promise(2, still(2), Some(60))];
    let found = insert(&promised, still(5), Objective::EarliestEnd).unwrap();
    assert_eq!((position(&promised, &found), found.from.as_str()), (0, "0"));
}

#[test]
fn a_role_comes_before_all_of_a_lower_priority() {
    // It would cost least at the end.
    let promised = [promise(1, span(0, 0, 1), Some(60)), promise(2, span(0, 0, 1), None)];
    let found = insert(&promised, span(40, 40, 60), Objective::EarliestEnd).unwrap();
    assert_eq!((position(&promised, &found), found.ends_at), (1, None));
}

#[test]
fn a_role_comes_earlier_to_meet_its_deadline() {
    // It ends after 46 s if it comes first, and after 56 s if it comes last.
    let position_with = |slack, ends_within| {
        let promised = [promise(1, span(0, 0, 10), Some(slack))];
        let found = insert_within(&promised, span(40, 40, 1), Objective::EarliestEnd, ends_within).unwrap();
        position(&promised, &found)
    };
    assert_eq!(position_with(90, None), 1);
    assert_eq!(position_with(90, Some(seconds(50))), 0);
    assert_eq!(position_with(80, Some(seconds(50))), 1, "it would delay the promise by 81 s");
    assert_eq!(position_with(90, Some(seconds(40))), 1, "it would be late anyway");
}

#[test]
fn a_role_that_can_start_comes_first_whatever_it_delays() {
    let promised = [promise(1, span(30, 30, 10), Some(1))];
    let promised: Vec<&PromisedRole> = promised.iter().collect();
    let (free, discharge) = (place(0), SharePerSecond::new(DISCHARGE).unwrap());
    let (time, release) = (Seconds::ZERO, Seconds::ZERO);
    let start = TimelineStart { place: &free, time, discharge, comes_first: true, ends_within: None, release };
    let found = insert_role(start, &promised, span(40, 40, 60), Objective::EarliestEnd, &Line).unwrap();
    assert_eq!(found.planned.before.as_ref(), Some(&promised[0].role));
    assert_eq!((found.from.as_str(), found.planned.start, found.planned.delay), ("0", seconds(0), seconds(80)));
}
