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
use consort_protocol::message::{Founder, FoundingAnswer};
use std::time::Duration;
use tokio::time::Instant;

/// What a node has heard of the fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Heard {
    /// A cluster of the fleet's name.
    pub(super) cluster: Option<ClusterId>,
    /// Whether the node's own copy of the ledger has voters.
    pub(super) keeps_ledger: bool,
    /// Whose turn it is to found a ledger, by all that it has met.
    pub(super) turn: Option<NodeId>,
}

impl Heard {
    /// Why nobody is to found a ledger, if so.
    fn of_ledger(&self) -> Option<String> {
        let cluster = self.cluster.map(|cluster| format!("there is a cluster of this name, {cluster}"));
        cluster.or_else(|| self.keeps_ledger.then(|| "there is a ledger of this name".to_owned()))
    }
}

/// To whom a node has left it to found the ledger.
#[derive(Debug)]
pub(super) struct Promise {
    me: Founder,
    /// How long a promise binds.
    holds: Duration,
    given: Option<(Founder, Instant)>,
    founded: bool,
}

impl Promise {
    pub(super) fn new(me: Founder, holds: Duration) -> Promise {
        Promise { me, holds, given: None, founded: false }
    }

    fn given_to(&self, now: Instant) -> Option<&Founder> {
        self.given.as_ref().filter(|(_, until)| now < *until).map(|(founder, _)| founder)
    }

    /// Answers one that asks. A node that is asking itself gives way to a lesser one.
    pub(super) fn answer(&mut self, founder: &Founder, heard: &Heard, now: Instant) -> FoundingAnswer {
        let founded = || self.founded.then(|| format!("{} has founded it", self.me.node));
        let bound = || {
            let gives_way = |to: &Founder| *to == self.me && founder < to;
            let other = self.given_to(now).filter(|to| *to != founder && !gives_way(to))?;
            Some(format!("{} is to found it", other.node))
        };
        match founded().or_else(|| heard.of_ledger()).or_else(bound) {
            Some(reason) => FoundingAnswer::Refused { reason },
            None => {
                self.given = Some((founder.clone(), now + self.holds));
                FoundingAnswer::Agreed
            }
        }
    }

    /// Whether this node may ask the others now; if so, it is bound to nobody but itself.
    pub(super) fn stand(&mut self, heard: &Heard, now: Instant) -> bool {
        let stands = self.is_free(heard, now);
        if stands {
            self.given = Some((self.me.clone(), now + self.holds));
        }
        stands
    }

    /// Whether this node, with which the others have agreed, founds the ledger: unless it has given way, or heard of one, since
    /// it asked.
    pub(super) fn found(&mut self, heard: &Heard, now: Instant) -> bool {
        self.founded = self.given_to(now) == Some(&self.me) && self.is_free(heard, now);
        self.founded
    }

    fn is_free(&self, heard: &Heard, now: Instant) -> bool {
        let own_turn = heard.of_ledger().is_none() && heard.turn.as_ref() == Some(&self.me.node);
        own_turn && self.given_to(now).is_none_or(|founder| *founder == self.me)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOLDS: Duration = Duration::from_secs(1);

    fn founder(name: &str) -> Founder {
        Founder { mobile: false, on_battery: false, node: NodeId::new(name).unwrap() }
    }

    /// It has met these.
    fn sees(names: &[&str]) -> Heard {
        Heard { cluster: None, keeps_ledger: false, turn: names.iter().map(|name| founder(name).node).min() }
    }

    fn refused(reason: &str) -> FoundingAnswer {
        FoundingAnswer::Refused { reason: reason.to_owned() }
    }

    #[test]
    fn a_promise_binds_for_its_time_and_no_longer() {
        let now = Instant::now();
        let mut cyd = Promise::new(founder("cyd"), HOLDS);
        let all = sees(&["ada", "bob", "cyd"]);
        assert_eq!(cyd.answer(&founder("bob"), &all, now), FoundingAnswer::Agreed);
        let late = now + HOLDS / 2;
        assert_eq!(cyd.answer(&founder("ada"), &all, late), refused("bob is to found it"));
        assert!(!cyd.stand(&sees(&["cyd"]), late));
        assert_eq!(cyd.answer(&founder("ada"), &all, now + HOLDS), FoundingAnswer::Agreed);
        assert!(cyd.stand(&sees(&["cyd"]), now + HOLDS * 2));
    }

    #[test]
    fn nobody_founds_who_hears_of_a_ledger_or_whose_turn_it_is_not() {
        let now = Instant::now();
        let alone = sees(&["bob"]);
        let known = Heard { cluster: Some(ClusterId(7)), ..alone.clone() };
        let kept = Heard { keeps_ledger: true, ..alone.clone() };
        for heard in [&known, &kept, &sees(&["ada", "bob"]), &sees(&[])] {
            let mut bob = Promise::new(founder("bob"), HOLDS);
            assert!(!bob.stand(heard, now), "{heard:?}");
            assert!(bob.stand(&alone, now) && !bob.found(heard, now), "{heard:?}");
        }
        let mut bob = Promise::new(founder("bob"), HOLDS);
        let reason = format!("there is a cluster of this name, {}", ClusterId(7));
        assert_eq!(bob.answer(&founder("ada"), &known, now), refused(&reason));
        assert_eq!(bob.answer(&founder("ada"), &kept, now), refused("there is a ledger of this name"));
        assert!(bob.stand(&alone, now) && bob.found(&alone, now));
        assert_eq!(bob.answer(&founder("ada"), &alone, now), refused("bob has founded it"));
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
        let mut nodes = names.map(|name| Promise::new(founder(name), HOLDS));
        let mut stands = [false; 2];
        for (who, turn) in order {
            let own = sees(&[names[*who]]);
            let mut ask = |whom: usize| {
                if !stands[*who] {
                    return; // whoever may not ask does not
                }
                let answer = nodes[whom].answer(&founder(names[*who]), &sees(&[names[whom]]), now);
                stands[*who] = answer == FoundingAnswer::Agreed;
            };
            match turn {
                Turn::AsksTheOther => ask(1 - who),
                Turn::AsksTheThird => ask(2),
                Turn::Stands => stands[*who] = nodes[*who].stand(&own, now),
                Turn::Founds => stands[*who] = stands[*who] && nodes[*who].found(&own, now),
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
