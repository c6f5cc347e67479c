//! Publications: once over each link, in order for each publisher and key, and then to all who want them there.

use super::agenda::Event;
use super::directory::{Declaration, Route};
use super::{Life, Network, Number, Place};
use crate::bus::Sample;
use rand::RngExt;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;
use tokio::time::Instant;
use zenoh_keyexpr::OwnedKeyExpr;

/// Ends of order (see [`Network::floors`]) kept before those in the past are swept out.
pub(super) const FLOORS_MIN: usize = 4_096;

/// A publication under way, shared by all who will receive it.
pub(super) struct Publication {
    sample: Sample,
    route: Arc<Route>,
    edition: u64,
}

impl Publication {
    fn bytes(&self) -> usize {
        self.route.key.len() + self.sample.payload.len() + self.sample.beside.len()
    }
}

impl Network {
    /// The key, if it was used lately and hence is known to be one.
    pub(in super::super) fn known_key(&self, key: &str) -> Option<OwnedKeyExpr> {
        self.subscriptions.known_route(key).map(|route| route.key.clone())
    }

    pub(in super::super) fn subscribe(
        &mut self,
        life: Life,
        wanted: OwnedKeyExpr,
        mailbox: UnboundedSender<Sample>,
    ) -> Number {
        let number = self.number();
        self.subscriptions.declare(number, Declaration { place: life.place, wanted, complete: false, mailbox });
        number
    }

    pub(in super::super) fn unsubscribe(&mut self, number: Number) {
        self.subscriptions.withdraw(number);
    }

    pub(in super::super) fn publish(&mut self, life: Life, key: &OwnedKeyExpr, sample: Sample) {
        let from = life.place;
        let route = self.subscriptions.route(key);
        if route.targets.is_empty() {
            return;
        }
        let edition = self.subscriptions.edition;
        let publication = Arc::new(Publication { sample, route: Arc::clone(&route), edition });
        for (to, _) in &route.targets {
            self.send_publication(from, *to, &publication);
        }
    }

    fn send_publication(&mut self, from: Place, to: Place, publication: &Arc<Publication>) {
        let bytes = publication.bytes();
        let Some(arrival) = self.cross(from, to, publication.route.kind, Some(bytes)) else { return };
        let to_life = self.life(to);
        let event = |publication: &Arc<Publication>| Event::Publication {
            from,
            to: to_life,
            publication: Arc::clone(publication),
        };
        if from == to {
            self.at(arrival, event(publication));
            return;
        }
        let model = self.model_between(from, to);
        let (duplication, reordering, delay) = (model.duplication, model.reordering, model.reordering_delay);
        if reordering > 0.0 && self.rng.random_bool(reordering) {
            let late = arrival + self.between(Duration::ZERO, delay);
            self.at(late, event(publication));
        } else {
            let due = self.in_order(from, to, publication.route.hash, arrival);
            self.at(due, event(publication));
        }
        if duplication > 0.0 && self.rng.random_bool(duplication) {
            self.counters.duplicated += 1;
            let again = self.now + self.latency(from, to);
            let due = self.in_order(from, to, publication.route.hash, again);
            self.at(due, event(publication));
        }
    }

    /// The arrival, put off until no earlier publication on the key is overtaken.
    fn in_order(&mut self, from: Place, to: Place, key: u64, arrival: Instant) -> Instant {
        if self.floors.len() >= self.floors_max {
            let now = self.now;
            self.floors.retain(|_, floor| *floor > now);
            self.floors_max = FLOORS_MIN.max(2 * self.floors.len());
        }
        let floor = self.floors.entry((from, to, key)).or_insert(arrival);
        *floor = arrival.max(*floor);
        *floor
    }

    pub(super) fn deliver(&mut self, from: Place, to: Life, publication: &Publication) {
        let mut heard = false;
        if self.lives(to) {
            let subscriptions = &mut self.subscriptions;
            let newer =
                (subscriptions.edition != publication.edition).then(|| subscriptions.route(&publication.route.key));
            let route = newer.as_ref().unwrap_or(&publication.route);
            if let Ok(found) = route.targets.binary_search_by_key(&to.place, |(place, _)| *place) {
                for number in &route.targets[found].1 {
                    if let Some(subscription) = subscriptions.declared.get(number) {
                        heard |= subscription.mailbox.send(publication.sample.clone()).is_ok();
                    }
                }
            }
        }
        if heard {
            self.note_received(from, to.place, publication.route.kind, publication.bytes());
            self.trace.note(self.now, from, to.place, publication.route.hash, &publication.sample.payload);
        }
        self.count(heard);
    }
}
