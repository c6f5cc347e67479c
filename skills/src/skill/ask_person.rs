//! The leaf that asks a person.

use super::context::TaskContext;
use crate::bt::{
    Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus, PortSpec, PortType, Registry, RegistryError,
};
use consort_protocol::ids::{PlaceId, RoleId};
use consort_protocol::ledger::PersonQuestion;
use consort_protocol::mission::{Escalation, PATIENCE_MAX_S};

/// Name of the node.
pub(crate) const ASK_PERSON: &str = "AskPerson";

pub(super) const ROLE: &str = "role";
pub(super) const MESSAGE: &str = "message";
const AT: &str = "at";
pub(super) const PATIENCE: &str = "patience_s";
pub(super) const ESCALATE_TO: &str = "escalate_to";
pub(super) const ESCALATE_AFTER: &str = "escalate_after_s";
const ANSWER: &str = "answer";

/// Asks people with a role, and waits for the answer of one of them. Without an answer for a while
/// it asks people with another role, too. It fails if a person declines or cannot answer, and if
/// nobody answers in time.
#[derive(Default)]
struct AskPersonLeaf {
    /// The open question.
    open: Option<PersonQuestion>,
}

pub(super) fn register_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let seconds = |port| PortSpec::input(port, PortType::Integer).in_range(1.0, f64::from(PATIENCE_MAX_S)).optional();
    let ports = [
        PortSpec::input(ROLE, PortType::Role),
        PortSpec::input(MESSAGE, PortType::Text),
        PortSpec::input(AT, PortType::Place).optional(),
        seconds(PATIENCE),
        PortSpec::input(ESCALATE_TO, PortType::Role).optional(),
        seconds(ESCALATE_AFTER),
        PortSpec::output(ANSWER, PortType::Text).optional(),
    ];
    let manifest = NodeManifest::new(ASK_PERSON, NodeKind::Action, ports).with_pair(ESCALATE_TO, ESCALATE_AFTER);
    registry.register(manifest, |_: &TaskContext| Box::new(AskPersonLeaf::default()))
}

impl AskPersonLeaf {
    fn question(context: &LeafContext<'_, '_>) -> Result<PersonQuestion, Cause> {
        let to = context.read::<RoleId>(ROLE)?;
        let other = context.read_optional::<RoleId>(ESCALATE_TO)?;
        let escalation = match (other, seconds(context, ESCALATE_AFTER)?) {
            (Some(other), _) if other == to => {
                return Err(Cause::new(format!("{ESCALATE_TO} is {to}, which is asked already")));
            }
            (Some(to), Some(after_s)) => Some(Box::new(Escalation { to, after_s })),
            (None, None) => None,
            (Some(_), None) | (None, Some(_)) => {
                return Err(Cause::new(format!("{ESCALATE_TO} and {ESCALATE_AFTER} need values, both or neither")));
            }
        };
        Ok(PersonQuestion {
            to,
            message: context.read(MESSAGE)?,
            at: context.read_optional::<PlaceId>(AT)?,
            patience_s: seconds(context, PATIENCE)?,
            escalation,
        })
    }
}

/// Reads a time in seconds.
fn seconds(context: &LeafContext<'_, '_>, port: &str) -> Result<Option<u32>, Cause> {
    let seconds = context.read_optional::<i64>(port)?.map(|given| {
        // The constraint of the port was checked when its value was written.
        u32::try_from(given).map_err(|_| Cause::new(format!("{port} is {given}; allowed is 1 to {PATIENCE_MAX_S}")))
    });
    seconds.transpose()
}

impl Leaf for AskPersonLeaf {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        let question = self.open.take().map_or_else(|| Self::question(context), Ok)?;
        match context.actions().ask_person(&question) {
            None => {
                self.open = Some(question);
                Ok(NodeStatus::Running)
            }
            Some(answer) => {
                context.write(ANSWER, answer.map_err(Cause::new)?)?;
                Ok(NodeStatus::Success)
            }
        }
    }

    fn halt(&mut self, context: &mut LeafContext<'_, '_>) {
        self.open = None;
        context.actions().withdraw_question();
    }
}
