//! Those who follow over a WebSocket.

use super::frame_publisher::Frame;
use super::json::error_reply;
use super::routes::DashboardState;
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

/// How long a client may take to take a message in. One that takes longer is gone, or as good as gone.
const SLOW: Duration = Duration::from_secs(20);

/// How many may follow at once: each costs the node a picture in the beginning, and what changes five times a second.
pub(super) const CLIENTS_MAX: usize = 100;

/// How often it is looked whether who follows still may.
const JUDGED_EVERY: Duration = Duration::from_secs(5);

/// What a WebSocket is closed with when its token has ended, of the numbers that are an application's own (RFC 6455, 7.4.2).
const TOKEN_ENDED: u16 = 4401;

/// Largest message of a client's over the WebSocket, in bytes: it has nothing to say.
const SAID_MAX: usize = 1024;

/// Takes in whoever wants to follow, if there is room.
pub(super) async fn open_websocket(
    State(shared): State<DashboardState>,
    Extension(guest): Extension<Option<AuthenticatedClient>>,
    upgrade: WebSocketUpgrade,
) -> Response {
    let Ok(place) = Arc::clone(&shared.client_permits).try_acquire_owned() else {
        let what = format!("{CLIENTS_MAX} follow this node already, as many as may at once");
        return error_reply(StatusCode::SERVICE_UNAVAILABLE, &what);
    };
    let frames = shared.publisher.frames();
    // Before a frame has come whole, room is made for it.
    let upgrade = upgrade.max_message_size(SAID_MAX).max_frame_size(SAID_MAX);
    upgrade.on_upgrade(move |socket| send_frames(socket, shared, guest, frames, place))
}

/// Sends the whole, then what changes. Whoever is slow misses frames, and gets the whole again. Who was let in by a token follows
/// for as long as that is good.
async fn send_frames(
    mut socket: WebSocket,
    DashboardState { publisher: board, admission, .. }: DashboardState,
    guest: Option<AuthenticatedClient>,
    mut frames: watch::Receiver<Arc<Frame>>,
    _place: OwnedSemaphorePermit,
) {
    let mut seen = 0;
    let mut judged = interval(JUDGED_EVERY);
    judged.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            changed = frames.changed() => {
                if changed.is_err() {
                    return;
                }
                let frame = frames.borrow_and_update().clone();
                let text = match frame.number.checked_sub(seen) {
                    // What the whole, of a later frame, had already.
                    Some(0) | None => None,
                    Some(1) if seen > 0 => frame.text.clone(),
                    Some(_) => {
                        let (number, whole) = board.full_frame();
                        seen = number;
                        Some(whole)
                    }
                };
                seen = seen.max(frame.number);
                let Some(text) = text else { continue };
                let sent = tokio::time::timeout(SLOW, socket.send(Message::Text(text))).await;
                if !matches!(sent, Ok(Ok(()))) {
                    return;
                }
            }
            said = socket.recv() => {
                if !matches!(said, Some(Ok(_))) {
                    return;
                }
            }
            _ = judged.tick() => {
                if !admission.is_still_valid(guest.as_ref()) {
                    let end = CloseFrame { code: TOKEN_ENDED, reason: "the token is no longer good".into() };
                    let _ = tokio::time::timeout(SLOW, socket.send(Message::Close(Some(end)))).await;
                    return;
                }
            }
        }
    }
}
