//! Bus of a node with a bug: the bus changes messages that the node sends or receives, or adds a request.

use super::Mutant;
use super::driver::{CanceledGoals, without_time_limit};
use super::gossip::{exchange_with, record_bug, retain_records_of, update_with};
use super::known_ledger::KnownLedger;
use super::message::{decode_report, encoded};
use super::refusals::{RefusalPassage, merged};
use super::reports::{ReportBug, reply_at_once, with_all_signals};
use crate::chaos::recurring::{self, SCHEDULE};
use crate::slug;
use async_trait::async_trait;
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::{
    Author, Bus, BusError, Delivery, Encoding, Link, Presence, PresenceToken, Query, Reply, RequestAuthority, Sample,
    ServiceSelection, SharedBus, Stream,
};
use consort_fleet::node::NodeSettings;
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{ApiCall, DriverCall, Key, Keys, RaftCall};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Ledger;
use consort_protocol::message::{AwardNotice, Beacon, ClusterEnvelope, OrdersNotice, ReportReply};
use serde::Serialize;
use serde_json::{Value, json};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;

/// Timeout of a request that an injected bug makes.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(3);

/// Layer over the bus of a node that injects a bug into the node.
pub(super) struct FaultyBus {
    mutant: Mutant,
    node: NodeId,
    keys: Keys,
    ledger: KnownLedger,
    /// Last renewal that this node's robot received.
    renewal: Arc<Mutex<Option<Bytes>>>,
    /// Latest term in the beacons that this node received.
    latest_term: Arc<AtomicU64>,
    canceled: CanceledGoals,
    clock: Clock,
    passage: RefusalPassage,
    inner: SharedBus,
}

/// Query as passed to the inner bus.
struct OutgoingQuery<'a> {
    key: &'a str,
    payload: Bytes,
    attachment: Bytes,
    timeout: Duration,
    target: ServiceSelection,
}

/// Reply of a voter to a heartbeat request, in the layout of `consort_raft`.
#[derive(Serialize)]
enum HeartbeatReply {
    Done { follows: bool, busy: bool },
}

impl FaultyBus {
    pub(super) fn new(
        mutant: Mutant,
        settings: &NodeSettings,
        ledger: KnownLedger,
        passage: RefusalPassage,
        inner: SharedBus,
    ) -> FaultyBus {
        let (node, keys) = (settings.node.clone(), Keys::new(&settings.fleet.fleet));
        let (renewal, latest_term, canceled) = Default::default();
        FaultyBus { mutant, node, keys, ledger, renewal, latest_term, canceled, clock: settings.clock, passage, inner }
    }

    async fn send(&self, query: OutgoingQuery<'_>) -> Result<Stream<Reply>, BusError> {
        let OutgoingQuery { key, payload, attachment, timeout, target } = query;
        let refusals = (self.mutant == Mutant::RefusalsUnsigned).then(|| self.passage.open());
        let replies = self.inner.query_with(key, payload, attachment, timeout, target).await?;
        Ok(match self.mutant {
            Mutant::AuthorsUnchecked => replies.map(|reply| Reply { author: Author::UNKNOWN, ..reply }),
            _ => match refusals {
                Some(refusals) => merged(replies, refusals),
                None => replies,
            },
        })
    }

    /// Acknowledges a heartbeat request for a voter that does not reply.
    async fn acknowledge_heartbeat(&self, query: OutgoingQuery<'_>) -> Result<Stream<Reply>, BusError> {
        let (key, limit) = (query.key.to_owned(), query.timeout / 2);
        let mut replies = self.send(query).await?;
        let reply = tokio::time::timeout(limit, replies.recv()).await.ok().flatten();
        let acknowledged = HeartbeatReply::Done { follows: true, busy: false };
        Ok(single(reply.unwrap_or_else(|| reply_with(&key, encoded(&acknowledged)))))
    }

    /// Renews the lease of a robot again when the coordinator does not reply.
    async fn renew_without_reply(&self, query: OutgoingQuery<'_>) -> Result<Stream<Reply>, BusError> {
        let (key, report) = (query.key.to_owned(), decode_report(&query.payload));
        let mut replies = self.send(query).await?;
        let reply = replies.recv().await;
        let mut renewal = self.renewal.lock().unwrap_or_else(PoisonError::into_inner);
        match reply.as_ref().and_then(decode_reply) {
            Some(ReportReply::Renewed { .. }) => {
                *renewal = reply.as_ref().and_then(|reply| reply.payload.clone().ok());
            }
            Some(ReportReply::Ended { .. }) => {}
            Some(ReportReply::NotCoordinator { .. }) | None => {
                let last = renewal.clone().filter(|bytes| {
                    let renewed = codec::decode(bytes).ok();
                    matches!((renewed, report), (Some(ReportReply::Renewed { epoch, .. }), Some(report)) if epoch == report.epoch)
                });
                if let Some(renewal) = last {
                    return Ok(single(reply_with(&key, renewal)));
                }
            }
        }
        Ok(reply.map_or_else(empty, single))
    }

    /// Passes on only records of the node itself, in both directions.
    async fn exchange_own_records(&self, peer: NodeId, query: OutgoingQuery<'_>) -> Result<Stream<Reply>, BusError> {
        let payload = retain_records_of(&self.node, query.payload);
        let replies = self.send(OutgoingQuery { payload, ..query }).await?;
        Ok(replies.map(move |reply| Reply {
            payload: reply.payload.map(|payload| retain_records_of(&peer, payload)),
            ..reply
        }))
    }

    /// Adds all signals that the role awaits to the replies to its reports.
    async fn receive_all_signals(&self, query: OutgoingQuery<'_>) -> Result<Stream<Reply>, BusError> {
        let (report, ledger) = (decode_report(&query.payload), self.ledger.clone());
        let replies = self.send(query).await?;
        Ok(replies.map(move |reply| match (&report, decode_reply(&reply)) {
            (Some(report), Some(told)) => {
                let told = ledger.read(|ledger| with_all_signals(ledger, report, told));
                Reply { payload: Ok(encoded(&told)), ..reply }
            }
            _ => reply,
        }))
    }

    /// Submits the latest occurrence of the schedule again.
    async fn repeat_occurrence(&self) -> Result<(), BusError> {
        let Some(request) = self.ledger.read(repeated_occurrence) else { return Ok(()) };
        let key = self.keys.write(&Key::Api(ApiCall::Submit));
        let mut replies = self.inner.query(&key, request.to_string().into(), REQUEST_TIMEOUT).await?;
        // Without its stream the query would be canceled.
        tokio::spawn(async move { while replies.recv().await.is_some() {} });
        Ok(())
    }

    fn change_incoming(&self, queries: Stream<Query>) -> Stream<Query> {
        let (mutant, keys, ledger) = (self.mutant, self.keys.clone(), self.ledger.clone());
        let (report_bug, record_bug) = (ReportBug::of(mutant), record_bug(mutant));
        let mut forgotten = 0;
        queries.map(move |query| match (mutant, keys.read(&query.key)) {
            (Mutant::StaleRead, Some(Key::Api(ApiCall::Get | ApiCall::List))) => without_confirmation(query),
            (Mutant::SignersUnchecked, _) => Query { authority: RequestAuthority::Unchecked, ..query },
            (Mutant::AuthorsUnchecked, _) => Query { author: Author::UNKNOWN, ..query },
            (Mutant::GuardSkipped, Some(Key::Award(_))) => without_guards(query),
            (Mutant::CircularWaitKept, Some(Key::Award(_))) => without_giving_way(query),
            (_, Some(Key::Award(_))) if ignores_orders(mutant) => without_ignored(mutant, query),
            (Mutant::OrderForgotten, Some(Key::Api(ApiCall::Hold | ApiCall::Release | ApiCall::Maintenance))) => {
                let reply = json!({ "robots": {} }).to_string();
                // The coordinator rejects a request without content.
                Query { payload: Bytes::new(), ..reply_at_once(query, reply.into(), Encoding::Json) }
            }
            (Mutant::RequestForgotten, Some(Key::Api(ApiCall::Submit))) => {
                forget_request(query, &ledger, &mut forgotten)
            }
            (_, Some(Key::Report(_))) => match report_bug {
                Some(bug) => bug.apply(query, &ledger),
                None => query,
            },
            (_, Some(Key::Gossip(_))) => match record_bug {
                Some(bug) => Query { payload: exchange_with(bug, query.payload), ..query },
                None => query,
            },
            _ => query,
        })
    }
}

/// Removes the guards from the plan of an award.
fn without_guards(query: Query) -> Query {
    let Ok(ClusterEnvelope { cluster, payload }) = codec::decode(&query.payload) else { return query };
    let Ok(AwardNotice::Awarded(mut award)) = codec::decode(&payload) else { return query };
    award.plan.guarded.clear();
    let payload = encoded(&AwardNotice::Awarded(award)).to_vec();
    Query { payload: encoded(&ClusterEnvelope { cluster, payload }), ..query }
}

/// Turns a request to give way into one for another award, which the robot ignores.
fn without_giving_way(query: Query) -> Query {
    let Ok(ClusterEnvelope { cluster, payload }) = codec::decode(&query.payload) else { return query };
    let Ok(AwardNotice::GiveWay { to, for_now, .. }) = codec::decode(&payload) else { return query };
    let payload = encoded(&AwardNotice::GiveWay { epoch: Epoch::default(), to, for_now }).to_vec();
    Query { payload: encoded(&ClusterEnvelope { cluster, payload }), ..query }
}

/// Checks whether robots ignore orders of people.
fn ignores_orders(mutant: Mutant) -> bool {
    matches!(mutant, Mutant::HoldIgnored | Mutant::ClosureIgnored | Mutant::AlarmIgnored | Mutant::LimitIgnored)
}

/// Removes the orders that the robots ignore.
fn remove_ignored(mutant: Mutant, orders: &mut OrdersNotice) {
    match mutant {
        Mutant::HoldIgnored => orders.hold = None,
        Mutant::ClosureIgnored => orders.closures.clear(),
        Mutant::AlarmIgnored => orders.alarm = None,
        Mutant::LimitIgnored => orders.speed_limits.clear(),
        _ => {}
    }
}

/// Removes the ignored orders from a notice about the orders of people.
fn without_ignored(mutant: Mutant, query: Query) -> Query {
    let Ok(ClusterEnvelope { cluster, payload }) = codec::decode(&query.payload) else { return query };
    let Ok(AwardNotice::Orders(mut orders)) = codec::decode(&payload) else { return query };
    remove_ignored(mutant, &mut orders);
    let payload = encoded(&AwardNotice::Orders(orders)).to_vec();
    Query { payload: encoded(&ClusterEnvelope { cluster, payload }), ..query }
}

/// Removes the ignored orders from the renewal of a lease.
fn renewed_without_ignored(mutant: Mutant, reply: Reply) -> Reply {
    let Some(mut renewed) = decode_reply(&reply) else { return reply };
    if let ReportReply::Renewed { orders, .. } = &mut renewed {
        remove_ignored(mutant, orders);
    }
    Reply { payload: Ok(encoded(&renewed)), ..reply }
}

/// Turns off the option `linearizable` of a read.
fn without_confirmation(query: Query) -> Query {
    let Ok(mut request) = serde_json::from_slice::<Value>(&query.payload) else { return query };
    if request.get("linearizable").is_none() {
        return query;
    }
    request["linearizable"] = json!(false);
    Query { payload: request.to_string().into(), ..query }
}

/// Renames a request that the ledger already contains, so that it counts as a new request.
fn forget_request(query: Query, ledger: &KnownLedger, forgotten: &mut u64) -> Query {
    let Ok(mut request) = serde_json::from_slice::<Value>(&query.payload) else { return query };
    let Some(name) = request["request"].as_str().map(str::to_owned) else { return query };
    let is_known = |id| ledger.read(|ledger| ledger.mission_of_request(&id).is_some());
    if !name.parse().is_ok_and(is_known) {
        return query;
    }
    *forgotten += 1;
    request["request"] = json!(format!("{name}-{forgotten}"));
    Query { payload: request.to_string().into(), ..query }
}

/// Returns a request for the latest occurrence of the schedule, unless the ledger contains this request.
fn repeated_occurrence(ledger: &Ledger) -> Option<Value> {
    let entry = ledger.schedule(&slug(SCHEDULE))?;
    let due_ms = entry.last.as_ref()?.due_ms;
    // The next number of a request of the schedule.
    let request = format!("{SCHEDULE}.{due_ms}.{}", entry.submitted);
    let is_new = ledger.mission_of_request(&slug(&request)).is_none();
    is_new.then(|| json!({ "mission": recurring::mission(), "request": request }))
}

fn decode_reply(reply: &Reply) -> Option<ReportReply> {
    codec::decode(reply.payload.as_ref().ok()?).ok()
}

fn reply_with(key: &str, payload: Bytes) -> Reply {
    Reply { key: key.to_owned(), payload: Ok(payload), attachment: Bytes::new(), author: Author::UNKNOWN }
}

fn empty() -> Stream<Reply> {
    Stream::new(mpsc::unbounded_channel().1, Box::new(()))
}

fn single(reply: Reply) -> Stream<Reply> {
    let (sender, receiver) = mpsc::unbounded_channel();
    sender.send(reply).expect("the receiver exists");
    Stream::new(receiver, Box::new(()))
}

#[async_trait]
impl Bus for FaultyBus {
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError> {
        // Only a coordinator publishes beacons.
        if let (Mutant::OccurrenceRepeated, Some(Key::Beacon)) = (self.mutant, self.keys.read(key)) {
            self.repeat_occurrence().await?;
        }
        self.inner.publish_with_attachment(key, payload, attachment, encoding, delivery).await
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        let samples = self.inner.subscribe(key_expr).await?;
        let (keys, canceled, latest_term) = (self.keys.clone(), self.canceled.clone(), Arc::clone(&self.latest_term));
        Ok(match self.mutant {
            Mutant::BeaconsBelieved => samples.filter_map(move |sample| {
                let Some(Key::Beacon) = keys.read(&sample.key) else { return Some(sample) };
                let ClusterEnvelope { payload, .. } = codec::decode(&sample.payload).ok()?;
                let beacon: Beacon = codec::decode(&payload).ok()?;
                (beacon.term >= latest_term.fetch_max(beacon.term, Ordering::Relaxed)).then_some(sample)
            }),
            Mutant::ReleasedInMotion => samples.map(move |sample| match keys.read(&sample.key) {
                Some(Key::Driver(_, DriverCall::State)) => Sample { payload: canceled.end(sample.payload), ..sample },
                _ => sample,
            }),
            Mutant::AuthorsUnchecked => samples.map(|sample| Sample { author: Author::UNKNOWN, ..sample }),
            mutant => match record_bug(mutant) {
                Some(bug) => samples.map(move |sample| match keys.read(&sample.key) {
                    Some(Key::Knowledge(_)) => Sample { payload: update_with(bug, sample.payload), ..sample },
                    _ => sample,
                }),
                None => samples,
            },
        })
    }

    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        attachment: Bytes,
        timeout: Duration,
        target: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError> {
        let query = OutgoingQuery { key: key_expr, payload, attachment, timeout, target };
        match (self.mutant, self.keys.read(key_expr)) {
            (Mutant::NoCheckQuorum, Some(Key::Raft(_, RaftCall::Heartbeat))) => self.acknowledge_heartbeat(query).await,
            (Mutant::LeaseNotChecked, Some(Key::Report(_))) => self.renew_without_reply(query).await,
            (Mutant::LostRelay, Some(Key::Gossip(peer))) => self.exchange_own_records(peer, query).await,
            (Mutant::WaitSkipped, Some(Key::Report(_))) => self.receive_all_signals(query).await,
            (mutant, Some(Key::Report(_))) if ignores_orders(mutant) => {
                Ok(self.send(query).await?.map(move |reply| renewed_without_ignored(mutant, reply)))
            }
            (Mutant::ReleasedInMotion, Some(Key::Driver(_, DriverCall::Command))) => {
                self.canceled.observe(&query.payload);
                let (replies, canceled) = (self.send(query).await?, self.canceled.clone());
                Ok(replies.map(move |reply| Reply { payload: reply.payload.map(|state| canceled.end(state)), ..reply }))
            }
            (Mutant::KeptTooLong, Some(Key::Driver(_, DriverCall::Command))) => {
                let payload = without_time_limit(query.payload);
                self.send(OutgoingQuery { payload, ..query }).await
            }
            (Mutant::OwnClock, Some(Key::Clock(_))) => {
                let (replies, clock) = (self.send(query).await?, self.clock);
                let own = move |_| encoded(&clock.wall_ms());
                Ok(replies.map(move |reply| Reply { payload: reply.payload.map(own), ..reply }))
            }
            (mutant, Some(Key::Gossip(_))) => {
                let replies = self.send(query).await?;
                let Some(bug) = record_bug(mutant) else { return Ok(replies) };
                let changed = move |payload| exchange_with(bug, payload);
                Ok(replies.map(move |reply| Reply { payload: reply.payload.map(changed), ..reply }))
            }
            _ => self.send(query).await,
        }
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        Ok(self.change_incoming(self.inner.serve(key_expr).await?))
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        Ok(self.change_incoming(self.inner.serve_complete(key_expr).await?))
    }

    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError> {
        self.inner.announce(key).await
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        self.inner.watch(key_expr).await
    }

    async fn links(&self) -> Vec<Link> {
        self.inner.links().await
    }
}
