//! What any client can do: make requests, look, and see who is there.

use crate::{Fleet, slug};
use consort_actors::bus::{Bus, Reply, Stream};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{ApiCall, Key};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

impl Fleet {
    /// Makes a request as any client would. `None` when nobody answered.
    pub async fn request(&self, call: ApiCall, payload: &Value) -> Option<Value> {
        self.request_raw(call, &payload.to_string()).await
    }

    /// Makes a request of any content. One who has not heard yet that somebody coordinates may put it off, while the one
    /// who does carries it out: as any client should, this one listens for a moment whether there is a better answer.
    pub async fn request_raw(&self, call: ApiCall, payload: &str) -> Option<Value> {
        let mut put_off = None;
        let mut replies = self.query(call, payload).await;
        let mut patience = Duration::from_secs(3);
        while let Ok(Some(reply)) = tokio::time::timeout(patience, replies.recv()).await {
            let voice: Value = serde_json::from_slice(&reply.payload.expect("an answer")).expect("JSON");
            if voice.get("retry_after_ms").is_none() {
                return Some(voice);
            }
            put_off = Some(voice);
            patience = Duration::from_millis(100);
        }
        put_off
    }

    /// Makes a request and gives all that answer it, in the order in which they do.
    pub async fn request_all(&self, call: ApiCall, payload: &Value) -> Vec<Value> {
        let mut replies = self.query(call, &payload.to_string()).await;
        let mut voices = vec![];
        while let Some(reply) = replies.recv().await {
            voices.push(serde_json::from_slice(&reply.payload.expect("an answer")).expect("JSON"));
        }
        voices
    }

    async fn query(&self, call: ApiCall, payload: &str) -> Stream<Reply> {
        let key = self.keys.write(&Key::Api(call));
        let limit = Duration::from_secs(3);
        let payload = payload.to_owned().into();
        let asked = match call.is_read_only() {
            true => self.client.query_nearest(&key, payload, limit).await,
            false => self.client.query(&key, payload, limit).await,
        };
        asked.expect("a virtual bus")
    }

    /// Makes a request to which there must be an answer.
    pub async fn request_answered(&self, call: ApiCall, payload: &Value) -> Value {
        let answer = self.request(call, payload).await;
        answer.unwrap_or_else(|| panic!("seed {}: no answer to {payload}\n{}", self.seed, self.event_log_text()))
    }

    /// What is to be seen under a key expression below `view/`, and how often each key was answered.
    ///
    /// # Panics
    /// When the answers are not JSON, or one key is answered twice.
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

    /// Asks a node to leave for good. What it answers: once it has left, or why it stays.
    pub async fn request_leave(&self, name: &str) -> Value {
        let (key, limit) = (self.keys.write(&Key::Leave(slug(name))), Duration::from_secs(60));
        let mut replies = self.client.query(&key, vec![].into(), limit).await.expect("a virtual bus");
        let said = replies.recv().await.unwrap_or_else(|| panic!("seed {}: {name} does not answer", self.seed));
        serde_json::from_slice(&said.payload.expect("an answer")).expect("JSON")
    }

    /// Asks for lab samples from a room until somebody acknowledges it.
    pub async fn submit(&self, request: &str, room: &str) -> MissionId {
        slug(self.submit_with_reply(request, room).await["mission"].as_str().expect("an acknowledgement names it"))
    }

    /// As [`submit`](Fleet::submit), and gives the whole answer.
    pub async fn submit_with_reply(&self, request: &str, room: &str) -> Value {
        let asked = json!({ "mission": "lab-samples", "parameters": { "room": room }, "request": request });
        self.poll_until(&format!("the acknowledgement of request {request}"), Duration::from_secs(300), async |fleet| {
            fleet.request(ApiCall::Submit, &asked).await.filter(|answer| answer["mission"].is_string())
        })
        .await
    }

    /// Lets virtual time pass until `look` sees something, which it is asked for ten times a second: for what only a question
    /// tells. What the fleet tells by itself is awaited by [`until`](Fleet::until).
    ///
    /// # Panics
    /// When it has not within `limit`; the message tells what was awaited, the seed, and all that happened.
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

    /// The presence tokens that a client who comes now sees, without the fleet's prefix.
    pub async fn presence_tokens(&self) -> BTreeSet<String> {
        let mut tokens = self.client.watch(&self.keys.any_alive()).await.expect("a virtual bus");
        let mut present = BTreeSet::new();
        // What is there already is told within one crossing of the network.
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
