//! Start and crash of nodes, and the processing of events.

use super::event_queue::{Event, ScheduledEvent};
use super::state::{Network, Node, PeerView};
use crate::virtual_bus::ids::{Incarnation, NodeIndex};
use crate::virtual_bus::link::TrafficByKind;
use consort_protocol::ids::NodeId;
use std::cmp::Reverse;
use std::collections::BTreeMap;

impl Network {
    /// Processes all due events, in order.
    pub(crate) fn run(&mut self) {
        while let Some(due) = self.next_due() {
            if due > self.now {
                break;
            }
            let Some(Reverse(entry)) = self.event_queue.pop() else { break };
            self.dispatch(entry);
        }
    }

    /// Returns the present incarnation of a node, and starts the node if it is not running.
    pub(crate) fn start(&mut self, id: NodeId) -> Incarnation {
        let index = match self.indexes.get(&id) {
            Some(&index) if self.nodes[index].alive => return self.incarnation(index),
            Some(&index) => index,
            None => self.add_node(id),
        };
        self.nodes[index].alive = true;
        self.nodes[index].paused = false;
        self.refresh_reachability_of(index);
        for other in 0..self.nodes.len() {
            self.send_presence_update(other, index);
            if other != index {
                self.send_presence_update(index, other);
            }
        }
        self.incarnation(index)
    }

    fn add_node(&mut self, id: NodeId) -> NodeIndex {
        let index = self.nodes.len();
        self.indexes.insert(id.clone(), index);
        for node in &mut self.nodes {
            node.peers.push(PeerView::default());
        }
        self.nodes.push(Node {
            id,
            incarnation: 0,
            alive: false,
            paused: false,
            held_back: Vec::new(),
            tokens: BTreeMap::new(),
            peers: (0..=index).map(|_| PeerView::default()).collect(),
            watches: BTreeMap::new(),
            traffic: TrafficByKind::default(),
        });
        self.refresh_models();
        index
    }

    /// Returns the nodes that node `index` is connected to.
    pub(crate) fn neighbours(&self, index: NodeIndex) -> impl Iterator<Item = &NodeId> {
        self.indexes
            .iter()
            .filter(move |(_, p)| **p != index && self.nodes[index].peers[**p].connected)
            .map(|(id, _)| id)
    }

    /// Crashes a node. Messages that it has sent remain in transit.
    pub(crate) fn crash(&mut self, id: &NodeId) {
        let Some(&index) = self.indexes.get(id) else { return };
        if !self.nodes[index].alive {
            return;
        }
        self.resume(id);
        let node = &mut self.nodes[index];
        node.alive = false;
        node.incarnation += 1;
        node.tokens.clear();
        node.watches.clear();
        for peer in &mut node.peers {
            *peer = PeerView {
                blocked: peer.blocked,
                silent: peer.silent,
                silence_changes: peer.silence_changes + 1,
                ..PeerView::default()
            };
        }
        self.subscriptions.remove_node(index);
        self.services.remove_node(index);
        self.queries.retain(|_, query| query.requester != index);
        for other in (0..self.nodes.len()).filter(|other| *other != index) {
            self.send_presence_update(other, index);
        }
    }

    /// Returns the index of a node that has been started.
    pub(crate) fn index(&self, id: &NodeId) -> Option<NodeIndex> {
        self.indexes.get(id).copied()
    }

    pub(crate) fn pause(&mut self, id: &NodeId) {
        if let Some(&index) = self.indexes.get(id) {
            self.nodes[index].paused = self.nodes[index].alive;
            self.refresh_reachability_of(index);
        }
    }

    pub(crate) fn resume(&mut self, id: &NodeId) {
        if let Some(&index) = self.indexes.get(id) {
            self.nodes[index].paused = false;
            // The old times and ids keep their order among themselves and before later events.
            let held_back = std::mem::take(&mut self.nodes[index].held_back);
            self.event_queue.extend(held_back.into_iter().map(Reverse));
            self.refresh_reachability_of(index);
        }
    }

    fn dispatch(&mut self, entry: ScheduledEvent) {
        if let Some((from, to)) = entry.event.endpoints() {
            if self.nodes[to].paused {
                return self.nodes[to].held_back.push(entry);
            }
            if self.nodes[from].paused {
                return self.nodes[from].held_back.push(entry);
            }
            if self.nodes[to].peers[from].blocked {
                if !matches!(entry.event, Event::Finished { .. }) {
                    self.counters.dropped += 1;
                }
                if let Event::Reply { part, .. } | Event::Finished { part, .. } = entry.event {
                    self.break_part(part);
                }
                return;
            }
        }
        match entry.event {
            Event::Publication { from, to, publication } => self.deliver_publication(from, to, &publication),
            Event::Query { from, to, part } => self.deliver_query(from, to, part),
            Event::Reply { from, to, part, reply } => self.deliver_reply(from, to, part, reply),
            Event::Finished { part, .. } => self.end_part(part),
            Event::QueryTimeout { query } => drop(self.queries.remove(&query)),
            Event::PresenceUpdate { at, of } => self.deliver_presence_update(at, of),
            Event::LeaseExpired { at, of, change } => self.expire_lease(at, of, change),
        }
    }

    /// Returns the traffic of a node over all its incarnations.
    pub(crate) fn traffic(&self, id: &NodeId) -> TrafficByKind {
        self.indexes.get(id).map(|index| self.nodes[*index].traffic.clone()).unwrap_or_default()
    }
}
