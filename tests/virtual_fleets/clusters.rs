//! Two halves of a fleet that have each created a cluster: the ledgers do not merge, both report
//! it, and both continue.

use consort_protocol::event::EventKind;
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::keys::{ApiCall, Key};
use consort_tests::{StationFleet, for_each_seed, slug};
use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::Instant;

const ONE: [&str; 3] = ["aster", "basil", "clove"];
const OTHER: [&str; 3] = ["daisy", "elder", "fennel"];

/// Starts both halves without a link between them.
async fn two_clusters(seed: u64) -> StationFleet {
    let mut fleet = StationFleet::empty(seed, 3);
    fleet.network.partition([ONE.map(slug), OTHER.map(slug)]);
    for name in ONE.iter().chain(&OTHER) {
        fleet.start(name).await;
    }
    fleet.wait_until("two coordinators", |fleet| fleet.leaders().len() == 2).await;
    fleet.wait_until("two clusters", |fleet| clusters(fleet).len() == 2 && !clusters(fleet).contains(&None)).await;
    fleet
}

fn clusters(fleet: &StationFleet) -> BTreeSet<Option<ClusterId>> {
    fleet.nodes.keys().map(|name| fleet.cluster(name)).collect()
}

fn missions(fleet: &StationFleet, names: &[&str]) -> Vec<Vec<String>> {
    let of = |name: &&str| {
        let replica = fleet.nodes[*name].replica.as_ref().expect("a copy");
        replica.read(|ledger| ledger.missions().map(|entry| entry.submission.request.to_string()).collect())
    };
    names.iter().map(of).collect()
}

#[test]
fn two_separate_clusters_do_not_merge_and_report_each_other() {
    for_each_seed(1..3, async |seed| {
        let mut fleet = two_clusters(seed).await;
        fleet.submit("basil", "of-one").await;
        fleet.submit("elder", "of-the-other").await;
        let own = |names: [&str; 3], fleet: &StationFleet| names.map(|name| fleet.cluster(name));
        let before = (own(ONE, &fleet), own(OTHER, &fleet));
        let voters = |fleet: &StationFleet, name: &str| fleet.leadership_view(name).voters;
        let kept = (voters(&fleet, "aster"), voters(&fleet, "daisy"));

        fleet.network.heal();
        let foreign = |fleet: &StationFleet| {
            let foreign_clusters = fleet.events().into_iter().filter_map(|what| match what {
                EventKind::Foreign { cluster, foreign, .. } => Some((cluster, foreign)),
                _ => None,
            });
            foreign_clusters.collect::<Vec<_>>()
        };
        fleet.wait_until("both report it", |fleet| foreign(fleet).len() >= 2).await;
        fleet.advance(Duration::from_secs(60)).await;
        let foreign_clusters = foreign(&fleet);
        assert_eq!(foreign_clusters.len(), 2, "seed {seed}: {foreign_clusters:?}");
        assert_eq!(foreign_clusters[0].0, foreign_clusters[1].1, "seed {seed}");
        assert_eq!((own(ONE, &fleet), own(OTHER, &fleet)), before, "seed {seed}");
        assert_eq!((voters(&fleet, "aster"), voters(&fleet, "daisy")), kept, "seed {seed}");
        assert_eq!(missions(&fleet, &ONE), [["of-one"]; 3], "seed {seed}");
        assert_eq!(missions(&fleet, &OTHER), [["of-the-other"]; 3], "seed {seed}");

        // Each half still elects and commits by itself while the other half is reachable.
        let leader =
            fleet.leaders().into_iter().find(|name| ONE.contains(&name.as_str())).expect("a leader of the first half");
        fleet.kill(&leader).await;
        fleet.wait_until("two coordinators again", |fleet| fleet.leaders().len() == 2).await;
        let cancel = json!({ "mission": "lab-samples-9" });
        let answers = fleet.query("fennel", &Key::Api(ApiCall::Cancel), &cancel, Duration::from_secs(1)).await;
        assert_eq!(answers.len(), 2, "seed {seed}: each coordinator replies: {answers:?}");
        let shown = fleet.query("fennel", &Key::ViewCoordinator, &Value::Null, Duration::from_secs(1)).await;
        for view in &shown {
            assert_eq!(view["foreign"].as_object().map(serde_json::Map::len), Some(1), "seed {seed}: {view}");
        }
    });
}

#[test]
fn a_node_that_discovers_a_cluster_creates_none() {
    for_each_seed(1..5, async |seed| {
        let mut fleet = StationFleet::empty(seed, 1);
        fleet.start("aster").await;
        fleet.wait_for_coordinator().await;
        let cluster = fleet.cluster("aster");
        for name in ["basil", "clove", "daisy", "elder"] {
            fleet.start(name).await;
        }
        fleet.advance(Duration::from_secs(30)).await;
        assert_eq!(clusters(&fleet), BTreeSet::from([cluster]), "seed {seed}");
        assert_eq!(fleet.leaders(), ["aster"], "seed {seed}");
    });
}

#[test]
fn a_new_node_between_two_clusters_joins_only_one() {
    for_each_seed(1..4, async |seed| {
        let mut fleet = two_clusters(seed).await;
        fleet.network.heal();
        fleet.start("gorse").await;
        fleet.start("hyssop").await;
        fleet.advance(Duration::from_secs(60)).await;
        let before = clusters(&fleet);
        assert_eq!(before.len(), 2, "seed {seed}: {before:?}");
        for name in ["gorse", "hyssop"] {
            let believed = fleet.leadership_view(name);
            let votes: Vec<_> = believed.voters.values().map(ToString::to_string).collect();
            if votes.iter().any(|voter| voter == name) {
                let with = votes.iter().filter(|voter| ONE.contains(&voter.as_str())).count();
                assert!(with == 0 || with == 3, "seed {seed}: {name} votes with {votes:?}");
            }
        }
        fleet.submit("gorse", "after").await;
    });
}

const FIVE: [&str; 5] = ["aster", "basil", "clove", "daisy", "elder"];

/// Starts five nodes within milliseconds, fixed and mobile nodes, in an order and at intervals
/// drawn from the seed. The nodes are linked in sequence, up to `link_up` after the first.
async fn all_at_once(seed: u64, expect: usize, link_up: Duration) -> StationFleet {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut fleet = StationFleet::empty(seed, expect);
    let mut names = FIVE;
    names.shuffle(&mut rng);
    let unlinked = |names: &[&str]| names.iter().map(|name| [slug(name)]).collect::<Vec<[NodeId; 1]>>();
    if !link_up.is_zero() {
        fleet.network.partition(unlinked(&names));
    }
    for name in names {
        tokio::time::sleep(Duration::from_micros(rng.random_range(0..5000))).await;
        match rng.random_bool(0.5) {
            true => fleet.start(name).await,
            false => fleet.start_mobile(name).await,
        }
    }
    if !link_up.is_zero() {
        names.shuffle(&mut rng);
        let began = Instant::now();
        let mut at: Vec<Duration> = names.iter().map(|_| rng.random_range(Duration::ZERO..link_up)).collect();
        at.sort();
        for (linked, at) in at.into_iter().enumerate() {
            tokio::time::sleep_until(began + at).await;
            fleet.network.partition(unlinked(&names[linked + 1..]));
        }
        fleet.network.heal();
    }
    fleet
}

/// Returns the time until all nodes belong to the same cluster. No node may ever belong to another.
async fn one_cluster(fleet: &StationFleet) -> Duration {
    let began = Instant::now();
    let cluster_count = |fleet: &StationFleet| {
        let known: Vec<ClusterId> = clusters(fleet).into_iter().flatten().collect();
        assert!(known.len() < 2, "seed {}: {known:?}", fleet.seed);
        (known.len(), clusters(fleet).contains(&None))
    };
    fleet.wait_until("all belong to the same cluster", |fleet| cluster_count(fleet) == (1, false)).await;
    let took = began.elapsed();
    let end = Instant::now() + Duration::from_secs(5);
    fleet.wait_until("no further cluster", |fleet| cluster_count(fleet) == (1, false) && Instant::now() >= end).await;
    took
}

#[test]
fn five_simultaneous_nodes_create_a_single_cluster() {
    for expect in [1, 2, 5] {
        let took = RefCell::new(vec![]);
        for_each_seed(0..60, async |seed| {
            let fleet = all_at_once(seed, expect, Duration::ZERO).await;
            let founded = one_cluster(&fleet).await;
            took.borrow_mut().push(founded);
        });
        let mut took = took.into_inner();
        took.sort_unstable();
        // They listen for 600 ms; the query takes a round trip.
        assert!(took[30] < Duration::from_millis(700), "expecting {expect}: {took:?}");
    }
}

#[test]
fn five_nodes_with_late_links_create_a_single_cluster() {
    for expect in [1, 2, 5] {
        for_each_seed(100..160, async |seed| {
            let fleet = all_at_once(seed, expect, Duration::from_millis(550)).await;
            one_cluster(&fleet).await;
        });
    }
}

#[test]
fn a_node_does_not_create_a_second_cluster_during_a_bootstrap() {
    // `aster` would come first of the two. It starts before the other node has created a cluster
    // and listens until after that.
    for_each_seed(200..260, async |seed| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut fleet = StationFleet::empty(seed, 1);
        fleet.start("elder").await;
        tokio::time::sleep(Duration::from_millis(rng.random_range(0..620))).await;
        fleet.network.partition([[slug("aster")]]);
        fleet.start("aster").await;
        tokio::time::sleep(Duration::from_millis(rng.random_range(0..590))).await;
        fleet.network.heal();
        one_cluster(&fleet).await;
    });
}

/// All stores were damaged: none of the empty stores may become the ledger, since the damaged files may
/// be all that is left of it.
#[test]
fn nodes_with_replaced_stores_create_no_cluster() {
    for_each_seed(1..3, async |seed| {
        let mut fleet = StationFleet::founded(seed, &ONE).await;
        fleet.submit("basil", "first").await;
        for name in ONE {
            fleet.kill(name).await;
        }
        for name in ONE {
            fleet.start_with_replaced_store(name).await;
        }
        fleet.advance(Duration::from_secs(60)).await;
        assert_eq!(fleet.leaders(), Vec::<String>::new(), "seed {seed}");
        assert_eq!(clusters(&fleet), BTreeSet::from([None]), "seed {seed}");
    });
}

#[test]
fn a_node_with_a_replaced_store_joins_the_cluster_again() {
    for_each_seed(1..3, async |seed| {
        let mut fleet = StationFleet::founded(seed, &ONE).await;
        fleet.submit("basil", "first").await;
        fleet.kill("basil").await;
        fleet.start_with_replaced_store("basil").await;
        let holds = |fleet: &StationFleet| missions(fleet, &["basil"]) == [["first"]];
        fleet.wait_until("basil to have the ledger", holds).await;
        fleet.wait_until("basil to vote again", |fleet| fleet.voters().len() == 3 && holds(fleet)).await;
    });
}
