//! The requests to people: open, and ended lately.

use crate::world::event_queue::TimerId;
use consort_protocol::ids::{RoleId, TaskType};
use consort_skills::actions::{GoalId, PersonResult};
use hecs::Entity;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Sequence number of a request. Earlier requests are served first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RequestNumber(pub(super) u64);

/// The open requests, and the ids of those that ended lately.
#[derive(Default)]
pub(crate) struct PersonRequests {
    /// Task types with which a person puts a sample into the drawer of a robot.
    handovers: BTreeSet<TaskType>,
    pub(super) open: BTreeMap<RequestNumber, Request>,
    pub(super) ids: BTreeMap<GoalId, RequestNumber>,
    /// Ended requests with their results; `None` for a canceled request.
    pub(super) ended: BTreeMap<GoalId, Option<PersonResult>>,
    /// Ended requests in the order of their ends.
    ended_order: VecDeque<GoalId>,
    next: u64,
}

/// A request.
pub(super) struct Request {
    pub(super) id: GoalId,
    pub(super) role: RoleId,
    pub(super) task: TaskType,
    pub(super) work: Work,
    pub(super) under_way: Option<Handover>,
    /// Time for which the request waits for an absent person, in seconds.
    pub(super) timeout_s: f64,
    /// The timeout, while every person in the role is away.
    pub(super) timeout_timer: Option<TimerId>,
}

/// Content of a request.
pub(super) enum Work {
    /// Handover of a sample to any of the robots `into`.
    Handover { into: BTreeSet<Entity> },
    /// Any other task, with its duration in seconds if a parameter contains it.
    Task { seconds: Option<f64> },
}

/// A handover or another task under way.
#[derive(Clone, Copy)]
pub(super) struct Handover {
    pub(super) person: Entity,
    /// The robot of a handover.
    pub(super) robot: Option<Entity>,
    pub(super) ends: TimerId,
}

impl PersonRequests {
    /// Creates an empty list, with the task types that are handovers.
    pub(super) fn new(handovers: BTreeSet<TaskType>) -> PersonRequests {
        PersonRequests { handovers, ..PersonRequests::default() }
    }

    pub(super) fn is_known(&self, id: GoalId) -> bool {
        self.ids.contains_key(&id) || self.ended.contains_key(&id)
    }

    pub(super) fn open(&mut self, request: Request) {
        let number = RequestNumber(self.next);
        self.next += 1;
        self.ids.insert(request.id, number);
        self.open.insert(number, request);
    }

    /// Checks whether a person hands a sample over in a task of this type.
    pub(super) fn is_handover(&self, task: &TaskType) -> bool {
        self.handovers.contains(task)
    }

    pub(super) fn under_way(&self, id: GoalId) -> Option<Handover> {
        self.open.get(self.ids.get(&id)?)?.under_way
    }

    /// Requests that are not being served, earlier requests first.
    pub(super) fn waiting(&self) -> Vec<RequestNumber> {
        self.open.iter().filter(|(_, request)| request.under_way.is_none()).map(|(number, _)| *number).collect()
    }

    pub(super) fn close(&mut self, id: GoalId, result: Option<PersonResult>, kept: usize) {
        if let Some(number) = self.ids.remove(&id) {
            self.open.remove(&number);
        }
        if self.ended.insert(id, result).is_none() {
            self.ended_order.push_back(id);
        }
        if self.ended.len() > kept
            && let Some(oldest) = self.ended_order.pop_front()
        {
            self.ended.remove(&oldest);
        }
    }

    /// Open requests, earlier requests first.
    pub(crate) fn open_requests(&self) -> Vec<GoalId> {
        self.open.values().map(|request| request.id).collect()
    }

    /// Checks whether a request was canceled lately.
    pub(crate) fn was_canceled(&self, id: GoalId) -> bool {
        self.ended.get(&id).is_some_and(Option::is_none)
    }

    /// Result of a request that ended lately.
    pub(crate) fn result(&self, id: GoalId) -> Option<PersonResult> {
        self.ended.get(&id).cloned().flatten()
    }
}
