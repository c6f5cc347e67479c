//! Publications: each crosses a link once, in order per publisher and key, and is then delivered to
//! all subscribers of the node.

use super::event_queue::Event;
use super::publication::{EARLIEST_ARRIVALS_MIN, Publication};
use super::routing_table::Declaration;
use super::state::Network;
use crate::bus::Sample;
use crate::mailbox::MailboxSender;
use crate::virtual_bus::ids::{EntityId, Incarnation, NodeIndex};
use rand::RngExt;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use zenoh_keyexpr::OwnedKeyExpr;

impl Network {
    /// Returns the key if it was used recently, and hence is known to be valid.
    pub(crate) fn cached_key(&self, key: &str) -> Option<OwnedKeyExpr> {
        self.subscriptions.cached_route(key).map(|route| route.key.clone())
    }

    pub(crate) fn subscribe(
        &mut self,
        incarnation: Incarnation,
        key_expr: OwnedKeyExpr,
        mailbox: MailboxSender<Sample>,
    ) -> EntityId {
        let id = self.next_id();
        self.subscriptions.declare(id, Declaration { node: incarnation.index, key_expr, complete: false, mailbox });
        id
    }

    pub(crate) fn unsubscribe(&mut self, id: EntityId) {
        self.subscriptions.remove(id);
    }

    pub(crate) fn publish(&mut self, incarnation: Incarnation, key: &OwnedKeyExpr, sample: Sample) {
        let from = incarnation.index;
        let route = self.subscriptions.route(key);
        if route.targets.is_empty() {
            return;
        }
        let edition = self.subscriptions.version;
        let publication = Arc::new(Publication { sample, route: Arc::clone(&route), edition });
        for (to, _) in &route.targets {
            self.send_publication(from, *to, &publication);
        }
    }

    fn send_publication(&mut self, from: NodeIndex, to: NodeIndex, publication: &Arc<Publication>) {
        let bytes = publication.bytes();
        let Some(arrival) = self.transmit(from, to, publication.route.class, Some(bytes)) else { return };
        let receiver = self.incarnation(to);
        let event = |publication: &Arc<Publication>| Event::Publication {
            from,
            to: receiver,
            publication: Arc::clone(publication),
        };
        if from == to {
            self.schedule(arrival, event(publication));
            return;
        }
        let model = self.model_between(from, to);
        let (duplication, reordering, delay) = (model.duplication, model.reordering, model.reordering_delay);
        if reordering > 0.0 && self.rng.random_bool(reordering) {
            let late = arrival + self.random_duration(Duration::ZERO, delay);
            self.schedule(late, event(publication));
        } else {
            let due = self.in_order(from, to, publication.route.hash, arrival);
            self.schedule(due, event(publication));
        }
        if duplication > 0.0 && self.rng.random_bool(duplication) {
            self.counters.duplicated += 1;
            let again = self.now + self.latency(from, to);
            let due = self.in_order(from, to, publication.route.hash, again);
            self.schedule(due, event(publication));
        }
    }

    /// Returns the arrival time, delayed so that no earlier publication on the key is overtaken.
    fn in_order(&mut self, from: NodeIndex, to: NodeIndex, key: u64, arrival: Instant) -> Instant {
        if self.earliest_arrivals.len() >= self.earliest_arrivals_max {
            let now = self.now;
            self.earliest_arrivals.retain(|_, earliest| *earliest > now);
            self.earliest_arrivals_max = EARLIEST_ARRIVALS_MIN.max(2 * self.earliest_arrivals.len());
        }
        let earliest = self.earliest_arrivals.entry((from, to, key)).or_insert(arrival);
        *earliest = arrival.max(*earliest);
        *earliest
    }

    pub(super) fn deliver_publication(&mut self, from: NodeIndex, to: Incarnation, publication: &Publication) {
        let mut delivered = false;
        if self.is_running(to) {
            let subscriptions = &mut self.subscriptions;
            let newer =
                (subscriptions.version != publication.edition).then(|| subscriptions.route(&publication.route.key));
            let route = newer.as_ref().unwrap_or(&publication.route);
            if let Ok(found) = route.targets.binary_search_by_key(&to.index, |(index, _)| *index) {
                for id in &route.targets[found].1 {
                    if let Some(subscription) = subscriptions.declared.get(id) {
                        delivered |= subscription.mailbox.send(publication.sample.clone());
                    }
                }
            }
        }
        if delivered {
            self.count_received(from, to.index, publication.route.class.kind, publication.bytes());
            self.trace.record(self.now, from, to.index, publication.route.hash, &publication.sample.payload);
        }
        self.count_delivery(delivered);
    }
}
