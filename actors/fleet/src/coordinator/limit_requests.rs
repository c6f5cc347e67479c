//! Requests of people that set speed limits, and clear them.

use super::api::{ApiError, ApiHandler};
use super::map_parts::map_parts;
use consort_protocol::api::{LimitAction, LimitRequest, LimitsReply, SPEED_LIMIT_MIN_MPS, parse_request};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{Command, SpeedLimitChange};
use std::collections::BTreeSet;

impl ApiHandler {
    /// Sets or clears speed limits, and returns those in force.
    pub(super) async fn limit(&self, payload: &[u8]) -> Result<LimitsReply, ApiError> {
        let LimitRequest { places, lanes, action, speed_mps, for_s, until, reason, by, request } =
            parse_request(ApiCall::Limit, payload)?;
        let (known, change) = match (action, speed_mps) {
            (LimitAction::Set, None) => return Err("the action `set` needs `speed_mps`".to_owned().into()),
            (LimitAction::Set, Some(speed)) if speed.get() < SPEED_LIMIT_MIN_MPS => {
                let text = format!(
                    "speed_mps is {}; allowed are {SPEED_LIMIT_MIN_MPS} or more; api/close keeps robots out",
                    speed.get()
                );
                return Err(text.into());
            }
            (LimitAction::Set, Some(speed)) => {
                let until_ms = self.end_of_period_ms(for_s, until)?;
                (BTreeSet::new(), SpeedLimitChange::Set { speed, until_ms, reason })
            }
            (LimitAction::Clear, speed) => {
                if speed.is_some() || for_s.is_some() || until.is_some() || !reason.is_empty() {
                    let text = "`speed_mps`, `for_s`, `until` and `reason` belong to the action `set`";
                    return Err(text.to_owned().into());
                }
                let limited = self.replica.read(|ledger| ledger.speed_limits().map(|limit| limit.part).collect());
                (limited, SpeedLimitChange::Clear)
            }
        };
        let parts = map_parts(places, lanes, &self.domain, &known)?;
        let order = self.order_request(change, by, request)?;
        self.commit_order(Command::ChangeSpeedLimits { parts, order }).await?;
        Ok(LimitsReply { speed_limits: self.replica.read(|ledger| ledger.speed_limits().collect()) })
    }
}
