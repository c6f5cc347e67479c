//! Promise of a node about the bootstrap of the cluster, and its replies to bootstrap requests. It
//! does no I/O.
//!
//! ```text
//!  bootstrapping node                           each node with the right to vote
//!    │ has listened, knows enough nodes, has the turn
//!    ├── request ──────────────────────────────────▶│ knows of no ledger, and has made no other promise;
//!    │◀─────────────────────────────────── agreed ──┤ of two nodes that both ask, the lesser continues
//!    │ bootstraps                                   │ does not bootstrap meanwhile
//! ```
//!
//! The turn depends on the nodes that are known, and two nodes that know of different nodes may
//! both conclude that it is their turn. If they can reach each other when either asks, at most one
//! of the two bootstraps all the same: the other refuses, or gives way. The same holds for two
//! nodes that cannot, if both reach a third node, for the duration of its promise. Two nodes
//! without any connection may bootstrap a ledger each, unless more than half of all nodes must
//! agree: no rule can distinguish a partitioned network from a small fleet.

use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::message::{BootstrapReply, BootstrapRequest};
use std::time::Duration;
use tokio::time::Instant;

/// State of the fleet as observed by a node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ObservedFleet {
    /// Known cluster of the fleet's name.
    pub(super) cluster: Option<ClusterId>,
    /// The node's own replica of the ledger has voters.
    pub(super) has_voters: bool,
    /// The node's store replaces a damaged store, which may contain the only ledger.
    pub(super) replaces_damaged: bool,
    /// Node that has the turn to bootstrap, considering all nodes known to this node.
    pub(super) next_founder: Option<NodeId>,
}

impl ObservedFleet {
    /// Returns the reason why no node may bootstrap, if there is any.
    fn reason_against_bootstrap(&self) -> Option<String> {
        let cluster = self.cluster.map(|cluster| format!("a cluster of this name exists: {cluster}"));
        let exists = || self.has_voters.then(|| "a ledger of this name exists".to_owned());
        let lost = || self.replaces_damaged.then(|| "its damaged store may contain the ledger".to_owned());
        cluster.or_else(exists).or_else(lost)
    }
}

/// Promise of a node to let another node bootstrap the cluster.
#[derive(Debug)]
pub(super) struct BootstrapPromise {
    me: BootstrapRequest,
    /// Duration of a promise.
    duration: Duration,
    given: Option<(BootstrapRequest, Instant)>,
    has_bootstrapped: bool,
}

impl BootstrapPromise {
    pub(super) fn new(me: BootstrapRequest, duration: Duration) -> BootstrapPromise {
        BootstrapPromise { me, duration, given: None, has_bootstrapped: false }
    }

    fn given_to(&self, now: Instant) -> Option<&BootstrapRequest> {
        self.given.as_ref().filter(|(_, until)| now < *until).map(|(candidate, _)| candidate)
    }

    /// Replies to a bootstrap request. A node that is asking itself gives way to a lesser node.
    pub(super) fn reply(
        &mut self,
        candidate: &BootstrapRequest,
        fleet: &ObservedFleet,
        now: Instant,
    ) -> BootstrapReply {
        let has_bootstrapped =
            || self.has_bootstrapped.then(|| format!("{} has bootstrapped the cluster", self.me.node));
        let bound = || {
            let gives_way = |to: &BootstrapRequest| *to == self.me && candidate < to;
            let other = self.given_to(now).filter(|to| *to != candidate && !gives_way(to))?;
            Some(format!("{} is to bootstrap the cluster", other.node))
        };
        match has_bootstrapped().or_else(|| fleet.reason_against_bootstrap()).or_else(bound) {
            Some(reason) => BootstrapReply::Refused { reason },
            None => {
                self.given = Some((candidate.clone(), now + self.duration));
                BootstrapReply::Agreed
            }
        }
    }

    /// Checks whether this node may ask the other nodes now. If so, it is bound only to itself.
    pub(super) fn begin_request(&mut self, fleet: &ObservedFleet, now: Instant) -> bool {
        let may_ask = self.is_free(fleet, now);
        if may_ask {
            self.given = Some((self.me.clone(), now + self.duration));
        }
        may_ask
    }

    /// Checks whether this node may bootstrap after the others have agreed: it may not if it has
    /// given way, or has received news of a ledger, since it asked.
    pub(super) fn confirm(&mut self, fleet: &ObservedFleet, now: Instant) -> bool {
        self.has_bootstrapped = self.given_to(now) == Some(&self.me) && self.is_free(fleet, now);
        self.has_bootstrapped
    }

    fn is_free(&self, fleet: &ObservedFleet, now: Instant) -> bool {
        let own_turn = fleet.reason_against_bootstrap().is_none() && fleet.next_founder.as_ref() == Some(&self.me.node);
        own_turn && self.given_to(now).is_none_or(|candidate| *candidate == self.me)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DURATION: Duration = Duration::from_secs(1);

    fn candidate(name: &str) -> BootstrapRequest {
        BootstrapRequest { mobile: false, on_battery: false, node: NodeId::new(name).unwrap() }
    }

    /// A fleet in which only these nodes are known.
    fn fleet_with(names: &[&str]) -> ObservedFleet {
        ObservedFleet {
            cluster: None,
            has_voters: false,
            replaces_damaged: false,
            next_founder: names.iter().map(|name| candidate(name).node).min(),
        }
    }

    fn refused(reason: &str) -> BootstrapReply {
        BootstrapReply::Refused { reason: reason.to_owned() }
    }

    #[test]
    fn a_promise_binds_for_its_duration() {
        let now = Instant::now();
        let mut cyd = BootstrapPromise::new(candidate("cyd"), DURATION);
        let all = fleet_with(&["ada", "bob", "cyd"]);
        assert_eq!(cyd.reply(&candidate("bob"), &all, now), BootstrapReply::Agreed);
        let late = now + DURATION / 2;
        assert_eq!(cyd.reply(&candidate("ada"), &all, late), refused("bob is to bootstrap the cluster"));
        assert!(!cyd.begin_request(&fleet_with(&["cyd"]), late));
        assert_eq!(cyd.reply(&candidate("ada"), &all, now + DURATION), BootstrapReply::Agreed);
        assert!(cyd.begin_request(&fleet_with(&["cyd"]), now + DURATION * 2));
    }

    #[test]
    fn a_node_bootstraps_only_on_its_turn_and_without_a_known_ledger() {
        let now = Instant::now();
        let alone = fleet_with(&["bob"]);
        let known = ObservedFleet { cluster: Some(ClusterId(7)), ..alone.clone() };
        let kept = ObservedFleet { has_voters: true, ..alone.clone() };
        let lost = ObservedFleet { replaces_damaged: true, ..alone.clone() };
        for fleet in [&known, &kept, &lost, &fleet_with(&["ada", "bob"]), &fleet_with(&[])] {
            let mut bob = BootstrapPromise::new(candidate("bob"), DURATION);
            assert!(!bob.begin_request(fleet, now), "{fleet:?}");
            assert!(bob.begin_request(&alone, now) && !bob.confirm(fleet, now), "{fleet:?}");
        }
        let mut bob = BootstrapPromise::new(candidate("bob"), DURATION);
        let reason = format!("a cluster of this name exists: {}", ClusterId(7));
        assert_eq!(bob.reply(&candidate("ada"), &known, now), refused(&reason));
        assert_eq!(bob.reply(&candidate("ada"), &kept, now), refused("a ledger of this name exists"));
        assert_eq!(bob.reply(&candidate("ada"), &lost, now), refused("its damaged store may contain the ledger"));
        assert!(bob.begin_request(&alone, now) && bob.confirm(&alone, now));
        assert_eq!(bob.reply(&candidate("ada"), &alone, now), refused("bob has bootstrapped the cluster"));
    }

    /// Step of a node in the test of two nodes that both bootstrap.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    enum Step {
        BeginsRequest,
        AsksOther,
        AsksThird,
        Confirms,
    }

    /// Returns all interleavings of the steps of both nodes, each node's own steps in order.
    fn interleavings(ada: &[Step], bob: &[Step]) -> Vec<Vec<(usize, Step)>> {
        if ada.is_empty() && bob.is_empty() {
            return vec![vec![]];
        }
        let mut all = vec![];
        for (node, own_steps, other_steps) in [(0, ada, bob), (1, bob, ada)] {
            let Some((step, remaining)) = own_steps.split_first() else { continue };
            let (ada, bob) = if node == 0 { (remaining, other_steps) } else { (other_steps, remaining) };
            for mut order in interleavings(ada, bob) {
                order.insert(0, (node, *step));
                all.push(order);
            }
        }
        all
    }

    /// Returns which of ada and bob bootstrap, in this order of steps. Neither knows the other; cyd
    /// knows neither.
    fn bootstrapping_nodes(order: &[(usize, Step)]) -> Vec<usize> {
        let names = ["ada", "bob", "cyd"];
        let now = Instant::now();
        let mut promises = names.map(|name| BootstrapPromise::new(candidate(name), DURATION));
        let mut may_ask = [false; 2];
        for (node, step) in order {
            let fleet = fleet_with(&[names[*node]]);
            let mut ask = |target: usize| {
                if !may_ask[*node] {
                    return; // it may not ask
                }
                let reply = promises[target].reply(&candidate(names[*node]), &fleet_with(&[names[target]]), now);
                may_ask[*node] = reply == BootstrapReply::Agreed;
            };
            match step {
                Step::AsksOther => ask(1 - node),
                Step::AsksThird => ask(2),
                Step::BeginsRequest => may_ask[*node] = promises[*node].begin_request(&fleet, now),
                Step::Confirms => may_ask[*node] = may_ask[*node] && promises[*node].confirm(&fleet, now),
            }
        }
        (0..2).filter(|node| may_ask[*node]).collect()
    }

    #[test]
    fn two_nodes_that_ask_a_common_node_never_both_bootstrap() {
        use Step::{AsksOther, AsksThird, BeginsRequest, Confirms};
        for requests in [&[AsksOther][..], &[AsksThird], &[AsksOther, AsksThird], &[AsksThird, AsksOther]] {
            let steps = [&[BeginsRequest], requests, &[Confirms]].concat();
            let all = interleavings(&steps, &steps);
            assert!(all.len() >= 20);
            for order in &all {
                assert!(bootstrapping_nodes(order).len() <= 1, "{order:?}");
            }
        }
        // An unreachable node cannot be distinguished from a node that is alone.
        let isolated = [BeginsRequest, Confirms];
        assert!(interleavings(&isolated, &isolated).iter().all(|order| bootstrapping_nodes(order).len() == 2));
    }

    #[test]
    fn exactly_one_of_two_nodes_that_ask_each_other_bootstraps() {
        use Step::{AsksOther, BeginsRequest, Confirms};
        let steps = |node| [BeginsRequest, AsksOther, Confirms].map(move |step| (node, step));
        let [[a, b, c], [d, e, f]] = [steps(0), steps(1)];
        // Both have asked: the lesser continues.
        assert_eq!(bootstrapping_nodes(&[a, d, b, e, c, f]), [0]);
        assert_eq!(bootstrapping_nodes(&[d, a, e, b, f, c]), [0]);
        // It received the request before it asked, or asked after the other had bootstrapped.
        assert_eq!(bootstrapping_nodes(&[d, e, a, b, c, f]), [1]);
        assert_eq!(bootstrapping_nodes(&[d, f, a, b, c]), [1]);
    }
}
