//! Conversion between the messages of the bus and those of Zenoh.

use super::transmission::Senders;
use crate::author::Author;
use crate::bus::{BusError, Encoding, Query, QueryRefused, Replier, Reply, RequestAuthority};
use crate::keys;
use crate::open_queries::{BUSY, QuerySender};
use async_trait::async_trait;
use bytes::Bytes;
use std::time::{SystemTime, UNIX_EPOCH};
use tokio::sync::OwnedSemaphorePermit;
use zenoh::Wait;
use zenoh::bytes::{Encoding as ZenohEncoding, ZBytes};
use zenoh::query::ReplyError;
use zenoh::session::ZenohId;
use zenoh::time::{NTP64, Timestamp, TimestampId};
use zenoh_keyexpr::OwnedKeyExpr;

pub(super) fn to_zenoh(encoding: Encoding) -> ZenohEncoding {
    match encoding {
        Encoding::Wire => ZenohEncoding::APPLICATION_OCTET_STREAM,
        Encoding::Json => ZenohEncoding::APPLICATION_JSON,
    }
}

/// Payloads without a JSON encoding count as wire messages.
pub(super) fn from_zenoh(encoding: &ZenohEncoding) -> Encoding {
    if *encoding == ZenohEncoding::APPLICATION_OCTET_STREAM {
        return Encoding::Wire;
    }
    let text = encoding.to_string(); // may be followed by parameters: `application/json;charset=utf-8`
    let json = ["application/json", "text/json"].contains(&text.split(';').next().unwrap_or_default());
    if json { Encoding::Json } else { Encoding::Wire }
}

pub(super) fn to_bytes(payload: &ZBytes) -> Bytes {
    match payload.to_bytes() {
        std::borrow::Cow::Borrowed(bytes) => Bytes::copy_from_slice(bytes),
        std::borrow::Cow::Owned(bytes) => Bytes::from(bytes),
    }
}

/// Copies the attachment; empty if absent.
pub(super) fn attachment_bytes(attachment: Option<&ZBytes>) -> Bytes {
    attachment.map(to_bytes).unwrap_or_default()
}

/// Returns the attachment to send; `None` if it is empty.
pub(super) fn to_attachment(attachment: Bytes) -> Option<Bytes> {
    (!attachment.is_empty()).then_some(attachment)
}

/// Checks whether an error is Zenoh's report of a query timeout. Zenoh ends such a query with an
/// error that no service sent. The encoding distinguishes the two: errors of our services are plain
/// text.
fn is_timeout(error: &ReplyError) -> bool {
    let unmarked = [ZenohEncoding::ZENOH_STRING, ZenohEncoding::ZENOH_BYTES].contains(error.encoding());
    unmarked && error.payload().to_bytes() == b"Timeout".as_slice()
}

pub(super) fn reply(from: zenoh::query::Reply, query_key: &OwnedKeyExpr) -> Option<Reply> {
    match from.into_result() {
        Ok(sample) => Some(Reply {
            key: sample.key_expr().to_string(),
            payload: Ok(to_bytes(sample.payload())),
            attachment: attachment_bytes(sample.attachment()),
            author: Author::UNKNOWN,
        }),
        Err(error) if is_timeout(&error) => None,
        Err(error) => {
            let reason = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
            Some(Reply {
                key: query_key.to_string(),
                payload: Err(QueryRefused(reason)),
                attachment: Bytes::new(),
                author: Author::UNKNOWN,
            })
        }
    }
}

/// Creates the callback that puts queries into a mailbox. `own` is the id of the session.
pub(super) fn query_callback(
    mailbox: QuerySender,
    own: ZenohId,
    message_max: usize,
    senders: Senders,
) -> impl Fn(zenoh::query::Query) + Send + Sync {
    move |query| {
        let size = |content: Option<&ZBytes>| content.map_or(0, ZBytes::len);
        let texts = query.key_expr().as_str().len() + query.parameters().as_str().len();
        let Some(open) = mailbox.admit(texts + size(query.payload()) + size(query.attachment())) else {
            return senders.refuse(query, BUSY);
        };
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let at = Timestamp::new(NTP64::from(since_1970), TimestampId::from(own));
        // It fails if the receiver is gone: the declaration is about to end.
        mailbox.send(Query {
            key: query.key_expr().to_string(),
            parameters: query.parameters().to_string(),
            payload: query.payload().map(to_bytes).unwrap_or_default(),
            attachment: attachment_bytes(query.attachment()),
            author: Author::UNKNOWN,
            authority: RequestAuthority::Unchecked,
            replier: Box::new(ZenohReplier {
                query_key: OwnedKeyExpr::from(query.key_expr().clone()),
                query: Some((query, open)),
                at,
                message_max,
                senders: senders.clone(),
            }),
        });
    }
}

/// Replies to a query of Zenoh. The query ends when this is dropped.
struct ZenohReplier {
    /// The query, and its part of the open queries of the service; present until this is dropped.
    query: Option<(zenoh::query::Query, OwnedSemaphorePermit)>,
    query_key: OwnedKeyExpr,
    /// Timestamp of the query, in Zenoh's sense, which is unique per node. All replies to the query
    /// have this timestamp. Zenoh returns the latest reply per key, so of two nodes that reply on
    /// the same keys all returned replies come from the same node.
    at: Timestamp,
    message_max: usize,
    senders: Senders,
}

impl ZenohReplier {
    /// Sends a reply to the query.
    async fn send(
        &self,
        send: impl FnOnce(zenoh::query::Query) -> zenoh::Result<()> + Send + 'static,
    ) -> Result<(), BusError> {
        let (query, _) = self.query.as_ref().expect("a replier has its query until it is dropped");
        let query = query.clone();
        self.senders.send("reply to a query", query.priority(), move || send(query)).await
    }
}

impl Drop for ZenohReplier {
    fn drop(&mut self) {
        if let Some((query, open)) = self.query.take() {
            self.senders.end(query, open);
        }
    }
}

#[async_trait]
impl Replier for ZenohReplier {
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError> {
        let key = keys::reply_key(key, &self.query_key)?;
        keys::check_payload_size("reply to a query", &payload, self.message_max)?;
        let at = self.at;
        self.send(move |query| {
            let reply = query.reply(key, payload).encoding(to_zenoh(encoding)).timestamp(at);
            reply.attachment(to_attachment(attachment)).wait()
        })
        .await
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        let reason = reason.to_owned();
        self.send(move |query| query.reply_err(reason).encoding(ZenohEncoding::TEXT_PLAIN).wait()).await
    }
}
