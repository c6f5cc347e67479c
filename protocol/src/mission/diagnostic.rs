//! What can be wrong with a mission, said so that its writer can mend it.

use crate::count::count;
use crate::ids::{ItemId, NameError, RoleId, TaskId};
use std::fmt;

/// All that is wrong with a mission. Ordinary for a mission written by hand; nothing was taken over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissionErrors {
    /// The mission, by the name it gives itself.
    pub mission: String,
    /// Every problem that was found, in the order of the file. Never empty.
    pub diagnostics: Vec<MissionDiagnostic>,
}

impl fmt::Display for MissionErrors {
    /// One line for the mission, then one line a problem.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "mission {} has {}:", self.mission, count(self.diagnostics.len(), "problem", "problems"))?;
        self.diagnostics.iter().try_for_each(|problem| write!(f, "\n  {problem}"))
    }
}

impl std::error::Error for MissionErrors {}

impl MissionErrors {
    /// `Ok` if there is no problem.
    pub(super) fn ok_if_empty(mission: impl fmt::Display, problems: Vec<MissionDiagnostic>) -> Result<(), Self> {
        if problems.is_empty() { Ok(()) } else { Err(Self { mission: mission.to_string(), diagnostics: problems }) }
    }
}

/// One thing that is wrong, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissionDiagnostic {
    /// Where: the tasks from the root down (`root/meet_nurse/navto_room`), or another part of the file
    /// (`roles/nurse`, `parameters/room`).
    pub path: String,
    /// What.
    pub kind: MissionErrorKind,
}

impl fmt::Display for MissionDiagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path, self.kind)
    }
}

/// The names that would have been right, and the likeliest of them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AllowedNames {
    /// All of them, in order.
    pub names: Vec<String>,
    /// The one that was probably meant.
    pub nearest: Option<String>,
}

/// How many allowed names a message lists.
const NAMES_SHOWN: usize = 24;

impl AllowedNames {
    /// The names allowed where `found` stood.
    pub fn suggest_for<T: fmt::Display>(found: &str, names: impl IntoIterator<Item = T>) -> Self {
        let names: Vec<String> = names.into_iter().map(|name| name.to_string()).collect();
        let nearest = names
            .iter()
            .map(|name| (distance(found, name), name))
            .filter(|(distance, name)| *distance <= 1 + name.chars().count().max(found.chars().count()) / 4)
            .min()
            .map(|(_, name)| name.clone());
        Self { names, nearest }
    }
}

impl fmt::Display for AllowedNames {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.names.is_empty() {
            return f.write_str("there are none to choose from");
        }
        let shown = &self.names[..self.names.len().min(NAMES_SHOWN)];
        write!(f, "allowed: {}", shown.join(", "))?;
        if self.names.len() > shown.len() {
            write!(f, " and {} more", self.names.len() - shown.len())?;
        }
        match &self.nearest {
            Some(name) => write!(f, "; did you mean `{name}`?"),
            None => Ok(()),
        }
    }
}

/// Edits (insert, delete, replace, swap of neighbours) from one name to the other, letter case aside.
fn distance(a: &str, b: &str) -> usize {
    let a: Vec<char> = a.chars().take(80).flat_map(char::to_lowercase).collect();
    let b: Vec<char> = b.chars().take(80).flat_map(char::to_lowercase).collect();
    let mut rows: Vec<Vec<usize>> = vec![(0..=b.len()).collect()];
    for i in 1..=a.len() {
        let mut row = vec![i];
        for j in 1..=b.len() {
            let replace = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut best = replace.min(rows[i - 1][j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(rows[i - 2][j - 2] + 1);
            }
            row.push(best);
        }
        rows.push(row);
    }
    rows[a.len()][b.len()]
}

/// What is wrong at one place of a mission.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MissionErrorKind {
    /// A name that is none.
    #[error(transparent)]
    Name(#[from] NameError),

    /// A mission without any task.
    #[error("there is no task at all; the first task is the root")]
    NoTask,
    /// Too many nodes.
    #[error("{found} tasks; at most {max} are allowed")]
    TooManyTasks {
        /// How many there are.
        found: usize,
        /// How many there may be.
        max: usize,
    },
    /// Too many roles.
    #[error("{found} roles; at most {max} are allowed")]
    TooManyRoles {
        /// How many there are.
        found: usize,
        /// How many there may be.
        max: usize,
    },
    /// Too many levels of refinement.
    #[error("stands {found} levels deep; at most {max} are allowed")]
    TooDeep {
        /// How deep it stands; the root stands at 1.
        found: usize,
        /// How deep it may stand.
        max: usize,
    },
    /// A child that does not exist.
    #[error("is refined into task number {child}, but the mission has {tasks} tasks, counted from 0")]
    ChildOutOfRange {
        /// The child's index.
        child: u32,
        /// How many tasks there are.
        tasks: usize,
    },
    /// A child at or before its parent, as in every cycle.
    #[error("is refined into `{child}`, which does not stand after it: a cycle, or tasks out of order")]
    ChildNotAfter {
        /// The child.
        child: String,
    },
    /// A node in two places of the tree, or twice in one.
    #[error("is refined into `{child}`, which already belongs to {parent}; a task has one parent")]
    TwoParents {
        /// The child.
        child: String,
        /// Path of its other parent.
        parent: String,
    },
    /// A node that hangs in the air.
    #[error("belongs to no task; only the first task, the root, has no parent")]
    NoParent,
    /// A method that does nothing.
    #[error("its method has no tasks; a method has at least one")]
    EmptyMethod,
    /// Two tasks of one name.
    #[error("has the name of {first}; task names are unique in a mission")]
    DuplicateId {
        /// Path of the first task of that name.
        first: String,
    },

    /// Nobody the fleet could provide.
    #[error("no role is managed; a mission needs at least one role that a robot fills")]
    NoManagedRole,
    /// A role without a task.
    #[error("has no task; give it one or leave it out")]
    UnusedRole,
    /// A task nobody does.
    #[error("no role does it; name at least one, {allowed}")]
    NoRole {
        /// The mission's roles.
        allowed: AllowedNames,
    },
    /// A role that the mission does not have.
    #[error("unknown role `{role}`; {allowed}")]
    UnknownRole {
        /// As given.
        role: String,
        /// The mission's roles.
        allowed: AllowedNames,
    },
    /// A role named twice.
    #[error("names the role `{role}` twice")]
    RoleTwice {
        /// The role.
        role: RoleId,
    },
    /// A joint task of too many.
    #[error("{found} roles do it jointly; at most {max} are allowed")]
    TooManyJoint {
        /// How many there are.
        found: usize,
        /// How many there may be.
        max: usize,
    },
    /// A kind of task that nothing realises.
    #[error("unknown task type `{task_type}`; {allowed}")]
    UnknownType {
        /// As given.
        task_type: String,
        /// The domain's task types.
        allowed: AllowedNames,
    },
    /// A parameter that the task type does not have.
    #[error("`{task_type}` has no parameter `{name}`; {allowed}")]
    UnknownParameter {
        /// The task's type.
        task_type: String,
        /// The parameter as given.
        name: String,
        /// The type's parameters.
        allowed: AllowedNames,
    },
    /// A parameter that the task type needs.
    #[error("`{task_type}` needs the parameter `{name}`: {kind}")]
    MissingParameter {
        /// The task's type.
        task_type: String,
        /// The parameter that is missing.
        name: String,
        /// What it should hold, in words.
        kind: String,
    },
    /// A value that is not of its parameter's kind.
    #[error("parameter `{name}` is {value:?}; it should be {kind}")]
    BadValue {
        /// The parameter.
        name: String,
        /// Its value.
        value: String,
        /// What it should hold, in words.
        kind: String,
    },
    /// A place that is on no map.
    #[error("`{name}` is the place {place:?}, which is not on the fleet's map; {allowed}")]
    UnknownPlace {
        /// The parameter.
        name: String,
        /// The place as given.
        place: String,
        /// The map's places.
        allowed: AllowedNames,
    },
    /// A parameter that names a role which the mission does not have.
    #[error("parameter `{name}` names the role `{role}`, which the mission does not have; {allowed}")]
    ParameterRole {
        /// The parameter.
        name: String,
        /// The role as given.
        role: String,
        /// The mission's roles.
        allowed: AllowedNames,
    },
    /// Too many parameters or reached states on one task.
    #[error("{found} {what}; at most {max} are allowed")]
    TooManyEntries {
        /// Which list, in words.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there may be.
        max: usize,
    },
    /// A text that is too long.
    #[error("{what} `{name}` has {found} characters; at most {max} are allowed")]
    TooLong {
        /// Which text, in words.
        what: &'static str,
        /// Its name, shortened.
        name: String,
        /// Its length.
        found: usize,
        /// How long it may be.
        max: usize,
    },

    /// Too few or too many attempts.
    #[error("has {found} attempts; allowed are 1 to {max}")]
    Attempts {
        /// As given.
        found: u8,
        /// How many there may be.
        max: u8,
    },
    /// An item that a task both hands over and lays down.
    #[error("both acquires and releases the item `{item}`; it does one or the other")]
    ItemTwice {
        /// The item.
        item: ItemId,
    },
    /// Two tasks that move one item in no order, so that nobody could tell who has it.
    #[error("touches the item `{item}`, as does {other}, and neither must come first; put them in sequence")]
    ItemUnordered {
        /// The item.
        item: ItemId,
        /// The other task.
        other: TaskId,
    },
    /// A recovery branch that is never taken.
    #[error("is never taken: no task of the mission acquires an item")]
    UnusedRecovery,
    /// A method with alternatives that is not one role's own affair.
    #[error(
        "has alternatives, so its tasks and theirs are done by one managed role alone and touch no item; \
         but {task} {problem}"
    )]
    NonLocalAlternatives {
        /// The task that is not.
        task: TaskId,
        /// In what way, in words.
        problem: String,
    },

    /// A node of a mission file that is both abstract and elementary, or neither.
    #[error(
        "a task has either `method` and `tasks`, or `type` and `roles` (and `parameters`, `reaches`); this one {problem}"
    )]
    InvalidTaskShape {
        /// What is wrong, in words.
        problem: String,
    },
    /// A `${…}` that is not closed or not a name.
    #[error("{text:?}: {problem}; write `${{name}}` for a parameter and `$$` for a dollar sign")]
    Substitution {
        /// The text that holds it.
        text: String,
        /// What is wrong, in words.
        problem: String,
    },
    /// A `${…}` of a parameter that the file does not declare.
    #[error("`${{{name}}}` is no parameter of the mission; {allowed}")]
    UnknownReference {
        /// The name in braces.
        name: String,
        /// The declared parameters.
        allowed: AllowedNames,
    },
    /// A declared parameter that no task uses.
    #[error("is declared, but `${{{name}}}` stands nowhere in the tasks")]
    UnusedParameter {
        /// The parameter.
        name: String,
    },
    /// A request that gives what the mission does not ask for.
    #[error("is given, but the mission has no such parameter; {allowed}")]
    UnknownArgument {
        /// The declared parameters.
        allowed: AllowedNames,
    },
    /// A request that does not give what the mission asks for.
    #[error("is not given and has no default; it should be {kind}")]
    MissingArgument {
        /// What it should hold, in words.
        kind: String,
    },

    /// What is wrong with a node of a flat iHTN.
    #[error(transparent)]
    Ihtn(#[from] super::ihtn::IhtnError),
}
