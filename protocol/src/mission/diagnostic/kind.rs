//! Kinds of problems in missions.

use super::ihtn::IhtnError;
use crate::ids::{EnsembleId, ItemId, NameError, RoleId, TaskId, TaskType};
use consort_text::AllowedNames;

/// Kind of problem in a mission.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MissionErrorKind {
    /// A name is invalid.
    #[error(transparent)]
    Name(#[from] NameError),

    /// The mission has no task.
    #[error("the mission has no task; the first task is the root")]
    NoTask,
    /// There are too many tasks.
    #[error("{found} tasks; at most {max} are allowed")]
    TooManyTasks {
        /// Number found.
        found: usize,
        /// Maximum.
        max: usize,
    },
    /// There are too many roles.
    #[error("{found} roles; at most {max} are allowed")]
    TooManyRoles {
        /// Number found.
        found: usize,
        /// Maximum.
        max: usize,
    },
    /// There are too many ensembles.
    #[error("{found} ensembles; at most {max} are allowed")]
    TooManyEnsembles {
        /// Number found.
        found: usize,
        /// Maximum.
        max: usize,
    },
    /// The fleet does not have the ensemble.
    #[error("the fleet has no ensemble `{name}`; {allowed}")]
    UnknownEnsemble {
        /// As given.
        name: EnsembleId,
        /// Ensembles of the fleet.
        allowed: AllowedNames,
    },
    /// There are too many levels of refinement.
    #[error("is {found} levels deep; at most {max} are allowed")]
    TooDeep {
        /// Depth of the task; the root has depth 1.
        found: usize,
        /// Maximum depth.
        max: usize,
    },
    /// A child does not exist.
    #[error("is refined into task number {child}, but the mission has {tasks} tasks, counted from 0")]
    ChildOutOfRange {
        /// Index of the child.
        child: u32,
        /// Number of tasks.
        tasks: usize,
    },
    /// A child is at or before its parent, as in every cycle.
    #[error("is refined into `{child}`, which is not listed after it: a cycle, or tasks out of order")]
    ChildNotAfter {
        /// The child.
        child: String,
    },
    /// A node occurs in two places of the tree, or twice in the same place.
    #[error("is refined into `{child}`, which already belongs to {parent}; a task has one parent")]
    TwoParents {
        /// The child.
        child: String,
        /// Path of its other parent.
        parent: String,
    },
    /// A node has no parent.
    #[error("belongs to no task; only the first task, the root, has no parent")]
    NoParent,
    /// A method has no tasks.
    #[error("its method has no tasks; a method needs at least 1 task")]
    EmptyMethod,
    /// Two tasks have the same name.
    #[error("has the same name as {first}; task names must be unique in a mission")]
    DuplicateId {
        /// Path of the first task with that name.
        first: String,
    },
    /// The roles of the iterations of a spread loop have the name of another role.
    #[error("is spread over the iterations of a loop, as `{role}`, but there is already a role with this name")]
    DuplicateRole {
        /// The name.
        role: RoleId,
    },

    /// No role is managed.
    #[error("no role is managed; a mission needs at least 1 role that a robot fills")]
    NoManagedRole,
    /// A role has no task.
    #[error("has no task; add a task for it or remove it")]
    UnusedRole,
    /// A task has no role.
    #[error("has no role; name at least 1 role, {allowed}")]
    NoRole {
        /// The mission's roles.
        allowed: AllowedNames,
    },
    /// A role is not declared in the mission.
    #[error("unknown role `{role}`; {allowed}")]
    UnknownRole {
        /// As given.
        role: String,
        /// The mission's roles.
        allowed: AllowedNames,
    },
    /// A role is named twice.
    #[error("names the role `{role}` twice")]
    RoleTwice {
        /// The role.
        role: RoleId,
    },
    /// Too many roles execute a task jointly.
    #[error("{found} roles execute it jointly; at most {max} are allowed")]
    TooManyJoint {
        /// Number found.
        found: usize,
        /// Maximum.
        max: usize,
    },
    /// The task type is not in the domain.
    #[error("unknown task type `{task_type}`; {allowed}")]
    UnknownType {
        /// As given.
        task_type: String,
        /// The domain's task types.
        allowed: AllowedNames,
    },
    /// The task type does not have the parameter.
    #[error("`{task_type}` has no parameter `{name}`; {allowed}")]
    UnknownParameter {
        /// Type of the task.
        task_type: String,
        /// Parameter as given.
        name: String,
        /// Parameters of the type.
        allowed: AllowedNames,
    },
    /// A required parameter is missing.
    #[error("`{task_type}` needs the parameter `{name}`: {kind}")]
    MissingParameter {
        /// Type of the task.
        task_type: String,
        /// Missing parameter.
        name: String,
        /// Required kind of value, as text.
        kind: String,
    },
    /// A value is not of the kind of its parameter.
    #[error("parameter `{name}` is {value:?}; it must be {kind}")]
    BadValue {
        /// The parameter.
        name: String,
        /// Value as given.
        value: String,
        /// Required kind of value, as text.
        kind: String,
    },
    /// A place is not on the map.
    #[error("`{name}` is the place {place:?}, which is not on the fleet's map; {allowed}")]
    UnknownPlace {
        /// The parameter.
        name: String,
        /// Place as given.
        place: String,
        /// Places of the map.
        allowed: AllowedNames,
    },
    /// A parameter names a role that the mission does not have.
    #[error("parameter `{name}` names the role `{role}`, which is not declared in the mission; {allowed}")]
    ParameterRole {
        /// The parameter.
        name: String,
        /// Role as given.
        role: String,
        /// The mission's roles.
        allowed: AllowedNames,
    },
    /// A task has too many parameters or reached states.
    #[error("{found} {what}; at most {max} are allowed")]
    TooManyEntries {
        /// List concerned, as text.
        what: &'static str,
        /// Number found.
        found: usize,
        /// Maximum.
        max: usize,
    },
    /// A text is too long.
    #[error("{what} `{name}` has {found} characters; at most {max} are allowed")]
    TooLong {
        /// Text concerned.
        what: &'static str,
        /// Name, shortened.
        name: String,
        /// Length found.
        found: usize,
        /// Maximum length.
        max: usize,
    },

    /// The time to wait for the answer of a person is out of range.
    #[error("`{what}` is {found} s; 1 to {max} are allowed")]
    Patience {
        /// Field in the file.
        what: &'static str,
        /// Time in the file.
        found: u32,
        /// Maximum.
        max: u32,
    },
    /// A task of a robot has a time to wait for an answer.
    #[error("has `{what}`, but {role} is a managed role; only a task of people has it")]
    PatienceOfRobot {
        /// Field in the file.
        what: &'static str,
        /// The managed role.
        role: RoleId,
    },
    /// A request escalates to a role that a robot holds.
    #[error("escalates to {role}, which is a managed role; only people are asked")]
    EscalationToRobot {
        /// The managed role.
        role: RoleId,
    },
    /// A request escalates to the people that are asked first.
    #[error("escalates to {role}, which is asked from the beginning; name another role")]
    EscalationToAsked {
        /// The role.
        role: RoleId,
    },
    /// The number of attempts is out of range.
    #[error("has {found} attempts; 1 to {max} are allowed")]
    Attempts {
        /// As given.
        found: u8,
        /// Maximum.
        max: u8,
    },
    /// A task both acquires and releases an item.
    #[error("both acquires and releases the item `{item}`; only one of the two is allowed")]
    ItemTwice {
        /// The item.
        item: ItemId,
    },
    /// A task of robots moves an item, and no action of its type hands items over.
    #[error(
        "moves the item `{item}`, but no action of `{task_type}` hands items over: it needs `hands_over: true`; {allowed}"
    )]
    HandsNothingOver {
        /// The item.
        item: ItemId,
        /// Type of the task.
        task_type: TaskType,
        /// The task types with such an action.
        allowed: AllowedNames,
    },
    /// Two tasks that move the same item are unordered, so that custody would be undefined.
    #[error("touches the item `{item}`, as does {other}, and the two tasks are unordered; put them in sequence")]
    ItemUnordered {
        /// The item.
        item: ItemId,
        /// The other task.
        other: TaskId,
    },
    /// An expression is invalid.
    #[error("`{text}`: {problem}")]
    Expression {
        /// Text of the expression.
        text: String,
        /// Description of the problem.
        problem: String,
    },
    /// A task uses the results of a task that does not exist.
    #[error("uses a result of `{task}`, which is no elementary task of the mission; {allowed}")]
    UnknownTask {
        /// As given.
        task: String,
        /// Elementary tasks of the mission.
        allowed: AllowedNames,
    },
    /// A task uses the results of a task that may end later.
    #[error("uses a result of {task}, which may end later; put {task} before it, in sequence")]
    LaterTask {
        /// The other task.
        task: TaskId,
    },
    /// The task type does not return the result.
    #[error("uses {task}.{result}, but `{task_type}` returns no such result; {allowed}")]
    UnknownResult {
        /// The other task.
        task: TaskId,
        /// As given.
        result: String,
        /// Type of the other task.
        task_type: TaskType,
        /// Results of the type.
        allowed: AllowedNames,
    },
    /// A result does not fit the parameter.
    #[error("parameter `{name}` must be {kind}, and {task}.{result} is {found}")]
    ResultKind {
        /// The parameter.
        name: String,
        /// Required kind of value, as text.
        kind: String,
        /// The other task.
        task: TaskId,
        /// The result.
        result: String,
        /// Kind of the result, as text.
        found: String,
    },
    /// The outcomes of the tasks may not fit in a report.
    #[error("the results of its tasks may have {bytes} bytes; at most {max} are allowed: a text counts 256")]
    LargeResults {
        /// Maximum size of all results in bytes.
        bytes: usize,
        /// Limit.
        max: usize,
    },
    /// A conditional task moves an item, so that custody would be undefined.
    #[error("has a condition and touches the item `{item}`; custody of an item must not depend on a condition")]
    ConditionalItem {
        /// The item.
        item: ItemId,
    },
    /// A task of an alternative uses results.
    #[error("is part of an alternative; it can use no results of other tasks")]
    AlternativeUsesResults,
    /// A recovery branch is never taken.
    #[error("is never taken: no task of the mission acquires an item")]
    UnusedRecovery,
    /// A method with alternatives is not local to a single role.
    #[error(
        "has alternatives, so a single managed role must execute its tasks and theirs, and none may touch an item; \
         but {task} {problem}"
    )]
    NonLocalAlternatives {
        /// Task that is not local.
        task: TaskId,
        /// Reason, as text.
        problem: String,
    },

    /// A node of a mission file is both abstract and elementary, or neither.
    #[error(
        "a task has either `method` and `tasks`, or `type` and `roles` (and `parameters`, `reaches`); this task {problem}"
    )]
    InvalidTaskShape {
        /// Description of the problem.
        problem: String,
    },
    /// A `${…}` is not closed or not a name.
    #[error("{text:?}: {problem}; write `${{name}}` for a parameter and `$$` for a dollar sign")]
    Substitution {
        /// Text that contains it.
        text: String,
        /// Description of the problem.
        problem: String,
    },
    /// A `${…}` names a parameter that the file does not declare.
    #[error("`${{{name}}}` is not a parameter of the mission; {allowed}")]
    UnknownReference {
        /// Name in braces.
        name: String,
        /// Declared parameters.
        allowed: AllowedNames,
    },
    /// A declared parameter is not used.
    #[error("is declared, but `${{{name}}}` is not used in any task or condition")]
    UnusedParameter {
        /// The parameter.
        name: String,
    },
    /// A request gives a parameter that the mission does not declare.
    #[error("is given, but the mission has no such parameter; {allowed}")]
    UnknownArgument {
        /// Declared parameters.
        allowed: AllowedNames,
    },
    /// A request lacks a parameter that the mission requires.
    #[error("is not given and has no default; it must be {kind}")]
    MissingArgument {
        /// Required kind of value, as text.
        kind: String,
    },

    /// A node of a flat iHTN is invalid.
    #[error(transparent)]
    Ihtn(#[from] IhtnError),
}
