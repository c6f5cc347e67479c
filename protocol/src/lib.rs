//! The decisions of Consort, as plain values.
//!
//! Missions and their division into local plans, knowledge and membership, bids and their
//! selection, leases, the state machine of the ledger, the messages between nodes and all keys.
//! This crate never blocks: it has no async code, no clock, no socket and no actor, so every
//! decision can be called, compared and fuzzed alone.
//!
//! From a mission file to the local plan of each role:
//!
//! ```
//! use consort_protocol::ids::NameError;
//! use consort_protocol::mission::{Domain, Format, MissionTemplate, TaskSchema, ValueKind};
//! use consort_protocol::plan::divide_and_check;
//!
//! let file = r#"
//! mission: greet
//! parameters: { room: { kind: place } }
//! roles: { r1: { kind: managed }, clerk: { kind: unmanaged } }
//! root:
//!   task: greet
//!   method: sequential
//!   tasks:
//!     - { task: go, type: navigation, roles: [r1], parameters: { to: "${room}" } }
//!     - { task: meet, type: wait, roles: [r1, clerk], parameters: { seconds: "5" } }
//! "#;
//! let task_types = [
//!     ("navigation", TaskSchema::default().required("to", ValueKind::Place)),
//!     ("wait", TaskSchema::default().required("seconds", ValueKind::Seconds)),
//! ];
//! let domain = task_types.into_iter().try_fold(Domain::default(), |domain, (name, schema)| {
//!     Ok::<_, NameError>(domain.with(name.parse()?, schema))
//! })?;
//! let template = MissionTemplate::parse(file, Format::Yaml)?;
//! let room = [("room".to_owned(), "IC Room 6".to_owned())].into();
//! let mission = template.instantiate(&room, &domain)?;
//! let division = divide_and_check(&mission)?;
//! // Division adds messages between the roles: the robot notifies the clerk when it arrives.
//! let steps = |role: &str| division.plans.iter().find(|(id, _)| id.as_str() == role).map(|(_, plan)| plan.steps.len());
//! assert!(steps("r1") > Some(2) && steps("clerk") > Some(1));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod access;
pub mod api;
pub mod auction;
mod bounds;
pub mod cause;
pub mod chargers;
pub mod charging_curve;
pub mod codec;
pub mod devices;
mod domain_reference;
pub mod ensemble;
pub mod event;
pub mod expression;
pub mod fnv;
pub mod ids;
pub mod keys;
pub mod knowledge;
pub mod lease;
pub mod ledger;
mod loop_depth;
pub mod message;
pub mod mission;
pub mod plan;
pub mod pose;
pub mod resource_leases;
pub mod scalar;
mod schema;
pub mod timeline;
pub mod timing;
pub mod trust;
pub mod units;
pub mod versions;
pub mod view;
mod word_enum;
pub mod yaml;
