//! Shared parts of commands that a person applies to a mission.

use crate::client::QueryFlags;
use crate::exit::Failure;
use consort_protocol::api::{MissionChangeReply, MissionChangeRequest};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;

/// Flags for the mission and the person.
#[derive(Debug, clap::Args)]
pub(super) struct MissionActionFlags {
    /// The mission, as named by `consort missions`
    mission: MissionId,
    /// Name of the responsible person, for the record. Default: in a closed fleet the name in your
    /// certificate, else "an operator"
    #[arg(long, env = "CONSORT_BY", value_name = "NAME")]
    by: Option<String>,
    #[command(flatten)]
    ask: QueryFlags,
}

impl MissionActionFlags {
    /// Sends the request, and prints the mission's new state; `word` extracts the state's name.
    ///
    /// # Errors
    /// See [`QueryFlags::print`].
    pub(super) fn request(
        &self,
        call: ApiCall,
        word: impl FnOnce(Option<&MissionState>) -> &'static str,
    ) -> Result<(), Failure> {
        self.ask.print(
            async |client| {
                let by = self.by.clone().or_else(|| client.is_anonymous().then(|| "an operator".to_owned()));
                client.api(call, &MissionChangeRequest { mission: self.mission.clone(), by }).await
            },
            |MissionChangeReply { mission, state }: &MissionChangeReply| {
                let detail = state.as_ref().map(super::missions::detail).unwrap_or_default();
                format!("{mission} {}{detail}", word(state.as_ref()))
            },
        )
    }
}
