//! Queries: a part per service, which ends when the service drops its replier.

use super::event_queue::Event;
use super::pending_query::{PendingQuery, QueryPartState};
use super::routing_table::Declaration;
use super::state::Network;
use crate::author::Author;
use crate::bus::{Query, Reply, RequestAuthority, ServiceSelection};
use crate::mailbox::{Item as _, MailboxSender};
use crate::open_queries::{BUSY, QuerySender};
use crate::virtual_bus::ids::{EntityId, Incarnation, NodeIndex, QueryPart};
use crate::virtual_bus::responder::{QueryRequest, VirtualReplier};
use bytes::Bytes;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;
use zenoh_keyexpr::OwnedKeyExpr;

/// Returns the size of a reply in bytes.
fn size(reply: &Reply) -> usize {
    reply.key.len() + reply.bytes()
}

impl Network {
    pub(crate) fn serve(
        &mut self,
        incarnation: Incarnation,
        key_expr: OwnedKeyExpr,
        complete: bool,
        mailbox: QuerySender,
    ) -> EntityId {
        let id = self.next_id();
        self.services.declare(id, Declaration { node: incarnation.index, key_expr, complete, mailbox });
        id
    }

    pub(crate) fn stop_serving(&mut self, id: EntityId) {
        self.services.remove(id);
    }

    pub(crate) fn query(
        &mut self,
        incarnation: Incarnation,
        request: QueryRequest,
        timeout: Duration,
        target: ServiceSelection,
        replies: MailboxSender<Reply>,
    ) -> EntityId {
        let requester = incarnation.index;
        let query = self.next_id();
        let route = self.services.route(&request.key_expr);
        let mut parts = BTreeMap::new();
        // A peer with an expired lease no longer counts as present.
        let is_present = |network: &Network, index: NodeIndex| {
            !network.nodes[index].peers[requester].blocked || network.nodes[requester].peers[index].connected
        };
        let nearest = match target {
            ServiceSelection::All => None,
            ServiceSelection::Nearest => {
                let present = || route.complete.iter().filter(|(index, _)| is_present(self, *index));
                present().find(|(index, _)| *index == requester).or_else(|| present().next())
            }
        };
        let selected = nearest.map(|(index, service)| vec![(*index, vec![*service])]);
        for (index, services) in selected.as_ref().unwrap_or(&route.targets) {
            if !is_present(self, *index) {
                continue;
            }
            for service in services {
                let arrival = self.transmit(requester, *index, route.class, Some(request.bytes()));
                let blocked = self.faults.blocks_query(&self.nodes[*index].id, &request.key_expr);
                let arrival = arrival.filter(|_| !blocked);
                let state = QueryPartState { service: self.incarnation(*index), broken: false, earliest: self.now };
                if let Some(arrival) = arrival {
                    let part = QueryPart { query, service: *service };
                    self.schedule(arrival, Event::Query { from: requester, to: state.service, part });
                }
                parts.insert(*service, state);
            }
        }
        if !parts.is_empty() {
            let (class, request) = (route.class, Arc::new(request));
            let latest = (target == ServiceSelection::Nearest).then(BTreeMap::new);
            self.queries.insert(query, PendingQuery { requester, replies, latest, request, class, parts });
            if let Some(end) = self.now.checked_add(timeout) {
                self.schedule(end, Event::QueryTimeout { query });
            }
        }
        query
    }

    pub(crate) fn cancel_query(&mut self, query: EntityId) {
        self.queries.remove(&query);
    }

    pub(crate) fn reply(&mut self, part: QueryPart, reply: Reply) {
        if let Some((from, to, due)) = self.transmit_from_service(part, Some(size(&reply))) {
            self.schedule(due, Event::Reply { from, to, part, reply });
        }
    }

    pub(crate) fn finish_part(&mut self, part: QueryPart) {
        if let Some((from, to, due)) = self.transmit_from_service(part, None) {
            self.schedule(due, Event::Finished { from, to, part });
        }
    }

    /// Returns sender, receiver and arrival time of the next message of a part, if the query is
    /// active and the message is not lost. Only replies, which have a size, are counted; in all
    /// other respects the end of a part is a message like any other.
    fn transmit_from_service(
        &mut self,
        part: QueryPart,
        bytes: Option<usize>,
    ) -> Option<(NodeIndex, NodeIndex, Instant)> {
        let pending = self.queries.get(&part.query)?;
        let state = pending.parts.get(&part.service)?;
        let (from, to, class) = (state.service.index, pending.requester, pending.class);
        if state.broken || !self.is_running(state.service) {
            return None;
        }
        let before = self.counters;
        let arrival = self.transmit(from, to, class, bytes);
        if bytes.is_none() {
            self.counters = before;
        }
        let state = self.queries.get_mut(&part.query)?.parts.get_mut(&part.service)?;
        match arrival {
            Some(arrival) => {
                state.earliest = state.earliest.max(arrival);
                Some((from, to, state.earliest))
            }
            None => {
                state.broken = true;
                None
            }
        }
    }

    pub(super) fn deliver_query(&mut self, from: NodeIndex, to: Incarnation, part: QueryPart) {
        let request = self.queries.get(&part.query).map(|query| (Arc::clone(&query.request), query.class.kind));
        let service = self.services.declared.get(&part.service).filter(|_| self.is_running(to));
        let (Some((request, kind)), Some(service)) = (request, service) else {
            self.count_delivery(false);
            return self.finish_part(part); // the service has ended
        };
        let Some(open) = service.mailbox.admit(request.bytes()) else {
            self.count_delivery(false);
            self.reply(part, request.refusal(BUSY));
            return self.finish_part(part);
        };
        let query = Query {
            key: request.key_expr.to_string(),
            parameters: request.parameters.clone(),
            payload: request.payload.clone(),
            attachment: request.attachment.clone(),
            author: Author::UNKNOWN,
            authority: RequestAuthority::Unchecked,
            replier: Box::new(VirtualReplier {
                sink: self.sink.clone(),
                part,
                incarnation: to,
                request: Arc::clone(&request),
                _open: open,
            }),
        };
        let delivered = service.mailbox.send(query);
        self.count_received(from, to.index, kind, request.bytes());
        self.trace.record(self.now, from, to.index, part.service, &request.payload);
        self.count_delivery(delivered);
    }

    pub(super) fn deliver_reply(&mut self, from: NodeIndex, to: NodeIndex, part: QueryPart, reply: Reply) {
        let Some(query) = self.queries.get_mut(&part.query) else { return self.count_delivery(false) };
        let content = match &reply.payload {
            Ok(payload) => payload.clone(),
            Err(refused) => Bytes::copy_from_slice(refused.0.as_bytes()),
        };
        let bytes = size(&reply);
        let kind = query.class.kind;
        let delivered = match &mut query.latest {
            Some(latest) if reply.payload.is_ok() => {
                latest.insert(reply.key.clone(), reply);
                !query.replies.is_closed()
            }
            _ => query.replies.send(reply),
        };
        self.count_received(from, to, kind, bytes);
        self.trace.record(self.now, from, to, part.service, &content);
        self.count_delivery(delivered);
    }

    pub(super) fn break_part(&mut self, part: QueryPart) {
        if let Some(state) = self.queries.get_mut(&part.query).and_then(|query| query.parts.get_mut(&part.service)) {
            state.broken = true;
        }
    }

    pub(super) fn end_part(&mut self, part: QueryPart) {
        if let Some(query) = self.queries.get_mut(&part.query) {
            query.parts.remove(&part.service);
            if query.parts.is_empty() {
                self.queries.remove(&part.query);
            }
        }
    }

    /// Ends the parts of queries of node `at` that are served by node `of` and match `fits`.
    pub(super) fn drop_parts(&mut self, at: NodeIndex, of: NodeIndex, fits: impl Fn(&QueryPartState) -> bool) {
        self.queries.retain(|_, query| {
            if query.requester == at {
                query.parts.retain(|_, part| part.service.index != of || !fits(part));
            }
            !query.parts.is_empty()
        });
    }
}
