//! Flags of commands with which people change the fleet.

use crate::client::{QueryFlags, new_request_id};
use crate::exit::Failure;
use consort_protocol::ids::RequestId;
use consort_protocol::keys::ApiCall;
use serde::{Deserialize, Serialize};

/// Flags for the person and for the fleet.
#[derive(Debug, clap::Args)]
pub(super) struct ChangeFlags {
    /// Name of the responsible person, for the record
    #[arg(long, env = "CONSORT_BY", value_name = "NAME")]
    pub(super) by: Option<String>,
    #[command(flatten)]
    pub(super) query: QueryFlags,
}

/// Flag for the reason of an order.
#[derive(Debug, clap::Args)]
pub(super) struct ReasonFlag {
    /// Reason, for the record
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    pub(super) reason: String,
}

impl ChangeFlags {
    /// Sends the request that `request` makes of the person and of a new id, and prints the reply as JSON or as text.
    ///
    /// # Errors
    /// See [`QueryFlags::print`] and [`Client::api`](crate::client::Client::api).
    pub(super) fn send<Request: Serialize, Reply: for<'de> Deserialize<'de>>(
        self,
        call: ApiCall,
        request: impl FnOnce(Option<String>, Option<RequestId>) -> Request,
        text: impl FnOnce(&Reply) -> String,
    ) -> Result<(), Failure> {
        let ChangeFlags { by, query } = self;
        let request = request(by, Some(new_request_id()));
        query.print(async |client| client.api(call, &request).await, text)
    }
}
