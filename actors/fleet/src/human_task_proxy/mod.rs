//! The human task proxy: executes unmanaged roles on behalf of people, who take no orders from the
//! fleet.
//!
//! The proxy follows the active missions. It executes the local plan of each unmanaged role as far
//! as the signals of other roles permit, sends its tasks to people through the driver server, and
//! signals their end to the other roles. A fleet needs a single proxy; several do no harm, because
//! requests and signals have ids and their repetition has no effect.
//!
//! The proxy stores nothing. After a restart it repeats each request under the same id if the
//! request is still needed. The driver server cancels requests that are no longer repeated.

mod actor;
mod message;
mod proxy_role;
mod requests;
mod roles;
mod state;

pub(crate) use actor::HumanTaskProxy;
pub(crate) use state::HumanTaskProxySettings;
