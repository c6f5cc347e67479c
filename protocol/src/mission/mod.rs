//! Missions: tasks, their order, and the roles that execute them.
//!
//! A mission is an instantiated hierarchical task network (iHTN: Lesire et al. 2016, as extended
//! with roles by Rodrigues). Abstract tasks are refined by methods. The tasks of a method are in
//! sequence or unordered, down to elementary tasks. Each elementary task is assigned to a single
//! role, or jointly to several.
//!
//! [`Mission`] is the checked value that is sent, divided and stored in the ledger. It is flat
//! (children by index) so that decoding never recurses. It is created from files, their parameters,
//! and the flat iHTN import:
//!
//! ```text
//! YAML, JSON ─► MissionTemplate ─ parameters, Domain ─► Mission ─► plan::divide
//! flat iHTN ────────────────────────── import_ihtn ───────▲
//! network ─────────────────────── Mission::check ─────────┘
//! ```
//!
//! [`MissionDocument`] is either of the first two, for every program that takes a mission.

mod bits;
mod condition;
mod diagnostic;
mod document;
mod domain;
mod file;
mod ihtn;
mod ihtn_names;
mod limits;
mod lost_item;
mod model;
mod order;
mod outcome;
mod policies;
mod references;
mod structure;
#[cfg(test)]
pub(crate) mod test_data;
mod validate;

pub use crate::domain_reference::{DomainHash, DomainReference, OtherDomain};
pub(crate) use bits::Bits;
pub use diagnostic::{IhtnError, MissionDiagnostic, MissionErrorKind, MissionErrors};
pub use document::{IhtnFields, MissionDocument};
pub use domain::{Domain, NumberRange, ParameterSchema, TaskSchema, ValueKind, check_results};
pub use file::{Format, MissionFileError, MissionTemplate, TemplateKind, TemplateParameter};
pub use ihtn::{ActionUse, IhtnOptions, UndeclaredActions, import_ihtn, is_flat_ihtn, undeclared_actions};
pub use ihtn_names::IhtnNames;
pub use limits::FILE_BYTES_MAX;
pub(crate) use limits::{ENSEMBLES_MAX, ROLES_MAX, TIME_LIMIT_MAX_S};
pub(crate) use lost_item::LostItem;
pub use model::{
    AlternativeMethod, Escalation, Method, Mission, OnLoss, PATIENCE_MAX_S, ResultReference, Role, RoleKind, TaskBody,
    TaskIndex, TaskNode, TaskOrder, TaskSpec,
};
pub use order::GlobalOrder;
pub(crate) use outcome::OUTCOMES_BYTES_MAX;
pub use outcome::{RESULTS_MAX, TaskOutcome, TaskOutcomes};
