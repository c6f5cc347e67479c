//! The leaf that asks a person.

use super::context::TaskContext;
use crate::bt::{
    Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus, PortSpec, PortType, Registry, RegistryError,
};
use consort_protocol::ids::{PlaceId, RoleId};
use consort_protocol::ledger::PersonQuestion;

const ROLE: &str = "role";
const MESSAGE: &str = "message";
const AT: &str = "at";
const PATIENCE: &str = "patience_s";
const ANSWER: &str = "answer";

/// Asks people with a role, and waits for the answer of one of them. It fails if a person declines or
/// cannot answer, and if nobody answers in time.
#[derive(Default)]
struct AskPersonLeaf {
    /// The open question.
    open: Option<PersonQuestion>,
}

pub(super) fn register_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [
        PortSpec::input(ROLE, PortType::Role),
        PortSpec::input(MESSAGE, PortType::Text),
        PortSpec::input(AT, PortType::Place).optional(),
        PortSpec::input(PATIENCE, PortType::Integer).optional(),
        PortSpec::output(ANSWER, PortType::Text).optional(),
    ];
    registry.register(NodeManifest::new("AskPerson", NodeKind::Action, ports), |_: &TaskContext| {
        Box::new(AskPersonLeaf::default())
    })
}

impl AskPersonLeaf {
    fn question(context: &LeafContext<'_, '_>) -> Result<PersonQuestion, Cause> {
        let patience_s = context.read_optional::<i64>(PATIENCE)?.map(|patience| {
            let seconds = u32::try_from(patience).ok().filter(|seconds| *seconds > 0);
            seconds.ok_or_else(|| Cause::new(format!("{PATIENCE} is {patience}, allowed is 1 to {}", u32::MAX)))
        });
        Ok(PersonQuestion {
            to: context.read::<RoleId>(ROLE)?,
            message: context.read(MESSAGE)?,
            at: context.read_optional::<PlaceId>(AT)?,
            patience_s: patience_s.transpose()?,
        })
    }
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
