//! Requests of clients during a session.

use super::api::ApiHandler;
use super::no_leader::{RETRY_AFTER_MS, busy_reply};
use super::people::PeopleHost;
use super::rate_limit::RequestLimiter;
use super::session_context::SessionContext;
use super::settings::NodeParts;
use consort_bus::{Query, RequestAuthority, Requester, reply};
use consort_protocol::api::ErrorReply;
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::ledger::Ledger;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tracing::info;

/// Requests of clients, counted and limited.
pub(super) struct Requests {
    /// Number of accepted requests.
    count: u64,
    limiter: RequestLimiter,
    /// Start of the session by the node's wall clock, in milliseconds. Distinguishes the sessions
    /// of a term.
    since_wall_ms: u64,
}

impl Requests {
    pub(super) fn new(context: &SessionContext) -> Requests {
        Requests {
            count: 0,
            limiter: RequestLimiter::new(context.settings.request_limits, context.since),
            since_wall_ms: context.settings.parts.clock.wall_ms(),
        }
    }

    /// Handles a request and replies to it. `time_ms` is the time of day, in milliseconds since 1970,
    /// if it is known.
    pub(super) fn handle(&mut self, query: Query, time_ms: Option<u64>, context: &mut SessionContext) {
        let Some(Key::Api(call)) = context.settings.parts.keys.read(&query.key) else {
            let asked = query.key.rsplit('/').next().unwrap_or_default();
            let calls = ApiCall::ALL.iter().map(|call| call.as_str()).collect::<Vec<_>>().join(", ");
            let reply = ErrorReply::rejected(format!("no such request: {asked}; there are {calls}"));
            reply::json_in(&mut context.tasks, query, reply);
            return;
        };
        let requester = match &query.authority {
            RequestAuthority::Unchecked => None,
            RequestAuthority::Verified(requester) => Some(requester.clone()),
            RequestAuthority::Rejected(reply) => {
                let reply = reply.clone();
                reply::json_in(&mut context.tasks, query, reply);
                return;
            }
        };
        if let Some(requester) = &requester
            && requester.signed_at_ms < session_start_ms(context)
            && !context.read_ledger(|ledger| is_remembered(call, ledger))
        {
            let text = "the request was signed before this node became coordinator, by its clock: sign it again, and \
                        compare the clocks if that does not help";
            let reply = busy_reply(text, Duration::from_millis(RETRY_AFTER_MS));
            reply::json_in(&mut context.tasks, query, reply);
            return;
        }
        if let Err(after) = self.limiter.try_acquire(context.now()) {
            let reply = busy_reply("too many requests per second", after);
            reply::json_in(&mut context.tasks, query, reply);
            return;
        }
        self.count += 1;
        if let Some(Requester { author, request, .. }) = &requester {
            info!(call = call.as_str(), %author, request, "executing a request");
        }
        let handler = self.handler(requester, time_ms, context);
        context.tasks.spawn(async move {
            let reply = handler.handle(call, &query.payload).await;
            reply::json(&query, &query.key, &reply).await;
            drop(handler); // its reply is no longer open
        });
    }

    fn handler(&self, requester: Option<Requester>, time_ms: Option<u64>, context: &SessionContext) -> ApiHandler {
        let NodeParts { node, keys, bus, replica, events, knowledge, wire_version, .. } = &context.settings.parts;
        ApiHandler {
            fleet: keys.fleet().clone(),
            node: node.clone(),
            replica: replica.clone(),
            events: events.clone(),
            knowledge: knowledge.clone(),
            supported_versions: wire_version.supported(),
            domain: Arc::clone(&context.settings.domain),
            ensembles: Arc::clone(&context.settings.auctions.ensembles),
            missions: Arc::clone(&context.settings.missions),
            alarms: Arc::clone(&context.settings.alarms),
            people: PeopleHost::new(bus, keys),
            request_prefix: format!(
                "unnamed-{}-{:x}-{}",
                context.term,
                self.since_wall_ms,
                node.as_str().chars().take(20).collect::<String>()
            ),
            time_ms,
            request_number: self.count,
            requester,
            limits: context.settings.request_limits,
            open_replies: context.open_replies.clone(),
            open_reply: OnceLock::new(),
        }
    }
}

/// Checks whether the ledger shows that a request was executed: by its id, or because it has ended its mission. An
/// earlier coordinator may have executed any other request, and a copy would be executed again.
fn is_remembered(call: ApiCall, ledger: &Ledger) -> bool {
    match call {
        // Without a history the ledger cancels the missions one by one and keeps no id. The condition of a copy would
        // select later missions.
        ApiCall::CancelMissions => ledger.history_limits().is_some(),
        ApiCall::Submit
        | ApiCall::Cancel
        | ApiCall::Priority
        | ApiCall::Reassign
        | ApiCall::Resolve
        | ApiCall::Hold
        | ApiCall::Release
        | ApiCall::Maintenance
        | ApiCall::Close
        | ApiCall::Open
        | ApiCall::Limit
        | ApiCall::Alarm => true,
        ApiCall::Answer | ApiCall::Schedule | ApiCall::Backup | ApiCall::Upgrade => false,
        // Reads are not signed.
        ApiCall::Get
        | ApiCall::List
        | ApiCall::Requests
        | ApiCall::Schedules
        | ApiCall::Audit
        | ApiCall::Explain
        | ApiCall::Help => true,
    }
}

/// Returns the start of the session in milliseconds since 1970, by the node's clock as it is now: it may have been
/// corrected since.
fn session_start_ms(context: &SessionContext) -> u64 {
    let age_ms = u64::try_from(context.now().since(context.since).as_millis()).unwrap_or(u64::MAX);
    context.settings.parts.clock.wall_ms().saturating_sub(age_ms)
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::Command;

    #[test]
    fn a_ledger_without_a_history_remembers_no_cancelation_of_several_missions() {
        let mut ledger = Ledger::default();
        assert!(is_remembered(ApiCall::Cancel, &ledger) && !is_remembered(ApiCall::CancelMissions, &ledger));
        ledger.apply(Epoch { term: 1, index: 1 }, Command::first_wire_version(3));
        assert!(is_remembered(ApiCall::CancelMissions, &ledger) && !is_remembered(ApiCall::Answer, &ledger));
    }
}
