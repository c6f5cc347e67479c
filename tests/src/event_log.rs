//! Log of everything that happens in a fleet. Each node appends its events locally, so network
//! faults hide none of them.

use consort_fleet::observe::Observer;
use consort_protocol::codec;
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Command;
use consort_raft::LeaderId;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hasher};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;

/// Something that happened in a fleet, or that the test did to a node.
#[derive(Debug, Clone, PartialEq)]
pub enum Observation {
    /// A node published an event.
    Published(Event),
    /// The test did something to a node.
    TestAction {
        /// The affected node.
        node: NodeId,
        /// The action.
        action: &'static str,
    },
    /// The leadership view of a node changed.
    LeadershipChanged {
        /// The node.
        node: NodeId,
        /// Its term.
        term: u64,
        /// The leader id of the node if it leads itself.
        leading_as: Option<LeaderId>,
    },
    /// A client request was acknowledged.
    RequestAcknowledged {
        /// The client.
        node: NodeId,
        /// Name of the request, if the client named it.
        request: Option<String>,
        /// The mission of the request.
        mission: MissionId,
    },
    /// The coordinator acknowledged an order of a person, unless it cancels missions.
    OrderAcknowledged {
        /// The client.
        node: NodeId,
        /// Name of the person. No other order has the same name.
        by: String,
    },
    /// The test revoked the certificate of a node.
    CertificateRevoked {
        /// The node.
        node: NodeId,
        /// Role that its robot held at that time.
        role: Option<(MissionId, RoleId)>,
    },
    /// A replica applied an entry of the log.
    EntryApplied {
        /// The node.
        node: NodeId,
        /// Position of the entry.
        at: Epoch,
        /// Digest of its commands; `None` for an entry of Raft itself.
        digest: Option<u64>,
        /// Its commands in order.
        commands: Arc<[Command]>,
    },
}

impl Observation {
    /// Returns the kind of the published event.
    pub fn event_kind(&self) -> Option<&EventKind> {
        match self {
            Observation::Published(event) => Some(&event.kind),
            _ => None,
        }
    }

    /// Returns the node of the observation.
    pub fn node(&self) -> &NodeId {
        match self {
            Observation::Published(event) => &event.node,
            Observation::TestAction { node, .. }
            | Observation::LeadershipChanged { node, .. }
            | Observation::RequestAcknowledged { node, .. }
            | Observation::OrderAcknowledged { node, .. }
            | Observation::CertificateRevoked { node, .. }
            | Observation::EntryApplied { node, .. } => node,
        }
    }
}

#[derive(Default)]
struct Entries {
    /// Number of entries that were forgotten.
    forgotten: usize,
    /// The later entries.
    kept: Vec<(Duration, Observation)>,
}

/// The log. Clones share the same entries.
#[derive(Clone)]
pub struct EventLog {
    started: Instant,
    entries: Arc<Mutex<Entries>>,
    grown: watch::Sender<usize>,
}

impl EventLog {
    pub(crate) fn new() -> EventLog {
        EventLog { started: Instant::now(), entries: Arc::default(), grown: watch::Sender::new(0) }
    }

    /// Returns the virtual time since the log was created.
    pub(crate) fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    /// Appends an observation with the current time.
    pub(crate) fn add(&self, entry: Observation) {
        self.lock().kept.push((self.elapsed(), entry));
        self.grown.send_modify(|count| *count += 1);
    }

    pub(crate) fn subscribe_len(&self) -> watch::Receiver<usize> {
        self.grown.subscribe()
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        self.entries.lock().expect("no panic while it is locked")
    }

    /// Returns all entries in order.
    pub fn entries(&self) -> Vec<(Duration, Observation)> {
        self.lock().kept.clone()
    }

    /// Returns the entries after the first `count`, in order.
    pub fn since(&self, count: usize) -> Vec<(Duration, Observation)> {
        let entries = self.lock();
        entries.kept.get(count.saturating_sub(entries.forgotten)..).map_or(vec![], <[_]>::to_vec)
    }

    /// Forgets the entries before the latest `kept` once there are twice as many, so that the log of a long run fits
    /// into memory.
    pub(crate) fn forget_before_latest(&self, kept: usize) {
        let mut entries = self.lock();
        if entries.kept.len() >= 2 * kept {
            let old = entries.kept.len() - kept;
            entries.kept.drain(..old);
            entries.forgotten += old;
        }
    }

    /// Returns the first result of `find` for the events after the first `count` entries.
    pub(crate) fn find_since<T>(&self, count: usize, find: impl FnMut(&EventKind) -> Option<T>) -> Option<T> {
        let entries = self.lock();
        let later = entries.kept.iter().skip(count.saturating_sub(entries.forgotten));
        later.filter_map(|(_, entry)| entry.event_kind()).find_map(find)
    }

    /// Returns the number of entries ever added.
    pub fn len(&self) -> usize {
        let entries = self.lock();
        entries.forgotten + entries.kept.len()
    }

    /// Checks whether the log is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the times of all events of a kind.
    pub fn times(&self, what: impl Fn(&EventKind) -> bool) -> Vec<Duration> {
        let entries = self.lock();
        let wanted = entries.kept.iter().filter(|(_, entry)| entry.event_kind().is_some_and(&what));
        wanted.map(|(at, _)| *at).collect()
    }

    /// Counts the events of a kind.
    pub fn count(&self, what: impl Fn(&EventKind) -> bool) -> usize {
        self.times(what).len()
    }

    /// Formats the log for debugging, with a line per entry.
    pub(crate) fn to_text(&self) -> String {
        let select = |entry: &Observation| !matches!(entry, Observation::LeadershipChanged { .. });
        self.lines(select).into_iter().map(|(_, line)| line + "\n").collect()
    }

    /// Formats the selected entries with their times.
    pub(crate) fn lines(&self, select: impl Fn(&Observation) -> bool) -> Vec<(Duration, String)> {
        let line = |(at, entry): &(Duration, Observation)| {
            let mut what = match entry {
                Observation::Published(event) => format!("{:?}", event.kind),
                Observation::TestAction { action: what, .. } => format!("*** {what}"),
                Observation::RequestAcknowledged { request, mission, .. } => {
                    let request = request.as_deref().unwrap_or("an unnamed request");
                    format!("*** {request} acknowledged as {mission}")
                }
                Observation::OrderAcknowledged { by, .. } => format!("*** {by} acknowledged"),
                Observation::CertificateRevoked { .. } => "*** its certificate is revoked".to_owned(),
                Observation::LeadershipChanged { term, leading_as: Some(reign), .. } => {
                    format!("leads as {reign} (term {term})")
                }
                Observation::LeadershipChanged { term, leading_as: None, .. } => format!("does not lead (term {term})"),
                Observation::EntryApplied { .. } => return None,
            };
            what.truncate(what.char_indices().nth(260).map_or(what.len(), |(index, _)| index));
            Some((*at, format!("{:8.3} {:>8} {what}", at.as_secs_f64(), entry.node().to_string())))
        };
        self.lock().kept.iter().filter(|(_, entry)| select(entry)).filter_map(line).collect()
    }

    /// Returns, for each task of a mission, the nodes at which it began and the nodes at which it
    /// ended well, in order.
    pub fn task_executors(&self, mission: &MissionId) -> BTreeMap<String, (Vec<String>, Vec<String>)> {
        let mut doers: BTreeMap<String, (Vec<String>, Vec<String>)> = BTreeMap::new();
        for (_, entry) in &self.lock().kept {
            match entry.event_kind() {
                Some(EventKind::TaskBegan { mission: of, task, .. }) if of == mission => {
                    doers.entry(task.to_string()).or_default().0.push(entry.node().to_string());
                }
                Some(EventKind::TaskEnded { mission: of, task, .. }) if of == mission => {
                    doers.entry(task.to_string()).or_default().1.push(entry.node().to_string());
                }
                _ => {}
            }
        }
        doers
    }

    /// Returns the intervals in which robots acted in roles: from a start or resumption until the
    /// robot suspended, halted or was killed.
    pub(crate) fn role_intervals(&self) -> Vec<RoleInterval> {
        let mut intervals: Vec<RoleInterval> = vec![];
        let entries = self.entries();
        for (at, entry) in &entries {
            let node = entry.node();
            let of = |mission: &MissionId, role: &RoleId| (mission.clone(), role.clone());
            match entry {
                Observation::Published(event) => match &event.kind {
                    EventKind::Started { mission, role, .. } | EventKind::Resumed { mission, role } => {
                        let (mission, role) = of(mission, role);
                        intervals.push(RoleInterval { robot: node.clone().into(), mission, role, from: *at, to: None });
                    }
                    EventKind::Suspended { mission, role, .. } | EventKind::Halted { mission, role, .. } => {
                        let ends = |interval: &&mut RoleInterval| {
                            interval.to.is_none()
                                && interval.robot.as_str() == node.as_str()
                                && (&interval.mission, &interval.role) == (mission, role)
                        };
                        if let Some(interval) = intervals.iter_mut().find(ends) {
                            interval.to = Some(*at);
                        }
                    }
                    _ => {}
                },
                Observation::TestAction { action: "killed" | "stopped", .. } => {
                    for interval in intervals.iter_mut().filter(|s| s.to.is_none() && s.robot.as_str() == node.as_str())
                    {
                        interval.to = Some(*at);
                    }
                }
                _ => {}
            }
        }
        intervals
    }
}

impl Observer for EventLog {
    fn on_event(&self, event: &Event) {
        self.add(Observation::Published(event.clone()));
    }

    fn on_applied(&self, node: &NodeId, at: Epoch, commands: &[Command]) {
        let digest = (!commands.is_empty()).then(|| {
            let mut hasher = DefaultHasher::new();
            hasher.write(&codec::encode_record(&commands).expect("it was decoded from bytes"));
            hasher.finish()
        });
        self.add(Observation::EntryApplied { node: node.clone(), at, digest, commands: commands.into() });
    }
}

/// Interval in which a robot acted in a role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RoleInterval {
    /// The robot.
    pub robot: RobotId,
    /// The mission.
    pub mission: MissionId,
    /// The role.
    pub role: RoleId,
    /// Start time.
    pub from: Duration,
    /// End time; `None` while it lasts.
    pub to: Option<Duration>,
}

impl RoleInterval {
    /// Checks whether both intervals share an instant.
    pub(crate) fn overlaps(&self, other: &RoleInterval) -> bool {
        let ends = |interval: &RoleInterval| interval.to.unwrap_or(Duration::MAX);
        self.from < ends(other) && other.from < ends(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;

    #[test]
    fn a_log_forgets_old_entries_and_counts_them() {
        let log = EventLog::new();
        let nodes = |since| log.since(since).iter().map(|(_, entry)| entry.node().to_string()).collect::<Vec<_>>();
        let add = |name: &str| log.add(Observation::TestAction { node: slug(name), action: "killed" });
        ["a", "b", "c"].into_iter().for_each(add);
        log.forget_before_latest(2);
        assert_eq!((nodes(0).len(), log.len()), (3, 3), "there are not yet twice as many");
        add("d");
        log.forget_before_latest(2);
        assert_eq!((nodes(0), log.len()), (vec!["c".to_owned(), "d".to_owned()], 4));
        assert_eq!((nodes(3), nodes(4).len()), (vec!["d".to_owned()], 0));
    }
}
