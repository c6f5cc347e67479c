//! Requests of people that close zones, places and lanes, and open them.

use super::api::{ApiError, ApiHandler};
use super::map_parts::map_parts;
use consort_protocol::api::{CLOSE_S_MAX, CloseRequest, ClosuresReply, OpenRequest, parse_request};
use consort_protocol::ids::RequestId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{ClosureChange, Command, MapPart};
use std::collections::BTreeSet;

impl ApiHandler {
    /// Closes zones, places and lanes.
    pub(super) async fn close(&self, payload: &[u8]) -> Result<ClosuresReply, ApiError> {
        let CloseRequest { places, lanes, for_s, until, reason, by, request } = parse_request(ApiCall::Close, payload)?;
        let parts = map_parts(places, lanes, &self.domain, &BTreeSet::new())?;
        let until_ms = self.end_of_period_ms(for_s, until)?;
        self.change_closures(parts, ClosureChange::Close { until_ms, reason }, by, request).await
    }

    /// Opens closed zones, places and lanes.
    pub(super) async fn open(&self, payload: &[u8]) -> Result<ClosuresReply, ApiError> {
        let OpenRequest { places, lanes, by, request } = parse_request(ApiCall::Open, payload)?;
        let closed = self.replica.read(|ledger| ledger.closures().map(|closure| closure.part).collect());
        let parts = map_parts(places, lanes, &self.domain, &closed)?;
        self.change_closures(parts, ClosureChange::Open, by, request).await
    }

    /// Returns the end of a closure or a speed limit in milliseconds since 1970.
    pub(super) fn end_of_period_ms(&self, for_s: Option<u32>, until: Option<String>) -> Result<Option<u64>, ApiError> {
        match (for_s, until) {
            (Some(_), Some(_)) => Err("give `for_s` or `until`, not both".to_owned().into()),
            (Some(seconds), None) if !(1..=CLOSE_S_MAX).contains(&seconds) => {
                Err(format!("for_s is {seconds}; allowed are 1 to {CLOSE_S_MAX}").into())
            }
            (Some(seconds), None) => Ok(Some(self.time_ms()?.saturating_add(u64::from(seconds) * 1000))),
            (None, until) => self.end_ms(until),
        }
    }

    /// Commits a change of closures, and returns those in force.
    async fn change_closures(
        &self,
        parts: BTreeSet<MapPart>,
        change: ClosureChange,
        by: Option<String>,
        request: Option<RequestId>,
    ) -> Result<ClosuresReply, ApiError> {
        let order = self.order_request(change, by, request)?;
        self.commit_order(Command::ChangeClosures { parts, order }).await?;
        Ok(ClosuresReply { closures: self.replica.read(|ledger| ledger.closures().collect()) })
    }
}
