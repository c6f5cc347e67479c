//! Presence: each node's delayed view of the tokens, and the notification of watchers.

use super::event_queue::Event;
use super::presence_watch::PresenceWatch;
use super::state::{Network, Node};
use crate::bus::Presence;
use crate::mailbox::MailboxSender;
use crate::virtual_bus::ids::{EntityId, Incarnation, NodeIndex};
use std::collections::BTreeMap;
use zenoh_keyexpr::OwnedKeyExpr;

impl Network {
    pub(crate) fn announce(&mut self, incarnation: Incarnation, key: OwnedKeyExpr) -> EntityId {
        let id = self.next_id();
        self.nodes[incarnation.index].tokens.insert(id, key);
        self.send_presence_to_all(incarnation.index);
        id
    }

    pub(crate) fn withdraw_token(&mut self, id: EntityId) {
        let owner = self.nodes.iter_mut().position(|node| node.tokens.remove(&id).is_some());
        if let Some(index) = owner {
            self.send_presence_to_all(index);
        }
    }

    fn send_presence_to_all(&mut self, of: NodeIndex) {
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

    pub(crate) fn watch(
        &mut self,
        incarnation: Incarnation,
        key_expr: OwnedKeyExpr,
        mailbox: MailboxSender<Presence>,
    ) -> EntityId {
        let id = self.next_id();
        let mut watch = PresenceWatch { key_expr, mailbox, present: BTreeMap::new() };
        let node = &mut self.nodes[incarnation.index];
        for peer in &node.peers {
            for key in peer.tokens.values() {
                watch.update(key, true);
            }
        }
        node.watches.insert(id, watch);
        id
    }

    pub(crate) fn stop_watching(&mut self, id: EntityId) {
        for node in &mut self.nodes {
            node.watches.remove(&id);
        }
    }

    /// Sets the view of `of` at `at` to `connected` and `tokens`, and notifies the watchers at
    /// `at`.
    fn update_peer(&mut self, at: NodeIndex, of: NodeIndex, connected: bool, tokens: BTreeMap<EntityId, OwnedKeyExpr>) {
        let Node { peers, watches, .. } = &mut self.nodes[at];
        let peer = &mut peers[of];
        peer.connected = connected;
        let before = std::mem::replace(&mut peer.tokens, tokens);
        let after = &peer.tokens;
        let gone = before.iter().filter(|(id, _)| !after.contains_key(id)).map(|(_, key)| (key, false));
        let new = after.iter().filter(|(id, _)| !before.contains_key(id)).map(|(_, key)| (key, true));
        for (key, alive) in gone.chain(new) {
            watches.values_mut().for_each(|watch| watch.update(key, alive));
        }
    }

    pub(super) fn deliver_presence_update(&mut self, at: NodeIndex, of: NodeIndex) {
        if self.nodes[at].peers[of].silent || !self.nodes[at].alive {
            return; // another update is sent when the silence ends
        }
        let of_now = self.incarnation(of);
        let alive = self.is_running(of_now);
        self.update_peer(at, of, alive, self.nodes[of].tokens.clone());
        self.drop_parts(at, of, |part| !alive || part.service != of_now);
    }

    pub(super) fn expire_lease(&mut self, at: NodeIndex, of: NodeIndex, change: u32) {
        let peer = &self.nodes[at].peers[of];
        if peer.silent && peer.silence_changes == change {
            self.update_peer(at, of, false, BTreeMap::new());
            self.drop_parts(at, of, |_| true);
        }
    }
}
