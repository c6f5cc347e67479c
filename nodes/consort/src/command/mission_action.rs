//! Shared parts of commands that a person applies to a mission.

use crate::client::QueryFlags;
use crate::exit::Failure;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use serde_json::{Value, json};

/// Flags for the mission and the person.
#[derive(Debug, clap::Args)]
pub(super) struct MissionActionFlags {
    /// The mission, as named by `consort missions`
    mission: MissionId,
    /// Name of the responsible person, for the record
    #[arg(long, env = "CONSORT_BY", default_value = "an operator")]
    by: String,
    #[command(flatten)]
    ask: QueryFlags,
}

impl MissionActionFlags {
    /// Sends the request, and prints the mission's new state; `word` extracts the state's name.
    ///
    /// # Errors
    /// See [`QueryFlags::print`].
    pub(super) fn request(&self, call: ApiCall, word: impl FnOnce(&Value) -> String) -> Result<(), Failure> {
        let request = json!({ "mission": self.mission, "by": self.by });
        self.ask.print(
            async |client| client.api(call, &request).await,
            |answer| {
                let state = &answer["state"];
                format!("{} {}{}", self.mission, word(state), super::missions::detail(state))
            },
        )
    }
}
