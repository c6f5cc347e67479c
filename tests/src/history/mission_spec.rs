//! Sequential specification of a single mission, for the linearizability tester.

use super::CLIENT;
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::MissionState;
use stateright::semantics::SequentialSpec;

/// Operation on a mission.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum MissionOp {
    Submit,
    Cancel,
    Resolve,
    Read,
}

/// Result of an operation on a mission.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum MissionResult {
    Submitted {
        mission: MissionId,
        again: bool,
        outcome: Option<MissionState>,
    },
    /// The mission was canceled or resolved, and has this state.
    Changed(Option<MissionState>),
    Refused,
    /// `None`: the mission does not exist.
    Read(Option<MissionState>),
    /// A list that lacks missions that have ended earlier lacks this mission, too.
    NotListed,
    /// The mission does not exist, or the ledger has forgotten its outcome.
    Forgotten,
    /// The client got no definite reply.
    Unknown,
}

/// A mission as clients may see it. Robots and coordinators change it between the calls of clients,
/// so a call may find any state that can follow the state seen last.
#[derive(Debug, Clone, Default)]
pub(super) struct MissionSpec {
    exists: bool,
    id: Option<MissionId>,
    /// The state seen last.
    state: Option<MissionState>,
    /// It has ended, in whatever state.
    ended: bool,
    /// The ledger has forgotten its outcome.
    forgotten: bool,
    cancel_requested: bool,
    resolve_requested: bool,
}

impl MissionSpec {
    /// Changes to a state, if the mission may have reached it.
    fn advance(&mut self, next: &MissionState) -> bool {
        let is_resolved = |state: &MissionState| match state {
            MissionState::Failed { cause, .. } => cause.contains("; resolved by "),
            _ => false,
        };
        let may_follow = match &self.state {
            None | Some(MissionState::Pending | MissionState::Running) => !self.ended || next.is_final(),
            Some(MissionState::NeedsIntervention { .. }) => {
                // A shortened text lacks the person.
                let is_shortened = matches!(next, MissionState::Failed { cause, .. } if cause.ends_with('…'));
                matches!(next, MissionState::NeedsIntervention { .. })
                    || is_resolved(next)
                    || (is_shortened && self.resolve_requested)
            }
            Some(last) => is_same_outcome(last, next),
        };
        let was_requested = match next {
            MissionState::Canceled { by } if by.contains(CLIENT) => self.cancel_requested,
            state if is_resolved(state) => self.resolve_requested,
            _ => true,
        };
        self.ended |= next.is_final();
        self.state = Some(next.clone());
        may_follow && was_requested
    }

    /// Checks whether a call may find the mission.
    fn is_known(&self) -> bool {
        self.exists && !self.forgotten
    }

    /// Forgets the mission for good, if it exists: only the outcome of an ended mission is forgotten.
    fn forget(&mut self) {
        self.ended |= self.exists;
        self.forgotten |= self.exists;
    }

    fn submitted(&mut self, mission: &MissionId, again: bool, outcome: Option<&MissionState>) -> bool {
        let is_same = self.id.get_or_insert_with(|| mission.clone()) == mission;
        let existed = std::mem::replace(&mut self.exists, true);
        let is_outcome_valid = match outcome {
            Some(state) => again && state.is_final() && self.advance(state),
            None => !self.ended,
        };
        is_same && existed == again && is_outcome_valid && !self.forgotten
    }
}

/// Checks whether two states are the same outcome. The ledger shortens the text of a mission that ended
/// earlier.
fn is_same_outcome(earlier: &MissionState, later: &MissionState) -> bool {
    match (earlier, later) {
        (MissionState::Failed { cause: earlier, .. }, MissionState::Failed { cause: later, .. })
        | (MissionState::Canceled { by: earlier }, MissionState::Canceled { by: later }) => {
            later == earlier || later.strip_suffix('…').is_some_and(|start| earlier.starts_with(start))
        }
        _ => earlier == later,
    }
}

impl SequentialSpec for MissionSpec {
    type Op = MissionOp;
    type Ret = MissionResult;

    /// Executes an operation that got no definite reply.
    fn invoke(&mut self, op: &MissionOp) -> MissionResult {
        match op {
            MissionOp::Submit => self.exists = true,
            MissionOp::Cancel => self.cancel_requested = true,
            MissionOp::Resolve => self.resolve_requested = true,
            MissionOp::Read => {}
        }
        MissionResult::Unknown
    }

    fn is_valid_step(&mut self, op: &MissionOp, result: &MissionResult) -> bool {
        match (op, result) {
            (MissionOp::Submit, MissionResult::Submitted { mission, again, outcome }) => {
                self.submitted(mission, *again, outcome.as_ref())
            }
            // An acknowledged cancellation has taken effect.
            (MissionOp::Cancel, MissionResult::Changed(Some(state))) => {
                self.cancel_requested = true;
                self.is_known() && state.is_final() && self.advance(state)
            }
            (MissionOp::Resolve, MissionResult::Changed(Some(state))) => {
                self.resolve_requested = true;
                self.is_known() && state.is_final() && self.advance(state)
            }
            // A mission that has ended cannot be canceled.
            (MissionOp::Cancel, MissionResult::Refused) => {
                self.ended |= self.exists;
                true
            }
            (MissionOp::Submit | MissionOp::Resolve, MissionResult::Refused) => true,
            (MissionOp::Read, MissionResult::Read(None)) => !self.exists,
            (MissionOp::Read, MissionResult::Read(Some(state))) => self.is_known() && self.advance(state),
            (MissionOp::Read, MissionResult::NotListed) => {
                self.ended |= self.exists;
                true
            }
            (MissionOp::Submit | MissionOp::Read, MissionResult::Forgotten) => {
                self.forget();
                true
            }
            _ => false,
        }
    }
}
