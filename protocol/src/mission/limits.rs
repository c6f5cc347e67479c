//! Limits of missions, enforced where a mission is parsed or decoded.

/// Maximum number of tasks of a mission, including abstract tasks. Raised: more memory on every
/// robot and ledger; the largest published mission has 21 tasks.
pub(crate) const TASKS_MAX: usize = 512;
/// Maximum number of roles of a mission.
pub(crate) const ROLES_MAX: usize = 64;
/// Maximum number of ensembles that a mission names.
pub(crate) const ENSEMBLES_MAX: usize = 16;
/// Maximum number of levels of the tree.
pub(crate) const DEPTH_MAX: usize = 32;
/// Maximum number of roles of a joint task: each role signals to each other role, so the number of
/// messages grows quadratically.
pub(crate) const JOINT_MAX: usize = 8;
/// Maximum number of conditions of a task.
pub(crate) const CONDITIONS_MAX: usize = 16;
/// Maximum number of parameters, and of reached states, of a task.
pub(crate) const ENTRIES_MAX: usize = 32;
/// Maximum length of a name or value of a parameter or of a reached state, in characters.
pub(crate) const VALUE_CHARS_MAX: usize = 256;
/// Maximum bound on the time of a mission, in seconds: ten years, as for the deadline of a request.
pub(crate) const TIME_LIMIT_MAX_S: u32 = 10 * 365 * 24 * 3600;
/// Maximum size of a mission file, in bytes. 500 tasks with long comments take a third of it.
pub const FILE_BYTES_MAX: usize = 256 * 1024;
