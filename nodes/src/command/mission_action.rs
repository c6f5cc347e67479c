//! What commands share that do something with a mission on somebody's word.

use crate::client::QueryFlags;
use crate::exit::Failure;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use serde_json::{Value, json};

/// Which mission, and on whose word.
#[derive(Debug, clap::Args)]
pub(super) struct MissionActionFlags {
    /// The mission, as `consort missions` names it
    mission: MissionId,
    /// On whose word, for the record
    #[arg(long, env = "CONSORT_BY", default_value = "an operator")]
    by: String,
    #[command(flatten)]
    ask: QueryFlags,
}

impl MissionActionFlags {
    /// Makes the request, and prints how the mission stands now; `word` has that in a word.
    ///
    /// # Errors
    /// As [`AskFlags::print`].
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
