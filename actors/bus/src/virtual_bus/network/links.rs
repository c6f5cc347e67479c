//! Reachability between nodes, and latencies.

use super::event_queue::Event;
use super::state::Network;
use crate::virtual_bus::faults::Faults;
use crate::virtual_bus::ids::NodeIndex;
use crate::virtual_bus::link::{LinkModel, MessageClass};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Priority;
use rand::RngExt;
use std::time::Duration;
use tokio::time::Instant;

impl Network {
    pub(crate) fn set_model(&mut self, model: LinkModel) {
        self.model = model.validated();
        self.models.clear();
        self.refresh_models();
    }

    pub(crate) fn set_model_between(&mut self, from: NodeId, to: NodeId, model: LinkModel) {
        self.models.insert((from, to), model.validated());
        self.refresh_models();
    }

    pub(super) fn refresh_models(&mut self) {
        let index = |id: &NodeId| self.indexes.get(id).copied();
        self.models_by_index = self
            .models
            .iter()
            .filter_map(|((from, to), model)| Some(((index(from)?, index(to)?), model.clone())))
            .collect();
    }

    pub(crate) fn set_lease(&mut self, lease: Duration) {
        self.lease = lease;
    }

    pub(crate) fn change_faults(&mut self, change: impl FnOnce(&mut Faults)) {
        change(&mut self.faults);
        self.refresh_reachability();
    }

    /// Recomputes the reachability of all nodes from the faults in force. A lease begins when a node
    /// falls silent; a presence update is sent when the silence ends.
    fn refresh_reachability(&mut self) {
        for at in 0..self.nodes.len() {
            for of in 0..self.nodes.len() {
                self.refresh_reachability_between(at, of);
            }
        }
    }

    /// Recomputes the reachability of a node, in the same order.
    pub(super) fn refresh_reachability_of(&mut self, node: NodeIndex) {
        for at in 0..self.nodes.len() {
            if at == node {
                (0..self.nodes.len()).for_each(|of| self.refresh_reachability_between(at, of));
            } else {
                self.refresh_reachability_between(at, node);
            }
        }
    }

    fn refresh_reachability_between(&mut self, at: NodeIndex, of: NodeIndex) {
        if at == of {
            return;
        }
        let cut = self.faults.blocks(&self.nodes[of].id, &self.nodes[at].id);
        let silent = cut || self.nodes[at].paused || self.nodes[of].paused;
        let peer = &mut self.nodes[at].peers[of];
        peer.blocked = cut;
        if peer.silent == silent {
            return;
        }
        peer.silent = silent;
        peer.silence_changes += 1;
        let change = peer.silence_changes;
        if silent {
            if let Some(end) = self.now.checked_add(self.lease) {
                self.schedule(end, Event::LeaseExpired { at, of, change });
            }
        } else {
            self.send_presence_update(at, of);
        }
    }

    /// Returns the arrival time of a message sent now, or `None` if it is lost. A message without a
    /// size does not count as traffic.
    pub(super) fn transmit(
        &mut self,
        from: NodeIndex,
        to: NodeIndex,
        class: MessageClass,
        bytes: Option<usize>,
    ) -> Option<Instant> {
        self.counters.sent += 1;
        if from == to {
            return Some(self.now);
        }
        if let Some(bytes) = bytes {
            self.nodes[from].traffic.sent(class.kind, bytes);
        }
        if self.nodes[to].peers[from].blocked {
            self.counters.dropped += 1;
            return None;
        }
        let loss = self.model_between(from, to).loss;
        if loss > 0.0 && self.rng.random_bool(loss) {
            self.counters.dropped += 1;
            return None;
        }
        let sent_at = self.sent_at(from, to, class.priority, bytes.unwrap_or_default());
        Some(sent_at + self.latency(from, to))
    }

    /// Returns the time at which a link will have sent a message.
    fn sent_at(&mut self, from: NodeIndex, to: NodeIndex, priority: Priority, bytes: usize) -> Instant {
        let Some(bandwidth) = self.model_between(from, to).bandwidth else { return self.now };
        self.link_queues.entry((from, to)).or_default().send(self.now, priority, bytes, bandwidth)
    }

    pub(super) fn latency(&mut self, from: NodeIndex, to: NodeIndex) -> Duration {
        if from == to {
            return Duration::ZERO;
        }
        let model = self.model_between(from, to);
        let (min, max) = (model.latency_min, model.latency_max);
        self.random_duration(min, max)
    }

    pub(super) fn random_duration(&mut self, min: Duration, max: Duration) -> Duration {
        if min >= max {
            return min;
        }
        let spread = u64::try_from((max - min).as_nanos()).unwrap_or(u64::MAX);
        min + Duration::from_nanos(self.rng.random_range(0..=spread))
    }

    pub(super) fn model_between(&self, from: NodeIndex, to: NodeIndex) -> &LinkModel {
        if self.models_by_index.is_empty() {
            return &self.model;
        }
        self.models_by_index.get(&(from, to)).unwrap_or(&self.model)
    }
}
