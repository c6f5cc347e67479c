//! Presence: tokens as each node knows them, which is later than they are, and what watchers hear of it.

use super::event_queue::Event;
use super::{EntityId, Incarnation, Network, NodeIndex};
use crate::bus::Presence;
use std::collections::BTreeMap;
use tokio::sync::mpsc::UnboundedSender;
use zenoh_keyexpr::OwnedKeyExpr;

pub(super) struct PresenceWatch {
    pub(super) node: NodeIndex,
    wanted: OwnedKeyExpr,
    mailbox: UnboundedSender<Presence>,
    /// How many tokens are known under each key.
    present: BTreeMap<String, u32>,
}

impl Network {
    pub(in super::super) fn announce(&mut self, life: Incarnation, key: OwnedKeyExpr) -> EntityId {
        let number = self.next_id();
        self.nodes[life.index].tokens.insert(number, key);
        self.spread(life.index);
        number
    }

    pub(in super::super) fn withdraw_token(&mut self, number: EntityId) {
        let owner = self.nodes.iter_mut().position(|node| node.tokens.remove(&number).is_some());
        if let Some(place) = owner {
            self.spread(place);
        }
    }

    fn spread(&mut self, of: NodeIndex) {
        for at in 0..self.nodes.len() {
            self.send_presence_update(at, of);
        }
    }

    pub(super) fn send_presence_update(&mut self, at: NodeIndex, of: NodeIndex) {
        if !self.nodes[at].peers[of].silent {
            let latency = self.latency(of, at);
            self.schedule(self.now + latency, Event::PresenceUpdate { at, of });
        }
    }

    pub(in super::super) fn watch(
        &mut self,
        life: Incarnation,
        wanted: OwnedKeyExpr,
        mailbox: UnboundedSender<Presence>,
    ) -> EntityId {
        let number = self.next_id();
        let mut watch = PresenceWatch { node: life.index, wanted, mailbox, present: BTreeMap::new() };
        for peer in &self.nodes[life.index].peers {
            for key in peer.tokens.values() {
                watch.see(key, true);
            }
        }
        self.watches.insert(number, watch);
        number
    }

    pub(in super::super) fn stop_watching(&mut self, number: EntityId) {
        self.watches.remove(&number);
    }

    /// Brings what `at` knows of `of` to `connected` and `tokens`, and tells those who watch at `at`.
    fn learn(&mut self, at: NodeIndex, of: NodeIndex, connected: bool, tokens: BTreeMap<EntityId, OwnedKeyExpr>) {
        let peer = &mut self.nodes[at].peers[of];
        peer.connected = connected;
        let before = std::mem::replace(&mut peer.tokens, tokens);
        let after = &self.nodes[at].peers[of].tokens;
        let gone = before.iter().filter(|(number, _)| !after.contains_key(number)).map(|(_, key)| (key, false));
        let new = after.iter().filter(|(number, _)| !before.contains_key(number)).map(|(_, key)| (key, true));
        for (key, alive) in gone.chain(new) {
            for watch in self.watches.values_mut().filter(|watch| watch.node == at) {
                watch.see(key, alive);
            }
        }
    }

    pub(super) fn deliver_presence_update(&mut self, at: NodeIndex, of: NodeIndex) {
        if self.nodes[at].peers[of].silent || !self.nodes[at].alive {
            return; // news travel again when the silence ends
        }
        let of_now = self.incarnation(of);
        let alive = self.is_running(of_now);
        self.learn(at, of, alive, self.nodes[of].tokens.clone());
        self.drop_parts(at, of, |leg| !alive || leg.service != of_now);
    }

    pub(super) fn expire_lease(&mut self, at: NodeIndex, of: NodeIndex, change: u32) {
        let peer = &self.nodes[at].peers[of];
        if peer.silent && peer.silence_changes == change {
            self.learn(at, of, false, BTreeMap::new());
            self.drop_parts(at, of, |_| true);
        }
    }
}

impl PresenceWatch {
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
