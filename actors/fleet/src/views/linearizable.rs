//! Linearizable reads: the reply contains everything that was acknowledged before the request.
//!
//! ```text
//!  client ── api/get ──▶ the nearest node ── seen/{coordinator}/** ──▶ the coordinator
//!                                                                       │ a majority confirms it
//!                                                                       ▼ its copy of the ledger
//! ```

use super::draw::json;
use super::{RETRY_AFTER_MS, ViewService};
use bytes::Bytes;
use consort_protocol::api::{ErrorReply, ReadOptions};
use consort_protocol::keys::Key;
use serde_json::Value;
use std::time::Duration;

/// Timeout for a majority to confirm the coordinator.
const CONFIRMATION_TIMEOUT: Duration = Duration::from_secs(2);

/// Timeout for the coordinator to reply: a little more than it may take.
const COORDINATOR_TIMEOUT: Duration = Duration::from_millis(2300);

impl ViewService {
    /// Reads a view of the ledger, here or at the coordinator.
    ///
    /// # Errors
    /// The JSON of an [`ErrorReply`]: the mission does not exist, or no majority has confirmed the
    /// coordinator in time.
    pub(super) async fn linearizable_view(&self, key: &Key) -> Result<Value, Value> {
        if self.views.replica.as_ref().is_some_and(|replica| replica.leadership().borrow().is_leader) {
            return self.own_linearizable_view(key).await;
        }
        match self.context().await.status.coordinator.filter(|coordinator| *coordinator != self.views.node) {
            Some(coordinator) => self.coordinators_view(Key::Seen(coordinator, Box::new(key.clone()))).await,
            None => Err(retry("no coordinator yet")),
        }
    }

    /// Reads a view of this node's own copy of the ledger, after a majority has confirmed that this
    /// node leads.
    ///
    /// # Errors
    /// As [`linearizable_view`](Self::linearizable_view).
    pub(super) async fn own_linearizable_view(&self, key: &Key) -> Result<Value, Value> {
        let node = &self.views.node;
        let Some(replica) = &self.views.replica else { return Err(retry(&format!("{node} has no ledger"))) };
        replica.ensure_leader(CONFIRMATION_TIMEOUT).await.map_err(|problem| retry(&problem.to_string()))?;
        let mut context = self.context().await;
        context.linearizable = true;
        context.status.has_ledger = true;
        let named = if let Key::ViewMission(mission) = key { Some(mission) } else { None };
        let mut views = context.draw(&|view| view == key, named);
        views.pop().map(|(_, view)| view).ok_or_else(|| match named {
            Some(mission) => json(ErrorReply::rejected(format!("no mission {mission} is known; see api/list"))),
            None => json(ErrorReply::rejected("only missions, requests and auctions have linearizable reads")),
        })
    }

    async fn coordinators_view(&self, seen: Key) -> Result<Value, Value> {
        let options = serde_json::to_vec(&ReadOptions { linearizable: true }).expect("options serialize to JSON");
        let key = self.views.keys.write(&seen);
        let replies = self.views.bus.query(&key, Bytes::from(options), COORDINATOR_TIMEOUT).await;
        let mut replies = replies.map_err(|problem| retry(&problem.to_string()))?;
        let reply = replies.recv().await.and_then(|reply| reply.payload.ok());
        let view: Option<Value> = reply.and_then(|payload| serde_json::from_slice(&payload).ok());
        let view = view.ok_or_else(|| retry("the coordinator does not reply"))?;
        if view.get("error").is_some() { Err(view) } else { Ok(view) }
    }
}

pub(super) fn retry(problem: &str) -> Value {
    json(ErrorReply::retry_after(format!("{problem}; the same request may be sent again"), RETRY_AFTER_MS))
}
