//! Missions: what is to be done, in which order, by which roles.
//!
//! A mission is an instantiated hierarchical task network (iHTN: Lesire et al. 2016, as extended with roles by
//! Rodrigues): abstract tasks are refined by methods, whose tasks are in sequence or in no order, down to
//! elementary tasks, each assigned to one role or jointly to several.
//!
//! [`Mission`] is the checked value that travels, is divided and is kept in the ledger. It is flat (children by
//! index) so that decoding one can never recurse. Files, their parameters and the flat iHTN import produce it:
//!
//! ```text
//! YAML, JSON ─► MissionTemplate ─ parameters, Domain ─► Mission ─► plan::divide
//! flat iHTN ─────────────────────── IhtnReading ──────────▲
//! off the wire ────────────────── Mission::check ─────────┘
//! ```

mod diagnostic;
mod domain;
mod file;
mod ihtn;
mod lost_item;
mod model;
mod request;
mod shipped;
mod validate;

pub use diagnostic::{AllowedNames, MissionDiagnostic, MissionErrorKind, MissionErrors};
pub use domain::{Domain, ParameterSchema, TaskSchema, ValueKind};
pub use file::{FILE_BYTES_MAX, Format, MissionFileError, MissionTemplate, TemplateKind, TemplateParameter};
pub use ihtn::{IhtnError, IhtnOptions, import_ihtn};
pub use lost_item::LostItem;
pub use model::{
    ATTEMPTS, ATTEMPTS_MAX, AlternativeMethod, Method, Mission, OnLoss, Role, RoleKind, TaskBody, TaskIndex, TaskNode,
    TaskOrder, TaskSpec,
};
pub use shipped::shipped;
pub use validate::{DEPTH_MAX, ENTRIES_MAX, JOINT_MAX, ROLES_MAX, TASKS_MAX, VALUE_CHARS_MAX};
