//! All that happened in a fleet, as each node told it at its own place: faults between nodes hide nothing.

use consort_actors::observe::Observer;
use consort_actors::raft::LeaderId;
use consort_protocol::codec;
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Command;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hasher};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;

/// Something that happened, or that the test did to a node.
#[derive(Debug, Clone, PartialEq)]
pub enum Observation {
    /// A node told of it.
    Published(Event),
    /// The test did it.
    TestAction {
        /// To which node.
        node: NodeId,
        /// What.
        action: &'static str,
    },
    /// What a node believes of who leads has changed.
    LeadershipChanged {
        /// Which node.
        node: NodeId,
        /// Its term.
        term: u64,
        /// Whether it leads itself, and in which reign.
        leading_as: Option<LeaderId>,
    },
    /// A client's request was acknowledged.
    RequestAcknowledged {
        /// The client.
        node: NodeId,
        /// The request's name, if the client gave it one.
        request: Option<String>,
        /// The mission that it stands for.
        mission: MissionId,
    },
    /// A node's copy of the ledger took in an entry.
    EntryApplied {
        /// Which node.
        node: NodeId,
        /// The entry's place.
        at: Epoch,
        /// A digest of its command; `None` for an entry of Raft's own.
        digest: Option<u64>,
        /// Its commands, in their order.
        commands: Arc<[Command]>,
    },
}

impl Observation {
    /// What a node told.
    pub fn event_kind(&self) -> Option<&EventKind> {
        match self {
            Observation::Published(event) => Some(&event.kind),
            _ => None,
        }
    }

    /// At which node it happened.
    pub fn node(&self) -> &NodeId {
        match self {
            Observation::Published(event) => &event.node,
            Observation::TestAction { node, .. }
            | Observation::LeadershipChanged { node, .. }
            | Observation::RequestAcknowledged { node, .. }
            | Observation::EntryApplied { node, .. } => node,
        }
    }
}

/// The record; clones are one.
#[derive(Clone)]
pub struct EventLog {
    started: Instant,
    entries: Arc<Mutex<Vec<(Duration, Observation)>>>,
    grown: watch::Sender<usize>,
}

impl EventLog {
    pub(crate) fn new() -> EventLog {
        EventLog { started: Instant::now(), entries: Arc::default(), grown: watch::Sender::new(0) }
    }

    /// How long it has been kept, in virtual time.
    pub(crate) fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    /// Adds what has just happened.
    pub(crate) fn add(&self, entry: Observation) {
        self.lock().push((self.elapsed(), entry));
        self.grown.send_modify(|count| *count += 1);
    }

    pub(crate) fn subscribe_len(&self) -> watch::Receiver<usize> {
        self.grown.subscribe()
    }

    fn lock(&self) -> MutexGuard<'_, Vec<(Duration, Observation)>> {
        self.entries.lock().expect("no panic while it is held")
    }

    /// Everything, in order.
    pub fn entries(&self) -> Vec<(Duration, Observation)> {
        self.lock().clone()
    }

    /// What was added after the first `count` entries, in order.
    pub fn since(&self, count: usize) -> Vec<(Duration, Observation)> {
        self.lock().get(count..).map_or(vec![], <[_]>::to_vec)
    }

    /// How much there is.
    pub fn len(&self) -> usize {
        self.lock().len()
    }

    /// Whether nothing has happened yet.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// When something of the kind happened, each time.
    pub fn times(&self, what: impl Fn(&EventKind) -> bool) -> Vec<Duration> {
        let entries = self.lock();
        let wanted = entries.iter().filter(|(_, entry)| entry.event_kind().is_some_and(&what));
        wanted.map(|(at, _)| *at).collect()
    }

    /// How often something of the kind happened.
    pub fn count(&self, what: impl Fn(&EventKind) -> bool) -> usize {
        self.times(what).len()
    }

    /// Everything, a line each, for a person who looks for the reason.
    pub fn to_text(&self) -> String {
        let told = |entry: &Observation| !matches!(entry, Observation::LeadershipChanged { .. });
        self.lines(told).into_iter().map(|(_, line)| line + "\n").collect()
    }

    /// What of it is worth telling, with its time.
    pub fn lines(&self, told: impl Fn(&Observation) -> bool) -> Vec<(Duration, String)> {
        let line = |(at, entry): &(Duration, Observation)| {
            let mut what = match entry {
                Observation::Published(event) => format!("{:?}", event.kind),
                Observation::TestAction { action: what, .. } => format!("*** {what}"),
                Observation::RequestAcknowledged { request, mission, .. } => {
                    let request = request.as_deref().unwrap_or("a request without a name");
                    format!("*** {request} acknowledged as {mission}")
                }
                Observation::LeadershipChanged { term, leading_as: Some(reign), .. } => {
                    format!("leads in reign {reign} (term {term})")
                }
                Observation::LeadershipChanged { term, leading_as: None, .. } => format!("does not lead (term {term})"),
                Observation::EntryApplied { .. } => return None,
            };
            what.truncate(what.char_indices().nth(260).map_or(what.len(), |(index, _)| index));
            Some((*at, format!("{:8.3} {:>8} {what}", at.as_secs_f64(), entry.node().to_string())))
        };
        self.lock().iter().filter(|(_, entry)| told(entry)).filter_map(line).collect()
    }

    /// By task of a mission: at which nodes it was begun, and at which it ended well, in order.
    pub fn task_executors(&self, mission: &MissionId) -> BTreeMap<String, (Vec<String>, Vec<String>)> {
        let mut doers: BTreeMap<String, (Vec<String>, Vec<String>)> = BTreeMap::new();
        for (_, entry) in self.lock().iter() {
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

    /// Who acted in which role from when to when: from its start or resumption until it suspended, halted or was killed.
    pub fn role_intervals(&self) -> Vec<RoleInterval> {
        let mut spells: Vec<RoleInterval> = vec![];
        let entries = self.entries();
        for (at, entry) in &entries {
            let node = entry.node();
            let of = |mission: &MissionId, role: &RoleId| (mission.clone(), role.clone());
            match entry {
                Observation::Published(event) => match &event.kind {
                    EventKind::Started { mission, role, .. } | EventKind::Resumed { mission, role } => {
                        let (mission, role) = of(mission, role);
                        spells.push(RoleInterval { robot: node.clone().into(), mission, role, from: *at, to: None });
                    }
                    EventKind::Suspended { mission, role } | EventKind::Halted { mission, role, .. } => {
                        let ends = |spell: &&mut RoleInterval| {
                            spell.to.is_none()
                                && spell.robot.as_str() == node.as_str()
                                && (&spell.mission, &spell.role) == (mission, role)
                        };
                        if let Some(spell) = spells.iter_mut().find(ends) {
                            spell.to = Some(*at);
                        }
                    }
                    _ => {}
                },
                Observation::TestAction { action: "killed" | "stopped", .. } => {
                    for spell in spells.iter_mut().filter(|s| s.to.is_none() && s.robot.as_str() == node.as_str()) {
                        spell.to = Some(*at);
                    }
                }
                _ => {}
            }
        }
        spells
    }
}

impl Observer for EventLog {
    fn on_event(&self, event: &Event) {
        self.add(Observation::Published(event.clone()));
    }

    fn on_applied(&self, node: &NodeId, at: Epoch, commands: &[Command]) {
        let digest = (!commands.is_empty()).then(|| {
            let mut hasher = DefaultHasher::new();
            hasher.write(&codec::encode_record(&commands).expect("it was read from bytes"));
            hasher.finish()
        });
        self.add(Observation::EntryApplied { node: node.clone(), at, digest, commands: commands.into() });
    }
}

/// One robot's acting in one role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RoleInterval {
    /// Who.
    pub robot: RobotId,
    /// For which mission.
    pub mission: MissionId,
    /// In which role.
    pub role: RoleId,
    /// Since when.
    pub from: Duration,
    /// Until when; `None` if still.
    pub to: Option<Duration>,
}

impl RoleInterval {
    /// Whether there was an instant that belongs to both.
    pub fn overlaps(&self, other: &RoleInterval) -> bool {
        let ends = |spell: &RoleInterval| spell.to.unwrap_or(Duration::MAX);
        self.from < ends(other) && other.from < ends(self)
    }
}
