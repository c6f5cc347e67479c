//! Clients that follow the fleet over a WebSocket.

use super::frame_publisher::Frame;
use super::json::error_reply;
use super::state::DashboardState;
use crate::admission::AuthenticatedClient;
use axum::Extension;
use axum::extract::ws::{CloseFrame, Message, WebSocket};
use axum::extract::{State, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::Response;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio::time::{MissedTickBehavior, interval};

/// Time limit for sending a message. A client that takes longer counts as disconnected.
const SEND_LIMIT: Duration = Duration::from_secs(20);

/// Maximum number of clients: each costs the node a full model at first, and then the changes five
/// times per second.
pub(super) const CLIENTS_MAX: usize = 100;

/// Interval for checking that a client's token is still valid.
const TOKEN_CHECK_EVERY: Duration = Duration::from_secs(5);

/// Close code for an expired token, in the range for applications (RFC 6455, 7.4.2).
const TOKEN_ENDED: u16 = 4401;

/// Maximum size of a client's message, in bytes: clients have nothing to send.
const MESSAGE_BYTES_MAX: usize = 1024;

/// Accepts a client, if the limit allows.
pub(super) async fn open_websocket(
    State(shared): State<DashboardState>,
    Extension(client): Extension<Option<AuthenticatedClient>>,
    upgrade: WebSocketUpgrade,
) -> Response {
    let Ok(permit) = Arc::clone(&shared.client_permits).try_acquire_owned() else {
        let what = format!("this node already serves {CLIENTS_MAX} clients, its maximum");
        return error_reply(StatusCode::SERVICE_UNAVAILABLE, &what);
    };
    let frames = shared.publisher.frames();
    // Memory is allocated before a frame has arrived completely.
    let upgrade = upgrade.max_message_size(MESSAGE_BYTES_MAX).max_frame_size(MESSAGE_BYTES_MAX);
    upgrade.on_upgrade(move |socket| send_frames(socket, shared, client, frames, permit))
}

/// Sends the full model, then changes. A slow client misses frames, and gets the full model again.
/// A client with a token is disconnected when the token expires.
async fn send_frames(
    mut socket: WebSocket,
    DashboardState { publisher, admission, .. }: DashboardState,
    client: Option<AuthenticatedClient>,
    mut frames: watch::Receiver<Arc<Frame>>,
    _permit: OwnedSemaphorePermit,
) {
    let mut sent_number = 0;
    let mut token_check = interval(TOKEN_CHECK_EVERY);
    token_check.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            changed = frames.changed() => {
                if changed.is_err() {
                    return;
                }
                let frame = frames.borrow_and_update().clone();
                let text = match frame.number.checked_sub(sent_number) {
                    // The full model of a later frame contained it already.
                    Some(0) | None => None,
                    Some(1) if sent_number > 0 => frame.text.clone(),
                    Some(_) => {
                        let (number, full) = publisher.full_frame();
                        sent_number = number;
                        Some(full)
                    }
                };
                sent_number = sent_number.max(frame.number);
                let Some(text) = text else { continue };
                let sent = tokio::time::timeout(SEND_LIMIT, socket.send(Message::Text(text))).await;
                if !matches!(sent, Ok(Ok(()))) {
                    return;
                }
            }
            received = socket.recv() => {
                if !matches!(received, Some(Ok(_))) {
                    return;
                }
            }
            _ = token_check.tick() => {
                if !admission.is_still_valid(client.as_ref()) {
                    let end = CloseFrame { code: TOKEN_ENDED, reason: "the token is no longer valid".into() };
                    let _ = tokio::time::timeout(SEND_LIMIT, socket.send(Message::Close(Some(end)))).await;
                    return;
                }
            }
        }
    }
}
