//! Sends spans to a collector, by OTLP over HTTP.

use super::spans::{Span, SpanTracker};
use super::{ClusterCell, TelemetryError};
use consort_fleet::node::NodeSettings;
use consort_fleet::observe::{Observer, SharedObserver};
use consort_protocol::event::Event;
use consort_protocol::ids::NodeId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Command;
use opentelemetry::trace::{Event as Mark, SpanContext, SpanId, SpanKind, Status, TraceFlags, TraceId, TraceState};
use opentelemetry::{InstrumentationScope, KeyValue};
use opentelemetry_otlp::{Protocol, SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::{SpanData, SpanEvents, SpanExporter as _, SpanLinks};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::task::JoinHandle;
use tracing::warn;

/// Maximum number of spans that wait for a slow collector; further spans are lost.
const WAITING_MAX: usize = 4096;

/// Maximum number of spans in a message.
const BATCH_MAX: usize = 256;

/// Time for collecting spans before they are sent.
const GATHER: Duration = Duration::from_secs(1);

/// Sends the spans of a node.
pub(super) struct Exporter {
    tracer: Arc<Tracer>,
    task: JoinHandle<()>,
}

impl Exporter {
    pub(super) fn start(
        endpoint: &str,
        settings: &NodeSettings,
        membership: ClusterCell,
    ) -> Result<Exporter, TelemetryError> {
        let at = format!("{}/v1/traces", endpoint.trim_end_matches('/'));
        let wrong = |problem: &dyn std::fmt::Display| TelemetryError::Collector {
            endpoint: endpoint.to_owned(),
            problem: problem.to_string(),
        };
        if !endpoint.starts_with("http://") {
            return Err(wrong(&"a collector's address starts with http://"));
        }
        let exporter = SpanExporter::builder().with_http().with_protocol(Protocol::HttpBinary).with_endpoint(at);
        let mut exporter = exporter.build().map_err(|problem| wrong(&problem))?;
        let resource = Resource::builder_empty().with_service_name("consort").with_attributes([
            KeyValue::new("service.namespace", settings.fleet.fleet.to_string()),
            KeyValue::new("service.instance.id", settings.node.to_string()),
            KeyValue::new("service.version", env!("CARGO_PKG_VERSION")),
        ]);
        exporter.set_resource(&resource.build());
        let (to, waiting) = channel(WAITING_MAX);
        let tracer = Arc::new(Tracer { membership, spans: Mutex::default(), to: Mutex::new(Some(to)) });
        Ok(Exporter { tracer, task: tokio::spawn(send(exporter, waiting)) })
    }

    pub(super) fn observer(&self) -> SharedObserver {
        self.tracer.clone()
    }

    /// Sends the waiting spans, and ends.
    pub(super) async fn end(self) {
        self.tracer.to.lock().unwrap_or_else(PoisonError::into_inner).take();
        let _ = self.task.await; // a panic there was reported already
    }
}

/// Creates spans from events.
struct Tracer {
    membership: ClusterCell,
    spans: Mutex<SpanTracker>,
    /// `None` after the node has ended.
    to: Mutex<Option<Sender<Span>>>,
}

impl Observer for Tracer {
    fn told(&self, event: &Event) {
        let ended = self.spans.lock().unwrap_or_else(PoisonError::into_inner).take(self.membership.cluster(), event);
        let to = self.to.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(to) = &*to else { return };
        let lost = ended.into_iter().filter(|span| to.try_send(span.clone()).is_err()).count();
        if lost > 0 {
            warn!(lost, "the collector is too slow, or unreachable: spans are lost");
        }
    }

    fn applied(&self, _: &NodeId, _: Epoch, _: &[Command]) {}
}

/// Sends spans until the channel is closed.
async fn send(exporter: SpanExporter, mut waiting: Receiver<Span>) {
    let mut fails = false;
    while let Some(first) = waiting.recv().await {
        let mut batch = vec![data(first)];
        let until = tokio::time::Instant::now() + GATHER;
        while batch.len() < BATCH_MAX
            && let Ok(Some(next)) = tokio::time::timeout_at(until, waiting.recv()).await
        {
            batch.push(data(next));
        }
        match exporter.export(batch).await {
            Ok(()) => fails = false,
            Err(problem) if !fails => {
                warn!(%problem, "spans were not accepted; logged once until the collector accepts spans again");
                fails = true;
            }
            Err(_) => {}
        }
    }
}

fn time(ms: u64) -> SystemTime {
    UNIX_EPOCH + Duration::from_millis(ms)
}

fn data(span: Span) -> SpanData {
    let id = |id: super::ids::SpanId| SpanId::from_bytes(id.0.to_be_bytes());
    let trace = TraceId::from_bytes(span.trace.0.to_be_bytes());
    let mut events = SpanEvents::default();
    events.events.extend(span.marks.into_iter().map(|(at, text)| Mark::new(text, time(at), vec![], 0)));
    SpanData {
        span_context: SpanContext::new(trace, id(span.id), TraceFlags::SAMPLED, false, TraceState::default()),
        parent_span_id: span.parent.map_or(SpanId::INVALID, id),
        parent_span_is_remote: false,
        span_kind: SpanKind::Internal,
        name: span.name.into(),
        start_time: time(span.begin_ms),
        end_time: time(span.end_ms),
        attributes: span.attributes.into_iter().map(|(key, value)| KeyValue::new(key, value)).collect(),
        dropped_attributes_count: 0,
        events,
        links: SpanLinks::default(),
        status: span.failure.map_or(Status::Unset, Status::error),
        instrumentation_scope: InstrumentationScope::builder("consort").build(),
    }
}
