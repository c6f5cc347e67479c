//! Client functions: requests, views and presence tokens.

use crate::{Fleet, slug};
use consort_bus::{Bus, Reply, Stream};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{ApiCall, Key};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

impl Fleet {
    /// Sends a request as any client does. Returns `None` if no node replies.
    pub async fn request(&self, call: ApiCall, payload: &Value) -> Option<Value> {
        self.request_raw(call, &payload.to_string()).await
    }

    /// Sends a request with any payload. A node that has no coordinator yet may reply with a retry
    /// delay while the coordinator carries the request out. So this client waits briefly for a
    /// better reply, as every client should.
    pub async fn request_raw(&self, call: ApiCall, payload: &str) -> Option<Value> {
        let mut put_off = None;
        let mut replies = self.query(call, payload).await;
        let mut timeout = Duration::from_secs(3);
        while let Ok(Some(reply)) = tokio::time::timeout(timeout, replies.recv()).await {
            let voice: Value = serde_json::from_slice(&reply.payload.expect("a reply")).expect("JSON");
            if voice.get("retry_after_ms").is_none() {
                return Some(voice);
            }
            put_off = Some(voice);
            timeout = Duration::from_millis(100);
        }
        put_off
    }

    /// Sends a request and returns all replies in the order of arrival.
    pub async fn request_all(&self, call: ApiCall, payload: &Value) -> Vec<Value> {
        values(self.query(call, &payload.to_string()).await).await
    }

    /// Sends a read to all nodes and returns their replies.
    pub async fn read_everywhere(&self, call: ApiCall, payload: &Value) -> Vec<Value> {
        let (key, limit) = (self.keys.write(&Key::Api(call)), Duration::from_secs(3));
        values(self.requests.query(&key, payload.to_string().into(), limit).await.expect("a virtual bus")).await
    }

    async fn query(&self, call: ApiCall, payload: &str) -> Stream<Reply> {
        let key = self.keys.write(&Key::Api(call));
        let limit = Duration::from_secs(3);
        let payload = payload.to_owned().into();
        let replies = match call.is_read_only() {
            true => self.requests.query_nearest(&key, payload, limit).await,
            false => self.requests.query(&key, payload, limit).await,
        };
        replies.expect("a virtual bus")
    }

    /// Sends a request and panics without a reply.
    pub async fn request_answered(&self, call: ApiCall, payload: &Value) -> Value {
        let answer = self.request(call, payload).await;
        answer.unwrap_or_else(|| panic!("seed {}: no reply to {payload}\n{}", self.seed, self.event_log_text()))
    }

    /// Queries the views under a key expression below `view/` and returns them by name.
    ///
    /// # Panics
    /// If a reply is not JSON, or if a key is answered twice.
    pub async fn view(&self, what: &str) -> BTreeMap<String, Value> {
        let key = format!("consort/ward/view/{what}");
        let limit = Duration::from_secs(1);
        let mut replies = self.client.query_nearest(&key, vec![].into(), limit).await.expect("a virtual bus");
        let mut views = BTreeMap::new();
        while let Some(reply) = replies.recv().await {
            let payload = reply.payload.expect("a view");
            let value: Value = serde_json::from_slice(&payload).expect("JSON");
            let name = reply.key.trim_start_matches("consort/ward/view/").to_owned();
            let former = views.insert(name, value);
            assert!(former.is_none(), "seed {}: {} was answered twice", self.seed, reply.key);
        }
        views
    }

    /// Queries a view as a single node computes it.
    ///
    /// # Panics
    /// If there is no reply, or if it is not JSON.
    pub async fn view_of(&self, node: &str, what: &str) -> Value {
        let key = format!("consort/ward/seen/{node}/{what}");
        let limit = Duration::from_secs(1);
        let mut replies = self.client.query_nearest(&key, vec![].into(), limit).await.expect("a virtual bus");
        let reply = replies.recv().await.expect("a reply");
        serde_json::from_slice(&reply.payload.expect("a view")).expect("JSON")
    }

    /// Asks a node to leave for good. The node replies after it has left, or with the reason why it
    /// stays.
    pub async fn request_leave(&self, name: &str) -> Value {
        let (key, limit) = (self.keys.write(&Key::Leave(slug(name))), Duration::from_secs(60));
        let mut replies = self.requests.query(&key, vec![].into(), limit).await.expect("a virtual bus");
        let reply = replies.recv().await.unwrap_or_else(|| panic!("seed {}: {name} does not reply", self.seed));
        serde_json::from_slice(&reply.payload.expect("a reply")).expect("JSON")
    }

    /// Requests lab samples from a room until the request is acknowledged.
    pub async fn submit(&self, request: &str, room: &str) -> MissionId {
        slug(self.submit_with_reply(request, room).await["mission"].as_str().expect("an acknowledgement names it"))
    }

    /// Same as [`submit`](Fleet::submit), but returns the whole reply.
    pub async fn submit_with_reply(&self, request: &str, room: &str) -> Value {
        let request = json!({ "mission": "lab-samples", "parameters": { "room": room }, "request": request });
        self.poll_until(&format!("the acknowledgement of request {request}"), Duration::from_secs(300), async |fleet| {
            fleet.request(ApiCall::Submit, &request).await.filter(|answer| answer["mission"].is_string())
        })
        .await
    }

    /// Lets virtual time pass until `look` returns a value. It calls `look` ten times a second. Use
    /// it for state that only a query shows; [`wait_until`](Fleet::wait_until) waits for published
    /// events.
    ///
    /// # Panics
    /// If `look` returns nothing within `limit`. The message contains the condition, the seed and
    /// the event log.
    pub async fn poll_until<T>(
        &self,
        what: &str,
        limit: Duration,
        mut look: impl AsyncFnMut(&Fleet) -> Option<T>,
    ) -> T {
        let deadline = self.elapsed() + limit;
        loop {
            if let Some(seen) = look(self).await {
                return seen;
            }
            assert!(
                self.elapsed() < deadline,
                "seed {}: {what} was not to be seen within {limit:?}\n{}",
                self.seed,
                self.event_log_text()
            );
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    /// Returns the presence tokens that a new client receives, without the prefix of the fleet.
    pub async fn presence_tokens(&self) -> BTreeSet<String> {
        let mut tokens = self.client.watch(&self.keys.any_alive()).await.expect("a virtual bus");
        let mut present = BTreeSet::new();
        // Existing tokens arrive within a network latency.
        while let Ok(Some(token)) = tokio::time::timeout(Duration::from_millis(100), tokens.recv()).await {
            let name = token.key.trim_start_matches("consort/ward/alive/").to_owned();
            if token.alive {
                present.insert(name)
            } else {
                present.remove(&name)
            };
        }
        present
    }
}

/// Returns all replies as JSON, in the order of arrival.
async fn values(mut replies: Stream<Reply>) -> Vec<Value> {
    let mut values = vec![];
    while let Some(reply) = replies.recv().await {
        values.push(serde_json::from_slice(&reply.payload.expect("a reply")).expect("JSON"));
    }
    values
}
