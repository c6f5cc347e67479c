//! Queries: one leg to each service, which ends when the service lets go of it.

use super::event_queue::Event;
use super::routing_table::Declaration;
use super::{EntityId, Incarnation, Network, NodeIndex};
use crate::bus::virtual_bus::responder::{QueryPart, VirtualReplier};
use crate::bus::{Query, Reply, ServiceSelection};
use bytes::Bytes;
use consort_protocol::keys::KeyKind;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;
use tokio::time::Instant;
use zenoh_keyexpr::OwnedKeyExpr;

/// A query that has not ended.
pub(super) struct PendingQuery {
    pub(super) requester: NodeIndex,
    replies: UnboundedSender<Reply>,
    /// The latest answer on each key, to be given at the end, where one is enough.
    latest: Option<BTreeMap<String, Reply>>,
    question: Arc<QueryRequest>,
    kind: KeyKind,
    /// By number of the service asked.
    legs: BTreeMap<EntityId, QueryPartState>,
}

impl Drop for PendingQuery {
    fn drop(&mut self) {
        for (_, reply) in self.latest.take().unwrap_or_default() {
            // Nobody may listen any more.
            let _ = self.replies.send(reply);
        }
    }
}

pub(in super::super) struct QueryRequest {
    pub(in super::super) key_expr: OwnedKeyExpr,
    pub(in super::super) parameters: String,
    pub(in super::super) payload: Bytes,
    pub(in super::super) attachment: Bytes,
}

impl QueryRequest {
    fn bytes(&self) -> usize {
        self.key_expr.len() + self.parameters.len() + self.payload.len() + self.attachment.len()
    }
}

/// What is left of one service's part in a query.
pub(super) struct QueryPartState {
    pub(super) service: Incarnation,
    /// Something of it got lost, and so will all that follows.
    broken: bool,
    /// When the latest answer arrives; none arrives before it.
    floor: Instant,
}

/// Bytes of an answer.
fn size(reply: &Reply) -> usize {
    reply.key.len() + reply.payload.as_ref().map_or_else(String::len, Bytes::len) + reply.attachment.len()
}

impl Network {
    pub(in super::super) fn serve(
        &mut self,
        life: Incarnation,
        wanted: OwnedKeyExpr,
        complete: bool,
        mailbox: UnboundedSender<Query>,
    ) -> EntityId {
        let number = self.next_id();
        self.services.declare(number, Declaration { node: life.index, key_expr: wanted, complete, mailbox });
        number
    }

    pub(in super::super) fn stop_serving(&mut self, number: EntityId) {
        self.services.remove(number);
    }

    pub(in super::super) fn query(
        &mut self,
        life: Incarnation,
        question: QueryRequest,
        limit: Duration,
        whom: ServiceSelection,
        replies: UnboundedSender<Reply>,
    ) -> EntityId {
        let asker = life.index;
        let query = self.next_id();
        let route = self.services.route(&question.key_expr);
        let mut legs = BTreeMap::new();
        // What is given up is known no more.
        let is_known = |network: &Network, place: NodeIndex| {
            !network.nodes[place].peers[asker].blocked || network.nodes[asker].peers[place].connected
        };
        let nearest = match whom {
            ServiceSelection::All => None,
            ServiceSelection::Nearest => {
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
                let arrival = self.transmit(asker, *place, route.kind, Some(question.bytes()));
                let state = QueryPartState { service: self.incarnation(*place), broken: false, floor: self.now };
                if let Some(arrival) = arrival {
                    let leg = QueryPart { query, service: *service };
                    self.schedule(arrival, Event::Query { from: asker, to: state.service, leg });
                }
                legs.insert(*service, state);
            }
        }
        if !legs.is_empty() {
            let (kind, question) = (route.kind, Arc::new(question));
            let latest = (whom == ServiceSelection::Nearest).then(BTreeMap::new);
            self.queries.insert(query, PendingQuery { requester: asker, replies, latest, question, kind, legs });
            if let Some(end) = self.now.checked_add(limit) {
                self.schedule(end, Event::QueryTimeout { query });
            }
        }
        query
    }

    pub(in super::super) fn cancel_query(&mut self, query: EntityId) {
        self.queries.remove(&query);
    }

    pub(in super::super) fn reply(&mut self, leg: QueryPart, reply: Reply) {
        if let Some((from, to, due)) = self.send_answer(leg, Some(size(&reply))) {
            self.schedule(due, Event::Reply { from, to, leg, reply });
        }
    }

    pub(in super::super) fn finish_part(&mut self, leg: QueryPart) {
        if let Some((from, to, due)) = self.send_answer(leg, None) {
            self.schedule(due, Event::Finished { from, to, leg });
        }
    }

    /// From, to and arrival of the next message of a leg, if the query goes on and the message is not lost. Only
    /// answers, which have a size, are counted; the end of a leg is a message like any other in every other respect.
    fn send_answer(&mut self, leg: QueryPart, bytes: Option<usize>) -> Option<(NodeIndex, NodeIndex, Instant)> {
        let pending = self.queries.get(&leg.query)?;
        let state = pending.legs.get(&leg.service)?;
        let (from, to, kind) = (state.service.index, pending.requester, pending.kind);
        if state.broken || !self.is_running(state.service) {
            return None;
        }
        let before = self.counters;
        let arrival = self.transmit(from, to, kind, bytes);
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

    pub(super) fn deliver_query(&mut self, from: NodeIndex, to: Incarnation, leg: QueryPart) {
        let question = self.queries.get(&leg.query).map(|query| (Arc::clone(&query.question), query.kind));
        let service = self.services.declared.get(&leg.service).filter(|_| self.is_running(to));
        let (Some((question, kind)), Some(service)) = (question, service) else {
            self.count_delivery(false);
            return self.finish_part(leg); // nobody listens there any more
        };
        let query = Query {
            key: question.key_expr.to_string(),
            parameters: question.parameters.clone(),
            payload: question.payload.clone(),
            attachment: question.attachment.clone(),
            replier: Box::new(VirtualReplier::new(self.shared.clone(), leg, to, Arc::clone(&question))),
        };
        let heard = service.mailbox.send(query).is_ok();
        self.count_received(from, to.index, kind, question.bytes());
        self.trace.record(self.now, from, to.index, leg.service, &question.payload);
        self.count_delivery(heard);
    }

    pub(super) fn deliver_reply(&mut self, from: NodeIndex, to: NodeIndex, leg: QueryPart, reply: Reply) {
        let Some(query) = self.queries.get_mut(&leg.query) else { return self.count_delivery(false) };
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
        self.count_received(from, to, kind, bytes);
        self.trace.record(self.now, from, to, leg.service, &content);
        self.count_delivery(heard);
    }

    pub(super) fn break_part(&mut self, leg: QueryPart) {
        if let Some(state) = self.queries.get_mut(&leg.query).and_then(|query| query.legs.get_mut(&leg.service)) {
            state.broken = true;
        }
    }

    pub(super) fn end_part(&mut self, leg: QueryPart) {
        if let Some(query) = self.queries.get_mut(&leg.query) {
            query.legs.remove(&leg.service);
            if query.legs.is_empty() {
                self.queries.remove(&leg.query);
            }
        }
    }

    /// Ends the legs of `at`'s queries at services of `of` that fit.
    pub(super) fn drop_parts(&mut self, at: NodeIndex, of: NodeIndex, fits: impl Fn(&QueryPartState) -> bool) {
        self.queries.retain(|_, query| {
            if query.requester == at {
                query.legs.retain(|_, leg| leg.service.index != of || !fits(leg));
            }
            !query.legs.is_empty()
        });
    }
}
