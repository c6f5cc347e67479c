//! Counters of events.

use consort_bus::Direction;
use consort_protocol::auction::{AuctionRecord, BidVerdict};
use consort_protocol::event::EventKind;
use consort_protocol::keys::KeyKind;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;

/// Counters by the value of a label.
type CountersByLabel = Family<[(&'static str, &'static str); 1], Counter>;
/// Counters by the values of two labels.
type CountersByTwoLabels = Family<[(&'static str, &'static str); 2], Counter>;

/// Upper bounds in seconds: an auction takes milliseconds when all members answer, and a window
/// otherwise.
const AWARD_SECONDS: [f64; 10] = [0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0, 30.0];

pub(super) struct EventCounters {
    events: CountersByLabel,
    elections: Counter,
    submitted: Counter,
    ended: CountersByLabel,
    auctions: CountersByLabel,
    bids: CountersByLabel,
    award_seconds: Histogram,
    tasks: CountersByLabel,
    commands: Counter,
    messages: CountersByTwoLabels,
    bytes: CountersByTwoLabels,
}

impl EventCounters {
    pub(super) fn new(registry: &mut Registry) -> EventCounters {
        let counts = EventCounters {
            events: CountersByLabel::default(),
            elections: Counter::default(),
            submitted: Counter::default(),
            ended: CountersByLabel::default(),
            auctions: CountersByLabel::default(),
            bids: CountersByLabel::default(),
            award_seconds: Histogram::new(AWARD_SECONDS),
            tasks: CountersByLabel::default(),
            commands: Counter::default(),
            messages: CountersByTwoLabels::default(),
            bytes: CountersByTwoLabels::default(),
        };
        // Unused counters start at zero: a rate needs a beginning.
        let begin = |counts: &CountersByLabel, label: &'static str, values: &[&'static str]| {
            values.iter().for_each(|value| drop(counts.get_or_create(&[(label, value)])));
        };
        begin(&counts.ended, "state", &["completed", "failed", "canceled", "needs_intervention"]);
        begin(&counts.auctions, "result", &["awarded", "no_award"]);
        begin(&counts.bids, "verdict", &["viable", "unviable", "refused"]);
        begin(&counts.tasks, "result", &["done", "failed", "retried", "alternative"]);
        registry.register("events", "Events published on the event stream", counts.events.clone());
        registry.register("elections", "Times elected coordinator", counts.elections.clone());
        registry.register("missions_submitted", "Missions acknowledged as coordinator", counts.submitted.clone());
        registry.register("missions_ended", "Missions ended while coordinating", counts.ended.clone());
        registry.register("auctions", "Auctions closed", counts.auctions.clone());
        registry.register("bids", "Bids and refusals in closed auctions", counts.bids.clone());
        let help = "From the commit of a request to the commit of its award";
        registry.register("award_seconds", help, counts.award_seconds.clone());
        registry.register("tasks", "Tasks of this node's robot", counts.tasks.clone());
        registry.register("ledger_commands", "Applied commands of the ledger", counts.commands.clone());
        registry.register("bus_messages", "Messages of this node", counts.messages.clone());
        registry.register("bus_bytes", "Bytes of payload of this node's messages", counts.bytes.clone());
        counts
    }

    pub(super) fn count_event(&self, what: &EventKind) {
        self.events.get_or_create(&[("event", what.as_str())]).inc();
        let task = |result: &'static str| {
            self.tasks.get_or_create(&[("result", result)]).inc();
        };
        match what {
            EventKind::Elected { .. } => {
                self.elections.inc();
            }
            EventKind::Submitted { .. } => {
                self.submitted.inc();
            }
            EventKind::Mission { state, .. } if state.is_final() => {
                self.ended.get_or_create(&[("state", state.as_str())]).inc();
            }
            EventKind::Closed { record, .. } => self.closed(record),
            EventKind::Awarded { after_ms: Some(after_ms), .. } => self.award_seconds.observe(after_ms / 1000.0),
            EventKind::TaskEnded { .. } => task("done"),
            EventKind::TaskSkipped { .. } => task("skipped"),
            EventKind::TaskFailed { .. } => task("failed"),
            EventKind::TaskRetried { .. } => task("retried"),
            EventKind::Alternative { .. } => task("alternative"),
            _ => {}
        }
    }

    fn closed(&self, record: &AuctionRecord) {
        let result = if record.failure.is_none() { "awarded" } else { "no_award" };
        self.auctions.get_or_create(&[("result", result)]).inc();
        for word in record.entries.iter().filter_map(|entry| word(&entry.verdict)) {
            self.bids.get_or_create(&[("verdict", word)]).inc();
        }
    }

    pub(super) fn count_commands(&self, commands: usize) {
        self.commands.inc_by(commands as u64);
    }

    pub(super) fn count_message(&self, kind: KeyKind, direction: Direction, bytes: usize) {
        let direction = match direction {
            Direction::Sent => "sent",
            Direction::Received => "received",
        };
        let labels = [("kind", kind.as_str()), ("direction", direction)];
        self.messages.get_or_create(&labels).inc();
        self.bytes.get_or_create(&labels).inc_by(bytes as u64);
    }
}

/// Returns the word for an answer; `None` for robots that were not asked.
fn word(verdict: &BidVerdict) -> Option<&'static str> {
    match verdict {
        BidVerdict::Viable { .. } => Some("viable"),
        BidVerdict::Unviable { .. } => Some("unviable"),
        BidVerdict::Refused { .. } => Some("refused"),
        BidVerdict::NotAsked { .. } => None,
    }
}
