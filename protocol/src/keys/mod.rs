//! All keys of the project. Other code calls this module to format and to parse keys.
//!
//! ```text
//! consort/{fleet}/wire/**   bincode, between nodes             (messages: see `message`)
//! consort/{fleet}/view/**   JSON, for people and any client    get: the fleet as any node sees it
//! consort/{fleet}/seen/**   JSON, for people and any client    get: {node}/…: the same views, from this node
//! consort/{fleet}/api/**    JSON, for people and any client    query: submit, cancel, get, list, help, leave/{node} …
//! consort/{fleet}/alive/**  presence tokens                    robot/{id}, node/{id}, coordinator/{term}/{id}
//! consort/{fleet}/events/** JSON, published                    {node}: events of this node, as they happen
//! ```
//!
//! [`TABLE`] lists each key with its owner, usage and content.
//!
//! ```
//! use consort_protocol::ids::{FleetId, RobotId};
//! use consort_protocol::keys::{Key, Keys};
//!
//! let keys = Keys::new(&FleetId::new("ward")?);
//! let award = Key::Award(RobotId::new("ada")?);
//! assert_eq!(keys.write(&award), "consort/ward/wire/award/ada");
//! assert_eq!(keys.read("consort/ward/wire/award/ada"), Some(award));
//! assert_eq!(keys.read("consort/annex/wire/award/ada"), None); // a key of another fleet
//! # Ok::<(), consort_protocol::ids::NameError>(())
//! ```

mod call;
mod fleet_keys;
mod key;
mod priority;
mod table;

pub use call::{ApiCall, DriverCall, KeyKind, PeopleCall, RaftCall};
pub use fleet_keys::Keys;
pub use key::Key;
pub use priority::Priority;
pub use table::{KeyInfo, KeyUsage, TABLE};

#[cfg(test)]
mod tests;
