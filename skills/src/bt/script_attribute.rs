//! Script attributes of nodes: pre- and postconditions.

/// A script attribute of a node, in the order of evaluation. Names and rules are those of
/// BehaviorTree.CPP 4.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ScriptAttribute {
    /// `_failureIf`: a node that is not running fails if the condition is true.
    FailureIf,
    /// `_successIf`: a node that is not running succeeds if the condition is true.
    SuccessIf,
    /// `_skipIf`: a node that is not running is skipped if the condition is true.
    SkipIf,
    /// `_while`: a node is skipped if the condition is false. A running node is halted first.
    While,
    /// `_onSuccess`: executed when the node succeeds.
    OnSuccess,
    /// `_onFailure`: executed when the node fails.
    OnFailure,
    /// `_onHalted`: executed after the running node was halted.
    OnHalted,
    /// `_post`: executed when the node succeeds or fails, after the two above.
    Post,
}

impl ScriptAttribute {
    /// All attributes, in the order of evaluation.
    pub const ALL: [ScriptAttribute; 8] = [
        ScriptAttribute::FailureIf,
        ScriptAttribute::SuccessIf,
        ScriptAttribute::SkipIf,
        ScriptAttribute::While,
        ScriptAttribute::OnSuccess,
        ScriptAttribute::OnFailure,
        ScriptAttribute::OnHalted,
        ScriptAttribute::Post,
    ];

    /// The attribute in XML.
    pub const fn name(self) -> &'static str {
        match self {
            ScriptAttribute::FailureIf => "_failureIf",
            ScriptAttribute::SuccessIf => "_successIf",
            ScriptAttribute::SkipIf => "_skipIf",
            ScriptAttribute::While => "_while",
            ScriptAttribute::OnSuccess => "_onSuccess",
            ScriptAttribute::OnFailure => "_onFailure",
            ScriptAttribute::OnHalted => "_onHalted",
            ScriptAttribute::Post => "_post",
        }
    }

    /// Checks whether the script is a condition, and not a list of assignments.
    pub(crate) fn is_condition(self) -> bool {
        self <= ScriptAttribute::While
    }
}
