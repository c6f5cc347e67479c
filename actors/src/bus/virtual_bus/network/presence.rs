//! Presence: tokens as each node knows them, which is later than they are, and what watchers hear of it.

use super::agenda::Event;
use super::{Life, Network, Number, Place};
use crate::bus::Presence;
use std::collections::BTreeMap;
use tokio::sync::mpsc::UnboundedSender;
use zenoh_keyexpr::OwnedKeyExpr;

pub(super) struct Watch {
    pub(super) place: Place,
    wanted: OwnedKeyExpr,
    mailbox: UnboundedSender<Presence>,
    /// How many tokens are known under each key.
    present: BTreeMap<String, u32>,
}

impl Network {
    pub(in super::super) fn announce(&mut self, life: Life, key: OwnedKeyExpr) -> Number {
        let number = self.number();
        self.nodes[life.place].tokens.insert(number, key);
        self.spread(life.place);
        number
    }

    pub(in super::super) fn renounce(&mut self, number: Number) {
        let owner = self.nodes.iter_mut().position(|node| node.tokens.remove(&number).is_some());
        if let Some(place) = owner {
            self.spread(place);
        }
    }

    fn spread(&mut self, of: Place) {
        for at in 0..self.nodes.len() {
            self.tell_news(at, of);
        }
    }

    pub(super) fn tell_news(&mut self, at: Place, of: Place) {
        if !self.nodes[at].peers[of].silent {
            let latency = self.latency(of, at);
            self.at(self.now + latency, Event::News { at, of });
        }
    }

    pub(in super::super) fn watch(
        &mut self,
        life: Life,
        wanted: OwnedKeyExpr,
        mailbox: UnboundedSender<Presence>,
    ) -> Number {
        let number = self.number();
        let mut watch = Watch { place: life.place, wanted, mailbox, present: BTreeMap::new() };
        for peer in &self.nodes[life.place].peers {
            for key in peer.tokens.values() {
                watch.see(key, true);
            }
        }
        self.watches.insert(number, watch);
        number
    }

    pub(in super::super) fn stop_watching(&mut self, number: Number) {
        self.watches.remove(&number);
    }

    /// Brings what `at` knows of `of` to `connected` and `tokens`, and tells those who watch at `at`.
    fn learn(&mut self, at: Place, of: Place, connected: bool, tokens: BTreeMap<Number, OwnedKeyExpr>) {
        let peer = &mut self.nodes[at].peers[of];
        peer.connected = connected;
        let before = std::mem::replace(&mut peer.tokens, tokens);
        let after = &self.nodes[at].peers[of].tokens;
        let gone = before.iter().filter(|(number, _)| !after.contains_key(number)).map(|(_, key)| (key, false));
        let new = after.iter().filter(|(number, _)| !before.contains_key(number)).map(|(_, key)| (key, true));
        for (key, alive) in gone.chain(new) {
            for watch in self.watches.values_mut().filter(|watch| watch.place == at) {
                watch.see(key, alive);
            }
        }
    }

    pub(super) fn deliver_news(&mut self, at: Place, of: Place) {
        if self.nodes[at].peers[of].silent || !self.nodes[at].alive {
            return; // news travel again when the silence ends
        }
        let of_now = self.life(of);
        let alive = self.lives(of_now);
        self.learn(at, of, alive, self.nodes[of].tokens.clone());
        self.give_up(at, of, |leg| !alive || leg.service != of_now);
    }

    pub(super) fn end_lease(&mut self, at: Place, of: Place, change: u32) {
        let peer = &self.nodes[at].peers[of];
        if peer.silent && peer.change == change {
            self.learn(at, of, false, BTreeMap::new());
            self.give_up(at, of, |_| true);
        }
    }
}

impl Watch {
    fn see(&mut self, key: &OwnedKeyExpr, alive: bool) {
        if !self.wanted.intersects(key) {
            return;
        }
        let count = self.present.entry(key.to_string()).or_insert(0);
        let before = *count;
        *count = if alive { before + 1 } else { before.saturating_sub(1) };
        let after = *count;
        if after == 0 {
            self.present.remove(key.as_str());
        }
        if (before == 0) != (after == 0) {
            // A watcher that is gone has no ear for this.
            let _ = self.mailbox.send(Presence { key: key.to_string(), alive });
        }
    }
}
