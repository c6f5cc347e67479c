//! Queries: one leg to each service, which ends when the service lets go of it.

use super::agenda::Event;
use super::directory::Declaration;
use super::{Life, Network, Number, Place};
use crate::bus::virtual_bus::responder::{Leg, Responder};
use crate::bus::{Query, Reply, Whom};
use bytes::Bytes;
use consort_protocol::keys::KeyKind;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;
use tokio::time::Instant;
use zenoh_keyexpr::OwnedKeyExpr;

/// A query that has not ended.
pub(super) struct Pending {
    pub(super) asker: Place,
    replies: UnboundedSender<Reply>,
    /// The latest answer on each key, to be given at the end, where one is enough.
    latest: Option<BTreeMap<String, Reply>>,
    question: Arc<Question>,
    kind: KeyKind,
    /// By number of the service asked.
    legs: BTreeMap<Number, LegState>,
}

impl Drop for Pending {
    fn drop(&mut self) {
        for (_, reply) in self.latest.take().unwrap_or_default() {
            // Nobody may listen any more.
            let _ = self.replies.send(reply);
        }
    }
}

pub(in super::super) struct Question {
    pub(in super::super) wanted: OwnedKeyExpr,
    pub(in super::super) parameters: String,
    pub(in super::super) payload: Bytes,
    pub(in super::super) beside: Bytes,
}

impl Question {
    fn bytes(&self) -> usize {
        self.wanted.len() + self.parameters.len() + self.payload.len() + self.beside.len()
    }
}

/// What is left of one service's part in a query.
pub(super) struct LegState {
    pub(super) service: Life,
    /// Something of it got lost, and so will all that follows.
    broken: bool,
    /// When the latest answer arrives; none arrives before it.
    floor: Instant,
}

/// Bytes of an answer.
fn size(reply: &Reply) -> usize {
    reply.key.len() + reply.payload.as_ref().map_or_else(String::len, Bytes::len) + reply.beside.len()
}

impl Network {
    pub(in super::super) fn serve(
        &mut self,
        life: Life,
        wanted: OwnedKeyExpr,
        complete: bool,
        mailbox: UnboundedSender<Query>,
    ) -> Number {
        let number = self.number();
        self.services.declare(number, Declaration { place: life.place, wanted, complete, mailbox });
        number
    }

    pub(in super::super) fn stop_serving(&mut self, number: Number) {
        self.services.withdraw(number);
    }

    pub(in super::super) fn ask(
        &mut self,
        life: Life,
        question: Question,
        limit: Duration,
        whom: Whom,
        replies: UnboundedSender<Reply>,
    ) -> Number {
        let asker = life.place;
        let query = self.number();
        let route = self.services.route(&question.wanted);
        let mut legs = BTreeMap::new();
        // What is given up is known no more.
        let is_known = |network: &Network, place: Place| {
            !network.nodes[place].peers[asker].cut || network.nodes[asker].peers[place].connected
        };
        let nearest = match whom {
            Whom::All => None,
            Whom::Nearest => {
                let known = || route.complete.iter().filter(|(place, _)| is_known(self, *place));
                known().find(|(place, _)| *place == asker).or_else(|| known().next())
            }
        };
        let alone = nearest.map(|(place, service)| vec![(*place, vec![*service])]);
        for (place, services) in alone.as_ref().unwrap_or(&route.targets) {
            if !is_known(self, *place) {
                continue;
            }
            for service in services {
                let arrival = self.cross(asker, *place, route.kind, Some(question.bytes()));
                let state = LegState { service: self.life(*place), broken: false, floor: self.now };
                if let Some(arrival) = arrival {
                    let leg = Leg { query, service: *service };
                    self.at(arrival, Event::Question { from: asker, to: state.service, leg });
                }
                legs.insert(*service, state);
            }
        }
        if !legs.is_empty() {
            let (kind, question) = (route.kind, Arc::new(question));
            let latest = (whom == Whom::Nearest).then(BTreeMap::new);
            self.queries.insert(query, Pending { asker, replies, latest, question, kind, legs });
            if let Some(end) = self.now.checked_add(limit) {
                self.at(end, Event::Limit { query });
            }
        }
        query
    }

    pub(in super::super) fn stop_asking(&mut self, query: Number) {
        self.queries.remove(&query);
    }

    pub(in super::super) fn answer(&mut self, leg: Leg, reply: Reply) {
        if let Some((from, to, due)) = self.send_answer(leg, Some(size(&reply))) {
            self.at(due, Event::Answer { from, to, leg, reply });
        }
    }

    pub(in super::super) fn finish(&mut self, leg: Leg) {
        if let Some((from, to, due)) = self.send_answer(leg, None) {
            self.at(due, Event::Finished { from, to, leg });
        }
    }

    /// From, to and arrival of the next message of a leg, if the query goes on and the message is not lost. Only
    /// answers, which have a size, are counted; the end of a leg is a message like any other in every other respect.
    fn send_answer(&mut self, leg: Leg, bytes: Option<usize>) -> Option<(Place, Place, Instant)> {
        let pending = self.queries.get(&leg.query)?;
        let state = pending.legs.get(&leg.service)?;
        let (from, to, kind) = (state.service.place, pending.asker, pending.kind);
        if state.broken || !self.lives(state.service) {
            return None;
        }
        let before = self.counters;
        let arrival = self.cross(from, to, kind, bytes);
        if bytes.is_none() {
            self.counters = before;
        }
        let state = self.queries.get_mut(&leg.query)?.legs.get_mut(&leg.service)?;
        match arrival {
            Some(arrival) => {
                state.floor = state.floor.max(arrival);
                Some((from, to, state.floor))
            }
            None => {
                state.broken = true;
                None
            }
        }
    }

    pub(super) fn deliver_question(&mut self, from: Place, to: Life, leg: Leg) {
        let question = self.queries.get(&leg.query).map(|query| (Arc::clone(&query.question), query.kind));
        let service = self.services.declared.get(&leg.service).filter(|_| self.lives(to));
        let (Some((question, kind)), Some(service)) = (question, service) else {
            self.count(false);
            return self.finish(leg); // nobody listens there any more
        };
        let query = Query {
            key: question.wanted.to_string(),
            parameters: question.parameters.clone(),
            payload: question.payload.clone(),
            beside: question.beside.clone(),
            replier: Box::new(Responder::new(self.home.clone(), leg, to, Arc::clone(&question))),
        };
        let heard = service.mailbox.send(query).is_ok();
        self.note_received(from, to.place, kind, question.bytes());
        self.trace.note(self.now, from, to.place, leg.service, &question.payload);
        self.count(heard);
    }

    pub(super) fn deliver_answer(&mut self, from: Place, to: Place, leg: Leg, reply: Reply) {
        let Some(query) = self.queries.get_mut(&leg.query) else { return self.count(false) };
        let content = match &reply.payload {
            Ok(payload) => payload.clone(),
            Err(reason) => Bytes::copy_from_slice(reason.as_bytes()),
        };
        let bytes = size(&reply);
        let kind = query.kind;
        let heard = match &mut query.latest {
            Some(latest) if reply.payload.is_ok() => {
                latest.insert(reply.key.clone(), reply);
                !query.replies.is_closed()
            }
            _ => query.replies.send(reply).is_ok(),
        };
        self.note_received(from, to, kind, bytes);
        self.trace.note(self.now, from, to, leg.service, &content);
        self.count(heard);
    }

    pub(super) fn break_leg(&mut self, leg: Leg) {
        if let Some(state) = self.queries.get_mut(&leg.query).and_then(|query| query.legs.get_mut(&leg.service)) {
            state.broken = true;
        }
    }

    pub(super) fn end_leg(&mut self, leg: Leg) {
        if let Some(query) = self.queries.get_mut(&leg.query) {
            query.legs.remove(&leg.service);
            if query.legs.is_empty() {
                self.queries.remove(&leg.query);
            }
        }
    }

    /// Ends the legs of `at`'s queries at services of `of` that fit.
    pub(super) fn give_up(&mut self, at: Place, of: Place, fits: impl Fn(&LegState) -> bool) {
        self.queries.retain(|_, query| {
            if query.asker == at {
                query.legs.retain(|_, leg| leg.service.place != of || !fits(leg));
            }
            !query.legs.is_empty()
        });
    }
}
