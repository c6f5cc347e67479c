//! Whether a node may found a ledger, as a value: what it has promised to others, and what it tells those who ask.
//!
//! ```text
//!  founder                                      each node that may vote
//!    │ has listened, has met enough, it is its turn
//!    ├── may I? ────────────────────────────────────▶│ knows of no ledger, and has promised it to nobody else;
//!    │◀──────────────────────────────────── agreed ──┤ if it asks itself, the lesser of the two goes on
//!    │ founds                                        │ founds none meanwhile
//! ```
//!
//! Whose turn it is depends on who has been met, and two that have met different nodes may both think that it is their own.
//! Of two that can reach each other when either asks, one at most founds all the same: one refuses, or gives way. So it is with
//! two that cannot, if both reach a third, as long as its promise holds. Two that nobody connects may found a ledger each,
//! unless more than half of all nodes must agree: no rule tells a network that is cut from a fleet that is small.

use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::message::{BootstrapReply, BootstrapRequest};
use std::time::Duration;
use tokio::time::Instant;

/// What a node has heard of the fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ObservedFleet {
    /// A cluster of the fleet's name.
    pub(super) cluster: Option<ClusterId>,
    /// Whether the node's own copy of the ledger has voters.
    pub(super) has_voters: bool,
    /// Whose turn it is to found a ledger, by all that it has met.
    pub(super) next_founder: Option<NodeId>,
}

impl ObservedFleet {
    /// Why nobody is to found a ledger, if so.
    fn of_ledger(&self) -> Option<String> {
        let cluster = self.cluster.map(|cluster| format!("there is a cluster of this name, {cluster}"));
        cluster.or_else(|| self.has_voters.then(|| "there is a ledger of this name".to_owned()))
    }
}

/// To whom a node has left it to found the ledger.
#[derive(Debug)]
pub(super) struct BootstrapPromise {
    me: BootstrapRequest,
    /// How long a promise binds.
    holds: Duration,
    given: Option<(BootstrapRequest, Instant)>,
    founded: bool,
}

impl BootstrapPromise {
    pub(super) fn new(me: BootstrapRequest, holds: Duration) -> BootstrapPromise {
        BootstrapPromise { me, holds, given: None, founded: false }
    }

    fn given_to(&self, now: Instant) -> Option<&BootstrapRequest> {
        self.given.as_ref().filter(|(_, until)| now < *until).map(|(founder, _)| founder)
    }

    /// Answers one that asks. A node that is asking itself gives way to a lesser one.
    pub(super) fn reply(&mut self, founder: &BootstrapRequest, heard: &ObservedFleet, now: Instant) -> BootstrapReply {
        let founded = || self.founded.then(|| format!("{} has founded it", self.me.node));
        let bound = || {
            let gives_way = |to: &BootstrapRequest| *to == self.me && founder < to;
            let other = self.given_to(now).filter(|to| *to != founder && !gives_way(to))?;
            Some(format!("{} is to found it", other.node))
        };
        match founded().or_else(|| heard.of_ledger()).or_else(bound) {
            Some(reason) => BootstrapReply::Refused { reason },
            None => {
                self.given = Some((founder.clone(), now + self.holds));
                BootstrapReply::Agreed
            }
        }
    }

    /// Whether this node may ask the others now; if so, it is bound to nobody but itself.
    pub(super) fn begin_request(&mut self, heard: &ObservedFleet, now: Instant) -> bool {
        let stands = self.is_free(heard, now);
        if stands {
            self.given = Some((self.me.clone(), now + self.holds));
        }
        stands
    }

    /// Whether this node, with which the others have agreed, founds the ledger: unless it has given way, or heard of one, since
    /// it asked.
    pub(super) fn confirm(&mut self, heard: &ObservedFleet, now: Instant) -> bool {
        self.founded = self.given_to(now) == Some(&self.me) && self.is_free(heard, now);
        self.founded
    }

    fn is_free(&self, heard: &ObservedFleet, now: Instant) -> bool {
        let own_turn = heard.of_ledger().is_none() && heard.next_founder.as_ref() == Some(&self.me.node);
        own_turn && self.given_to(now).is_none_or(|founder| *founder == self.me)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOLDS: Duration = Duration::from_secs(1);

    fn founder(name: &str) -> BootstrapRequest {
        BootstrapRequest { mobile: false, on_battery: false, node: NodeId::new(name).unwrap() }
    }

    /// It has met these.
    fn sees(names: &[&str]) -> ObservedFleet {
        ObservedFleet {
            cluster: None,
            has_voters: false,
            next_founder: names.iter().map(|name| founder(name).node).min(),
        }
    }

    fn refused(reason: &str) -> BootstrapReply {
        BootstrapReply::Refused { reason: reason.to_owned() }
    }

    #[test]
    fn a_promise_binds_for_its_time_and_no_longer() {
        let now = Instant::now();
        let mut cyd = BootstrapPromise::new(founder("cyd"), HOLDS);
        let all = sees(&["ada", "bob", "cyd"]);
        assert_eq!(cyd.reply(&founder("bob"), &all, now), BootstrapReply::Agreed);
        let late = now + HOLDS / 2;
        assert_eq!(cyd.reply(&founder("ada"), &all, late), refused("bob is to found it"));
        assert!(!cyd.begin_request(&sees(&["cyd"]), late));
        assert_eq!(cyd.reply(&founder("ada"), &all, now + HOLDS), BootstrapReply::Agreed);
        assert!(cyd.begin_request(&sees(&["cyd"]), now + HOLDS * 2));
    }

    #[test]
    fn nobody_founds_who_hears_of_a_ledger_or_whose_turn_it_is_not() {
        let now = Instant::now();
        let alone = sees(&["bob"]);
        let known = ObservedFleet { cluster: Some(ClusterId(7)), ..alone.clone() };
        let kept = ObservedFleet { has_voters: true, ..alone.clone() };
        for heard in [&known, &kept, &sees(&["ada", "bob"]), &sees(&[])] {
            let mut bob = BootstrapPromise::new(founder("bob"), HOLDS);
            assert!(!bob.begin_request(heard, now), "{heard:?}");
            assert!(bob.begin_request(&alone, now) && !bob.confirm(heard, now), "{heard:?}");
        }
        let mut bob = BootstrapPromise::new(founder("bob"), HOLDS);
        let reason = format!("there is a cluster of this name, {}", ClusterId(7));
        assert_eq!(bob.reply(&founder("ada"), &known, now), refused(&reason));
        assert_eq!(bob.reply(&founder("ada"), &kept, now), refused("there is a ledger of this name"));
        assert!(bob.begin_request(&alone, now) && bob.confirm(&alone, now));
        assert_eq!(bob.reply(&founder("ada"), &alone, now), refused("bob has founded it"));
    }

    /// What happens to one of two that would both found.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    enum Turn {
        Stands,
        AsksTheOther,
        AsksTheThird,
        Founds,
    }

    /// Both orders of every pair of turns, each one's own turns in their order.
    fn orders(ada: &[Turn], bob: &[Turn]) -> Vec<Vec<(usize, Turn)>> {
        if ada.is_empty() && bob.is_empty() {
            return vec![vec![]];
        }
        let mut all = vec![];
        for (who, mine, rest) in [(0, ada, bob), (1, bob, ada)] {
            let Some((turn, left)) = mine.split_first() else { continue };
            let (ada, bob) = if who == 0 { (left, rest) } else { (rest, left) };
            for mut order in orders(ada, bob) {
                order.insert(0, (who, *turn));
                all.push(order);
            }
        }
        all
    }

    /// Who founds, of ada and bob, in this order of turns. Neither has met the other; cyd has met nobody either.
    fn founders(order: &[(usize, Turn)]) -> Vec<usize> {
        let names = ["ada", "bob", "cyd"];
        let now = Instant::now();
        let mut nodes = names.map(|name| BootstrapPromise::new(founder(name), HOLDS));
        let mut stands = [false; 2];
        for (who, turn) in order {
            let own = sees(&[names[*who]]);
            let mut ask = |whom: usize| {
                if !stands[*who] {
                    return; // whoever may not ask does not
                }
                let answer = nodes[whom].reply(&founder(names[*who]), &sees(&[names[whom]]), now);
                stands[*who] = answer == BootstrapReply::Agreed;
            };
            match turn {
                Turn::AsksTheOther => ask(1 - who),
                Turn::AsksTheThird => ask(2),
                Turn::Stands => stands[*who] = nodes[*who].begin_request(&own, now),
                Turn::Founds => stands[*who] = stands[*who] && nodes[*who].confirm(&own, now),
            }
        }
        (0..2).filter(|who| stands[*who]).collect()
    }

    #[test]
    fn of_two_that_ask_each_other_or_a_third_never_both_found_in_whatever_order() {
        use Turn::{AsksTheOther, AsksTheThird, Founds, Stands};
        for asks in [&[AsksTheOther][..], &[AsksTheThird], &[AsksTheOther, AsksTheThird], &[AsksTheThird, AsksTheOther]]
        {
            let turns = [&[Stands], asks, &[Founds]].concat();
            let all = orders(&turns, &turns);
            assert!(all.len() >= 20);
            for order in &all {
                assert!(founders(order).len() <= 1, "{order:?}");
            }
        }
        // Who reaches nobody cannot be told from who is alone.
        let deaf = [Stands, Founds];
        assert!(orders(&deaf, &deaf).iter().all(|order| founders(order).len() == 2));
    }

    #[test]
    fn of_two_that_ask_each_other_at_once_one_founds() {
        use Turn::{AsksTheOther, Founds, Stands};
        let turns = |who| [Stands, AsksTheOther, Founds].map(move |turn| (who, turn));
        let [[a, b, c], [d, e, f]] = [turns(0), turns(1)];
        // Both have asked: the lesser goes on.
        assert_eq!(founders(&[a, d, b, e, c, f]), [0]);
        assert_eq!(founders(&[d, a, e, b, f, c]), [0]);
        // It was asked before it asked, or came when the other had founded.
        assert_eq!(founders(&[d, e, a, b, c, f]), [1]);
        assert_eq!(founders(&[d, f, a, b, c]), [1]);
    }
}
